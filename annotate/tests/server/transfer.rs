//! Import and export: an import of exported files gives the same answers.

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
fn a_job_exports_files_to_download_and_splits_are_kept_apart() {
    let site = annotated();
    let boss = site.person("boss");
    let job: Job = boss.post("exports", &json!({ "format": "csv" })).ok();
    let job = finished(&boss, job.id);
    assert_eq!(job.state, "done");
    assert_eq!(job.files, ["labels.csv", "export.json"]);
    let answered = boss.get(&format!("jobs/{}/files/labels.csv", job.id));
    let disposition = answered.header("content-disposition");
    assert_eq!(disposition, Some("attachment; filename=\"labels.csv\""));
    assert!(answered.text().starts_with("task,kind"));
    let job: Job = boss.call("POST", "imports?format=dataset", Some(b"")).ok();
    let job = finished(&boss, job.id);
    assert_eq!(job.state, "done");
    assert_eq!(job.counts["new_tasks"], 0);
    let audit: Audit = boss.get("audit?kind=exported").ok();
    assert_eq!(audit.entries.len(), 1);
    let holdout = json!({ "format": "csv", "splits": ["holdout"] });
    assert_eq!(boss.post("exports", &holdout).code(), Code::Invalid);

    let folder = site.folder.path().join("test-split");
    let only = ExportRequest {
        splits: vec!["test".to_owned()],
        ..selection(ExportFormat::Parquet)
    };
    let run = |what: &ExportRequest| export(&site.store, &site.dataset, &folder, what, "test");
    // Only the answers of the chosen splits are counted, each once.
    let accepted = |done: &Exported| -> Vec<(String, i64)> {
        let mut counts = done.counts.clone();
        counts.retain(|name, _| name.starts_with("accepted_by "));
        counts.into_iter().collect()
    };
    let by_review = [("accepted_by review".to_owned(), 6_i64)];
    for format in [
        ExportFormat::Csv,
        ExportFormat::Stance,
        ExportFormat::Parquet,
    ] {
        let all = run(&selection(format)).expect("exports");
        assert_eq!(accepted(&all), by_review, "{format}");
        let none = run(&ExportRequest {
            format,
            ..only.clone()
        });
        assert!(accepted(&none.expect("exports")).is_empty(), "{format}");
    }
    let rows: Vec<AnnotationRow> = rows(&folder, "annotations");
    assert!(rows.is_empty(), "all answers are of the training split");
    // A pair of a training and a test clip is left out.
    let motions = site.store.all_motions().expect("motions");
    let of = |split: &str| {
        let mut of_split = motions.iter().filter(|motion| motion.split == split);
        of_split.next().expect("a motion").hash.clone()
    };
    let task = NewTask {
        source: of("train"),
        target: Some(of("test")),
        accepted: Some(pair(Verdict::Keep)),
        ..bare_task(1, TaskKind::Pair)
    };
    let imported = site.store.import(None, vec![task], START + MINUTE);
    imported.expect("a task");
    let done = run(&selection(ExportFormat::Parquet)).expect("exports");
    assert_eq!(done.counts["pairs_across_splits"], 1);
    assert_eq!(accepted(&done), by_review);
    let rows: Vec<AnnotationRow> = self::rows(&folder, "annotations");
    assert!(
        rows.iter()
            .all(|row| row.split == "train" && row.task != "task000001")
    );
}

#[test]
fn a_clip_in_another_split_takes_its_answers_along() {
    let site = annotated();
    let store = site.store.as_ref();
    let mut clips: Vec<MotionRow> = read(&site.dataset);
    let clip = clips.iter_mut().find(|row| row.id.as_str() == "clip00");
    let clip = clip.expect("a clip");
    clip.split = Split::Test;
    clip.style = Some("old".to_owned());
    commit(&site.dataset, &clips, |row| row.split, "another seed");
    let mut pairs: Vec<PairRow> = pair_rows(&site).into_values().collect();
    pairs.retain(|pair| pair.id != "fine-grained0");
    commit(&site.dataset, &pairs, |row| row.split, "pairs anew");

    // The dataset tells the splits, also before it is imported again.
    let folder = site.folder.path().join("files");
    let done = write_to(&site, store, &folder, ExportFormat::Dataset);
    assert_eq!(done.counts["pairs_across_splits"], 1);
    let is_said = |message: &String| message.contains("pair:fine-grained0");
    assert!(done.messages.iter().any(is_said), "{:?}", done.messages);
    let masks: Vec<MaskRow> = read(&site.dataset);
    let mut of_clip = masks
        .iter()
        .filter(|row| row.motion_id.as_str() == "clip00");
    assert!(of_clip.all(|row| row.split == Split::Test), "{masks:?}");
    assert!(!pair_rows(&site).contains_key("fine-grained0"));
    sound(&site);

    let taken = take_dataset(&site, store);
    assert_eq!(taken.counts["corrected_clips"], 1);
    let is_said = |message: &String| message.contains("clip00");
    assert!(taken.messages.iter().any(is_said), "{:?}", taken.messages);
    let mut known = store.all_motions().expect("motions").into_iter();
    let known = known
        .find(|motion| motion.id == "clip00")
        .expect("a motion");
    assert_eq!(
        (known.split.as_str(), known.style.as_deref()),
        ("test", Some("old"))
    );
    assert_eq!(task_of(store, "mask:clip00").split, "test");
    let done = write_to(&site, store, &folder, ExportFormat::Parquet);
    assert_eq!(done.counts["pairs_across_splits"], 1);
    let rows: Vec<AnnotationRow> = rows(&folder, "annotations");
    let of = |task: &str| -> Vec<&str> {
        let of_task = rows.iter().filter(|row| row.task == task);
        of_task.map(|row| row.split.as_str()).collect()
    };
    assert_eq!(of("mask:clip00"), ["test", "test"]);
    assert_eq!(of("mask:clip01"), ["train"]);
    assert_eq!(of("pair:fine-grained0"), Vec::<&str>::new());
    assert!(
        !take_dataset(&site, store)
            .counts
            .contains_key("corrected_clips")
    );
    whole(store);
}

#[test]
fn a_rejection_holds_for_its_clips_until_it_is_taken_back() {
    let site = annotated();
    let store = site.store.as_ref();
    let mut pairs: Vec<PairRow> = read(&site.dataset);
    let clips = |row: &PairRow| [row.source_id.clone(), row.target_id.clone()];
    let places = ["fine-grained0", "fine-grained1", "fine-grained5"]
        .map(|id| pairs.iter().position(|pair| pair.id == id).expect("a pair"));
    let [kept, rejected, other] = places;
    let [before, theirs] = [rejected, other].map(|place| clips(&pairs[place]));
    let listed = || -> Vec<(String, [MotionId; 2])> {
        let dataset = Dataset::open(&site.dataset).expect("a dataset");
        let all = dataset
            .manifest()
            .rejected_pairs()
            .expect("a list")
            .into_iter();
        all.flat_map(|(store, pairs)| pairs.into_iter().map(move |pair| (store.clone(), pair)))
            .collect()
    };

    // `stance pairs` with another seed gives the ids of judged pairs to other clips.
    for place in [kept, rejected] {
        pairs[place].source_id = theirs[0].clone();
        pairs[place].target_id = theirs[1].clone();
    }
    pairs.remove(other);
    commit(&site.dataset, &pairs, |row| row.split, "another seed");
    let done = commit_answers(&site, store);
    assert_eq!(done.counts["replaced"], 1, "{done:?}");
    let rows = pair_rows(&site);
    assert_eq!(clips(&rows["fine-grained1"]), theirs);
    assert_eq!(rows["fine-grained0"].source, "annotate");
    let own = done.store.clone();
    assert_eq!(listed(), [(own.clone(), before.clone())]);

    // The rejection of another project stays when it is taken back here.
    let second = fresh_store(&site, "second.sqlite");
    judge(&second, "pair:fine-grained1", Verdict::Unnatural);
    let theirs = commit_answers(&site, &second).store;
    assert_eq!(listed().len(), 2);
    reopen(store, "pair:fine-grained1");
    commit_answers(&site, store);
    let stores: Vec<String> = listed().into_iter().map(|(store, _)| store).collect();
    assert_eq!(stores, [theirs]);
    sound(&site);
}

#[test]
fn projects_that_judge_a_pair_differently_say_so_at_each_export() {
    const OVER: [&str; 2] = ["pairs_accepted_over_others", "pairs_rejected_over_others"];
    let site = annotated();
    let counted = |store: &Store| {
        let counts = commit_answers(&site, store).counts;
        OVER.map(|what| counts.get(what).copied().unwrap_or_default())
    };
    let first = site.store.as_ref();
    let second = fresh_store(&site, "second.sqlite");
    let third = fresh_store(&site, "third.sqlite");
    judge(&second, "pair:fine-grained0", Verdict::Unnatural);
    let mut said = pair(Verdict::Keep);
    if let Answer::Pair { text, .. } = &mut said {
        "another text".clone_into(text);
    }
    let task = task_of(&third, "pair:fine-grained0");
    let worded = NewTask {
        key: task.key,
        source: task.source,
        target: task.target,
        accepted: Some(said),
        ..bare_task(0, TaskKind::Pair)
    };
    third.import(None, vec![worded], START).expect("imports");
    assert_eq!(counted(first), [0, 0]);
    assert_eq!(counted(&second), [0, 1]);
    assert_eq!(counted(first), [1, 0]);
    assert_eq!(counted(first), [0, 0], "nobody judged in between");
    assert_eq!(counted(&second), [0, 1]);
    assert_eq!(counted(first), [1, 0]);
    let reworded =
        |store: &Store| commit_answers(&site, store).counts["pairs_reworded_over_others"];
    assert_eq!(reworded(&third), 1);
    assert_eq!(reworded(first), 1);
    assert_eq!(counted(&second), [0, 1]);

    // The manifest names the pairs that people rejected, and candidates are none yet.
    let lost = |store: &Store| {
        let counts = commit_answers(&site, store).counts;
        counts.get("left_out_rejected_candidates").copied()
    };
    assert_eq!(lost(&second), None);
    judge(&second, "takes:clip12|clip13", Verdict::Unnatural);
    assert_eq!(lost(&second), Some(1));
    sound(&site);
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

#[test]
fn an_answer_about_other_clips_than_the_task_of_its_key_fills_no_task() {
    let site = Site::new();
    let store = site.store.as_ref();
    let key = |number: usize| format!("pair:fine-grained{number}");
    let before = [0, 1, 2].map(|number| task_of(store, &key(number)));
    // `stance pairs` with another seed gives known ids to other sources.
    let mut pairs: Vec<PairRow> = read(&site.dataset);
    for pair in &mut pairs {
        if (0..3).any(|number| key(number) == format!("pair:{}", pair.id)) {
            pair.source_id = MotionId::parse("clip12").expect("an id");
        }
    }
    commit(&site.dataset, &pairs, |row| row.split, "another seed");
    // Another project judges them, and a pair of the same clips as here.
    let second = fresh_store(&site, "second.sqlite");
    for (number, verdict) in [
        (0, Verdict::Keep),
        (1, Verdict::Unnatural),
        (4, Verdict::Keep),
    ] {
        judge(&second, &key(number), verdict);
    }
    let counted = |taken: &Taken, names: [&str; 2]| names.map(|name| taken.counts[name]);
    let names_others = |taken: &Taken, numbers: &[usize]| {
        assert_eq!(taken.counts["tasks_of_other_clips"], numbers.len() as i64);
        let mut messages = taken.messages.iter();
        let said = messages.find(|message| message.contains("other clips"));
        let said = said.unwrap_or_else(|| panic!("{:?}", taken.messages));
        assert!(said.contains("--store"), "{said}");
        for number in 0..3 {
            let is_named = said.contains(&key(number));
            assert_eq!(is_named, numbers.contains(&number), "{said}");
        }
    };

    // The files of the other project fill the task about the same clips alone.
    let table = write(&site, &second, "table", ExportFormat::Parquet);
    let lists = write(&site, &second, "lists", ExportFormat::Stance);
    let mut lists_as_one = release(&lists);
    lists_as_one["pairs"] = read_json(lists.join("pairs.json"));
    let same = BTreeMap::from([(key(4), pair(Verdict::Keep))]);
    let taken = take(store, &table);
    assert_eq!(counted(&taken, ["filled_tasks", "conflicts"]), [1, 2]);
    names_others(&taken, &[0, 1]);
    assert_eq!(answers(store), same);
    let taken = from_release(store, &lists_as_one, None, START).expect("takes");
    assert_eq!(counted(&taken, ["filled_tasks", "conflicts"]), [0, 1]);
    names_others(&taken, &[0]);
    assert_eq!(answers(store), same);

    // The dataset with its answers fills no other. A pair of other clips that nobody has judged is not a known task.
    commit_answers(&site, &second);
    let of_second = pair_rows(&site);
    let taken = take_dataset(&site, store);
    assert_eq!(counted(&taken, ["new_tasks", "filled_tasks"]), [0, 0]);
    names_others(&taken, &[0, 2]);
    assert_eq!(take_dataset(&site, store), taken, "the same each time");
    assert_eq!(answers(store), same);
    for task in before {
        assert_eq!(task_of(store, &task.key), task);
    }
    commit_answers(&site, store);
    let clips = |rows: BTreeMap<String, PairRow>| -> Vec<(String, MotionId, MotionId)> {
        let rows = rows.into_values();
        rows.map(|row| (row.id, row.source_id, row.target_id))
            .collect()
    };
    assert_eq!(clips(pair_rows(&site)), clips(of_second));
    // A new project has these answers as labels of the dataset. The table names no authors, so it replaces none.
    let third = fresh_store(&site, "third.sqlite");
    let taken = take(&third, &table);
    let counts = ["known_tasks", "filled_tasks", "new_tasks", "conflicts"];
    assert_eq!(counts.map(|name| taken.counts[name]), [2, 0, 1, 0]);
    assert_eq!(answers(&third), answers(&second));
    whole(store);
}

#[test]
fn an_answer_fills_the_task_of_a_pair_whose_clip_was_ingested_anew() {
    let site = Site::new();
    let store = site.store.as_ref();
    let key = "pair:fine-grained4";
    let second = fresh_store(&site, "second.sqlite");
    judge(&second, key, Verdict::Keep);
    let table = write(&site, &second, "table", ExportFormat::Parquet);
    ingest_anew(&site, &[(4, 34)], "anew");
    let taken = take_dataset(&site, store);
    assert_eq!(taken.counts["changed_motions"], 1);
    assert!(
        !taken.counts.contains_key("tasks_of_other_clips"),
        "{taken:?}"
    );
    let old = site.folder.path().join("old.parquet");
    let taken = take_without_hashes(store, &rows::<AnnotationRow>(&table, "annotations"), &old);
    assert_eq!(taken.counts["filled_tasks"], 1);
    assert_eq!(taken.counts["conflicts"], 0);
    assert!(answers(store).contains_key(key));
    whole(store);
}

fn pair_rows(site: &Site) -> BTreeMap<String, PairRow> {
    let rows: Vec<PairRow> = read(&site.dataset);
    let count = rows.len();
    let by_id = rows.into_iter().map(|row| (row.id.clone(), row));
    let by_id = BTreeMap::from_iter(by_id);
    assert_eq!(by_id.len(), count, "every id is there once");
    by_id
}

#[test]
fn candidates_are_made_of_every_clip_and_variants_of_a_motion_are_no_mask_tasks() {
    let site = Site::new();
    // Eighteen clips of one action and split make seventeen candidates, minus ten existing pairs; two clips of the
    // other split make one.
    let again = take_dataset(&site, &site.store);
    assert_eq!(again.counts["candidates"], 8);
    assert_eq!(again.counts["new_tasks"], 0);
    let task = |key: &str| task_of(&site.store, key);
    assert_eq!(task("takes:clip16|clip17").kind, TaskKind::Pair);
    assert_eq!(task("takes:clip18|clip19").split, "test");
    // Pairs made for an instruction come first.
    assert!(task("pair:fine-grained8").id < task("takes:clip09|clip10").id);

    let mut pairs: Vec<PairRow> = pair_rows(&site).into_values().collect();
    let variant = pairs.iter_mut().find(|pair| pair.id == "fine-grained3");
    variant.expect("a pair").source = "variants-1".to_owned();
    commit(&site.dataset, &pairs, |row| row.split, "variants");
    let store = empty_store(&site, "other.sqlite");
    let taken = take_dataset(&site, &store);
    assert_eq!(taken.counts["variants"], 2, "clip03 and clip04");
    let funnel = store.funnel().expect("counts");
    let masks = funnel.iter().filter(|row| row.0 == TaskKind::MaskText);
    assert_eq!(masks.map(|row| row.2).sum::<i64>(), CLIPS as i64 - 2);
}

#[test]
fn pairs_of_a_later_import_make_bundles_of_their_own() {
    let site = Site::new();
    let all: Vec<PairRow> = pair_rows(&site).into_values().collect();
    let store = empty_store(&site, "later.sqlite");
    let some: Vec<PairRow> = all.iter().skip(1).step_by(2).cloned().collect();
    for rows in [&some, &all] {
        commit(
            &site.dataset,
            rows,
            |row| row.split,
            &rows.len().to_string(),
        );
        take_dataset(&site, &store);
    }
    let tasks = (1..500).filter_map(|id| store.task_record(id).ok());
    let places = tasks.filter_map(|task| Some((task.bundle?, task.bundle_index)));
    let places: Vec<(i64, i64)> = places.collect();
    assert!(places.iter().all(|(_, index)| (0..8).contains(index)));
    let different: BTreeSet<_> = places.iter().collect();
    assert_eq!(different.len(), places.len(), "{places:?}");
}

#[test]
fn a_clip_that_repeats_another_one_now_has_lost_its_content() {
    let site = Site::new();
    let store = fresh_store(&site, "repeated.sqlite");
    let mut motions: Vec<MotionRow> = read(&site.dataset);
    motions[1] = MotionRow {
        id: motions[1].id.clone(),
        ..motions[0].clone()
    };
    commit(&site.dataset, &motions, |row| row.split, "repeated");
    let taken = take_dataset(&site, &store);
    assert_eq!(taken.counts["clips_gone"], 1, "{:?}", taken.messages);
}

#[test]
fn a_pair_that_one_project_rejected_is_no_candidate_of_another() {
    let site = annotated();
    let candidates =
        |name: &str| take_dataset(&site, &empty_store(&site, name)).counts["candidates"];
    let before = candidates("before.sqlite");
    assert!(pair_rows(&site).contains_key("fine-grained1"));
    commit_answers(&site, &site.store);
    assert!(!pair_rows(&site).contains_key("fine-grained1"));
    assert_eq!(candidates("after.sqlite"), before);
}

#[test]
fn a_candidate_keeps_its_key_and_leaves_the_pairs_when_it_is_judged_unusable() {
    let site = Site::new();
    let store = site.store.as_ref();
    let id = "takes:clip18|clip19";
    let [ann, eve] = site.people(["ann", "eve"]);
    for _ in 0..9 {
        ann.answer(pair(Verdict::Unclear));
    }
    ann.answer(pair(Verdict::Keep));
    assert_eq!(eve.accept_all(), 10);
    assert!(answers(store).contains_key(id));
    commit_answers(&site, store);
    let row = pair_rows(&site)[id].clone();
    assert_eq!(row.source, "annotate");
    assert_eq!(row.edit_type.as_deref(), Some("amplitude"));
    sound(&site);
    // The store imports the dataset again, as a server does at its start.
    assert_eq!(take_dataset(&site, store).counts["new_tasks"], 0);
    // A new store gives the pair the same key, with the whole answer.
    let other = fresh_store(&site, "other.sqlite");
    let whole_answer = BTreeMap::from([(id.to_owned(), pair(Verdict::Keep))]);
    assert_eq!(answers(&other), whole_answer);
    let before = pair_rows(&site);
    commit_answers(&site, &other);
    assert_eq!(pair_rows(&site), before);
    // If the pair is then judged unusable, it is removed from the dataset.
    let task = task_of(store, id).id;
    let why = json!({ "comment": "look again" });
    let reopened = eve.decide(task, 0, Decision::Reopen, why);
    assert_eq!(reopened.status, 200);
    let review = eve.review().expect("a task to review");
    assert_eq!(review.task.id, task);
    let unnatural = json!({ "answer": pair(Verdict::Unnatural) });
    let merged = eve.decide(task, review.lease.epoch, Decision::Merge, unnatural);
    assert_eq!(merged.status, 200);
    commit_answers(&site, store);
    assert!(!pair_rows(&site).contains_key(id));
}

#[test]
fn two_tasks_of_one_candidate_in_an_old_store_make_one_pair() {
    let site = Site::new();
    let store = site.store.as_ref();
    let candidate = "takes:clip09|clip10";
    let first = task_of(store, candidate);
    let accept = |key: &str, verdict| {
        let done = import_judged(store, key, &first, verdict);
        assert_eq!(done.conflicts, Vec::<String>::new());
        commit_answers(&site, store);
        pair_rows(&site).contains_key(candidate)
    };
    assert!(accept(candidate, Verdict::Keep));
    // An earlier version imported a candidate from the dataset under a second key. The later decision counts.
    assert!(!accept("pair:takes:clip09|clip10", Verdict::Unclear));
}

#[test]
fn an_export_is_one_point_in_time_and_its_log_names_nobody() {
    use std::sync::atomic::{AtomicBool, Ordering};
    let site = annotated();
    let store = site.store.as_ref();
    set(store, |settings| {
        settings.rules = vec![Rule {
            people: vec![user_id(store, "ann")],
            ..rule("trusted", RuleKind::Trusted)
        }];
    });
    let folder = write(&site, store, "files", ExportFormat::Parquet);
    let events: Vec<EventRow> = rows(&folder, "events");
    let id = store.id().expect("an id");
    let ann = format!("a002-{}", &id[..6]);
    let mut kinds = BTreeSet::new();
    for event in &events {
        let body: Value = serde_json::from_str(&event.body).expect("JSON");
        for name in ["ann", "eve", "root"] {
            let named = event.body.contains(&format!("\"{name}\""));
            assert!(!named, "{}", event.body);
        }
        for value in ["user", "author"]
            .iter()
            .filter_map(|field| body.get(field))
        {
            kinds.insert(event.kind.as_str());
            let is_pseudonym = value.as_str().is_some_and(|text| text.starts_with('a'));
            assert!(is_pseudonym, "{}", event.body);
        }
    }
    for kind in ["role_changed", "accepted"] {
        assert!(kinds.contains(kind), "{kinds:?}");
    }
    for kind in ["accepted", "settings_changed"] {
        let entry = events.iter().rfind(|event| event.kind == kind);
        let entry = entry.expect("an entry");
        assert!(entry.body.contains(&ann), "{}", entry.body);
    }
    let labels: Vec<LabelRow> = rows(&folder, "labels");
    assert!(labels.iter().all(|label| label.author == ann));

    let frozen = store.snapshot().expect("a snapshot");
    let (seq, count) = (store.last_seq().expect("a place"), answers(store).len());
    let first = task_of(store, "takes:clip09|clip10");
    let import = |number: usize| {
        let key = format!("task{number:06}");
        import_judged(store, &key, &first, Verdict::Unclear)
    };
    import(0);
    assert_eq!(answers(store).len(), count + 1);
    assert_eq!(answers(&frozen).len(), count);
    assert_eq!(frozen.last_seq().expect("a place"), seq);
    let refused = frozen.import(None, vec![bare_task(1, TaskKind::Pair)], START);
    assert!(refused.is_err());
    // Every unusable pair is in both tables, even while more are added.
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut numbers = 1..;
            while !stop.load(Ordering::Relaxed) {
                import(numbers.next().expect("a number"));
            }
        });
        for number in 0..10 {
            let folder = format!("export{number}");
            let folder = write(&site, store, &folder, ExportFormat::Parquet);
            let rejects: Vec<RejectRow> = rows(&folder, "rejects");
            let annotations: Vec<AnnotationRow> = rows(&folder, "annotations");
            let verdicts = annotations.iter().map(|row| row.verdict.as_deref());
            let unclear = verdicts.filter(|verdict| *verdict == Some("unclear"));
            let listed = rejects.iter().filter(|row| row.reason == "unclear");
            assert_eq!(unclear.count(), listed.count());
            let stamp = read_json(folder.join("export.json"));
            assert_eq!(stamp["store"], id);
            let events: Vec<EventRow> = rows(&folder, "events");
            assert_eq!(stamp["seq"].as_u64(), events.last().map(|event| event.seq));
            assert_eq!(stamp["counts"]["annotations"], annotations.len());
        }
        stop.store(true, Ordering::Relaxed);
    });
}

/// Replaces the content of clips of the site's dataset.
fn ingest_anew(site: &Site, content: &[(usize, usize)], plan: &str) {
    let mut rows: Vec<MotionRow> = read(&site.dataset);
    for (clip, variant) in content {
        let id = format!("clip{clip:02}");
        let row = rows.iter_mut().find(|row| row.id.as_str() == id);
        let row = row.expect("a clip");
        *row = motion_row(&id, row.split, &motion(*variant));
    }
    commit(&site.dataset, &rows, |row| row.split, plan);
}

#[test]
fn a_clip_that_was_ingested_anew_stops_nobody_and_its_tasks_ask() {
    let site = annotated();
    let store = site.store.as_ref();
    let hash = |clip: &str| {
        let mut all = store.all_motions().expect("motions").into_iter();
        all.find(|motion| motion.id == clip).expect("a clip").hash
    };
    let [ann, eve] = ["ann", "eve"].map(|name| user_id(store, name));
    let (before, untouched) = (hash("clip00"), hash("clip05"));
    let draft = answer_in(store, ann, None);
    assert_eq!(store.task_record(draft).expect("a task").key, "mask:clip03");
    let boss = site.person("boss");
    let is_shown = |hash: &str| boss.get(&format!("motions/{hash}/joints")).status == 200;
    assert!(is_shown(&untouched) && !is_shown("unknown"));
    ingest_anew(&site, &[(0, 30), (3, 33), (5, 35)], "anew");
    let taken = take_dataset(&site, store);
    assert_eq!(taken.counts["changed_motions"], 3);
    assert_eq!(taken.counts["new_tasks"], 0);
    let is_said = |message: &String| message.contains("changed");
    assert!(taken.messages.iter().any(is_said), "{:?}", taken.messages);
    assert_ne!(hash("clip00"), before);
    assert_ne!(hash("clip05"), untouched);
    // The server that is running shows the new content.
    assert!(is_shown(&hash("clip05")) && !is_shown("unknown"));
    let asking = || {
        let tasks = store.changed_tasks().expect("tasks").into_iter();
        tasks.map(|task| task.key).collect::<Vec<_>>()
    };
    let three = ["mask:clip00", "mask:clip03", "pair:fine-grained0"];
    assert_eq!(asking(), three);
    // A task without answers gets the new content, and needs no decision.
    assert_eq!(task_of(store, "mask:clip05").source, hash("clip05"));
    let detail = store.task(&who(ann, Role::Annotator), draft);
    let detail = detail.expect("a task");
    assert!(detail.clip_changed, "{detail:?}");
    assert!(detail.comment.is_none(), "{detail:?}");
    whole(store);
    // The export counts the answers that were accepted before their clip changed.
    let folder = site.folder.path().join("f");
    let done = write_to(&site, store, &folder, ExportFormat::Csv);
    assert_eq!(done.counts["accepted_before_clip_changed"], 2);
    // An answer to the new content, or a decision, ends the need for a decision.
    answer_in(store, ann, Some(masks("nodding")));
    assert_eq!(asking(), ["mask:clip00", "pair:fine-grained0"]);
    let settle = |key: &str, keeps: bool| {
        let task = task_of(store, key).id;
        let settled = store.settle_changed(None, &[task], keeps, START);
        settled.expect("settles");
        task_of(store, key).state
    };
    assert_eq!(settle("mask:clip00", true), TaskState::Accepted);
    assert_eq!(asking(), ["pair:fine-grained0"]);
    assert_eq!(settle("pair:fine-grained0", false), TaskState::Submitted);
    let pairs = Some(TaskKind::Pair);
    let next = store.review_next(eve, ReviewQueue::Sample, pairs, START);
    let Ok(review) = next.expect("claims") else {
        panic!("a task to review")
    };
    assert!(review.task.changed);
    // Two clips exchange their content: each task follows its clip.
    let (old6, old7) = (hash("clip06"), hash("clip07"));
    ingest_anew(&site, &[(6, 7), (7, 6)], "swapped");
    take_dataset(&site, store);
    assert_eq!(
        [hash("clip06"), hash("clip07")],
        [old7.clone(), old6.clone()]
    );
    assert_eq!(task_of(store, "mask:clip06").source, old7);
    let between = task_of(store, "pair:fine-grained6");
    assert_eq!((between.source, between.target), (old7, Some(old6)));
    whole(store);
}

/// Exports many tasks in every layout. A short version runs with the other tests; this command prints time and memory
/// of a large export:
///
/// ```sh
/// ANNOTATE_EXPORT=50000 cargo test --release --workspace --test server many_tasks -- --nocapture
/// ```
#[test]
fn many_tasks_are_written_as_they_are_read() {
    let count =
        std::env::var("ANNOTATE_EXPORT").map_or(5000, |count| count.parse().expect("a number"));
    let site = Site::new();
    for count in [count / 10, count] {
        let store = open_sqlite(&site.folder.path().join(format!("{count}.db"))).expect("a store");
        let hash = |number: usize| format!("hash{number:06}");
        let motions = (0..count).map(|number| MotionRecord {
            hash: hash(number),
            id: format!("motion{number:06}"),
            ..bare_motion()
        });
        store.put_motions(motions.collect()).expect("motions");
        let tasks = (0..count).map(|number| {
            let mut task = bare_task(number, TaskKind::MaskText);
            task.source = hash(number);
            task.accepted = Some(masks(&format!("waving {number}")));
            task
        });
        store.import(None, tasks.collect(), START).expect("tasks");
        for format in [
            ExportFormat::Parquet,
            ExportFormat::Stance,
            ExportFormat::Csv,
        ] {
            let before = peak_memory_mb().and(peak_memory_mb());
            let begun = std::time::Instant::now();
            let folder = site.folder.path().join(format!("{count}{format:?}"));
            let found = write_to(&site, &store, &folder, format).counts;
            let secs = begun.elapsed().as_secs_f64();
            let peak = peak_memory_mb();
            let per_task = |what: &str, each: usize| {
                assert_eq!(found.get(what), Some(&((each * count) as i64)), "{what}");
            };
            match format {
                ExportFormat::Parquet => {
                    per_task("annotations", 2);
                    let rows: Vec<AnnotationRow> = rows(&folder, "annotations");
                    assert!(rows.is_sorted_by_key(|row| (row.task.clone(), row.number)));
                    assert_eq!(rows.len(), 2 * count);
                }
                ExportFormat::Stance => {
                    per_task("motions", 1);
                    let said = read_json(folder.join("mask_all.json"));
                    let said: BTreeMap<String, Vec<String>> = from_json(said);
                    assert_eq!(said.len(), count);
                }
                ExportFormat::Csv | ExportFormat::Dataset => per_task("labels", 0),
            }
            say(&format!(
                "{count} tasks as {format:?}: {secs:.2} s, {before:?} MB before, peak {peak:?} MB"
            ));
        }
    }
}

#[test]
fn rules_and_bulk_acceptance_leave_answers_to_an_earlier_motion_to_reviewers() {
    let site = Site::new();
    let store = site.store.as_ref();
    let [bob, eve] = [("bob", Role::Annotator), ("eve", Role::Reviewer)]
        .map(|(name, role)| join(store, name, role));
    let tasks = [(); 2].map(|()| answer_in(store, bob, Some(masks("sitting"))));
    let record = |task: i64| store.task_record(task).expect("a task");
    assert_eq!(
        tasks.map(|task| record(task).key),
        ["mask:clip00", "mask:clip01"]
    );
    ingest_anew(&site, &[(0, 30)], "anew");
    take_dataset(&site, store);
    set(store, |settings| {
        settings.rules = vec![Rule {
            review_percent: 0,
            ..rule("all", RuleKind::Sampled)
        }];
    });
    let who = who(eve, Role::Reviewer);
    let accept = json!({ "action": "accept", "filter": {}, "comment": "" });
    let counted = store.preview_bulk(&who, from_json(accept.clone()), START);
    let counted = counted.expect("counts");
    assert_eq!((counted.done, counted.left_alone["clip_changed"]), (1, 1));
    let done = store.apply_rules(0, START).expect("applies");
    assert_eq!(done.accepted["all"], 1);
    let done = store.bulk(&who, from_json(accept), START).expect("acts");
    assert_eq!((done.done, done.left_alone["clip_changed"]), (0, 1));
    assert_eq!(record(tasks[0]).state, TaskState::Submitted);
    assert_eq!(record(tasks[1]).state, TaskState::Accepted);
    let changed = store.changed_tasks().expect("tasks");
    assert_eq!(changed.len(), 1, "the mark stays");
}
