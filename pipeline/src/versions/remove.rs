//! Makes a version without some clips.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::dataset::{Commit, ShardName, table_facts};
use datasets_spec::license::{self, LICENSES_FACT};
use datasets_spec::manifest::{FileEntry, plan_hash};
use datasets_spec::record::{MaskRow, MotionRow, PairRow, SkippedRow};
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{Dataset, MotionId, Split, Transaction};
use serde::Serialize;

use super::choose::{Choice, REMOVED, accounting, left_out};
use super::labels::{Labels, check_lost, is_mask_of_people, is_pair_of_people};
use super::select::composed;
use crate::Error;
use crate::clip_table::{CLIP_TABLES, borrowed, clip_ids, rewrite};
use crate::facts::json;
use crate::ingest::LostLabel;

/// Result of [`remove`], or of its dry run.
#[derive(Clone, Debug, Serialize)]
pub struct Removed {
    /// Ids of the removed clips.
    pub removed: Vec<String>,
    /// Clips of the result.
    pub clips: u64,
    /// Labels that people made of the removed clips. The previous version keeps them.
    pub lost: Vec<LostLabel>,
    /// Numbers of other masks and pairs of the removed clips, by table.
    pub dropped: BTreeMap<String, u64>,
    /// Tables made of all clips, which the result does not contain; their commands make them again.
    pub left_tables: Vec<String>,
    /// Whether nothing was changed, because a dry run was requested.
    pub dry_run: bool,
    /// Rows of each table of the result, or of the newest version after a dry run.
    pub tables: BTreeMap<String, u64>,
    /// Hash of the newest version.
    pub root_hash: String,
}

/// What a removal would do.
struct Planned {
    dataset: Dataset,
    chosen: BTreeSet<MotionId>,
    before: Labels,
    labels: Labels,
    left: Vec<SkippedRow>,
    shards: Shards,
    report: Removed,
}

impl Planned {
    fn of(root: &Path, choice: &Choice) -> Result<Self, Error> {
        let dataset = Dataset::open(root)?;
        let chosen = choice.of(&dataset)?;
        let manifest = dataset.manifest();
        let before = Labels::read(&dataset)?;
        let (labels, lost, dropped) = without(&before, &chosen);
        let left = left_out(&dataset, |id| chosen.contains(id), REMOVED)?;
        let shards = Shards::read(&dataset)?;
        if shards.num_clips() <= left.len() {
            return Err(Error::refused(format!(
                "every clip of {} would be removed; nothing was changed. Remove the folder if that is meant",
                root.display()
            )));
        }
        let report = Removed {
            removed: chosen.iter().map(ToString::to_string).collect(),
            clips: (shards.num_clips() - left.len()) as u64,
            lost,
            dropped,
            left_tables: composed(&dataset),
            dry_run: true,
            tables: manifest.row_counts(),
            root_hash: manifest.root_hash.clone(),
        };
        Ok(Self {
            dataset,
            chosen,
            before,
            labels,
            left,
            shards,
            report,
        })
    }
}

/// What [`remove`] would do. This needs no lock, so it works while another run writes, and on folders that are read-only.
///
/// # Errors
/// No clip is chosen, or all are, or a table cannot be read.
pub fn removable(root: &Path, choice: &Choice) -> Result<Removed, Error> {
    Ok(Planned::of(root, choice)?.report)
}

/// Makes a version without the chosen clips. The previous version keeps them, and ingestion leaves them out as long as
/// their files are unchanged.
///
/// # Errors
/// No clip is chosen, or all are; labels of people would be lost and `drop_labels` does not allow it; or the folder cannot
/// be written.
pub fn remove(
    transaction: Transaction,
    choice: &Choice,
    drop_labels: bool,
) -> Result<Removed, Error> {
    let root = transaction.root().to_owned();
    let Planned {
        dataset,
        chosen,
        before,
        labels,
        left,
        mut shards,
        mut report,
    } = Planned::of(&root, choice)?;
    let manifest = dataset.manifest();
    report.dry_run = false;
    check_lost(&root, &report.lost, drop_labels)?;
    let skeleton = dataset.skeleton()?;
    let plan = plan_hash("remove", &(&manifest.root_hash, &report.removed));
    let mut tables = shards.without(&transaction, &chosen)?;
    let written = labels.write(&before, &transaction, &skeleton, &plan)?;
    let mut skipped: Vec<SkippedRow> = dataset.read(None)?;
    let num_left = left.len() as u64;
    skipped.extend(left);
    let facts = table_facts(&skeleton, &plan);
    tables.insert(
        SkippedRow::TABLE.to_owned(),
        transaction.write_shards(None, &skipped, &facts)?,
    );
    tables.extend(written);
    let changed: BTreeSet<String> = tables.keys().cloned().collect();
    let mut plans = manifest.plans.clone();
    plans.retain(|table, _| !changed.contains(table) && !report.left_tables.contains(table));
    for (table, files) in &manifest.tables {
        if !report.left_tables.contains(table) {
            tables.entry(table.clone()).or_insert_with(|| files.clone());
        }
    }
    tables.retain(|table, files| !files.is_empty() || table == MotionRow::TABLE);
    let motions = tables.get(MotionRow::TABLE).into_iter().flatten();
    let licenses = license::count(&root, motions)?;
    let mut facts = manifest.facts.clone();
    facts.insert(LICENSES_FACT.to_owned(), json(&licenses));
    let done = transaction.commit(Commit {
        tables,
        plan_hash: plan,
        plans,
        skeleton,
        accounting: Some(accounting(&manifest.accounting, num_left)),
        facts,
        fresh: true,
        ..Commit::default()
    })?;
    report.tables = done.manifest().row_counts();
    report.root_hash.clone_from(&done.manifest().root_hash);
    Ok(report)
}

/// Removes the labels of the `chosen` clips. Returns the remaining labels, the removed ones that people made, and the
/// number of other removed ones by table.
fn without(
    before: &Labels,
    chosen: &BTreeSet<MotionId>,
) -> (Labels, Vec<LostLabel>, BTreeMap<String, u64>) {
    let mut labels = before.clone();
    let mut gone = Vec::new();
    let mut dropped: BTreeMap<String, u64> = BTreeMap::new();
    let mut leaves = |table: &str, id: &str, clips: Vec<&MotionId>, of_people: bool| {
        let Some(clip) = clips.into_iter().find(|clip| chosen.contains(*clip)) else {
            return false;
        };
        match of_people {
            true => {
                let reason = format!("{clip} is to be removed");
                gone.push(LostLabel::new(table, id, clip, reason));
            }
            false => *dropped.entry(table.to_owned()).or_default() += 1,
        }
        true
    };
    labels
        .masks
        .retain(|id, mask| !leaves(MaskRow::TABLE, id, mask.clips(), is_mask_of_people(mask)));
    labels
        .pairs
        .retain(|id, pair| !leaves(PairRow::TABLE, id, pair.clips(), is_pair_of_people(pair)));
    (labels, gone, dropped)
}

/// A file of a table of clips, and the ids of its rows.
type File = (&'static str, FileEntry, Vec<MotionId>);

/// The shards of clips by the name of their files: motions, with their markers and features beside them.
struct Shards(BTreeMap<String, (Split, Vec<File>)>);

impl Shards {
    fn read(dataset: &Dataset) -> Result<Self, Error> {
        let mut shards = BTreeMap::new();
        for table in CLIP_TABLES {
            for (path, file) in dataset.files(table, None) {
                let reader = ShardReader::open(&path)?;
                let split = file.split.unwrap_or(Split::Train);
                let (_, files) = shards
                    .entry(file.name().to_owned())
                    .or_insert_with(|| (split, Vec::new()));
                files.push((table, file.clone(), clip_ids(table, &reader)?));
            }
        }
        Ok(Self(shards))
    }

    fn num_clips(&self) -> usize {
        let files = self.0.values().flat_map(|(_, files)| files);
        let ids = files.flat_map(|(_, _, ids)| ids);
        ids.collect::<BTreeSet<_>>().len()
    }

    /// Files of all shards after removing clips. Shards without any of the clips stay unchanged.
    fn without(
        &mut self,
        transaction: &Transaction,
        chosen: &BTreeSet<MotionId>,
    ) -> Result<BTreeMap<String, Vec<FileEntry>>, Error> {
        let is_broken = |files: &[File]| {
            let mut ids = files.iter().flat_map(|(_, _, ids)| ids);
            ids.any(|id| chosen.contains(id))
        };
        let mut of: BTreeMap<Split, usize> = BTreeMap::new();
        for (split, files) in self.0.values() {
            *of.entry(*split).or_default() += usize::from(is_broken(files));
        }
        let mut next: BTreeMap<Split, usize> = BTreeMap::new();
        let mut tables: BTreeMap<String, Vec<FileEntry>> = BTreeMap::new();
        for (split, files) in self.0.values() {
            let broken = is_broken(files);
            let index = next.get(split).copied().unwrap_or(0);
            for (table, file, _) in files {
                let entries = tables.entry((*table).to_owned()).or_default();
                if !broken {
                    entries.push(file.clone());
                    continue;
                }
                let name = ShardName {
                    table,
                    split: Some(*split),
                    index,
                    of: of.get(split).copied().unwrap_or(1),
                };
                let stays = |id: &MotionId| (!chosen.contains(id)).then_some("");
                let facts = ShardReader::open(&transaction.root().join(&file.path))?.facts();
                let facts = borrowed(&facts);
                entries.extend(rewrite(transaction, &name, file, &facts, &stays)?);
            }
            *next.entry(*split).or_default() += usize::from(broken);
        }
        Ok(tables)
    }
}
