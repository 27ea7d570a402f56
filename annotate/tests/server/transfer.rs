//! Import and export: exported files can be imported unchanged.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use annotate::store::{AcceptedAnswer, MotionRecord, Store, open_sqlite};
use annotate::transfer::{
    AnnotationRow, LabelRow, RejectRow, Selection, export, from_annotations, from_dataset,
    from_release,
};
use annotate::wire::{
    Answer, CountReason, Decision, ExportFormat, Job, ReviewNext, Role, TaskKind, Verdict,
};
use datasets_spec::Dataset;
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::table::read_rows;
use serde_json::json;

use crate::support::{
    Client, MINUTE, START, Site, all_keys, bare_motion, bare_task, key, masks, pair,
    peak_memory_mb, style,
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

fn selection(format: ExportFormat) -> Selection {
    Selection {
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
    let strip = |folder: &Path| -> Vec<AnnotationRow> {
        let rows: Vec<AnnotationRow> =
            read_rows(&folder.join("annotations.parquet")).expect("rows");
        // Pseudonyms differ between stores.
        rows.into_iter()
            .map(|row| AnnotationRow {
                author: String::new(),
                ..row
            })
            .collect()
    };
    assert_eq!(strip(&second), strip(&first));
    assert!(store.verify().expect("checks").is_empty());
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
        ("done", &["labels.csv".to_owned()][..])
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
    let only = Selection {
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
