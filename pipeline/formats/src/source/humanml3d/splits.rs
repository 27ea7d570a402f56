//! The splits that lists of ids assign to clips.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Split;

use super::layout::List;

/// Splits of clips, by the lists that name them.
pub(crate) struct Splits {
    of_clip: BTreeMap<String, BTreeSet<Split>>,
    /// Maps the id of a clip, or that of its mirror image, to the clip.
    clip_of: fn(&str) -> String,
}

impl Splits {
    /// Merges the lists. A clip and its mirror image share a split, so that mirrored copies do not leak between splits.
    pub(crate) fn of<'a>(
        lists: impl Iterator<Item = &'a List>,
        clip_of: fn(&str) -> String,
    ) -> Self {
        let mut of_clip: BTreeMap<String, BTreeSet<Split>> = BTreeMap::new();
        for (split, ids) in lists {
            for id in ids.iter().filter(|_| split.is_some()) {
                of_clip.entry(clip_of(id)).or_default().extend(split);
            }
        }
        Self { of_clip, clip_of }
    }

    /// The clips that have a split.
    pub(crate) fn clips(&self) -> impl Iterator<Item = &str> {
        self.of_clip.keys().map(String::as_str)
    }

    /// The split of a clip, and a note if lists disagree. Test then wins over validation, and validation over training,
    /// so that no published test clip is trained on.
    pub(crate) fn get(&self, id: &str) -> (Option<Split>, Option<String>) {
        let Some(splits) = self.of_clip.get(&(self.clip_of)(id)) else {
            return (None, None);
        };
        let taken = splits.last().copied();
        let note = (splits.len() > 1).then(|| {
            let names: Vec<&str> = splits.iter().map(|split| split.as_str()).collect();
            format!(
                "listed in several splits ({}); {} was taken",
                names.join(", "),
                taken.map_or("", Split::as_str)
            )
        });
        (taken, note)
    }
}
