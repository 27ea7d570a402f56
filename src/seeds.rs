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
    split: Option<u64>,
    /// Seed of the test items.
    items: Option<u64>,
    /// Seed of weights, noise and the training stream.
    train: Option<u64>,
    /// Seed of the sampling noise of edits.
    sample: Option<u64>,
}

impl Seeds {
    pub(crate) fn split(&self, global: &Global) -> Seed {
        global.seed_or(self.split)
    }

    pub(crate) fn items(&self, global: &Global) -> Seed {
        global.seed_or(self.items)
    }

    pub(crate) fn train(&self, global: &Global) -> Seed {
        global.seed_or(self.train)
    }

    pub(crate) fn sample(&self, global: &Global) -> Seed {
        global.seed_or(self.sample)
    }

    /// All seeds in words, for a report.
    pub(crate) fn in_words(&self, global: &Global) -> String {
        format!(
            "split {}, items {}, training {}, sampling {}",
            self.split(global).0,
            self.items(global).0,
            self.train(global).0,
            self.sample(global).0
        )
    }

    /// The seed of a model whose own settings may hold one; `resolved` is the seed in its settings, completed by the
    /// preset.
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
