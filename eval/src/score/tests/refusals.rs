//! What is refused: items and tables that do not fit.

use super::*;

#[test]
fn metrics_and_intervals_need_their_items() {
    let found = |num_items: usize, protocol: &Protocol, metric: &Metric| {
        let items: Vec<ItemRow> = (0..num_items).map(|index| item(index, "style")).collect();
        let scores = scored(&items, &perfect("copy", &items), protocol).expect("valid");
        let row = scores
            .into_iter()
            .find(|row| row.system == IDENTITY && row.metric == metric.name);
        row.map(|row| (row.fid_items, row.ci95.is_some()))
    };
    let default = Protocol::default();
    // A task of one item keeps the metrics that need only one item.
    for (metric, is_there) in [
        (&FID, false),
        (&DIVERSITY, false),
        (&FOOT_SCORE, true),
        (&retrieval::E2T_RECALL_1, true),
    ] {
        assert_eq!(found(1, &default, metric).is_some(), is_there, "{metric}");
    }
    // The latents have twelve numbers; halves and whole sets are tested.
    for metric in [&FID, &FID_RAW] {
        assert_eq!(found(25, &default, metric), None);
        assert_eq!(found(26, &default, metric), Some((13, true)));
        let whole = Protocol {
            fid_sample: FidSample::All,
            ..default
        };
        assert_eq!(found(12, &whole, metric), None);
        assert_eq!(found(13, &whole, metric), Some((13, true)));
    }
    let pairs = Protocol {
        diversity_pairs: 12,
        ..default
    };
    assert_eq!(found(11, &pairs, &DIVERSITY), None);
    assert!(found(12, &pairs, &DIVERSITY).is_some());
    // Each item has its own target.
    for (targets, interval, is_known) in [
        (9, Spread::Targets, false),
        (10, Spread::Targets, true),
        (9, Spread::Repeats, false),
    ] {
        let protocol = Protocol {
            interval,
            ..default
        };
        let found = found(targets, &protocol, &POSITION_ERROR).expect("measured");
        assert_eq!(found.1, is_known, "{targets} {interval:?}");
    }
}

#[test]
fn broken_tables_are_refused_with_the_items_named() {
    let refused = |items: &[ItemRow], edits: &[EditRow], why: &str| {
        let error = scored(items, edits, &Protocol::default()).expect_err("a broken table");
        assert!(error.to_string().contains(why), "{error}");
        error
    };
    refused(&[], &[], "holds no items");
    let items = questions(8);
    let mut edits = perfect("partial", &items);
    let lost = edits.remove(3).id;
    let error = refused(&items, &edits, "partial");
    assert_eq!(
        error.to_string(),
        format!("system \"partial\" lacks 1 of 8 items: {lost}; edit them or leave the system out")
    );
    let foreign = item(99, "style");
    let mut edits = perfect("stray", &items);
    edits.extend(perfect("stray", std::slice::from_ref(&foreign)));
    refused(&items, &edits, &foreign.id);
    edits.pop();
    edits.push(take(lazy("stray", &items), 1).remove(0));
    refused(&items, &edits, "same number of takes");
    refused(&items, &lazy(IDENTITY, &items), "cannot be named");

    let mut changed = items.clone();
    changed[2].instruction = "kick".to_owned();
    let error = refused(&changed, &[], "");
    assert!(matches!(error, Error::Item { .. }), "{error}");
    let mut unaimed = items.clone();
    unaimed[2].target_frames = 0;
    unaimed[2].id = unaimed[2].content_id();
    refused(&unaimed, &[], "has no target");

    let refused = |break_it: &dyn Fn(&mut [EditRow]), why: &str| {
        let mut edits = perfect("broken", &items);
        break_it(&mut edits);
        refused(&items, &edits, why)
    };
    let rates = "30 fps, but its target runs at 20 fps";
    refused(&|edits| edits[0].fps = 30.0, rates);
    let error = refused(&|edits| edits[3].transl[0][1] = f32::NAN, "");
    assert!(matches!(error, Error::Motion { .. }), "{error}");
    let cut = |edits: &mut [EditRow]| {
        for row in edits {
            row.transl.truncate(2);
            row.global_orient.truncate(2);
            row.body_pose.truncate(2);
        }
    };
    refused(&cut, "2 frames are too few");
}

#[test]
fn broken_latents_are_refused() {
    let items = questions(2);
    let answered = answered(&items, &[]);
    let mut ids: Vec<&str> = items.iter().map(|item| item.id.as_str()).collect();
    ids.sort_unstable();
    let of_item = |item: usize, problem: &str| {
        let id = ids[item];
        format!("system \"source\", item {id:?}: the latent {problem}")
    };
    let [none, few] = [
        "cannot encode the motions of system \"source\"",
        "the encoder returned 1 latents for 2 motions of system \"source\"",
    ]
    .map(str::to_owned);
    let wide = of_item(1, "has another width than the others");
    let broken = of_item(0, "is not finite");
    let zero = of_item(1, "is zero, so it has no direction to compare");
    for (latents, expected) in [
        (vec![], none),
        (vec![vec![1.0]], few),
        (vec![vec![1.0, 2.0], vec![1.0]], wide),
        (vec![vec![f64::NAN], vec![1.0]], broken),
        (vec![vec![1.0], vec![0.0]], zero),
    ] {
        let encoder = Encoder(|_: &[&Motion]| -> Latents {
            if latents.is_empty() {
                return Err("no weights".into());
            }
            Ok(latents.clone())
        });
        let evaluators = by(&encoder, &answered);
        let error = score(&answered, evaluators, &Protocol::default(), &NoProgress)
            .expect_err("broken latents");
        assert_eq!(error.to_string(), expected);
    }
}
