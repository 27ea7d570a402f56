//! Jobs in pieces through the command: many processes give the same result as one.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use datasets_spec::Dataset;
use datasets_spec::dataset::Transaction;
use datasets_spec::record::QuarantineRow;
use datasets_spec::table::read_rows;
use serde::Deserialize;
use work::{Outcome, Piece, Record};

use crate::archives::files_below;
use crate::train::Workshop;
use crate::util::{
    Ran, arg, command, corpus, files_with_extension, json_of, put, real_data, root_hash_of,
    rows_of, stance, text_of, typed, typed_with,
};
use crate::variants::{ANY as ANY_PAIR, SMALL as SMALL_GENERATOR};

/// Number of clips for which the training split has two shards.
const CLIPS: usize = 340;

/// The document of `stage commit --json`, as a script relies on it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Committed {
    #[expect(dead_code, reason = "part of the contract")]
    destination: PathBuf,
    already_committed: bool,
    pieces: u64,
    failed: u64,
    tables: BTreeMap<String, u64>,
    accounting: Option<Counts>,
    root_hash: String,
    /// Notes of the job on the result.
    #[serde(default)]
    #[expect(dead_code, reason = "part of the contract")]
    notes: serde_json::Value,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Counts {
    sources: u64,
    ingested: u64,
    quarantined: u64,
    skipped: u64,
    codes: BTreeMap<String, u64>,
}

/// The document of `stage plan --json`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Planned {
    #[expect(dead_code, reason = "part of the contract")]
    job: String,
    #[expect(dead_code, reason = "part of the contract")]
    plan: Option<PathBuf>,
    #[expect(dead_code, reason = "part of the contract")]
    destination: PathBuf,
    #[expect(dead_code, reason = "part of the contract")]
    plan_hash: String,
    pieces: u64,
    items: u64,
    bytes: u64,
    sample: Option<Sample>,
    estimated_hours: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sample {
    items: u64,
    #[expect(dead_code, reason = "part of the contract")]
    secs: f64,
}

/// The document of `stage status --json`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Status {
    committed: bool,
    pieces: u64,
    done: u64,
    missing: Vec<String>,
    failed: Vec<Record>,
    #[expect(dead_code, reason = "part of the contract")]
    secs: f64,
}

fn root_hash(verb: &[&str], out: &Path) -> String {
    let mut args = vec!["--json"];
    args.extend(verb);
    args.extend(["--out", arg(out)]);
    let done: serde_json::Value = stance(&args).done();
    done["root_hash"].as_str().expect("a hash").to_owned()
}

/// Plans a job into `into`, with the plan in `plan`.
fn planned(job: &[&str], into: &Path, plan: &Path) -> Planned {
    let mut args = vec!["--json", "stage", "plan"];
    args.extend(job);
    args.extend(["--into", arg(into), "--out", arg(plan)]);
    stance(&args).done()
}

fn records(ran: &Ran) -> Vec<Record> {
    let lines = ran.stdout.lines();
    lines
        .map(|line| serde_json::from_str(line).expect("a record on each line"))
        .collect()
}

fn work(plan: &Path, more: &[&str], code: i32) -> Vec<Record> {
    records(&typed_with("--json stage work {}", &[&plan], more).expect_code(code))
}

fn commit(plan: &Path, more: &[&str], code: i32) -> Committed {
    let mut args = vec!["--json", "stage", "commit", arg(plan)];
    args.extend(more);
    stance(&args).expect_code(code).json()
}

fn status(plan: &Path) -> Status {
    typed("--json stage status {}", &[&plan]).done()
}

fn pieces(plan: &Path) -> Vec<Piece> {
    read_rows(&plan.join("pieces.parquet")).expect("a table of pieces")
}

fn count(records: &[Record], outcome: Outcome) -> usize {
    let records = records.iter();
    records.filter(|record| record.outcome == outcome).count()
}

fn started(args: &[&str]) -> Child {
    command(args)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("stance starts")
}

/// Makes the pieces of a plan with four processes at once.
fn by_four(plan: &Path) {
    let shares = ["0/4", "1/4", "2/4", "3/4"];
    let workers = shares.map(|share| started(&["stage", "work", arg(plan), "--shard", share]));
    for mut worker in workers {
        assert!(worker.wait().expect("a child").success());
    }
}

/// Makes the pieces of a job in every way that a scheduler may, and returns the hash of the result: by four
/// processes of which one is killed, again in another order, and after a file was lost.
fn root_hash_in_pieces(job: &[&str], into: &Path, plan: &Path) -> String {
    let made = planned(job, into, plan);
    let ids: Vec<String> = pieces(plan).into_iter().map(|piece| piece.id).collect();
    assert_eq!(made.pieces, ids.len() as u64);
    // Whether the kill comes before, in or after a piece, the result must be the same.
    let mut killed = started(&["--threads", "1", "stage", "work", arg(plan)]);
    while files_in(into) == 0 && killed.try_wait().expect("a child").is_none() {
        std::thread::yield_now();
    }
    killed.kill().expect("a child");
    killed.wait().expect("a child");
    by_four(plan);
    let reversed: Vec<&str> = ids.iter().rev().map(String::as_str).collect();
    let again = work(plan, &["--items", &reversed.join(",")], 0);
    assert_eq!(count(&again, Outcome::DoneBefore), ids.len());
    let order: Vec<&str> = again.iter().map(|record| record.piece.as_str()).collect();
    assert_eq!(order, reversed);

    let lost = again.iter().find(|record| !record.files.is_empty());
    let lost = lost.expect("a piece with a file");
    let shard = lost.files[0].path.trim_end_matches(".parquet");
    let staged = format!("meta/staged/0-{}/{shard}", plan_hash(plan));
    fs::remove_file(into.join(staged)).expect("a staged file");
    assert_eq!(status(plan).missing, std::slice::from_ref(&lost.piece));
    let made = work(plan, &[], 0);
    assert_eq!(count(&made, Outcome::Done), 1, "only what is lost is made");

    let done = commit(plan, &[], 0);
    assert!(!done.already_committed && done.failed == 0, "{done:?}");
    assert_eq!(done.pieces, ids.len() as u64);
    let again = commit(plan, &[], 0);
    assert!(again.already_committed && again.root_hash == done.root_hash);
    // A late worker has nothing to do, and leaves no files.
    let late = work(plan, &[], 0);
    assert_eq!(count(&late, Outcome::DoneBefore), ids.len());
    assert!(status(plan).committed);
    assert_eq!(
        fs::read_dir(into.join("meta/staged"))
            .expect("a folder")
            .count(),
        0
    );
    assert!(files_with_extension(into, "tmp").is_empty());
    done.root_hash
}

fn plan_hash(plan: &Path) -> String {
    let plan: serde_json::Value = json_of(plan.join("plan.json"));
    plan["plan_hash"].as_str().expect("a hash").to_owned()
}

fn files_in(folder: &Path) -> usize {
    match folder.exists() {
        true => files_with_extension(folder, "parquet").len(),
        false => 0,
    }
}

/// A corpus with several pieces, and the folder for the results.
struct Place {
    dir: tempfile::TempDir,
}

impl Place {
    fn new(clips: usize) -> Self {
        Self { dir: corpus(clips) }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Plans the ingestion of the corpus.
    fn planned(&self) -> [PathBuf; 2] {
        let [into, plan] = ["dataset", "plan"].map(|name| self.at(name));
        let source = self.at("corpus");
        planned(&["ingest", arg(&source)], &into, &plan);
        [into, plan]
    }
}

#[test]
fn an_ingestion_in_pieces_is_that_of_one_process() {
    let place = Place::new(CLIPS);
    let source = place.at("corpus");
    put(source.join("broken.bvh"), "HIERARCHY\n");
    let clean = place.at("clean");
    let ran = stance(&["--json", "ingest", arg(&source), "--out", arg(&clean)]).expect_code(3);
    let clean: serde_json::Value = ran.json();
    let job = ["ingest", arg(&source)];
    let [into, plan] = ["dataset", "plan"].map(|name| place.at(name));
    let made = planned(&job, &into, &plan);
    assert_eq!((made.pieces, made.items), (4, CLIPS as u64 + 1));
    assert!(made.bytes > 0 && made.sample.is_none());
    assert!(!into.exists(), "a plan touches no dataset");
    by_four(&plan);
    let done = commit(&plan, &[], 3);
    assert_eq!(clean["root_hash"], done.root_hash);
    let counts = done.accounting.expect("an ingestion has sources");
    assert_eq!(counts.codes.values().sum::<u64>(), 1);
    assert_eq!(
        counts.sources,
        counts.ingested + counts.quarantined + counts.skipped
    );
}

#[test]
fn pieces_that_are_killed_repeated_and_lost_give_the_same_dataset() {
    let place = Place::new(CLIPS);
    let source = place.at("corpus");
    let verb = ["ingest", arg(&source)];
    let clean = root_hash(&verb, &place.at("clean"));
    let [into, plan] = ["dataset", "plan"].map(|name| place.at(name));
    assert_eq!(root_hash_in_pieces(&verb, &into, &plan), clean);
}

#[test]
fn a_dataset_that_grows_in_pieces_is_that_of_one_process() {
    let place = Place::new(40);
    let source = place.at("corpus");
    let (first, second) = (place.at("one"), place.at("two"));
    for out in [&first, &second] {
        stance(&["ingest", arg(&source), "--out", arg(out)]).expect_code(0);
    }
    // One clip changes, one is removed and one is new, so that shards are written again.
    let files = files_with_extension(&source, "bvh");
    let text = text_of(&files[0]);
    put(&files[1], &text);
    fs::remove_file(&files[2]).expect("removed");
    put(source.join("new.bvh"), &text);
    let verb = ["ingest", arg(&source), "--prune", "--drop-labels"];
    let clean = root_hash(&verb, &first);
    let plan = place.at("plan");
    planned(&verb, &second, &plan);
    by_four(&plan);
    assert_eq!(commit(&plan, &[], 0).root_hash, clean);
}

#[test]
fn the_real_data_in_pieces_is_that_of_one_process() {
    let Some(source) = real_data("the_real_data_in_pieces_is_that_of_one_process") else {
        return;
    };
    let dir = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| dir.path().join(name);
    let clean = stance(&["--json", "ingest", arg(&source), "--out", arg(&at("clean"))]);
    let code = clean.code;
    assert!(code == 0 || code == 3, "{}", clean.stderr);
    let clean: serde_json::Value = clean.json();
    planned(&["ingest", arg(&source)], &at("dataset"), &at("plan"));
    by_four(&at("plan"));
    let done = commit(&at("plan"), &[], code);
    assert_eq!(clean["root_hash"], done.root_hash);
    let counts = done.accounting.expect("counts");
    for (name, count) in [
        ("ingested", counts.ingested),
        ("quarantined", counts.quarantined),
    ] {
        assert_eq!(clean[name], count, "{name}");
    }
}

#[test]
fn a_commit_of_an_incomplete_plan_is_refused_with_the_command_that_completes_it() {
    let place = Place::new(12);
    let [into, plan] = place.planned();
    let first = &pieces(&plan)[0];
    work(&plan, &["--items", &first.id], 0);
    let ran = stance(&["stage", "commit", arg(&plan)]).expect_code(1);
    let missing = format!(
        "{} of {} pieces are missing",
        pieces(&plan).len() - 1,
        pieces(&plan).len()
    );
    ran.expect_said(&missing);
    let command = format!("stance stage work {}", plan.display());
    ran.expect_said(&command);
    assert!(Dataset::open(&into).is_err(), "nothing is committed");
    let found = status(&plan);
    assert_eq!((found.done, found.pieces), (1, pieces(&plan).len() as u64));
    assert!(found.failed.is_empty() && !found.committed);
    assert_eq!(found.missing.len() as u64, found.pieces - 1);
}

#[test]
fn one_of_two_commits_wins_and_the_other_is_told() {
    let place = Place::new(12);
    let [into, plan] = place.planned();
    work(&plan, &[], 0);
    let lock = Transaction::begin(&into, "the other run").expect("locks");
    let ran = stance(&["stage", "commit", arg(&plan)]).expect_code(75);
    ran.expect_said("the other run");
    drop(lock);
    let both = [0, 1].map(|_| started(&["stage", "commit", arg(&plan)]));
    let mut codes = both.map(|mut child| child.wait().expect("a child").code());
    codes.sort_unstable();
    // The second commit is locked out, or finds the dataset already committed.
    assert!(
        codes == [Some(0), Some(75)] || codes == [Some(0), Some(0)],
        "{codes:?}"
    );
    assert_eq!(Dataset::open(&into).expect("opens").manifest().version, 1);
}

#[test]
fn a_plan_is_refused_once_its_destination_has_another_version() {
    let place = Place::new(12);
    let [into, plan] = place.planned();
    let ids = pieces(&plan);
    work(&plan, &["--items", &ids[0].id], 0);
    let source = place.at("corpus");
    stance(&["ingest", arg(&source), "--out", arg(&into), "--fps", "30"]).expect_code(0);
    let before = root_hash_of(&into);
    for record in work(&plan, &[], 3) {
        assert_eq!(record.code.as_deref(), Some("E-PLAN-STALE"));
    }
    stance(&["stage", "commit", arg(&plan)]).expect_refused("plan again");
    assert_eq!(root_hash_of(&into), before);
}

#[test]
fn a_piece_whose_source_changed_fails_alone_and_can_be_quarantined() {
    let place = Place::new(CLIPS);
    let [into, plan] = place.planned();
    let source = place.at("corpus");
    let bvh = &files_with_extension(&source, "bvh")[0];
    let planned_bytes = fs::read(bvh).expect("a file");
    // The size is the same, so that only the hash differs.
    let mut changed = planned_bytes.clone();
    let digit = changed
        .iter()
        .rposition(u8::is_ascii_digit)
        .expect("a digit");
    changed[digit] = if changed[digit] == b'1' { b'2' } else { b'1' };
    // An unreadable file may be unchanged: its piece fails and can be made again.
    fs::remove_file(bvh).expect("removed");
    std::os::unix::fs::symlink(bvh, bvh).expect("a link to itself");
    let reasons = work(&plan, &[], 3)
        .into_iter()
        .filter_map(|made| made.reason);
    let reasons: Vec<String> = reasons.collect();
    assert!(
        reasons.len() == 1 && reasons[0].contains("make the piece again"),
        "{reasons:?}"
    );
    fs::remove_file(bvh).expect("removed");
    put(bvh, &changed);
    let made = work(&plan, &[], 3);
    let failed: Vec<&Record> = made.iter().filter(|record| !record.is_done()).collect();
    let [failed] = failed[..] else {
        panic!("one piece reads the file: {made:?}");
    };
    assert_eq!(failed.code.as_deref(), Some("E-SOURCE-CHANGED"));
    let reason = failed.reason.as_deref().expect("a reason");
    assert!(
        reason.contains("plan again") && reason.contains(arg(bvh)),
        "{reason}"
    );
    assert_eq!(status(&plan).failed.len(), 1);
    stance(&["stage", "commit", arg(&plan)]).expect_refused("--quarantine-failed");

    let items = pieces(&plan)
        .into_iter()
        .find(|piece| piece.id == failed.piece)
        .expect("a piece of the plan")
        .items;
    let done = commit(&plan, &["--quarantine-failed"], 3);
    let counts = done.accounting.expect("counts");
    assert_eq!((done.failed, counts.quarantined), (1, items));
    assert_eq!(counts.codes["E-SOURCE-CHANGED"], items);
    assert_eq!(
        counts.sources,
        counts.ingested + counts.quarantined + counts.skipped
    );
    assert_eq!(done.tables["motions"], counts.ingested);
    let rows: Vec<QuarantineRow> = rows_of(&into);
    assert!(rows.iter().all(|row| row.reason == reason));

    // Most files of the piece did not cause the failure: the next run reads them.
    let again = stance(&["--json", "ingest", arg(&source), "--out", arg(&into)]).expect_code(0);
    let again: serde_json::Value = again.json();
    assert_eq!(again["ingested"], CLIPS);
}

#[test]
fn a_label_file_that_is_added_after_planning_fails_the_pieces_that_it_speaks_of() {
    let place = Place::new(CLIPS);
    let source = place.at("corpus");
    let walk = &files_with_extension(&source, "bvh")[0];
    let sidecar = walk.with_extension("stance.json");
    let said = fs::read(&sidecar).expect("a sidecar");
    fs::remove_file(&sidecar).expect("removed");
    let clean = root_hash(&["ingest", arg(&source)], &place.at("clean"));
    let [_, plan] = place.planned();
    let all = pieces(&plan).len();
    let folder = walk.parent().expect("a folder");
    // Label files of the motion, of its folder, and of a folder above.
    for (added, bytes, num_failed) in [
        (sidecar.clone(), said, 1..=1),
        (walk.with_extension("txt"), b"a walk\n".to_vec(), 1..=1),
        (
            folder.join("captions.csv"),
            b"name,text\n".to_vec(),
            1..=all,
        ),
        (
            source.join("stance.toml"),
            b"style = \"calm\"\n".to_vec(),
            all..=all,
        ),
    ] {
        put(&added, bytes);
        let made = work(&plan, &[], 3);
        let failed: Vec<&Record> = made.iter().filter(|record| !record.is_done()).collect();
        assert!(num_failed.contains(&failed.len()), "{made:?}");
        for record in failed {
            assert_eq!(record.code.as_deref(), Some("E-SOURCE-CHANGED"));
            let reason = record.reason.as_deref().expect("a reason");
            assert!(
                reason.contains("plan again") && reason.contains(arg(&added)),
                "{reason}"
            );
        }
        fs::remove_file(&added).expect("removed");
        let staged = place.at("dataset").join("meta/staged");
        fs::remove_dir_all(staged).expect("removed");
    }
    // A file that labels no motion does not stop the run.
    put(source.join("job-17.out"), "made\n");
    by_four(&plan);
    assert_eq!(commit(&plan, &[], 0).root_hash, clean);
}

#[test]
fn a_dry_run_counts_a_file_of_many_pieces_once() {
    let place = Place::new(CLIPS);
    let [source, into, plan] = ["corpus", "dataset", "plan"].map(|name| place.at(name));
    put(source.join("stance.toml"), "license = \"CC0-1.0\"\n");
    let made = planned(&["ingest", arg(&source)], &into, &plan);
    assert!(made.pieces > 1);
    let sizes = files_below(&source)
        .into_values()
        .map(|bytes| bytes.len() as u64);
    assert_eq!(made.bytes, sizes.sum::<u64>());
}

#[test]
fn a_dry_run_counts_and_writes_nothing() {
    let place = Place::new(12);
    let [source, into] = ["corpus", "dataset"].map(|name| place.at(name));
    let planned: Planned = typed(
        "--json stage plan ingest {} --into {} --dry-run",
        &[&source, &into],
    )
    .done();
    assert_eq!(planned.items, 12);
    assert!(planned.pieces > 0 && planned.bytes > 0);
    let sample = planned.sample.expect("a sample");
    assert!(sample.items > 0 && planned.estimated_hours.is_some_and(|hours| hours > 0.0));
    let names: Vec<_> = fs::read_dir(place.dir.path())
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name())
        .collect();
    assert_eq!(names, ["corpus"]);
}

/// Kills the process that makes a piece, as the system does when memory runs out.
#[cfg(target_os = "linux")]
#[test]
fn a_piece_whose_process_is_killed_fails_alone() {
    let place = Place::new(CLIPS);
    let [into, plan] = place.planned();
    let largest = pieces(&plan).into_iter().max_by_key(|piece| piece.items);
    let largest = largest.expect("a piece");
    let worker = command(&["--json", "stage", "work", arg(&plan), "--isolate"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("stance starts");
    let children = format!("/proc/{0}/task/{0}/children", worker.id());
    let is_of_piece = |child: &str| {
        let line = fs::read(format!("/proc/{child}/cmdline")).unwrap_or_default();
        line.split(|byte| *byte == 0)
            .any(|word| word == largest.id.as_bytes())
    };
    let child = loop {
        let children = text_of(&children);
        let mut children = children.split_whitespace();
        if let Some(child) = children.find(|child| is_of_piece(child)) {
            break child.to_owned();
        }
        std::thread::yield_now();
    };
    let killed = std::process::Command::new("kill")
        .args(["-9", &child])
        .status();
    assert!(killed.expect("kill starts").success());
    let ran = Ran::from(worker.wait_with_output().expect("a child")).expect_code(3);
    let made = records(&ran);
    assert_eq!(made.len(), pieces(&plan).len());
    for record in &made {
        assert_eq!(record.is_done(), record.piece != largest.id, "{record:?}");
    }
    let done = commit(&plan, &["--quarantine-failed"], 3);
    let counts = done.accounting.expect("counts");
    assert_eq!(
        counts.codes,
        BTreeMap::from([("E-CRASH".to_owned(), largest.items)])
    );
    assert_eq!(done.tables["motions"], CLIPS as u64 - largest.items);
    let rows: Vec<QuarantineRow> = rows_of(&into);
    assert!(rows.iter().all(|row| row.reason.contains("signal 9")));
}

#[cfg(target_os = "linux")]
#[test]
fn a_piece_that_needs_more_memory_than_allowed_fails_and_can_be_made_with_more() {
    let place = Place::new(12);
    let [_, plan] = place.planned();
    let id = pieces(&plan).remove(0).id;
    let made = work(&plan, &["--items", &id, "--isolate", "--memory", "64MB"], 3);
    assert_eq!(made[0].code.as_deref(), Some("E-CRASH"), "{made:?}");
    let made = work(&plan, &["--items", &id, "--isolate", "--memory", "16GB"], 0);
    assert_eq!(made[0].outcome, Outcome::Done);
    assert!(status(&plan).failed.is_empty());
}

#[cfg(target_os = "linux")]
#[test]
fn windows_and_triplets_in_pieces_are_those_of_one_process() {
    let workshop = Workshop::open();
    let dataset = workshop.dataset();
    // The windows have three shards, the triplets one.
    for (name, count) in [
        ("windows", ["--windows", "9000"]),
        ("triplets", ["--count", "12"]),
    ] {
        let job = [&["triplets", arg(&dataset)][..], &count].concat();
        let [clean, into, plan] =
            ["clean", "into", "plan"].map(|folder| workshop.path(&format!("{name}-{folder}")));
        let clean_hash = root_hash(&job, &clean);
        assert_eq!(
            root_hash_in_pieces(&job, &into, &plan),
            clean_hash,
            "{name}"
        );
        stance(&["verify", arg(&into)]).expect_code(0);
    }
    assert_eq!(pieces(&workshop.path("windows-plan")).len(), 3);

    // For this job, a piece that fails is itself quarantined.
    let [into, plan] = ["failing", "failing-plan"].map(|name| workshop.path(name));
    planned(
        &["triplets", arg(&dataset), "--windows", "5000"],
        &into,
        &plan,
    );
    let [first, second] = [0, 1].map(|number: usize| pieces(&plan)[number].id.clone());
    work(&plan, &["--items", &first], 0);
    work(
        &plan,
        &["--items", &second, "--isolate", "--memory", "64MB"],
        3,
    );
    let done = commit(&plan, &["--quarantine-failed"], 3);
    assert_eq!((done.failed, done.tables["windows"]), (1, 4096));
    let rows: Vec<QuarantineRow> = rows_of(&into);
    let found: Vec<(&str, &str)> = rows
        .iter()
        .map(|row| (row.path.as_str(), row.code.as_str()))
        .collect();
    assert_eq!(found, [("windows/train-00001-of-00002", "E-CRASH")]);

    // A changed dataset would give other windows.
    let [into, plan] = ["late", "late-plan"].map(|name| workshop.path(name));
    planned(
        &["triplets", arg(&dataset), "--windows", "100"],
        &into,
        &plan,
    );
    let source = workshop.path("corpus");
    fs::remove_file(&files_with_extension(&source, "bvh")[0]).expect("removed");
    typed(
        "ingest {} --out {} --prune --drop-labels",
        &[&source, &dataset],
    )
    .expect_code(0);
    let made = work(&plan, &[], 3);
    assert_eq!(
        made[0].code.as_deref(),
        Some("E-SOURCE-CHANGED"),
        "{made:?}"
    );
}

#[test]
fn edits_in_pieces_are_those_of_one_process() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "4").expect_code(0);
    let [dataset, items, run] = ["dataset", "items", "editor"].map(|name| workshop.path(name));
    typed(
        "items {} --out {} --split train --count 70",
        &[&dataset, &items],
    )
    .expect_code(0);
    let job = ["edit", arg(&run), "--items", arg(&items), "--takes", "2"];
    let [clean, into, plan] = ["clean", "edits", "plan"].map(|name| workshop.path(name));
    let clean_hash = root_hash(&job, &clean);
    assert_eq!(root_hash_in_pieces(&job, &into, &plan), clean_hash);
    assert!(pieces(&plan).len() >= 2, "a piece for each take at least");
    let remarks = |folder: &Path| fs::read(folder.join("remarks.json")).expect("remarks");
    assert_eq!(remarks(&into), remarks(&clean));
    assert!(into.join("times.json").is_file() == clean.join("times.json").is_file());
}

#[test]
fn variants_in_pieces_are_those_of_one_process() {
    let workshop = Workshop::open();
    let (settings, texts) = (workshop.path("mld.toml"), workshop.path("texts"));
    put(&settings, SMALL_GENERATOR);
    let lines: String = (0..40)
        .map(|number| format!("a person walks {number} steps\n"))
        .collect();
    put(&texts, lines);
    let small = ["--config", arg(&settings), "--steps", "3"];
    workshop.train_with("mld", "mld", &small).expect_code(0);
    let (dataset, run) = (workshop.dataset(), workshop.path("mld"));
    let job = [
        "variants",
        arg(&dataset),
        "--generator",
        arg(&run),
        "--instructions",
        arg(&texts),
    ];
    let job = [&job[..], &["--variants", "2"], &ANY_PAIR].concat();
    let [clean, into, plan] = ["clean", "into", "plan"].map(|name| workshop.path(name));
    let clean_hash = root_hash(&job, &clean);
    assert_eq!(root_hash_in_pieces(&job, &into, &plan), clean_hash);
    assert_eq!(pieces(&plan).len(), 2, "32 instructions are a batch");
}

/// Finds the hidden folder that holds the pieces of an export. It lies beside the export.
fn pieces_beside(into: &Path) -> Option<PathBuf> {
    let name = into.file_name().expect("a name").to_string_lossy();
    let beside = fs::read_dir(into.parent().expect("a folder")).expect("a folder");
    let mut beside = beside.map(|entry| entry.expect("an entry").path());
    beside.find(|path| {
        let found = path.file_name().expect("a name").to_string_lossy();
        found.starts_with(&format!(".{name}.")) && found.ends_with(".pieces")
    })
}

#[test]
fn exports_in_pieces_are_those_of_one_process() {
    let place = Place::new(CLIPS);
    let [source, dataset] = ["corpus", "dataset"].map(|name| place.at(name));
    stance(&["ingest", arg(&source), "--out", arg(&dataset)]).expect_code(0);
    for (layout, parts) in [
        ("amass", 4),
        ("bvh", 4),
        ("humanml3d", 4),
        ("humanml3d-272", 4),
        ("motionmillion", 4),
        ("hy-motion", 4),
        ("webdataset", 1),
    ] {
        let job = ["export", arg(&dataset), "--to", layout];
        let [clean, into, plan] =
            ["clean", "into", "plan"].map(|name| place.at(&format!("{layout}-{name}")));
        stance(&[&job[..], &["--out", arg(&clean)]].concat()).expect_code(0);
        let made = planned(&job, &into, &plan);
        assert_eq!((made.pieces, made.items), (parts, CLIPS as u64), "{layout}");
        assert!(made.bytes > 0, "{layout}");
        by_four(&plan);
        let ids: Vec<String> = pieces(&plan).into_iter().map(|piece| piece.id).collect();
        let reversed: Vec<&str> = ids.iter().rev().map(String::as_str).collect();
        let again = work(&plan, &["--items", &reversed.join(",")], 0);
        assert_eq!(count(&again, Outcome::DoneBefore), ids.len(), "{layout}");
        assert!(!into.exists(), "{layout}: an export appears whole");
        let done = commit(&plan, &[], 0);
        assert_eq!(done.tables["clips"], CLIPS as u64, "{layout}");
        assert!(files_below(&into) == files_below(&clean), "{layout}");
        let again = commit(&plan, &[], 0);
        assert!(again.already_committed && again.root_hash == done.root_hash);
        // A late worker has nothing to do, and leaves no files.
        assert_eq!(
            count(&work(&plan, &[], 0), Outcome::DoneBefore),
            ids.len(),
            "{layout}"
        );
        assert_eq!(pieces_beside(&into), None, "{layout}");
        fs::remove_dir_all(&clean).expect("removed");
        fs::remove_dir_all(&into).expect("removed");
    }
}

#[test]
fn an_export_whose_workers_and_commits_are_killed_is_that_of_one_process() {
    let place = Place::new(CLIPS);
    let [source, dataset] = ["corpus", "dataset"].map(|name| place.at(name));
    stance(&["ingest", arg(&source), "--out", arg(&dataset)]).expect_code(0);
    let job = ["export", arg(&dataset), "--to", "humanml3d"];
    let [clean, into, plan] = ["clean", "into", "plan"].map(|name| place.at(name));
    stance(&[&job[..], &["--out", arg(&clean)]].concat()).expect_code(0);
    let clean = files_below(&clean);
    planned(&job, &into, &plan);

    // Whether the kill comes before, in or after a piece, the result must be the same.
    let staged = format!("meta/staged/0-{}", plan_hash(&plan));
    let has_begun = || {
        let made = pieces_beside(&into)?.join(&staged).join("pieces");
        fs::read_dir(made).ok()?.next()
    };
    let mut killed = started(&["--threads", "1", "stage", "work", arg(&plan)]);
    while has_begun().is_none() && killed.try_wait().expect("a child").is_none() {
        std::thread::yield_now();
    }
    killed.kill().expect("a child");
    killed.wait().expect("a child");
    by_four(&plan);

    // A lost file only affects its piece.
    let home = pieces_beside(&into).expect("a folder of pieces");
    let record = &work(&plan, &[], 0)[1];
    let lost = home.join(staged).join(&record.files[0].path);
    fs::remove_file(lost).expect("a staged file");
    assert_eq!(status(&plan).missing, std::slice::from_ref(&record.piece));
    assert_eq!(count(&work(&plan, &[], 0), Outcome::Done), 1);

    // A commit that was killed before it published is repeated; files of another run at the destination are not
    // touched.
    let mut killed = started(&["stage", "commit", arg(&plan)]);
    while !home.join("result/new_joints").exists() && killed.try_wait().expect("a child").is_none()
    {
        std::thread::yield_now();
    }
    killed.kill().expect("a child");
    killed.wait().expect("a child");
    if !into.exists() {
        put(into.join("notes.txt"), "mine");
        stance(&["stage", "commit", arg(&plan)]).expect_refused(arg(&into));
        fs::remove_dir_all(&into).expect("removed");
    }
    let done = commit(&plan, &[], 0);
    assert!(files_below(&into) == clean);
    assert_eq!(pieces_beside(&into), None);

    // A commit that was killed after it published counts as done.
    fs::create_dir(&home).expect("a folder");
    fs::rename(plan.join("committed.json"), home.join("committed.json")).expect("moved");
    let again = commit(&plan, &[], 0);
    assert!(again.already_committed && again.root_hash == done.root_hash);
    assert!(status(&plan).committed);
    assert_eq!(pieces_beside(&into), None);
    assert!(files_below(&into) == clean);
}

#[test]
fn a_dry_run_of_an_export_makes_a_few_clips() {
    let place = Place::new(40);
    let [source, dataset] = ["corpus", "dataset"].map(|name| place.at(name));
    stance(&["ingest", arg(&source), "--out", arg(&dataset)]).expect_code(0);
    for layout in ["bvh", "webdataset"] {
        let into = place.at("into");
        let planned: Planned = typed(
            "--json stage plan export {} --to {} --into {} --dry-run",
            &[&dataset, &layout, &into],
        )
        .done();
        let sample = planned.sample.expect("a sample");
        assert_eq!((planned.items, sample.items), (40, 16), "{layout}");
        assert!(planned.bytes > 0 && !into.exists(), "{layout}");
    }
}

#[test]
fn an_export_of_chosen_clips_in_pieces_is_that_of_one_process() {
    let place = Place::new(24);
    let [source, dataset] = ["corpus", "dataset"].map(|name| place.at(name));
    stance(&["ingest", arg(&source), "--out", arg(&dataset)]).expect_code(0);
    let job = [
        "export",
        arg(&dataset),
        "--to",
        "bvh",
        "--where",
        "split = 'train'",
    ];
    let [clean, into, plan] = ["clean", "into", "plan"].map(|name| place.at(name));
    stance(&[&job[..], &["--out", arg(&clean)]].concat()).expect_code(0);
    planned(&job, &into, &plan);
    // A damaged file of the dataset fails only the pieces that read it.
    let shard = files_with_extension(&dataset.join("data/motions"), "parquet");
    let shard = shard
        .iter()
        .find(|path| path.to_string_lossy().contains("train"))
        .expect("a shard");
    let whole = fs::read(shard).expect("a shard");
    let mut damaged = whole.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    put(shard, damaged);
    let made = work(&plan, &[], 3);
    assert_eq!(
        made[0].code.as_deref(),
        Some("E-SOURCE-CHANGED"),
        "{made:?}"
    );
    typed("stage commit {} --quarantine-failed", &[&plan]).expect_refused("whole or not at all");
    put(shard, whole);
    work(&plan, &[], 0);
    commit(&plan, &[], 0);
    assert!(files_below(&into) == files_below(&clean));
}
