//! Tests of the store, on each available database.

use std::collections::BTreeMap;
use std::sync::Arc;

use annotate::store::{NewTask, Store, TokenUse, Who, open_sqlite};
use annotate::wire::{
    Answer, Code, Decision, EventKind, EventResult, JointChoice, JointWeight, MaskAnswer, NewEvent,
    NewReview, ReviewQueue, RevisionState, Role, Settings, SkipReason, TaskKind, TaskState,
    Verdict,
};
use datasets_spec::Seed;
use rand::RngExt;

use crate::support::{
    MINUTE, START, all_keys, bare_motion, bare_task, event, key, masks, pair, plain_settings,
};

/// Runs a test on a fresh store of each database.
pub(crate) fn on_each(test: &str, check: impl Fn(Arc<Store>)) {
    let folder = tempfile::tempdir().expect("a folder");
    check(open_sqlite(&folder.path().join("store.sqlite")).expect("a store"));
    on_postgres(test, &check);
}

#[cfg(feature = "postgres")]
pub(crate) fn on_postgres(test: &str, check: &dyn Fn(Arc<Store>)) {
    match std::env::var("ANNOTATE_TEST_PG") {
        Ok(url) => {
            let schema = format!(
                "t{}_{}",
                std::process::id(),
                test.replace(|c: char| !c.is_ascii_alphanumeric(), "_")
            );
            check(annotate::store::open_postgres(&url, &schema).expect("a store on PostgreSQL"));
        }
        Err(_) => skipped(test),
    }
}

#[cfg(not(feature = "postgres"))]
pub(crate) fn on_postgres(test: &str, _: &dyn Fn(Arc<Store>)) {
    skipped(test);
}

pub(crate) fn skipped(test: &str) {
    use std::io::Write;
    // Write to the terminal past the test runner's capture, so that the skipped database is visible.
    let _said = writeln!(
        std::io::stderr().lock(),
        "SKIPPED {test} on PostgreSQL: needs the feature postgres and ANNOTATE_TEST_PG"
    );
}

/// A store with users and tasks of a kind.
pub(crate) struct Fixture {
    pub(crate) store: Arc<Store>,
    pub(crate) ann: i64,
    pub(crate) bob: i64,
    pub(crate) eve: Who,
}

pub(crate) fn fixture(store: Arc<Store>, tasks: Vec<NewTask>) -> Fixture {
    plain_settings(store.as_ref());
    let user = |name: &str, role| store.add_user(None, name, role, START).expect("a user").id;
    let (ann, bob) = (user("ann", Role::Annotator), user("bob", Role::Annotator));
    let eve = Who {
        id: user("eve", Role::Reviewer),
        name: "eve".to_owned(),
        role: Role::Reviewer,
    };
    store.put_motions(vec![bare_motion()]).expect("a motion");
    store.import(None, tasks, START).expect("tasks");
    Fixture {
        store,
        ann,
        bob,
        eve,
    }
}

pub(crate) fn mask_tasks(count: usize) -> Vec<NewTask> {
    (0..count)
        .map(|number| bare_task(number, TaskKind::MaskText))
        .collect()
}

impl Fixture {
    pub(crate) fn who(&self, id: i64) -> Who {
        Who {
            id,
            name: String::new(),
            role: Role::Annotator,
        }
    }

    pub(crate) fn claim(&self, user: i64, now: i64) -> Option<i64> {
        self.claim_kind(user, TaskKind::MaskText, now)
    }

    pub(crate) fn claim_kind(&self, user: i64, kind: TaskKind, now: i64) -> Option<i64> {
        match self.store.claim(user, kind, 3, now).expect("claims") {
            Ok((detail, _)) => Some(detail.task.id),
            Err(_) => None,
        }
    }

    /// Tasks that the user's home page promises.
    fn open(&self, user: i64, kind: TaskKind, now: i64) -> i64 {
        let home = self.store.home(user, now).expect("home");
        let queue = home.queues.iter().find(|queue| queue.kind == kind);
        queue.expect("a queue").open
    }

    pub(crate) fn skip(&self, user: i64, now: i64) -> i64 {
        let task = self.claim(user, now).expect("a task");
        let skip = NewEvent {
            reason: Some(SkipReason::CannotTell),
            note: "too dark".to_owned(),
            ..event(EventKind::Skip, self.epoch(user, task), 0, None)
        };
        assert_eq!(self.send(user, task, skip, now).status, 200);
        task
    }

    pub(crate) fn epoch(&self, user: i64, task: i64) -> i64 {
        let detail = self.store.task(&self.who(user), task).expect("a task");
        detail.lease.map_or(0, |lease| lease.epoch)
    }

    pub(crate) fn send(&self, user: i64, task: i64, event: NewEvent, now: i64) -> EventResult {
        let mut results = self
            .store
            .append(user, task, vec![event], now)
            .expect("takes events");
        results.pop().expect("one result")
    }

    /// Submits an answer to a task that the user holds.
    pub(crate) fn submit(&self, user: i64, task: i64, base_rev: i64, answer: Answer, now: i64) {
        let epoch = self.epoch(user, task);
        let sent = event(EventKind::Submit, epoch, base_rev, Some(answer));
        assert_eq!(self.send(user, task, sent, now).status, 200);
    }

    /// Has the reviewer return the answer to the only task that waits.
    fn send_back(&self, task: i64, now: i64) {
        let (waiting, lease) = self.review(now);
        assert_eq!(waiting, task);
        let done = self.decide(task, lease, Decision::Return, now);
        assert_eq!(done, Ok(TaskState::Returned));
    }

    pub(crate) fn answer(&self, user: i64, text: &str, now: i64) -> i64 {
        let task = self.claim(user, now).expect("a task");
        self.submit(user, task, 0, masks(text), now);
        task
    }

    pub(crate) fn state(&self, task: i64) -> TaskState {
        self.store.task_record(task).expect("a task").state
    }

    pub(crate) fn review(&self, now: i64) -> (i64, i64) {
        match self
            .store
            .review_next(self.eve.id, ReviewQueue::Disagreement, None, now)
            .expect("claims")
        {
            Ok(detail) => (detail.task.id, detail.lease.epoch),
            Err(empty) => panic!("nothing to review: {empty:?}"),
        }
    }

    pub(crate) fn decide(
        &self,
        task: i64,
        epoch: i64,
        decision: Decision,
        now: i64,
    ) -> Result<TaskState, Code> {
        let review = NewReview {
            idem_key: key(),
            task,
            lease_epoch: epoch,
            decision,
            author: None,
            answer: (decision == Decision::Merge).then(|| masks("merged")),
            comment: "because".to_owned(),
            secs: 40.0,
        };
        match self.store.review(self.eve.id, review, now) {
            Ok(done) => Ok(done.state),
            Err(error) => Err(error.problem().code),
        }
    }

    pub(crate) fn whole(&self) {
        assert_eq!(self.store.verify().expect("checks"), Vec::<String>::new());
    }
}

pub(crate) fn problem(result: &EventResult) -> Code {
    result.problem.as_ref().expect("a problem").code
}

#[test]
fn a_task_goes_to_as_many_people_as_it_wants_and_no_more() {
    on_each("claims", |store| {
        let site = fixture(store, mask_tasks(2));
        let first = site.claim(site.ann, START);
        assert_eq!(
            site.claim(site.ann, START),
            first,
            "the same task until it is done"
        );
        let second = site.claim(site.bob, START);
        assert!(second.is_some() && second != first);
        assert_eq!(site.claim(site.eve.id, START), None);
        let Err(empty) = site
            .store
            .claim(site.eve.id, TaskKind::MaskText, 3, START)
            .expect("claims")
        else {
            panic!("nothing is left");
        };
        assert_eq!((empty.total, empty.leased_by_others, empty.done), (2, 2, 0));
        assert_eq!(empty.soonest_expiry, Some(START + 15 * MINUTE));
        site.whole();
    });
}

#[test]
fn an_expired_lease_is_given_away_by_the_claim_itself_and_its_late_answer_is_kept() {
    on_each("expiry", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.claim(site.ann, START).expect("a task");
        let epoch = site.epoch(site.ann, task);
        let later = START + 16 * MINUTE;
        assert_eq!(site.claim(site.bob, later), Some(task));
        let late = event(EventKind::Submit, epoch, 0, Some(masks("late")));
        let result = site.send(site.ann, task, late.clone(), later);
        assert_eq!(
            (result.status, problem(&result), result.rev),
            (409, Code::LeaseLost, 1)
        );
        let detail = site
            .store
            .task(&site.who(site.ann), task)
            .expect("still mine to see");
        let mine = detail.mine.expect("my draft");
        assert_eq!(
            (mine.state, mine.answer),
            (RevisionState::Draft, masks("late"))
        );
        assert_eq!(site.store.task_record(task).expect("a task").submitted, 0);
        assert_eq!(
            site.send(site.ann, task, late, later),
            result,
            "asked again, the same answer"
        );
        let refused = site
            .store
            .claim_task(site.ann, task, later)
            .expect_err("full");
        assert_eq!(refused.problem().code, Code::TaskFull);
        site.whole();
    });
}

#[test]
fn nobody_takes_an_expired_lease_away_but_a_claim() {
    on_each("late", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.claim(site.ann, START).expect("a task");
        site.submit(site.ann, task, 0, masks("slow"), START + 60 * MINUTE);
        site.whole();
    });
}

#[test]
fn a_key_is_taken_once() {
    on_each("keys", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.claim(site.ann, START).expect("a task");
        let draft = event(
            EventKind::Draft,
            site.epoch(site.ann, task),
            0,
            Some(masks("one")),
        );
        let before = site.store.last_seq().expect("a place");
        let first = site.send(site.ann, task, draft.clone(), START);
        for _ in 0..5 {
            assert_eq!(
                site.send(site.ann, task, draft.clone(), START + MINUTE),
                first
            );
        }
        assert_eq!(site.store.last_seq().expect("a place"), before + 1);
        let other = NewEvent {
            answer: Some(masks("two")),
            ..draft
        };
        assert_eq!(
            problem(&site.send(site.ann, task, other, START)),
            Code::KeyReused
        );
        site.whole();
    });
}

#[test]
fn a_stale_revision_is_refused_with_the_other_one_and_both_stay_in_the_log() {
    on_each("stale", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.claim(site.ann, START).expect("a task");
        let epoch = site.epoch(site.ann, task);
        let draft = |base, text| event(EventKind::Draft, epoch, base, Some(masks(text)));
        assert_eq!(site.send(site.ann, task, draft(0, "tab one"), START).rev, 1);
        let result = site.send(site.ann, task, draft(0, "tab two"), START);
        assert_eq!(
            (result.status, problem(&result)),
            (409, Code::StaleRevision)
        );
        let theirs = result
            .problem
            .and_then(|problem| problem.theirs)
            .expect("the other one");
        assert_eq!((theirs.rev, theirs.answer), (1, masks("tab one")));
        let log = site.store.log(0, 1000).expect("the log");
        for text in ["tab one", "tab two"] {
            assert!(
                log.iter()
                    .any(|entry| entry.body.to_string().contains(text)),
                "{text}"
            );
        }
        assert_eq!(site.send(site.ann, task, draft(1, "merged"), START).rev, 2);
        site.whole();
    });
}

#[test]
fn a_batch_stops_at_the_first_event_that_fails() {
    on_each("batch", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.claim(site.ann, START).expect("a task");
        let epoch = site.epoch(site.ann, task);
        let batch = vec![
            event(EventKind::Draft, epoch, 0, Some(masks("one"))),
            event(EventKind::Submit, epoch, 0, Some(masks("two"))),
            event(EventKind::Submit, epoch, 1, Some(masks("three"))),
        ];
        let results = site
            .store
            .append(site.ann, task, batch.clone(), START)
            .expect("takes events");
        let statuses: Vec<u16> = results.iter().map(|result| result.status).collect();
        assert_eq!(statuses, [200, 409]);
        let results = site
            .store
            .append(site.ann, task, batch[2..].to_vec(), START)
            .expect("takes events");
        assert_eq!(results[0].state, Some(TaskState::Submitted));
        site.whole();
    });
}

#[test]
fn an_answer_can_be_taken_back_until_it_is_reviewed() {
    on_each("undo", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.answer(site.ann, "hasty", START);
        let undone = site.send(site.ann, task, event(EventKind::Undo, 0, 1, None), START);
        assert_eq!(
            (undone.status, undone.state, undone.rev),
            (200, Some(TaskState::Leased), 2)
        );
        let epoch = undone.lease.expect("a lease again").epoch;
        assert_eq!(site.claim(site.bob, START), None, "the place is still mine");
        let again = event(EventKind::Submit, epoch, 2, Some(masks("better")));
        assert_eq!(site.send(site.ann, task, again, START).status, 200);
        let (reviewed, lease) = site.review(START);
        assert_eq!(reviewed, task);
        let late = site.send(site.ann, task, event(EventKind::Undo, 0, 3, None), START);
        assert_eq!(problem(&late), Code::WrongState);
        assert_eq!(
            site.decide(task, lease, Decision::Accept, START),
            Ok(TaskState::Accepted)
        );
        site.whole();
    });
}

#[test]
fn a_returned_task_comes_back_to_its_author_first_and_to_others_after_days() {
    on_each("returned", |store| {
        let site = fixture(store, mask_tasks(2));
        let task = site.answer(site.ann, "poor", START);
        site.send_back(task, START);
        let home = site.store.home(site.ann, START).expect("home");
        assert_eq!(
            (home.returned[0].task, home.returned[0].comment.as_str()),
            (task, "because")
        );
        let other = site.claim(site.bob, START).expect("the other task");
        assert_ne!(other, task);
        assert_eq!(
            site.claim(site.ann, START),
            Some(task),
            "first in its author's queue"
        );
        let detail = site.store.task(&site.who(site.ann), task).expect("a task");
        assert_eq!(detail.comment.as_deref(), Some("because"));
        site.submit(site.ann, task, 1, masks("good"), START);
        site.send_back(task, START);
        let weeks_later = START + 8 * 24 * 60 * MINUTE;
        site.submit(site.bob, other, 0, masks("x"), START);
        assert_eq!(site.claim(site.bob, weeks_later), Some(task));
        site.whole();
    });
}

#[test]
fn reviewers_do_not_judge_their_own_work_and_decisions_can_be_undone() {
    on_each("review", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.answer(site.eve.id, "mine", START);
        let review = site
            .store
            .review_next(site.eve.id, ReviewQueue::Sample, None, START)
            .expect("claims");
        let Err(empty) = review else {
            panic!("one's own work is not given out")
        };
        assert_eq!((empty.waiting, empty.mine), (1, 1));
        assert_eq!(
            site.decide(task, 0, Decision::Accept, START),
            Err(Code::OwnWork)
        );
        let other = Fixture {
            store: Arc::clone(&site.store),
            ann: site.ann,
            bob: site.bob,
            eve: Who {
                id: site
                    .store
                    .add_user(None, "zoe", Role::Reviewer, START)
                    .expect("a user")
                    .id,
                name: "zoe".to_owned(),
                role: Role::Reviewer,
            },
        };
        assert_eq!(
            other.decide(task, 99, Decision::Accept, START),
            Err(Code::LeaseLost)
        );
        let (_, lease) = other.review(START);
        assert_eq!(
            other.decide(task, lease, Decision::Merge, START),
            Ok(TaskState::Accepted)
        );
        assert_eq!(
            other.decide(task, lease, Decision::Accept, START),
            Err(Code::WrongState)
        );
        let accepted = site.store.accepted(&all_keys()).expect("answers");
        assert!(accepted[0].merged && accepted[0].answer == masks("merged"));
        assert_eq!(
            other.decide(task, 0, Decision::Reopen, START),
            Ok(TaskState::Submitted)
        );
        assert!(
            site.store
                .accepted(&all_keys())
                .expect("answers")
                .is_empty()
        );
        let (_, lease) = other.review(START);
        assert_eq!(
            other.decide(task, lease, Decision::Drop, START),
            Ok(TaskState::Dropped)
        );
        assert_eq!(site.state(task), TaskState::Dropped);
        site.whole();
    });
}

#[test]
fn two_answers_that_differ_come_first_in_the_queue_of_disagreement() {
    on_each("disagreement", |store| {
        let site = fixture(store, Vec::new());
        let settings = Settings {
            answers_per_task: 2,
            ..site.store.settings().expect("settings")
        };
        site.store
            .put_settings(1, settings, START)
            .expect("settings");
        site.store
            .import(None, mask_tasks(2), START)
            .expect("tasks");
        for user in [site.ann, site.bob] {
            let task = site.claim(user, START).expect("a task");
            site.submit(user, task, 0, masks("same"), START);
            let task = site.claim(user, START).expect("a task");
            let mut answer = masks("same");
            if let (true, Answer::MaskText { masks, .. }) = (user == site.bob, &mut answer) {
                masks[0].parts = vec!["RIGHT_ARM".to_owned()];
            }
            site.submit(user, task, 0, answer, START);
        }
        let (task, _) = site.review(START);
        let record = site.store.task_record(task).expect("a task");
        assert!(record.distance.expect("a distance") > 0.0);
        site.whole();
    });
}

/// An answer whose first mask, the left arm, holds for a range.
fn in_range(range: [i32; 2]) -> Answer {
    let mut answer = masks("waving");
    if let Answer::MaskText { masks, .. } = &mut answer {
        masks[0].range = Some(range);
    }
    answer
}

#[test]
fn ranges_and_joints_are_checked_and_kept() {
    on_each("ranges", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.claim(site.ann, START).expect("a task");
        let epoch = site.epoch(site.ann, task);
        let send = |kind, rev, answer: Answer| {
            site.send(site.ann, task, event(kind, epoch, rev, Some(answer)), START)
        };
        let with_joint = |joint: &str, weight| {
            let mut answer = in_range([4, 36]);
            if let Answer::MaskText { masks, .. } = &mut answer {
                masks[0].joints = vec![JointChoice {
                    joint: joint.to_owned(),
                    weight,
                }];
            }
            answer
        };
        for (answer, field, words) in [
            (in_range([4, 34]), "range", "a range needs 31 at least"),
            (in_range([20, 41]), "range", "of a clip of 40 frames"),
            (in_range([30, 4]), "range", "a later end"),
            (
                with_joint("left_elbow", JointWeight::Hard),
                "joints",
                "is hard in the mask of the parts already",
            ),
        ] {
            let refused = send(EventKind::Submit, 0, answer);
            let problem = refused.problem.expect("a problem");
            assert_eq!(problem.code, Code::Invalid);
            assert_eq!(problem.field, Some(format!("answer.masks.0.{field}")));
            assert!(problem.detail.starts_with("mask 1"), "{}", problem.detail);
            assert!(problem.detail.contains(words), "{}", problem.detail);
        }
        let unknown = send(EventKind::Draft, 0, with_joint("tail", JointWeight::Hard));
        assert_eq!(problem(&unknown), Code::Invalid);
        // An end on its way through a short range is a draft like any other.
        assert_eq!(send(EventKind::Draft, 0, in_range([4, 5])).status, 200);
        let answer = with_joint("left_collar", JointWeight::None);
        assert_eq!(send(EventKind::Submit, 1, answer.clone()).status, 200);
        let (waiting, lease) = site.review(START);
        assert_eq!(
            site.decide(waiting, lease, Decision::Accept, START),
            Ok(TaskState::Accepted)
        );
        let accepted = site.store.accepted(&all_keys()).expect("answers");
        assert_eq!(accepted[0].answer, answer);
        site.whole();
    });
}

#[test]
fn a_merged_answer_has_ranges_of_the_clip_too() {
    on_each("merged_ranges", |store| {
        let site = fixture(store, mask_tasks(1));
        site.answer(site.ann, "waving", START);
        let (task, lease_epoch) = site.review(START);
        let merge = |range| {
            let review = NewReview {
                idem_key: key(),
                task,
                lease_epoch,
                decision: Decision::Merge,
                author: None,
                answer: Some(in_range(range)),
                comment: String::new(),
                secs: 0.0,
            };
            site.store.review(site.eve.id, review, START)
        };
        let refused = merge([9, 41]).expect_err("it leaves the clip");
        assert_eq!(refused.problem().code, Code::Invalid);
        assert_eq!(merge([9, 40]).expect("merges").state, TaskState::Accepted);
        site.whole();
    });
}

#[test]
fn a_mask_of_a_store_of_an_earlier_version_has_the_bytes_that_it_had() {
    let earlier = r#"{"parts":["LEFT_ARM"],"soft":true,"text":"waving","suggestion":null}"#;
    let mask: MaskAnswer = serde_json::from_str(earlier).expect("a mask");
    assert!(mask.range.is_none() && mask.joints.is_empty());
    assert_eq!(serde_json::to_string(&mask).expect("JSON"), earlier);
}

#[test]
fn skipped_tasks_stay_away_and_postponed_ones_come_last() {
    on_each("skips", |store| {
        let site = fixture(store, mask_tasks(3));
        let first = site.claim(site.ann, START).expect("a task");
        let lacking = event(EventKind::Skip, site.epoch(site.ann, first), 0, None);
        assert_eq!(
            problem(&site.send(site.ann, first, lacking, START)),
            Code::Invalid
        );
        let skip = NewEvent {
            reason: Some(SkipReason::CannotTell),
            ..event(EventKind::Skip, site.epoch(site.ann, first), 0, None)
        };
        assert_eq!(
            site.send(site.ann, first, skip, START).state,
            Some(TaskState::Open)
        );
        let second = site.claim(site.ann, START).expect("a task");
        let later = event(EventKind::Postpone, site.epoch(site.ann, second), 0, None);
        assert_eq!(site.send(site.ann, second, later, START).status, 200);
        let third = site.answer(site.ann, "third", START);
        assert_ne!(third, second);
        assert_eq!(site.claim(site.ann, START), Some(second));
        assert_eq!(
            site.claim(site.bob, START),
            Some(first),
            "others may still want it"
        );
        assert_eq!(site.store.rejects(&all_keys()).expect("rejects").len(), 1);
        site.whole();
    });
}

#[test]
fn a_bundle_is_leased_together_and_handed_in_one_by_one() {
    on_each("bundles", |store| {
        let tasks = (0..10)
            .map(|number| NewTask {
                bundle: Some(if number < 8 { "a" } else { "b" }.to_owned()),
                bundle_index: number % 8,
                ..bare_task(usize::try_from(number).expect("small"), TaskKind::Pair)
            })
            .collect();
        let site = fixture(store, tasks);
        let mut seen = Vec::new();
        let first = site
            .claim_kind(site.ann, TaskKind::Pair, START)
            .expect("a task");
        let lease = site
            .store
            .task(&site.who(site.ann), first)
            .expect("a task")
            .lease
            .expect("a lease");
        site.store
            .renew(site.ann, lease.id, START + 10 * MINUTE)
            .expect("renews");
        let ends: Vec<i64> = site
            .store
            .leases(START)
            .expect("leases")
            .iter()
            .map(|held| held.lease.expires)
            .collect();
        assert_eq!(
            ends,
            [START + 25 * MINUTE; 8],
            "the bundle is renewed as one"
        );
        for number in 0..8 {
            let task = site
                .claim_kind(site.ann, TaskKind::Pair, START)
                .expect("a task");
            let detail = site.store.task(&site.who(site.ann), task).expect("a task");
            assert_eq!(
                detail.bundle.iter().filter(|item| item.leased).count(),
                8 - number
            );
            let verdict = if number % 2 == 0 {
                Verdict::Unnatural
            } else {
                Verdict::Keep
            };
            site.submit(site.ann, task, 0, pair(verdict), START);
            seen.push(task);
        }
        let mut distinct = seen.clone();
        distinct.dedup();
        assert_eq!(distinct.len(), 8);
        let other = site
            .claim_kind(site.ann, TaskKind::Pair, START)
            .expect("the next bundle");
        assert!(!seen.contains(&other));
        assert_eq!(site.claim_kind(site.bob, TaskKind::Pair, START), None);
        site.whole();
    });
}

/// Makes gold tasks from answers that nobody here gave, and has them given out at this rate.
fn make_golds(site: &Fixture, count: usize, kind: TaskKind, percent: u32) -> Vec<i64> {
    let settings = Settings {
        gold_percent: percent,
        ..site.store.settings().expect("settings")
    };
    let stored = site.store.put_settings(1, settings, START);
    stored.expect("settings");
    let known = (0..count).map(|number| NewTask {
        accepted: Some(match kind {
            TaskKind::Pair => pair(Verdict::Keep),
            _ => masks("known"),
        }),
        suggestions: vec![draft("a draft")],
        ..bare_task(900_000 + number, kind)
    });
    site.store
        .import(None, known.collect(), START)
        .expect("tasks");
    let known = site.store.accepted(&all_keys()).expect("answers");
    let known = known
        .iter()
        .filter(|answer| answer.task.key.contains("task9"));
    known
        .map(|answer| {
            site.store
                .make_gold(1, answer.task.id, START)
                .expect("gold")
        })
        .collect()
}

fn draft(text: &str) -> annotate::store::NewSuggestion {
    annotate::store::NewSuggestion {
        source: annotate::wire::SuggestionSource::Import,
        parts: vec!["LEFT_ARM".to_owned()],
        text: text.to_owned(),
        model: "m".to_owned(),
        prompt_hash: String::new(),
        params: "{}".to_owned(),
        tokens: None,
        response_hash: String::new(),
    }
}

#[test]
fn gold_tasks_look_like_others_and_are_scored() {
    on_each("gold", |store| {
        let tasks = mask_tasks(2).into_iter().map(|task| NewTask {
            suggestions: vec![draft("another draft")],
            ..task
        });
        let site = fixture(store, tasks.collect());
        let gold = make_golds(&site, 1, TaskKind::MaskText, 100)[0];
        assert_eq!(site.claim(site.bob, START), Some(gold));
        let usual = site.claim(site.ann, START).expect("gold too");
        assert_eq!(usual, gold, "everybody gets it");
        let see = |user: i64, task: i64| site.store.task(&site.who(user), task).expect("a task");
        let seen = see(site.bob, gold);
        assert_eq!(
            (seen.task.state, seen.task.wanted, seen.task.submitted),
            (TaskState::Leased, 1, 0)
        );
        let drafts: Vec<&str> = seen
            .suggestions
            .iter()
            .map(|draft| draft.text.as_str())
            .collect();
        assert_eq!(drafts, ["a draft"]);
        let sent = event(
            EventKind::Submit,
            site.epoch(site.bob, gold),
            0,
            Some(masks("known")),
        );
        let result = site.send(site.bob, gold, sent, START);
        assert_eq!(
            (result.status, result.state),
            (200, Some(TaskState::Submitted))
        );
        let seen = see(site.bob, gold);
        assert_eq!(
            (seen.task.state, seen.task.submitted),
            (TaskState::Submitted, 1)
        );
        // Answers to other tasks look the same.
        let other = site.answer(site.bob, "other", START);
        let seen = see(site.bob, other);
        assert_eq!(
            (seen.task.state, seen.task.wanted, seen.task.submitted),
            (TaskState::Submitted, 1, 1)
        );
        let people = site.store.people().expect("people");
        let bob = people
            .iter()
            .find(|person| person.user.id == site.bob)
            .expect("bob");
        assert_eq!((bob.gold_items, bob.gold_score), (1, Some(1.0)));
        let counted: i64 = site
            .store
            .funnel()
            .expect("counts")
            .iter()
            .map(|(_, _, count)| count)
            .sum();
        assert_eq!(counted, 3, "gold tasks are not counted as work");
        site.whole();
    });
}

#[test]
fn a_gold_task_is_not_given_to_those_who_know_its_answer() {
    on_each("gold_authors", |store| {
        let site = fixture(store, mask_tasks(6));
        let task = site.answer(site.ann, "known", START);
        assert!(
            site.store.make_gold(1, task, START).is_err(),
            "only accepted answers are known"
        );
        let (_, lease) = site.review(START);
        assert_eq!(
            site.decide(task, lease, Decision::Accept, START),
            Ok(TaskState::Accepted)
        );
        let gold = site.store.make_gold(1, task, START).expect("a gold task");
        let settings = Settings {
            gold_percent: 100,
            ..site.store.settings().expect("settings")
        };
        site.store
            .put_settings(1, settings, START)
            .expect("settings");
        for user in [site.ann, site.eve.id] {
            let given = site.claim(user, START).expect("a task");
            assert_ne!(given, gold, "its author and its reviewer know the answer");
        }
        assert_eq!(site.claim(site.bob, START), Some(gold));
        // Once its answer is no longer accepted it is no measure.
        assert_eq!(
            site.decide(task, 0, Decision::Reopen, START),
            Ok(TaskState::Submitted)
        );
        let zoe = site.store.add_user(None, "zoe", Role::Annotator, START);
        let zoe = zoe.expect("a user").id;
        assert_ne!(site.claim(zoe, START), Some(gold));
        site.whole();
    });
}

#[test]
fn gold_is_drawn_for_each_answer_and_stands_in_the_places_of_a_bundle() {
    on_each("gold_bundles", |store| {
        let bundled = |number: usize| NewTask {
            bundle: Some(format!("bundle{}", number / 8)),
            bundle_index: (number % 8) as i64,
            ..bare_task(number, TaskKind::Pair)
        };
        let site = fixture(store, (0..40).map(bundled).collect());
        let golds = make_golds(&site, 30, TaskKind::Pair, 40);
        let (mut given, mut places) = (Vec::new(), 0);
        while let Some(task) = site.claim_kind(site.ann, TaskKind::Pair, START) {
            let detail = site.store.task(&site.who(site.ann), task).expect("a task");
            assert_eq!(detail.bundle.len(), 8, "as many places as in every bundle");
            let place = detail.bundle.iter().position(|entry| entry.task == task);
            let place = place.expect("a place of its own");
            assert_eq!(detail.task.bundle_index, place as i64);
            places += usize::from(golds.contains(&task)) * place;
            let lease = detail.lease.expect("a lease");
            // All of the bundle is renewed, whichever of it is renewed.
            let renewed = site.store.renew(site.ann, lease.id, START + MINUTE);
            let renewed = renewed.expect("renews").expires;
            let all = site.store.leases(START).expect("leases");
            assert!(all.iter().all(|held| held.lease.expires == renewed));
            let answer = Some(pair(Verdict::Unclear));
            let sent = event(EventKind::Submit, lease.epoch, 0, answer);
            let result = site.send(site.ann, task, sent, START);
            assert_eq!(
                (result.status, result.state),
                (200, Some(TaskState::Submitted))
            );
            given.push(task);
        }
        let drawn = given.iter().filter(|task| golds.contains(task)).count();
        assert_eq!(given.len(), 40 + drawn, "each pair is answered too");
        let share = given[..40]
            .iter()
            .filter(|task| golds.contains(task))
            .count();
        assert!((8..=24).contains(&share), "{share} of the first 40 answers");
        assert!(places > 0, "not only at the start of a bundle");
        let mut distinct = given.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), given.len());
        site.whole();
    });
}

#[test]
fn the_motions_of_the_next_tasks_are_named_gold_ones_too() {
    on_each("upcoming", |store| {
        let of = |name: &str, number: usize| NewTask {
            source: format!("{name}{number}"),
            ..bare_task(number, TaskKind::Pair)
        };
        let bundled = |number: usize| NewTask {
            bundle: Some("bundle".to_owned()),
            bundle_index: number as i64,
            ..of("bundled", number)
        };
        let mut tasks: Vec<NewTask> = (0..4).map(bundled).collect();
        tasks.extend((4..8).map(|number| of("later", number)));
        tasks.push(NewTask {
            accepted: Some(pair(Verdict::Keep)),
            ..of("known", 8)
        });
        let site = fixture(store, tasks);
        let next = |user: i64| match site.store.claim(user, TaskKind::Pair, 3, START) {
            Ok(Ok((detail, upcoming))) => (detail.task.source, upcoming.join(" ")),
            other => panic!("{other:?}"),
        };
        let (present, following) = next(site.ann);
        assert_eq!(present, "bundled0");
        assert_eq!(
            following, "bundled1 bundled2 bundled3",
            "the rest of the bundle"
        );
        let accepted = site.store.accepted(&all_keys()).expect("answers");
        let gold = site.store.make_gold(1, accepted[0].task.id, START);
        gold.expect("a gold task");
        let settings = Settings {
            gold_percent: 1,
            ..site.store.settings().expect("settings")
        };
        site.store
            .put_settings(1, settings, START)
            .expect("settings");
        let (present, following) = next(site.bob);
        let others = following.replace("known8 ", "");
        assert_ne!(others, following, "a gold task may come next: {following}");
        assert!(
            present.starts_with("later") && others == "later5 later6",
            "{others}"
        );
        site.whole();
    });
}

#[test]
fn home_promises_what_a_claim_gives() {
    on_each("promises", |store| {
        let site = fixture(store, mask_tasks(2));
        let open = |user: i64, now: i64| site.open(user, TaskKind::MaskText, now);
        let (first, second) = (site.claim(site.ann, START), site.claim(site.eve.id, START));
        assert!(first.is_some() && second.is_some() && first != second);
        assert_eq!(open(site.ann, START), 1, "what I hold is mine to do");
        assert_eq!(
            (open(site.bob, START), site.claim(site.bob, START)),
            (0, None)
        );
        // Expired leases are ended by the next claim.
        let later = START + 16 * MINUTE;
        assert_eq!(open(site.bob, later), 2);
        let task = site.skip(site.bob, later);
        assert_eq!(open(site.bob, later), 1);
        assert_eq!(
            site.claim(site.bob, later),
            first.filter(|&id| id != task).or(second)
        );
        // A returned answer waits for its author.
        let task = site.answer(site.bob, "poor", later);
        assert_eq!(open(site.bob, later), 0);
        site.send_back(task, later);
        assert_eq!(open(site.bob, later), 1);
        assert_eq!(site.claim(site.bob, later), Some(task));
        site.whole();
    });
}

#[test]
fn home_leaves_out_pairs_that_the_quota_of_their_category_holds_back() {
    on_each("promised pairs", |store| {
        let tasks = (0..9).map(|number| NewTask {
            category: Some(if number < 6 { "walk" } else { "wave" }.to_owned()),
            ..bare_task(number, TaskKind::Pair)
        });
        let site = fixture(store, tasks.collect());
        let open = |user: i64, now: i64| site.open(user, TaskKind::Pair, now);
        assert_eq!(open(site.ann, START), 9);
        let settings = Settings {
            category_quota: 2,
            ..site.store.settings().expect("settings")
        };
        site.store
            .put_settings(1, settings, START)
            .expect("settings");
        assert_eq!(open(site.ann, START), 4, "two of each category");
        // Ann takes all that there is room for, two keeps of each category.
        let mut taken = Vec::new();
        while let Some(task) = site.claim_kind(site.ann, TaskKind::Pair, START) {
            assert_eq!(open(site.ann, START), 4 - taken.len() as i64);
            let epoch = site.epoch(site.ann, task);
            if taken.len() == 3 {
                break;
            }
            let sent = event(EventKind::Submit, epoch, 0, Some(pair(Verdict::Keep)));
            assert_eq!(site.send(site.ann, task, sent, START).status, 200);
            taken.push(task);
        }
        assert_eq!(taken.len(), 3);
        assert_eq!(open(site.ann, START), 1, "the one she holds");
        assert_eq!(open(site.bob, START), 0);
        assert_eq!(site.claim_kind(site.bob, TaskKind::Pair, START), None);
        // Her lease expires: the pair and its place in the category are free again.
        let later = START + 16 * MINUTE;
        assert_eq!(open(site.bob, later), 1);
        assert!(site.claim_kind(site.bob, TaskKind::Pair, later).is_some());
        assert_eq!(open(site.ann, later), 0);
        site.whole();
    });
}

#[test]
fn a_held_task_is_mine_on_the_home_page() {
    on_each("held", |store| {
        let site = fixture(store, mask_tasks(3));
        let queue = |user: i64| {
            let home = site.store.home(user, START).expect("home");
            home.queues.into_iter().next().expect("masks")
        };
        let before = queue(site.ann);
        assert_eq!((before.mine, before.held, before.held_until), (0, 0, None));
        site.answer(site.ann, "waving", START);
        site.claim(site.ann, START).expect("a task");
        let after = queue(site.ann);
        assert_eq!((after.mine, after.held, after.open), (2, 1, 2));
        assert_eq!(after.held_until, Some(START + 15 * MINUTE));
    });
}

#[test]
fn a_returned_answer_waits_for_its_author_through_lost_leases_and_then_goes_to_anybody() {
    on_each("reserved", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.answer(site.ann, "poor", START);
        site.send_back(task, START);
        // She looks at it and leaves: it is still hers.
        assert_eq!(site.claim(site.ann, START), Some(task));
        let hour = 60 * MINUTE;
        assert_eq!(site.open(site.bob, TaskKind::MaskText, START + hour), 0);
        assert_eq!(site.claim(site.bob, START + hour), None);
        let home = site.store.home(site.ann, START + hour).expect("home");
        assert_eq!(home.returned[0].task, task);
        assert_eq!(home.returned[0].until, START + 7 * 24 * hour);
        // The same with a draft, and when she gives the lease back.
        assert_eq!(site.claim(site.ann, START + hour), Some(task));
        let draft = event(
            EventKind::Draft,
            site.epoch(site.ann, task),
            1,
            Some(masks("better")),
        );
        assert_eq!(site.send(site.ann, task, draft, START + hour).status, 200);
        let detail = site.store.task(&site.who(site.ann), task).expect("a task");
        let lease = detail.lease.expect("a lease").id;
        site.store
            .release(&site.who(site.ann), lease, START + hour)
            .expect("gives it back");
        assert_eq!(site.claim(site.bob, START + hour), None);
        assert_eq!(site.state(task), TaskState::Returned);
        // After the days of the setting anybody may take it, its author too.
        let weeks = START + 8 * 24 * hour;
        assert_eq!(site.claim(site.bob, weeks), Some(task));
        let bob = Who {
            role: Role::Annotator,
            ..site.who(site.bob)
        };
        let lease = site.store.task(&bob, task).expect("a task").lease;
        let lease = lease.expect("a lease").id;
        site.store
            .release(&bob, lease, weeks)
            .expect("gives it back");
        assert_eq!(site.open(site.ann, TaskKind::MaskText, weeks), 1);
        assert_eq!(site.claim(site.ann, weeks), Some(task));
        site.whole();
    });
}

#[test]
fn a_reviewer_who_takes_a_returned_task_away_gives_it_to_others() {
    on_each("taken_away", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.answer(site.ann, "poor", START);
        site.send_back(task, START);
        assert_eq!(site.claim(site.ann, START), Some(task));
        let lease = site.store.leases(START).expect("leases")[0].lease.id;
        site.store
            .release(&site.eve, lease, START)
            .expect("a reviewer may");
        assert_eq!(site.claim(site.bob, START), Some(task));
        site.whole();
    });
}

#[test]
fn the_work_of_a_disabled_user_goes_on_to_others_at_once() {
    on_each("disabled", |store| {
        let site = fixture(store, mask_tasks(2));
        let returned = site.answer(site.ann, "poor", START);
        site.send_back(returned, START);
        let held = site.claim(site.bob, START).expect("a task");
        for user in [site.ann, site.bob] {
            let changed = site
                .store
                .change_user(Some(1), user, None, Some(false), START);
            changed.expect("a change");
        }
        let zoe = site.store.add_user(None, "zoe", Role::Annotator, START);
        let zoe = zoe.expect("a user").id;
        let mut got = vec![
            site.answer(zoe, "one", START),
            site.answer(zoe, "two", START),
        ];
        got.sort_unstable();
        let mut expected = vec![returned, held];
        expected.sort_unstable();
        assert_eq!(got, expected);
        site.whole();
    });
}

#[test]
fn leases_are_renewed_given_back_and_taken_away() {
    on_each("leases", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.claim(site.ann, START).expect("a task");
        let lease = site
            .store
            .task(&site.who(site.ann), task)
            .expect("a task")
            .lease
            .expect("a lease");
        let renewed = site
            .store
            .renew(site.ann, lease.id, START + MINUTE)
            .expect("renews");
        assert_eq!(renewed.expires, lease.expires + MINUTE);
        assert!(site.store.renew(site.bob, lease.id, START).is_err());
        assert!(
            site.store
                .release(&site.who(site.bob), lease.id, START)
                .is_err()
        );
        site.store
            .release(&site.eve, lease.id, START)
            .expect("a reviewer may");
        let lost = site
            .store
            .renew(site.ann, lease.id, START)
            .expect_err("gone");
        assert_eq!(lost.problem().code, Code::LeaseLost);
        assert_eq!(site.claim(site.bob, START), Some(task));
        site.whole();
    });
}

#[test]
fn tokens_end_are_revoked_and_work_once_where_they_should() {
    on_each("tokens", |store| {
        plain_settings(store.as_ref());
        let user = store
            .add_user(None, "ann", Role::Annotator, START)
            .expect("a user");
        let issue = |purpose| {
            store
                .issue(user.id, purpose, START + MINUTE, START)
                .expect("a token")
                .token
        };
        let token = issue(TokenUse::Token);
        let good = |token: &str, purpose, now| store.authenticate(token, &[purpose], now).is_ok();
        assert!(good(&token, TokenUse::Token, START));
        assert!(
            !good(&token, TokenUse::Session, START),
            "a token is no session"
        );
        assert!(!good(&token, TokenUse::Token, START + MINUTE), "it ended");
        assert!(!good("ann_0000", TokenUse::Token, START));
        let once = issue(TokenUse::Once);
        assert!(good(&once, TokenUse::Once, START));
        assert!(!good(&once, TokenUse::Once, START), "it was used");
        let session = issue(TokenUse::Session);
        store.log_out(&session).expect("logs out");
        assert!(!good(&session, TokenUse::Session, START));
        let session = issue(TokenUse::Session);
        let id = store.tokens(user.id).expect("tokens")[0].id;
        store.revoke(id).expect("revokes");
        assert!(!good(&token, TokenUse::Token, START));
        assert!(
            !good(&session, TokenUse::Session, START),
            "sessions go with it"
        );
        let token = issue(TokenUse::Token);
        store
            .change_user(None, user.id, None, Some(false), START)
            .expect("changes");
        assert!(!good(&token, TokenUse::Token, START));
        let admin = store.users().expect("users")[0].clone();
        assert!(
            store
                .change_user(None, admin.id, Some(Role::Annotator), None, START)
                .is_err(),
            "the last admin"
        );
        assert!(
            store.add_user(None, "ann", Role::Admin, START).is_err(),
            "the name is taken"
        );
    });
}

#[test]
fn importing_again_changes_nothing() {
    on_each("import", |store| {
        let site = fixture(store, mask_tasks(3));
        site.answer(site.ann, "done", START);
        let again = site
            .store
            .import(None, mask_tasks(5), START)
            .expect("imports");
        assert_eq!((again.new, again.known), (2, 3));
        site.whole();
    });
}

#[test]
fn random_walks_end_in_a_store_that_follows_from_its_log() {
    on_each("walks", |store| {
        let site = fixture(store, Vec::new());
        let settings = Settings {
            answers_per_task: 2,
            lease_minutes: 5,
            blind_percent: 50,
            gold_percent: 20,
            ..site.store.settings().expect("settings")
        };
        site.store
            .put_settings(1, settings, START)
            .expect("settings");
        let mut tasks = mask_tasks(6);
        tasks.extend((6..16).map(|number| NewTask {
            bundle: Some(format!("{}", number / 4)),
            bundle_index: number % 4,
            ..bare_task(usize::try_from(number).expect("small"), TaskKind::Pair)
        }));
        site.store.import(None, tasks, START).expect("tasks");
        let mut rng = Seed(11).rng(&["walk"]);
        let mut now = START;
        let mut held: BTreeMap<i64, Vec<i64>> = BTreeMap::new();
        for step in 0..1500 {
            now += rng.random_range(0..2 * MINUTE);
            let user = [site.ann, site.bob, site.eve.id][rng.random_range(0..3)];
            let kind = if rng.random::<bool>() {
                TaskKind::MaskText
            } else {
                TaskKind::Pair
            };
            match rng.random_range(0..10) {
                0..4 => {
                    let promised = site.open(user, kind, now);
                    let claimed = site.claim_kind(user, kind, now);
                    assert_eq!(
                        promised > 0,
                        claimed.is_some(),
                        "home promises {promised}, the claim gives {claimed:?}"
                    );
                    held.entry(user).or_default().extend(claimed);
                }
                4..8 => {
                    let Some(task) = held.get(&user).and_then(|tasks| tasks.last()).copied() else {
                        continue;
                    };
                    let kind = site.store.task_record(task).expect("a task").kind;
                    let answer = match kind {
                        TaskKind::Pair => pair(Verdict::ALL[rng.random_range(0..4)]),
                        _ => masks(&format!("step {step}")),
                    };
                    let rev = site
                        .store
                        .task(&site.who(user), task)
                        .ok()
                        .and_then(|detail| detail.mine)
                        .map_or(0, |mine| mine.rev);
                    let what = [
                        EventKind::Draft,
                        EventKind::Submit,
                        EventKind::Submit,
                        EventKind::Undo,
                        EventKind::Skip,
                        EventKind::Postpone,
                    ][rng.random_range(0..6)];
                    let stale = i64::from(rng.random_range(0..8) == 0);
                    let epoch = site.store.task(&site.eve, task).map_or(0, |_| {
                        site.store
                            .leases(0)
                            .expect("leases")
                            .iter()
                            .find(|held| held.lease.task == task && held.lease.user == user)
                            .map_or(0, |held| held.lease.epoch)
                    });
                    let mut sent = event(what, epoch, rev - stale, Some(answer));
                    sent.reason = Some(SkipReason::Other);
                    let result = site.send(user, task, sent.clone(), now);
                    assert_eq!(site.send(user, task, sent, now).status, result.status);
                }
                8 => {
                    let claimed =
                        site.store
                            .review_next(site.eve.id, ReviewQueue::Disagreement, None, now);
                    if let Ok(detail) = claimed.expect("claims") {
                        let decision = Decision::ALL[rng.random_range(0..4)];
                        let author = detail
                            .candidates
                            .iter()
                            .find(|(revision, _)| revision.state == RevisionState::Submitted)
                            .map(|(revision, _)| revision.author);
                        let mut review = NewReview {
                            idem_key: key(),
                            task: detail.task.id,
                            lease_epoch: detail.lease.epoch,
                            decision,
                            author: author.filter(|_| decision != Decision::Merge),
                            answer: None,
                            comment: "walk".to_owned(),
                            secs: 3.0,
                        };
                        if decision == Decision::Merge {
                            review.answer = Some(match detail.task.kind {
                                TaskKind::Pair => pair(Verdict::Keep),
                                _ => masks("merged"),
                            });
                        }
                        site.store
                            .review(site.eve.id, review, now)
                            .expect("decides");
                    }
                }
                _ => {
                    for task in 1..=16 {
                        if site.state(task) == TaskState::Accepted && rng.random::<bool>() {
                            // It may be gold already.
                            let _tried = site.store.make_gold(1, task, now);
                        }
                    }
                    let decided = site.store.funnel().expect("counts");
                    if decided
                        .iter()
                        .any(|(_, state, count)| *state == TaskState::Dropped && *count > 8)
                    {
                        for task in 1..=16 {
                            let state = site.state(task);
                            if state == TaskState::Dropped || state == TaskState::Accepted {
                                // Its author may not reopen it.
                                let _tried = site.decide(task, 0, Decision::Reopen, now);
                            }
                        }
                    }
                }
            }
        }
        site.whole();
        let before = site.store.funnel().expect("counts");
        assert_eq!(site.store.rebuild().expect("rebuilds"), Vec::<&str>::new());
        assert_eq!(site.store.funnel().expect("counts"), before);
        assert!(site.store.last_seq().expect("a place") > 500);
    });
}

#[test]
fn many_at_once_lose_nothing() {
    on_each("many", |store| {
        let site = fixture(store, mask_tasks(60));
        let users: Vec<i64> = (0..6)
            .map(|number| {
                let name = format!("worker{number}");
                site.store
                    .add_user(None, &name, Role::Annotator, START)
                    .expect("a user")
                    .id
            })
            .collect();
        std::thread::scope(|scope| {
            for &user in &users {
                let site = &site;
                scope.spawn(move || {
                    while let Some(task) = site.claim(user, START) {
                        site.submit(user, task, 0, masks("x"), START);
                    }
                });
            }
        });
        let (answered, _) = site.store.answered_since(0).expect("tasks");
        let labels = site.store.labels_to(answered).expect("labels");
        assert_eq!(labels.len(), 60, "each task was answered once");
        site.whole();
    });
}

/// Keys are ordered by bytes on every database, so that exports have the same order.
#[test]
fn keys_are_paged_in_the_order_of_their_bytes() {
    on_each("keys_are_paged", |store| {
        store.put_motions(vec![bare_motion()]).expect("motions");
        let mut keys = ["B", "a", "a b", "a-b", "A", "\u{e9}", "z", "_", "~"].map(str::to_owned);
        let tasks = keys.iter().enumerate().map(|(number, key)| NewTask {
            key: format!("~{key}"),
            ..bare_task(number, TaskKind::MaskText)
        });
        store.import(None, tasks.collect(), START).expect("tasks");
        keys.sort();
        let mut after = "~".to_owned();
        for pair in keys.chunks(2) {
            let range = store.next_keys(&after, 2).expect("keys").expect("more");
            assert_eq!(range.after, after);
            assert_eq!(range.up_to, format!("~{}", pair[pair.len() - 1]));
            after = range.up_to;
        }
        assert!(store.next_keys(&after, 2).expect("keys").is_none());
    });
}

#[test]
fn a_store_keeps_its_id_and_no_other_has_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("one.sqlite");
    let id = open_sqlite(&path).expect("a store").id().expect("an id");
    assert!(id.len() == 16 && id.chars().all(|c| c.is_ascii_hexdigit()));
    let again = open_sqlite(&path).expect("a store");
    assert_eq!(again.id().expect("an id"), id);
    on_each("ids", |other| {
        let own = other.id().expect("an id");
        assert_ne!(own, id);
        assert_eq!(other.id().expect("an id"), own);
    });
}

#[test]
fn skips_and_reviews_count_as_work_and_days_begin_in_the_time_zone_of_the_project() {
    on_each("work", |store| {
        let site = fixture(store, mask_tasks(3));
        let worked = |user: i64, now: i64| {
            let home = site.store.home(user, now).expect("a home");
            (home.today, home.today_secs)
        };
        // 22:13 UTC is 7:13 of the next day in Tokyo.
        assert_eq!(worked(site.ann, START), (0, 0.0));
        let task = site.answer(site.ann, "one", START);
        let second = site.claim(site.ann, START).expect("a task");
        let mut skip = event(EventKind::Skip, site.epoch(site.ann, second), 0, None);
        skip.reason = Some(SkipReason::CannotTell);
        assert_eq!(site.send(site.ann, second, skip, START).status, 200);
        assert_eq!(worked(site.ann, START), (1, 25.0));
        let (reviewed, epoch) = site.review(START);
        assert_eq!(reviewed, task);
        let state = site.decide(task, epoch, Decision::Accept, START);
        assert_eq!(state, Ok(TaskState::Accepted));
        assert_eq!(worked(site.eve.id, START), (0, 40.0));

        let next_day = START + 120 * MINUTE;
        assert_eq!(worked(site.ann, next_day), (0, 0.0), "0:13 UTC");
        let admin = site.store.users().expect("users")[0].id;
        let settings = |zone: &str| Settings {
            time_zone: zone.to_owned(),
            ..site.store.settings().expect("settings")
        };
        site.store
            .put_settings(admin, settings("Asia/Tokyo"), next_day)
            .expect("a time zone");
        assert_eq!(worked(site.ann, next_day), (1, 25.0), "9:13 in Tokyo");
        let refused = site
            .store
            .put_settings(admin, settings("Mars/Olympus"), next_day)
            .expect_err("no time zone");
        assert_eq!(refused.problem().code, Code::Invalid);
        site.whole();
    });
}

#[test]
fn a_task_that_nobody_took_is_not_said_to_be_taken() {
    on_each("nobody", |store| {
        let site = fixture(store, mask_tasks(1));
        let task = site.claim(site.ann, START).expect("a task");
        let epoch = site.epoch(site.ann, task);
        let later = START + 16 * MINUTE;
        // Any claim ends leases that ran out; this one is for another kind of task.
        assert_eq!(site.claim_kind(site.bob, TaskKind::Style, later), None);
        let say = |base: i64, text: &str, now: i64| {
            let late = event(EventKind::Draft, epoch, base, Some(masks(text)));
            let result = site.send(site.ann, task, late, now);
            assert_eq!(problem(&result), Code::LeaseLost);
            result.problem.expect("a problem").detail
        };
        let detail = say(0, "late", later);
        assert!(!detail.contains("somebody else"), "{detail}");
        assert_eq!(site.claim(site.bob, later), Some(task));
        let detail = say(1, "later", later);
        assert!(detail.contains("somebody else has the task"), "{detail}");
        site.whole();
    });
}

#[test]
fn a_category_gets_no_more_pairs_than_its_quota_and_the_emptiest_comes_first() {
    on_each("a category quota", |store| {
        let tasks = (0..40)
            .map(|number| NewTask {
                category: Some(if number < 20 { "walk" } else { "wave" }.to_owned()),
                bundle: Some(format!("bundle {}", number / 8)),
                bundle_index: number as i64 % 8,
                ..bare_task(number, TaskKind::Pair)
            })
            .collect();
        let fixture = fixture(store, tasks);
        let quota = |category_quota: u32| {
            let settings = Settings {
                category_quota,
                ..fixture.store.settings().expect("settings")
            };
            let put = fixture.store.put_settings(1, settings, START);
            put.expect("settings");
        };
        quota(6);
        let category = |task: i64| {
            let task = fixture.store.task_record(task).expect("a task");
            task.category.expect("a category")
        };
        let answer = |user: i64, verdict: Verdict| {
            let task = fixture
                .claim_kind(user, TaskKind::Pair, START)
                .expect("a task");
            fixture.submit(user, task, 0, pair(verdict), START);
            category(task)
        };
        // Ann is at work on six walks, which is all there is room for; Bob gets the other category.
        assert_eq!(answer(fixture.ann, Verdict::Keep), "walk");
        assert_eq!(fixture.store.leases(START).expect("leases").len(), 5);
        assert_eq!(answer(fixture.bob, Verdict::Unclear), "wave");
        // A pair that is not kept makes room again once that is decided.
        let (task, lease) = fixture.review(START);
        assert_eq!(category(task), "walk");
        let done = fixture.decide(task, lease, Decision::Accept, START);
        assert_eq!(done, Ok(TaskState::Accepted));
        let (task, lease) = fixture.review(START);
        assert_eq!(category(task), "wave");
        let done = fixture.decide(task, lease, Decision::Accept, START);
        assert_eq!(done, Ok(TaskState::Accepted));
        for _ in 0..5 {
            assert_eq!(answer(fixture.ann, Verdict::Keep), "walk");
        }
        let mut bob = BTreeMap::new();
        for _ in 0..100 {
            if fixture
                .claim_kind(fixture.bob, TaskKind::Pair, START)
                .is_none()
            {
                break;
            }
            *bob.entry(answer(fixture.bob, Verdict::Keep)).or_insert(0) += 1;
        }
        assert_eq!(bob, BTreeMap::from([("wave".to_owned(), 6)]));
        let Err(empty) = fixture
            .store
            .claim(fixture.ann, TaskKind::Pair, 0, START)
            .expect("claims")
        else {
            panic!("both quotas are reached")
        };
        assert_eq!(empty.quota_full, 14 + 13);
        let kept: Vec<i64> = fixture
            .store
            .kept()
            .expect("counts")
            .iter()
            .map(|row| row.2)
            .collect();
        assert_eq!(kept, [6, 6]);
        assert_eq!(
            fixture.store.verify().expect("checks"),
            Vec::<String>::new()
        );
        // With a larger quota the emptiest category comes first.
        quota(8);
        assert_eq!(answer(fixture.ann, Verdict::Keep), "walk");
        assert_eq!(answer(fixture.bob, Verdict::Keep), "wave");
        // Who lost a task cannot take it up again when there is no room left.
        let held = fixture.claim_kind(fixture.ann, TaskKind::Pair, START);
        let held = held.expect("a task");
        let ann = fixture.who(fixture.ann);
        let lease = fixture.store.task(&ann, held).expect("a task").lease;
        let lease = lease.expect("a lease").id;
        fixture
            .store
            .release(&ann, lease, START)
            .expect("gives it back");
        quota(7);
        let refused = fixture.store.claim_task(fixture.ann, held, START);
        let refused = refused.expect_err("no room");
        assert_eq!(refused.problem().code, Code::TaskFull);
        quota(8);
        let again = fixture.store.claim_task(fixture.ann, held, START);
        assert_eq!(again.expect("room").task.id, held);
        fixture.whole();
    });
}
