//! MDM through the command line: trained on captions, it edits body parts and is ranked in a table.

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Dataset, Skeleton};
use kinematics::skeleton::NUM_BODY_JOINTS;
use serde_json::Value;

use crate::evaluate::{Bench, UNPOSED};
use crate::results::score;
use crate::util::{arg, put};

/// Settings of a network that is trained in a second.
const SMALL: &str = "
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
    let settings = bench.workshop.path("mdm.toml");
    put(&settings, SMALL);
    let small = ["--config", arg(&settings), "--steps", "3"];
    let done: Value = bench.workshop.train_with("mdm", "mdm", &small).done();
    assert_eq!(
        (&done["steps"], &done["is_complete"]),
        (&3.into(), &true.into())
    );

    let out = bench.answers(
        "mdm",
        "items",
        "parts",
        &["--release", "0", "--guidance", "2"],
    );
    let folder = Dataset::open(&out).expect("edits");
    let edits: Vec<EditRow> = folder.read(None).expect("rows");
    let items: Vec<ItemRow> = folder.read(None).expect("rows");
    assert_eq!((edits.len(), items.len()), (8, 8));
    let skeleton = Skeleton::smplx_neutral();
    for edit in &edits {
        let settings: Value = serde_json::from_str(&edit.settings).expect("a document");
        assert_eq!(
            (&settings["start"], &settings["release"]),
            (&9.into(), &0.into())
        );
        let item = items
            .iter()
            .find(|item| item.id == edit.id)
            .expect("its item");
        let (source, motion) = (
            item.source().expect("a motion"),
            edit.motion().expect("a motion"),
        );
        assert_eq!((motion.len(), motion.fps()), (source.len(), source.fps()));
        let free = item.edited_joints().expect("known joints");
        let [before, after] = [&source, &motion].map(|motion| skeleton.motion_keypoints(motion));
        let moved = |joint: usize| {
            let pairs = before.points.iter().zip(&after.points);
            pairs
                .map(|(a, b)| a[joint].distance(b[joint]))
                .fold(0.0, f64::max)
        };
        // The network is untrained: its motion of a part is far from the source, and the bones around the part follow
        // it.
        let most = |is_free: bool| {
            let joints = (0..NUM_BODY_JOINTS).filter(|&joint| free.contains(joint) == is_free);
            joints.map(moved).fold(0.0, f64::max)
        };
        if !free.contains(0) {
            assert!(
                most(false) < 0.5 * most(true),
                "{free}: {} {}",
                most(false),
                most(true)
            );
        }
    }

    let ours = bench.edits("ours", &[]);
    let scores: Value = bench.eval(&[&ours, &out], &["--json"]).done();
    for system in ["MDM-BP (guidance 2)", "Identity", UNPOSED] {
        assert!(
            score(&scores, system, "E2T AvgR")["mean"]
                .as_f64()
                .is_some()
        );
    }
}
