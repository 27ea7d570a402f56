//! The split lists of the release.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Split;
use serde_json::Value;

use super::name::{listed_name, motion_id, original_of};

/// The names of one section's lists and their splits. A name in several lists gets the split furthest
/// from training, so that no test motion is trained on.
#[derive(Clone, Debug, Default)]
pub(super) struct Lists {
    names: BTreeMap<String, Split>,
    /// The splits that have a list.
    stated: BTreeSet<Split>,
}

impl Lists {
    /// Split of a list, by its file name.
    pub(super) fn split_of(stem: &str) -> Option<Split> {
        match stem.to_lowercase().as_str() {
            "train" => Some(Split::Train),
            "val" | "valid" | "validation" => Some(Split::Val),
            "test" => Some(Split::Test),
            _ => None,
        }
    }

    /// A list of lines.
    pub(super) fn of_lines(split: Split, text: &str) -> Self {
        let mut lists = Self::empty(split);
        for line in text.lines() {
            lists.put(split, line);
        }
        lists
    }

    /// A list with every name in a list of names or pairs, or in a map.
    pub(super) fn of_json(split: Split, value: &Value) -> Self {
        let mut lists = Self::empty(split);
        lists.take_json(split, value);
        lists
    }

    fn empty(split: Split) -> Self {
        Self {
            stated: BTreeSet::from([split]),
            ..Self::default()
        }
    }

    fn take_json(&mut self, split: Split, value: &Value) {
        match value {
            Value::String(name) => self.put(split, name),
            Value::Number(number) => self.put(split, &number.to_string()),
            Value::Array(items) => items.iter().for_each(|item| self.take_json(split, item)),
            Value::Object(map) => {
                for (key, value) in map {
                    self.put(split, key);
                    self.take_json(split, value);
                }
            }
            _ => {}
        }
    }

    fn put(&mut self, split: Split, name: &str) {
        let name = listed_name(name);
        if !name.is_empty() {
            self.add(split, name.to_owned());
        }
    }

    fn add(&mut self, split: Split, name: String) {
        let found = self.names.entry(name).or_insert(split);
        *found = split.max(*found);
    }

    /// Adds the names of other lists of the same section.
    pub(super) fn join(&mut self, other: Self) {
        self.stated.extend(other.stated);
        for (name, split) in other.names {
            self.add(split, name);
        }
    }

    /// The listed names without a motion.
    pub(super) fn missing(&self, is_there: impl Fn(&str) -> bool) -> Vec<&str> {
        let names = self.names.keys().map(String::as_str);
        names.filter(|name| !is_there(name)).collect()
    }

    /// The published splits without a list, if there are lists. The release lists validation and test only.
    pub(super) fn absent(&self) -> impl Iterator<Item = Split> {
        let expected = [Split::Val, Split::Test].into_iter();
        expected.filter(|split| !self.stated.is_empty() && !self.stated.contains(split))
    }

    /// The split of a name: `train` if no list names it, `None` if there are no lists.
    pub(super) fn of(&self, name: &str) -> Option<Split> {
        if self.names.is_empty() {
            return None;
        }
        Some(self.names.get(name).copied().unwrap_or(Split::Train))
    }

    /// The splits of HumanML3D's clips, from lists of base motions and of style transfers. A clip, its mirrored copy
    /// and its styled versions share one split: of all that the lists state for them, the furthest from training.
    pub(super) fn of_clips(base: &Self, style: &Self) -> Self {
        let mut clips = Self::default();
        for (name, split) in &base.names {
            clips.add(*split, clip_of(&motion_id(name)));
        }
        for (name, split) in &style.names {
            // A style transfer is listed by its file, such as 000009_proud.
            let (base, _style) = name.split_once('_').unwrap_or((name, ""));
            clips.add(*split, clip_of(&motion_id(base)));
        }
        clips
    }

    /// The split of a motion's clip, by the motion's id. `self` is a result of [`Lists::of_clips`].
    pub(super) fn of_clip(&self, id: &str) -> Option<Split> {
        self.of(&clip_of(id))
    }
}

fn clip_of(id: &str) -> String {
    original_of(id).unwrap_or(id).to_owned()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn copies_and_styles_of_a_clip_are_where_the_last_of_them_is() {
        let (mut base, mut style) = (Lists::default(), Lists::default());
        base.join(Lists::of_lines(Split::Val, "000001\r\nM000002\n\n"));
        // Names may still end in an extension after their last one is removed.
        base.join(Lists::of_lines(Split::Test, "014619\nrun.npy.pkl\n"));
        for styled in [
            json!([["000004.pkl", "style/000004_proud.pkl"], 5]),
            json!({"000001_old": 1}),
            json!(["walk.npy_proud.pkl"]),
        ] {
            style.join(Lists::of_json(Split::Test, &styled));
        }
        assert_eq!(style.absent().collect::<Vec<_>>(), [Split::Val]);
        let splits = Lists::of_clips(&base, &style);
        for (id, split) in [
            ("000001", Split::Test),
            ("M000001", Split::Test),
            ("000002", Split::Val),
            ("000003", Split::Test),
            ("000004", Split::Test),
            ("000005", Split::Test),
            ("000006", Split::Train),
            ("run.npy", Split::Test),
            ("walk.npy", Split::Test),
        ] {
            assert_eq!(splits.of_clip(id), Some(split), "{id}");
        }
        let none = Lists::of_clips(&Lists::default(), &Lists::default());
        assert_eq!(none.of_clip("000001"), None);
    }

    #[test]
    fn lists_are_named_by_their_file() {
        assert_eq!(Lists::split_of("Val"), Some(Split::Val));
        assert_eq!(Lists::split_of("test"), Some(Split::Test));
        assert_eq!(Lists::split_of("all"), None);
        assert_eq!(Lists::default().of("a"), None);
        let lists = Lists::of_json(Split::Test, &json!(["x/a.pkl"]));
        let found = (lists.of("a"), lists.of("b"));
        assert_eq!(found, (Some(Split::Test), Some(Split::Train)));
    }
}
