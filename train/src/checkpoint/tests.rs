use datasets_spec::Skeleton;

use super::*;

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Settings {
    width: usize,
    rate: f64,
    val_every: u64,
}

fn record(width: usize) -> RunRecord<Settings> {
    // The shortest decimal form of this number needs 17 digits.
    let rate = 0.1 + 0.2;
    let settings = Settings {
        width,
        rate,
        val_every: 6,
    };
    RunRecord::new("test", "hash", &Skeleton::smplx_neutral(), settings)
}

fn files(value: u8) -> Files {
    [("a.bin".to_owned(), vec![value; 9])].into()
}

#[test]
fn a_run_is_opened_again_by_the_same_settings_alone() {
    let dir = tempfile::tempdir().expect("a folder");
    Run::open(dir.path(), &record(4)).expect("started");
    Run::open(dir.path(), &record(4)).expect("opened again");
    let other = Run::open(dir.path(), &record(8));
    assert!(matches!(other, Err(Error::OtherRun { field, .. }) if field == "config.width"));
    let read: RunRecord<Settings> = read_record(dir.path(), "test").expect("read");
    assert_eq!(read.config.width, 4);
    let error = read_record::<Settings>(dir.path(), "tmr").expect_err("another kind");
    assert!(error.to_string().contains("is not a tmr run"), "{error}");
}

/// A folder with a run.
fn started() -> (tempfile::TempDir, Run) {
    let dir = tempfile::tempdir().expect("a folder");
    let run = Run::open(dir.path(), &record(4)).expect("started");
    (dir, run)
}

#[test]
fn a_run_is_written_by_one_process_at_a_time() {
    let (dir, run) = started();
    let second = Run::open(dir.path(), &record(4)).expect_err("locked");
    assert_eq!(second.code().expect("a code").0, "E-LOCKED");
    read_record::<Settings>(dir.path(), "test").expect("readers take no lock");
    drop(run);
    Run::open(dir.path(), &record(4)).expect("free again");
}

#[test]
fn a_refused_run_leaves_no_folder_and_a_dataset_as_it_was() {
    let dir = tempfile::tempdir().expect("a folder");
    let run = dir.path().join("run");
    let start = Start::from(&run);
    let extend = Start {
        extend: true,
        ..start
    };
    let init = Start {
        init: Some(dir.path()),
        ..start
    };
    for start in [extend, init] {
        Run::open(start, &record(4)).expect_err("nothing to begin with");
        assert!(!run.exists());
    }
    fs::create_dir_all(run.join("meta")).expect("made");
    fs::write(run.join("meta/manifest-1.json"), "{}").expect("written");
    let occupied = Run::open(&run, &record(4)).expect_err("a dataset");
    assert_eq!(occupied.code().expect("a code").0, "E-OCCUPIED");
    assert!(!run.join(CONFIG).exists());
}

#[test]
fn a_checkpoint_is_replaced_whole_and_survives_a_crash_between_renames() {
    let (dir, run) = started();
    assert!(read(dir.path(), Slot::Last).expect("read").is_none());
    run.write(Slot::Last, &files(1)).expect("written");
    run.write(Slot::Last, &files(2)).expect("written");
    assert_eq!(read(dir.path(), Slot::Last).expect("read"), Some(files(2)));
    assert!(read(dir.path(), Slot::Best).expect("read").is_none());

    let checkpoints = dir.path().join("checkpoint");
    fs::rename(checkpoints.join("last"), checkpoints.join(".last.old")).expect("renamed");
    assert_eq!(read(dir.path(), Slot::Last).expect("read"), Some(files(2)));
}

#[test]
fn a_run_that_was_killed_before_its_last_checkpoint_is_extended_only_after_that_checkpoint() {
    let (dir, run) = started();
    let mut changed = record(4);
    changed.config.val_every = 3;
    let start = Start::from(dir.path());
    let extend = Start {
        extend: true,
        ..start
    };
    drop(run);
    for weights in [1, 2] {
        let run = Run::open(start, &record(4)).expect("opened");
        run.write(Slot::Best, &files(weights)).expect("written");
        drop(run);
        let error = Run::open(extend, &changed).expect_err("killed in between");
        assert!(error.to_string().contains("without --extend"), "{error}");
        let run = Run::open(start, &record(4)).expect("goes on");
        run.write(Slot::Last, &files(weights)).expect("written");
        drop(run);
        Run::open(extend, &changed).expect("both are of one step");
    }
}

#[test]
fn an_imported_mdm_takes_any_body_and_a_trained_model_its_own() {
    let own = Skeleton::smplx_neutral();
    let tall = Skeleton::new("tall", std::array::from_fn(|joint| 1.1 * own.rest(joint)));
    let check = |kind: &str, dataset_hash: &str| {
        let record = RunRecord::new(kind, dataset_hash, &own, Value::Null);
        let text = serde_json::to_string(&record).expect("serialises");
        check_skeleton_of(&text, Path::new("run"), "the editor", &tall)
    };
    check(MDM_KIND, IMPORTED).expect("HumanML3D's features are those of one body");
    for (kind, dataset_hash) in [(MDM_KIND, "ab"), ("motionrefit", IMPORTED)] {
        let error = check(kind, dataset_hash).expect_err(kind).to_string();
        assert!(
            error.contains(own.name()) && error.contains("tall"),
            "{error}"
        );
    }
}

#[test]
fn a_damaged_checkpoint_is_refused_with_the_reason() {
    let (dir, run) = started();
    let path = dir.path().join("checkpoint/last/a.bin");
    for (bytes, reason) in [
        (Some(vec![1; 8]), "8 bytes"),
        (Some(vec![7; 9]), "BLAKE3"),
        (None, "missing"),
    ] {
        run.write(Slot::Last, &files(1)).expect("written");
        match bytes {
            Some(bytes) => fs::write(&path, bytes).expect("damaged"),
            None => fs::remove_file(&path).expect("removed"),
        }
        let error = read(dir.path(), Slot::Last).expect_err(reason);
        assert!(error.to_string().contains(reason), "{error}");
    }
}

#[test]
fn the_log_is_rewound_to_the_checkpoint() {
    let (dir, run) = started();
    run.rewind_log(3).expect("nothing to rewind");
    for step in [2, 4, 6] {
        run.log(&serde_json::json!({ "step": step }))
            .expect("logged");
    }
    run.rewind_log(4).expect("rewound");
    let text = fs::read_to_string(dir.path().join(METRICS)).expect("read");
    assert_eq!(text, "{\"step\":2}\n{\"step\":4}\n");
    let lines = [2, 4].map(|step| events::of_line(&serde_json::json!({ "step": step })));
    let expected = [events::head(), lines.concat()].concat();
    assert_eq!(fs::read(dir.path().join(EVENTS)).expect("read"), expected);
}
