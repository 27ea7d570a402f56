//! `stance build` makes a dataset with style pairs, and `stance triplets` records windows to train on.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use datasets_spec::Split;
use datasets_spec::record::{
    EditRow, MaskRow, MotionRow, NormalizerRow, PairRow, TripletRow, WindowRow,
};
use datasets_spec::table::Row;
use serde_json::Value;

use crate::util::{
    Folder, arg, assert_has, commit, files_with_extension, json_of, motions_of, number_of, stem_of,
};

/// One take of 26 actions in six styles.
const CLIPS: usize = 156;

#[test]
fn one_file_builds_a_dataset_with_pairs_and_the_layout_of_the_release() {
    let folder = Folder::of_clips(CLIPS);
    // A layout that does not exist is refused before anything is made.
    let wrong = "sources = [\"corpus\"]\nout = \"built\"\nexport = [\"stance\", \"bvx\"]\n";
    folder.put("wrong.toml", wrong);
    let refused = folder.typed("build --config @wrong.toml").expect_code(1);
    refused.expect_said("wrong.toml:3:");
    refused.expect_said("export names \"bvx\", which is none of amass, ");
    assert!(!folder.path("built").exists());
    folder.put(
        "build.toml",
        r#"
            sources = ["corpus"]
            out = "built"
            triplets = 40
            export = ["stance"]
            [pairs]
            [compose]
            alignment = "time-warp"
            undonored_ratio = 0.2
        "#,
    );
    let build = || folder.json::<Value>("build --config @build.toml");
    let built = build();
    assert_eq!(built["motions"], CLIPS);
    assert_eq!(built["recorded"], 40);
    assert!(number_of(&built["pairs"]) > 15.0, "{built}");
    // Nothing is left to do.
    assert_eq!(build()["root_hash"], built["root_hash"]);

    let triplets: Vec<TripletRow> = folder.rows("built/triplets");
    let clips = folder.rows::<MotionRow>("built/dataset").into_iter();
    let splits = clips.map(|row| (row.id.to_string(), row.split));
    let splits: BTreeMap<String, _> = splits.collect();
    for triplet in &triplets {
        let motions = [triplet.source_id.to_string(), triplet.target_id.to_string()];
        for motion in motions.iter().chain(&triplet.donor_ids) {
            assert_eq!(splits[motion], triplet.split, "{}", triplet.id);
        }
        let warped = triplet.alignment == "time-warp";
        assert_eq!(warped, triplet.kind == "style", "{}", triplet.id);
    }
    for kind in ["style", "semantic"] {
        assert!(triplets.iter().any(|triplet| triplet.kind == kind));
    }

    // An export of the dataset before it grew is not taken for one of today's, nor deleted.
    let more = CLIPS + 26;
    folder.run(&format!("corpus --clips {more} --out @more"));
    let more = format!("corpus={}", folder.path("more").display());
    let grown = || folder.typed_with("build --config @build.toml --sources", &[&more]);
    grown().expect_refused("is not an export of the dataset as it is now");
    fs::rename(folder.path("built/stance"), folder.path("before")).expect("moved");
    grown().expect_code(0);
    grown().expect_code(0);
    folder.run("ingest @before --out @before-back");
    assert_eq!(folder.rows::<MotionRow>("before-back").len(), CLIPS);

    // The export is read again as a release, with its pairs.
    folder.run("ingest @built/stance --out @back");
    let styles = |dataset: &str| {
        let rows = folder.rows::<PairRow>(dataset).into_iter();
        let mut styles: Vec<Option<String>> = rows.map(|row| row.style).collect();
        styles.sort();
        styles
    };
    assert_eq!(styles("back"), styles("built/dataset"));
}

#[test]
fn windows_are_recorded_in_the_range_of_the_dataset_and_trained_on() {
    let folder = Folder::of_masks(48);
    let record = |out: &str, more: &str| {
        folder.run(&format!(
            "triplets @dataset --windows 200 --out @{out} {more}"
        ));
    };
    record("windows", "");
    let recorded = folder.dataset_at("windows");
    assert_eq!(recorded.manifest().rows(WindowRow::TABLE, None), 200);
    let ranges: Vec<NormalizerRow> = folder.rows("windows");
    let [range] = &ranges[..] else {
        panic!("{ranges:?}");
    };
    range.normalizer().expect("sound");
    assert_eq!(range.id.len(), 64);
    let untouched = folder.dataset_at("dataset");
    let tables = &untouched.manifest().tables;
    assert!(!tables.contains_key(NormalizerRow::TABLE));
    folder.run("verify @dataset");
    folder.run("verify @windows");
    folder.put("train.toml", "batch_size = 16\n");
    let train = "train motionrefit @dataset --steps 3 --config @train.toml";
    let said = folder.run(&format!("{train} --out @run --windows @windows"));
    assert!(
        !said.stderr.contains("composed otherwise"),
        "{}",
        said.stderr
    );

    // Windows recorded with another normaliser are refused.
    record("other", "--where 'n_frames > 130'");
    let other = format!("{train} --out @run2 --windows @other");
    folder.refused(&other, "another normaliser");

    // A run records how its windows were composed, and its seed is not theirs.
    folder.put("once.toml", "fixed_pairs = true\nrange = \"scalar\"\n");
    record("once", "--compose @once.toml --seed 4");
    let once = format!("{train} --windows @once --seed 9");
    let said = folder.run(&format!("{once} --out @once-run"));
    said.expect_said("fixed_pairs true instead of false, range \"scalar\" instead of \"per-axis\"");
    let config = &json_of::<Value>(folder.path("once-run/config.json"))["config"];
    assert_eq!(config["train"]["seed"], 9);
    let compose = &config["compose"];
    assert_eq!(compose["seed"], 4);
    assert_eq!(compose["config"]["fixed_pairs"], true);
    let clip = &files_with_extension(&folder.path("corpus"), "bvh")[0];
    let edit = "edit @once-run --text wave --out @edits --motion";
    folder.typed_with(edit, &[arg(clip)]).expect_code(0);
    let edits: Vec<EditRow> = folder.rows("edits");
    assert_has(&edits[0].system, &["composed once"]);
    for other in ["compose", "phrases"] {
        let line = format!("{once} --out @none --{other} @{other}.toml");
        let ran = folder.typed(&line).expect_code(2);
        ran.expect_said(&format!("cannot be used with '--{other} "));
    }

    // Version 0.2 did not record it. The same command then adds it, and the windows stay the same.
    let hash = |name: &str| folder.dataset_at(name).content_hash(&[WindowRow::TABLE]);
    let before = hash("windows");
    let path = folder.path("windows/meta/manifest-1.json");
    let mut manifest: Value = json_of(&path);
    let facts = manifest["facts"].as_object_mut().expect("facts");
    facts.remove("recorded_windows").expect("a fact");
    fs::write(&path, manifest.to_string()).expect("written");
    let again = format!("{train} --out @run --windows @windows");
    folder.refused(&again, "does not state how windows were composed");
    record("windows", "");
    assert_eq!(hash("windows"), before);
    folder.run(&again);
    // Masks and pairs that are shorter than a window are counted wherever they are left out. A window of 60 frames at 10
    // per second spans 119 stored ones.
    let motions = motions_of(&folder.path("dataset"));
    let masks: Vec<MaskRow> = folder.rows("dataset");
    let masks = masks.iter().filter(|mask| mask.split == Split::Train);
    let short = masks.filter(|mask| motions[mask.motion_id.as_str()].n_frames < 119);
    let short = short.count();
    assert!(short > 0);
    folder.put("long.toml", "window = 60\n");
    let stats: Value = folder.json("triplets stats @dataset --compose @long.toml");
    assert_eq!(stats["too_short"], short, "{stats}");
    let items = "items @dataset --split train --count 4 --compose @long.toml --out @few";
    let said = format!("{short} masks and pairs of split train");
    let ran = folder.run(&format!("--json {items}"));
    ran.expect_said(&said);
    assert_eq!(ran.json::<Value>()["too_short"], short);
    let windows = "triplets @dataset --windows 4 --compose @long.toml --out @long-windows";
    let said = format!("{short} masks and pairs are shorter");
    let ran = folder.run(&format!("--json {windows}"));
    ran.expect_said(&said);
    assert_eq!(ran.json::<Value>()["too_short"], short);
    folder.put("few.toml", "triplets = 4\n");
    let nearest = "train nearest @dataset --config @few.toml --compose @long.toml --out @nearest";
    assert_eq!(folder.json::<Value>(nearest)["left_out"], short);
    folder.put("train.toml", "batch_size = 16\nwindow = 60\n");
    let done: Value = folder.json(&format!("{train} --out @long"));
    assert_eq!(done["left_out"], short, "{done}");
    folder.put("train.toml", "batch_size = 16\n");

    // Windows are refused if the dataset no longer has all masks that they were recorded from.
    let masks: Vec<MaskRow> = folder.rows("dataset");
    let dataset = folder.path("dataset");
    commit(&dataset, &masks[1..], |row| row.split, "fewer");
    folder.refused(&again, "other motions, masks or pairs");

    let stats: Value = folder.json("triplets stats @dataset --sheet @sheet.svg");
    assert!(number_of(&stats["distinct_pairs"]["semantic"]) > 100.0);
    // Twelve strips inside one picture.
    assert_eq!(folder.text("sheet.svg").matches("<svg ").count(), 13);
}

#[test]
fn the_examples_build_datasets() {
    let folder = Folder::of_clips(24);
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipeline/examples");
    let examples = files_with_extension(&examples, "toml");
    assert_eq!(examples.len(), 2);
    for example in &examples {
        let out = stem_of(example);
        let line = format!("--json build --sources @corpus --out @{out}");
        let built: Value = folder.typed_with(&line, &["--config", arg(example)]).done();
        assert_eq!(built["motions"], 24);
        for made in ["pairs", "recorded"] {
            assert!(number_of(&built[made]) > 0.0, "{out}");
        }
    }
}

#[test]
fn a_split_without_clips_is_said_to_be_empty() {
    let dir = Folder::of_masks(1);
    let own = dir.rows::<MotionRow>("dataset")[0].split;
    for split in ["train", "val", "test"] {
        let line = format!("items @dataset --split {split} --count 4 --out @items");
        let refused = dir.typed(&line).refusal();
        let said = format!("is in split {split}; choose another split");
        let is_empty = split != own.as_str();
        assert_eq!(refused.contains(&said), is_empty, "{refused}");
    }
}
