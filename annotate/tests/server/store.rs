//! Tests of the store, on each available database.

mod clips;
mod gold;
mod walk;

use std::collections::{BTreeMap, BTreeSet};

use annotate::store::{AcceptedAnswer, NewTask, TokenUse};
use annotate::wire::{
    Answer, Code, Decision, EventKind, JointChoice, JointWeight, MaskAnswer, NewEvent, NewReview,
    ReviewQueue, RevisionState, Role, Rule, RuleKind, SkipReason, TaskKind, TaskState, Verdict,
};
use datasets_spec::Seed;
use rand::RngExt;

use crate::fixture::{Fixture, each, mask_tasks, on_each, pair_tasks, problem};
use crate::support::{
    DAY, HOUR, MINUTE, ROOT, START, all_keys, bare_motion, bare_task, decision, event, masks, pair,
    plain_settings, refusal, review, rule,
};

/// Pairs in bundles of eight.
fn bundled(count: usize) -> Vec<NewTask> {
    let pairs = pair_tasks(count).into_iter().enumerate();
    let bundled = pairs.map(|(number, task)| NewTask {
        bundle: Some(format!("bundle {}", number / 8)),
        bundle_index: number as i64 % 8,
        ..task
    });
    bundled.collect()
}

#[test]
fn a_task_goes_to_as_many_people_as_it_wants_and_only_a_claim_ends_its_lease() {
    each("claims", mask_tasks(2), |site| {
        let first = site.take(site.ann);
        assert_eq!(site.take(site.ann), first, "until it is done");
        assert_ne!(site.take(site.bob), first);
        let empty = site.nothing(site.eve, TaskKind::MaskText);
        assert_eq!((empty.total, empty.leased_by_others, empty.done), (2, 2, 0));
        assert_eq!(empty.soonest_expiry, Some(START + 15 * MINUTE));
        site.wait(HOUR);
        site.submit(site.ann, first, 0, masks("slow"));
    });
}

#[test]
fn an_expired_lease_is_given_away_by_the_claim_itself_and_its_late_answer_is_kept() {
    each("expiry", mask_tasks(1), |site| {
        let task = site.take(site.ann);
        let epoch = site.epoch(site.ann, task);
        site.wait(16 * MINUTE);
        assert_eq!(site.claim(site.bob), Some(task));
        let late = event(EventKind::Submit, epoch, 0, masks("late"));
        let result = site.send(site.ann, task, late.clone());
        let said = (result.status, problem(&result), result.rev);
        assert_eq!(said, (409, Code::LeaseLost, 1));
        let mine = site.detail(site.ann, task).mine.expect("my draft");
        let draft = (RevisionState::Draft, masks("late"));
        assert_eq!((mine.state, mine.answer), draft);
        assert_eq!(site.record(task).submitted, 0);
        // A repeated request gets the same reply.
        assert_eq!(site.send(site.ann, task, late), result);
        let again = site.store.claim_task(site.ann, task, site.now());
        assert_eq!(refusal(again), Code::TaskFull);
    });
}

#[test]
fn events_are_taken_once_in_order_and_on_the_newest_revision() {
    each("events", mask_tasks(3), |site| {
        // An event is applied once, however often it is sent.
        let task = site.take(site.bob);
        let epoch = site.epoch(site.bob, task);
        let draft = event(EventKind::Draft, epoch, 0, masks("one"));
        let before = site.last_seq();
        let first = site.send(site.bob, task, draft.clone());
        site.wait(MINUTE);
        for _ in 0..5 {
            assert_eq!(site.send(site.bob, task, draft.clone()), first);
        }
        assert_eq!(site.last_seq(), before + 1);
        let other = NewEvent {
            answer: Some(masks("two")),
            ..draft
        };
        assert_eq!(problem(&site.send(site.bob, task, other)), Code::KeyReused);

        // A batch stops at the first event that fails.
        let task = site.take(site.ann);
        let epoch = site.epoch(site.ann, task);
        let batch = vec![
            event(EventKind::Draft, epoch, 0, masks("one")),
            event(EventKind::Submit, epoch, 0, masks("two")),
            event(EventKind::Submit, epoch, 1, masks("three")),
        ];
        let results = site.append(site.ann, task, batch.clone());
        let statuses: Vec<u16> = results.iter().map(|result| result.status).collect();
        assert_eq!(statuses, [200, 409]);
        let results = site.append(site.ann, task, batch[2..].to_vec());
        assert_eq!(results[0].state, Some(TaskState::Submitted));

        // A stale revision is refused with the other one, and both stay in the log.
        let task = site.take(site.ann);
        let draft = |base, text| site.tell(site.ann, task, EventKind::Draft, base, masks(text));
        assert_eq!(draft(0, "tab one").rev, 1);
        let result = draft(0, "tab two");
        let said = (result.status, problem(&result));
        assert_eq!(said, (409, Code::StaleRevision));
        let theirs = result.problem.and_then(|problem| problem.theirs);
        let theirs = theirs.expect("the other one");
        assert_eq!((theirs.rev, theirs.answer), (1, masks("tab one")));
        let log = site.store.log(0, 1000).expect("the log");
        for text in ["tab one", "tab two"] {
            let mut bodies = log.iter().map(|entry| entry.body.to_string());
            assert!(bodies.any(|body| body.contains(text)), "{text}");
        }
        assert_eq!(draft(1, "merged").rev, 2);
    });
}

#[test]
fn an_answer_can_be_taken_back_until_it_is_reviewed() {
    each("undo", mask_tasks(1), |site| {
        let task = site.answer(site.ann, "hasty");
        let undone = site.send(site.ann, task, event(EventKind::Undo, 0, 1, None));
        let said = (undone.status, undone.state, undone.rev);
        assert_eq!(said, (200, Some(TaskState::Leased), 2));
        let epoch = undone.lease.expect("a lease again").epoch;
        assert_eq!(site.claim(site.bob), None, "the place is still mine");
        let again = event(EventKind::Submit, epoch, 2, masks("better"));
        assert_eq!(site.send(site.ann, task, again).status, 200);
        // By day and week, an answer counts once, however often it was handed in.
        let end = site.now() + DAY;
        let days = site.store.work(0, end).expect("days");
        let weeks = site.store.weeks(&[0, end]).expect("weeks");
        assert_eq!((days[0].answers, weeks[0].submitted), (1, 1));
        let (reviewed, lease) = site.review();
        assert_eq!(reviewed, task);
        let late = site.send(site.ann, task, event(EventKind::Undo, 0, 3, None));
        assert_eq!(problem(&late), Code::WrongState);
        let done = site.decide(task, lease, Decision::Accept);
        assert_eq!(done, Ok(TaskState::Accepted));
    });
}

#[test]
fn reviewers_do_not_judge_their_own_work_and_decisions_can_be_undone() {
    each("review", mask_tasks(1), |site| {
        let task = site.answer(site.eve, "mine");
        let sample = ReviewQueue::Sample;
        let review = site.store.review_next(site.eve, sample, None, START);
        let Err(empty) = review.expect("claims") else {
            panic!("one's own work is not given out")
        };
        assert_eq!((empty.waiting, empty.mine), (1, 1));
        assert_eq!(site.decide(task, 0, Decision::Accept), Err(Code::OwnWork));
        let other = Fixture {
            eve: site.join("zoe", Role::Reviewer),
            ..site.clone()
        };
        let early = other.decide(task, 99, Decision::Accept);
        assert_eq!(early, Err(Code::LeaseLost));
        let (_, lease) = other.review();
        let merged = other.decide(task, lease, Decision::Merge);
        assert_eq!(merged, Ok(TaskState::Accepted));
        let late = other.decide(task, lease, Decision::Accept);
        assert_eq!(late, Err(Code::WrongState));
        let accepted = site.accepted();
        assert!(accepted[0].merged && accepted[0].answer == masks("merged"));
        other.reopen(task);
        assert!(site.accepted().is_empty());
        // Only the log still has the merged answer; reviewers see it.
        let review = other.store.review_task(other.eve, task, START);
        assert_eq!(review.expect("claims").former, Some(masks("merged")));
        other.judge(Decision::Drop);
        assert_eq!(site.state(task), TaskState::Dropped);
    });
}

#[test]
fn a_return_concerns_those_who_had_answered_then_and_reserves_nothing_for_people_who_left() {
    each("returned_to", Vec::new(), |site| {
        site.set(|settings| settings.answers_per_task = 2);
        site.import(mask_tasks(1));
        let task = site.answer(site.ann, "one");
        site.answer(site.bob, "another");
        site.enable(site.bob, false);
        site.send_back(task);
        let holders = site.store.leases(site.now()).expect("leases");
        let holders: Vec<i64> = holders.iter().map(|held| held.lease.user).collect();
        assert_eq!(holders, [site.ann]);
        let zoe = site.join("zoe", Role::Annotator);
        assert_eq!(site.answer(zoe, "a third"), task);
        assert_eq!(site.detail(zoe, task).comment, None);
        let returned = |user: i64| site.person(user).returned;
        assert_eq!([site.ann, site.bob, zoe].map(returned), [1, 1, 0]);
        let decisions = site.store.task_row(task).expect("a task").1;
        assert_eq!(decisions[0].authors, ["ann", "bob"]);
    });
}

#[test]
fn two_answers_that_differ_come_first_in_the_queue_of_disagreement() {
    each("disagreement", Vec::new(), |site| {
        site.set(|settings| settings.answers_per_task = 2);
        site.import(mask_tasks(2));
        for user in [site.ann, site.bob] {
            site.answer(user, "same");
            let other = changed(masks("same"), |mask| {
                if user == site.bob {
                    mask.parts = vec!["RIGHT_ARM".to_owned()];
                }
            });
            site.hand_in(user, other);
        }
        let (task, _) = site.review();
        assert!(site.record(task).distance.expect("a distance") > 0.0);
    });
}

/// The answer after a change of its first mask, that of the left arm.
fn changed(mut answer: Answer, change: impl FnOnce(&mut MaskAnswer)) -> Answer {
    if let Answer::MaskText { masks, .. } = &mut answer {
        change(&mut masks[0]);
    }
    answer
}

fn in_range(range: [i32; 2]) -> Answer {
    changed(masks("waving"), |mask| mask.range = Some(range))
}

#[test]
fn ranges_and_joints_are_checked_and_kept_in_merged_answers_too() {
    each("ranges", mask_tasks(2), |site| {
        let task = site.take(site.ann);
        let send = |kind, rev, answer: Answer| site.tell(site.ann, task, kind, rev, answer);
        let with_joint = |joint: &str, weight| {
            let joint = joint.to_owned();
            let joints = vec![JointChoice { joint, weight }];
            changed(in_range([4, 36]), |mask| mask.joints = joints)
        };
        let hard = with_joint("left_elbow", JointWeight::Hard);
        let already = "is hard in the mask of the parts already";
        for (answer, field, words) in [
            (in_range([4, 34]), "range", "a range needs 31 at least"),
            (in_range([20, 41]), "range", "of a clip of 40 frames"),
            (in_range([30, 4]), "range", "a later end"),
            (hard, "joints", already),
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
        // A short range, as while its end is dragged, is accepted in a draft.
        assert_eq!(send(EventKind::Draft, 0, in_range([4, 5])).status, 200);
        let answer = with_joint("left_collar", JointWeight::None);
        assert_eq!(send(EventKind::Submit, 1, answer.clone()).status, 200);
        site.judge(Decision::Accept);
        assert_eq!(site.accepted()[0].answer, answer);

        site.answer(site.ann, "waving");
        let (task, epoch) = site.review();
        let merge = |range| {
            let review = NewReview {
                answer: Some(in_range(range)),
                ..decision(task, epoch, Decision::Merge)
            };
            site.store.review(site.eve, review, START)
        };
        // The range exceeds the clip.
        assert_eq!(refusal(merge([9, 41])), Code::Invalid);
        assert_eq!(merge([9, 40]).expect("merges").state, TaskState::Accepted);
    });
}

#[test]
fn skipped_tasks_stay_away_and_postponed_ones_come_last() {
    each("skips", mask_tasks(3), |site| {
        let first = site.take(site.ann);
        let lacking = site.tell(site.ann, first, EventKind::Skip, 0, None);
        assert_eq!(problem(&lacking), Code::Invalid);
        assert_eq!(site.skip(site.ann), first);
        assert_eq!(site.state(first), TaskState::Open);
        let second = site.take(site.ann);
        let later = site.tell(site.ann, second, EventKind::Postpone, 0, None);
        assert_eq!(later.status, 200);
        assert_ne!(site.answer(site.ann, "third"), second);
        assert_eq!(site.take(site.ann), second);
        assert_eq!(site.take(site.bob), first, "others may still want it");
        assert_eq!(site.store.rejects(&all_keys()).expect("rejects").len(), 1);
        // Importing again changes no task.
        let again = site.import(mask_tasks(5));
        assert_eq!((again.new, again.known), (2, 3));
    });
}

#[test]
fn a_bundle_is_leased_together_and_handed_in_one_by_one() {
    each("bundles", bundled(10), |site| {
        let first = site.take_pair(site.ann);
        let lease = site.lease(site.ann, first).id;
        site.wait(10 * MINUTE);
        let renewed = site.store.renew(site.ann, lease, site.now());
        renewed.expect("renews");
        let ends = [START + 25 * MINUTE; 8];
        assert_eq!(site.lease_ends(), ends, "the bundle is renewed as one");
        let mut seen = BTreeSet::new();
        for number in 0..8 {
            let task = site.take_pair(site.ann);
            let detail = site.detail(site.ann, task);
            let leased = detail.bundle.iter().filter(|item| item.leased);
            assert_eq!(leased.count(), 8 - number);
            let verdict = [Verdict::Unnatural, Verdict::Keep][number % 2];
            site.submit(site.ann, task, 0, pair(verdict));
            assert!(seen.insert(task), "once each");
        }
        assert!(!seen.contains(&site.take_pair(site.ann)));
        assert_eq!(site.claim_pair(site.bob), None);
    });
}

#[test]
fn the_motions_of_the_next_tasks_are_named_gold_ones_too() {
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
    each("upcoming", tasks, |site| {
        let next = |user: i64| match site.claimed(user, TaskKind::Pair) {
            Ok((detail, upcoming)) => (detail.task.source, upcoming.join(" ")),
            other => panic!("{other:?}"),
        };
        let (present, following) = next(site.ann);
        // The other pairs of the bundle follow.
        let rest = ("bundled0", "bundled1 bundled2 bundled3");
        assert_eq!((present.as_str(), following.as_str()), rest);
        site.make_gold(site.accepted()[0].task.id);
        site.set(|settings| settings.gold_percent = 1);
        let (present, following) = next(site.bob);
        let others = following.replace("known8 ", "");
        assert_ne!(others, following, "a gold task may come next: {following}");
        assert!(present.starts_with("later"), "{present}");
        assert_eq!(others, "later5 later6");
    });
}

#[test]
fn home_promises_what_a_claim_gives() {
    each("promises", mask_tasks(2), |site| {
        let (first, second) = (site.take(site.ann), site.take(site.eve));
        assert_ne!(first, second);
        assert_eq!(site.open(site.ann), 1, "what I hold is mine to do");
        assert_eq!((site.open(site.bob), site.claim(site.bob)), (0, None));
        // Expired leases are ended by the next claim.
        site.wait(16 * MINUTE);
        assert_eq!(site.open(site.bob), 2);
        let skipped = site.skip(site.bob);
        assert_eq!(site.open(site.bob), 1);
        let other = if skipped == first { second } else { first };
        assert_eq!(site.take(site.bob), other);
        // A returned answer waits for its author.
        let task = site.answer(site.bob, "poor");
        assert_eq!(site.open(site.bob), 0);
        site.send_back(task);
        assert_eq!(site.open(site.bob), 1);
        assert_eq!(site.take(site.bob), task);
    });
}

/// Puts the first tasks into the category of walks, and the others into that of waves.
fn in_categories(walks: usize, tasks: Vec<NewTask>) -> Vec<NewTask> {
    let tasks = tasks.into_iter().enumerate();
    let named = tasks.map(|(number, task)| NewTask {
        category: Some(if number < walks { "walk" } else { "wave" }.to_owned()),
        ..task
    });
    named.collect()
}

#[test]
fn home_leaves_out_pairs_that_the_quota_of_their_category_holds_back() {
    each("promised pairs", in_categories(6, pair_tasks(9)), |site| {
        let open = |user: i64| site.queue(user, TaskKind::Pair).open;
        assert_eq!(open(site.ann), 9);
        site.set(|settings| settings.category_quota = 2);
        assert_eq!(open(site.ann), 4, "two of each category");
        // Ann takes as many tasks as the quota allows: two kept pairs per category.
        for left in [4, 3, 2] {
            let task = site.take_pair(site.ann);
            assert_eq!(open(site.ann), left);
            site.submit(site.ann, task, 0, pair(Verdict::Keep));
        }
        site.take_pair(site.ann);
        assert_eq!(open(site.ann), 1, "the one she holds");
        assert_eq!((open(site.bob), site.claim_pair(site.bob)), (0, None));
        // Her lease expires: the pair and its place in the category are free again.
        site.wait(16 * MINUTE);
        assert_eq!(open(site.bob), 1);
        site.take_pair(site.bob);
        assert_eq!(open(site.ann), 0);
    });
}

#[test]
fn a_held_task_is_mine_on_the_home_page() {
    each("held", mask_tasks(3), |site| {
        let queue = || site.queue(site.ann, TaskKind::MaskText);
        let before = queue();
        assert_eq!((before.mine, before.held, before.held_until), (0, 0, None));
        site.answer(site.ann, "waving");
        site.take(site.ann);
        let after = queue();
        assert_eq!((after.mine, after.held, after.open), (2, 1, 2));
        assert_eq!(after.held_until, Some(START + 15 * MINUTE));
    });
}

#[test]
fn a_rule_of_equal_answers_compares_their_texts() {
    each("equal answers", Vec::new(), |site| {
        site.set(|settings| {
            settings.answers_per_task = 2;
            settings.rules = vec![Rule {
                min_answers: 2,
                ..rule("equal", RuleKind::Sampled)
            }];
        });
        site.import(mask_tasks(2));
        for (texts, state) in [
            (["waving", "not waving"], TaskState::Submitted),
            (["waving", "waving"], TaskState::Accepted),
        ] {
            let answers = [site.ann, site.bob].into_iter().zip(texts);
            let tasks = answers.map(|(user, text)| site.answer(user, text));
            let tasks: Vec<i64> = tasks.collect();
            assert_eq!(site.state(tasks[0]), state, "{texts:?}");
        }
    });
}

#[test]
fn leases_are_renewed_given_back_and_taken_away() {
    each("leases", mask_tasks(1), |site| {
        let task = site.take(site.ann);
        let lease = site.lease(site.ann, task);
        let renew = |user: i64, now: i64| site.store.renew(user, lease.id, now);
        let release = |lease, by| site.store.release(&site.who(by), lease, START);
        let renewed = renew(site.ann, START + MINUTE).expect("renews");
        assert_eq!(renewed.expires, lease.expires + MINUTE);
        assert!(renew(site.bob, START).is_err() && release(lease.id, site.bob).is_err());
        release(lease.id, site.eve).expect("a reviewer may");
        assert_eq!(refusal(renew(site.ann, START)), Code::LeaseLost);
        assert_eq!(site.take(site.bob), task);
        // A returned task that is taken away from its author is not reserved any longer.
        site.submit(site.bob, task, 0, masks("poor"));
        site.send_back(task);
        assert_eq!(site.take(site.bob), task);
        release(site.lease(site.bob, task).id, site.eve).expect("a reviewer may");
        assert_eq!(site.take(site.ann), task);
    });
}

#[test]
fn tokens_end_are_revoked_and_work_once_where_they_should() {
    use TokenUse::{Once, Session, Token};
    on_each("tokens", |store| {
        plain_settings(&store);
        let ann = store.add_user(None, "ann", Role::Annotator, START);
        let ann = ann.expect("a user").id;
        let issue = |purpose| {
            let issued = store.issue(ann, purpose, START + MINUTE, START);
            issued.expect("a token").token
        };
        let good_at = |token: &str, purpose, now| store.authenticate(token, purpose, now).is_ok();
        let good = |token: &str, purpose| good_at(token, purpose, START);
        let token = issue(Token);
        assert!(good(&token, Token));
        assert!(!good(&token, Session), "a token is no session");
        assert!(!good_at(&token, Token, START + MINUTE), "it ended");
        assert!(!good("ann_0000", Token));
        let once = issue(Once);
        assert!(good(&once, Once));
        assert!(!good(&once, Once), "it was used");
        let session = issue(Session);
        store.log_out(&session).expect("logs out");
        assert!(!good(&session, Session));
        let session = issue(Session);
        let id = store.tokens(ann).expect("tokens")[0].id;
        store.revoke(id).expect("revokes");
        assert!(!good(&token, Token));
        assert!(!good(&session, Session), "sessions go with it");
        let token = issue(Token);
        let disabled = store.change_user(None, ann, None, Some(false), START);
        disabled.expect("changes");
        assert!(!good(&token, Token));
        let annotator = Some(Role::Annotator);
        let demoted = store.change_user(None, ROOT, annotator, None, START);
        assert!(demoted.is_err(), "the last admin");
        let again = store.add_user(None, "ann", Role::Admin, START);
        assert!(again.is_err(), "the name is taken");
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
fn skips_and_reviews_count_as_work_and_days_begin_in_the_time_zone_of_the_project() {
    each("work", mask_tasks(3), |site| {
        let worked = |user: i64| {
            let home = site.home(user);
            (home.today, home.today_secs)
        };
        // 22:13 UTC is 7:13 of the next day in Tokyo.
        assert_eq!(worked(site.ann), (0, 0.0));
        let task = site.answer(site.ann, "one");
        site.skip(site.ann);
        assert_eq!(worked(site.ann), (1, 25.0));
        assert_eq!(site.judge(Decision::Accept), task);
        assert_eq!(worked(site.eve), (0, 40.0));

        site.wait(2 * HOUR);
        assert_eq!(worked(site.ann), (0, 0.0), "0:13 UTC");
        site.set(|settings| settings.time_zone = "Asia/Tokyo".to_owned());
        assert_eq!(worked(site.ann), (1, 25.0), "9:13 in Tokyo");
    });
}

#[test]
fn a_task_that_nobody_took_is_not_said_to_be_taken() {
    each("nobody", mask_tasks(1), |site| {
        let task = site.take(site.ann);
        let epoch = site.epoch(site.ann, task);
        site.wait(16 * MINUTE);
        // Any claim ends expired leases, even a claim of another kind of task.
        assert_eq!(site.claim_kind(site.bob, TaskKind::Style), None);
        let say = |base: i64, text: &str| {
            let late = event(EventKind::Draft, epoch, base, masks(text));
            let result = site.send(site.ann, task, late);
            assert_eq!(problem(&result), Code::LeaseLost);
            result.problem.expect("a problem").detail
        };
        let detail = say(0, "late");
        assert!(!detail.contains("somebody else"), "{detail}");
        assert_eq!(site.take(site.bob), task);
        let detail = say(1, "later");
        assert!(detail.contains("somebody else has the task"), "{detail}");
    });
}

#[test]
fn a_category_gets_no_more_pairs_than_its_quota_and_the_emptiest_comes_first() {
    let tasks = in_categories(20, bundled(40));
    each("a category quota", tasks, |site| {
        let quota = |pairs: u32| site.set(|settings| settings.category_quota = pairs);
        let category = |task: i64| site.record(task).category.expect("a category");
        let answer = |user: i64, verdict| category(site.hand_in(user, pair(verdict)));
        quota(6);
        // Ann holds pairs for six walks, which fills the quota; Bob gets the other category.
        assert_eq!(answer(site.ann, Verdict::Keep), "walk");
        assert_eq!(site.lease_ends().len(), 5);
        assert_eq!(answer(site.bob, Verdict::Unclear), "wave");
        // A pair that is rejected frees quota once the decision is made.
        for decided in ["walk", "wave"] {
            assert_eq!(category(site.judge(Decision::Accept)), decided);
        }
        for _ in 0..5 {
            assert_eq!(answer(site.ann, Verdict::Keep), "walk");
        }
        let mut waves = 0;
        while site.claim_pair(site.bob).is_some() {
            assert_eq!(answer(site.bob, Verdict::Keep), "wave");
            waves += 1;
        }
        assert_eq!(waves, 6);
        let empty = site.nothing(site.ann, TaskKind::Pair);
        assert_eq!(empty.quota_full, 14 + 13, "both quotas are reached");
        let kept = site.store.kept().expect("counts");
        assert_eq!(kept.iter().map(|row| row.2).collect::<Vec<_>>(), [6, 6]);
        site.whole();
        // With a larger quota the emptiest category comes first.
        quota(8);
        assert_eq!(answer(site.ann, Verdict::Keep), "walk");
        assert_eq!(answer(site.bob, Verdict::Keep), "wave");
        // A person who lost a task cannot claim it again when the quota is full.
        let held = site.take_pair(site.ann);
        site.give_back(site.ann, held);
        let again = || site.store.claim_task(site.ann, held, START);
        quota(7);
        assert_eq!(refusal(again()), Code::TaskFull);
        quota(8);
        assert_eq!(again().expect("room").task.id, held);
    });
}
