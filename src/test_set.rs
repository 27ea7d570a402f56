//! The test set that comes with the program.
//!
//! It is not stored: corpus, dataset and items follow from seed 0, and its digest is a constant below.

use compose::{ItemConfig, ItemCount, Novelty};
use corpus::{CorpusOptions, HELD_OUT_CLIPS, PAIR_LIST};
use datasets_spec::Seed;

/// Name of the set: questions on the built-in corpus, a third of each novelty that [`items`] lists.
pub(crate) const BUILTIN_1: &str = "builtin-1";
const COUNT: usize = 300;
/// Number of items that the demo is scored on, unless all are requested.
const PART: usize = 150;
/// Digest of the item ids, by [`compose::digest_of_ids`].
const DIGEST: &str = "099accb8ce2b9bbe74622c0a5611bf21";
/// Adjusted clips per neutral clip, which make the fine-grained pairs.
pub(crate) const ADJUSTED: usize = 2;

pub(crate) fn corpus(seed: Seed) -> CorpusOptions {
    CorpusOptions {
        clips: HELD_OUT_CLIPS,
        adjusted: ADJUSTED,
        seed,
    }
}

/// Settings of the items: all, or the part that the demo is scored on. Only items of seed 0 are checked by digest.
pub(crate) fn items(seed: Seed, is_full: bool) -> ItemConfig {
    ItemConfig {
        count: ItemCount::Exactly(COUNT),
        novelty: vec![Novelty::Retake, Novelty::Combination, Novelty::Action],
        part: (!is_full).then_some(PART),
        digest: (seed == Seed(0)).then(|| DIGEST.to_owned()),
        ..ItemConfig::default()
    }
}

/// The commands that make its dataset in a new folder.
pub(crate) fn commands() -> String {
    let dataset = "builtin";
    format!(
        "stance corpus --clips {HELD_OUT_CLIPS} --adjusted {ADJUSTED} --held-out --out corpus; \
         stance ingest corpus --pairs corpus/{PAIR_LIST} --out {dataset}; \
         stance masks {dataset}; stance pairs {dataset}"
    )
}
