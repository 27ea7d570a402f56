//! Ingestion through the command: accounting, bad input, repeatability.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Stdio;

use datasets_spec::record::{MotionRow, QuarantineRow};
use datasets_spec::{Dataset, Skeleton};
use eval::metric::foot_score::{FOOT_JOINTS, foot_score};
use eval::protocol::Floor;
use serde::Deserialize;
use serde_json::Value;

use crate::util::{
    Ran, arg, assert_quarantined, command, corpus, dataset_of, everything, files_with_extension,
    motions_of, put, real_data, rows_of, stance, text_of, typed, typed_with,
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

fn ingest(source: &Path, out: &Path, more: &[&str], code: i32) -> Ingested {
    let ran = typed_with("--json ingest {} --out {}", &[&source, &out], more);
    ran.expect_code(code).json()
}

#[test]
fn the_corpus_is_ingested_whole_and_the_same_on_any_number_of_threads() {
    let dir = corpus(24);
    let source = dir.path().join("corpus");
    let mut hashes = Vec::new();
    for threads in ["1", "2", "7"] {
        let out = dir.path().join(format!("dataset{threads}"));
        let done = ingest(&source, &out, &["--threads", threads], 0);
        assert_eq!((done.ingested, done.quarantined), (24, 0));
        assert!(done.balances() && !done.already_complete, "{done:?}");
        assert!(done.refused_pairs.is_empty() && done.remarks.is_empty());
        assert!(done.refused_splits.is_empty() && done.label_problems.is_empty());
        assert_eq!(done.licenses["CC0-1.0"], 24);
        hashes.push(done.root_hash);
    }
    assert_eq!(hashes[0], hashes[1]);
    assert_eq!(hashes[0], hashes[2]);
    let seeded = ingest(&source, &dir.path().join("seeded"), &["--seed", "5"], 0);
    assert_ne!(seeded.root_hash, hashes[0], "the seed decides the splits");
    // `inspect` counts what was written, and no verb reads a shard that was altered.
    let out = dir.path().join("dataset1");
    let inspected: Value = stance(&["--json", "inspect", arg(&out)]).done();
    assert_eq!(inspected["root_hash"], hashes[0]);
    let version = datasets_spec::table::SCHEMA_VERSION;
    assert_eq!(inspected["schema_version"], version);
    assert_eq!(inspected["tables"]["motions"], 24);
    let shard = &files_with_extension(&out, "parquet")[0];
    let mut bytes = fs::read(shard).expect("a shard");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    put(shard, bytes);
    stance(&["masks", arg(&out)]).expect_refused("does not match its manifest");
}

#[test]
fn bad_files_are_quarantined_with_a_reason_and_the_rest_goes_on() {
    let dir = corpus(8);
    let source = dir.path().join("corpus");
    let npz = fs::read(&files_with_extension(&source, "npz")[0]).expect("an archive");
    put(source.join("truncated.npz"), &npz[..npz.len() / 2]);
    let bvh = text_of(&files_with_extension(&source, "bvh")[0]);
    let row = bvh.trim_end().lines().last().expect("a row");
    let longer = format!("{}\n{row}\n", bvh.trim_end());
    put(source.join("extra_row.bvh"), longer);
    put(source.join("notes.md"), "not a motion");

    let out = dir.path().join("dataset");
    let done = ingest(&source, &out, &[], 3);
    assert_eq!((done.ingested, done.quarantined), (8, 2), "{done:?}");
    assert!(done.balances() && done.resumed_shards == 0, "{done:?}");
    assert_eq!((done.files, done.dropped_pairs), (8 + 8 + 3, 0));
    let expected = [
        ("extra_row.bvh", "E-BVH-FRAMES"),
        ("truncated.npz", "E-NPZ-TRUNCATED"),
    ];
    let rows = assert_quarantined(&out, &expected);
    assert!(rows["extra_row.bvh"].byte_offset.is_some());
    for row in rows.values() {
        assert!(row.source_hash.len() == 64 && !row.reason.is_empty());
    }

    let allowed = dir.path().join("allowed");
    ingest(&source, &allowed, &["--allow-quarantine", "2"], 0);
    let strict = dir.path().join("strict");
    ingest(&source, &strict, &["--allow-quarantine", "1%"], 3);
}

#[test]
fn a_folder_that_holds_a_project_is_refused_and_stays_as_it_is() {
    let (dir, dataset) = dataset_of(4, &[]);
    let [source, project, plan] = ["corpus", "project", "plan"].map(|name| dir.path().join(name));
    put(project.join("README.md"), "# my project");
    put(project.join("data/metadata/clips.parquet"), "of a user");
    let before = everything(&project);
    for (line, from, more) in [
        ("ingest {} --out {}", &source, &["--dry-run"][..]),
        ("ingest {} --out {}", &source, &[]),
        (
            "stage plan ingest {} --into {}",
            &source,
            &["--out", arg(&plan)],
        ),
        (
            "dataset select {} --out {}",
            &dataset,
            &["--where", "id like '%'"],
        ),
        ("dataset merge {} --out {}", &dataset, &[arg(&dataset)]),
    ] {
        let ran = typed_with(&format!("--json {line}"), &[from, &project], more);
        let refused: Value = ran.expect_code(1).json();
        assert_eq!(refused["code"], "E-OCCUPIED", "{line}: {refused}");
        assert_eq!(everything(&project), before, "{line}");
    }
    // Other files are not in the way of a dataset, and stay.
    fs::rename(project.join("README.md"), project.join("notes.md")).expect("renamed");
    fs::rename(project.join("data"), project.join("tables")).expect("renamed");
    ingest(&source, &project, &[], 0);
    assert_eq!(text_of(project.join("notes.md")), "# my project");
}

/// A write that fails half-way, as on a full disk: the process may write no file larger than 64 KB.
#[cfg(target_os = "linux")]
#[test]
fn a_write_that_fails_leaves_no_dataset_and_the_next_run_completes_it() {
    let dir = corpus(12);
    let source = dir.path().join("corpus");
    let clean = ingest(&source, &dir.path().join("clean"), &[], 0);

    let out = dir.path().join("dataset");
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

    let done = ingest(&source, &out, &[], 0);
    assert_eq!(done.root_hash, clean.root_hash);
    let leftovers = files_with_extension(&out, "tmp");
    assert!(leftovers.is_empty(), "{leftovers:?}");
}

#[test]
fn a_killed_run_continues_to_the_same_dataset() {
    let dir = corpus(48);
    let source = dir.path().join("corpus");
    let clean = ingest(&source, &dir.path().join("clean"), &[], 0);
    let out = dir.path().join("dataset");
    let staged = out.join("meta/staged");
    let mut run = command(&["--threads", "1", "ingest", arg(&source), "--out", arg(&out)])
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .expect("stance starts");
    // Wherever the kill comes, before, during or after the write of a shard, the next run must give the same result.
    while !staged.exists() && run.try_wait().expect("a child").is_none() {
        std::thread::yield_now();
    }
    run.kill().expect("a child");
    run.wait().expect("a child");
    let done = ingest(&source, &out, &[], 0);
    assert_eq!(done.root_hash, clean.root_hash);
}

#[test]
fn the_ingested_corpus_keeps_its_feet_on_the_ground() {
    let dir = corpus(corpus::CLIPS_PER_TAKE);
    let out = dir.path().join("dataset");
    ingest(&dir.path().join("corpus"), &out, &[], 0);
    let skeleton = Skeleton::smplx_neutral();
    let mut actions: BTreeMap<Option<String>, Vec<f64>> = BTreeMap::new();
    for row in rows_of::<MotionRow>(&out) {
        let keypoints = skeleton.motion_keypoints(&row.motion().expect("valid"));
        let frames = keypoints.points.iter();
        let feet: Vec<_> = frames
            .map(|frame| FOOT_JOINTS.map(|joint| frame[joint.index()]))
            .collect();
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
    let dir = tempfile::tempdir().expect("a temporary folder");
    let out = dir.path().join("dataset");
    let [bvh, amass] = ["bvh", "amass_layout"].map(|name| data.join(name));
    let ran = typed("--json ingest {} {} --out {}", &[&bvh, &amass, &out]);
    assert!([0, 3].contains(&ran.code), "{}", ran.stderr);
    let done: Ingested = ran.json();
    assert!(done.balances(), "{done:?}");
    let motions =
        files_with_extension(&bvh, "bvh").len() + files_with_extension(&amass, "npz").len();
    assert_eq!(done.ingested + done.quarantined, motions as u64, "{done:?}");
    // Every Bandai-Namco take is a motion of a person, so none is quarantined.
    let rows: Vec<QuarantineRow> = rows_of(&out);
    let of_take = |row: &&QuarantineRow| row.path.contains("bandai_namco");
    assert_eq!(rows.iter().find(of_take), None);
}

#[test]
fn work_goes_on_where_nobody_reads_its_messages() {
    let dir = corpus(4);
    let (source, out) = (dir.path().join("corpus"), dir.path().join("dataset"));
    let mut ingest = command(&["ingest", arg(&source), "--out", arg(&out)]);
    let mut child = ingest.stdout(Stdio::null()).stderr(Stdio::piped()).spawn();
    let child = child.as_mut().expect("stance starts");
    // As `2>&1 | head -0` does.
    drop(child.stderr.take());
    assert!(child.wait().expect("an end").success());
    assert_eq!(motions_of(&out).len(), 4);
}
