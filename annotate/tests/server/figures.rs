//! Figures of the dashboard over days and weeks.
//!
//! The work of a team over two weeks is simulated on the test's small dataset, or on the dataset in a folder. A server
//! on this folder then shows the screens of the README's pictures:
//!
//! ```sh
//! ANNOTATE_SEED=DATASET cargo test --release -p stance -p annotate-tests --test server work_of_a_team
//! ```

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use annotate::store::{MotionRecord, NewTask, Store, TaskDetail, open_sqlite};
use annotate::transfer::from_dataset;
use annotate::wire::{
    Agreement, Answer, DayWork, Decision, EventKind, Funnel, Me, NewEvent, NewReview, ReviewQueue,
    Role, Rule, RuleKind, Settings, SettingsChange, TaskKind, Verdict,
};
use datasets_spec::Seed;
use rand::RngExt;
use serde_json::{Value, json};

use crate::fixture::on_each;
use crate::support::{
    CLIPS, DAY, HOUR, MINUTE, START, Site, bare_motion, bare_task, claim, dataset, decision,
    event_of, from_json, masks, pair, review, rule, tell, whole,
};

/// Tuesday 2023-11-14, midnight UTC: `START` is in the evening of this day.
const TUESDAY: i64 = START - START % DAY;

#[test]
fn weeks_and_days_begin_in_the_time_zone_of_the_project() {
    let site = Site::new();
    site.set(|settings| {
        settings.time_zone = "Pacific/Auckland".to_owned();
    });
    let [ann, eve] = site.people(["ann", "eve"]);
    let me: Me = eve.get("me").ok();
    assert_eq!(me.project.time_zone, "Pacific/Auckland");
    ann.answer(pair(Verdict::Unclear));
    // Sunday 20:00 UTC is Monday 9:00 in Auckland.
    let sunday = TUESDAY + 5 * DAY + 20 * HOUR;
    site.clock.advance(sunday - START);
    ann.answer(pair(Verdict::Unclear));
    let funnel: Funnel = eve.get("stats/funnel").ok();
    let last = funnel.weeks.iter().rev().take(2);
    let last: Vec<(i64, i64)> = last.map(|week| (week.start, week.submitted)).collect();
    let monday = TUESDAY + 5 * DAY + 11 * HOUR;
    assert_eq!(last, [(monday, 1), (monday - 7 * DAY, 1)]);
    assert_eq!(funnel.weeks.len(), 12);
    // A period includes its whole first day, whatever time it starts at.
    let days = |query: String| -> Vec<(i64, i64)> {
        let days: Vec<DayWork> = eve.get(&format!("stats/days{query}")).ok();
        days.iter().map(|day| (day.start, day.answers)).collect()
    };
    let both = [(TUESDAY + 11 * HOUR, 1), (monday, 1)];
    assert_eq!(days(format!("?from={}", START + MINUTE)), both);
    assert_eq!(days(String::new()), both);
    assert_eq!(days(format!("?from={}", monday + MINUTE)), both[1..]);
    assert_eq!(days(format!("?from=-1&to={monday}")), both[..1]);
}

#[test]
fn agreement_is_told_for_the_week_of_the_last_answer() {
    let site = Site::new();
    site.set(|settings| settings.answers_per_task = 2);
    let [ann, bob, eve] = site.people(["ann", "bob", "eve"]);
    // Two pairs in the first week: one verdict agrees, the other does not.
    for theirs in [Verdict::Unclear, Verdict::Identical] {
        let task = ann.answer(pair(Verdict::Unclear));
        assert_eq!(bob.answer(pair(theirs)), task, "both answer the same tasks");
    }
    let clip = ann.answer(masks("waving"));
    site.clock.advance(7 * DAY);
    // Equal joints in the second week; one of the two answers is a week old.
    assert_eq!(bob.answer(masks("swinging")), clip);
    let single = ann.answer(masks("waving"));
    assert_ne!(single, clip);
    let weeks = || -> Vec<(Option<f64>, usize)> {
        let funnel: Funnel = eve.get("stats/funnel").ok();
        let weeks = funnel.weeks.iter().rev().take(3);
        weeks
            .map(|week| (week.agreement, week.shared_items))
            .collect()
    };
    assert_eq!(weeks(), [(Some(1.0), 1), (Some(0.5), 2), (None, 0)]);
    // Both answers mask the legs, but only Ann's also the left arm.
    let legs = json!({
        "kind": "mask_text", "count_reason": "single_action",
        "masks": [{ "parts": ["LOWER_BODY"], "text": "swinging, walking" }],
    });
    assert_eq!(bob.answer(from_json(legs)), single);
    // Figures are a minute old at most.
    site.clock.advance(2 * MINUTE);
    let weeks = weeks();
    let mean = weeks[0].0.expect("an agreement");
    assert!((0.5..1.0).contains(&mean), "{mean}");
    assert_eq!(weeks[0].1, 2, "two tasks are shared in this week");
    assert_eq!(weeks[1..], [(Some(0.5), 2), (None, 0)]);
}

/// Mask tasks of [`many_masks`].
const MANY: usize = 2 * CLIPS;

/// A server with [`MANY`] mask tasks about clips of 40 and of 90 frames.
fn many_masks() -> Site {
    let site = Site::new();
    let longer = MotionRecord {
        hash: "longer".to_owned(),
        id: "longer".to_owned(),
        frames: 90,
        ..bare_motion()
    };
    let motions = site.store.put_motions(vec![bare_motion(), longer]);
    motions.expect("motions");
    let tasks = (CLIPS..MANY).map(|number| NewTask {
        source: ["hash", "longer"][number % 2].to_owned(),
        ..bare_task(number, TaskKind::MaskText)
    });
    let imported = site.store.import(None, tasks.collect(), START);
    imported.expect("tasks");
    site
}

/// Has a person answer the next mask task.
fn answer_next(site: &Site, person: i64, answer: impl FnOnce(&TaskDetail) -> Answer) {
    let detail = claim(&site.store, person, TaskKind::MaskText, START).expect("a task");
    let submitted = event_of(&detail, EventKind::Submit, answer(&detail));
    tell(&site.store, person, detail.task.id, submitted, START);
}

#[test]
fn a_mask_of_the_whole_clip_is_like_one_without_a_range_in_every_figure() {
    let site = many_masks();
    site.set(|settings| settings.answers_per_task = 2);
    let [ann, bob, eve] = site.people(["ann", "bob", "eve"]);
    for person in [ann.user.id, bob.user.id] {
        for number in 0..MANY {
            answer_next(&site, person, |detail| {
                let frames = match detail.task.source.as_str() {
                    "longer" => 90,
                    _ => 40,
                };
                let range = (number % 4 < 2).then_some([0, frames]);
                let arm = json!({ "parts": ["LEFT_ARM"], "range": range, "text": "waving" });
                from_json(json!({
                    "kind": "mask_text", "masks": [arm], "count_reason": "single_action",
                }))
            });
        }
    }
    let found: Agreement = eve.get("stats/agreement").ok();
    assert_eq!(found.shared_items, MANY);
    assert_eq!(found.jaccard.map(|found| found.value), Some(1.0));
    assert_eq!(found.jaccard_chance, Some(1.0), "all masks are the same");
}

#[test]
fn an_answer_that_was_returned_was_not_accepted_unchanged() {
    let site = many_masks();
    let [ann, eve] = site.people(["ann", "eve"]);
    let answer = |text: &str| answer_next(&site, ann.user.id, |_| masks(text));
    let decide = |what: Decision| {
        let queue = ReviewQueue::Sample;
        let next = review(&site.store, eve.user.id, queue, START).expect("an answer");
        let decided = decision(next.task.id, next.lease.epoch, what);
        let done = site.store.review(eve.user.id, decided, START);
        done.expect("decides");
    };
    for number in 0..MANY {
        answer("waving");
        if number % 4 == 0 {
            decide(Decision::Return);
            answer("swinging");
        }
        decide(Decision::Accept);
    }
    let found: Agreement = eve.get("stats/agreement").ok();
    let share = found.accepted_share.expect("enough answers");
    assert_eq!((share.value, share.items), (0.75, MANY));
}

/// Texts that people write about parts of a clip without a drafted text.
const DOING: [(&str, &str); 8] = [
    ("LEFT_ARM", "swinging the left arm beside the body"),
    ("RIGHT_ARM", "raising the right hand to the shoulder"),
    ("BOTH_ARMS", "holding both arms in front of the chest"),
    ("LEFT_LEG", "lifting the left knee"),
    ("RIGHT_LEG", "stepping forward with the right leg"),
    ("BOTH_LEGS", "shifting the weight from one leg to the other"),
    ("LOWER_BODY", "standing with the feet apart"),
    ("UPPER_BODY", "leaning slightly forward"),
];

/// Part and type of an edit, and its instruction.
const EDITS: [(&str, &str); 8] = [
    ("LEFT_ARM amplitude", "Raise the left arm higher."),
    ("RIGHT_ARM speed", "Swing the right arm faster."),
    ("BOTH_ARMS force", "Move both arms with more force."),
    ("BOTH_LEGS amplitude", "Take wider steps."),
    ("LOWER_BODY amplitude", "Bend the knees deeper."),
    ("RIGHT_LEG timing", "Lift the right foot a moment later."),
    ("UPPER_BODY spatial", "Turn the chest to the left."),
    ("BOTH_ARMS spatial", "Keep the hands closer to the body."),
];

/// Comments of reviewers who send an answer back.
const COMMENTS: [&str; 3] = [
    "Which hand is it? Look again from the side.",
    "The legs act too: add a mask for them.",
    "Say what changes, not what the second clip shows.",
];

/// An answer with two masks: from the drafts of the clip, or from [`DOING`] if the person has an opinion of their own
/// or drafts are missing.
fn describe(task: &TaskDetail, number: u64, own: bool) -> Answer {
    let mut said: Vec<Value> = Vec::new();
    let drafts = task.suggestions.iter();
    let drafted = drafts.filter(|draft| !draft.text.is_empty());
    for draft in drafted.take(if own { 0 } else { 2 }) {
        let text = draft.text.trim_start_matches("The person is ");
        let text = text.trim_end_matches('.');
        said.push(json!({ "parts": draft.parts, "text": text, "suggestion": draft.id }));
    }
    for (part, text) in DOING.iter().cycle().skip(number as usize % DOING.len()) {
        if said.len() >= 2 {
            break;
        }
        if said.iter().all(|mask| mask["parts"] != json!([part])) {
            said.push(json!({ "parts": [part], "text": text }));
        }
    }
    from_json(json!({ "kind": "mask_text", "masks": said }))
}

/// A team that works on a store.
struct Team {
    store: Arc<Store>,
    /// Annotators, each with the mean seconds they need for a mask task.
    annotators: Vec<(i64, f64)>,
    reviewers: Vec<i64>,
    rng: datasets_spec::Rng,
    answers: i64,
    secs: f64,
}

impl Team {
    fn new(store: Arc<Store>, root: &Path, begin: i64) -> Self {
        let user = |name: &str, role| store.add_user(None, name, role, begin).expect("a user").id;
        let admin = user("ines", Role::Admin);
        let was = store.settings().expect("settings");
        let now = Settings {
            name: "Reference motions".to_owned(),
            time_zone: "Europe/Berlin".to_owned(),
            answers_per_task: 2,
            overlap_percent: 40,
            gold_percent: 0,
            category_quota: 24,
            quota: 6,
            rules: vec![Rule {
                min_answers: 2,
                review_percent: 10,
                ..rule("both-reject", RuleKind::Rejects)
            }],
            ..was.clone()
        };
        let change = SettingsChange { was, now };
        store
            .change_settings(admin, change, begin)
            .expect("settings");
        from_dataset(&store, root, None, begin, &mut |_, _| {}).expect("imports");
        let annotators = [
            ("aisha", 205.0),
            ("jonas", 260.0),
            ("mei", 235.0),
            ("tom", 310.0),
        ]
        .map(|(name, secs)| (user(name, Role::Annotator), secs));
        let reviewers = ["clara", "rui"].map(|name| user(name, Role::Reviewer));
        Self {
            store,
            annotators: annotators.to_vec(),
            reviewers: reviewers.to_vec(),
            rng: Seed(21).rng(&["a team"]),
            answers: 0,
            secs: 0.0,
        }
    }

    /// The answer of a person to a task: in nine of ten cases the same answer as others give.
    fn answer(&mut self, task: &TaskDetail) -> Answer {
        let own = self.rng.random_range(0..100) < 10;
        let number = if own {
            self.rng.random_range(0..u64::MAX)
        } else {
            Seed(21).draw_u64(&["truth", &task.task.key])
        };
        match task.task.kind {
            TaskKind::MaskText => describe(task, number, own),
            TaskKind::Pair => {
                let verdict = match number % 20 {
                    0..=4 => Verdict::Unnatural,
                    5..=7 => Verdict::Unclear,
                    8 => Verdict::Identical,
                    _ => Verdict::Keep,
                };
                let (edit, text) = EDITS[(number / 20) as usize % EDITS.len()];
                let (part, edit_type) = edit.split_once(' ').expect("a part and a type");
                from_json(if verdict == Verdict::Keep {
                    json!({ "kind": "pair", "verdict": "keep", "parts": [part], "edit_type": edit_type, "text": text })
                } else {
                    json!({ "kind": "pair", "verdict": verdict })
                })
            }
            TaskKind::Style => {
                let style = task.task.style.as_deref().unwrap_or("proud");
                let text = format!("Do the same in a {style} way.");
                from_json(json!({
                    "kind": "style", "verdict": "keep", "extent": "whole", "style": style, "text": text,
                }))
            }
        }
    }

    /// A person answers up to `count` tasks, from the time `now` on.
    fn work(&mut self, person: i64, pace: f64, count: usize, mut now: i64) {
        for turn in 0..count {
            let first = [0, 1, 0, 1, 2][turn % 5];
            let kinds = [TaskKind::MaskText, TaskKind::Pair, TaskKind::Style];
            let claimed =
                (0..3).find_map(|next| claim(&self.store, person, kinds[(first + next) % 3], now));
            let Some(detail) = claimed else { return };
            let slower = self.rng.random_range(0.7..1.4);
            let secs = match detail.task.kind {
                TaskKind::MaskText => pace * slower,
                _ => pace * slower / 2.0,
            };
            now += (secs * 1000.0) as i64;
            let sent = NewEvent {
                secs,
                ..event_of(&detail, EventKind::Submit, self.answer(&detail))
            };
            tell(&self.store, person, detail.task.id, sent, now);
            self.answers += 1;
            self.secs += secs;
        }
    }

    /// Reviewers decide about `count` tasks.
    fn review(&mut self, count: usize, mut now: i64) {
        for turn in 0..count {
            let reviewer = self.reviewers[turn % self.reviewers.len()];
            let queue = ReviewQueue::Disagreement;
            let Some(detail) = review(&self.store, reviewer, queue, now) else {
                return;
            };
            now += MINUTE / 2;
            let back = detail.comments.is_empty() && self.rng.random_range(0..100) < 9;
            let first = detail.candidates.first().map(|(own, _)| own.author);
            let (what, comment) = match back {
                true => (Decision::Return, COMMENTS[turn % COMMENTS.len()]),
                false => (Decision::Accept, ""),
            };
            let review = NewReview {
                author: first,
                comment: comment.to_owned(),
                secs: 28.0,
                ..decision(detail.task.id, detail.lease.epoch, what)
            };
            self.store.review(reviewer, review, now).expect("decides");
        }
    }

    /// Simulates two weeks up to `end`. Work begins at 8:00 UTC on weekdays.
    fn two_weeks(&mut self, end: i64) {
        let counts = self.store.funnel().expect("a funnel");
        let tasks: i64 = counts.iter().map(|row| row.2).sum();
        let daily = tasks as f64 * 1.4 * 0.75 / (10.0 * self.annotators.len() as f64);
        let today = end - end % DAY;
        let mornings: Vec<i64> = (0..14)
            .map(|back| today - (13 - back) * DAY + 8 * HOUR)
            // The first day of the epoch was a Thursday.
            .filter(|morning| (morning / DAY + 3) % 7 < 5 && *morning < end - 3 * HOUR)
            .collect();
        for (day, &morning) in mornings.iter().enumerate() {
            for (index, (person, pace)) in self.annotators.clone().into_iter().enumerate() {
                // The fourth annotator joins later, and the second is away on every third day.
                if index == 3 && day < 4 || index == 1 && day % 3 == 2 {
                    continue;
                }
                let count = (daily * self.rng.random_range(0.6..1.4)).round();
                let begin = morning + index as i64 * 20 * MINUTE;
                self.work(person, pace, count as usize, begin);
            }
            // Answers of the last day are not reviewed yet.
            if day + 1 < mornings.len() {
                self.review((daily * 2.2).round() as usize, morning + 2 * HOUR);
            }
        }
    }
}

#[test]
fn the_work_of_a_team_is_counted_once_by_day_and_by_week() {
    let check = |mut team: Team, end: i64| {
        team.two_weeks(end);
        let store = Arc::clone(&team.store);
        let days = store.work(end - 15 * DAY, end).expect("days");
        let answers: i64 = days.iter().map(|day| day.answers).sum();
        assert_eq!(answers, team.answers);
        let secs: f64 = days.iter().map(|day| day.secs).sum();
        let reviews: i64 = days.iter().map(|day| day.reviews).sum();
        let expected = team.secs + reviews as f64 * 28.0;
        assert!((secs - expected).abs() < 1.0, "{secs} of {expected}");
        let mut by_person: BTreeMap<&str, i64> = BTreeMap::new();
        for day in &days {
            *by_person.entry(&day.name).or_default() += day.answers;
        }
        assert!(by_person["tom"] < by_person["aisha"], "{by_person:?}");
        let outlook = store.outlook(end).expect("an outlook");
        assert!(outlook.iter().all(|kind| kind.answers_left >= 0));
        whole(&store);
    };
    if let Some(root) = std::env::var_os("ANNOTATE_SEED") {
        let root = std::path::PathBuf::from(root);
        let path = root.join("annotate").join("store.sqlite");
        assert!(!path.exists(), "{} is there already", path.display());
        std::fs::create_dir_all(root.join("annotate")).expect("a folder");
        let now = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .expect("after 1970");
        let end = now.as_millis() as i64;
        let store = open_sqlite(&path).expect("a store");
        check(Team::new(store, &root, end - 14 * DAY), end);
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let root = folder.path().join("dataset");
    dataset(&root);
    on_each("a team", |store| {
        check(Team::new(store, &root, START - 14 * DAY), START);
    });
}
