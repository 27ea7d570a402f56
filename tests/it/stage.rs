//! Jobs in pieces through the command: many processes give the same result as one.

mod exports;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use datasets_spec::Dataset;
use datasets_spec::dataset::Transaction;
use datasets_spec::record::QuarantineRow;
use datasets_spec::table::read_rows;
use serde::Deserialize;
use serde_json::Value;
use work::{Outcome, Piece, Record};

use crate::annotate::from_json;
use crate::archives::files_below;
use crate::train::Workshop;
use crate::util::{
    Folder, Ran, arg, assert_has, assert_quarantined, damage, files_with_extension, json_lines,
    json_of, kill_once, manifest_of, put, real_data, root_hash_of, rows_of, word_of,
};
use crate::variants::{ANY as ANY_PAIR, SMALL as SMALL_GENERATOR};

/// Number of clips for which the training split has two shards.
const CLIPS: usize = 340;

/// The document of `stage commit --json`, with the fields that scripts rely on.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "part of the contract")]
struct Committed {
    destination: PathBuf,
    already_committed: bool,
    pieces: u64,
    failed: u64,
    tables: BTreeMap<String, u64>,
    accounting: Option<Counts>,
    root_hash: String,
    /// Notes of the job on the result.
    #[serde(default)]
    notes: Value,
}

impl Committed {
    /// The counts of an ingestion, which must add up.
    fn counts(&self) -> &Counts {
        let counts = self.accounting.as_ref();
        let counts = counts.expect("an ingestion has sources");
        let sum = counts.ingested + counts.quarantined + counts.skipped;
        assert_eq!(counts.sources, sum);
        counts
    }
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
#[expect(dead_code, reason = "part of the contract")]
struct Planned {
    job: String,
    plan: Option<PathBuf>,
    destination: PathBuf,
    plan_hash: String,
    pieces: u64,
    items: u64,
    /// Null where all pieces read the same.
    bytes: Option<u64>,
    sample: Option<Sample>,
    estimated_hours: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "part of the contract")]
struct Sample {
    items: u64,
    secs: f64,
}

/// The document of `stage status --json`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "part of the contract")]
struct Status {
    committed: bool,
    pieces: u64,
    done: u64,
    missing: Vec<String>,
    failed: Vec<Record>,
    secs: f64,
}

/// Does a job in one process, and returns the root hash of its result.
fn root_hash(folder: &Folder, job: &str, out: &str) -> String {
    let done: Value = folder.json(&format!("{job} --out @{out}"));
    word_of(&done["root_hash"]).to_owned()
}

fn records(ran: &Ran) -> Vec<Record> {
    let lines = json_lines(&ran.stdout).into_iter();
    lines.map(from_json).collect()
}

fn count(records: &[Record], outcome: Outcome) -> usize {
    let records = records.iter();
    records.filter(|record| record.outcome == outcome).count()
}

fn failed(records: &[Record]) -> Vec<&Record> {
    records.iter().filter(|record| !record.is_done()).collect()
}

/// Asserts that a piece failed because this file changed, and returns the reason.
fn assert_changed<'a>(failed: &'a Record, file: &Path) -> &'a str {
    assert_eq!(failed.code.as_deref(), Some("E-SOURCE-CHANGED"));
    let reason = failed.reason.as_deref().expect("a reason");
    assert_has(reason, &["plan again", arg(file)]);
    reason
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

/// A job in pieces: its result is the folder `name`, and its plan the folder `name-plan`.
struct Job<'a> {
    folder: &'a Folder,
    into: PathBuf,
    plan: PathBuf,
    planned: Planned,
}

impl<'a> Job<'a> {
    fn planned(folder: &'a Folder, name: &str, job: &str) -> Self {
        let line = format!("stage plan {job} --into @{name} --out @{name}-plan");
        Self {
            folder,
            planned: folder.json(&line),
            into: folder.path(name),
            plan: folder.path(&format!("{name}-plan")),
        }
    }

    /// Plans the ingestion of the corpus.
    fn ingestion(folder: &'a Folder) -> Self {
        Self::planned(folder, "dataset", "ingest @corpus")
    }

    fn typed(&self, line: &str, more: &[&str]) -> Ran {
        let args = [&[arg(&self.plan)], more].concat();
        self.folder.typed_with(line, &args)
    }

    fn started(&self, line: &str, more: &[&str]) -> Child {
        let args = [&[arg(&self.plan)], more].concat();
        self.folder.started(line, &args)
    }

    fn work(&self, more: &[&str], code: i32) -> Vec<Record> {
        records(&self.typed("--json stage work", more).expect_code(code))
    }

    fn commit(&self, more: &[&str], code: i32) -> Committed {
        let ran = self.typed("--json stage commit", more);
        ran.expect_code(code).json()
    }

    /// Asserts that a commit is refused with this text.
    fn refused(&self, said: &str) {
        self.typed("stage commit", &[]).expect_refused(said);
    }

    fn status(&self) -> Status {
        self.typed("--json stage status", &[]).done()
    }

    fn pieces(&self) -> Vec<Piece> {
        read_rows(&self.plan.join("pieces.parquet")).expect("a table of pieces")
    }

    fn plan_hash(&self) -> String {
        let plan: Value = json_of(self.plan.join("plan.json"));
        word_of(&plan["plan_hash"]).to_owned()
    }

    fn quarantined(&self) -> Vec<QuarantineRow> {
        rows_of(&self.into)
    }

    /// Makes the pieces with four processes at once.
    fn by_four(&self) {
        let shares = ["0/4", "1/4", "2/4", "3/4"];
        let workers = shares.map(|share| self.started("stage work", &["--shard", share]));
        for mut worker in workers {
            assert!(worker.wait().expect("a child").success());
        }
    }

    /// Asks for all pieces in reverse order; they are made already.
    fn again_in_reverse(&self) -> Vec<Record> {
        let ids: Vec<String> = self.pieces().into_iter().map(|piece| piece.id).collect();
        assert_eq!(self.planned.pieces, ids.len() as u64);
        let reversed: Vec<&str> = ids.iter().rev().map(String::as_str).collect();
        let again = self.work(&["--items", &reversed.join(",")], 0);
        assert_eq!(count(&again, Outcome::DoneBefore), ids.len());
        let order: Vec<&str> = again.iter().map(|record| record.piece.as_str()).collect();
        assert_eq!(order, reversed);
        again
    }

    /// Checks that another commit and more work after `done` change nothing.
    fn again_after(&self, done: &Committed) {
        let again = self.commit(&[], 0);
        assert!(again.already_committed && again.root_hash == done.root_hash);
        let late = self.work(&[], 0);
        let done_before = count(&late, Outcome::DoneBefore) as u64;
        assert_eq!(done_before, self.planned.pieces);
        assert!(self.status().committed);
    }

    /// Makes the pieces in every way that a scheduler may: by four processes of which one is killed once it
    /// `has_begun`, again in another order, and after a file was lost.
    fn make_in_every_way(&self, has_begun: impl Fn() -> bool) {
        kill_once(self.started("--threads 1 stage work", &[]), has_begun);
        self.by_four();
        let again = self.again_in_reverse();

        let lost = again.iter().find(|record| !record.files.is_empty());
        let lost = lost.expect("a piece with a file");
        let shard = lost.files[0].path.trim_end_matches(".parquet");
        let staged = format!("meta/staged/0-{}/{shard}", self.plan_hash());
        let home = pieces_beside(&self.into);
        let home = home.as_ref().unwrap_or(&self.into);
        fs::remove_file(home.join(staged)).expect("a staged file");
        assert_eq!(self.status().missing, std::slice::from_ref(&lost.piece));
        let made = self.work(&[], 0);
        assert_eq!(count(&made, Outcome::Done), 1, "only what is lost is made");
    }

    /// Makes the pieces of a dataset in every way, and commits them. The commit ends with `code`.
    fn in_every_way(&self, code: i32) -> Committed {
        self.make_in_every_way(|| {
            self.into.exists() && !files_with_extension(&self.into, "parquet").is_empty()
        });
        let done = self.commit(&[], code);
        assert!(!done.already_committed && done.failed == 0, "{done:?}");
        assert_eq!(done.pieces, self.planned.pieces);
        self.again_after(&done);
        let staged = fs::read_dir(self.into.join("meta/staged"));
        assert_eq!(staged.expect("a folder").count(), 0);
        assert!(files_with_extension(&self.into, "tmp").is_empty());
        done
    }
}

#[test]
fn an_ingestion_in_pieces_that_are_killed_repeated_and_lost_is_that_of_one_process() {
    let folder = Folder::of_clips(CLIPS);
    folder.put("corpus/broken.bvh", "HIERARCHY\n");
    folder.put("corpus/stance.toml", "license = \"CC0-1.0\"\n");
    let clean = folder.typed("--json ingest @corpus --out @clean");
    let clean: Value = clean.expect_code(3).json();
    let job = Job::ingestion(&folder);
    let planned = &job.planned;
    assert_eq!((planned.pieces, planned.items), (4, CLIPS as u64 + 1));
    // `stance.toml` belongs to all pieces, but its bytes are counted once.
    let files = files_below(&folder.path("corpus")).into_values();
    let sizes = files.map(|bytes| bytes.len() as u64);
    assert_eq!(planned.bytes, Some(sizes.sum()));
    assert!(planned.sample.is_none());
    assert!(!job.into.exists(), "a plan touches no dataset");
    let done = job.in_every_way(3);
    assert_eq!(clean["root_hash"], done.root_hash);
    assert_eq!(done.counts().codes.values().sum::<u64>(), 1);
}

#[test]
fn a_dataset_that_grows_in_pieces_is_that_of_one_process() {
    let folder = Folder::of_clips(40);
    folder.run("ingest @corpus --out @one");
    folder.run("ingest @corpus --out @two");
    // One clip changes, one is removed and one is new, so that shards are written again.
    let files = files_with_extension(&folder.path("corpus"), "bvh");
    let text = fs::read(&files[0]).expect("a file");
    put(&files[1], &text);
    fs::remove_file(&files[2]).expect("removed");
    folder.put("corpus/new.bvh", &text);
    let verb = "ingest @corpus --prune --drop-labels";
    let clean = root_hash(&folder, verb, "one");
    let job = Job::planned(&folder, "two", verb);
    job.by_four();
    assert_eq!(job.commit(&[], 0).root_hash, clean);

    // A file that changes after planning fails its piece, and its clip is not pruned.
    let clips = || manifest_of(&folder.path("two")).rows("motions", None);
    let before = clips();
    put(&files[1], fs::read(&files[3]).expect("a file"));
    folder.run(&format!("stage plan {verb} --into @two --out @late"));
    put(&files[1], &text);
    folder.typed("stage work @late").expect_code(3);
    let commit = "stage commit @late --quarantine-failed";
    folder.typed(commit).expect_code(3);
    assert_eq!(clips(), before);
}

#[test]
fn the_real_data_in_pieces_is_that_of_one_process() {
    let Some(source) = real_data("the_real_data_in_pieces_is_that_of_one_process") else {
        return;
    };
    let folder = Folder::empty();
    let ingest = format!("ingest {}", source.display());
    let clean = folder.typed(&format!("--json {ingest} --out @clean"));
    let code = clean.code;
    assert!(code == 0 || code == 3, "{}", clean.stderr);
    let clean: Value = clean.json();
    let job = Job::planned(&folder, "dataset", &ingest);
    job.by_four();
    let done = job.commit(&[], code);
    assert_eq!(clean["root_hash"], done.root_hash);
    assert_eq!(clean["ingested"], done.counts().ingested);
    assert_eq!(clean["quarantined"], done.counts().quarantined);
}

#[test]
fn a_plan_is_committed_once_and_when_all_pieces_are_made() {
    let folder = Folder::of_clips(12);
    let job = Job::ingestion(&folder);
    let ids = job.pieces();
    let one = ["--items", ids[0].id.as_str()];
    if cfg!(target_os = "linux") {
        // A piece that needs more memory than allowed fails, and can be made with more.
        let isolated = |memory, code| {
            let more = ["--isolate", "--memory", memory];
            job.work(&[&one[..], &more].concat(), code).remove(0)
        };
        let made = isolated("64MB", 3);
        assert_eq!(made.code.as_deref(), Some("E-CRASH"), "{made:?}");
        assert_eq!(isolated("16GB", 0).outcome, Outcome::Done);
    } else {
        job.work(&one, 0);
    }
    let missing = ids.len() - 1;
    job.refused(&format!("{missing} of {} pieces are missing", ids.len()));
    job.refused(&format!("stance stage work {}", job.plan.display()));
    assert!(Dataset::open(&job.into).is_err(), "nothing is committed");
    let found = job.status();
    assert_eq!((found.done, found.pieces), (1, ids.len() as u64));
    assert!(found.failed.is_empty() && !found.committed);
    assert_eq!(found.missing.len(), missing);

    job.work(&[], 0);
    let lock = Transaction::begin(&job.into, "the other run").expect("locks");
    let ran = job.typed("stage commit", &[]).expect_code(75);
    ran.expect_said("the other run");
    drop(lock);
    let both = [0, 1].map(|_| job.started("stage commit", &[]));
    let mut codes = both.map(|mut child| child.wait().expect("a child").code());
    codes.sort_unstable();
    // The second commit is locked out, or finds the dataset already committed.
    let [first, second] = codes;
    assert_eq!(first, Some(0));
    assert!([Some(0), Some(75)].contains(&second), "{second:?}");
    assert_eq!(manifest_of(&job.into).version, 1);

    // A plan is refused once its destination has another version.
    let job = Job::planned(&folder, "stale", "ingest @corpus");
    job.work(&["--items", &job.pieces()[0].id], 0);
    folder.run("ingest @corpus --out @stale --fps 30");
    let before = root_hash_of(&job.into);
    for record in job.work(&[], 3) {
        assert_eq!(record.code.as_deref(), Some("E-PLAN-STALE"));
    }
    job.refused("plan again");
    assert_eq!(root_hash_of(&job.into), before);
}

#[test]
fn a_piece_whose_source_changed_fails_alone_and_can_be_quarantined() {
    let folder = Folder::of_clips(CLIPS);
    let job = Job::ingestion(&folder);
    let bvh = &files_with_extension(&folder.path("corpus"), "bvh")[0];
    // The size is the same, so that only the hash differs.
    let mut changed = fs::read(bvh).expect("a file");
    let digit = changed.iter().rposition(u8::is_ascii_digit);
    let digit = digit.expect("a digit");
    changed[digit] = if changed[digit] == b'1' { b'2' } else { b'1' };
    // An unreadable file may be unchanged: its piece fails and can be made again.
    fs::remove_file(bvh).expect("removed");
    std::os::unix::fs::symlink(bvh, bvh).expect("a link to itself");
    let made = job.work(&[], 3).into_iter();
    let reasons: Vec<String> = made.filter_map(|made| made.reason).collect();
    assert_eq!(reasons.len(), 1, "{reasons:?}");
    assert_has(&reasons[0], &["make the piece again"]);
    fs::remove_file(bvh).expect("removed");
    put(bvh, &changed);
    let made = job.work(&[], 3);
    let [failed] = failed(&made)[..] else {
        panic!("one piece reads the file: {made:?}");
    };
    let reason = assert_changed(failed, bvh);
    assert_eq!(job.status().failed.len(), 1);
    job.refused("--quarantine-failed");

    let pieces = job.pieces();
    let piece = pieces.iter().find(|piece| piece.id == failed.piece);
    let items = piece.expect("a piece of the plan").items;
    let done = job.commit(&["--quarantine-failed"], 3);
    let counts = done.counts();
    assert_eq!((done.failed, counts.quarantined), (1, items));
    assert_eq!(counts.codes["E-SOURCE-CHANGED"], items);
    assert_eq!(done.tables["motions"], counts.ingested);
    assert!(job.quarantined().iter().all(|row| row.reason == reason));

    // Most files of the piece did not cause the failure: the next run reads them.
    let again: Value = folder.json("ingest @corpus --out @dataset");
    assert_eq!(again["ingested"], CLIPS);
}

#[test]
fn a_label_file_that_is_added_after_planning_fails_the_pieces_that_it_speaks_of() {
    let folder = Folder::of_clips(CLIPS);
    let source = folder.path("corpus");
    let walk = &files_with_extension(&source, "bvh")[0];
    let sidecar = walk.with_extension("stance.json");
    let said = fs::read(&sidecar).expect("a sidecar");
    fs::remove_file(&sidecar).expect("removed");
    let clean = root_hash(&folder, "ingest @corpus", "clean");
    let job = Job::ingestion(&folder);
    let all = job.pieces().len();
    let captions = walk.with_file_name("captions.csv");
    // Label files of the motion, of its folder, and of a folder above.
    for (added, bytes, num_failed) in [
        (sidecar, &said[..], 1..=1),
        (walk.with_extension("txt"), b"a walk\n", 1..=1),
        (captions, b"name,text\n", 1..=all),
        (source.join("stance.toml"), b"style = \"calm\"\n", all..=all),
    ] {
        put(&added, bytes);
        let made = job.work(&[], 3);
        let failed = failed(&made);
        assert!(num_failed.contains(&failed.len()), "{made:?}");
        for record in failed {
            assert_changed(record, &added);
        }
        fs::remove_file(&added).expect("removed");
        fs::remove_dir_all(job.into.join("meta/staged")).expect("removed");
    }
    // A file that labels no motion does not stop the run.
    folder.put("corpus/job-17.out", "made\n");
    job.by_four();
    assert_eq!(job.commit(&[], 0).root_hash, clean);
}

#[test]
fn a_dry_run_counts_and_writes_nothing() {
    let folder = Folder::of_clips(40);
    let planned: Planned = folder.json("stage plan ingest @corpus --into @dataset --dry-run");
    assert_eq!(planned.items, 40);
    assert!(planned.pieces > 0 && planned.bytes.is_some());
    let sample = planned.sample.expect("a sample");
    assert!(sample.items > 0 && planned.estimated_hours.is_some_and(|hours| hours > 0.0));
    let entries = fs::read_dir(folder.path("")).expect("a folder");
    let names = entries.map(|entry| entry.expect("an entry").file_name());
    assert_eq!(names.collect::<Vec<_>>(), ["corpus"]);

    folder.run("ingest @corpus --out @dataset");
    for layout in ["bvh", "webdataset"] {
        let line = format!("stage plan export @dataset --to {layout} --into @into --dry-run");
        let planned: Planned = folder.json(&line);
        let sample = planned.sample.expect("a sample");
        assert_eq!((planned.items, sample.items), (40, 16), "{layout}");
        let into = folder.path("into");
        assert!(planned.bytes.is_some() && !into.exists(), "{layout}");
    }
}

#[test]
fn a_plan_takes_an_empty_folder_and_no_other() {
    let folder = Folder::of_clips(4);
    fs::create_dir(folder.path("dataset-plan")).expect("made");
    let job = Job::ingestion(&folder);
    assert!(job.planned.pieces > 0 && job.plan.join("plan.json").is_file());
    folder.put("other/notes.txt", "mine");
    let line = "stage plan ingest @corpus --into @dataset --out @other";
    folder.typed(line).expect_refused("not empty");
    assert_eq!(folder.text("other/notes.txt"), "mine");
}

/// Kills the process that makes a piece, as the system does when memory runs out.
#[cfg(target_os = "linux")]
#[test]
fn a_piece_whose_process_is_killed_fails_alone() {
    let folder = Folder::of_clips(CLIPS);
    let job = Job::ingestion(&folder);
    let pieces = job.pieces();
    let largest = pieces.iter().max_by_key(|piece| piece.items);
    let largest = largest.expect("a piece");
    let mut command = folder.command("--json stage work @dataset-plan --isolate");
    command.stdout(Stdio::piped()).stderr(Stdio::null());
    let worker = command.spawn().expect("stance starts");
    let children = format!("/proc/{0}/task/{0}/children", worker.id());
    let is_of_piece = |child: &str| {
        let line = fs::read(format!("/proc/{child}/cmdline")).unwrap_or_default();
        line.split(|byte| *byte == 0)
            .any(|word| word == largest.id.as_bytes())
    };
    let child = loop {
        let children = fs::read_to_string(&children).expect("text");
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
    assert_eq!(made.len(), pieces.len());
    for record in &made {
        assert_eq!(record.is_done(), record.piece != largest.id, "{record:?}");
    }
    let done = job.commit(&["--quarantine-failed"], 3);
    let codes = BTreeMap::from([("E-CRASH".to_owned(), largest.items)]);
    assert_eq!(done.counts().codes, codes);
    assert_eq!(done.tables["motions"], CLIPS as u64 - largest.items);
    let rows = job.quarantined();
    assert!(rows.iter().all(|row| row.reason.contains("signal 9")));
}

#[test]
fn windows_triplets_edits_and_variants_in_pieces_are_those_of_one_process() {
    let workshop = Workshop::with_corpus();
    workshop.train("motionrefit", "editor", "4").expect_code(0);
    workshop.run("items @dataset --out @items --split train --count 70");
    workshop.trained("mld", "mld", SMALL_GENERATOR, "--steps 3");
    let lines = (0..40).map(|number| format!("a person walks {number} steps\n"));
    workshop.put("texts", lines.collect::<String>());
    let variants =
        format!("variants @dataset --generator @mld --instructions @texts --variants 2 {ANY_PAIR}");
    for (name, job, pieces) in [
        ("windows", "triplets @dataset --windows 9000", 3..=3),
        ("triplets", "triplets @dataset --count 12", 1..=12),
        // At least one piece for each take.
        ("edits", "edit @editor --items @items --takes 2", 2..=140),
        // A piece has a batch of 32 instructions.
        ("variants", &variants, 2..=2),
    ] {
        let clean = root_hash(&workshop, job, &format!("{name}-clean"));
        let job = Job::planned(&workshop, name, job);
        assert_eq!(job.in_every_way(0).root_hash, clean, "{name}");
        assert!(pieces.contains(&job.planned.pieces), "{name}");
        assert_eq!(job.planned.bytes, None, "{name}");
    }
    let planned = "stage plan triplets @dataset --count 12 --into @none --dry-run";
    let planned = workshop.run(planned).stdout;
    assert!(planned.contains("12 items, into "), "{planned}");
    workshop.run("verify @windows");
    workshop.run("verify @triplets");
    let remarks = |edits: &str| workshop.text(&format!("{edits}/remarks.json"));
    assert_eq!(remarks("edits"), remarks("edits-clean"));
    let is_timed = |edits: &str| workshop.path(edits).join("times.json").is_file();
    assert_eq!(is_timed("edits"), is_timed("edits-clean"));

    // For windows, a failed piece is quarantined as one item.
    if cfg!(target_os = "linux") {
        let job = Job::planned(&workshop, "failing", "triplets @dataset --windows 5000");
        let ids = job.pieces();
        job.work(&["--items", &ids[0].id], 0);
        let second = ids[1].id.as_str();
        let isolated = ["--items", second, "--isolate", "--memory", "64MB"];
        job.work(&isolated, 3);
        let done = job.commit(&["--quarantine-failed"], 3);
        assert_eq!((done.failed, done.tables["windows"]), (1, 4096));
        let expected = [("windows/train-00001-of-00002", "E-CRASH")];
        assert_quarantined(&job.into, &expected);
    }

    // A changed dataset would give other windows, so the piece fails.
    let [made, job] = ["made", "late"]
        .map(|name| Job::planned(&workshop, name, "triplets @dataset --windows 100"));
    made.work(&[], 0);
    fs::remove_file(workshop.clip()).expect("removed");
    workshop.run("ingest @corpus --out @dataset --prune --drop-labels");
    let failed = job.work(&[], 3).remove(0);
    let code = failed.code.as_deref();
    assert_eq!(code, Some("E-SOURCE-CHANGED"), "{failed:?}");
    // Pieces that were made before are not committed either.
    let refused = made.typed("--json stage commit", &[]).expect_code(1);
    let refused: Value = refused.json();
    assert_eq!(refused["code"], "E-SOURCE-CHANGED");
}
