//! Tasks whose clips change, leave the dataset and come back; tasks that their people leave.

use super::*;

#[test]
fn a_returned_answer_waits_for_its_author_through_lost_leases_and_then_goes_to_anybody() {
    each("reserved", mask_tasks(2), |site| {
        let task = site.answer(site.ann, "poor");
        site.send_back(task);
        let other = site.take(site.bob);
        assert_ne!(other, task);
        assert_eq!(site.take(site.ann), task, "first in its author's queue");
        let comment = site.detail(site.ann, task).comment;
        assert_eq!(comment.as_deref(), Some("because"));
        site.submit(site.bob, other, 0, masks("x"));
        // She has taken the task and left it: her lease has expired, but the task stays reserved for her.
        site.wait(HOUR);
        assert_eq!((site.open(site.bob), site.claim(site.bob)), (0, None));
        let back = &site.home(site.ann).returned[0];
        assert_eq!((back.task, back.until), (task, START + 7 * DAY));
        assert_eq!(back.comment, "because");
        // The same holds with a draft, and after she gives the lease back.
        assert_eq!(site.take(site.ann), task);
        let draft = site.tell(site.ann, task, EventKind::Draft, 1, masks("better"));
        assert_eq!(draft.status, 200);
        site.give_back(site.ann, task);
        assert_eq!(site.claim(site.bob), None);
        assert_eq!(site.state(task), TaskState::Returned);
        // After the configured days anybody may take the task, including its author.
        site.wait(8 * DAY);
        assert_eq!(site.take(site.bob), task);
        site.give_back(site.bob, task);
        assert_eq!(site.open(site.ann), 1);
        assert_eq!(site.take(site.ann), task);
    });
}

#[test]
fn the_work_of_a_disabled_user_goes_on_to_others_at_once() {
    each("disabled", mask_tasks(2), |site| {
        let returned = site.answer(site.ann, "poor");
        site.send_back(returned);
        let held = site.take(site.bob);
        for user in [site.ann, site.bob] {
            site.enable(user, false);
        }
        let zoe = site.join("zoe", Role::Annotator);
        let got = BTreeSet::from([site.answer(zoe, "one"), site.answer(zoe, "two")]);
        assert_eq!(got, BTreeSet::from([returned, held]));
    });
}

#[test]
fn who_holds_a_task_when_its_clip_changes_must_look_at_the_new_one() {
    each("changed clips", mask_tasks(2), |site| {
        let ingest_anew = |before: &str, now: &str| {
            let mut clips = site.store.motions(vec![before.to_owned()]).expect("clips");
            clips[0].hash = now.to_owned();
            let replaced = site.store.replace_motions(None, clips, site.now());
            replaced.expect("replaced");
        };
        let task = site.take(site.ann);
        let epoch = site.epoch(site.ann, task);
        ingest_anew(&bare_motion().hash, "second");
        // The page still shows the first content.
        let blind = event(EventKind::Submit, epoch, 0, masks("hopping"));
        let refused = site.send(site.ann, task, blind);
        assert_eq!(problem(&refused), Code::LeaseLost);
        let detail = refused.problem.expect("a problem").detail;
        assert!(detail.contains("ingested anew"), "{detail}");
        assert_eq!(site.state(task), TaskState::Open);
        assert_eq!(site.take(site.ann), task);
        assert_eq!(site.record(task).source, "second");
        let mine = site.detail(site.ann, task).mine.expect("the draft");
        site.submit(site.ann, task, mine.rev, masks("walking"));

        // A reviewer who looks at the second content decides nothing about the third.
        let (task, epoch) = site.review();
        ingest_anew("second", "third");
        for what in [Decision::Accept, Decision::Return, Decision::Drop] {
            let review = site
                .store
                .review(site.eve, decision(task, epoch, what), site.now());
            assert_eq!(refusal(review), Code::LeaseLost, "{what}");
        }
        assert_eq!(site.state(task), TaskState::Submitted);
        assert!(site.record(task).changed);
        site.judge(Decision::Accept);
        assert!(!site.record(task).changed);
    });
}

#[test]
fn tasks_of_clips_that_left_the_dataset_are_given_to_nobody_until_these_are_back() {
    let pair = NewTask {
        source: "other".to_owned(),
        target: Some(bare_motion().hash),
        ..bare_task(9, TaskKind::Pair)
    };
    let tasks = [mask_tasks(3), vec![pair]].concat();
    each("clips gone", tasks, |site| {
        let handed_in = site.answer(site.ann, "waving");
        let held = site.take(site.ann);
        assert_eq!((site.open(site.bob), site.open(site.ann)), (1, 2));
        let gone = vec![bare_motion().hash];
        site.store.note_gone(None, gone, site.now()).expect("noted");
        assert_eq!(site.state(held), TaskState::Open);
        for user in [site.ann, site.bob] {
            let empty = site.nothing(user, TaskKind::MaskText);
            assert_eq!((empty.clip_gone, empty.total), (2, 3));
            assert_eq!(site.open(user), 0);
        }
        assert_eq!(site.nothing(site.bob, TaskKind::Pair).clip_gone, 1);
        let again = site.store.claim_task(site.ann, held, site.now());
        assert_eq!(refusal(again), Code::WrongState);
        assert!(review(&site.store, site.eve, ReviewQueue::Sample, site.now()).is_none());
        site.store
            .put_motions(vec![bare_motion()])
            .expect("is back");
        assert_eq!(site.take(site.ann), held);
        assert_eq!(site.review().0, handed_in);
        assert!(site.claim_pair(site.bob).is_some());
    });
}
