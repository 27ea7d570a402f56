//! Novelty of test items, which labels decide and which can be requested in equal parts; and the sets of known limits.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Split;
use datasets_spec::record::{ItemRow, MaskRow, MotionRow, PairRow};
use serde_json::Value;

use crate::util::{Folder, json_of, motions_of, text_of, word_of};

/// Makes the dataset of the built-in test set from a corpus of `clips` clips.
fn with_dataset(clips: &str) -> Folder {
    let folder = Folder::empty();
    let line = format!("corpus --clips {clips} --adjusted 2 --held-out --out @corpus");
    folder.run(&line);
    folder.run("ingest @corpus --pairs @corpus/pairs.csv --out @dataset");
    folder.run("masks @dataset");
    folder.run("pairs @dataset");
    folder
}

/// The rows of a dataset, from which the documented rules give the novelty of an item.
struct Rules {
    clips: BTreeMap<String, MotionRow>,
    masks: Vec<MaskRow>,
    pairs: Vec<PairRow>,
}

impl Rules {
    fn of(folder: &Folder) -> Self {
        Self {
            clips: motions_of(&folder.path("dataset")),
            masks: folder.rows("dataset"),
            pairs: folder.rows("dataset"),
        }
    }

    /// Whether the training split has a clip for which `is` holds.
    fn has(&self, is: impl Fn(&MotionRow) -> bool) -> bool {
        let mut clips = self.clips.values();
        clips.any(|row| row.split == Split::Train && is(row))
    }

    /// Whether the training split has an annotation with this text, and with this action if one is named.
    fn has_text(&self, text: &str, action: Option<&Option<String>>) -> bool {
        let masks = self.masks.iter();
        let masks = masks.map(|mask| (mask.split, mask.text.as_str(), mask.motion_id.as_str()));
        let pairs = self.pairs.iter();
        let pairs = pairs.map(|pair| (pair.split, &*pair.instruction, pair.source_id.as_str()));
        masks.chain(pairs).any(|(split, said, id)| {
            split == Split::Train
                && said == text
                && action.is_none_or(|action| self.clips[id].action == *action)
        })
    }

    fn novelty(&self, item: &ItemRow) -> &'static str {
        let has_action = |action: &Option<String>| self.has(|row| row.action == *action);
        let (kind, id) = item.origin.split_once(' ').expect("kind and id");
        if kind == "mask" {
            let group = |row: &MotionRow| {
                let source = &row.source_name;
                let who = row.subject.clone().map(|who| (source.clone(), who));
                (row.action.clone(), row.style.clone(), who)
            };
            let has_group = |clip: &MotionRow| self.has(|row| group(row) == group(clip));
            let mask = self.masks.iter().find(|mask| mask.id == id);
            let mask = mask.expect("a mask");
            let source = &self.clips[item.source_id.as_str()];
            let target = &self.clips[mask.motion_id.as_str()];
            return match () {
                () if !has_action(&target.action) && !self.has_text(&mask.text, None) => "unshown",
                () if !has_action(&source.action) => "action",
                () if has_group(source) && has_group(target) => "retake",
                () if self.has_text(&mask.text, Some(&source.action)) => "retake",
                () => "combination",
            };
        }
        let pair = self.pairs.iter().find(|pair| pair.id == id);
        let pair = pair.expect("a pair");
        let action = &self.clips[pair.source_id.as_str()].action;
        let has = |action: Option<&Option<String>>| match &pair.style {
            Some(_) => self.has(|row| {
                row.style == pair.style && action.is_none_or(|action| row.action == *action)
            }),
            None => self.has_text(&pair.instruction, action),
        };
        match () {
            () if !has(None) => "unshown",
            () if !has_action(action) => "action",
            () if has(Some(action)) => "retake",
            () => "combination",
        }
    }
}

#[test]
fn the_built_in_test_set_asks_for_three_novelties_in_equal_parts() {
    let folder = with_dataset("780");
    let done: Value = folder.json("items @dataset --set builtin-2 --out @items");
    assert_eq!(done["items"], 300, "{done}");
    for value in ["retake", "combination", "action"] {
        assert_eq!(done["novelty"][value], 100, "{done}");
    }
    assert!(done["targets"].as_u64() >= Some(100), "{done}");
    let rules = Rules::of(&folder);
    let holds = |items: &[ItemRow]| {
        for item in items {
            let stated = item.novelty.as_deref();
            assert_eq!(stated, Some(rules.novelty(item)), "{}", item.origin);
        }
    };
    holds(&folder.rows::<ItemRow>("items"));
    // If no novelty is requested, items of every novelty of the split are drawn, and the rules hold for them too.
    folder.run("items @dataset --count 400 --seed 5 --out @any");
    let any: Vec<ItemRow> = folder.rows("any");
    let found = any.iter().filter_map(|item| item.novelty.as_deref());
    let all = BTreeSet::from(["retake", "combination", "action", "unshown"]);
    assert_eq!(found.collect::<BTreeSet<_>>(), all);
    holds(&any);
}

#[test]
fn a_dataset_that_is_not_that_of_a_test_set_is_refused_and_one_without_training_has_no_novelty() {
    let folder = with_dataset("330");
    let refused = folder.typed("items @dataset --set builtin-2 --out @items");
    refused.expect_refused("--clips 780 --adjusted 2 --held-out");
    assert!(!folder.path("items").exists());
    let unknown = folder.typed("items @dataset --set builtin-1 --out @items");
    unknown.expect_code(2).expect_said("there is builtin-2");
    folder.refused(
        "items @dataset --set builtin-2 --seed 3 --out @items",
        "leave --seed out",
    );
    // Training has shown all actions that style is transferred to.
    let style = "items @dataset --count 6 --task style --novelty";
    folder.refused(
        &format!("{style} unshown --out @items"),
        "split test gives no item of task style and of novelty unshown",
    );
    assert!(!folder.path("items").exists());
    let ran = folder.run(&format!("{style} action,unshown --out @fewer"));
    ran.expect_said("gives 3 different items, 6 were asked for: 3 action, 0 unshown");

    // The training split is removed, so the novelty is unknown.
    folder.run("dataset select @dataset --where \"split != 'train'\" --out @alone");
    let done: Value = folder.json("items @alone --count 12 --out @items");
    assert_eq!(done["novelty"]["not known"], 12, "{done}");
}

#[test]
fn what_training_has_shown_does_not_depend_on_the_clips_that_questions_are_drawn_from() {
    let folder = with_dataset("330");
    folder.run("items @dataset --count all --out @whole");
    folder.run("items @dataset --count all --where \"split = 'test'\" --out @part");
    let [whole, part] = ["whole", "part"].map(|items| {
        let rows = folder.rows::<ItemRow>(items).into_iter();
        let rows = rows.map(|row| (row.id, (row.task, row.novelty)));
        rows.collect::<BTreeMap<_, _>>()
    });
    assert_eq!(part, whole);
    // Only the pairs of the training split tell that an adjustment was shown.
    let mut stated = whole.into_values();
    let is_told = |(task, novelty): (String, Option<String>)| {
        task == "fine-grained" && novelty.is_some_and(|novelty| novelty != "unshown")
    };
    assert!(stated.any(is_told));
}

#[test]
fn a_set_draws_its_items_again_without_their_motions_and_refuses_others() {
    let folder = with_dataset("330");
    folder.put("compose.toml", "fixed_pairs = true");
    let drawn: Value = folder.json(
        "items @dataset --count 24 --task semantic,style --novelty retake,combination --seed 7 \
         --where \"action <> 'walk'\" --compose @compose.toml --out @first",
    );
    let path = folder.path("first").join("set.json");
    folder.put("sent.json", std::fs::read(&path).expect("a set"));
    assert!(text_of(&path).len() < 4_000, "{}", text_of(&path));
    std::fs::rename(folder.path("first"), folder.path("away")).expect("moved");

    // Whoever has made the same dataset draws the same folder: items, novelties, and the set itself.
    folder.run("ingest @corpus --pairs @corpus/pairs.csv --out @theirs");
    folder.run("masks @theirs");
    folder.run("pairs @theirs");
    let again: Value = folder.json("items @theirs --set @sent.json --out @again");
    assert_eq!(again, drawn);
    assert_eq!(folder.text("again/set.json"), folder.text("sent.json"));

    // A folder that holds these items says so only once they were drawn again.
    let altered = folder
        .text("sent.json")
        .replace(word_of(&drawn["digest"]), "0123");
    folder.put("altered.json", altered);
    folder.refused(
        "items @theirs --set @altered.json --out @again",
        "come to 0123",
    );

    // Other masks, another seed, or no digest: refused, and nothing is written.
    folder.run("dataset select @theirs --where \"split <> 'val' AND style <> 'old'\" --out @part");
    let refused = folder.typed("items @part --set @sent.json --out @none");
    refused.expect_refused("of other files of motions, masks or pairs");
    folder.refused(
        "items @theirs --set @sent.json --seed 8 --out @none",
        "drawn with seed 7",
    );
    let mut unproved: Value = json_of(folder.path("sent.json"));
    unproved["items"]["digest"] = Value::Null;
    folder.put("unproved.json", unproved.to_string());
    folder.refused(
        "items @theirs --set @unproved.json --out @none",
        "does not state the digest",
    );
    folder.put("other.json", "{\"split\": \"test\"}");
    folder.refused(
        "items @theirs --set @other.json --out @none",
        "is no set of test items",
    );
    assert!(!folder.path("none").exists());
    let both = folder.typed("items @theirs --set @sent.json --count 3 --out @none");
    both.expect_code(2);
}

/// Ingests the folder of one limit with one of its lists of pairs, and draws all its items.
fn questions(folder: &Folder, limit: &str, list: &str) -> Vec<ItemRow> {
    let (sources, name) = (format!("@limits/{limit}"), format!("{list}-{limit}"));
    let line = format!("ingest {sources} --pairs {sources}/{list} --out @dataset-{name}");
    folder.run(&line);
    let line = format!("items @dataset-{name} --count all --out @items-{name}");
    folder.run(&line);
    folder.rows(&format!("items-{name}"))
}

#[test]
fn limits_are_asked_in_a_set_each_and_wordings_beside_those_of_training() {
    let folder = Folder::empty();
    folder.run("corpus --limits --out @limits");
    for (limit, words) in [("repetition", "three times"), ("spatial", "instead of the")] {
        let items = questions(&folder, limit, "pairs.csv");
        assert_eq!(items.len(), 60, "{limit}");
        let with_words = items.iter().filter(|item| item.instruction.contains(words));
        assert_eq!(with_words.count(), if limit == "spatial" { 60 } else { 20 });
    }
    // The same motions, donors and parts, with other instructions.
    let key = |item: &ItemRow| (item.origin.clone(), item.parts.clone());
    let by_origin = |items: Vec<ItemRow>| -> BTreeMap<_, ItemRow> {
        items.into_iter().map(|item| (key(&item), item)).collect()
    };
    let unseen = by_origin(questions(&folder, "wording", "pairs.csv"));
    let seen = by_origin(questions(&folder, "wording", "pairs-seen.csv"));
    assert_eq!(unseen.len(), 88);
    assert!(unseen.keys().eq(seen.keys()));
    for (unseen, seen) in unseen.values().zip(seen.values()) {
        assert_eq!(unseen.donor_ids, seen.donor_ids);
        assert_eq!(unseen.target_transl, seen.target_transl);
        assert_ne!(unseen.instruction, seen.instruction);
    }
    let asks = |items: &BTreeMap<_, ItemRow>, words: &str| {
        let mut items = items.values();
        items.any(|item| item.instruction.starts_with(words))
    };
    assert!(asks(&seen, "Lean forward more") && !asks(&unseen, "Lean forward more"));
    assert!(asks(&unseen, "Tip the trunk") && asks(&unseen, "Be silly"));
}
