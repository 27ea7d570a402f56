//! New annotators practise; gold and practice follow the tasks that they are copies of.

use super::*;

#[test]
fn a_new_annotator_practises_until_the_score_is_reached() {
    each("practice", pair_tasks(4), |site| {
        let known = site.hand_in(site.bob, unclear());
        site.judge(Decision::Accept);
        let copy = || site.store.make_practice(ROOT, known, START);
        let practice = copy().expect("a practice task");
        assert!(copy().is_err(), "once");
        site.set(|settings| {
            settings.practice_tasks = 5;
            settings.practice_percent = 90;
        });
        let standing = |user: i64| {
            let mut all = site.store.practice(user).expect("practice").into_iter();
            all.find(|own| own.kind == TaskKind::Pair).expect("pairs")
        };
        let queue = || site.queue(site.ann, TaskKind::Pair);
        let own = || site.mine(site.ann).remove(0);
        assert_eq!(standing(site.ann).needed, 1, "as many as there are");
        assert!(!standing(site.ann).passed);
        let try_it = |answer: Answer, rev: i64| {
            let task = site.take_pair(site.ann);
            assert_eq!(task, practice, "practice comes before real work");
            let epoch = site.epoch(site.ann, task);
            let sent = event(EventKind::Submit, epoch, rev, answer);
            let result = site.send(site.ann, task, sent.clone());
            assert_eq!(site.send(site.ann, task, sent), result, "asked again");
            result.feedback.expect("feedback")
        };
        assert_eq!(queue().open, 1, "practice, and no real work yet");
        let wrong = try_it(pair(Verdict::Keep), 0);
        assert_eq!((wrong.score, &wrong.known), (0.0, &unclear()));
        assert_eq!(own().standing, Standing::Practice);
        assert_eq!(own().feedback, Some(wrong));
        assert_eq!(queue().open, 1, "it is given again");
        // She practises the task again; the known answer is not shown beside a draft.
        let undo = event(EventKind::Undo, 0, 1, None);
        assert_eq!(site.send(site.ann, practice, undo).status, 200);
        assert_eq!((own().standing, own().feedback), (Standing::Draft, None));
        assert_eq!(queue().held, 0, "others do not wait for practice");
        assert_eq!(standing(site.ann).done, 0);
        site.wait(1);
        assert_eq!(try_it(unclear(), 2).score, 1.0);
        assert!(standing(site.ann).passed);
        assert!(standing(site.eve).passed, "reviewers need no practice");
        let (pairs, today) = (queue(), site.home(site.ann).today);
        let counts = (pairs.mine, today, pairs.open);
        assert_eq!(counts, (0, 0, 3), "practice is no answer");
        let query = json!({ "task": practice, "limit": 5 });
        let (found, _) = site.mine_of(site.ann, query);
        assert_eq!(found.len(), 1);
        let score = found[0].feedback.as_ref().map(|found| found.score);
        assert_eq!(score, Some(1.0));
        assert_ne!(site.take_pair(site.ann), practice);
        assert_ne!(site.claim_pair(site.eve), Some(practice), "no practice");
        let people = site.store.people().expect("people");
        assert!(people.iter().all(|person| person.gold_items == 0));
        let done = |user: i64| site.person(user).done;
        assert_eq!([site.ann, site.bob].map(done), [0, 1]);
        let days = site.store.work(0, i64::MAX / 2).expect("days");
        let answers: i64 = days.iter().map(|day| day.answers).sum();
        assert_eq!(answers, 1, "that of Bob");
        assert_eq!(site.found(json!({})).len(), 4, "no practice task");
    });
}

#[test]
fn gold_and_practice_follow_the_answer_of_the_task_that_they_are_copies_of() {
    let check = |site: &Fixture, practice: bool| {
        let task = site.hand_in(site.ann, waving());
        site.judge(Decision::Accept);
        let copy = if practice {
            let copy = site.store.make_practice(ROOT, task, START);
            copy.expect("a practice task")
        } else {
            site.make_gold(task)
        };
        site.set(|settings| {
            settings.practice_tasks = practice.into();
            settings.gold_percent = if practice { 0 } else { 100 };
        });
        // While the task has no accepted answer, nobody gets its copy.
        site.reopen(task);
        assert_ne!(site.take(site.bob), copy);
        // Once a reviewer has corrected the answer, the copy is scored by the new one.
        let right = from_json::<Answer>(json!({
            "kind": "mask_text", "masks": [{ "parts": ["RIGHT_ARM"], "text": "waving" }],
            "count_reason": "single_action",
        }));
        let (_, epoch) = site.review();
        let merge = NewReview {
            answer: Some(right.clone()),
            ..decision(task, epoch, Decision::Merge)
        };
        let merged = site.store.review(site.eve, merge, site.now());
        assert_eq!(merged.expect("merges").state, TaskState::Accepted);
        let zoe = site.join("zoe", Role::Annotator);
        assert_eq!(site.take(zoe), copy);
        let result = site.tell(zoe, copy, EventKind::Submit, 0, right.clone());
        assert_eq!(result.status, 200, "{:?}", result.problem);
        assert_eq!(result.feedback, site.own(zoe, copy).feedback);
        if practice {
            let feedback = result.feedback.expect("feedback");
            assert_eq!((feedback.score, feedback.known), (1.0, right));
        } else {
            assert_eq!(site.person(zoe).gold_score, Some(1.0));
        }
        // The copy of a dropped task is not given either.
        site.reopen(task);
        let dropped = site.decide(task, 0, Decision::Drop);
        assert_eq!(dropped, Ok(TaskState::Dropped));
        let yan = site.join("yan", Role::Annotator);
        assert_ne!(site.take(yan), copy);
    };
    each("gold_copies", mask_tasks(4), |site| check(site, false));
    each("practice_copies", mask_tasks(4), |site| check(site, true));
}
