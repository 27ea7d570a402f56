//! Quotas of edit types: which pairs are given out first, and what is told of them.

use std::collections::BTreeMap;

use annotate::store::{NewTask, Store, open_sqlite};
use annotate::transfer::from_dataset;
use annotate::wire::{Answer, Code, EditType, EditTypeCount, Role, Settings, TaskKind, Verdict};
use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{EDIT_TYPES, PairRow};
use datasets_spec::{Dataset, Skeleton};

use crate::store::{Fixture, fixture, on_each};
use crate::support::{START, Site, bare_task, pair, plain_settings};

fn set(store: &Store, quotas: &[(EditType, u32)]) {
    let settings = Settings {
        edit_type_quota: quotas.iter().copied().collect(),
        ..store.settings().expect("settings")
    };
    store.put_settings(1, settings, START).expect("settings");
}

/// Pair tasks that the source states to be of these types.
fn stated(types: &[Option<EditType>]) -> Vec<NewTask> {
    let tasks = types.iter().enumerate();
    tasks
        .map(|(number, edit_type)| NewTask {
            edit_type: *edit_type,
            ..bare_task(number, TaskKind::Pair)
        })
        .collect()
}

/// An answer that keeps a pair as an edit of a type.
fn kept(of_type: EditType) -> Answer {
    let mut answer = pair(Verdict::Keep);
    if let Answer::Pair { edit_type, .. } = &mut answer {
        *edit_type = Some(of_type);
    }
    answer
}

/// Gives a person the next pair, and returns the number of its task and its id.
fn claim(site: &Fixture, user: i64) -> (usize, i64) {
    let id = site.claim_kind(user, TaskKind::Pair, START);
    let id = id.expect("a pair");
    let key = site.store.task_record(id).expect("a task").key;
    let number = key.strip_prefix("task").and_then(|rest| rest.parse().ok());
    (number.expect("a number"), id)
}

#[test]
fn pairs_of_the_type_that_is_furthest_behind_come_first_and_none_is_held_back() {
    use EditType::{Force, Speed, Timing};
    on_each("edit type quotas", |store| {
        let types = [
            None,
            Some(Speed),
            Some(Force),
            Some(Speed),
            Some(Force),
            Some(Timing),
        ];
        let site = fixture(store, stated(&types));
        set(&site.store, &[(Speed, 4), (Force, 4)]);
        let answer = |answer: Answer| {
            let (number, id) = claim(&site, site.ann);
            site.submit(site.ann, id, 0, answer, START);
            number
        };
        assert_eq!(answer(kept(Speed)), 1, "both are at nothing");
        // What people say counts, whatever the source states.
        assert_eq!(answer(kept(Speed)), 2, "force is behind");
        assert_eq!(answer(kept(Force)), 4, "force is still behind");
        assert_eq!(answer(pair(Verdict::Unclear)), 3, "no force is left");
        assert_eq!(answer(kept(Timing)), 0, "others come in their order");
        assert_eq!(answer(kept(Timing)), 5);
        let count = |edit_type: EditType| {
            let kept = site.store.kept().expect("counts").into_iter();
            kept.filter(|(_, name, _)| name == edit_type.as_str())
                .map(|(.., count)| count)
                .sum::<i64>()
        };
        assert_eq!([Speed, Force, Timing].map(count), [2, 1, 2]);
        site.whole();
    });
}

#[test]
fn of_a_type_with_enough_pairs_the_last_ones_are_given_out_last() {
    use EditType::{Force, Speed};
    on_each("full edit types", |store| {
        let types = [Some(Speed), Some(Speed), None, Some(Force)];
        let site = fixture(store, stated(&types));
        set(&site.store, &[(Speed, 1), (Force, 1)]);
        // Who is at work on a pair may keep it.
        assert_eq!(claim(&site, site.ann).0, 0);
        assert_eq!(claim(&site, site.bob).0, 3);
        assert_eq!(claim(&site, site.eve.id).0, 2);
        let (number, id) = claim(&site, site.ann);
        assert_eq!(number, 0, "it is hers until it is done");
        site.submit(site.ann, id, 0, kept(Speed), START);
        assert_eq!(
            claim(&site, site.ann).0,
            1,
            "more than enough is no refusal"
        );
        // Accepted answers of elsewhere count as well.
        let imported = NewTask {
            accepted: Some(kept(Force)),
            ..bare_task(9, TaskKind::Pair)
        };
        site.store
            .import(None, vec![imported], START)
            .expect("an accepted pair");
        let kept = site.store.kept().expect("counts");
        let kept: BTreeMap<&str, i64> = kept
            .iter()
            .map(|(_, name, count)| (name.as_str(), *count))
            .collect();
        assert_eq!(kept, BTreeMap::from([("force", 1), ("speed", 1)]));
        site.whole();
    });
}

#[test]
fn everybody_is_told_what_is_wanted_of_each_edit_type() {
    let site = Site::new();
    let people = [("ann", Role::Annotator), ("boss", Role::Admin)];
    let [ann, boss] = people.map(|(name, role)| site.person(name, role));
    let told = || ann.get("stats/edit-types").ok::<Vec<EditTypeCount>>();
    assert_eq!(told(), Vec::new());
    let quotas = [
        (EditType::Amplitude, 1),
        (EditType::Speed, 40),
        (EditType::Force, 0),
    ];
    set(&site.store, &quotas);
    for _ in 0..2 {
        ann.answer(TaskKind::Pair, pair(Verdict::Keep));
    }
    let count = |edit_type, kept, wanted| EditTypeCount {
        edit_type,
        kept,
        wanted,
    };
    assert_eq!(
        told(),
        [
            count(EditType::Amplitude, 2, 1),
            count(EditType::Speed, 0, 40)
        ]
    );
    let mut settings: Settings = boss.get("settings").ok();
    settings.edit_type_quota.insert(EditType::Other, u32::MAX);
    let body = serde_json::to_vec(&settings).expect("JSON");
    let refused = boss.call("PUT", "settings", Some(&body)).problem();
    assert_eq!(
        (refused.code, refused.field.as_deref()),
        (Code::Invalid, Some("edit_type_quota"))
    );
}

#[test]
fn the_edit_type_that_a_dataset_states_of_a_pair_is_known_beforehand() {
    let site = Site::new();
    let dataset = Dataset::open(&site.dataset).expect("a dataset");
    let mut pairs: Vec<PairRow> = dataset.read(None).expect("pairs");
    for pair in &mut pairs {
        pair.edit_type = match pair.id.as_str() {
            "fine-grained7" => Some("wiggle".to_owned()),
            "fine-grained8" => Some("speed".to_owned()),
            _ => None,
        };
    }
    commit_rows(
        &site.dataset,
        &pairs,
        Some(|row: &PairRow| row.split),
        &Skeleton::smplx_neutral(),
        "stated types",
        "test",
    )
    .expect("pairs");
    let first = |quotas: &[(EditType, u32)]| {
        let folder = tempfile::tempdir().expect("a folder");
        let store = open_sqlite(&folder.path().join("store.sqlite")).expect("a store");
        plain_settings(&store);
        let taken = from_dataset(&store, &site.dataset, None, START, &mut |_, _| {});
        let taken = taken.expect("imports");
        assert_eq!(taken.counts["unknown_edit_types"], 1);
        assert!(taken.messages.iter().any(|line| line.contains("timing")));
        set(&store, quotas);
        let claimed = store.claim(1, TaskKind::Pair, 0, START).expect("claims");
        let Ok((detail, _)) = claimed else {
            panic!("there are pairs");
        };
        detail.task.key
    };
    assert_eq!(first(&[]), "pair:fine-grained0");
    assert_eq!(first(&[(EditType::Speed, 3)]), "pair:fine-grained8");
}

#[test]
fn edit_types_are_those_of_the_table() {
    let names: Vec<&str> = EditType::ALL.iter().map(|kind| kind.as_str()).collect();
    assert_eq!(names, EDIT_TYPES);
}
