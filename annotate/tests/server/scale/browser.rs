//! The browser of tasks filters, searches, and pages in every order.

use super::*;

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
