//! TMED, one of the systems that the method is compared with.

use datasets_spec::record::{EditRow, ItemRow};
use serde_json::Value;

use crate::evaluate::Bench;
use crate::util::texts_in;

/// A small TMED.
pub(crate) const SMALL_TMED: &str = "
    batch_size = 6
    val_every = 4
    val_clips = 6
    log_every = 2
    max_frames = 40
    [model]
    width = 32
    num_layers = 1
    num_heads = 4
    feed_forward = 64
    [diffusion]
    num_steps = 6
";

#[test]
fn tmed_with_and_without_motion_cut_mix_stand_in_one_table() {
    let bench = Bench::open();
    bench.put("pairs.toml", "fixed_pairs = true\n");
    bench.trained("tmed", "mixed", SMALL_TMED, "--steps 4");
    let more = "--steps 4 --compose @pairs.toml";
    bench.trained("tmed", "fixed", SMALL_TMED, more);
    // The same command finds the run complete.
    let again = bench.trained("tmed", "mixed", SMALL_TMED, "--steps 4");
    assert_eq!(again["steps"], 4);

    bench.answers("mixed", "items", "with", "--diffusion-steps 3");
    bench.answers("fixed", "items", "without", "");
    let items: Vec<ItemRow> = bench.rows("with");
    let edits: Vec<EditRow> = bench.rows("with");
    assert_eq!(items.len(), edits.len());
    for edit in &edits {
        let item = items.iter().find(|item| item.id == edit.id);
        assert_eq!(edit.n_frames, item.expect("its item").target_frames);
    }
    let settings: Value = serde_json::from_str(&edits[0].settings).expect("an object");
    assert_eq!(settings["steps"], 3);

    let scores = bench.scores("@with @without", "");
    let systems = texts_in(&scores, "system");
    for system in ["TMED", "TMED w/ MCM (steps 3)", "Identity", "Real Data"] {
        assert!(systems.contains(&system), "{system}: {systems:?}");
    }

    // The corpus has masks and no captured pairs.
    bench.put("captured.toml", format!("data = \"pairs\"\n{SMALL_TMED}"));
    let train = "train tmed @dataset --out @captured --config @captured.toml";
    bench.refused(train, "composed");
    let composed = format!("{train} --compose @pairs.toml");
    bench.refused(&composed, "settings of the composer have no effect");
    // TMED follows a single instruction, for some frames or for all.
    let edit = "edit @mixed --motion @walk.bvh --out @part.npz";
    let ranges = "--during '0:10 The person is waving.' --during '10:20 The person is bowing.'";
    bench.refused(&format!("{edit} {ranges}"), "one instruction");
    for range in ["0:900000", "20:5", "10:10"] {
        let line = format!("{edit} --during '{range} wave'");
        bench.refused(&line, "does not fit");
    }
}
