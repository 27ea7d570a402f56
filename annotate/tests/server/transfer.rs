//! Import and export: an import of exported files gives the same answers.

mod candidates;
mod clips;
mod export;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use annotate::store::{Imported, MotionRecord, NewTask, Store, TaskRecord, open_sqlite};
use annotate::transfer::{
    AnnotationRow, EventRow, Exported, LabelRow, RejectRow, Taken, export, from_annotations,
    from_dataset, from_release,
};
use annotate::wire::{
    Answer, Audit, Code, Decision, EventKind, ExportFormat, ExportRequest, Job, NewReview,
    ReviewQueue, Role, Rule, RuleKind, TaskKind, TaskState, Verdict,
};
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::{Row, read_rows, write_rows};
use datasets_spec::{Dataset, MotionId, Split, Transaction};
use serde_json::{Value, json};

use crate::support::{
    CLIPS, Client, MINUTE, START, Site, all_keys, bare_motion, bare_task, claim, commit, decision,
    event_of, from_json, join, masks, motion, motion_row, pair, peak_memory_mb, plain_settings,
    read, review, rule, say, set, style, tell, user_id, who, whole,
};

pub(crate) fn finished(boss: &Client, id: i64) -> Job {
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(60);
    loop {
        let job: Job = boss.get(&format!("jobs/{id}")).ok();
        if job.state != "running" {
            return job;
        }
        let is_late = std::time::Instant::now() > deadline;
        assert!(!is_late, "job {id} does not end");
        std::thread::yield_now();
    }
}

/// A server with one accepted answer of each kind.
fn annotated() -> Site {
    let site = Site::new();
    let [ann, eve] = site.people(["ann", "eve"]);
    ann.answer(masks("waving"));
    let hard = json!({ "parts": ["LEFT_ARM"], "soft": false, "text": "a, \"quoted\"\ntext" });
    let described = |masks: Value, reason: &str, note: &str| -> Answer {
        from_json(
            json!({ "kind": "mask_text", "masks": masks, "count_reason": reason, "note": note }),
        )
    };
    ann.answer(described(json!([hard]), "single_action", "=note"));
    ann.answer(described(json!([]), "other", "stands still"));
    ann.answer(pair(Verdict::Keep));
    ann.answer(pair(Verdict::Unnatural));
    ann.answer(style());
    assert_eq!(eve.accept_all(), 6);
    site
}

fn selection(format: ExportFormat) -> ExportRequest {
    ExportRequest {
        format,
        splits: Vec::new(),
        events: true,
    }
}

fn write_to(site: &Site, store: &Store, folder: &Path, format: ExportFormat) -> Exported {
    let selection = selection(format);
    export(store, &site.dataset, folder, &selection, "test").expect("exports")
}

fn write(site: &Site, store: &Store, folder: &str, format: ExportFormat) -> PathBuf {
    let folder = site.folder.path().join(folder);
    write_to(site, store, &folder, format);
    folder
}

fn commit_answers(site: &Site, store: &Store) -> Exported {
    let folder = site.folder.path().join("unused");
    write_to(site, store, &folder, ExportFormat::Dataset)
}

fn rows<R: Row>(folder: &Path, table: &str) -> Vec<R> {
    read_rows(&folder.join(format!("{table}.parquet"))).expect("rows")
}

fn read_json(path: PathBuf) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("a file")).expect("JSON")
}

/// The document of a release that an export wrote.
fn release(folder: &Path) -> Value {
    let read = |name: &str| read_json(folder.join(name));
    json!({ "mask_all": read("mask_all.json"), "part_annotations": read("part_annotations.json") })
}

fn take(store: &Store, folder: &Path) -> Taken {
    let table = folder.join("annotations.parquet");
    from_annotations(store, &table, None, START).expect("takes")
}

/// Writes a table `annotations` of a version without content hashes, and imports it.
fn take_without_hashes(store: &Store, rows: &[AnnotationRow], file: &Path) -> Taken {
    let rows = rows.iter().cloned().map(|row| AnnotationRow {
        motion_hash: None,
        target_hash: None,
        ..row
    });
    let rows: Vec<AnnotationRow> = rows.collect();
    let bytes = write_rows(Vec::new(), file, &rows, &[]).expect("a table");
    std::fs::write(file, bytes).expect("written");
    from_annotations(store, file, None, START).expect("takes")
}

/// A store with motions but no tasks.
fn empty_store(site: &Site, name: &str) -> Arc<Store> {
    let store = open_sqlite(&site.folder.path().join(name)).expect("a store");
    let motions = site.store.all_motions().expect("motions");
    store.put_motions(motions).expect("motions");
    store
}

fn answers(store: &Store) -> BTreeMap<String, Answer> {
    let all = store.accepted(&all_keys()).expect("answers").into_iter();
    all.map(|one| (one.task.key, one.answer)).collect()
}

/// A store with the tasks of the site's dataset and without answers.
fn fresh_store(site: &Site, name: &str) -> Arc<Store> {
    let store = empty_store(site, name);
    plain_settings(&store);
    take_dataset(site, &store);
    store
}

fn take_dataset(site: &Site, store: &Store) -> Taken {
    from_dataset(store, &site.dataset, None, START, &mut |_, _| {}).expect("imports")
}

fn task_of(store: &Store, key: &str) -> TaskRecord {
    let mut tasks = (1..500).filter_map(|id| store.task_record(id).ok());
    let found = tasks.find(|task| task.key == key);
    found.unwrap_or_else(|| panic!("there is no task {key}"))
}

/// Has a person answer a mask task in a store without a server, or begin a draft, and returns the task.
fn answer_in(store: &Store, user: i64, answer: Option<Answer>) -> i64 {
    let detail = claim(store, user, TaskKind::MaskText, START).expect("a task");
    let event = match answer {
        Some(answer) => event_of(&detail, EventKind::Submit, answer),
        None => event_of(&detail, EventKind::Draft, masks("a draft")),
    };
    tell(store, user, detail.task.id, event, START);
    detail.task.id
}

/// Imports an accepted answer about the clips of a task.
fn import_judged(store: &Store, key: &str, clips: &TaskRecord, verdict: Verdict) -> Imported {
    let judged = NewTask {
        key: key.to_owned(),
        source: clips.source.clone(),
        target: clips.target.clone(),
        accepted: Some(pair(verdict)),
        ..bare_task(0, TaskKind::Pair)
    };
    store.import(None, vec![judged], START).expect("imports")
}

/// Imports an accepted answer to the task of a pair that nobody has worked on.
fn judge(store: &Store, key: &str, verdict: Verdict) {
    let done = import_judged(store, key, &task_of(store, key), verdict);
    assert_eq!(done.filled, 1, "{done:?}");
}

/// Has eve reopen a task.
fn reopen(store: &Store, key: &str) {
    let reopened = decision(task_of(store, key).id, 0, Decision::Reopen);
    let done = store.review(user_id(store, "eve"), reopened, START);
    done.expect("reopens");
}

fn accept_in(store: &Store, user: i64) {
    let next = review(store, user, ReviewQueue::Sample, START).expect("a task to review");
    let accept = NewReview {
        author: Some(next.candidates[0].0.author),
        ..decision(next.task.id, next.lease.epoch, Decision::Accept)
    };
    store.review(user, accept, START).expect("accepts");
}

fn same_files(a: &Path, b: &Path, names: &[&str]) {
    for name in names {
        let read = |folder: &Path| std::fs::read(folder.join(name)).expect("a file");
        assert_eq!(read(a), read(b), "{name}");
    }
}

#[test]
fn parquet_and_a_release_come_back_as_they_went_from_a_store_with_tasks_or_without() {
    let site = annotated();
    let said = answers(&site.store);
    let first = write(&site, &site.store, "first", ExportFormat::Parquet);
    let again = write(&site, &site.store, "again", ExportFormat::Parquet);
    for table in ["annotations", "labels", "rejects", "agreement"] {
        same_files(&first, &again, &[&format!("{table}.parquet")]);
    }
    let annotations: Vec<AnnotationRow> = rows(&first, "annotations");
    assert_eq!(annotations.len(), 2 + 1 + 1 + 2 + 1);
    let labels: Vec<LabelRow> = rows(&first, "labels");
    assert_eq!(labels.len(), 6);
    let mut authors = labels.iter().map(|label| label.author.as_str());
    assert!(authors.all(|author| author.starts_with('a') && author != "ann"));
    let rejects: Vec<RejectRow> = rows(&first, "rejects");
    let reasons: Vec<&str> = rejects.iter().map(|row| row.reason.as_str()).collect();
    assert_eq!(reasons, ["unnatural"]);

    let store = empty_store(&site, "empty.sqlite");
    let taken = take(&store, &first);
    assert_eq!(taken.counts["new_tasks"], 6);
    assert_eq!(answers(&store), said);
    let second = write(&site, &store, "second", ExportFormat::Parquet);
    assert_eq!(rows::<AnnotationRow>(&second, "annotations"), annotations);
    whole(&store);

    let store = fresh_store(&site, "full.sqlite");
    let tasks = || {
        let counts = store.funnel().expect("counts");
        counts.iter().map(|row| row.2).sum::<i64>()
    };
    let counted = |taken: Taken, names: [&str; 3]| names.map(|name| taken.counts[name]);
    let filled = ["filled_tasks", "new_tasks", "conflicts"];
    let known = ["filled_tasks", "known_tasks", "conflicts"];
    let before = tasks();
    assert_eq!(counted(take(&store, &first), filled), [6, 0, 0]);
    assert_eq!(answers(&store), said);
    assert_eq!(tasks(), before, "no task is there twice");
    let third = write(&site, &store, "third", ExportFormat::Parquet);
    same_files(&first, &third, &["annotations.parquet", "rejects.parquet"]);
    assert_eq!(counted(take(&store, &first), known), [0, 6, 0]);
    let old = site.folder.path().join("old.parquet");
    let old = take_without_hashes(&store, &annotations, &old);
    let by_id = ["found_by_id_alone", "known_tasks", "conflicts"];
    assert_eq!(counted(old, by_id), [6, 6, 0]);
    whole(&store);

    // Rows in another order say the same; a table that lacks some of an answer's rows is refused.
    let file = site.folder.path().join("sorted.parquet");
    let mut sorted = annotations.clone();
    sorted.sort_by(|a, b| (&b.parts, &b.task).cmp(&(&a.parts, &a.task)));
    let store = empty_store(&site, "sorted.sqlite");
    take_without_hashes(&store, &sorted, &file);
    assert_eq!(answers(&store), said);
    sorted.retain(|row| (row.count, row.number) != (2, 1));
    let bytes = write_rows(Vec::new(), &file, &sorted, &[]).expect("a table");
    std::fs::write(&file, bytes).expect("written");
    let store = empty_store(&site, "fewer.sqlite");
    let refused = from_annotations(&store, &file, None, START).expect_err("a row is missing");
    assert!(
        refused.to_string().contains("the 2 rows of its answer"),
        "{refused}"
    );
    assert!(answers(&store).is_empty());

    let first = write(&site, &site.store, "release", ExportFormat::Stance);
    let document = release(&first);
    let masks = &document["mask_all"]["clip00"];
    assert_eq!(*masks, json!(["LEFT_ARM", "LOWER_BODY"]));
    let texts = &document["part_annotations"]["clip00"];
    assert_eq!(*texts, json!(["waving", "waving, walking"]));
    let pairs = read_json(first.join("pairs.json"));
    assert_eq!(pairs.as_array().map(Vec::len), Some(2));
    // Texts that an annotator could not have written are left out, and the rest is taken.
    let mut hostile = document.clone();
    hostile["part_annotations"]["clip00"][0] = json!("a\u{0}b");
    let store = empty_store(&site, "hostile.sqlite");
    let taken = from_release(&store, &hostile, None, START).expect("takes the rest");
    assert_eq!(taken.counts["entries_refused"], 1, "{:?}", taken.messages);
    let full = fresh_store(&site, "full-2.sqlite");
    for (name, store) in [
        ("empty-2", empty_store(&site, "empty-2.sqlite")),
        ("full-2", full),
    ] {
        let taken = from_release(&store, &document, None, START).expect("takes");
        if name == "full-2" {
            assert_eq!(counted(taken, filled)[..2], [3, 0]);
        }
        let second = write(&site, &store, name, ExportFormat::Stance);
        same_files(&first, &second, &["mask_all.json", "part_annotations.json"]);
    }
}

#[test]
fn ranges_and_joints_come_back_from_every_layout_with_a_place_for_them() {
    let site = Site::new();
    let [ann, eve] = site.people(["ann", "eve"]);
    // The masks are in the order of their ids in the dataset.
    let ranged = json!({ "kind": "mask_text", "masks": [
        { "parts": ["BOTH_LEGS"], "joints": [{ "joint": "left_hip", "weight": "soft" }], "text": "walking" },
        { "parts": ["LEFT_ARM"], "range": [0, 31], "text": "waving" },
        {
            "parts": ["LEFT_ARM"], "range": [9, 40], "text": "pointing", "joints": [
                { "joint": "left_collar", "weight": "hard" }, { "joint": "left_wrist", "weight": "none" },
            ],
        },
    ] });
    let task = ann.answer(from_json(ranged));
    assert_eq!(eve.accept_all(), 1);
    let said = answers(&site.store);
    let first = write(&site, &site.store, "first", ExportFormat::Parquet);
    let rows: Vec<AnnotationRow> = rows(&first, "annotations");
    let frames = |row: &AnnotationRow| (row.start, row.end);
    assert_eq!(frames(&rows[0]), (None, None));
    assert_eq!(rows[0].soft_joints, ["left_hip"]);
    assert_eq!(frames(&rows[2]), (Some(9), Some(40)));
    let hard = ["left_collar", "left_shoulder", "left_elbow"];
    assert_eq!(rows[2].hard_joints, hard);
    assert!(rows[2].soft_joints.is_empty());

    // The JSON files of a release cannot hold ranges and joints, so they are counted. The table beside them holds both.
    let lists = site.folder.path().join("lists");
    let done = write_to(&site, &site.store, &lists, ExportFormat::Stance);
    assert_eq!(done.counts["masks_of_a_range"], 2);
    assert_eq!(done.counts["masks_of_own_joints"], 2);
    assert!(!done.counts.contains_key("masks_without_ring"));
    for (name, folder) in [("first", &first), ("lists", &lists)] {
        let store = empty_store(&site, &format!("{name}.sqlite"));
        take(&store, folder);
        assert_eq!(answers(&store), said);
        whole(&store);
    }
    let csv = write(&site, &site.store, "csv", ExportFormat::Csv);
    let csv = std::fs::read_to_string(csv.join("labels.csv")).expect("a file");
    assert!(csv.contains("\"\"range\"\":[9,40]"), "{csv}");

    commit_answers(&site, &site.store);
    let mut masks: Vec<MaskRow> = read(&site.dataset);
    masks.retain(|row| row.text_origin == "human");
    let ranges: Vec<_> = masks.iter().map(|row| (row.start, row.end)).collect();
    let expected = [(None, None), (Some(0), Some(31)), (Some(9), Some(40))];
    assert_eq!(ranges, expected);
    let store = fresh_store(&site, "of-dataset.sqlite");
    assert_eq!(answers(&store), said);

    // A mask whose range exceeds its clip, which is shorter now, is left out of the dataset.
    let source = site.store.task_record(task).expect("a task").source;
    let mut clip = site.store.all_motions().expect("motions");
    clip.retain(|motion| motion.hash == source);
    (clip[0].hash, clip[0].frames) = ("shorter".to_owned(), 35);
    let replaced = site.store.replace_motions(None, clip, START);
    replaced.expect("replaces");
    // Until the dataset has that content too, answers about the clip are left out.
    let done = write_to(&site, &site.store, &lists, ExportFormat::Dataset);
    assert_eq!(done.counts["clips_of_other_content"], 1);
    assert!(!done.counts.contains_key("masks_past_the_clip"));
    let mut clips: Vec<MotionRow> = read(&site.dataset);
    let clip = clips.iter_mut().find(|row| row.content_hash == source);
    clip.expect("a clip").content_hash = "shorter".to_owned();
    commit(&site.dataset, &clips, |row| row.split, "shorter");
    let done = write_to(&site, &site.store, &lists, ExportFormat::Dataset);
    assert_eq!(done.counts["masks_past_the_clip"], 1);
}

#[test]
fn the_dataset_takes_what_was_accepted_in_one_commit_and_a_new_store_takes_it_from_there() {
    let site = annotated();
    let store = site.store.as_ref();
    let run = |format| {
        let folder = site.folder.path().join("files");
        export(store, &site.dataset, &folder, &selection(format), "test")
    };
    let manifest = || {
        let dataset = Dataset::open(&site.dataset).expect("a dataset");
        dataset.manifest().clone()
    };
    let version = || manifest().version;
    let before = version();
    let held = Transaction::begin(&site.dataset, "another run").expect("a lock");
    let refused = run(ExportFormat::Dataset).expect_err("the dataset is locked");
    assert!(refused.to_string().contains("another run"), "{refused}");
    drop(held);
    assert_eq!(version(), before);
    let done = run(ExportFormat::Dataset).expect("exports");
    assert_eq!(version(), before + 1, "masks and pairs are one version");
    let facts = manifest().facts;
    assert_eq!(facts["annotate_store"], store.id().expect("an id"));
    assert_eq!(facts["annotate_seq"], done.seq.to_string());
    assert_eq!(done.seq, store.last_seq().expect("a place"));
    run(ExportFormat::Dataset).expect("exports");
    assert_eq!(version(), before + 1, "nothing is written again");
    let missing = site.folder.path().join("nowhere");
    let format = selection(ExportFormat::Dataset);
    assert!(export(store, &missing, &missing, &format, "test").is_err());
    assert!(!missing.exists(), "no folder is made of a typing error");

    let masks: Vec<MaskRow> = read(&site.dataset);
    assert_eq!(masks.len(), 3);
    assert_eq!(masks[0].id, "clip00#LEFT_ARM");
    assert_eq!(masks[0].soft_joints, ["left_collar"]);
    assert!(masks[2].soft_joints.is_empty(), "its ring was off");
    let human = masks.iter().all(|row| row.text_origin == "human");
    assert!(human, "the automatic mask was replaced");
    let pairs: Vec<PairRow> = read(&site.dataset);
    let judged = pairs.iter().filter(|pair| pair.source == "annotate");
    assert_eq!(judged.count(), 2);
    assert_eq!(pairs.len(), 9, "ten, less the unnatural one");

    let other = open_sqlite(&site.folder.path().join("third.sqlite")).expect("a store");
    take_dataset(&site, &other);
    let again = answers(&other);
    let key = "mask:clip00";
    assert_eq!(again[key], answers(store)[key]);
    assert_eq!(again.len(), 4);
    commit_answers(&site, &other);
    let bare = |mut rows: Vec<MaskRow>| {
        for row in &mut rows {
            row.author.clear();
        }
        rows
    };
    assert_eq!(bare(read(&site.dataset)), bare(masks));
}

#[test]
fn an_acceptance_that_was_taken_back_leaves_the_dataset() {
    let site = annotated();
    let store = site.store.as_ref();
    let export_it = || commit_answers(&site, store);
    let described = || -> BTreeSet<String> {
        let masks: Vec<MaskRow> = read(&site.dataset);
        masks.iter().map(|row| row.motion_id.to_string()).collect()
    };
    assert!(!export_it().counts.contains_key("taken_back"));
    reopen(store, "mask:clip00");
    reopen(store, "pair:fine-grained0");
    let done = export_it();
    assert_eq!(done.counts["taken_back"], 2 + 1, "two masks and a pair");
    let is_said = |message: &String| message.contains("taken back");
    assert!(done.messages.iter().any(is_said), "{:?}", done.messages);
    assert_eq!(described(), BTreeSet::from(["clip01".to_owned()]));
    assert!(!pair_rows(&site).contains_key("fine-grained0"));
    sound(&site);
    assert!(!export_it().counts.contains_key("taken_back"));

    // After an export of another store, only the author of a mask tells which store wrote it.
    let other = fresh_store(&site, "other.sqlite");
    judge(&other, "takes:clip12|clip13", Verdict::Keep);
    commit_answers(&site, &other);
    reopen(store, "mask:clip01");
    reopen(store, "pair:style10");
    let done = export_it();
    assert_eq!(done.counts["taken_back"], 1);
    assert_eq!(done.counts["taken_back_but_kept"], 1);
    assert_eq!(described(), BTreeSet::new());
    let kept = pair_rows(&site);
    assert!(kept.contains_key("style10") && kept.contains_key("takes:clip12|clip13"));
    sound(&site);
}

/// Checks that `stance verify` finds nothing wrong with the dataset.
fn sound(site: &Site) {
    let found = pipeline::verify::verify(&site.dataset, &datasets_spec::NoProgress);
    assert_eq!(found.expect("a dataset").findings, Vec::new());
}

#[test]
fn an_import_never_touches_an_answer_of_a_person_and_reports_the_conflict() {
    let site = annotated();
    let first = write(&site, &site.store, "first", ExportFormat::Parquet);
    let store = fresh_store(&site, "other.sqlite");
    let bob = join(&store, "bob", Role::Annotator);
    let eve = join(&store, "eve", Role::Reviewer);
    // clip00 has another accepted answer, clip01 the same one, clip02 a draft.
    let theirs = answers(&site.store);
    let accepted = answer_in(&store, bob, Some(masks("sitting")));
    accept_in(&store, eve);
    let same = answer_in(&store, bob, Some(theirs["mask:clip01"].clone()));
    accept_in(&store, eve);
    let draft = answer_in(&store, bob, None);
    let record = |task: i64| store.task_record(task).expect("a task");
    let keys = [accepted, same, draft].map(|task| record(task).key);
    assert_eq!(keys, ["mask:clip00", "mask:clip01", "mask:clip02"]);
    let taken = take(&store, &first);
    for (name, count) in [("filled_tasks", 3), ("known_tasks", 1), ("conflicts", 2)] {
        assert_eq!(taken.counts[name], count, "{name}");
    }
    for key in ["mask:clip00", "mask:clip02"] {
        let mut messages = taken.messages.iter();
        let is_said = messages.any(|message| message.contains(key));
        assert!(is_said, "{:?}", taken.messages);
    }
    let ours = answers(&store);
    assert_eq!(ours["mask:clip00"], masks("sitting"));
    assert!(!ours.contains_key("mask:clip02"));
    assert_eq!(record(draft).state, TaskState::Leased);
    // The file does not fill a task that a reviewer reopened.
    let kept = ours.keys().find(|key| key.starts_with("pair:"));
    let reopened = kept.expect("a pair");
    reopen(&store, reopened);
    let taken = take(&store, &first);
    assert_eq!(taken.counts["conflicts"], 3);
    assert_eq!(task_of(&store, reopened).state, TaskState::Open);
    whole(&store);
}

fn pair_rows(site: &Site) -> BTreeMap<String, PairRow> {
    let rows: Vec<PairRow> = read(&site.dataset);
    let count = rows.len();
    let by_id = rows.into_iter().map(|row| (row.id.clone(), row));
    let by_id = BTreeMap::from_iter(by_id);
    assert_eq!(by_id.len(), count, "every id is there once");
    by_id
}
