//! Random walks of people through a store.

use super::*;

/// Ids of the tasks in a random walk.
const WALKED: std::ops::RangeInclusive<i64> = 1..=16;

/// A random walk of three people through a store.
struct Walk<'a> {
    site: &'a Fixture,
    rng: datasets_spec::Rng,
    /// Tasks that each person has held.
    held: BTreeMap<i64, Vec<i64>>,
}

impl Walk<'_> {
    fn draw(&mut self, below: usize) -> usize {
        self.rng.random_range(0..below)
    }

    fn step(&mut self, step: usize) {
        self.site.wait(self.rng.random_range(0..2 * MINUTE));
        let people = [self.site.ann, self.site.bob, self.site.eve];
        let user = people[self.draw(3)];
        let kind = [TaskKind::MaskText, TaskKind::Pair][self.draw(2)];
        match self.draw(10) {
            0..4 => self.claim(user, kind),
            4..8 => self.send(user, step),
            8 => self.review(),
            _ => self.decide_again(),
        }
    }

    fn claim(&mut self, user: i64, kind: TaskKind) {
        let promised = self.site.queue(user, kind).open;
        let claimed = self.site.claim_kind(user, kind);
        let said = format!("home promises {promised}, the claim gives {claimed:?}");
        assert_eq!(promised > 0, claimed.is_some(), "{said}");
        self.held.entry(user).or_default().extend(claimed);
    }

    fn send(&mut self, user: i64, step: usize) {
        use EventKind::{Draft, Postpone, Skip, Submit, Undo};
        let Some(&task) = self.held.get(&user).and_then(|tasks| tasks.last()) else {
            return;
        };
        let store = &self.site.store;
        let answer = match self.site.record(task).kind {
            TaskKind::Pair => pair(Verdict::ALL[self.draw(4)]),
            _ => masks(&format!("step {step}")),
        };
        let detail = store.task(&self.site.who(user), task).ok();
        let mine = detail.and_then(|detail| detail.mine);
        let rev = mine.map_or(0, |mine| mine.rev);
        let what = [Draft, Submit, Submit, Undo, Skip, Postpone][self.draw(6)];
        let stale = i64::from(self.draw(8) == 0);
        let mut leases = store.leases(0).expect("leases").into_iter();
        let own = leases.find(|held| held.lease.task == task && held.lease.user == user);
        let epoch = own.map_or(0, |held| held.lease.epoch);
        let sent = NewEvent {
            reason: Some(SkipReason::Other),
            ..event(what, epoch, rev - stale, answer)
        };
        let result = self.site.send(user, task, sent.clone());
        let again = self.site.send(user, task, sent);
        assert_eq!(again.status, result.status);
    }

    fn review(&mut self) {
        let (eve, now) = (self.site.eve, self.site.now());
        let queue = ReviewQueue::Disagreement;
        let claimed = self.site.store.review_next(eve, queue, None, now);
        let Ok(detail) = claimed.expect("claims") else {
            return;
        };
        let what = Decision::ALL[self.draw(4)];
        let mut answers = detail.candidates.iter().map(|(revision, _)| revision);
        let waiting = answers.find(|revision| revision.state == RevisionState::Submitted);
        let merged = match detail.task.kind {
            TaskKind::Pair => pair(Verdict::Keep),
            _ => masks("merged"),
        };
        let is_merge = what == Decision::Merge;
        let review = NewReview {
            author: waiting
                .filter(|_| !is_merge)
                .map(|revision| revision.author),
            answer: is_merge.then_some(merged),
            ..decision(detail.task.id, detail.lease.epoch, what)
        };
        let done = self.site.store.review(eve, review, now);
        done.expect("decides");
    }

    /// Makes gold of accepted answers, and reopens tasks once many are dropped.
    fn decide_again(&mut self) {
        let site = self.site;
        for task in WALKED {
            if site.state(task) == TaskState::Accepted && self.rng.random::<bool>() {
                // This may be refused: the task may be gold already.
                let _tried = site.store.make_gold(ROOT, task, site.now());
            }
        }
        let counts = site.store.funnel().expect("counts");
        let dropped = |row: &(TaskKind, TaskState, i64)| row.1 == TaskState::Dropped && row.2 > 8;
        if counts.iter().any(dropped) {
            for task in WALKED {
                if matches!(site.state(task), TaskState::Dropped | TaskState::Accepted) {
                    // This may be refused: the author may not reopen the task.
                    let _tried = site.decide(task, 0, Decision::Reopen);
                }
            }
        }
    }
}

#[test]
fn random_walks_end_in_a_store_that_follows_from_its_log() {
    each("walks", Vec::new(), |site| {
        site.set(|settings| {
            settings.answers_per_task = 2;
            settings.lease_minutes = 5;
            settings.blind_percent = 50;
            settings.gold_percent = 20;
        });
        let mut tasks = mask_tasks(6);
        tasks.extend((6..16).map(|number| NewTask {
            bundle: Some(format!("{}", number / 4)),
            bundle_index: number as i64 % 4,
            ..bare_task(number, TaskKind::Pair)
        }));
        site.import(tasks);
        let mut walk = Walk {
            site,
            rng: Seed(11).rng(&["walk"]),
            held: BTreeMap::new(),
        };
        for step in 0..1500 {
            walk.step(step);
        }
        site.whole();
        let before = site.store.funnel().expect("counts");
        assert_eq!(site.store.rebuild().expect("rebuilds"), Vec::<&str>::new());
        assert_eq!(site.store.funnel().expect("counts"), before);
        assert!(site.last_seq() > 500);
    });
}
