//! The systems that the method is compared with.

use std::collections::BTreeSet;

use datasets_spec::Dataset;
use datasets_spec::record::{EditRow, ItemRow};
use serde_json::Value;

use crate::evaluate::Bench;
use crate::util::{arg, put, typed};

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
    let workshop = &bench.workshop;
    let (small, fixed) = (workshop.path("tmed.toml"), workshop.path("fixed.toml"));
    put(&small, SMALL_TMED);
    put(&fixed, "fixed_pairs = true\n");
    let settings = ["--config", arg(&small), "--steps", "4"];
    let train = |run: &str, more: &[&str]| {
        let args = [&settings[..], more].concat();
        workshop.train_with("tmed", run, &args)
    };
    train("mixed", &[]).expect_code(0);
    train("fixed", &["--compose", arg(&fixed)]).expect_code(0);
    // The same command finds the run complete.
    let again: Value = train("mixed", &[]).done();
    assert_eq!(again["steps"], 4);

    let mixed = bench.answers("mixed", "items", "with", &["--diffusion-steps", "3"]);
    let without = bench.answers("fixed", "items", "without", &[]);
    let made = Dataset::open(&mixed).expect("a folder of edits");
    let (items, edits): (Vec<ItemRow>, Vec<EditRow>) = (
        made.read(None).expect("items"),
        made.read(None).expect("edits"),
    );
    assert_eq!(items.len(), edits.len());
    for edit in &edits {
        let item = items.iter().find(|item| item.id == edit.id);
        assert_eq!(edit.n_frames, item.expect("its item").target_frames);
    }
    let settings: Value = serde_json::from_str(&edits[0].settings).expect("an object");
    assert_eq!(settings["steps"], 3);

    let scores: Value = bench.eval(&[&mixed, &without], &["--json"]).done();
    let systems: BTreeSet<&str> = scores
        .as_array()
        .expect("rows")
        .iter()
        .filter_map(|row| row["system"].as_str())
        .collect();
    for system in ["TMED", "TMED w/ MCM (steps 3)", "Identity", "Real Data"] {
        assert!(systems.contains(system), "{system}: {systems:?}");
    }

    // The corpus has masks and no captured pairs.
    let pairs = workshop.path("pairs.toml");
    put(&pairs, format!("data = \"pairs\"\n{SMALL_TMED}"));
    let refused = workshop.train_with("tmed", "pairs", &["--config", arg(&pairs)]);
    refused.expect_refused("composed");
    // The system follows one instruction, for some frames or for all.
    let clip = workshop.clip();
    let (run, out) = (workshop.path("mixed"), workshop.path("part.npz"));
    let (wave, bow) = ("0:10 The person is waving.", "10:20 The person is bowing.");
    typed(
        "edit {} --motion {} --during {} --during {} --out {}",
        &[&run, &clip, &wave, &bow, &out],
    )
    .expect_refused("one instruction");
}
