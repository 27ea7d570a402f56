//! Sets of test items without their motions: what draws the same items again from the same dataset.
//!
//! `stance items` writes one beside the items, so that others can draw the same questions where the motions may not be
//! shared.
//! One comes with the program; its corpus and dataset follow from seed 0 as well.

use std::path::Path;

use anyhow::{Context, bail};
use compose::{COMPOSED, ItemConfig, ItemCount, Novelty};
use corpus::{CorpusOptions, HELD_OUT_CLIPS, PAIR_LIST};
use datasets_spec::store::{ByPath, Store as _};
use datasets_spec::{Seed, Split};
use pipeline::stage::ItemsFolder;
use serde::{Deserialize, Serialize};

use crate::chosen::ChosenArgs;
use crate::global::Global;
use crate::{local, stages};

/// File beside items that holds their set.
const FILE: &str = "set.json";

/// Name of the set: questions on the built-in corpus, a third of each novelty that [`items`] lists.
pub(crate) const BUILTIN: &str = "builtin-2";
const COUNT: usize = 300;
/// Number of items that the demo is scored on, unless all are requested.
const PART: usize = 150;
/// Digest of the item ids, by [`compose::digest_of_ids`].
const DIGEST: &str = "7a6bb21b838eb68956fe8bfc334505c1";
/// Adjusted clips per neutral clip, which make the fine-grained pairs.
pub(crate) const ADJUSTED: usize = 2;

/// A set of test items.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TestSet {
    pub(crate) split: Split,
    pub(crate) seed: Seed,
    /// Condition on the clips that are asked about.
    #[serde(rename = "where")]
    pub(crate) condition: Option<String>,
    /// Hash of the files from which the items were drawn: the chosen motions, masks and pairs of a dataset.
    pub(crate) content: Option<String>,
    pub(crate) items: ItemConfig,
}

impl TestSet {
    /// The set [`BUILTIN`].
    pub(crate) fn builtin() -> Self {
        Self {
            split: Split::Test,
            seed: Seed(0),
            condition: None,
            content: None,
            items: items(Seed(0), true),
        }
    }

    pub(crate) fn read(path: &Path) -> anyhow::Result<Self> {
        let set: Self = local::read_json(path, "is no set of test items")?;
        if set.items.digest.is_none() {
            bail!(
                "{} does not state the digest of its items, by which others would be noticed",
                path.display()
            );
        }
        Ok(set)
    }

    /// Draws the items from a dataset.
    pub(crate) fn draw(
        &mut self,
        dataset: &Path,
        out: &Path,
        global: &Global,
    ) -> anyhow::Result<ItemsFolder> {
        let condition = self.condition.as_deref().map(str::parse).transpose()?;
        let opened = ChosenArgs { condition }.open(dataset)?;
        let content = opened.content_hash(&COMPOSED);
        let drawn = stages::items(&opened, out, self.split, &self.items, self.seed, global);
        let drawn = drawn.with_context(|| match &self.content {
            Some(expected) if *expected != content => format!(
                "the set is of other files of motions, masks or pairs ({expected:.12}) than those of {} ({content:.12})",
                dataset.display()
            ),
            _ => "cannot draw items".to_owned(),
        })?;
        self.content = Some(content);
        Ok(drawn)
    }

    /// Writes the set beside its items, whose ids have this digest.
    pub(crate) fn write(mut self, items: &Path, digest: &str) -> anyhow::Result<()> {
        self.items.digest.get_or_insert_with(|| digest.to_owned());
        let mut text = serde_json::to_string_pretty(&self)?;
        text.push('\n');
        let path = items.join(FILE);
        let write = || {
            let mut file = ByPath.create(&path)?;
            std::io::Write::write_all(&mut file, text.as_bytes())?;
            file.publish()
        };
        write().with_context(|| format!("cannot write {}", path.display()))
    }
}

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
