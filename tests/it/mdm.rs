//! MDM through the command line: trained on captions, it edits body parts and is ranked in a table.

use datasets_spec::record::{EditRow, ItemRow, MotionRow};
use datasets_spec::{Skeleton, Split};
use kinematics::skeleton::NUM_BODY_JOINTS;
use serde_json::Value;

use crate::evaluate::{Bench, UNPOSED};
use crate::results::score;
use crate::util::number_of;

/// Settings of a network that is trained in a second.
pub(crate) const SMALL: &str = "
    batch_size = 8
    val_every = 3
    log_every = 3
    diffusion_steps = 10
    [model]
    width = 32
    num_layers = 1
    num_heads = 4
    feed_forward = 64
";

#[test]
fn mdm_edits_body_parts_and_stands_in_the_table() {
    let bench = Bench::open();
    let done = bench.trained("mdm", "mdm", SMALL, "--steps 3");
    assert_eq!(done["steps"], 3);
    assert_eq!(done["is_complete"], true);
    // Clips that are too short for its windows are counted.
    let clips: Vec<MotionRow> = bench.rows("dataset");
    let is_of = |row: &&MotionRow| row.split == Split::Train && !row.captions.is_empty();
    let lengths: Vec<i32> = clips.iter().filter(is_of).map(|row| row.n_frames).collect();
    let least = 1 + lengths.iter().max().expect("clips") / 2;
    let few = format!("min_frames = {least}\n{SMALL}");
    let done = bench.trained("mdm", "long", &few, "--steps 1");
    let short = lengths.iter().filter(|frames| **frames <= least).count();
    assert_eq!(done["left_out"], short, "{done}");
    assert_ne!(short, 0);

    bench.answers("mdm", "items", "parts", "--release 0 --guidance 2");
    let edits: Vec<EditRow> = bench.rows("parts");
    let items: Vec<ItemRow> = bench.rows("parts");
    assert_eq!((edits.len(), items.len()), (8, 8));
    let skeleton = Skeleton::smplx_neutral();
    for edit in &edits {
        let settings: Value = serde_json::from_str(&edit.settings).expect("a document");
        assert_eq!(settings["start"], 9);
        assert_eq!(settings["release"], 0);
        let item = items.iter().find(|item| item.id == edit.id);
        let item = item.expect("its item");
        let source = item.source().expect("a motion");
        let motion = edit.motion().expect("a motion");
        assert_eq!((motion.len(), motion.fps()), (source.len(), source.fps()));
        let free = item.edited_joints().expect("known joints");
        let [before, after] = [&source, &motion].map(|motion| skeleton.motion_keypoints(motion));
        let moved = |joint: usize| {
            let pairs = before.points.iter().zip(&after.points);
            let moved = pairs.map(|(a, b)| a[joint].distance(b[joint]));
            moved.fold(0.0, f64::max)
        };
        // The network is hardly trained, so edited joints end far from the source; others move less than half as far.
        let most = |is_free: bool| {
            let joints = (0..NUM_BODY_JOINTS).filter(|&joint| free.contains(joint) == is_free);
            joints.map(moved).fold(0.0, f64::max)
        };
        let (rest, part) = (most(false), most(true));
        let is_kept = free.contains(0) || rest < 0.5 * part;
        assert!(is_kept, "{free}: {rest} {part}");
    }

    bench.edits("ours", "");
    let scores = bench.scores("@ours @parts", "");
    for system in ["MDM-BP (guidance 2)", "Identity", UNPOSED] {
        number_of(&score(&scores, system, "E2T AvgR")["mean"]);
    }
}
