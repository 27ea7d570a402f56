//! What a project of tens of thousands of tasks needs: rules of acceptance, the task browser, bulk actions, what
//! people handed in.

use std::collections::BTreeSet;
use std::sync::Arc;

use annotate::store::{DecisionQuery, MineQuery, NewTask, PageQuery, Store, Who};
use annotate::transfer::export;
use annotate::wire::{
    Answer, BulkAction, BulkRequest, Code, Decision, EventKind, ExportFormat, ExportRequest,
    MyAnswer, ReviewQueue, Role, Rule, RuleKind, Settings, SkipFilter, SkipReason, Standing,
    TaskFilter, TaskKind, TaskSort, TaskState, Verdict,
};

use crate::store::{Fixture, fixture, mask_tasks, on_each, problem};
use crate::support::{MINUTE, START, all_keys, bare_task, event, masks, pair};

/// The admin of every fixture.
const ROOT: i64 = 1;

pub(crate) fn rule(name: &str, accepts: RuleKind) -> Rule {
    Rule {
        name: name.to_owned(),
        enabled: true,
        accepts,
        kinds: Vec::new(),
        people: Vec::new(),
        min_answers: 1,
        max_distance: 0.0,
        review_percent: 0,
    }
}

fn set(store: &Store, change: impl FnOnce(&mut Settings)) {
    let mut settings = store.settings().expect("settings");
    change(&mut settings);
    store.put_settings(ROOT, settings, START).expect("settings");
}

fn pair_tasks(count: usize) -> Vec<NewTask> {
    (0..count)
        .map(|number| bare_task(number, TaskKind::Pair))
        .collect()
}

impl Fixture {
    /// Claims the next task of an answer's kind, submits the answer, and returns the task.
    fn hand_in(&self, user: i64, answer: Answer, now: i64) -> i64 {
        let task = self.claim_kind(user, answer.kind(), now).expect("a task");
        self.submit(user, task, 0, answer, now);
        task
    }

    fn basis(&self, task: i64) -> Option<String> {
        self.store.task_row(task).expect("a task").0.accepted_by
    }

    fn mine(&self, user: i64, now: i64) -> Vec<MyAnswer> {
        let query = MineQuery {
            limit: 50,
            ..MineQuery::default()
        };
        self.store.answers_of(user, query, now).expect("answers").0
    }

    fn found(&self, filter: TaskFilter) -> Vec<i64> {
        let page = self
            .store
            .browse(PageQuery {
                filter,
                limit: 200,
                ..PageQuery::default()
            })
            .expect("a page");
        assert_eq!(page.total, Some(page.rows.len() as i64));
        page.rows.iter().map(|row| row.id).collect()
    }

    fn accepted_keys(&self) -> BTreeSet<String> {
        let all = self.store.accepted(&all_keys()).expect("answers");
        all.into_iter().map(|answer| answer.task.key).collect()
    }
}

#[test]
fn unanimous_rejects_are_accepted_as_they_arrive_and_the_log_names_the_rule() {
    on_each("rejects", |store| {
        let site = fixture(store, pair_tasks(3));
        set(&site.store, |settings| {
            settings.rules = vec![rule("rejects", RuleKind::Rejects)];
        });
        let rejected = site.hand_in(site.ann, pair(Verdict::Unnatural), START);
        assert_eq!(site.state(rejected), TaskState::Accepted);
        assert_eq!(site.basis(rejected).as_deref(), Some("rule:rejects"));
        let kept = site.hand_in(site.ann, pair(Verdict::Keep), START);
        assert_eq!(site.state(kept), TaskState::Submitted);
        let log = site.store.log(0, 1000).expect("the log");
        let accepted: Vec<_> = log
            .iter()
            .filter(|entry| entry.kind == "accepted")
            .collect();
        assert_eq!(accepted.len(), 1);
        assert_eq!(accepted[0].body["rule"], "rejects");
        assert_eq!(accepted[0].actor, None);
        site.whole();
    });
}

#[test]
fn answers_that_differ_wait_for_a_reviewer() {
    on_each("differ", |store| {
        let site = fixture(store, Vec::new());
        set(&site.store, |settings| {
            settings.answers_per_task = 2;
            settings.rules = vec![Rule {
                min_answers: 2,
                ..rule("agreed", RuleKind::Sampled)
            }];
        });
        site.store
            .import(None, pair_tasks(3), START)
            .expect("tasks");
        let second = |ours: Verdict, theirs: Verdict| {
            let task = site.hand_in(site.ann, pair(ours), START);
            assert_eq!(
                site.state(task),
                TaskState::Open,
                "one answer is not enough"
            );
            assert_eq!(site.hand_in(site.bob, pair(theirs), START), task);
            site.state(task)
        };
        let equal = second(Verdict::Unclear, Verdict::Unclear);
        let other = second(Verdict::Unclear, Verdict::Unnatural);
        assert_eq!((equal, other), (TaskState::Accepted, TaskState::Submitted));
        site.whole();
    });
}

#[test]
fn answers_of_trusted_people_need_no_reviewer() {
    on_each("trusted", |store| {
        let site = fixture(store, mask_tasks(4));
        set(&site.store, |settings| {
            settings.rules = vec![Rule {
                people: vec![site.bob],
                ..rule("trusted", RuleKind::Trusted)
            }];
        });
        let hers = site.hand_in(site.ann, masks("waving"), START);
        let his = site.hand_in(site.bob, masks("waving"), START);
        assert_eq!(site.state(hers), TaskState::Submitted);
        assert_eq!(site.state(his), TaskState::Accepted);
        site.whole();
    });
}

/// Tasks left to reviewers, by key.
fn left_to_review(store: Arc<Store>, seed: u32) -> BTreeSet<String> {
    let site = fixture(store, mask_tasks(60));
    set(&site.store, |settings| {
        settings.seed = seed;
        settings.rules = vec![Rule {
            review_percent: 20,
            ..rule("sample", RuleKind::Sampled)
        }];
    });
    for _ in 0..60 {
        site.hand_in(site.ann, masks("waving"), START);
    }
    let waiting = site.found(TaskFilter {
        state: Some(TaskState::Submitted),
        ..TaskFilter::default()
    });
    let accepted = site.found(TaskFilter {
        rule: Some("sample".to_owned()),
        ..TaskFilter::default()
    });
    assert_eq!(
        waiting.len() + accepted.len(),
        60,
        "accepted or left to a reviewer"
    );
    site.whole();
    let keys = |id: &i64| site.store.task_record(*id).expect("a task").key;
    waiting.iter().map(keys).collect()
}

#[test]
fn the_share_left_to_reviewers_depends_on_seed_and_task_alone() {
    on_each("sample", |store| {
        let folder = tempfile::tempdir().expect("a folder");
        let fresh =
            |name: &str| annotate::store::open_sqlite(&folder.path().join(name)).expect("a store");
        let first = left_to_review(store, 7);
        assert!((4..=22).contains(&first.len()), "{}", first.len());
        assert_eq!(left_to_review(fresh("again"), 7), first);
        assert_ne!(left_to_review(fresh("other"), 42), first);
    });
}

#[test]
fn rules_are_applied_on_demand_over_what_waits_as_their_preview_says() {
    on_each("demand", |store| {
        let site = fixture(store, pair_tasks(12));
        for number in 0..12 {
            let verdict = if number % 3 == 0 {
                Verdict::Keep
            } else {
                Verdict::Unclear
            };
            site.hand_in(site.ann, pair(verdict), START);
        }
        set(&site.store, |settings| {
            settings.rules = vec![rule("rejects", RuleKind::Rejects)];
        });
        let before = site.store.rules().expect("rules");
        assert_eq!((before[0].accepted, before[0].would_accept), (0, 8));
        let done = site.store.apply_rules(0, START).expect("applies");
        assert_eq!((done.looked_at, done.accepted["rejects"]), (12, 8));
        assert_eq!(done.next, None);
        let after = site.store.rules().expect("rules");
        assert_eq!((after[0].accepted, after[0].would_accept), (8, 0));
        assert_eq!(site.store.accepted(&all_keys()).expect("answers").len(), 8);
        site.whole();
    });
}

#[test]
fn undoing_a_rule_takes_its_acceptances_back_together_and_review_and_export_follow() {
    on_each("undo_rule", |store| {
        let site = fixture(store, pair_tasks(6));
        set(&site.store, |settings| {
            settings.rules = vec![rule("rejects", RuleKind::Rejects)];
        });
        for _ in 0..5 {
            site.hand_in(site.ann, pair(Verdict::Unclear), START);
        }
        let kept = site.hand_in(site.ann, pair(Verdict::Keep), START);
        let (task, epoch) = site.review(START);
        assert_eq!(task, kept);
        assert_eq!(
            site.decide(task, epoch, Decision::Accept, START),
            Ok(TaskState::Accepted)
        );
        assert_eq!(site.accepted_keys().len(), 6);
        let undone = site
            .store
            .undo_rule(ROOT, "rejects", START)
            .expect("undoes");
        assert_eq!((undone.reopened, undone.left), (5, 0));
        assert_eq!(
            site.accepted_keys().len(),
            1,
            "what a person accepted stays"
        );
        let settings = site.store.settings().expect("settings");
        assert!(!settings.rules[0].enabled, "the next answer waits again");
        let (task, epoch) = site.review(START);
        assert_eq!(site.state(task), TaskState::InReview);
        assert_eq!(
            site.decide(task, epoch, Decision::Accept, START),
            Ok(TaskState::Accepted)
        );
        set(&site.store, |settings| settings.rules[0].enabled = true);
        let again = site.store.apply_rules(0, START).expect("applies");
        assert_eq!(again.accepted["rejects"], 4);
        let unknown = site.store.undo_rule(ROOT, "nothing", START);
        assert_eq!(
            unknown.expect_err("no such rule").problem().code,
            Code::NotFound
        );
        site.whole();
    });
}

#[test]
fn a_rule_leaves_alone_what_a_reviewer_sent_back_or_reopened() {
    on_each("touched", |store| {
        let site = fixture(store, pair_tasks(2));
        let returned = site.hand_in(site.ann, pair(Verdict::Unclear), START);
        let (task, epoch) = site.review(START);
        assert_eq!(task, returned);
        assert_eq!(
            site.decide(task, epoch, Decision::Return, START),
            Ok(TaskState::Returned)
        );
        set(&site.store, |settings| {
            settings.rules = vec![rule("rejects", RuleKind::Rejects)];
        });
        let task = site
            .claim_kind(site.ann, TaskKind::Pair, START)
            .expect("back");
        assert_eq!(task, returned);
        site.submit(site.ann, task, 1, pair(Verdict::Unclear), START);
        assert_eq!(site.state(returned), TaskState::Submitted);
        let reopened = site.hand_in(site.ann, pair(Verdict::Unclear), START);
        assert_eq!(site.state(reopened), TaskState::Accepted);
        assert_eq!(
            site.decide(reopened, 0, Decision::Reopen, START),
            Ok(TaskState::Submitted)
        );
        let done = site.store.apply_rules(0, START).expect("applies");
        assert!(done.accepted.is_empty(), "{done:?}");
        site.whole();
    });
}

#[test]
fn an_author_may_take_back_what_a_rule_accepted_for_a_while() {
    on_each("take_back", |store| {
        let site = fixture(store, pair_tasks(2));
        set(&site.store, |settings| {
            settings.take_back_minutes = 10;
            settings.rules = vec![rule("rejects", RuleKind::Rejects)];
        });
        let task = site.hand_in(site.ann, pair(Verdict::Unclear), START);
        let own = &site.mine(site.ann, START + MINUTE)[0];
        assert_eq!(
            (own.standing, own.can_take_back),
            (Standing::Accepted, true)
        );
        let undo = event(EventKind::Undo, 0, 1, None);
        let undone = site.send(site.ann, task, undo, START + MINUTE);
        assert_eq!(
            (undone.status, undone.state),
            (200, Some(TaskState::Leased))
        );
        assert!(site.accepted_keys().is_empty());
        let epoch = undone.lease.expect("a lease again").epoch;
        let sent = event(EventKind::Submit, epoch, 2, Some(pair(Verdict::Unnatural)));
        let later = START + 2 * MINUTE;
        assert_eq!(site.send(site.ann, task, sent, later).status, 200);
        assert_eq!(site.state(task), TaskState::Accepted);
        let late = later + 11 * MINUTE;
        assert!(!site.mine(site.ann, late)[0].can_take_back);
        let refused = site.send(site.ann, task, event(EventKind::Undo, 0, 3, None), late);
        assert_eq!(problem(&refused), Code::WrongState);
        site.whole();
    });
}

#[test]
fn rules_are_checked_before_they_are_kept() {
    on_each("checked", |store| {
        let site = fixture(store, Vec::new());
        let good = rule("agreed", RuleKind::Sampled);
        let broken = [
            Rule {
                name: "no spaces".to_owned(),
                ..good.clone()
            },
            Rule {
                review_percent: 101,
                ..good.clone()
            },
            Rule {
                max_distance: f64::NAN,
                ..good.clone()
            },
            Rule {
                people: vec![1],
                ..good.clone()
            },
            rule("trusted", RuleKind::Trusted),
        ];
        let mut all: Vec<Vec<Rule>> = broken.into_iter().map(|rule| vec![rule]).collect();
        all.push(vec![good.clone(), good]);
        for rules in all {
            let settings = Settings {
                rules,
                ..site.store.settings().expect("settings")
            };
            let refused = site.store.put_settings(ROOT, settings, START);
            assert_eq!(refused.expect_err("refused").problem().code, Code::Invalid);
        }
    });
}

#[test]
fn a_search_finds_texts_and_captions_but_no_names_of_fields() {
    on_each("search", |store| {
        let site = fixture(store, mask_tasks(4));
        let waving = site.hand_in(site.ann, masks("Waving_50%"), START);
        let masked = site.hand_in(site.ann, masks("putting on a mask"), START);
        let searched = |text: &str| {
            site.found(TaskFilter {
                q: Some(text.to_owned()),
                ..TaskFilter::default()
            })
        };
        assert_eq!(searched("mask"), [masked]);
        assert_eq!(searched("wavinG_50%"), [waving]);
        assert_eq!(searched("wavinGx50%"), Vec::<i64>::new());
        assert_eq!(searched("left_arm"), Vec::<i64>::new(), "a part is no text");
        assert_eq!(searched("soft"), Vec::<i64>::new());
        let (shelf, epoch) = site.review(START);
        let shelved = |text: &str| {
            let filter = annotate::store::ShelfFilter {
                text: Some(text.to_owned()),
                limit: 10,
                ..Default::default()
            };
            site.store.shelf(site.bob, filter).expect("a shelf").len()
        };
        assert_eq!(
            site.decide(shelf, epoch, Decision::Accept, START),
            Ok(TaskState::Accepted)
        );
        assert_eq!((shelved("kind"), shelved("waving")), (0, 1));
        site.whole();
    });
}

#[test]
fn the_browser_filters_by_everything_a_reviewer_asks_for() {
    on_each("filters", |store| {
        let mut tasks = mask_tasks(3);
        tasks.extend((10..14).map(|number| NewTask {
            category: Some(if number % 2 == 0 { "walk" } else { "run" }.to_owned()),
            ..bare_task(number, TaskKind::Pair)
        }));
        let site = fixture(store, tasks);
        let mask = site.hand_in(site.ann, masks("waving"), START);
        let keep = site.hand_in(site.ann, pair(Verdict::Keep), START);
        let reject = site.hand_in(site.bob, pair(Verdict::Unclear), START + 1);
        let held = site
            .claim_kind(site.bob, TaskKind::Pair, START)
            .expect("a task");
        let none = TaskFilter::default;
        let check = |filter: TaskFilter, expected: &[i64]| {
            assert_eq!(site.found(filter.clone()), expected, "{filter:?}");
        };
        check(
            TaskFilter {
                kind: Some(TaskKind::MaskText),
                state: Some(TaskState::Submitted),
                ..none()
            },
            &[mask],
        );
        check(
            TaskFilter {
                person: Some(site.ann),
                ..none()
            },
            &[mask, keep],
        );
        check(
            TaskFilter {
                person: Some(site.bob),
                ..none()
            },
            &[reject, held],
        );
        check(
            TaskFilter {
                part: Some("RIGHT_ARM".to_owned()),
                ..none()
            },
            &[keep],
        );
        check(
            TaskFilter {
                edit_type: Some(annotate::wire::EditType::Amplitude),
                ..none()
            },
            &[keep],
        );
        check(
            TaskFilter {
                verdict: Some(Verdict::Unclear),
                ..none()
            },
            &[reject],
        );
        check(
            TaskFilter {
                category: Some("walk".to_owned()),
                verdict: Some(Verdict::Keep),
                ..none()
            },
            &[keep],
        );
        check(
            TaskFilter {
                min_distance: Some(0.0),
                ..none()
            },
            &[],
        );
        check(
            TaskFilter {
                task: Some(held),
                ..none()
            },
            &[held],
        );
        let row = site.store.task_row(held).expect("a task").0;
        assert_eq!(row.holders.len(), 1);
        assert_eq!(row.holders[0].name, "bob");
        assert_eq!(row.holders[0].until, START + 15 * MINUTE);
        let refused = site.store.browse(PageQuery {
            filter: TaskFilter {
                part: Some("TAIL".to_owned()),
                ..none()
            },
            limit: 10,
            ..PageQuery::default()
        });
        assert_eq!(refused.expect_err("no part").problem().code, Code::Invalid);
    });
}

#[test]
fn pages_in_every_order_hold_every_task_once() {
    on_each("pages", |store| {
        let site = fixture(store, Vec::new());
        set(&site.store, |settings| settings.answers_per_task = 2);
        site.store
            .import(None, pair_tasks(25), START)
            .expect("tasks");
        for number in 0..10 {
            let (ours, theirs) = (
                pair(Verdict::Unclear),
                pair([Verdict::Unclear, Verdict::Keep][number % 2]),
            );
            site.hand_in(site.ann, ours, START + number as i64);
            site.hand_in(site.bob, theirs, START + number as i64);
        }
        for sort in [TaskSort::Id, TaskSort::Distance, TaskSort::Touched] {
            for reverse in [false, true] {
                let mut after = None;
                let mut seen = Vec::new();
                loop {
                    let page = site
                        .store
                        .browse(PageQuery {
                            sort: Some(sort),
                            reverse,
                            after: after.clone(),
                            limit: 4,
                            ..PageQuery::default()
                        })
                        .expect("a page");
                    assert_eq!(page.total, after.is_none().then_some(25));
                    seen.extend(page.rows);
                    after = page.next;
                    if after.is_none() {
                        break;
                    }
                }
                let ids: BTreeSet<i64> = seen.iter().map(|row| row.id).collect();
                assert_eq!((ids.len(), seen.len()), (25, 25), "{sort} {reverse}");
                let ordered = seen.is_sorted_by(|a, b| match (sort, reverse) {
                    (TaskSort::Id, false) => a.id < b.id,
                    (TaskSort::Id, true) => a.id > b.id,
                    (TaskSort::Distance, false) => {
                        a.distance.unwrap_or(-1.0) >= b.distance.unwrap_or(-1.0)
                    }
                    (TaskSort::Distance, true) => {
                        a.distance.unwrap_or(-1.0) <= b.distance.unwrap_or(-1.0)
                    }
                    (TaskSort::Touched, false) => a.touched >= b.touched,
                    (TaskSort::Touched, true) => a.touched <= b.touched,
                });
                assert!(ordered, "{sort} {reverse}");
            }
        }
        let bad = site.store.browse(PageQuery {
            after: Some("nothing".to_owned()),
            limit: 4,
            ..PageQuery::default()
        });
        assert_eq!(bad.expect_err("no cursor").problem().code, Code::Invalid);
    });
}

#[test]
fn tasks_that_everybody_skipped_are_listed_with_the_reasons() {
    on_each("skipped", |store| {
        let site = fixture(store, mask_tasks(3));
        let skipped = |filter| {
            site.found(TaskFilter {
                skipped: Some(filter),
                ..TaskFilter::default()
            })
        };
        let annotators_may_log_in = |active| {
            for user in [site.ann, site.bob] {
                site.store
                    .change_user(Some(ROOT), user, None, Some(active), START)
                    .expect("a change");
            }
        };
        let (first, second) = (site.skip(site.ann, START), site.skip(site.ann, START));
        assert_eq!(skipped(SkipFilter::Any), [first, second]);
        assert_eq!(skipped(SkipFilter::Everybody), Vec::<i64>::new());
        // Eve only reviews.
        assert_eq!(site.skip(site.bob, START), first);
        assert_eq!(skipped(SkipFilter::Everybody), [first]);
        let row = site.store.task_row(first).expect("a task").0;
        let skips: Vec<_> = row
            .skips
            .iter()
            .map(|skip| (skip.name.as_str(), skip.reason, skip.note.as_str()))
            .collect();
        let why = Some(SkipReason::CannotTell);
        assert_eq!(skips, [("ann", why, "too dark"), ("bob", why, "too dark")]);
        // It has its answer.
        assert_eq!(site.answer(site.bob, "seen", START), second);
        assert_eq!(skipped(SkipFilter::Any), [first, second]);
        assert_eq!(skipped(SkipFilter::Everybody), [first]);
        // Where nobody annotates, everybody counts: eve and the admin are left.
        annotators_may_log_in(false);
        assert_eq!(skipped(SkipFilter::Everybody), Vec::<i64>::new());
        annotators_may_log_in(true);
        assert_eq!(
            site.decide(first, 0, Decision::Drop, START),
            Ok(TaskState::Dropped)
        );
        assert_eq!(skipped(SkipFilter::Everybody), Vec::<i64>::new());
        site.whole();
    });
}

#[test]
fn a_task_is_opened_for_review_from_its_record_by_one_reviewer_who_did_not_answer_it() {
    on_each("opened", |store| {
        let site = fixture(store, mask_tasks(3));
        let rev = site
            .store
            .add_user(None, "rev", Role::Reviewer, START)
            .expect("a user")
            .id;
        let open = |user: i64, task: i64| {
            let opened = site.store.review_task(user, task, START);
            opened
                .map(|review| review.lease)
                .map_err(|error| error.problem().code)
        };
        let first = site.answer(site.ann, "waving", START);
        let second = site.answer(site.eve.id, "bowing", START);
        let third = site.found(TaskFilter::default())[2];
        let lease = open(site.eve.id, first).expect("a lease");
        assert_eq!(open(site.eve.id, first).expect("the same").id, lease.id);
        let row = site.store.task_row(first).expect("a task").0;
        let held: Vec<_> = row
            .holders
            .iter()
            .map(|holder| (holder.lease, holder.name.as_str(), holder.purpose.as_str()))
            .collect();
        assert_eq!(held, [(lease.id, "eve", "review")]);
        assert_eq!(open(rev, first), Err(Code::LeaseLost));
        assert_eq!(open(site.eve.id, second), Err(Code::OwnWork));
        assert_eq!(open(rev, third), Err(Code::WrongState));
        assert_eq!(open(rev, i64::MAX), Err(Code::NotFound));
        assert!(open(rev, second).is_ok());
        site.whole();
    });
}

fn request(action: BulkAction, filter: TaskFilter) -> BulkRequest {
    BulkRequest {
        filter,
        action,
        comment: "all of them".to_owned(),
        person: None,
        after: None,
    }
}

#[test]
fn a_bulk_action_does_what_its_preview_counted() {
    on_each("bulk", |store| {
        let site = fixture(store, pair_tasks(8));
        for _ in 0..5 {
            site.hand_in(site.ann, pair(Verdict::Unclear), START);
        }
        let own = site.hand_in(site.eve.id, pair(Verdict::Unclear), START);
        let all = TaskFilter::default;
        let accept = request(BulkAction::Accept, all());
        let before = site.store.last_seq().expect("a place");
        let preview = site
            .store
            .preview_bulk(&site.eve, accept.clone(), START)
            .expect("counts");
        assert_eq!((preview.looked_at, preview.done), (8, 5));
        assert_eq!(preview.left_alone["own_work"], 1);
        assert_eq!(preview.left_alone["wrong_state"], 2);
        assert_eq!(site.store.last_seq().expect("a place"), before);
        let done = site.store.bulk(&site.eve, accept, START).expect("acts");
        assert_eq!(done, preview);
        assert_eq!(site.accepted_keys().len(), 5);
        assert_eq!(site.state(own), TaskState::Submitted);
        let reopened = site
            .store
            .bulk(
                &site.eve,
                request(
                    BulkAction::Reopen,
                    TaskFilter {
                        state: Some(TaskState::Accepted),
                        ..all()
                    },
                ),
                START,
            )
            .expect("acts");
        assert_eq!((reopened.done, site.accepted_keys().len()), (5, 0));
        let returned = site
            .store
            .bulk(
                &site.eve,
                request(
                    BulkAction::Return,
                    TaskFilter {
                        person: Some(site.ann),
                        ..all()
                    },
                ),
                START,
            )
            .expect("acts");
        assert_eq!(returned.done, 5);
        let home = site.store.home(site.ann, START).expect("home");
        assert_eq!(home.returned.len(), 5);
        let dropped = site
            .store
            .bulk(&site.eve, request(BulkAction::Drop, all()), START)
            .expect("acts");
        assert_eq!((dropped.done, dropped.left_alone["own_work"]), (7, 1));
        let silent = BulkRequest {
            comment: " ".to_owned(),
            ..request(BulkAction::Drop, all())
        };
        let counted = site
            .store
            .preview_bulk(&site.eve, silent.clone(), START)
            .expect("a preview needs no comment");
        assert_eq!(counted.looked_at, 8);
        let refused = site.store.bulk(&site.eve, silent, START);
        assert_eq!(
            refused.expect_err("no comment").problem().code,
            Code::Invalid
        );
        site.whole();
    });
}

#[test]
fn an_assigned_task_goes_to_its_person_first() {
    on_each("assign", |store| {
        let site = fixture(store, mask_tasks(5));
        let others = site.claim(site.ann, START).expect("a task");
        let last = site.found(TaskFilter::default())[4];
        let assign = BulkRequest {
            person: Some(site.bob),
            after: Some(last - 1),
            ..request(BulkAction::Assign, TaskFilter::default())
        };
        let done = site.store.bulk(&site.eve, assign, START).expect("acts");
        assert_eq!(done.done, 1);
        assert_eq!(site.state(last), TaskState::Leased);
        assert_eq!(site.claim(site.bob, START), Some(last));
        let held = BulkRequest {
            person: Some(site.bob),
            ..request(BulkAction::Assign, TaskFilter::default())
        };
        let preview = site
            .store
            .preview_bulk(&site.eve, held, START)
            .expect("counts");
        assert_eq!(preview.done, 3);
        assert_eq!(preview.left_alone["task_full"], 1, "task {others}");
        assert_eq!(preview.left_alone["held"], 1);
        let nobody = BulkRequest {
            person: Some(999),
            ..request(BulkAction::Assign, TaskFilter::default())
        };
        let refused = site.store.bulk(&site.eve, nobody, START);
        assert_eq!(refused.expect_err("nobody").problem().code, Code::Invalid);
        site.whole();
    });
}

#[test]
fn a_reservation_that_nobody_takes_up_ends() {
    on_each("assigned_reserved", |store| {
        let site = fixture(store, mask_tasks(1));
        let assign = BulkRequest {
            person: Some(site.bob),
            ..request(BulkAction::Assign, TaskFilter::default())
        };
        site.store.bulk(&site.eve, assign, START).expect("acts");
        assert_eq!(site.claim(site.ann, START), None);
        let weeks_later = START + 8 * 24 * 60 * MINUTE;
        assert!(site.claim(site.ann, weeks_later).is_some());
        site.whole();
    });
}

#[test]
fn my_answers_say_where_each_stands() {
    on_each("own_answers", |store| {
        let site = fixture(store, mask_tasks(4));
        let tasks: Vec<i64> = (0..4)
            .map(|number| site.hand_in(site.ann, masks(&format!("n{number}")), START + number))
            .collect();
        let review = |decision: Decision| {
            let (task, epoch) = site.review(START + 10);
            site.decide(task, epoch, decision, START + 10)
                .expect("decides");
            task
        };
        let returned = review(Decision::Return);
        let merged = review(Decision::Merge);
        let accepted = review(Decision::Accept);
        let waiting = *tasks.last().expect("tasks");
        let standing = |task: i64| {
            let all = site.mine(site.ann, START + 20);
            all.into_iter()
                .find(|own| own.mine.task == task)
                .expect("my answer")
        };
        assert_eq!(standing(waiting).standing, Standing::WaitsForReview);
        assert!(standing(waiting).can_take_back);
        assert_eq!(standing(accepted).standing, Standing::Accepted);
        assert!(!standing(accepted).can_take_back);
        let back = standing(returned);
        assert_eq!(
            (back.standing, back.comment.as_deref()),
            (Standing::Returned, Some("because"))
        );
        assert_eq!(back.until, Some(START + 10 + 7 * 24 * 60 * MINUTE));
        let other = standing(merged);
        assert_eq!(other.standing, Standing::Superseded);
        assert_eq!(other.accepted, Some(masks("merged")));
        let (some, next) = site
            .store
            .answers_of(
                site.ann,
                MineQuery {
                    limit: 2,
                    ..MineQuery::default()
                },
                START,
            )
            .expect("answers");
        assert_eq!((some[0].mine.task, some.len()), (waiting, 2));
        let (rest, end) = site
            .store
            .answers_of(
                site.ann,
                MineQuery {
                    before: next,
                    limit: 10,
                    ..MineQuery::default()
                },
                START,
            )
            .expect("answers");
        assert_eq!((rest.len(), end), (2, None));
        let returned_only = MineQuery {
            standing: Some(Standing::Returned),
            limit: 1,
            ..MineQuery::default()
        };
        let (found, _) = site
            .store
            .answers_of(site.ann, returned_only, START)
            .expect("answers");
        assert_eq!(found[0].mine.task, returned);
        let sent_back = site
            .store
            .decisions(DecisionQuery {
                reviewer: Some(site.eve.id),
                decision: Some("returned".to_owned()),
                limit: 10,
                ..DecisionQuery::default()
            })
            .expect("decisions");
        assert_eq!(sent_back.items.len(), 1);
        assert_eq!(sent_back.items[0].authors, ["ann"]);
        assert_eq!(sent_back.items[0].state, TaskState::Returned);
    });
}

#[test]
fn an_answer_that_waits_for_a_second_person_says_so() {
    on_each("second", |store| {
        let site = fixture(store, Vec::new());
        set(&site.store, |settings| settings.answers_per_task = 2);
        site.store
            .import(None, mask_tasks(1), START)
            .expect("a task");
        let task = site.hand_in(site.ann, masks("waving"), START);
        let own = site.mine(site.ann, START).remove(0);
        assert_eq!(
            (own.standing, own.can_take_back),
            (Standing::WaitsForOthers, true)
        );
        assert_eq!((own.task.wanted, own.task.submitted), (2, 1));
        assert_eq!(site.hand_in(site.bob, masks("waving"), START), task);
        let own = site.mine(site.ann, START).remove(0);
        assert_eq!(own.standing, Standing::WaitsForReview);
    });
}

#[test]
fn one_researcher_may_accept_their_own_work_and_it_is_marked() {
    on_each("solo", |store| {
        let site = fixture(store, mask_tasks(2));
        let solo = Who {
            id: site.ann,
            name: "ann".to_owned(),
            role: Role::Admin,
        };
        let task = site.hand_in(solo.id, masks("waving"), START);
        let queue = |site: &Fixture| {
            site.store
                .review_next(solo.id, ReviewQueue::Disagreement, None, START)
                .expect("claims")
        };
        assert!(queue(&site).is_err());
        set(&site.store, |settings| settings.solo = true);
        let Ok(detail) = queue(&site) else {
            panic!("my own answer waits");
        };
        assert_eq!(detail.task.id, task);
        let done = site
            .store
            .review(
                solo.id,
                annotate::wire::NewReview {
                    idem_key: crate::support::key(),
                    task,
                    lease_epoch: detail.lease.epoch,
                    decision: Decision::Accept,
                    author: None,
                    answer: None,
                    comment: String::new(),
                    secs: 0.0,
                },
                START,
            )
            .expect("accepts");
        assert_eq!(done.state, TaskState::Accepted);
        assert_eq!(site.basis(task).as_deref(), Some("own"));
        let folder = tempfile::tempdir().expect("a folder");
        for format in [
            ExportFormat::Csv,
            ExportFormat::Parquet,
            ExportFormat::Stance,
        ] {
            let selection = ExportRequest {
                format,
                splits: Vec::new(),
                events: false,
            };
            let path = folder.path();
            let done = export(&site.store, path, path, &selection, "test").expect("exports");
            assert_eq!(done.counts["accepted_by own"], 1, "{format}");
            assert!(
                done.messages
                    .iter()
                    .any(|text| text.contains("own authors"))
            );
        }
        let csv = std::fs::read_to_string(folder.path().join("labels.csv")).expect("a file");
        assert!(csv.lines().any(|line| line.contains(",own,")), "{csv}");
        site.whole();
    });
}

#[test]
fn a_changed_number_of_people_applies_to_open_tasks() {
    on_each("retarget", |store| {
        let site = fixture(store, mask_tasks(3));
        let done = site.hand_in(site.ann, masks("waving"), START);
        let wanted = |site: &Fixture| -> Vec<u32> {
            (1..=3)
                .map(|id| site.store.task_record(id).expect("a task").wanted)
                .collect()
        };
        assert_eq!(wanted(&site), [1, 1, 1]);
        set(&site.store, |settings| settings.answers_per_task = 2);
        assert_eq!(
            wanted(&site),
            [1, 2, 2],
            "task {done} has all its answers already"
        );
        let half = site.hand_in(site.ann, masks("waving"), START);
        assert_eq!(site.state(half), TaskState::Open);
        let before = site.store.last_seq().expect("a place");
        set(&site.store, |settings| settings.min_masks = 1);
        assert_eq!(
            site.store.last_seq().expect("a place"),
            before + 1,
            "other settings change no task"
        );
        set(&site.store, |settings| settings.answers_per_task = 1);
        assert_eq!(wanted(&site), [1, 1, 1]);
        assert_eq!(site.state(half), TaskState::Submitted);
        site.whole();
    });
}

#[test]
fn a_new_annotator_practises_until_the_score_is_reached() {
    on_each("practice", |store| {
        let site = fixture(store, pair_tasks(4));
        let known = site.hand_in(site.bob, pair(Verdict::Unclear), START);
        let (task, epoch) = site.review(START);
        assert_eq!(
            site.decide(task, epoch, Decision::Accept, START),
            Ok(TaskState::Accepted)
        );
        let practice = site
            .store
            .make_practice(ROOT, known, START)
            .expect("a practice task");
        assert!(
            site.store.make_practice(ROOT, known, START).is_err(),
            "once"
        );
        set(&site.store, |settings| {
            settings.practice_tasks = 5;
            settings.practice_percent = 90;
        });
        let standing = |user: i64| {
            let all = site.store.practice(user).expect("practice");
            all.into_iter()
                .find(|practice| practice.kind == TaskKind::Pair)
                .expect("pairs")
        };
        assert_eq!(standing(site.ann).needed, 1, "as many as there are");
        assert!(!standing(site.ann).passed);
        let try_it = |verdict: Verdict, rev: i64, now: i64| {
            let task = site
                .claim_kind(site.ann, TaskKind::Pair, now)
                .expect("a task");
            assert_eq!(task, practice, "practice comes before real work");
            let sent = event(
                EventKind::Submit,
                site.epoch(site.ann, task),
                rev,
                Some(pair(verdict)),
            );
            let result = site.send(site.ann, task, sent.clone(), now);
            assert_eq!(site.send(site.ann, task, sent, now), result, "asked again");
            result.feedback.expect("feedback")
        };
        let home = |user: i64| {
            let home = site.store.home(user, START).expect("home");
            let queue = home
                .queues
                .into_iter()
                .find(|queue| queue.kind == TaskKind::Pair);
            (queue.expect("pairs"), home.today)
        };
        let own = || site.mine(site.ann, START + 1).remove(0);
        assert_eq!(home(site.ann).0.open, 1, "practice, and no real work yet");
        let wrong = try_it(Verdict::Keep, 0, START);
        assert_eq!((wrong.score, &wrong.known), (0.0, &pair(Verdict::Unclear)));
        assert_eq!(own().standing, Standing::Practice);
        assert_eq!(own().feedback, Some(wrong));
        assert_eq!(home(site.ann).0.open, 1, "it is given again");
        // She tries it again herself; the known answer is not shown beside a draft.
        let undone = site.send(
            site.ann,
            practice,
            event(EventKind::Undo, 0, 1, None),
            START,
        );
        assert_eq!(undone.status, 200);
        assert_eq!((own().standing, own().feedback), (Standing::Draft, None));
        assert_eq!(home(site.ann).0.held, 0, "others do not wait for practice");
        assert_eq!(standing(site.ann).done, 0);
        let right = try_it(Verdict::Unclear, 2, START + 1);
        assert_eq!(right.score, 1.0);
        assert!(standing(site.ann).passed);
        assert!(standing(site.eve.id).passed, "reviewers need no practice");
        let (queue, today) = home(site.ann);
        assert_eq!(
            (queue.mine, today, queue.open),
            (0, 0, 3),
            "practice is no answer"
        );
        let query = MineQuery {
            task: Some(practice),
            limit: 5,
            ..MineQuery::default()
        };
        let found = site
            .store
            .answers_of(site.ann, query, START)
            .expect("answers")
            .0;
        assert_eq!(found.len(), 1);
        assert_eq!(
            found[0].feedback.as_ref().map(|found| found.score),
            Some(1.0)
        );
        let real = site
            .claim_kind(site.ann, TaskKind::Pair, START)
            .expect("work");
        assert_ne!(real, practice);
        assert_ne!(
            site.claim_kind(site.eve.id, TaskKind::Pair, START),
            Some(practice),
            "reviewers need no practice"
        );
        let people = site.store.people().expect("people");
        assert!(people.iter().all(|person| person.gold_items == 0));
        assert_eq!(
            site.found(TaskFilter::default()).len(),
            4,
            "no practice task"
        );
        site.whole();
    });
}

#[test]
fn hours_and_answers_are_counted_by_person_and_day() {
    on_each("days", |store| {
        const DAY: i64 = 24 * 60 * MINUTE;
        let site = fixture(store, mask_tasks(6));
        let midnight = START.div_euclid(DAY) * DAY;
        let evening = midnight + 23 * 60 * MINUTE;
        site.hand_in(site.ann, masks("one"), evening);
        site.hand_in(site.ann, masks("two"), evening);
        site.hand_in(site.ann, masks("three"), evening + 2 * 60 * MINUTE);
        let (task, epoch) = site.review(evening);
        site.decide(task, epoch, Decision::Accept, evening)
            .expect("accepts");
        let days = || site.store.work(midnight, midnight + 2 * DAY).expect("days");
        let utc: Vec<(i64, i64, f64)> = days()
            .iter()
            .filter(|day| day.user == site.ann)
            .map(|day| (day.start, day.answers, day.secs))
            .collect();
        assert_eq!(utc, [(midnight, 2, 25.0), (midnight + DAY, 1, 12.5)]);
        let eve: Vec<i64> = days()
            .iter()
            .filter(|day| day.user == site.eve.id)
            .map(|day| day.reviews)
            .collect();
        assert_eq!(eve, [1]);
        set(&site.store, |settings| {
            settings.time_zone = "Africa/Johannesburg".to_owned();
        });
        let east: Vec<(i64, i64)> = days()
            .iter()
            .filter(|day| day.user == site.ann)
            .map(|day| (day.start, day.answers))
            .collect();
        assert_eq!(east, [(midnight + 22 * 60 * MINUTE, 3)]);
        let outlook = site.store.outlook(evening + DAY).expect("an outlook");
        let masks = &outlook[0];
        assert_eq!((masks.answers_left, masks.reviews_left), (3, 2));
        assert_eq!(masks.answers_per_day, 3.0);
        assert_eq!(masks.days_left, Some(1.0));
        assert_eq!(masks.ends, Some(evening + 2 * DAY));
        site.whole();
    });
}

#[test]
fn users_come_in_bulk_with_a_token_each_or_not_at_all() {
    on_each("teams", |store| {
        let site = fixture(store, Vec::new());
        let add = |lines: &str| {
            site.store
                .add_users(Some(ROOT), lines, START + MINUTE, START)
        };
        let before = site.store.users().expect("users").len();
        for (lines, field) in [
            ("cleo\nann", "lines.2"),
            ("cleo,captain", "lines.1"),
            ("cleo\ncleo", "lines.2"),
            ("", "lines"),
        ] {
            let problem = add(lines).expect_err("refused").problem();
            assert_eq!(problem.field.as_deref(), Some(field), "{lines:?}");
        }
        assert_eq!(site.store.users().expect("users").len(), before);
        let added = add("name,role\r\ncleo\r\n\"dora\";reviewer\r\n\r\n").expect("users");
        let roles: Vec<(&str, Role)> = added
            .iter()
            .map(|issued| (issued.user.name.as_str(), issued.user.role))
            .collect();
        assert_eq!(roles, [("cleo", Role::Annotator), ("dora", Role::Reviewer)]);
        let who = site
            .store
            .authenticate(&added[0].token, &[annotate::store::TokenUse::Token], START)
            .expect("a token");
        assert_eq!(who.name, "cleo");
    });
}

#[test]
fn the_routes_of_a_large_project_answer_as_documented() {
    use annotate::wire::{
        BulkDone, Decisions, MyAnswers, NewUserLink, Practice, RuleState, RulesApplied, TaskFile,
        TaskPage,
    };
    use serde_json::json;

    let site = crate::support::Site::new();
    let (ann, eve, root) = (
        site.person("ann", Role::Annotator),
        site.person("eve", Role::Reviewer),
        site.person("max", Role::Admin),
    );
    let task = ann.answer(TaskKind::MaskText, masks("waving with a mask"));
    let rejected = ann.answer(TaskKind::Pair, pair(Verdict::Unclear));
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
    let applied: RulesApplied = root.post("rules/apply", &json!({})).ok();
    assert_eq!(applied.looked_at, 1);
    let links: Vec<NewUserLink> = root
        .post("users/bulk", &json!({ "lines": "cleo\ndora,reviewer" }))
        .ok();
    assert!(links[1].path.starts_with("/#token=ann_"));
    let practice: Vec<Practice> = ann.get("practice").ok();
    assert!(practice.iter().all(|practice| practice.passed));
    let days: Vec<annotate::wire::DayWork> = eve.get("stats/days").ok();
    assert_eq!(days.iter().map(|day| day.answers).sum::<i64>(), 2);
    let outlook: Vec<annotate::wire::Outlook> = eve.get("stats/outlook").ok();
    assert_eq!(outlook.len(), TaskKind::ALL.len());
    assert_eq!(eve.get("tasks?colour=red").problem().code, Code::BadRequest);
}

#[test]
fn the_guide_has_guidelines_and_pictures_of_each_kind() {
    use annotate::wire::{Guide, KindGuide, Me, PictureInfo, TextForm};
    use serde_json::json;

    let site = crate::support::Site::new();
    let (ann, root) = (
        site.person("ann", Role::Annotator),
        site.person("max", Role::Admin),
    );
    let guide: Guide = ann.get("guide").ok();
    assert!(guide.kinds[&TaskKind::Style].text.contains("proudly"));
    assert_eq!(guide.forms[&TaskKind::MaskText], TextForm::Completion);
    assert_eq!(guide.forms[&TaskKind::Pair], TextForm::Instruction);
    let me: Me = ann.get("me").ok();
    assert!(me.project.mask_templates.contains(&"raising".to_owned()));
    let png = b"\x89PNG\r\n\x1a\nnot a whole picture";
    let put = |client: &crate::support::Client, name: &str, bytes: &[u8]| {
        client.call("PUT", &format!("guide/pictures/{name}"), Some(bytes))
    };
    let kept: PictureInfo = put(&root, "right.png", png).ok();
    assert_eq!((kept.mime.as_str(), kept.bytes), ("image/png", png.len()));
    assert_eq!(
        put(&root, "evil.svg", b"<svg/>").problem().code,
        Code::Invalid
    );
    assert_eq!(put(&ann, "right.png", png).problem().code, Code::Forbidden);
    let seen = ann.get("guide/pictures/right.png");
    assert_eq!(seen.body, png);
    assert_eq!(
        seen.headers
            .get("content-type")
            .and_then(|value| value.to_str().ok()),
        Some("image/png")
    );
    let changed = json!({
        "text": "Say what differs.",
        "pictures": [{ "name": "right.png", "caption": "an arm", "right": true }],
    });
    let body = serde_json::to_vec(&changed).expect("JSON");
    let changed: KindGuide = root.call("PUT", "guide/pair", Some(&body)).ok();
    let guide: Guide = ann.get("guide").ok();
    assert_eq!(guide.kinds[&TaskKind::Pair], changed);
    assert!(guide.kinds[&TaskKind::Style].text.contains("proudly"));
    assert_eq!(
        root.call("DELETE", "guide/pictures/right.png", None).status,
        204
    );
    assert_eq!(
        ann.get("guide/pictures/right.png").problem().code,
        Code::NotFound
    );
}
