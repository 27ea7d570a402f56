//! Novelty of test questions: decided by labels, printed with every table, and requested in equal parts.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::Split;
use datasets_spec::record::{ItemRow, MaskRow, MotionRow, PairRow};
use serde_json::Value;

use crate::util::{arg, assert_has, rows_of, stance, typed};

/// Makes the dataset of the built-in test set from a corpus of `clips` clips.
fn dataset(dir: &Path, clips: &str) -> std::path::PathBuf {
    let (corpus, dataset) = (dir.join("corpus"), dir.join("dataset"));
    typed(
        "corpus --clips {} --adjusted 2 --held-out --out {}",
        &[&clips, &corpus],
    )
    .expect_code(0);
    let pairs = corpus.join("pairs.csv");
    typed(
        "ingest {} --pairs {} --out {}",
        &[&corpus, &pairs, &dataset],
    )
    .expect_code(0);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    dataset
}

/// The novelty of an item by the rules of the documentation, from the rows of the dataset.
struct Rules {
    clips: BTreeMap<String, MotionRow>,
    masks: Vec<MaskRow>,
    pairs: Vec<PairRow>,
}

impl Rules {
    fn of(dataset: &Path) -> Self {
        let clips = rows_of::<MotionRow>(dataset).into_iter();
        Self {
            clips: clips.map(|row| (row.id.to_string(), row)).collect(),
            masks: rows_of(dataset),
            pairs: rows_of(dataset),
        }
    }

    fn trained(&self) -> impl Iterator<Item = &MotionRow> {
        self.clips.values().filter(|row| row.split == Split::Train)
    }

    fn has_action(&self, action: &Option<String>) -> bool {
        self.trained().any(|row| row.action == *action)
    }

    fn has_group(&self, clip: &MotionRow) -> bool {
        let group = |row: &MotionRow| {
            let who = row
                .subject
                .clone()
                .map(|subject| (row.source_name.clone(), subject));
            (row.action.clone(), row.style.clone(), who)
        };
        self.trained().any(|row| group(row) == group(clip))
    }

    /// Whether the training split has an annotation with this text, and with this action if one is named.
    fn has_text(&self, text: &str, action: Option<&Option<String>>) -> bool {
        let is_of = |id: &str| action.is_none_or(|action| self.clips[id].action == *action);
        self.masks.iter().any(|mask| {
            mask.split == Split::Train && mask.text == text && is_of(mask.motion_id.as_str())
        }) || self.pairs.iter().any(|pair| {
            pair.split == Split::Train && pair.instruction == text && is_of(pair.source_id.as_str())
        })
    }

    fn has_style(&self, style: &Option<String>, action: Option<&Option<String>>) -> bool {
        let is_of = |row: &MotionRow| action.is_none_or(|action| row.action == *action);
        self.trained().any(|row| row.style == *style && is_of(row))
    }

    fn novelty(&self, item: &ItemRow) -> &'static str {
        let (kind, id) = item.origin.split_once(' ').expect("kind and id");
        if kind == "mask" {
            let mask = self
                .masks
                .iter()
                .find(|mask| mask.id == id)
                .expect("a mask");
            let source = &self.clips[item.source_id.as_str()];
            let target = &self.clips[mask.motion_id.as_str()];
            return match () {
                () if !self.has_action(&target.action) && !self.has_text(&mask.text, None) => {
                    "unshown"
                }
                () if !self.has_action(&source.action) => "action",
                () if self.has_group(source) && self.has_group(target) => "retake",
                () if self.has_text(&mask.text, Some(&source.action)) => "retake",
                () => "combination",
            };
        }
        let pair = self
            .pairs
            .iter()
            .find(|pair| pair.id == id)
            .expect("a pair");
        let action = &self.clips[pair.source_id.as_str()].action;
        let has = |action: Option<&Option<String>>| match &pair.style {
            Some(_) => self.has_style(&pair.style, action),
            None => self.has_text(&pair.instruction, action),
        };
        match () {
            () if !has(None) => "unshown",
            () if !self.has_action(action) => "action",
            () if has(Some(action)) => "retake",
            () => "combination",
        }
    }
}

#[test]
fn the_built_in_test_set_asks_for_three_novelties_in_equal_parts() {
    let dir = tempfile::tempdir().expect("a folder");
    let dataset = dataset(dir.path(), "780");
    let items = dir.path().join("items");
    let done: Value = typed(
        "--json items {} --set builtin-1 --out {}",
        &[&dataset, &items],
    )
    .done();
    assert_eq!(done["items"], 300, "{done}");
    for value in ["retake", "combination", "action"] {
        assert_eq!(done["novelty"][value], 100, "{done}");
    }
    assert!(done["targets"].as_u64() >= Some(100), "{done}");
    let items: Vec<ItemRow> = rows_of(&items);
    let rules = Rules::of(&dataset);
    let holds = |items: &[ItemRow]| {
        for item in items {
            let stated = item.novelty.as_deref();
            assert_eq!(stated, Some(rules.novelty(item)), "{}", item.origin);
        }
    };
    holds(&items);
    // If no novelty is requested, items of every novelty of the split are drawn, and the rules hold for them too.
    let any = dir.path().join("any");
    typed("items {} --count 400 --seed 5 --out {}", &[&dataset, &any]).expect_code(0);
    let any: Vec<ItemRow> = rows_of(&any);
    let found: BTreeSet<&str> = any
        .iter()
        .filter_map(|item| item.novelty.as_deref())
        .collect();
    assert_eq!(
        found,
        BTreeSet::from(["retake", "combination", "action", "unshown"])
    );
    holds(&any);
}

#[test]
fn a_dataset_that_is_not_that_of_a_test_set_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let dataset = dataset(dir.path(), "330");
    let items = dir.path().join("items");
    let said = typed("items {} --set builtin-1 --out {}", &[&dataset, &items]).refusal();
    assert_has(&said, &["--clips 780 --adjusted 2 --held-out"]);
    assert!(!items.exists());
    assert!(
        typed("items {} --set builtin-2 --out {}", &[&dataset, &items])
            .expect_code(2)
            .stderr
            .contains("there is builtin-1")
    );
}

#[test]
fn clips_without_labels_have_no_novelty() {
    let dir = tempfile::tempdir().expect("a folder");
    let dataset = dataset(dir.path(), "330");
    // The training split is removed, so the novelty is unknown.
    let alone = dir.path().join("alone");
    typed(
        "dataset select {} --where {} --out {}",
        &[&dataset, &"split != 'train'", &alone],
    )
    .expect_code(0);
    let items = dir.path().join("items");
    let done: Value = typed("--json items {} --count 12 --out {}", &[&alone, &items]).done();
    assert_eq!(done["novelty"]["not known"], 12, "{done}");
}

/// Ingests the questions of one folder `limit` with one of its lists, and draws all of them.
fn questions(dir: &Path, limit: &str, list: &str) -> Vec<ItemRow> {
    let sources = dir.join("limits").join(limit);
    let pairs = sources.join(list);
    let [dataset, items] =
        ["dataset", "items"].map(|kind| dir.join(format!("{kind}-{list}-{limit}")));
    typed(
        "ingest {} --pairs {} --out {}",
        &[&sources, &pairs, &dataset],
    )
    .expect_code(0);
    typed("items {} --count all --out {}", &[&dataset, &items]).expect_code(0);
    rows_of(&items)
}

#[test]
fn limits_are_asked_in_a_set_each_and_wordings_beside_those_of_training() {
    let dir = tempfile::tempdir().expect("a folder");
    let dir = dir.path();
    let limits = dir.join("limits");
    stance(&["corpus", "--limits", "--out", arg(&limits)]).expect_code(0);
    for (limit, words) in [("repetition", "three times"), ("spatial", "instead of the")] {
        let items = questions(dir, limit, "pairs.csv");
        assert_eq!(items.len(), 60, "{limit}");
        let with_words = items.iter().filter(|item| item.instruction.contains(words));
        assert_eq!(with_words.count(), if limit == "spatial" { 60 } else { 20 });
    }
    // The same motions, donors and parts, with other instructions.
    let key = |item: &ItemRow| (item.origin.clone(), item.parts.clone());
    let by_origin = |items: Vec<ItemRow>| -> BTreeMap<_, ItemRow> {
        items.into_iter().map(|item| (key(&item), item)).collect()
    };
    let unseen = by_origin(questions(dir, "wording", "pairs.csv"));
    let seen = by_origin(questions(dir, "wording", "pairs-seen.csv"));
    assert_eq!(unseen.len(), 88);
    assert!(unseen.keys().eq(seen.keys()));
    for (unseen, seen) in unseen.values().zip(seen.values()) {
        assert_eq!(unseen.donor_ids, seen.donor_ids);
        assert_eq!(unseen.target_transl, seen.target_transl);
        assert_ne!(unseen.instruction, seen.instruction);
    }
    let asks = |items: &BTreeMap<_, ItemRow>, words: &str| {
        items
            .values()
            .any(|item| item.instruction.starts_with(words))
    };
    assert!(asks(&seen, "Lean forward more") && !asks(&unseen, "Lean forward more"));
    assert!(asks(&unseen, "Tip the trunk") && asks(&unseen, "Be silly"));
}
