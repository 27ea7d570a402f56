//! Features for projects with tens of thousands of tasks: acceptance rules, task browser, bulk actions, submitted
//! answers.

mod browser;
mod practice;

use std::collections::BTreeSet;

use annotate::store::{MotionRecord, NewTask, PageQuery, TokenUse};
use annotate::transfer::export;
use annotate::wire::{
    Answer, BulkAction, BulkDone, BulkRequest, Code, Decision, EventKind, ExportFormat, MyAnswer,
    NewReview, ReviewQueue, Role, Rule, RuleKind, Standing, TaskKind, TaskRow, TaskSort, TaskState,
    Verdict,
};
use serde_json::{Value, json};

use crate::fixture::{Fixture, each, mask_tasks, pair_tasks, problem};
use crate::support::{
    Client, DAY, HOUR, MINUTE, ROOT, START, Site, bare_motion, bare_task, decision, event,
    from_json, masks, pair, refusal, rule,
};

fn unclear() -> Answer {
    pair(Verdict::Unclear)
}

fn waving() -> Answer {
    masks("waving")
}

impl Fixture {
    fn accept_rejects(&self) {
        self.rules([rule("rejects", RuleKind::Rejects)]);
    }

    fn rules<const N: usize>(&self, rules: [Rule; N]) {
        self.set(|settings| settings.rules = rules.into());
    }

    /// Applies the rules, and returns the number of tasks that `rule` accepted.
    fn applied(&self, rule: &str) -> i64 {
        let done = self.store.apply_rules(0, START).expect("applies");
        assert_eq!(done.next, None);
        done.accepted.get(rule).copied().unwrap_or(0)
    }

    fn row(&self, task: i64) -> TaskRow {
        self.store.task_row(task).expect("a task").0
    }

    fn mine(&self, user: i64) -> Vec<MyAnswer> {
        self.mine_of(user, json!({ "limit": 50 })).0
    }

    /// A user's answer to a task.
    fn own(&self, user: i64, task: i64) -> MyAnswer {
        let mut all = self.mine(user).into_iter();
        all.find(|own| own.mine.task == task).expect("an answer")
    }

    fn mine_of(&self, user: i64, query: Value) -> (Vec<MyAnswer>, Option<String>) {
        let answers = self.store.answers_of(user, from_json(query), self.now());
        answers.expect("answers")
    }

    fn found(&self, filter: Value) -> Vec<i64> {
        let query = PageQuery {
            filter: from_json(filter),
            limit: 200,
            ..PageQuery::default()
        };
        let page = self.store.browse(query).expect("a page");
        assert_eq!(page.total, Some(page.rows.len() as i64));
        page.rows.iter().map(|row| row.id).collect()
    }

    /// Runs a bulk action of the reviewer.
    fn bulk(&self, request: BulkRequest) -> BulkDone {
        let done = self.store.bulk(&self.who(self.eve), request, START);
        done.expect("acts")
    }

    fn preview(&self, request: BulkRequest) -> BulkDone {
        let counted = self.store.preview_bulk(&self.who(self.eve), request, START);
        counted.expect("counts")
    }
}

#[test]
fn rules_accept_rejects_agreed_answers_and_those_of_trusted_people() {
    let masks = mask_tasks(12).split_off(10);
    each("rules", [pair_tasks(2), masks].concat(), |site| {
        // Rejects are accepted as they arrive, and the log names the rule.
        site.accept_rejects();
        let rejected = site.hand_in(site.ann, pair(Verdict::Unnatural));
        assert_eq!(site.state(rejected), TaskState::Accepted);
        let basis = site.row(rejected).accepted_by;
        assert_eq!(basis.as_deref(), Some("rule:rejects"));
        let kept = site.hand_in(site.ann, pair(Verdict::Keep));
        assert_eq!(site.state(kept), TaskState::Submitted);
        let mut log = site.store.log(0, 1000).expect("the log");
        log.retain(|entry| entry.kind == "accepted");
        assert_eq!(log.len(), 1);
        assert_eq!(log[0].body["rule"], "rejects");
        assert_eq!(log[0].actor, None);

        site.rules([Rule {
            people: vec![site.bob],
            ..rule("trusted", RuleKind::Trusted)
        }]);
        let hers = site.hand_in(site.ann, waving());
        let his = site.hand_in(site.bob, waving());
        assert_eq!(site.state(hers), TaskState::Submitted);
        assert_eq!(site.state(his), TaskState::Accepted);

        // Answers that differ wait for a reviewer.
        site.set(|settings| settings.answers_per_task = 2);
        site.rules([Rule {
            min_answers: 2,
            ..rule("agreed", RuleKind::Sampled)
        }]);
        site.import(pair_tasks(25).split_off(20));
        let second = |theirs: Verdict| {
            let task = site.hand_in(site.ann, unclear());
            assert_eq!(site.state(task), TaskState::Open, "one is not enough");
            assert_eq!(site.hand_in(site.bob, pair(theirs)), task);
            site.state(task)
        };
        assert_eq!(second(Verdict::Unclear), TaskState::Accepted);
        assert_eq!(second(Verdict::Unnatural), TaskState::Submitted);
    });
}

#[test]
fn the_share_left_to_reviewers_depends_on_seed_and_task_alone() {
    let left: std::sync::Mutex<Vec<(u32, BTreeSet<String>)>> = Vec::new().into();
    for (name, seed) in [("sample", 7), ("sample again", 7), ("sample other", 42)] {
        each(name, mask_tasks(60), |site| {
            site.set(|settings| settings.seed = seed);
            site.rules([Rule {
                review_percent: 20,
                ..rule("sample", RuleKind::Sampled)
            }]);
            for _ in 0..60 {
                site.hand_in(site.ann, waving());
            }
            let waiting = site.found(json!({ "state": "submitted" }));
            let accepted = site.found(json!({ "rule": "sample" }));
            assert_eq!(waiting.len() + accepted.len(), 60, "one or the other");
            let keys = waiting.into_iter().map(|task| site.record(task).key);
            let mut left = left.lock().expect("no panic");
            left.push((seed, keys.collect()));
        });
    }
    let left = left.into_inner().expect("no panic");
    let (_, first) = &left[0];
    assert!((4..=22).contains(&first.len()), "{}", first.len());
    for (seed, keys) in &left {
        assert_eq!(keys == first, *seed == 7, "{seed}");
    }
}

#[test]
fn rules_are_applied_on_demand_as_their_preview_says_and_undone_with_all_that_they_accepted() {
    each("demand", pair_tasks(9), |site| {
        let kept = site.hand_in(site.ann, pair(Verdict::Keep));
        for _ in 0..8 {
            site.hand_in(site.ann, unclear());
        }
        site.accept_rejects();
        let counts = || {
            let rules = site.store.rules().expect("rules");
            (rules[0].accepted, rules[0].would_accept)
        };
        assert_eq!(counts(), (0, 8));
        let done = site.store.apply_rules(0, START).expect("applies");
        assert_eq!((done.looked_at, done.accepted["rejects"]), (9, 8));
        assert_eq!(done.next, None);
        assert_eq!(counts(), (8, 0));
        assert_eq!(site.accepted().len(), 8);

        assert_eq!(site.judge(Decision::Accept), kept);
        assert_eq!(site.accepted().len(), 9);
        let undo = |rule: &str| site.store.undo_rule(ROOT, rule, START);
        let undone = undo("rejects").expect("undoes");
        assert_eq!((undone.reopened, undone.left), (8, 0));
        assert_eq!(site.accepted().len(), 1, "what a person accepted stays");
        let settings = site.store.settings().expect("settings");
        assert!(!settings.rules[0].enabled, "the next answer waits again");
        let (task, epoch) = site.review();
        assert_eq!(site.state(task), TaskState::InReview);
        let done = site.decide(task, epoch, Decision::Accept);
        assert_eq!(done, Ok(TaskState::Accepted));
        site.set(|settings| settings.rules[0].enabled = true);
        assert_eq!(site.applied("rejects"), 7);
        assert_eq!(refusal(undo("nothing")), Code::NotFound);
    });
}

#[test]
fn a_rule_leaves_alone_what_was_sent_back_and_its_acceptances_may_be_taken_back_for_a_while() {
    each("take_back", pair_tasks(3), |site| {
        let returned = site.hand_in(site.ann, unclear());
        assert_eq!(site.judge(Decision::Return), returned);
        site.accept_rejects();
        assert_eq!(site.take_pair(site.ann), returned);
        site.submit(site.ann, returned, 1, unclear());
        assert_eq!(site.state(returned), TaskState::Submitted);
        let reopened = site.hand_in(site.ann, unclear());
        assert_eq!(site.state(reopened), TaskState::Accepted);
        site.reopen(reopened);
        assert_eq!(site.applied("rejects"), 0);

        site.set(|settings| settings.take_back_minutes = 10);
        let task = site.hand_in(site.ann, unclear());
        site.wait(MINUTE);
        let own = || site.own(site.ann, task);
        let stands = (own().standing, own().can_take_back);
        assert_eq!(stands, (Standing::Accepted, true));
        let undone = site.send(site.ann, task, event(EventKind::Undo, 0, 1, None));
        let said = (undone.status, undone.state);
        assert_eq!(said, (200, Some(TaskState::Leased)));
        assert!(site.accepted().is_empty());
        site.wait(MINUTE);
        site.submit(site.ann, task, 2, pair(Verdict::Unnatural));
        assert_eq!(site.state(task), TaskState::Accepted);
        site.wait(11 * MINUTE);
        assert!(!own().can_take_back);
        let refused = site.send(site.ann, task, event(EventKind::Undo, 0, 3, None));
        assert_eq!(problem(&refused), Code::WrongState);
    });
}

fn request(action: BulkAction, filter: Value) -> BulkRequest {
    from_json(json!({ "filter": filter, "action": action, "comment": "all of them" }))
}

#[test]
fn a_bulk_action_does_what_its_preview_counted() {
    each("bulk", pair_tasks(8), |site| {
        for _ in 0..5 {
            site.hand_in(site.ann, unclear());
        }
        let own = site.hand_in(site.eve, unclear());
        let accept = || request(BulkAction::Accept, json!({}));
        let before = site.last_seq();
        let preview = site.preview(accept());
        assert_eq!((preview.looked_at, preview.done), (8, 5));
        assert_eq!(preview.left_alone["own_work"], 1);
        assert_eq!(preview.left_alone["wrong_state"], 2);
        assert_eq!(site.last_seq(), before);
        assert_eq!(site.bulk(accept()), preview);
        assert_eq!(site.accepted().len(), 5);
        assert_eq!(site.state(own), TaskState::Submitted);
        let accepted = json!({ "state": "accepted" });
        let reopened = site.bulk(request(BulkAction::Reopen, accepted));
        assert_eq!((reopened.done, site.accepted().len()), (5, 0));
        let hers = json!({ "person": site.ann });
        let returned = site.bulk(request(BulkAction::Return, hers));
        assert_eq!(returned.done, 5);
        assert_eq!(site.home(site.ann).returned.len(), 5);
        let dropped = site.bulk(request(BulkAction::Drop, json!({})));
        assert_eq!((dropped.done, dropped.left_alone["own_work"]), (7, 1));
        let silent = || BulkRequest {
            comment: " ".to_owned(),
            ..request(BulkAction::Drop, json!({}))
        };
        // A preview needs no comment.
        assert_eq!(site.preview(silent()).looked_at, 8);
        let refused = site.store.bulk(&site.who(site.eve), silent(), START);
        assert_eq!(refusal(refused), Code::Invalid);
    });
}

fn assign(person: i64) -> BulkRequest {
    BulkRequest {
        person: Some(person),
        ..request(BulkAction::Assign, json!({}))
    }
}

#[test]
fn an_assigned_task_goes_to_its_person_first_until_the_reservation_ends() {
    each("assign", mask_tasks(5), |site| {
        let others = site.take(site.ann);
        let last = site.found(json!({}))[4];
        let only_last = BulkRequest {
            after: Some(last - 1),
            ..assign(site.bob)
        };
        assert_eq!(site.bulk(only_last).done, 1);
        assert_eq!(site.state(last), TaskState::Leased);
        let held = site.store.leases(START).expect("leases");
        let reserved = held.iter().find(|held| held.purpose == "assigned");
        let reserved = reserved.expect("a reservation").lease.id;
        let renewed = site.store.renew(site.bob, reserved, START);
        let said = renewed.expect_err("it is reserved").to_string();
        assert_eq!(said, "a task that is assigned cannot be renewed; claim it");
        assert_eq!(site.take(site.bob), last);
        let preview = site.preview(assign(site.bob));
        assert_eq!(preview.done, 3);
        assert_eq!(preview.left_alone["task_full"], 1, "task {others}");
        assert_eq!(preview.left_alone["held"], 1);
        let refused = site.store.bulk(&site.who(site.eve), assign(999), START);
        assert_eq!(refusal(refused), Code::Invalid);
        // Nobody else gets the other three until Bob has left them for days.
        site.submit(site.ann, others, 0, waving());
        site.submit(site.bob, last, 0, waving());
        assert_eq!(site.bulk(assign(site.bob)).done, 3);
        assert_eq!(site.claim(site.ann), None);
        site.wait(8 * DAY);
        site.take(site.ann);
    });
}

#[test]
fn my_answers_say_where_each_stands() {
    each("own_answers", mask_tasks(4), |site| {
        let tasks = [0, 1, 2, 3].map(|number| {
            site.wait(number);
            site.answer(site.ann, &format!("n{number}"))
        });
        let begun = site.now();
        let decisions = [Decision::Return, Decision::Merge, Decision::Accept];
        let [returned, merged, accepted] = decisions.map(|decision| site.judge(decision));
        let waiting = tasks[3];
        let own = |task: i64| site.own(site.ann, task);
        assert_eq!(own(waiting).standing, Standing::WaitsForReview);
        assert!(own(waiting).can_take_back);
        assert_eq!(own(accepted).standing, Standing::Accepted);
        assert!(!own(accepted).can_take_back);
        let back = own(returned);
        assert_eq!(back.standing, Standing::Returned);
        assert_eq!(back.comment.as_deref(), Some("because"));
        assert_eq!(back.until, Some(begun + 7 * DAY));
        let other = own(merged);
        assert_eq!(other.standing, Standing::Superseded);
        assert_eq!(other.accepted, Some(masks("merged")));
        let (some, next) = site.mine_of(site.ann, json!({ "limit": 2 }));
        assert_eq!((some[0].mine.task, some.len()), (waiting, 2));
        let (rest, end) = site.mine_of(site.ann, json!({ "before": next, "limit": 10 }));
        assert_eq!((rest.len(), end), (2, None));
        let returned_only = json!({ "standing": "returned", "limit": 1 });
        let (found, _) = site.mine_of(site.ann, returned_only);
        assert_eq!(found[0].mine.task, returned);
        let sent_back = json!({ "reviewer": site.eve, "decision": "returned", "limit": 10 });
        let decisions = site.store.decisions(from_json(sent_back));
        let sent_back = decisions.expect("decisions").items;
        assert_eq!(sent_back.len(), 1);
        assert_eq!(sent_back[0].authors, ["ann"]);
        assert_eq!(sent_back[0].state, TaskState::Returned);
        // A task that was dropped after its return cannot be fixed.
        let drop = decision(returned, 0, Decision::Drop);
        site.store
            .review(site.eve, drop, site.now())
            .expect("drops");
        assert_eq!(own(returned).standing, Standing::Dropped);
        assert_eq!(own(returned).until, None);
    });
}

#[test]
fn one_researcher_may_accept_their_own_work_and_it_is_marked() {
    each("solo", mask_tasks(2), |site| {
        let task = site.hand_in(site.ann, waving());
        let next = || {
            let queue = ReviewQueue::Disagreement;
            let claimed = site.store.review_next(site.ann, queue, None, START);
            claimed.expect("claims")
        };
        assert!(next().is_err());
        site.set(|settings| settings.solo = true);
        let Ok(detail) = next() else {
            panic!("my own answer waits");
        };
        assert_eq!(detail.task.id, task);
        let accept = decision(task, detail.lease.epoch, Decision::Accept);
        let done = site.store.review(site.ann, accept, START);
        assert_eq!(done.expect("accepts").state, TaskState::Accepted);
        assert_eq!(site.row(task).accepted_by.as_deref(), Some("own"));
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path();
        for format in [
            ExportFormat::Csv,
            ExportFormat::Parquet,
            ExportFormat::Stance,
        ] {
            let selection = from_json(json!({ "format": format }));
            let done = export(&site.store, path, path, &selection, "test").expect("exports");
            assert_eq!(done.counts["accepted_by own"], 1, "{format}");
            let mut messages = done.messages.iter();
            assert!(messages.any(|text| text.contains("own authors")));
        }
        let csv = std::fs::read_to_string(path.join("labels.csv")).expect("a file");
        assert!(csv.lines().any(|line| line.contains(",own,")), "{csv}");
    });
}

#[test]
fn a_changed_number_of_people_applies_to_open_tasks_and_answers_say_for_whom_they_wait() {
    each("retarget", mask_tasks(3), |site| {
        let done = site.hand_in(site.ann, waving());
        let wanted = || [1, 2, 3].map(|task| site.record(task).wanted);
        assert_eq!(wanted(), [1, 1, 1]);
        site.set(|settings| settings.answers_per_task = 2);
        assert_eq!(wanted(), [1, 2, 2], "task {done} has all its answers");
        let half = site.hand_in(site.ann, waving());
        assert_eq!(site.state(half), TaskState::Open);
        let own = || site.own(site.ann, half);
        assert_eq!(own().standing, Standing::WaitsForOthers);
        assert!(own().can_take_back);
        assert_eq!((own().task.wanted, own().task.submitted), (2, 1));
        let before = site.last_seq();
        site.set(|settings| settings.min_masks = 1);
        assert_eq!(site.last_seq(), before + 1, "other settings change no task");
        site.set(|settings| settings.answers_per_task = 1);
        assert_eq!(wanted(), [1, 1, 1]);
        assert_eq!(site.state(half), TaskState::Submitted);
        assert_eq!(own().standing, Standing::WaitsForReview);
    });
}

#[test]
fn hours_and_answers_are_counted_by_person_and_day() {
    each("days", mask_tasks(6), |site| {
        let midnight = START.div_euclid(DAY) * DAY;
        let evening = midnight + 23 * HOUR;
        site.wait(evening - START);
        site.answer(site.ann, "one");
        site.answer(site.ann, "two");
        site.judge(Decision::Accept);
        site.wait(2 * HOUR);
        site.answer(site.ann, "three");
        let days = |user: i64| {
            let days = site.store.work(midnight, midnight + 2 * DAY);
            let mut days = days.expect("days");
            days.retain(|day| day.user == user);
            let counts = days
                .iter()
                .map(|day| (day.start, day.answers, day.reviews, day.secs));
            counts.collect::<Vec<_>>()
        };
        let utc = [(midnight, 2, 0, 25.0), (midnight + DAY, 1, 0, 12.5)];
        assert_eq!(days(site.ann), utc);
        assert_eq!(days(site.eve), [(midnight, 0, 1, 40.0)]);
        site.set(|settings| settings.time_zone = "Africa/Johannesburg".to_owned());
        let east = [(midnight + 22 * HOUR, 3, 0, 37.5)];
        assert_eq!(days(site.ann), east);
        let outlook = site.store.outlook(evening + DAY).expect("an outlook");
        let masks = &outlook[0];
        assert_eq!((masks.answers_left, masks.reviews_left), (3, 2));
        assert_eq!(masks.answers_per_day, 3.0);
        assert_eq!(masks.days_left, Some(1.0));
        assert_eq!(masks.ends, Some(evening + 2 * DAY));
    });
}

#[test]
fn users_come_in_bulk_with_a_token_each_or_not_at_all() {
    each("teams", Vec::new(), |site| {
        let add = |lines: &str| {
            let until = START + MINUTE;
            site.store.add_users(Some(ROOT), lines, until, START)
        };
        let count = || site.store.users().expect("users").len();
        let before = count();
        for (lines, field) in [
            ("cleo\nann", "lines.2"),
            ("cleo,captain", "lines.1"),
            ("cleo\ncleo", "lines.2"),
            ("", "lines"),
        ] {
            let problem = add(lines).expect_err("refused").problem();
            assert_eq!(problem.field.as_deref(), Some(field), "{lines:?}");
        }
        assert_eq!(count(), before);
        let added = add("\u{feff}name,role\r\ncleo\r\n\"dora\";reviewer\r\n\r\n").expect("users");
        let users = added.iter().map(|issued| &issued.user);
        let roles: Vec<_> = users.map(|user| (user.name.as_str(), user.role)).collect();
        assert_eq!(roles, [("cleo", Role::Annotator), ("dora", Role::Reviewer)]);
        let token = &added[0].token;
        let who = site.store.authenticate(token, TokenUse::Token, START);
        assert_eq!(who.expect("a token").name, "cleo");
    });
}

#[test]
fn the_routes_of_a_large_project_answer_as_documented() {
    use annotate::wire::{
        DayWork, Decisions, MyAnswers, NewUserLink, Outlook, Practice, RuleState, RulesApplied,
        Task, TaskFile, TaskPage,
    };

    let site = Site::new();
    let [ann, eve, boss] = site.people(["ann", "eve", "boss"]);
    let task = ann.answer(masks("waving with a mask"));
    let rejected = ann.answer(unclear());
    let page: TaskPage = eve.get("tasks?q=a+MASK&state=submitted&limit=10").ok();
    assert_eq!((page.total, page.rows.len()), (Some(1), 1));
    assert_eq!(page.rows[0].id, task);
    assert_eq!(page.rows[0].source_id, "clip00");
    assert_eq!(page.rows[0].answers[0].name, "ann");
    let captions: TaskPage = eve.get("tasks?q=take+clip00&kind=mask_text").ok();
    assert_eq!(captions.total, Some(1), "captions are searched");
    let record: TaskFile = eve.get(&format!("tasks/{task}/record")).ok();
    assert_eq!(record.answers.len(), 1);
    let mine: MyAnswers = ann.get("answers?limit=1").ok();
    assert_eq!(mine.items.len(), 1);
    assert!(mine.next.is_some());
    let bulk = json!({ "filter": { "kind": "pair", "verdict": "unclear" }, "action": "accept" });
    let preview: BulkDone = eve.post("bulk/preview", &bulk).ok();
    let done: BulkDone = eve.post("bulk", &bulk).ok();
    assert_eq!((preview.done, done.done), (1, 1));
    let decisions: Decisions = eve.get("reviews?decision=accepted").ok();
    assert_eq!(decisions.items[0].task, rejected);
    let rules: Vec<RuleState> = eve.get("rules").ok();
    assert!(rules.is_empty());
    let applied: RulesApplied = boss.post("rules/apply", &json!({})).ok();
    assert_eq!(applied.looked_at, 1);
    let lines = json!({ "lines": "cleo\ndora,reviewer" });
    let links: Vec<NewUserLink> = boss.post("users/bulk", &lines).ok();
    assert!(links[1].path.starts_with("/#token=ann_"));
    let practice: Vec<Practice> = ann.get("practice").ok();
    assert!(practice.iter().all(|practice| practice.passed));
    let days: Vec<DayWork> = eve.get("stats/days").ok();
    assert_eq!(days.iter().map(|day| day.answers).sum::<i64>(), 2);
    let outlook: Vec<Outlook> = eve.get("stats/outlook").ok();
    assert_eq!(outlook.len(), TaskKind::ALL.len());
    for copy in ["gold", "practice"] {
        let made: Task = boss
            .post(&format!("tasks/{rejected}/{copy}"), &json!({}))
            .ok();
        assert_eq!(made.wanted, 1, "{copy}: a person is asked once");
    }
    assert_eq!(eve.get("tasks?colour=red").code(), Code::BadRequest);
}

#[test]
fn the_guide_has_guidelines_and_pictures_of_each_kind() {
    use annotate::wire::{Guide, GuideChange, KindGuide, Me, PictureInfo, TextForm};

    let site = Site::new();
    let [ann, boss] = site.people(["ann", "boss"]);
    let guide: Guide = ann.get("guide").ok();
    assert!(guide.kinds[&TaskKind::Style].text.contains("proudly"));
    assert_eq!(guide.forms[&TaskKind::MaskText], TextForm::Completion);
    assert_eq!(guide.forms[&TaskKind::Pair], TextForm::Instruction);
    let me: Me = ann.get("me").ok();
    assert!(me.project.mask_templates.contains(&"raising".to_owned()));
    let png = b"\x89PNG\r\n\x1a\nnot a whole picture";
    let put = |client: &Client, name: &str, bytes: &[u8]| {
        client.call("PUT", &format!("guide/pictures/{name}"), Some(bytes))
    };
    let kept: PictureInfo = put(&boss, "right.png", png).ok();
    assert_eq!((kept.mime.as_str(), kept.bytes), ("image/png", png.len()));
    // Base64 pads each of these lengths in another way.
    for more in 0..3 {
        put(
            &boss,
            "right.png",
            &[png.as_slice(), &[0, 1][..more]].concat(),
        );
        let listed: Vec<PictureInfo> = ann.get("guide/pictures").ok();
        assert_eq!(listed[0].bytes, png.len() + more);
    }
    put(&boss, "right.png", png);
    assert_eq!(put(&boss, "..", png).code(), Code::Invalid);
    assert_eq!(put(&boss, "evil.svg", b"<svg/>").code(), Code::Invalid);
    assert_eq!(put(&ann, "right.png", png).code(), Code::Forbidden);
    let seen = ann.get("guide/pictures/right.png");
    assert_eq!(seen.body, png);
    assert_eq!(seen.header("content-type"), Some("image/png"));
    let changed: KindGuide = from_json(json!({
        "text": "Say what differs.",
        "pictures": [{ "name": "right.png", "caption": "an arm", "right": true }],
    }));
    let change = |was: &KindGuide, now: &KindGuide| {
        let (was, now) = (was.clone(), now.clone());
        boss.put("guide/pair", &GuideChange { was, now })
    };
    let before = guide
        .kinds
        .get(&TaskKind::Pair)
        .cloned()
        .unwrap_or_default();
    let changed: KindGuide = change(&before, &changed).ok();
    // Somebody who read the guide before is told, and nothing is overwritten.
    let late = KindGuide {
        text: "Be quick.".to_owned(),
        ..before.clone()
    };
    assert_eq!(change(&before, &late).code(), Code::SettingChanged);
    let guide: Guide = ann.get("guide").ok();
    assert_eq!(guide.kinds[&TaskKind::Pair], changed);
    assert!(guide.kinds[&TaskKind::Style].text.contains("proudly"));
    assert_eq!(boss.delete("guide/pictures/right.png").status, 204);
    let gone = ann.get("guide/pictures/right.png");
    assert_eq!(gone.code(), Code::NotFound);
}
