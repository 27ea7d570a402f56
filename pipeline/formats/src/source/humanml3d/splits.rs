//! The splits that lists of ids assign to clips.

use std::collections::BTreeMap;

use datasets_spec::Split;

use super::id::clip_of;

/// Splits of clips, by the lists that name them.
#[derive(Debug, Default)]
pub(crate) struct Splits {
    of_clip: BTreeMap<String, Vec<Split>>,
}

impl Splits {
    /// Merges the lists. A clip and its mirror image share a split, so that mirrored copies do not leak between splits.
    pub(crate) fn of<'a>(lists: impl Iterator<Item = &'a (Option<Split>, Vec<String>)>) -> Self {
        let mut of_clip: BTreeMap<String, Vec<Split>> = BTreeMap::new();
        for (split, ids) in lists {
            for (split, id) in split
                .iter()
                .flat_map(|split| ids.iter().map(move |id| (split, id)))
            {
                let splits = of_clip.entry(clip_of(id).to_owned()).or_default();
                if !splits.contains(split) {
                    splits.push(*split);
                    splits.sort();
                }
            }
        }
        Self { of_clip }
    }

    /// The split of a clip, and a note if lists disagree. Test then wins over validation, and validation over training,
    /// so that no published test clip is trained on.
    pub(crate) fn get(&self, id: &str) -> (Option<Split>, Option<String>) {
        let Some(splits) = self.of_clip.get(clip_of(id)) else {
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
