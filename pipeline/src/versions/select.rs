//! Makes a new dataset from some clips of another.

use std::collections::BTreeMap;
use std::path::Path;

use datasets_spec::dataset::{Commit, table_facts};
use datasets_spec::license::{self, LICENSES_FACT};
use datasets_spec::manifest::{LAID_OUT_FACT, plan_hash};
use datasets_spec::record::{MotionRow, PairRow, QuarantineRow, SkippedRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Progress, Transaction};
use serde::{Deserialize, Serialize};
use tables::Condition;

use super::choose::{Choice, NOT_SELECTED, accounting, left_out};
use super::labels::Labels;
use super::rows::ClipIndex;
use crate::Error;
use crate::clip_table::is_composed;
use crate::facts::json;
use crate::ingest::Places;

/// Fact of a manifest: the datasets from which its clips were selected, with the conditions, as JSON.
pub const SELECTED_FACT: &str = "selected";

#[derive(Debug, Serialize, Deserialize)]
struct Origin {
    root_hash: String,
    #[serde(rename = "where")]
    condition: String,
}

/// Result of [`select`].
#[derive(Clone, Debug, Serialize)]
pub struct Selected {
    /// Clips of the result.
    pub clips: u64,
    /// Clips that are not selected.
    pub left: u64,
    /// Captures without a motion, for which no condition holds; `left` counts them too.
    pub left_captures: u64,
    /// Rows of each table.
    pub tables: BTreeMap<String, u64>,
    /// Masks of clips that are not selected.
    pub left_masks: u64,
    /// Pairs of which neither clip is selected.
    pub left_pairs: u64,
    /// Pairs with only one selected clip; the result has none of them.
    pub parted_pairs: Vec<String>,
    /// Tables made from all clips, which the result does not contain; their commands make them again.
    pub left_tables: Vec<String>,
    /// Hash of the result.
    pub root_hash: String,
}

/// Writes the clips for which a condition holds to a new dataset at `out`, with all that belongs to them. They keep
/// their ids and splits.
///
/// # Errors
/// The condition holds for no clip, `out` is a dataset already, or reading or writing fails.
pub fn select(
    root: &Path,
    filter: &Condition,
    out: &Path,
    holder: &str,
    progress: &dyn Progress,
) -> Result<Selected, Error> {
    let dataset = Dataset::open(root)?;
    let chosen = Choice::Where(filter.clone()).of(&dataset)?;
    let transaction = Transaction::begin(out, holder)?;
    if transaction.base().is_some() {
        return Err(Error::dataset_exists(out));
    }
    let manifest = dataset.manifest();
    let skeleton = dataset.skeleton()?;
    let plan = plan_hash("select", &(&manifest.root_hash, filter.text()));
    let mut index = ClipIndex::read(&dataset)?;
    let captures = index.clips.iter().filter(|clip| !clip.has_motion()).count() as u64;
    index.clips.retain(|clip| chosen.contains(&clip.id));
    let mut tables = index.write(&transaction, progress)?;
    let all = Labels::read(&dataset)?;
    let mut labels = all.clone();
    labels
        .masks
        .retain(|_, mask| chosen.contains(&mask.motion_id));
    let sides = |pair: &PairRow| [&pair.source_id, &pair.target_id].map(|id| chosen.contains(id));
    labels.pairs.retain(|_, pair| sides(pair) == [true, true]);
    let parted = all.pairs.values().filter(|pair| {
        let [source, target] = sides(pair);
        source != target
    });
    let parted_pairs: Vec<String> = parted.map(|pair| pair.id.clone()).collect();
    let written = labels.write(&Labels::default(), &transaction, &skeleton, &plan)?;
    tables.extend(written);
    let facts = table_facts(&skeleton, &plan);
    let quarantine: Vec<QuarantineRow> = dataset.read(None)?;
    let mut skipped: Vec<SkippedRow> = dataset.read(None)?;
    let left = left_out(&dataset, |id| !chosen.contains(id), NOT_SELECTED)?;
    let num_left = left.len() as u64;
    skipped.extend(left);
    let quarantine = transaction.write_shards(None, &quarantine, &facts)?;
    tables.insert(QuarantineRow::TABLE.to_owned(), quarantine);
    let skipped = transaction.write_shards(None, &skipped, &facts)?;
    tables.insert(SkippedRow::TABLE.to_owned(), skipped);
    let motions = tables.get(MotionRow::TABLE).into_iter().flatten();
    let licenses = license::count(transaction.root(), motions)?;
    let mut facts = manifest.facts.clone();
    facts.remove(LAID_OUT_FACT);
    facts.insert(LICENSES_FACT.to_owned(), json(&licenses));
    facts.insert(SELECTED_FACT.to_owned(), selected_from(&dataset, filter)?);
    let left_tables = composed(&dataset);
    let store = transaction.store();
    Places::read(store.as_ref(), root)?.write(store.as_ref(), transaction.root())?;
    let done = transaction.commit(Commit {
        tables,
        plan_hash: plan,
        skeleton,
        accounting: Some(accounting(&manifest.accounting, num_left)),
        facts,
        ..Commit::default()
    })?;
    let manifest = done.manifest();
    Ok(Selected {
        clips: manifest.rows(MotionRow::TABLE, None),
        left: num_left,
        left_captures: captures,
        tables: manifest.row_counts(),
        left_masks: (all.masks.len() - labels.masks.len()) as u64,
        left_pairs: (all.pairs.len() - labels.pairs.len() - parted_pairs.len()) as u64,
        parted_pairs,
        left_tables,
        root_hash: manifest.root_hash.clone(),
    })
}

fn selected_from(dataset: &Dataset, filter: &Condition) -> Result<String, Error> {
    let manifest = dataset.manifest();
    let mut selections: Vec<Origin> = manifest.fact(SELECTED_FACT)?;
    selections.push(Origin {
        root_hash: manifest.root_hash.clone(),
        condition: filter.text().to_owned(),
    });
    Ok(json(&selections))
}

/// Tables that stages make of all clips of a dataset.
pub(crate) fn composed(dataset: &Dataset) -> Vec<String> {
    let tables = dataset.manifest().tables.keys();
    tables.filter(|table| is_composed(table)).cloned().collect()
}
