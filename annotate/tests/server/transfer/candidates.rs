//! Candidates of pairs: their keys, their bundles, and projects that judge them differently.

use super::*;

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
    // A new store of the dataset has the pair under the same key, with the whole answer.
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
