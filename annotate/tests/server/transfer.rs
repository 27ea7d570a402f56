//! Import and export: exported files can be imported unchanged.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use annotate::store::{
    AcceptedAnswer, KeyRange, MotionRecord, NewTask, Store, TaskRecord, Who, open_sqlite,
};
use annotate::transfer::{
    AnnotationRow, EventRow, LabelRow, RejectRow, Taken, export, from_annotations, from_dataset,
    from_release,
};
use annotate::wire::{
    Answer, CountReason, Decision, EventKind, ExportFormat, ExportRequest, Job, NewReview,
    ReviewNext, ReviewQueue, Role, TaskKind, TaskState, Verdict,
};
use datasets_spec::dataset::{Transaction, commit_rows};
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::read_rows;
use datasets_spec::{Dataset, Split};
use serde_json::json;

use crate::support::{
    CLIPS, Client, MINUTE, START, Site, all_keys, bare_motion, bare_task, event, key, masks,
    motion, motion_row, pair, peak_memory_mb, plain_settings, style,
};

/// Waits for a job to end.
pub(crate) fn finished(admin: &Client, id: i64) -> Job {
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(60);
    loop {
        let job: Job = admin.get(&format!("jobs/{id}")).ok();
        if job.state != "running" {
            return job;
        }
        assert!(
            std::time::Instant::now() < deadline,
            "job {id} does not end"
        );
        std::thread::yield_now();
    }
}

fn accept_all(eve: &Client) -> usize {
    let mut accepted = 0;
    loop {
        let next: ReviewNext = eve.post("review/next", &json!({ "queue": "sample" })).ok();
        let Some(review) = next.review else {
            return accepted;
        };
        let done = eve.post(
            "reviews",
            &json!({ "idem_key": key(), "task": review.task.id, "lease_epoch": review.lease.epoch,
                     "decision": Decision::Accept, "author": review.candidates[0].revision.author }),
        );
        assert_eq!(done.status, 200);
        accepted += 1;
    }
}

/// A server with one accepted answer of each kind.
fn annotated() -> Site {
    let site = Site::new();
    let (ann, eve) = (
        site.person("ann", Role::Annotator),
        site.person("eve", Role::Reviewer),
    );
    ann.answer(TaskKind::MaskText, masks("waving"));
    let Answer::MaskText { masks: list, .. } = masks("a, \"quoted\"\ntext") else {
        unreachable!("masks makes masks")
    };
    let mut one = list[..1].to_vec();
    one[0].soft = false;
    ann.answer(
        TaskKind::MaskText,
        Answer::MaskText {
            masks: one,
            count_reason: Some(CountReason::SingleAction),
            note: "=note".to_owned(),
        },
    );
    ann.answer(
        TaskKind::MaskText,
        Answer::MaskText {
            masks: Vec::new(),
            count_reason: Some(CountReason::Other),
            note: "stands still".to_owned(),
        },
    );
    ann.answer(TaskKind::Pair, pair(Verdict::Keep));
    ann.answer(TaskKind::Pair, pair(Verdict::Unnatural));
    ann.answer(TaskKind::Style, style());
    assert_eq!(accept_all(&eve), 6);
    site
}

fn selection(format: ExportFormat) -> ExportRequest {
    ExportRequest {
        format,
        splits: Vec::new(),
        events: true,
    }
}

fn write(site: &Site, store: &Store, folder: &str, format: ExportFormat) -> std::path::PathBuf {
    let folder = site.folder.path().join(folder);
    export(store, &site.dataset, &folder, &selection(format), "test").expect("exports");
    folder
}

/// A store with motions but no tasks.
fn empty_store(site: &Site, name: &str) -> (Arc<Store>, BTreeMap<String, MotionRecord>) {
    let store = open_sqlite(&site.folder.path().join(name)).expect("a store");
    let motions = site.store.all_motions().expect("motions");
    store.put_motions(motions.clone()).expect("motions");
    let by_id = motions
        .into_iter()
        .map(|motion| (motion.id.clone(), motion))
        .collect();
    (store, by_id)
}

fn answers(store: &Store) -> BTreeMap<String, Answer> {
    let all: Vec<AcceptedAnswer> = store.accepted(&all_keys()).expect("answers");
    all.into_iter()
        .map(|one| (one.task.key, one.answer))
        .collect()
}

/// A store with the tasks of the site's dataset and nobody's answers.
fn fresh_store(site: &Site, name: &str) -> (Arc<Store>, BTreeMap<String, MotionRecord>) {
    let (store, motions) = empty_store(site, name);
    plain_settings(store.as_ref());
    take_dataset(site, store.as_ref());
    (store, motions)
}

fn take_dataset(site: &Site, store: &Store) -> Taken {
    from_dataset(store, &site.dataset, None, START, &mut |_, _| {}).expect("imports")
}

fn annotation_rows(folder: &Path) -> Vec<AnnotationRow> {
    read_rows(&folder.join("annotations.parquet")).expect("rows")
}

fn task_of(store: &Store, key: &str) -> TaskRecord {
    let after = KeyRange {
        after: String::new(),
        up_to: key.to_owned(),
    };
    let found = (1..500).find_map(|id| store.task_record(id).ok().filter(|task| task.key == key));
    found.unwrap_or_else(|| panic!("a task {key}, {:?}", store.accepted(&after)))
}

/// Has a person answer a task of a kind in a store without a server, and returns it.
fn answer_in(store: &Store, user: i64, kind: TaskKind, answer: Option<Answer>) -> i64 {
    let Ok((detail, _)) = store.claim(user, kind, 0, START).expect("claims") else {
        panic!("a task")
    };
    let lease = detail.lease.expect("a lease");
    let (kind, answer) = match answer {
        Some(answer) => (EventKind::Submit, answer),
        None => (EventKind::Draft, masks("a draft")),
    };
    let sent = event(
        kind,
        lease.epoch,
        detail.mine.map_or(0, |mine| mine.rev),
        Some(answer),
    );
    let results = store
        .append(user, detail.task.id, vec![sent], START)
        .expect("takes events");
    assert_eq!(results[0].status, 200, "{:?}", results[0].problem);
    detail.task.id
}

/// Has a reviewer accept the next answer.
fn accept_in(store: &Store, user: i64) {
    let next = store
        .review_next(user, ReviewQueue::Sample, None, START)
        .expect("claims");
    let Ok(review) = next else {
        panic!("a task to review")
    };
    let decision = NewReview {
        idem_key: key(),
        task: review.task.id,
        lease_epoch: review.lease.epoch,
        decision: Decision::Accept,
        author: Some(review.candidates[0].0.author),
        answer: None,
        comment: String::new(),
        secs: 0.0,
    };
    store.review(user, decision, START).expect("accepts");
}

fn same_files(a: &Path, b: &Path, names: &[&str]) {
    for name in names {
        let read = |folder: &Path| std::fs::read(folder.join(name)).expect("a file");
        assert_eq!(read(a), read(b), "{name}");
    }
}

#[test]
fn parquet_comes_back_as_it_went() {
    let site = annotated();
    let first = write(&site, site.store.as_ref(), "first", ExportFormat::Parquet);
    let again = write(&site, site.store.as_ref(), "again", ExportFormat::Parquet);
    let tables =
        ["annotations", "labels", "rejects", "agreement"].map(|name| format!("{name}.parquet"));
    let names: Vec<&str> = tables.iter().map(String::as_str).collect();
    same_files(&first, &again, &names);
    let rows: Vec<AnnotationRow> = read_rows(&first.join("annotations.parquet")).expect("rows");
    assert_eq!(rows.len(), 2 + 1 + 1 + 2 + 1);
    let labels: Vec<LabelRow> = read_rows(&first.join("labels.parquet")).expect("rows");
    assert_eq!(labels.len(), 6);
    assert!(
        labels
            .iter()
            .all(|label| label.author.starts_with('a') && label.author != "ann")
    );
    let rejects: Vec<RejectRow> = read_rows(&first.join("rejects.parquet")).expect("rows");
    assert_eq!(
        rejects
            .iter()
            .map(|row| row.reason.as_str())
            .collect::<Vec<_>>(),
        ["unnatural"]
    );

    let (store, motions) = empty_store(&site, "other.sqlite");
    let taken = from_annotations(
        store.as_ref(),
        &motions,
        &first.join("annotations.parquet"),
        None,
        START,
    )
    .expect("takes");
    assert_eq!(taken.counts["new_tasks"], 6);
    assert_eq!(answers(store.as_ref()), answers(site.store.as_ref()));
    let second = write(&site, store.as_ref(), "second", ExportFormat::Parquet);
    assert_eq!(annotation_rows(&second), annotation_rows(&first));
    assert!(store.verify().expect("checks").is_empty());
}

/// Masks that hold for ranges, with joints that a person chose, in the order of their ids in the dataset.
fn ranged() -> Answer {
    let answer = json!({ "kind": "mask_text", "masks": [
        { "parts": ["BOTH_LEGS"], "joints": [{ "joint": "left_hip", "weight": "soft" }], "text": "walking" },
        { "parts": ["LEFT_ARM"], "range": [0, 31], "text": "waving" },
        {
            "parts": ["LEFT_ARM"], "range": [9, 40], "text": "pointing", "joints": [
                { "joint": "left_collar", "weight": "hard" }, { "joint": "left_wrist", "weight": "none" },
            ],
        },
    ] });
    serde_json::from_value(answer).expect("an answer")
}

#[test]
fn ranges_and_joints_come_back_from_every_layout_with_a_place_for_them() {
    let site = Site::new();
    let (ann, eve) = (
        site.person("ann", Role::Annotator),
        site.person("eve", Role::Reviewer),
    );
    ann.answer(TaskKind::MaskText, ranged());
    assert_eq!(accept_all(&eve), 1);
    let said = answers(site.store.as_ref());
    let first = write(&site, site.store.as_ref(), "first", ExportFormat::Parquet);
    let rows = annotation_rows(&first);
    let frames = |row: &AnnotationRow| (row.start, row.end);
    assert_eq!(frames(&rows[0]), (None, None));
    assert_eq!(rows[0].soft_joints, ["left_hip"]);
    assert_eq!(frames(&rows[2]), (Some(9), Some(40)));
    assert_eq!(
        rows[2].hard_joints,
        ["left_collar", "left_shoulder", "left_elbow"]
    );
    assert!(rows[2].soft_joints.is_empty());

    // The lists of a release count them; the table beside them has them.
    let lists = site.folder.path().join("lists");
    let stance = selection(ExportFormat::Stance);
    let done =
        export(site.store.as_ref(), &site.dataset, &lists, &stance, "test").expect("exports");
    assert_eq!(done.counts["masks_of_a_range"], 2);
    assert_eq!(done.counts["masks_of_own_joints"], 2);
    assert!(!done.counts.contains_key("masks_without_ring"));
    for folder in [&first, &lists] {
        let name = folder.file_name().expect("a name").to_string_lossy();
        let (store, motions) = empty_store(&site, &format!("{name}.sqlite"));
        let table = folder.join("annotations.parquet");
        from_annotations(store.as_ref(), &motions, &table, None, START).expect("takes");
        assert_eq!(answers(store.as_ref()), said);
        assert!(store.verify().expect("checks").is_empty());
    }
    let csv = write(&site, site.store.as_ref(), "csv", ExportFormat::Csv);
    let csv = std::fs::read_to_string(csv.join("labels.csv")).expect("a file");
    assert!(csv.contains("\"\"range\"\":[9,40]"), "{csv}");

    write(&site, site.store.as_ref(), "unused", ExportFormat::Dataset);
    let dataset = Dataset::open(&site.dataset).expect("a dataset");
    let masks: Vec<MaskRow> = dataset.read(None).expect("masks");
    let ranges: Vec<(Option<i32>, Option<i32>)> = masks
        .iter()
        .filter(|row| row.text_origin == "human")
        .map(|row| (row.start, row.end))
        .collect();
    assert_eq!(
        ranges,
        [(None, None), (Some(0), Some(31)), (Some(9), Some(40))]
    );
    let (store, _) = fresh_store(&site, "of-dataset.sqlite");
    assert_eq!(answers(store.as_ref()), said);
}

#[test]
fn a_range_that_a_shorter_clip_does_not_have_is_left_out_of_the_dataset_and_counted() {
    let site = Site::new();
    let (ann, eve) = (
        site.person("ann", Role::Annotator),
        site.person("eve", Role::Reviewer),
    );
    let task = ann.answer(TaskKind::MaskText, ranged());
    assert_eq!(accept_all(&eve), 1);
    let source = site.store.task_record(task).expect("a task").source;
    let mut clip = site.store.all_motions().expect("motions");
    clip.retain(|motion| motion.hash == source);
    (clip[0].hash, clip[0].frames) = ("shorter".to_owned(), 35);
    site.store
        .replace_motions(None, clip, START)
        .expect("replaces");
    let done = export(
        site.store.as_ref(),
        &site.dataset,
        site.folder.path(),
        &selection(ExportFormat::Dataset),
        "test",
    )
    .expect("exports");
    assert_eq!(done.counts["masks_past_the_clip"], 1);
}

#[test]
fn the_release_layout_comes_back_as_it_went() {
    let site = annotated();
    let first = write(&site, site.store.as_ref(), "first", ExportFormat::Stance);
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(first.join(name)).expect("a file")).expect("JSON")
    };
    let (masks, texts, pairs) = (
        read("mask_all.json"),
        read("part_annotations.json"),
        read("pairs.json"),
    );
    assert_eq!(masks["clip00"], json!(["LEFT_ARM", "LOWER_BODY"]));
    assert_eq!(texts["clip00"], json!(["waving", "waving, walking"]));
    assert_eq!(pairs.as_array().map(Vec::len), Some(2));
    let (store, motions) = empty_store(&site, "other.sqlite");
    let document = json!({ "mask_all": masks, "part_annotations": texts });
    from_release(store.as_ref(), &motions, &document, None, START).expect("takes");
    let second = write(&site, store.as_ref(), "second", ExportFormat::Stance);
    same_files(&first, &second, &["mask_all.json", "part_annotations.json"]);
}

#[test]
fn the_dataset_takes_what_was_accepted_and_a_new_store_takes_it_from_there() {
    let site = annotated();
    write(&site, site.store.as_ref(), "unused", ExportFormat::Dataset);
    let dataset = Dataset::open(&site.dataset).expect("a dataset");
    let masks: Vec<MaskRow> = dataset.read(None).expect("masks");
    let human: Vec<&MaskRow> = masks
        .iter()
        .filter(|row| row.text_origin == "human")
        .collect();
    assert_eq!(human.len(), 3);
    assert_eq!(human[0].id, "clip00#LEFT_ARM");
    assert_eq!(human[0].soft_joints, ["left_collar"]);
    assert_eq!(
        human[2].soft_joints,
        Vec::<String>::new(),
        "its ring was off"
    );
    assert!(
        masks.iter().all(|row| row.text_origin == "human"),
        "the automatic mask was replaced"
    );
    let pairs: Vec<PairRow> = dataset.read(None).expect("pairs");
    let judged: Vec<&PairRow> = pairs
        .iter()
        .filter(|pair| pair.source == "annotate")
        .collect();
    assert_eq!(judged.len(), 2);
    assert_eq!(pairs.len(), 9, "ten, less the unnatural one");

    let store = open_sqlite(&site.folder.path().join("third.sqlite")).expect("a store");
    from_dataset(store.as_ref(), &site.dataset, None, START, &mut |_, _| {}).expect("imports");
    let again = answers(store.as_ref());
    assert_eq!(
        again["mask:clip00"],
        answers(site.store.as_ref())["mask:clip00"]
    );
    assert_eq!(again.len(), 4);
    let before = dataset.manifest().root_hash.clone();
    write(&site, store.as_ref(), "unused", ExportFormat::Dataset);
    let after: Vec<MaskRow> = Dataset::open(&site.dataset)
        .expect("a dataset")
        .read(None)
        .expect("masks");
    let bare = |rows: &[MaskRow]| -> Vec<MaskRow> {
        rows.iter()
            .map(|row| MaskRow {
                author: String::new(),
                ..row.clone()
            })
            .collect()
    };
    assert_eq!(bare(&after), bare(&masks));
    assert!(!before.is_empty());
}

#[test]
fn a_job_exports_and_its_files_are_downloaded() {
    let site = annotated();
    let admin = site.person("adm", Role::Admin);
    let job: Job = admin.post("exports", &json!({ "format": "csv" })).ok();
    let job = finished(&admin, job.id);
    assert_eq!(
        (job.state.as_str(), job.files.as_slice()),
        (
            "done",
            &["labels.csv".to_owned(), "export.json".to_owned()][..]
        )
    );
    let answered = admin.get(&format!("jobs/{}/files/labels.csv", job.id));
    let disposition = answered
        .headers
        .get("content-disposition")
        .and_then(|value| value.to_str().ok());
    assert_eq!(disposition, Some("attachment; filename=\"labels.csv\""));
    let text = String::from_utf8(answered.body).expect("text");
    assert_eq!(
        text.lines()
            .next()
            .map(|line| line.starts_with("task,kind")),
        Some(true)
    );
    let job: Job = admin.call("POST", "imports?format=dataset", Some(b"")).ok();
    let job = finished(&admin, job.id);
    assert_eq!(
        (job.state.as_str(), job.counts.get("new_tasks")),
        ("done", Some(&0))
    );
    let audit: annotate::wire::Audit = admin.get("audit?kind=exported").ok();
    assert_eq!(audit.entries.len(), 1);
    let bad = admin.post(
        "exports",
        &json!({ "format": "csv", "splits": ["holdout"] }),
    );
    assert_eq!(bad.problem().code, annotate::wire::Code::Invalid);
}

#[test]
fn splits_are_kept_apart() {
    let site = annotated();
    let folder = site.folder.path().join("test-split");
    let only = ExportRequest {
        splits: vec!["test".to_owned()],
        ..selection(ExportFormat::Parquet)
    };
    export(site.store.as_ref(), &site.dataset, &folder, &only, "test").expect("exports");
    let rows: Vec<AnnotationRow> = read_rows(&folder.join("annotations.parquet")).expect("rows");
    assert!(rows.is_empty(), "all answers are of the training split");
    // A task of split train with a motion of the test split is not exported.
    let mut motion = site.store.all_motions().expect("motions");
    motion.retain(|motion| motion.split == "test");
    let mut task = crate::support::bare_task(1, TaskKind::MaskText);
    task.source.clone_from(&motion[0].hash);
    task.accepted = Some(masks("leak"));
    site.store
        .import(None, vec![task], START + MINUTE)
        .expect("a task");
    let leak = export(
        site.store.as_ref(),
        &site.dataset,
        &folder,
        &selection(ExportFormat::Parquet),
        "test",
    );
    assert!(leak.expect_err("a leak").to_string().contains("split"));
}

#[test]
fn an_export_and_a_release_fill_tasks_that_exist() {
    let site = annotated();
    let first = write(&site, site.store.as_ref(), "first", ExportFormat::Parquet);
    let (store, motions) = fresh_store(&site, "other.sqlite");
    let before = store.funnel().expect("counts");
    let import = || {
        let path = first.join("annotations.parquet");
        from_annotations(store.as_ref(), &motions, &path, None, START)
            .expect("takes")
            .counts
    };
    let taken = import();
    assert_eq!(
        (
            taken["filled_tasks"],
            taken["new_tasks"],
            taken["conflicts"]
        ),
        (6, 0, 0)
    );
    assert_eq!(answers(store.as_ref()), answers(site.store.as_ref()));
    let total =
        |counts: &[(TaskKind, TaskState, i64)]| -> i64 { counts.iter().map(|row| row.2).sum() };
    assert_eq!(
        total(&store.funnel().expect("counts")),
        total(&before),
        "no task is there twice"
    );
    let second = write(&site, store.as_ref(), "second", ExportFormat::Parquet);
    assert_eq!(annotation_rows(&second), annotation_rows(&first));
    same_files(&first, &second, &["annotations.parquet", "rejects.parquet"]);
    let again = import();
    assert_eq!(
        (
            again["filled_tasks"],
            again["known_tasks"],
            again["conflicts"]
        ),
        (0, 6, 0)
    );
    assert!(store.verify().expect("checks").is_empty());
    let release = write(&site, site.store.as_ref(), "release", ExportFormat::Stance);
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(release.join(name)).expect("a file")).expect("JSON")
    };
    let document = json!({ "mask_all": read("mask_all.json"), "part_annotations": read("part_annotations.json") });
    let (store, motions) = fresh_store(&site, "third.sqlite");
    let taken = from_release(store.as_ref(), &motions, &document, None, START).expect("takes");
    assert_eq!(
        (taken.counts["filled_tasks"], taken.counts["new_tasks"]),
        (3, 0)
    );
    let second = write(&site, store.as_ref(), "release2", ExportFormat::Stance);
    same_files(
        &release,
        &second,
        &["mask_all.json", "part_annotations.json"],
    );
}

#[test]
fn an_import_never_touches_an_answer_of_a_person_and_reports_the_conflict() {
    let site = annotated();
    let first = write(&site, site.store.as_ref(), "first", ExportFormat::Parquet);
    let (store, motions) = fresh_store(&site, "other.sqlite");
    let bob = store
        .add_user(None, "bob", Role::Annotator, START)
        .expect("a user")
        .id;
    let eve = store
        .add_user(None, "eve", Role::Reviewer, START)
        .expect("a user")
        .id;
    // clip00 has another accepted answer, clip01 the same one, clip02 a draft.
    let theirs = answers(site.store.as_ref());
    let accepted = answer_in(
        store.as_ref(),
        bob,
        TaskKind::MaskText,
        Some(masks("sitting")),
    );
    accept_in(store.as_ref(), eve);
    let same = answer_in(
        store.as_ref(),
        bob,
        TaskKind::MaskText,
        Some(theirs["mask:clip01"].clone()),
    );
    accept_in(store.as_ref(), eve);
    let draft = answer_in(store.as_ref(), bob, TaskKind::MaskText, None);
    let keys = [accepted, same, draft].map(|task| store.task_record(task).expect("a task").key);
    assert_eq!(keys, ["mask:clip00", "mask:clip01", "mask:clip02"]);
    let path = first.join("annotations.parquet");
    let taken = from_annotations(store.as_ref(), &motions, &path, None, START).expect("takes");
    assert_eq!(
        (taken.counts["filled_tasks"], taken.counts["known_tasks"]),
        (3, 1)
    );
    assert_eq!(taken.counts["conflicts"], 2);
    for key in ["mask:clip00", "mask:clip02"] {
        assert!(
            taken.messages.iter().any(|message| message.contains(key)),
            "{:?}",
            taken.messages
        );
    }
    let ours = answers(store.as_ref());
    assert_eq!(ours["mask:clip00"], masks("sitting"));
    assert!(!ours.contains_key("mask:clip02"));
    assert_eq!(
        store.task_record(draft).expect("a task").state,
        TaskState::Leased
    );
    // A task that a reviewer opened again is not filled by the file.
    let pairs: Vec<_> = ours.keys().filter(|key| key.starts_with("pair:")).collect();
    let reopened = task_of(store.as_ref(), pairs[0]).id;
    let reopen = NewReview {
        idem_key: key(),
        task: reopened,
        lease_epoch: 0,
        decision: Decision::Reopen,
        author: None,
        answer: None,
        comment: "once more".to_owned(),
        secs: 0.0,
    };
    store.review(eve, reopen, START).expect("reopens");
    let taken = from_annotations(store.as_ref(), &motions, &path, None, START).expect("takes");
    assert_eq!(taken.counts["conflicts"], 3);
    assert_eq!(
        store.task_record(reopened).expect("a task").state,
        TaskState::Open
    );
    assert!(store.verify().expect("checks").is_empty());
}

/// The pairs of the site's dataset.
fn pair_rows(site: &Site) -> BTreeMap<String, PairRow> {
    let rows: Vec<PairRow> = Dataset::open(&site.dataset)
        .expect("a dataset")
        .read(None)
        .expect("pairs");
    let count = rows.len();
    let by_id: BTreeMap<String, PairRow> =
        rows.into_iter().map(|row| (row.id.clone(), row)).collect();
    assert_eq!(by_id.len(), count, "every id is there once");
    by_id
}

#[test]
fn candidates_are_made_of_every_clip_and_beside_other_pairs() {
    let site = Site::new();
    // Eighteen clips of one action and split make seventeen candidates, less ten that are pairs already; two clips of
    // the other split make one.
    let again = take_dataset(&site, site.store.as_ref());
    assert_eq!(again.counts["candidates"], 8);
    assert_eq!(again.counts["new_tasks"], 0);
    assert_eq!(
        task_of(site.store.as_ref(), "takes:clip16|clip17").kind,
        TaskKind::Pair
    );
    assert_eq!(
        task_of(site.store.as_ref(), "takes:clip18|clip19").split,
        "test"
    );
    let fine = task_of(site.store.as_ref(), "pair:fine-grained8");
    assert!(
        fine.id < task_of(site.store.as_ref(), "takes:clip09|clip10").id,
        "pairs made for an instruction come first"
    );
}

#[test]
fn variants_of_a_motion_are_no_mask_tasks() {
    let site = Site::new();
    let mut pairs: Vec<PairRow> = pair_rows(&site).into_values().collect();
    for pair in &mut pairs {
        if pair.id == "fine-grained3" {
            pair.source = "variants-1".to_owned();
        }
    }
    let skeleton = datasets_spec::Skeleton::smplx_neutral();
    let split: fn(&PairRow) -> Split = |row| row.split;
    commit_rows(
        &site.dataset,
        &pairs,
        Some(split),
        &skeleton,
        "variants",
        "test",
    )
    .expect("pairs");
    let (store, _) = empty_store(&site, "other.sqlite");
    let taken = take_dataset(&site, store.as_ref());
    assert_eq!(taken.counts["variants"], 2, "clip03 and clip04");
    let funnel = store.funnel().expect("counts");
    let masks = funnel.iter().filter(|row| row.0 == TaskKind::MaskText);
    assert_eq!(masks.map(|row| row.2).sum::<i64>(), CLIPS as i64 - 2);
}

#[test]
fn a_candidate_keeps_its_key_and_leaves_the_pairs_when_it_is_judged_unusable() {
    let site = Site::new();
    let store = site.store.as_ref();
    let id = "takes:clip18|clip19";
    let (ann, eve) = (
        site.person("ann", Role::Annotator),
        site.person("eve", Role::Reviewer),
    );
    for _ in 0..9 {
        ann.answer(TaskKind::Pair, pair(Verdict::Unclear));
    }
    ann.answer(TaskKind::Pair, pair(Verdict::Keep));
    assert_eq!(accept_all(&eve), 10);
    assert!(answers(store).contains_key(id));
    write(&site, store, "unused", ExportFormat::Dataset);
    let row = pair_rows(&site)[id].clone();
    assert_eq!(
        (row.source.as_str(), row.edit_type.as_deref()),
        ("annotate", Some("amplitude"))
    );
    let found =
        pipeline::verify::verify(&site.dataset, &datasets_spec::NoProgress).expect("a dataset");
    assert_eq!(found.findings, Vec::new());
    // The store takes the dataset again, as a server does at its start.
    assert_eq!(take_dataset(&site, store).counts["new_tasks"], 0);
    // A new store has the same key, with the whole answer.
    let (other, _) = fresh_store(&site, "other.sqlite");
    assert_eq!(
        answers(other.as_ref()),
        BTreeMap::from([(id.to_owned(), pair(Verdict::Keep))])
    );
    let before = pair_rows(&site);
    write(&site, other.as_ref(), "unused", ExportFormat::Dataset);
    assert_eq!(pair_rows(&site), before);
    // Judged again, as unusable, it leaves the dataset.
    let task = task_of(store, id).id;
    let answered = eve.post(
        "reviews",
        &json!({ "idem_key": key(), "task": task, "lease_epoch": 0, "decision": "reopen", "comment": "look again" }),
    );
    assert_eq!(answered.status, 200);
    let next: ReviewNext = eve.post("review/next", &json!({ "queue": "sample" })).ok();
    let review = next.review.expect("a task to review");
    assert_eq!(review.task.id, task);
    let done = eve.post(
        "reviews",
        &json!({ "idem_key": key(), "task": task, "lease_epoch": review.lease.epoch, "decision": "merge",
                 "answer": pair(Verdict::Unnatural) }),
    );
    assert_eq!(done.status, 200);
    write(&site, store, "unused", ExportFormat::Dataset);
    assert!(!pair_rows(&site).contains_key(id));
}

#[test]
fn two_tasks_of_one_candidate_in_an_old_store_make_one_pair() {
    let site = Site::new();
    let store = site.store.as_ref();
    // An earlier version imported a candidate from the dataset under a second key.
    let mut second = bare_task(0, TaskKind::Pair);
    let first = task_of(store, "takes:clip09|clip10");
    second.key = "pair:takes:clip09|clip10".to_owned();
    second.source.clone_from(&first.source);
    second.target.clone_from(&first.target);
    let accept = |mut task: NewTask, verdict| {
        task.accepted = Some(pair(verdict));
        let done = store.import(None, vec![task], START).expect("imports");
        assert_eq!(done.conflicts, Vec::<String>::new());
    };
    let mut same = second.clone();
    same.key = first.key.clone();
    accept(same, Verdict::Keep);
    write(&site, store, "unused", ExportFormat::Dataset);
    assert!(pair_rows(&site).contains_key("takes:clip09|clip10"));
    accept(second, Verdict::Unclear);
    write(&site, store, "unused", ExportFormat::Dataset);
    assert!(
        !pair_rows(&site).contains_key("takes:clip09|clip10"),
        "the later decision counts"
    );
}

#[test]
fn an_export_is_one_point_in_time() {
    use std::sync::atomic::{AtomicBool, Ordering};
    let site = annotated();
    let store = site.store.as_ref();
    let frozen = store.snapshot().expect("a snapshot");
    let (seq, count) = (store.last_seq().expect("a place"), answers(store).len());
    let first = task_of(store, "takes:clip09|clip10");
    let unusable = |number: usize| {
        let mut task = bare_task(number, TaskKind::Pair);
        task.source.clone_from(&first.source);
        task.target.clone_from(&first.target);
        task.accepted = Some(pair(Verdict::Unclear));
        task
    };
    store
        .import(None, vec![unusable(0)], START)
        .expect("imports");
    assert_eq!(answers(store).len(), count + 1);
    assert_eq!(answers(&frozen).len(), count);
    assert_eq!(frozen.last_seq().expect("a place"), seq);
    assert!(frozen.import(None, vec![unusable(1)], START).is_err());
    // Every unusable pair is in two tables, also while more of them come.
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for number in 1.. {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                store
                    .import(None, vec![unusable(number)], START)
                    .expect("imports");
            }
        });
        for number in 0..10 {
            let folder = write(
                &site,
                store,
                &format!("export{number}"),
                ExportFormat::Parquet,
            );
            let rejects: Vec<RejectRow> = read_rows(&folder.join("rejects.parquet")).expect("rows");
            let rows = annotation_rows(&folder);
            let unclear = rows
                .iter()
                .filter(|row| row.verdict.as_deref() == Some("unclear"));
            let listed = rejects.iter().filter(|row| row.reason == "unclear");
            assert_eq!(unclear.count(), listed.count());
            let stamp: serde_json::Value = serde_json::from_slice(
                &std::fs::read(folder.join("export.json")).expect("a stamp"),
            )
            .expect("JSON");
            assert_eq!(stamp["store"], store.id().expect("an id"));
            let events: Vec<EventRow> = read_rows(&folder.join("events.parquet")).expect("rows");
            assert_eq!(stamp["seq"].as_u64(), events.last().map(|event| event.seq));
            assert_eq!(
                stamp["counts"]["annotations"].as_u64(),
                Some(rows.len() as u64)
            );
        }
        stop.store(true, Ordering::Relaxed);
    });
}

#[test]
fn the_dataset_gets_masks_and_pairs_in_one_commit_under_its_lock() {
    let site = annotated();
    let store = site.store.as_ref();
    let run = |format| {
        let folder = site.folder.path().join("files");
        export(store, &site.dataset, &folder, &selection(format), "test")
    };
    let version = || {
        Dataset::open(&site.dataset)
            .expect("a dataset")
            .manifest()
            .version
    };
    let before = version();
    let held = Transaction::begin(&site.dataset, "another run").expect("a lock");
    let refused = run(ExportFormat::Dataset).expect_err("the dataset is locked");
    assert!(refused.to_string().contains("another run"), "{refused}");
    drop(held);
    assert_eq!(version(), before);
    let done = run(ExportFormat::Dataset).expect("exports");
    assert_eq!(version(), before + 1, "masks and pairs are one version");
    let manifest = Dataset::open(&site.dataset)
        .expect("a dataset")
        .manifest()
        .clone();
    assert_eq!(manifest.facts["annotate_store"], store.id().expect("an id"));
    assert_eq!(manifest.facts["annotate_seq"], done.seq.to_string());
    assert_eq!(done.seq, store.last_seq().expect("a place"));
    run(ExportFormat::Dataset).expect("exports");
    assert_eq!(
        version(),
        before + 1,
        "what is there already is not written again"
    );
    let missing = site.folder.path().join("nowhere");
    let format = selection(ExportFormat::Dataset);
    assert!(export(store, &missing, &missing, &format, "test").is_err());
    assert!(!missing.exists(), "no folder is made of a typing error");
}

#[test]
fn the_exported_log_names_nobody() {
    let site = annotated();
    let folder = write(&site, site.store.as_ref(), "files", ExportFormat::Parquet);
    let events: Vec<EventRow> = read_rows(&folder.join("events.parquet")).expect("rows");
    let id = site.store.id().expect("an id");
    let ann = format!("a002-{}", &id[..6]);
    let mut kinds = BTreeSet::new();
    for event in &events {
        let body: serde_json::Value = serde_json::from_str(&event.body).expect("JSON");
        for name in ["ann", "eve", "root"] {
            assert!(
                !event.body.contains(&format!("\"{name}\"")),
                "{}",
                event.body
            );
        }
        for field in ["user", "author"] {
            if let Some(value) = body.get(field) {
                kinds.insert(event.kind.clone());
                assert!(
                    value.as_str().is_some_and(|text| text.starts_with('a')),
                    "{}",
                    event.body
                );
            }
        }
    }
    assert!(
        kinds.contains("role_changed") && kinds.contains("accepted"),
        "{kinds:?}"
    );
    let accepted = events
        .iter()
        .find(|event| event.kind == "accepted")
        .expect("an entry");
    assert!(accepted.body.contains(&ann), "{}", accepted.body);
    let labels: Vec<LabelRow> = read_rows(&folder.join("labels.parquet")).expect("rows");
    assert!(labels.iter().all(|label| label.author == ann));
}

/// Replaces the content of clips of the site's dataset.
fn ingest_anew(site: &Site, content: &[(usize, usize)], plan: &str) {
    let dataset = Dataset::open(&site.dataset).expect("a dataset");
    let mut rows: Vec<MotionRow> = dataset.read(None).expect("motions");
    for (clip, variant) in content {
        let id = format!("clip{clip:02}");
        let row = rows
            .iter_mut()
            .find(|row| row.id.as_str() == id)
            .expect("a clip");
        *row = motion_row(&id, row.split, &motion(*variant));
    }
    let skeleton = dataset.skeleton().expect("a skeleton");
    let split: fn(&MotionRow) -> Split = |row| row.split;
    commit_rows(&site.dataset, &rows, Some(split), &skeleton, plan, "test").expect("motions");
}

#[test]
fn a_clip_that_was_ingested_anew_stops_nobody_and_its_tasks_ask() {
    let site = annotated();
    let store = site.store.as_ref();
    let hash = |clip: &str| {
        let all = store.all_motions().expect("motions");
        all.into_iter()
            .find(|motion| motion.id == clip)
            .expect("a clip")
            .hash
    };
    let (before, untouched) = (hash("clip00"), hash("clip05"));
    let ann = store
        .users()
        .expect("users")
        .into_iter()
        .find(|user| user.name == "ann")
        .expect("ann")
        .id;
    let draft = answer_in(store, ann, TaskKind::MaskText, None);
    assert_eq!(store.task_record(draft).expect("a task").key, "mask:clip03");
    ingest_anew(&site, &[(0, 30), (3, 33), (5, 35)], "anew");
    let taken = take_dataset(&site, store);
    assert_eq!(taken.counts["changed_motions"], 3);
    assert_eq!(taken.counts["new_tasks"], 0);
    assert!(
        taken
            .messages
            .iter()
            .any(|message| message.contains("changed")),
        "{:?}",
        taken.messages
    );
    assert_ne!(hash("clip00"), before);
    assert_ne!(hash("clip05"), untouched);
    let asking = |store: &Store| -> Vec<String> {
        store
            .changed_tasks()
            .expect("tasks")
            .into_iter()
            .map(|task| task.key)
            .collect()
    };
    assert_eq!(
        asking(store),
        ["mask:clip00", "mask:clip03", "pair:fine-grained0"]
    );
    assert_eq!(
        task_of(store, "mask:clip05").source,
        hash("clip05"),
        "a task without answers only gets the clip"
    );
    let who = Who {
        id: ann,
        name: "ann".to_owned(),
        role: Role::Annotator,
    };
    let detail = store.task(&who, draft).expect("a task");
    assert!(
        detail.clip_changed && detail.comment.is_none(),
        "{detail:?}"
    );
    assert!(store.verify().expect("checks").is_empty());
    // The server starts with it, and exports say so.
    let done = export(
        store,
        &site.dataset,
        &site.folder.path().join("f"),
        &selection(ExportFormat::Csv),
        "test",
    );
    assert_eq!(
        done.expect("exports").counts["accepted_before_clip_changed"],
        2
    );
    // An answer to the new content settles the question, and so does a decision.
    answer_in(store, ann, TaskKind::MaskText, Some(masks("nodding")));
    assert_eq!(asking(store), ["mask:clip00", "pair:fine-grained0"]);
    let clip00 = task_of(store, "mask:clip00").id;
    store
        .settle_changed(None, &[clip00], true, START)
        .expect("keeps");
    assert_eq!(asking(store), ["pair:fine-grained0"]);
    assert_eq!(task_of(store, "mask:clip00").state, TaskState::Accepted);
    let fine = task_of(store, "pair:fine-grained0").id;
    store
        .settle_changed(None, &[fine], false, START)
        .expect("reopens");
    assert_eq!(
        task_of(store, "pair:fine-grained0").state,
        TaskState::Submitted
    );
    let eve = store
        .users()
        .expect("users")
        .into_iter()
        .find(|user| user.name == "eve")
        .expect("eve")
        .id;
    let next = store
        .review_next(eve, ReviewQueue::Sample, Some(TaskKind::Pair), START)
        .expect("claims");
    let Ok(review) = next else {
        panic!("a task to review")
    };
    assert!(review.task.changed);
    // Two clips change places: each task follows its clip.
    let (old6, old7) = (hash("clip06"), hash("clip07"));
    ingest_anew(&site, &[(6, 7), (7, 6)], "swapped");
    take_dataset(&site, store);
    assert_eq!(
        (hash("clip06"), hash("clip07")),
        (old7.clone(), old6.clone())
    );
    assert_eq!(task_of(store, "mask:clip06").source, old7);
    let between = task_of(store, "pair:fine-grained6");
    assert_eq!(
        (between.source, between.target),
        (hash("clip06"), Some(hash("clip07")))
    );
    assert!(store.verify().expect("checks").is_empty());
}

/// Exports many tasks in every layout. A short version runs with the other tests; time and memory of a large export
/// are printed by
///
/// ```sh
/// ANNOTATE_EXPORT=50000 cargo test --release --workspace --test server many_tasks -- --nocapture
/// ```
#[test]
fn many_tasks_are_written_as_they_are_read() {
    use std::io::Write;
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
            let done = export(
                store.as_ref(),
                &site.dataset,
                &folder,
                &selection(format),
                "test",
            );
            let secs = begun.elapsed().as_secs_f64();
            let peak = peak_memory_mb();
            let found = done.expect("exports").counts;
            let per_task = |what: &str, each: usize| {
                assert_eq!(found.get(what), Some(&((each * count) as i64)), "{what}");
            };
            match format {
                ExportFormat::Parquet => {
                    per_task("annotations", 2);
                    let rows: Vec<AnnotationRow> =
                        read_rows(&folder.join("annotations.parquet")).expect("rows");
                    assert!(rows.is_sorted_by_key(|row| (row.task.clone(), row.number)));
                    assert_eq!(rows.len(), 2 * count);
                }
                ExportFormat::Stance => {
                    per_task("motions", 1);
                    let text = std::fs::read(folder.join("mask_all.json")).expect("a file");
                    let said: BTreeMap<String, Vec<String>> =
                        serde_json::from_slice(&text).expect("JSON");
                    assert_eq!(said.len(), count);
                }
                ExportFormat::Csv | ExportFormat::Dataset => per_task("labels", 0),
            }
            let line =
                format!("{count} tasks as {format:?}: {secs:.2} s, {before:?} MB before, peak");
            let mut out = std::io::stdout().lock();
            writeln!(out, "{line} {peak:?} MB").expect("stdout");
        }
    }
}
