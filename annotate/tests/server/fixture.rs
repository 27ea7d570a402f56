//! A store with people and a clock, on each available database.

use std::sync::Arc;

use annotate::store::{
    AcceptedAnswer, Imported, NewTask, Store, TaskDetail, TaskRecord, Who, open_sqlite,
};
use annotate::wire::{
    Answer, Code, Decision, Empty, EventKind, EventResult, Home, Lease, NewEvent, NewReview,
    Person, QueueInfo, ReviewQueue, Role, Settings, SkipReason, TaskKind, TaskState,
};

use crate::support::{
    Hands, ROOT, START, all_keys, bare_motion, bare_task, decision, event, join, masks,
    plain_settings, role, say, set, who, whole,
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
            let opened = annotate::store::open_postgres(&url, &schema, true);
            check(opened.expect("a store on PostgreSQL"));
        }
        Err(_) => skipped(test),
    }
}

#[cfg(not(feature = "postgres"))]
pub(crate) fn on_postgres(test: &str, _: &dyn Fn(Arc<Store>)) {
    skipped(test);
}

pub(crate) fn skipped(test: &str) {
    say(&format!(
        "SKIPPED {test} on PostgreSQL: needs the feature postgres and ANNOTATE_TEST_PG"
    ));
}

/// A store with people and a clock.
#[derive(Clone)]
pub(crate) struct Fixture {
    pub(crate) store: Arc<Store>,
    pub(crate) clock: Hands,
    pub(crate) ann: i64,
    pub(crate) bob: i64,
    pub(crate) eve: i64,
}

/// Runs a test on a fresh store of each database, with these tasks, and checks the store afterwards.
pub(crate) fn each(test: &str, tasks: Vec<NewTask>, check: impl Fn(&Fixture)) {
    on_each(test, |store| {
        plain_settings(&store);
        let user = |name: &str| join(&store, name, role(name));
        let site = Fixture {
            ann: user("ann"),
            bob: user("bob"),
            eve: user("eve"),
            clock: Hands::at(START),
            store,
        };
        site.store
            .put_motions(vec![bare_motion()])
            .expect("a motion");
        site.import(tasks.clone());
        check(&site);
        site.whole();
    });
}

pub(crate) fn tasks(count: usize, kind: TaskKind) -> Vec<NewTask> {
    (0..count).map(|number| bare_task(number, kind)).collect()
}

pub(crate) fn mask_tasks(count: usize) -> Vec<NewTask> {
    tasks(count, TaskKind::MaskText)
}

pub(crate) fn pair_tasks(count: usize) -> Vec<NewTask> {
    tasks(count, TaskKind::Pair)
}

impl Fixture {
    pub(crate) fn now(&self) -> i64 {
        self.clock.now()
    }

    pub(crate) fn wait(&self, millis: i64) {
        self.clock.advance(millis);
    }

    pub(crate) fn set(&self, change: impl FnOnce(&mut Settings)) {
        set(&self.store, change);
    }

    pub(crate) fn import(&self, tasks: Vec<NewTask>) -> Imported {
        self.store.import(None, tasks, START).expect("tasks")
    }

    pub(crate) fn join(&self, name: &str, role: Role) -> i64 {
        join(&self.store, name, role)
    }

    pub(crate) fn enable(&self, user: i64, active: bool) {
        let store = &self.store;
        let changed = store.change_user(Some(ROOT), user, None, Some(active), START);
        changed.expect("a change");
    }

    pub(crate) fn who(&self, id: i64) -> Who {
        let role = match id == self.eve {
            true => Role::Reviewer,
            false => Role::Annotator,
        };
        who(id, role)
    }

    pub(crate) fn claimed(
        &self,
        user: i64,
        kind: TaskKind,
    ) -> Result<(TaskDetail, Vec<String>), Empty> {
        let claimed = self.store.claim(user, kind, 3, self.now());
        claimed.expect("claims")
    }

    pub(crate) fn claim_kind(&self, user: i64, kind: TaskKind) -> Option<i64> {
        let claimed = self.claimed(user, kind).ok();
        claimed.map(|(detail, _)| detail.task.id)
    }

    pub(crate) fn claim(&self, user: i64) -> Option<i64> {
        self.claim_kind(user, TaskKind::MaskText)
    }

    pub(crate) fn claim_pair(&self, user: i64) -> Option<i64> {
        self.claim_kind(user, TaskKind::Pair)
    }

    /// Why there is no task for a user. Panics if there is one.
    pub(crate) fn nothing(&self, user: i64, kind: TaskKind) -> Empty {
        let claimed = self.claimed(user, kind);
        claimed.expect_err("nothing is left")
    }

    /// Claims a mask task. Panics if there is none.
    pub(crate) fn take(&self, user: i64) -> i64 {
        self.claim(user).expect("a task")
    }

    /// Claims a pair. Panics if there is none.
    pub(crate) fn take_pair(&self, user: i64) -> i64 {
        self.claim_pair(user).expect("a pair")
    }

    /// The row of a user in the table of people.
    pub(crate) fn person(&self, user: i64) -> Person {
        let mut people = self.store.people().expect("people").into_iter();
        let found = people.find(|person| person.user.id == user);
        found.expect("a person")
    }

    pub(crate) fn home(&self, user: i64) -> Home {
        self.store.home(user, self.now()).expect("home")
    }

    pub(crate) fn queue(&self, user: i64, kind: TaskKind) -> QueueInfo {
        let mut queues = self.home(user).queues.into_iter();
        queues.find(|queue| queue.kind == kind).expect("a queue")
    }

    /// Number of open mask tasks on the user's home page.
    pub(crate) fn open(&self, user: i64) -> i64 {
        self.queue(user, TaskKind::MaskText).open
    }

    pub(crate) fn detail(&self, user: i64, task: i64) -> TaskDetail {
        let detail = self.store.task(&self.who(user), task);
        detail.expect("a task that the user may see")
    }

    pub(crate) fn lease(&self, user: i64, task: i64) -> Lease {
        self.detail(user, task).lease.expect("a lease")
    }

    pub(crate) fn epoch(&self, user: i64, task: i64) -> i64 {
        let lease = self.detail(user, task).lease;
        lease.map_or(0, |lease| lease.epoch)
    }

    pub(crate) fn record(&self, task: i64) -> TaskRecord {
        self.store.task_record(task).expect("a task")
    }

    pub(crate) fn state(&self, task: i64) -> TaskState {
        self.record(task).state
    }

    pub(crate) fn last_seq(&self) -> i64 {
        self.store.last_seq().expect("a place")
    }

    pub(crate) fn accepted(&self) -> Vec<AcceptedAnswer> {
        self.store.accepted(&all_keys()).expect("answers")
    }

    /// Times at which the current leases end.
    pub(crate) fn lease_ends(&self) -> Vec<i64> {
        let leases = self.store.leases(self.now()).expect("leases");
        leases.iter().map(|held| held.lease.expires).collect()
    }

    pub(crate) fn append(&self, user: i64, task: i64, events: Vec<NewEvent>) -> Vec<EventResult> {
        let results = self.store.append(user, task, events, self.now());
        results.expect("takes events")
    }

    pub(crate) fn send(&self, user: i64, task: i64, event: NewEvent) -> EventResult {
        self.append(user, task, vec![event]).remove(0)
    }

    /// Sends an event under the user's lease.
    pub(crate) fn tell(
        &self,
        user: i64,
        task: i64,
        kind: EventKind,
        base_rev: i64,
        answer: impl Into<Option<Answer>>,
    ) -> EventResult {
        let event = event(kind, self.epoch(user, task), base_rev, answer);
        self.send(user, task, event)
    }

    /// Submits an answer to a task that the user holds.
    pub(crate) fn submit(&self, user: i64, task: i64, base_rev: i64, answer: Answer) {
        let result = self.tell(user, task, EventKind::Submit, base_rev, answer);
        assert_eq!(result.status, 200, "{:?}", result.problem);
    }

    /// Claims the next task of an answer's kind, submits the answer, and returns the task.
    pub(crate) fn hand_in(&self, user: i64, answer: Answer) -> i64 {
        let task = self.claim_kind(user, answer.kind()).expect("a task");
        self.submit(user, task, 0, answer);
        task
    }

    pub(crate) fn answer(&self, user: i64, text: &str) -> i64 {
        self.hand_in(user, masks(text))
    }

    pub(crate) fn skip(&self, user: i64) -> i64 {
        let task = self.take(user);
        let skip = NewEvent {
            reason: Some(SkipReason::CannotTell),
            note: "too dark".to_owned(),
            ..event(EventKind::Skip, self.epoch(user, task), 0, None)
        };
        assert_eq!(self.send(user, task, skip).status, 200);
        task
    }

    /// The next task to review, and the epoch of the lease.
    pub(crate) fn review(&self) -> (i64, i64) {
        let queue = ReviewQueue::Disagreement;
        let claimed = self.store.review_next(self.eve, queue, None, self.now());
        match claimed.expect("claims") {
            Ok(detail) => (detail.task.id, detail.lease.epoch),
            Err(empty) => panic!("nothing to review: {empty:?}"),
        }
    }

    pub(crate) fn decide(&self, task: i64, epoch: i64, what: Decision) -> Result<TaskState, Code> {
        let review = NewReview {
            answer: (what == Decision::Merge).then(|| masks("merged")),
            ..decision(task, epoch, what)
        };
        let done = self.store.review(self.eve, review, self.now());
        done.map(|done| done.state)
            .map_err(|error| error.problem().code)
    }

    /// Decides about the next task to review, and returns it.
    pub(crate) fn judge(&self, what: Decision) -> i64 {
        let (task, epoch) = self.review();
        let state = match what {
            Decision::Accept | Decision::Merge => TaskState::Accepted,
            Decision::Return => TaskState::Returned,
            Decision::Drop => TaskState::Dropped,
            Decision::Reopen => TaskState::Submitted,
        };
        assert_eq!(self.decide(task, epoch, what), Ok(state));
        task
    }

    pub(crate) fn reopen(&self, task: i64) {
        let done = self.decide(task, 0, Decision::Reopen);
        assert_eq!(done, Ok(TaskState::Submitted));
    }

    /// Has the reviewer return the answer to the only task that waits.
    pub(crate) fn send_back(&self, task: i64) {
        assert_eq!(self.judge(Decision::Return), task);
    }

    /// Gives back the lease that a user holds on a task.
    pub(crate) fn give_back(&self, user: i64, task: i64) {
        let lease = self.lease(user, task).id;
        let released = self.store.release(&self.who(user), lease, self.now());
        released.expect("gives it back");
    }

    pub(crate) fn make_gold(&self, task: i64) -> i64 {
        let gold = self.store.make_gold(ROOT, task, START);
        gold.expect("a gold task")
    }

    pub(crate) fn whole(&self) {
        whole(&self.store);
    }
}

pub(crate) fn problem(result: &EventResult) -> Code {
    result.problem.as_ref().expect("a problem").code
}
