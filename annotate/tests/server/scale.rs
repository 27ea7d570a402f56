//! Features for projects with tens of thousands of tasks: acceptance rules, task browser, bulk actions, submitted
//! answers.

use std::collections::BTreeSet;

use annotate::store::{MotionRecord, NewTask, PageQuery, TokenUse};
use annotate::transfer::export;
use annotate::wire::{
    Answer, BulkAction, BulkDone, BulkRequest, Code, Decision, EventKind, ExportFormat, MyAnswer,
    NewReview, ReviewQueue, Role, Rule, RuleKind, Standing, TaskKind, TaskRow, TaskSort, TaskState,
    Verdict,
};
use serde_json::{Value, json};

use crate::store::{Fixture, each, mask_tasks, pair_tasks, problem};
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

#[test]
fn the_browser_filters_by_everything_a_reviewer_asks_for_and_searches_texts_alone() {
    let mut tasks = mask_tasks(4);
    tasks.extend((10..14).map(|number| NewTask {
        category: Some(["walk", "run"][number % 2].to_owned()),
        ..bare_task(number, TaskKind::Pair)
    }));
    each("filters", tasks, |site| {
        let mask = site.hand_in(site.ann, masks("Waving_50%"));
        let other = site.hand_in(site.ann, masks("putting on a mask"));
        let keep = site.hand_in(site.ann, pair(Verdict::Keep));
        site.wait(1);
        let reject = site.hand_in(site.bob, unclear());
        let held = site.take_pair(site.bob);
        let submitted = json!({ "kind": "mask_text", "state": "submitted" });
        let walks = json!({ "category": "walk", "verdict": "keep" });
        let cases: [(Value, &[i64]); 14] = [
            (submitted, &[mask, other]),
            (json!({ "person": site.ann }), &[mask, other, keep]),
            (json!({ "person": site.bob }), &[reject, held]),
            (json!({ "part": "RIGHT_ARM" }), &[keep]),
            (json!({ "edit_type": "amplitude" }), &[keep]),
            (json!({ "verdict": "unclear" }), &[reject]),
            (walks, &[keep]),
            (json!({ "min_distance": 0.0 }), &[]),
            (json!({ "task": held }), &[held]),
            (json!({ "q": "mask" }), &[other]),
            (json!({ "q": "wavinG_50%" }), &[mask]),
            (json!({ "q": "wavinGx50%" }), &[]),
            // Names of a part and of a field are not found.
            (json!({ "q": "left_arm" }), &[]),
            (json!({ "q": "soft" }), &[]),
        ];
        for (filter, expected) in cases {
            assert_eq!(site.found(filter.clone()), expected, "{filter}");
        }
        let holders = site.row(held).holders;
        assert_eq!((holders.len(), holders[0].name.as_str()), (1, "bob"));
        assert_eq!(holders[0].until, site.now() + 15 * MINUTE);
        let refused = site.store.browse(PageQuery {
            filter: from_json(json!({ "part": "TAIL" })),
            limit: 10,
            ..PageQuery::default()
        });
        assert_eq!(refusal(refused), Code::Invalid);

        let opened = site.store.review_task(site.eve, mask, site.now());
        let epoch = opened.expect("a review").lease.epoch;
        let done = site.decide(mask, epoch, Decision::Accept);
        assert_eq!(done, Ok(TaskState::Accepted));
        for (text, expected) in [("kind", 0), ("waving", 1)] {
            let filter = from_json(json!({ "q": text, "limit": 10 }));
            let shelf = site.store.shelf(site.eve, filter).expect("a shelf");
            assert_eq!(shelf.len(), expected, "{text}");
        }
    });
}

#[test]
fn a_search_ignores_case_and_reads_captions_as_they_stand() {
    each("search", Vec::new(), |site| {
        let captions = ["Öffnet die Tür", "says \"Hi\", twice", r"a back\slash"];
        let captions = captions.map(str::to_owned).to_vec();
        let motion = MotionRecord {
            captions,
            ..bare_motion()
        };
        site.store.put_motions(vec![motion]).expect("a motion");
        let hinted = NewTask {
            hint: Some("ÉCHAPPER".to_owned()),
            ..bare_task(0, TaskKind::MaskText)
        };
        site.import(vec![hinted]);
        for (text, found) in [
            ("öffnet die tür", 1),
            ("ÖFFNET DIE TÜR", 1),
            ("échapper", 1),
            ("\"hi\", TWICE", 1),
            (r"back\slash", 1),
            (r"back\\slash", 0),
            ("\"", 1),
            ("offnet", 0),
            ("\",\"", 0),
        ] {
            assert_eq!(site.found(json!({ "q": text })).len(), found, "{text}");
        }
    });
}

/// All rows of the browser in an order, read in pages of four.
fn paged(site: &Fixture, sort: TaskSort, reverse: bool) -> Vec<TaskRow> {
    let (mut after, mut seen) = (None, Vec::new());
    loop {
        let is_first = seen.is_empty();
        let page = site.store.browse(PageQuery {
            sort: Some(sort),
            reverse,
            after,
            limit: 4,
            ..PageQuery::default()
        });
        let page = page.expect("a page");
        assert_eq!(page.total, is_first.then_some(25));
        seen.extend(page.rows);
        after = page.next;
        if after.is_none() {
            return seen;
        }
    }
}

#[test]
fn pages_in_every_order_hold_every_task_once() {
    each("pages", Vec::new(), |site| {
        site.set(|settings| settings.answers_per_task = 2);
        site.import(pair_tasks(25));
        for number in 0..10 {
            site.hand_in(site.ann, unclear());
            let theirs = [Verdict::Unclear, Verdict::Keep][number % 2];
            site.hand_in(site.bob, pair(theirs));
            site.wait(1);
        }
        for sort in [TaskSort::Id, TaskSort::Distance, TaskSort::Touched] {
            for reverse in [false, true] {
                let seen = paged(site, sort, reverse);
                let ids: BTreeSet<i64> = seen.iter().map(|row| row.id).collect();
                assert_eq!((ids.len(), seen.len()), (25, 25), "{sort} {reverse}");
                // Ids ascend, distances and times descend.
                let place = |row: &TaskRow| match sort {
                    TaskSort::Id => -(row.id as f64),
                    TaskSort::Distance => row.distance.unwrap_or(-1.0),
                    TaskSort::Touched => row.touched as f64,
                };
                let ordered = seen.is_sorted_by(|a, b| match reverse {
                    false => place(a) >= place(b),
                    true => place(a) <= place(b),
                });
                assert!(ordered, "{sort} {reverse}");
            }
        }
        let bad = site.store.browse(PageQuery {
            after: Some("nothing".to_owned()),
            limit: 4,
            ..PageQuery::default()
        });
        assert_eq!(refusal(bad), Code::Invalid);
    });
}

#[test]
fn tasks_that_everybody_skipped_are_listed_with_the_reasons() {
    each("skipped", mask_tasks(3), |site| {
        let check = |by_any: &[i64], by_everybody: &[i64]| {
            assert_eq!(site.found(json!({ "skipped": "any" })), by_any);
            assert_eq!(site.found(json!({ "skipped": "everybody" })), by_everybody);
        };
        let enable = |active| {
            for user in [site.ann, site.bob] {
                site.enable(user, active);
            }
        };
        let (first, second) = (site.skip(site.ann), site.skip(site.ann));
        check(&[first, second], &[]);
        // Eve only reviews.
        assert_eq!(site.skip(site.bob), first);
        check(&[first, second], &[first]);
        let skips = site.row(first).skips;
        let names: Vec<&str> = skips.iter().map(|skip| skip.name.as_str()).collect();
        assert_eq!(names, ["ann", "bob"]);
        for skip in skips {
            let why = skip.reason.map(|reason| reason.as_str());
            assert_eq!((why, skip.note.as_str()), (Some("cannot_tell"), "too dark"));
        }
        // An answered task is not listed as skipped by everybody.
        assert_eq!(site.answer(site.bob, "seen"), second);
        check(&[first, second], &[first]);
        // Without annotators, all users count: eve and the admin are left.
        enable(false);
        check(&[first, second], &[]);
        enable(true);
        let dropped = site.decide(first, 0, Decision::Drop);
        assert_eq!(dropped, Ok(TaskState::Dropped));
        assert!(site.found(json!({ "skipped": "everybody" })).is_empty());
    });
}

#[test]
fn a_task_is_opened_for_review_from_its_record_by_one_reviewer_who_did_not_answer_it() {
    each("opened", mask_tasks(3), |site| {
        let rev = site.join("rev", Role::Reviewer);
        let open = |user: i64, task: i64| site.store.review_task(user, task, START);
        let first = site.answer(site.ann, "waving");
        let second = site.answer(site.eve, "bowing");
        let third = site.found(json!({}))[2];
        let lease = open(site.eve, first).expect("a review").lease.id;
        let again = open(site.eve, first).expect("the same").lease.id;
        assert_eq!(again, lease);
        let held = &site.row(first).holders;
        assert_eq!((held.len(), held[0].lease), (1, lease));
        let by = (held[0].name.as_str(), held[0].purpose.as_str());
        assert_eq!(by, ("eve", "review"));
        for (user, task, code) in [
            (rev, first, Code::LeaseLost),
            (site.eve, second, Code::OwnWork),
            (rev, third, Code::WrongState),
            (rev, i64::MAX, Code::NotFound),
        ] {
            assert_eq!(refusal(open(user, task)), code);
        }
        open(rev, second).expect("a review");
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
