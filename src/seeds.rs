//! The seeds of a plan.

use datasets_spec::Seed;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::global::Global;

/// Section `[seeds]` of a plan. Each is 0 unless it is given, and `--seed` replaces them all.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Seeds {
    /// Seed of the draws when the dataset is made: the split of new clips, and the pairs.
    pub(crate) split: Option<u64>,
    /// Seed of the test items.
    pub(crate) items: Option<u64>,
    /// Seed of weights, noise and the training stream.
    pub(crate) train: Option<u64>,
    /// Seed of the sampling noise of edits.
    pub(crate) sample: Option<u64>,
}

impl Seeds {
    /// All seeds in words, for a report.
    pub(crate) fn in_words(&self, global: &Global) -> String {
        let [split, items, train, sample] =
            [self.split, self.items, self.train, self.sample].map(|seed| global.seed_or(seed).0);
        format!("split {split}, items {items}, training {train}, sampling {sample}")
    }

    /// The seed of a model: `--seed`, or else the seed in its `own` settings, or else `train`. `resolved` is the seed
    /// in the model's settings completed by the preset; it counts only if `own` has the key `seed`.
    pub(crate) fn of_model(
        &self,
        resolved: u64,
        own: &Map<String, Value>,
        global: &Global,
    ) -> Seed {
        let own = own.contains_key("seed").then_some(resolved);
        global.seed_or(own.or(self.train))
    }
}
