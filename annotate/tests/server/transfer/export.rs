//! Exports are one point in time, in files to download, also of many tasks.

use super::*;

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
    // An export lists the same unusable pairs in both tables, even while more are added.
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
