//! Ingestion through the command: accounting, bad input, repeatability.

use std::collections::BTreeMap;
use std::fs;
use std::process::Stdio;

use datasets_spec::record::{MotionRow, QuarantineRow};
use datasets_spec::{Dataset, Skeleton};
use eval::metric::foot_score::{feet, foot_score};
use eval::protocol::Floor;
use serde::Deserialize;
use serde_json::Value;

use crate::util::{
    Folder, Ran, arg, assert_quarantined, damage, everything, files_with_extension, kill_once,
    motions_of, real_data, text_of,
};

/// The document of `ingest --json`, with the fields that scripts rely on.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Ingested {
    #[expect(dead_code, reason = "part of the contract")]
    dataset: String,
    files: u64,
    sources: u64,
    ingested: u64,
    quarantined: u64,
    skipped: u64,
    codes: BTreeMap<String, u64>,
    skipped_reasons: BTreeMap<String, u64>,
    already_complete: bool,
    resumed_shards: usize,
    tables: BTreeMap<String, u64>,
    dropped_pairs: u64,
    refused_pairs: Vec<Value>,
    refused_splits: Vec<Value>,
    label_problems: Vec<Value>,
    licenses: BTreeMap<String, u64>,
    remarks: Vec<String>,
    #[expect(dead_code, reason = "part of the contract")]
    alike: Vec<Value>,
    #[expect(dead_code, reason = "part of the contract")]
    growth: Option<Value>,
    root_hash: String,
}

impl Ingested {
    fn balances(&self) -> bool {
        self.sources == self.ingested + self.quarantined + self.skipped
            && self.sources >= self.files
            && self.tables["quarantine"] == self.quarantined
            && self.quarantined == self.codes.values().sum::<u64>()
            && self.skipped == self.skipped_reasons.values().sum::<u64>()
    }
}

/// Ingests the folder `corpus`.
fn ingest(dir: &Folder, out: &str, more: &str, code: i32) -> Ingested {
    let ran = dir.typed(&format!("--json ingest @corpus --out @{out} {more}"));
    ran.expect_code(code).json()
}

#[test]
fn the_corpus_is_ingested_whole_and_the_same_on_any_number_of_threads() {
    let dir = Folder::of_clips(24);
    let mut hashes = Vec::new();
    for threads in ["1", "2", "7"] {
        let out = format!("dataset{threads}");
        let done = ingest(&dir, &out, &format!("--threads {threads}"), 0);
        assert_eq!((done.ingested, done.quarantined), (24, 0));
        assert!(done.balances() && !done.already_complete, "{done:?}");
        assert!(done.refused_pairs.is_empty() && done.remarks.is_empty());
        assert!(done.refused_splits.is_empty() && done.label_problems.is_empty());
        assert_eq!(done.licenses["CC0-1.0"], 24);
        hashes.push(done.root_hash);
    }
    assert_eq!(hashes[0], hashes[1]);
    assert_eq!(hashes[0], hashes[2]);
    let seeded = ingest(&dir, "seeded", "--seed 5", 0);
    assert_ne!(seeded.root_hash, hashes[0], "the seed decides the splits");
    // `inspect` counts what was written, and no verb reads a shard that was altered.
    let inspected: Value = dir.json("inspect @dataset1");
    assert_eq!(inspected["root_hash"], hashes[0]);
    let version = datasets_spec::table::SCHEMA_VERSION;
    assert_eq!(inspected["schema_version"], version);
    assert_eq!(inspected["tables"]["motions"], 24);
    damage(&files_with_extension(&dir.path("dataset1"), "parquet")[0]);
    dir.refused("masks @dataset1", "does not match its manifest");
}

#[test]
fn bad_files_are_quarantined_with_a_reason_and_the_rest_goes_on() {
    let dir = Folder::of_clips(8);
    let source = dir.path("corpus");
    let npz = fs::read(&files_with_extension(&source, "npz")[0]).expect("an archive");
    dir.put("corpus/truncated.npz", &npz[..npz.len() / 2]);
    let bvh = text_of(&files_with_extension(&source, "bvh")[0]);
    let row = bvh.trim_end().lines().last().expect("a row");
    let longer = format!("{}\n{row}\n", bvh.trim_end());
    dir.put("corpus/extra_row.bvh", longer);
    dir.put("corpus/notes.md", "not a motion");

    let done = ingest(&dir, "dataset", "", 3);
    assert_eq!((done.ingested, done.quarantined), (8, 2), "{done:?}");
    assert!(done.balances() && done.resumed_shards == 0, "{done:?}");
    assert_eq!((done.files, done.dropped_pairs), (8 + 8 + 3, 0));
    let expected = [
        ("extra_row.bvh", "E-BVH-FRAMES"),
        ("truncated.npz", "E-NPZ-TRUNCATED"),
    ];
    let rows = assert_quarantined(&dir.path("dataset"), &expected);
    assert!(rows["extra_row.bvh"].byte_offset.is_some());
    for row in rows.values() {
        assert!(row.source_hash.len() == 64 && !row.reason.is_empty());
    }

    ingest(&dir, "allowed", "--allow-quarantine 2", 0);
    ingest(&dir, "strict", "--allow-quarantine 1%", 3);
}

#[test]
fn a_folder_that_holds_a_project_is_refused_and_stays_as_it_is() {
    let dir = Folder::of_dataset(4);
    let project = dir.path("project");
    dir.put("project/README.md", "# my project");
    dir.put("project/data/metadata/clips.parquet", "of a user");
    let before = everything(&project);
    for line in [
        "ingest @corpus --out @project --dry-run",
        "ingest @corpus --out @project",
        "stage plan ingest @corpus --into @project --out @plan",
        "dataset select @dataset --out @project --where \"id like '%'\"",
        "dataset merge @dataset @dataset --out @project",
    ] {
        let ran = dir.typed(&format!("--json {line}"));
        let refused: Value = ran.expect_code(1).json();
        assert_eq!(refused["code"], "E-OCCUPIED", "{line}: {refused}");
        assert_eq!(everything(&project), before, "{line}");
    }
    // Other files are not in the way of a dataset, and stay.
    fs::rename(project.join("README.md"), project.join("notes.md")).expect("renamed");
    fs::rename(project.join("data"), project.join("tables")).expect("renamed");
    ingest(&dir, "project", "", 0);
    assert_eq!(dir.text("project/notes.md"), "# my project");
}

/// A write that fails half-way, as on a full disk: the process may write no file larger than 64 KB.
#[cfg(target_os = "linux")]
#[test]
fn a_write_that_fails_leaves_no_dataset_and_the_next_run_completes_it() {
    let dir = Folder::of_clips(12);
    let clean = ingest(&dir, "clean", "", 0);

    let (source, out) = (dir.path("corpus"), dir.path("dataset"));
    let binary = env!("CARGO_BIN_EXE_stance");
    // The ignored signal is inherited, so the write fails with an error instead of a kill.
    let script = r#"trap '' XFSZ; ulimit -f 64; exec "$0" ingest "$1" --out "$2""#;
    let ran: Ran = std::process::Command::new("bash")
        .args(["-c", script, binary, arg(&source), arg(&out)])
        .output()
        .expect("bash starts")
        .into();
    ran.expect_refused("cannot write");
    assert!(Dataset::open(&out).is_err(), "nothing was committed");

    let done = ingest(&dir, "dataset", "", 0);
    assert_eq!(done.root_hash, clean.root_hash);
    let leftovers = files_with_extension(&out, "tmp");
    assert!(leftovers.is_empty(), "{leftovers:?}");
}

#[test]
fn a_killed_run_continues_to_the_same_dataset() {
    let dir = Folder::of_clips(48);
    let clean = ingest(&dir, "clean", "", 0);
    let run = dir.started("--threads 1 ingest @corpus --out @dataset", &[]);
    kill_once(run, || dir.path("dataset/meta/staged").exists());
    let done = ingest(&dir, "dataset", "", 0);
    assert_eq!(done.root_hash, clean.root_hash);
}

#[test]
fn the_ingested_corpus_keeps_its_feet_on_the_ground() {
    let dir = Folder::of_clips(corpus::CLIPS_PER_TAKE);
    ingest(&dir, "dataset", "", 0);
    let skeleton = Skeleton::smplx_neutral();
    let mut actions: BTreeMap<Option<String>, Vec<f64>> = BTreeMap::new();
    for row in dir.rows::<MotionRow>("dataset") {
        let keypoints = skeleton.motion_keypoints(&row.motion().expect("valid"));
        let feet = feet(&keypoints.points);
        let score = foot_score(&feet, keypoints.fps, Floor::Lowest).expect("long enough");
        actions.entry(row.action).or_default().push(score);
    }
    assert!(actions.len() >= 12, "{} activities", actions.len());
    let all: Vec<f64> = actions.values().flatten().copied().collect();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    assert!(mean >= 0.9, "foot score {mean}: {actions:?}");
}

#[test]
fn real_motion_is_ingested_or_quarantined_with_a_reason() {
    let Some(data) = real_data("real_motion_is_ingested_or_quarantined_with_a_reason") else {
        return;
    };
    let dir = Folder::empty();
    let [bvh, amass] = ["bvh", "amass_layout"].map(|name| data.join(name));
    let ran = dir.typed_with("--json ingest --out @dataset", &[arg(&bvh), arg(&amass)]);
    assert!([0, 3].contains(&ran.code), "{}", ran.stderr);
    let done: Ingested = ran.json();
    assert!(done.balances(), "{done:?}");
    let motions =
        files_with_extension(&bvh, "bvh").len() + files_with_extension(&amass, "npz").len();
    assert_eq!(done.ingested + done.quarantined, motions as u64, "{done:?}");
    // Every Bandai-Namco take is a motion of a person, so none is quarantined.
    let rows: Vec<QuarantineRow> = dir.rows("dataset");
    let of_take = |row: &&QuarantineRow| row.path.contains("bandai_namco");
    assert_eq!(rows.iter().find(of_take), None);
}

#[test]
fn work_goes_on_where_nobody_reads_its_messages() {
    let dir = Folder::of_clips(4);
    let mut ingest = dir.command("ingest @corpus --out @dataset");
    let mut child = ingest.stdout(Stdio::null()).stderr(Stdio::piped()).spawn();
    let child = child.as_mut().expect("stance starts");
    // As `2>&1 | head -0` does.
    drop(child.stderr.take());
    assert!(child.wait().expect("an end").success());
    assert_eq!(motions_of(&dir.path("dataset")).len(), 4);
}
