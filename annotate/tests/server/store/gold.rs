//! Gold tasks are given out like others and measure annotators.

use super::*;

/// Makes gold tasks from imported answers, and sets the rate at which they are given out.
fn make_golds(site: &Fixture, count: usize, kind: TaskKind, percent: u32) -> Vec<i64> {
    site.set(|settings| settings.gold_percent = percent);
    let known = (0..count).map(|number| NewTask {
        accepted: Some(match kind {
            TaskKind::Pair => pair(Verdict::Keep),
            _ => masks("known"),
        }),
        suggestions: vec![draft("a draft")],
        ..bare_task(900_000 + number, kind)
    });
    site.import(known.collect());
    let mut known = site.accepted();
    known.retain(|answer| answer.task.key.contains("task9"));
    let gold = |answer: &AcceptedAnswer| site.make_gold(answer.task.id);
    known.iter().map(gold).collect()
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
    let drafted = mask_tasks(2).into_iter().map(|task| NewTask {
        suggestions: vec![draft("another draft")],
        ..task
    });
    each("gold", drafted.collect(), |site| {
        let gold = make_golds(site, 1, TaskKind::MaskText, 100)[0];
        assert_eq!(site.take(site.bob), gold);
        assert_eq!(site.take(site.ann), gold, "everybody gets it");
        let seen = |task: i64| {
            let task = site.detail(site.bob, task).task;
            (task.state, task.wanted, task.submitted)
        };
        assert_eq!(seen(gold), (TaskState::Leased, 1, 0));
        let drafts = site.detail(site.bob, gold).suggestions;
        assert_eq!((drafts.len(), drafts[0].text.as_str()), (1, "a draft"));
        let known = masks("known");
        let result = site.tell(site.bob, gold, EventKind::Submit, 0, known);
        let said = (result.status, result.state);
        assert_eq!(said, (200, Some(TaskState::Submitted)));
        // Answers to other tasks look the same.
        let submitted = (TaskState::Submitted, 1, 1);
        assert_eq!(seen(gold), submitted);
        assert_eq!(seen(site.answer(site.bob, "other")), submitted);
        let bob = site.person(site.bob);
        assert_eq!((bob.gold_items, bob.gold_score), (1, Some(1.0)));
        let counts = site.store.funnel().expect("counts");
        let counted: i64 = counts.iter().map(|row| row.2).sum();
        assert_eq!(counted, 3, "gold tasks are not counted as work");
    });
}

#[test]
fn a_gold_task_is_not_given_to_those_who_know_its_answer() {
    each("gold_authors", mask_tasks(6), |site| {
        let task = site.answer(site.ann, "known");
        let early = site.store.make_gold(ROOT, task, START);
        assert!(early.is_err(), "only accepted answers are known");
        assert_eq!(site.judge(Decision::Accept), task);
        let gold = site.make_gold(task);
        site.set(|settings| settings.gold_percent = 100);
        for user in [site.ann, site.eve] {
            let given = site.take(user);
            assert_ne!(given, gold, "its author and its reviewer know the answer");
        }
        assert_eq!(site.take(site.bob), gold);
        // Once its answer is no longer accepted, the gold task is not given out.
        site.reopen(task);
        let zoe = site.join("zoe", Role::Annotator);
        assert_ne!(site.claim(zoe), Some(gold));
    });
}

#[test]
fn gold_is_drawn_for_each_answer_and_stands_in_the_places_of_a_bundle() {
    each("gold_bundles", bundled(40), |site| {
        let golds = make_golds(site, 30, TaskKind::Pair, 40);
        let (mut given, mut places) = (Vec::new(), 0);
        while let Some(task) = site.claim_pair(site.ann) {
            let detail = site.detail(site.ann, task);
            assert_eq!(detail.bundle.len(), 8, "as many places as in every bundle");
            let place = detail.bundle.iter().position(|entry| entry.task == task);
            let place = place.expect("a place of its own");
            assert_eq!(detail.task.bundle_index, place as i64);
            places += usize::from(golds.contains(&task)) * place;
            let lease = detail.lease.expect("a lease");
            // Renewing one task of a bundle renews all of them.
            let renewed = site.store.renew(site.ann, lease.id, START + MINUTE);
            let renewed = renewed.expect("renews").expires;
            assert!(site.lease_ends().iter().all(|end| *end == renewed));
            let unclear = pair(Verdict::Unclear);
            let result = site.tell(site.ann, task, EventKind::Submit, 0, unclear);
            let said = (result.status, result.state);
            assert_eq!(said, (200, Some(TaskState::Submitted)));
            given.push(task);
        }
        let drawn = |tasks: &[i64]| tasks.iter().filter(|task| golds.contains(task)).count();
        assert_eq!(given.len(), 40 + drawn(&given), "each pair is answered too");
        let share = drawn(&given[..40]);
        assert!((8..=24).contains(&share), "{share} of the first 40 answers");
        assert!(places > 0, "not only at the start of a bundle");
        let distinct: BTreeSet<i64> = given.iter().copied().collect();
        assert_eq!(distinct.len(), given.len());
    });
}
