//! A whole project in simulated time: people answer, rules accept, a share is reviewed, and the export agrees with the
//! log. A short version runs with the other tests; this command runs one of the size of the paper's project:
//!
//! ```sh
//! ANNOTATE_SIMULATION=40000x5000x13 cargo test --release --workspace --test server simulated -- --nocapture
//! ```
//!
//! with the number of pairs, of clips and of people.

use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::sync::Arc;
use std::time::{Duration, Instant};

use annotate::store::{MotionRecord, NewTask, PageQuery, Store, TaskDetail, open_sqlite};
use annotate::wire::{
    Answer, Decision, EditType, EventKind, NewEvent, NewReview, ReviewQueue, RevisionState, Role,
    Rule, RuleKind, SkipReason, TaskKind, TaskSort, TaskState, Verdict,
};
use datasets_spec::Seed;
use rand::RngExt;
use serde_json::{Value, json};

use crate::fixture::on_each;
use crate::support::{
    DAY, HOUR, MINUTE, START, all_keys, bare_motion, bare_task, claim, decision, event, from_json,
    join, kept, masks, pair, peak_memory_mb, plain_settings, review, rule, say, set, sizes, tell,
};

/// Percentage of the tasks that reviewers see.
const REVIEWED: u32 = 20;
/// Categories of the bundles of pairs: there are three times as many walks and runs as jumps and waves.
const CATEGORIES: [&str; 8] = ["walk", "run", "jump", "walk", "run", "wave", "walk", "run"];
/// Quota of each category, as a share of all pairs: larger than the number of usable jumps or waves, and smaller than
/// that of usable walks or runs.
const QUOTA: f64 = 0.135;

#[derive(Default)]
pub(crate) struct Times(BTreeMap<&'static str, Vec<Duration>>);

impl Times {
    pub(crate) fn of<T>(&mut self, what: &'static str, work: impl FnOnce() -> T) -> T {
        let clock = Instant::now();
        let value = work();
        self.0.entry(what).or_default().push(clock.elapsed());
        value
    }

    pub(crate) fn add(&mut self, others: Self) {
        for (what, times) in others.0 {
            self.0.entry(what).or_default().extend(times);
        }
    }

    pub(crate) fn print(&mut self) {
        for (what, times) in &mut self.0 {
            times.sort();
            let at = |share: f64| times[((times.len() - 1) as f64 * share).round() as usize];
            say(&format!(
                "  {what:<28} {:>7} times, p50 {:>9.2?} p99 {:>9.2?} total {:>8.1?}",
                times.len(),
                at(0.5),
                at(0.99),
                times.iter().sum::<Duration>()
            ));
        }
    }
}

fn quota(pairs: usize) -> i64 {
    (pairs as f64 * QUOTA) as i64
}

/// Accepted pairs that are kept, and pairs without a decision, by category.
fn by_category(store: &Store) -> BTreeMap<&'static str, [i64; 2]> {
    let mut found: BTreeMap<_, _> = CATEGORIES.map(|category| (category, [0, 0])).into();
    for answer in store.accepted(&all_keys()).expect("answers") {
        let category = answer.task.category.as_deref();
        if answer.answer.verdict() == Some(Verdict::Keep)
            && let Some(name) = CATEGORIES.iter().find(|name| Some(**name) == category)
        {
            found.entry(name).or_default()[0] += 1;
        }
    }
    let total = |category: &str, state: Option<TaskState>| -> i64 {
        let filter = json!({ "kind": "pair", "state": state, "category": category });
        let page = store.browse(PageQuery {
            filter: from_json(filter),
            limit: 1,
            ..PageQuery::default()
        });
        let total = page.expect("a page").total;
        total.expect("a first page has a total")
    };
    for (category, [_, left]) in &mut found {
        let decided =
            [TaskState::Accepted, TaskState::Dropped].map(|state| total(category, Some(state)));
        *left = total(category, None) - decided.iter().sum::<i64>();
    }
    found
}

struct Project {
    store: Arc<Store>,
    people: Vec<i64>,
    reviewers: Vec<i64>,
    rng: datasets_spec::Rng,
    times: Times,
    /// Acknowledged answers that are still submitted, by task and author.
    handed_in: BTreeSet<(i64, i64)>,
    reviews: i64,
}

fn project(store: Arc<Store>, [pairs, clips, people]: [usize; 3]) -> Project {
    plain_settings(&store);
    let rule = |name: &str, accepts: RuleKind, max_distance: f64| Rule {
        max_distance,
        review_percent: REVIEWED,
        ..rule(name, accepts)
    };
    set(&store, |settings| {
        settings.answers_per_task = 2;
        settings.overlap_percent = 10;
        settings.blind_percent = 10;
        settings.seed = 20;
        settings.category_quota = quota(pairs) as u32;
        settings.rules = vec![
            rule("rejects", RuleKind::Rejects, 1.0),
            rule("sample", RuleKind::Sampled, 0.5),
        ];
    });
    let user = |name: String, role| join(&store, &name, role);
    let reviewers = (0..people.div_ceil(6))
        .map(|number| user(format!("reviewer{number}"), Role::Reviewer))
        .collect();
    let people = (0..people)
        .map(|number| user(format!("person{number:02}"), Role::Annotator))
        .collect();
    let motions: Vec<MotionRecord> = (0..clips)
        .map(|clip| MotionRecord {
            hash: format!("hash{clip:05}"),
            id: format!("clip{clip:05}"),
            frames: 100,
            captions: vec![format!("a person waves, take {clip}")],
            ..bare_motion()
        })
        .collect();
    store.put_motions(motions).expect("motions");
    let mut tasks: Vec<NewTask> = (0..clips)
        .map(|clip| NewTask {
            source: format!("hash{clip:05}"),
            ..bare_task(clip, TaskKind::MaskText)
        })
        .collect();
    tasks.extend((0..pairs).map(|number| NewTask {
        key: format!("pair{number:06}"),
        source: format!("hash{:05}", number % clips),
        target: Some(format!("hash{:05}", (number + 1) % clips)),
        bundle: Some(format!("bundle{}", number / 8)),
        bundle_index: (number % 8) as i64,
        category: Some(CATEGORIES[number / 8 % CATEGORIES.len()].to_owned()),
        ..bare_task(number, TaskKind::Pair)
    }));
    let mut times = Times::default();
    times.of("import of all tasks", || {
        store.import(None, tasks, START).expect("tasks");
    });
    Project {
        store,
        people,
        reviewers,
        rng: Seed(20).rng(&["simulation"]),
        times,
        handed_in: BTreeSet::new(),
        reviews: 0,
    }
}

impl Project {
    fn draw(&mut self, percent: u32) -> bool {
        self.rng.random_range(0..100) < percent
    }

    /// The answer of a person to a task: mostly the expected one, else a different one.
    fn answer(&mut self, task: &TaskDetail) -> Answer {
        let number = if self.draw(90) {
            Seed(20).draw_u64(&["truth", &task.task.key])
        } else {
            self.rng.random_range(0..u64::MAX)
        };
        match task.task.kind {
            TaskKind::MaskText => masks(&format!("waving {}", number % 7)),
            _ => match number % 10 {
                0..=3 => pair(Verdict::Unnatural),
                4 => pair(Verdict::Unclear),
                5 => pair(Verdict::Identical),
                _ => kept(EditType::ALL[(number / 10) as usize % EditType::ALL.len()]),
            },
        }
    }

    /// One turn of a person. Returns the seconds it took, or `None` if there is nothing to do.
    fn work(&mut self, person: i64, kind: TaskKind, now: i64) -> Option<f64> {
        let store = Arc::clone(&self.store);
        let claimed = self.times.of("claim", || claim(&store, person, kind, now));
        let detail = claimed?;
        let task = detail.task.id;
        let epoch = detail.lease.as_ref().expect("a lease").epoch;
        let mut rev = detail.mine.as_ref().map_or(0, |mine| mine.rev);
        let secs = if kind == TaskKind::Pair {
            self.rng.random_range(10.0..40.0)
        } else {
            self.rng.random_range(40.0..90.0)
        };
        if self.draw(1) {
            // The person closes the browser, and the lease expires.
            return Some(1200.0);
        }
        let send = |project: &mut Self, kind: EventKind, epoch, rev, answer: Option<Answer>| {
            let sent = NewEvent {
                reason: (kind == EventKind::Skip).then_some(SkipReason::CannotTell),
                secs,
                ..event(kind, epoch, rev, answer)
            };
            let what = "draft, answer or skip";
            let times = &mut project.times;
            times.of(what, || tell(&store, person, task, sent, now))
        };
        if self.draw(1) {
            send(self, EventKind::Skip, epoch, rev, None);
            return Some(secs / 2.0);
        }
        let answer = Some(self.answer(&detail));
        if self.draw(20) {
            rev = send(self, EventKind::Draft, epoch, rev, answer.clone()).rev;
        }
        rev = send(self, EventKind::Submit, epoch, rev, answer.clone()).rev;
        if self.draw(1) {
            let undone = send(self, EventKind::Undo, 0, rev, None);
            let epoch = undone.lease.expect("a lease again").epoch;
            send(self, EventKind::Submit, epoch, undone.rev, answer);
        }
        self.handed_in.insert((task, person));
        Some(secs)
    }

    /// A working day of everybody, from 9 to 17.
    fn day(&mut self, morning: i64) {
        let mut turns: BinaryHeap<_> = self
            .people
            .iter()
            .enumerate()
            .map(|(number, &person)| std::cmp::Reverse((morning, person, number)))
            .collect();
        while let Some(std::cmp::Reverse((now, person, number))) = turns.pop() {
            if now >= morning + 8 * HOUR {
                continue;
            }
            // A few people describe masks; everybody helps where work is left.
            let kinds = if number % 4 == 0 {
                [TaskKind::MaskText, TaskKind::Pair]
            } else {
                [TaskKind::Pair, TaskKind::MaskText]
            };
            let took = kinds
                .into_iter()
                .find_map(|kind| self.work(person, kind, now));
            // Only tasks held by others remain: try again in a quarter of an hour.
            let pause = took.map_or(15 * MINUTE, |secs| (secs * 1000.0) as i64 + 1);
            turns.push(std::cmp::Reverse((now + pause, person, number)));
        }
    }

    /// Reviewers empty the queue.
    fn review(&mut self, now: i64) {
        for index in 0.. {
            let reviewer = self.reviewers[index % self.reviewers.len()];
            let store = Arc::clone(&self.store);
            let claimed = self.times.of("claim of a review", || {
                review(&store, reviewer, ReviewQueue::Sample, now)
            });
            let Some(detail) = claimed else {
                return;
            };
            let what = match self.rng.random_range(0..100) {
                0..5 if detail.comments.is_empty() => Decision::Return,
                5..7 => Decision::Drop,
                _ => Decision::Accept,
            };
            let mut answers = detail.candidates.iter().map(|(own, _)| own);
            let first = answers.find(|own| own.state == RevisionState::Submitted);
            let first = first.filter(|_| what == Decision::Accept);
            let review = NewReview {
                author: first.map(|own| own.author),
                ..decision(detail.task.id, detail.lease.epoch, what)
            };
            let done = self.times.of("decision of a reviewer", || {
                store.review(reviewer, review, now).expect("decides")
            });
            self.reviews += 1;
            if done.state == TaskState::Returned {
                let task = detail.task.id;
                self.handed_in.retain(|(known, _)| *known != task);
            }
        }
    }
}

/// Accepted answers according to the log: by the id of their task, the author and the rule that accepted the answer.
fn accepted_by_the_log(store: &Store) -> BTreeMap<i64, (i64, Option<String>)> {
    let mut accepted = BTreeMap::new();
    let mut after = 0;
    loop {
        let some = store.log(after, 5000).expect("the log");
        let Some(last) = some.last() else {
            return accepted;
        };
        after = last.seq;
        for entry in some {
            let Some(task) = entry.task else { continue };
            match entry.kind.as_str() {
                "accepted" => {
                    let author = entry.body["author"].as_i64().expect("an author");
                    let rule = entry.body["rule"].as_str().map(str::to_owned);
                    assert!(
                        accepted.insert(task, (author, rule)).is_none(),
                        "task {task} is accepted twice"
                    );
                }
                "reopened" => {
                    accepted.remove(&task);
                }
                _ => {}
            }
        }
    }
}

#[test]
fn a_simulated_week_loses_nothing_and_its_export_equals_the_log() {
    let size: [usize; 3] = sizes("ANNOTATE_SIMULATION", "240x40x5");
    let is_full = size[0] >= 10_000;
    let simulate = |store: Arc<Store>| {
        let begun = Instant::now();
        let mut project = project(store, size);
        // START is a Tuesday evening; the week begins with the next morning.
        let morning = START.div_euclid(DAY) * DAY + DAY + 9 * HOUR;
        for day in 0..7 {
            project.day(morning + day * DAY);
            project.review(morning + day * DAY + 9 * HOUR);
            let now = by_category(&project.store);
            say(&format!("day {day}: kept and undecided {now:?}"));
            check_quota(&now, size, false);
        }
        let end = morning + 7 * DAY;
        let store = Arc::clone(&project.store);
        check_answers(&project, size);
        let funnel = store.funnel().expect("a funnel");
        let of = |wanted: TaskState| -> i64 {
            let rows = funnel.iter().filter(|row| row.1 == wanted);
            rows.map(|row| row.2).sum()
        };
        let total = (size[0] + size[1]) as i64;
        let (accepted, dropped) = (of(TaskState::Accepted), of(TaskState::Dropped));
        let log = accepted_by_the_log(&store);
        assert_eq!(accepted, log.len() as i64);
        let by_rule = log.values().filter(|(_, rule)| rule.is_some()).count() as i64;
        let exported = store.accepted(&all_keys()).expect("answers").into_iter();
        let exported = exported.map(|answer| (answer.task.id, answer.author));
        let logged = log.iter().map(|(task, (author, _))| (*task, *author));
        let is_equal = BTreeMap::from_iter(exported) == BTreeMap::from_iter(logged);
        assert!(is_equal, "the export equals the log");
        let reviewed = project.reviews as f64 / total as f64;
        if is_full {
            assert!((0.19..0.27).contains(&reviewed), "{reviewed}");
            let held_back: i64 = check_quota(&by_category(&store), size, true);
            let decided = accepted + dropped;
            assert!(decided > (total - held_back) * 99 / 100, "{funnel:?}");
        }
        assert!(by_rule > 0 && reviewed > 0.0);
        measure(&mut project, end);
        let verify = || store.verify().expect("checks");
        let found = project.times.of("check of the store", verify);
        assert_eq!(found, Vec::<String>::new());
        say(&format!(
            "simulation: {} pairs, {} clips, {} people: {accepted} accepted ({by_rule} by rules), {dropped} dropped, \
             {} decisions of reviewers ({:.1} % of the tasks), {} answers, {} log entries, {:.0?}, peak memory {} MB",
            size[0],
            size[1],
            size[2],
            project.reviews,
            100.0 * reviewed,
            project.handed_in.len(),
            store.last_seq().expect("a place"),
            begun.elapsed(),
            peak_memory_mb().unwrap_or(0)
        ));
        project.times.print();
    };
    if is_full {
        let folder = tempfile::tempdir().expect("a folder");
        simulate(open_sqlite(&folder.path().join("store.sqlite")).expect("a store"));
    } else {
        on_each("simulation", simulate);
    }
}

/// Checks that no category exceeds its quota, and that pairs of the categories with pairs left were given out evenly.
/// Returns the number of pairs held back because of the quota.
fn check_quota(
    now: &BTreeMap<&'static str, [i64; 2]>,
    [pairs, _, people]: [usize; 3],
    is_end: bool,
) -> i64 {
    let quota = quota(pairs);
    // One bundle for each person.
    let at_work = 8 * people as i64;
    let mut held_back = 0;
    let mut given = Vec::new();
    for (category, &[kept, left]) in now {
        assert!(kept <= quota, "{category}: {kept} of {quota}");
        // Pairs that wait for a reviewer use quota, so the last pairs can only be given out later.
        if 100 * kept >= 99 * quota {
            held_back += left;
        } else if is_end {
            assert!(left <= pairs as i64 / 100, "{category}: {left} left");
        } else if left > at_work {
            given.push(kept);
        }
    }
    given.sort_unstable();
    if let (Some(least), Some(most)) = (given.first(), given.last()) {
        assert!(most - least <= at_work + most / 10, "{now:?}");
    }
    held_back
}

/// Checks that every acknowledged answer is in the store once, and that no task has more answers than it needs.
fn check_answers(project: &Project, size: [usize; 3]) {
    let mut stored = BTreeSet::new();
    let (answered, _) = project.store.answered_since(0).expect("tasks");
    for label in project.store.labels_to(answered).expect("labels") {
        if label.revision.state != RevisionState::Returned {
            assert!(
                stored.insert((label.task, label.revision.author)),
                "an answer is there twice"
            );
        }
    }
    let lost: Vec<_> = project.handed_in.difference(&stored).take(5).collect();
    assert!(lost.is_empty(), "lost: {lost:?}");
    let mut answers: BTreeMap<i64, u32> = BTreeMap::new();
    for (task, _) in &stored {
        *answers.entry(*task).or_default() += 1;
    }
    assert!(answers.len() <= size[0] + size[1]);
    for (task, count) in answers {
        let record = project.store.task_record(task).expect("a task");
        assert!(count <= record.wanted, "task {task} has {count} answers");
    }
}

/// Measures the requests of a dashboard and a task browser.
fn measure(project: &mut Project, now: i64) {
    let store = Arc::clone(&project.store);
    let times = &mut project.times;
    let keeps = json!({ "person": project.people[0], "verdict": "keep" });
    let filters: [(&str, Value); 5] = [
        ("page: all", json!({})),
        ("page: a text that is rare", json!({ "q": "take 17" })),
        ("page: a text of no task", json!({ "q": "no such text" })),
        ("page: a person's keeps", keeps),
        ("page: disagreement", json!({ "min_distance": 0.5 })),
    ];
    for (what, filter) in filters {
        for sort in [TaskSort::Id, TaskSort::Distance, TaskSort::Touched] {
            let (mut what, mut after) = (what, None);
            for _ in 0..20 {
                let query = PageQuery {
                    filter: from_json(filter.clone()),
                    sort: Some(sort),
                    after,
                    limit: 100,
                    ..PageQuery::default()
                };
                let page = times.of(what, || store.browse(query).expect("a page"));
                what = "page: a later one";
                after = page.next;
                if after.is_none() {
                    break;
                }
            }
        }
    }
    times.of("rules with their counts", || store.rules().expect("rules"));
    times.of("hours by person and day", || {
        store.work(now - 14 * DAY, now).expect("days")
    });
    times.of("outlook", || store.outlook(now).expect("an outlook"));
}
