//! Quotas of edit types: the order in which pairs are given out, and the displayed counts.

use std::collections::BTreeMap;

use annotate::store::{NewTask, Store, open_sqlite};
use annotate::transfer::from_dataset;
use annotate::wire::{Answer, Code, EditType, EditTypeCount, Settings, TaskKind, Verdict};
use datasets_spec::record::{EDIT_TYPES, PairRow};

use crate::fixture::{Fixture, each, pair_tasks};
use crate::support::{ROOT, START, Site, commit, kept, pair, plain_settings, read, set};

fn quotas(store: &Store, quotas: &[(EditType, u32)]) {
    set(store, |settings| {
        settings.edit_type_quota = quotas.iter().copied().collect();
    });
}

/// Pair tasks with these edit types, stated by the source.
fn stated(types: &[Option<EditType>]) -> Vec<NewTask> {
    let mut tasks = pair_tasks(types.len());
    for (task, edit_type) in tasks.iter_mut().zip(types) {
        task.edit_type = *edit_type;
    }
    tasks
}

/// Claims the next pair for a person, and returns the number in the key of its task and the id of its task.
fn claim(site: &Fixture, user: i64) -> (usize, i64) {
    let id = site.take_pair(user);
    let key = site.record(id).key;
    let number = key.strip_prefix("task").and_then(|rest| rest.parse().ok());
    (number.expect("a number"), id)
}

#[test]
fn pairs_of_the_type_that_is_furthest_behind_come_first_and_none_is_held_back() {
    use EditType::{Force, Speed, Timing};
    let mut types = vec![None];
    types.extend([Speed, Force, Speed, Force, Timing].map(Some));
    each("edit type quotas", stated(&types), |site| {
        quotas(&site.store, &[(Speed, 4), (Force, 4)]);
        let answer = |answer: Answer| {
            let (number, id) = claim(site, site.ann);
            site.submit(site.ann, id, 0, answer);
            number
        };
        assert_eq!(answer(kept(Speed)), 1, "both are at nothing");
        // The edit type of the answer counts, whatever the source states.
        assert_eq!(answer(kept(Speed)), 2, "force is behind");
        assert_eq!(answer(kept(Force)), 4, "force is still behind");
        assert_eq!(answer(pair(Verdict::Unclear)), 3, "no force is left");
        assert_eq!(answer(kept(Timing)), 0, "others come in their order");
        assert_eq!(answer(kept(Timing)), 5);
        let count = |edit_type: EditType| {
            let kept = site.store.kept().expect("counts");
            let of_type = kept.iter().filter(|row| row.1 == edit_type);
            of_type.map(|row| row.2).sum::<i64>()
        };
        assert_eq!([Speed, Force, Timing].map(count), [2, 1, 2]);
    });
}

#[test]
fn of_a_type_with_enough_pairs_the_last_ones_are_given_out_last() {
    use EditType::{Force, Speed};
    let types = [Some(Speed), Some(Speed), None, Some(Force)];
    each("full edit types", stated(&types), |site| {
        quotas(&site.store, &[(Speed, 1), (Force, 1)]);
        // A pair that somebody works on counts, because it may be kept.
        assert_eq!(claim(site, site.ann).0, 0);
        assert_eq!(claim(site, site.bob).0, 3);
        assert_eq!(claim(site, site.eve).0, 2);
        let (number, id) = claim(site, site.ann);
        assert_eq!(number, 0, "it is hers until it is done");
        site.submit(site.ann, id, 0, kept(Speed));
        // A pair of a type that has enough is still given out.
        assert_eq!(claim(site, site.ann).0, 1);
        // Imported accepted answers count as well.
        let mut imported = pair_tasks(10).split_off(9);
        imported[0].accepted = Some(kept(Force));
        site.import(imported);
        let counts = site.store.kept().expect("counts");
        let counts = counts.iter().map(|row| (row.1.as_str(), row.2));
        let expected = BTreeMap::from([("force", 1), ("speed", 1)]);
        assert_eq!(counts.collect::<BTreeMap<_, _>>(), expected);
    });
}

#[test]
fn everybody_is_told_what_is_wanted_of_each_edit_type() {
    let site = Site::new();
    let [ann, boss] = site.people(["ann", "boss"]);
    let told = || ann.get("stats/edit-types").ok::<Vec<EditTypeCount>>();
    assert_eq!(told(), Vec::new());
    let wanted = [
        (EditType::Amplitude, 1),
        (EditType::Speed, 40),
        (EditType::Force, 0),
    ];
    quotas(&site.store, &wanted);
    for _ in 0..2 {
        ann.answer(pair(Verdict::Keep));
    }
    let count = |edit_type, kept, wanted| EditTypeCount {
        edit_type,
        kept,
        wanted,
    };
    let speed = count(EditType::Speed, 0, 40);
    assert_eq!(told(), [count(EditType::Amplitude, 2, 1), speed]);
    let was: Settings = boss.get("settings").ok();
    let mut settings = was.clone();
    settings.edit_type_quota.insert(EditType::Other, u32::MAX);
    let refused = boss.put_settings(&was, &settings).problem();
    let said = (refused.code, refused.field.as_deref());
    assert_eq!(said, (Code::Invalid, Some("edit_type_quota")));
}

#[test]
fn the_edit_type_that_a_dataset_states_of_a_pair_is_known_beforehand() {
    let site = Site::new();
    let mut pairs: Vec<PairRow> = read(&site.dataset);
    for pair in &mut pairs {
        pair.edit_type = match pair.id.as_str() {
            "fine-grained7" => Some("wiggle".to_owned()),
            "fine-grained8" => Some("speed".to_owned()),
            _ => None,
        };
    }
    commit(&site.dataset, &pairs, |row| row.split, "stated types");
    let first = |wanted: &[(EditType, u32)]| {
        let folder = tempfile::tempdir().expect("a folder");
        let store = open_sqlite(&folder.path().join("store.sqlite")).expect("a store");
        plain_settings(&store);
        let taken = from_dataset(&store, &site.dataset, None, START, &mut |_, _| {});
        let taken = taken.expect("imports");
        assert_eq!(taken.counts["unknown_edit_types"], 1);
        assert!(taken.messages.iter().any(|line| line.contains("timing")));
        quotas(&store, wanted);
        let claimed = store.claim(ROOT, TaskKind::Pair, 0, START).expect("claims");
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
