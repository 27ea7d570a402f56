//! Answers to clips that changed, moved to another split or were ingested anew.

use super::*;

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
