//! What stays of a dataset that grows: clips whose files are as they were, and labels of clips that are
//! still there.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::dataset::ShardName;
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{
    HumanMl3dRow, MarkerRow, MaskRow, MotionRow, PairRow, QuarantineRow, SkippedRow,
};
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{MotionId, Split, Transaction};
use serde::Serialize;

use super::plan::Plan;
use super::recorded::Recorded;
use super::sources::{SourceLabel, lies_in};
use crate::Error;
use crate::annotation::pairs::is_from_labels;
use crate::clip::LabelProblem;
use crate::clip_table::ClipRow;
use crate::source::format_named;

/// What became of the clips and labels that a dataset had.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Growth {
    /// Clips that the dataset did not have.
    pub new: u64,
    /// Clips that stay as they are, without their files being read.
    pub kept: u64,
    /// Clips that were read again although their files did not change: labels or settings did.
    pub read_again: Vec<String>,
    /// Clips whose files changed.
    pub changed: Vec<String>,
    /// Clips whose files lie elsewhere now.
    pub moved: Vec<String>,
    /// Clips whose files are gone.
    pub gone: Vec<String>,
    /// Masks and pairs that stay.
    pub labels: BTreeMap<String, u64>,
    /// Masks and pairs that are lost, with the reason. The version before keeps them.
    pub lost: Vec<LostLabel>,
    /// Tables that were composed of clips that changed or went; their commands make them again.
    pub dropped_tables: Vec<String>,
}

/// A mask or pair whose clip changed or went.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LostLabel {
    /// The table: masks or pairs.
    pub table: String,
    /// Id of the row.
    pub id: String,
    /// The clip, and what happened to it.
    pub reason: String,
}

/// What becomes of a recorded clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    /// Its source is not among those of this run, or cannot be read now.
    Elsewhere,
    Kept,
    /// It is read again; whether its file is the same.
    ReadAgain {
        is_same_file: bool,
    },
    Gone,
}

/// The fates of all recorded clips.
pub(super) struct Fates<'a> {
    recorded: &'a Recorded,
    fates: Vec<Fate>,
    of_id: BTreeMap<&'a str, usize>,
}

/// Labels of the version before: those that stay and those that are lost.
#[derive(Default)]
pub(super) struct Labels {
    pub(super) masks: Vec<MaskRow>,
    pub(super) pairs: Vec<PairRow>,
    pub(super) lost: Vec<LostLabel>,
}

/// Files of tables that are written shard by shard, by table.
pub(super) type Files = BTreeMap<String, Vec<FileEntry>>;

impl Growth {
    /// Adds what became of the labels.
    pub(super) fn count(&mut self, labels: &Labels) {
        let counts = [
            (MaskRow::TABLE, labels.masks.len()),
            (PairRow::TABLE, labels.pairs.len()),
        ];
        let counts = counts.into_iter().filter(|(_, count)| *count > 0);
        self.labels = counts
            .map(|(table, count)| (table.to_owned(), count as u64))
            .collect();
        self.lost.clone_from(&labels.lost);
    }
}

impl<'a> Fates<'a> {
    pub(super) fn of(plan: &Plan, recorded: &'a Recorded) -> Self {
        let labels = plan.all_labels(recorded);
        let mut fates: Vec<Fate> = recorded
            .clips
            .iter()
            .map(|clip| match plan.is_of_run(&clip.path, &labels) {
                true => Fate::Gone,
                false => Fate::Elsewhere,
            })
            .collect();
        for item in &plan.items {
            let Some(index) = item.known else { continue };
            fates[index] = match item.is_kept {
                true => Fate::Kept,
                false => Fate::ReadAgain {
                    is_same_file: plan.hash_of(item) == recorded.clips[index].hash,
                },
            };
        }
        let clips = recorded.clips.iter().enumerate();
        Self {
            recorded,
            fates,
            of_id: clips
                .map(|(index, clip)| (clip.id.as_str(), index))
                .collect(),
        }
    }

    fn stays(&self, index: usize) -> bool {
        matches!(self.fates[index], Fate::Kept | Fate::Elsewhere)
    }

    /// The clips that stay as they are, with their splits.
    pub(super) fn staying(&self) -> impl Iterator<Item = (&'a MotionId, Split)> + '_ {
        let clips = self.recorded.clips.iter().enumerate();
        clips
            .filter(|(index, _)| self.stays(*index))
            .map(|(_, clip)| (&clip.id, clip.split))
    }

    /// Number of clips whose source is not among those of this run.
    pub(super) fn num_elsewhere(&self) -> u64 {
        let elsewhere = self.fates.iter().filter(|fate| **fate == Fate::Elsewhere);
        elsewhere.count() as u64
    }

    pub(super) fn nothing_changed(&self) -> bool {
        (0..self.fates.len()).all(|index| self.stays(index))
    }

    /// The shards of which some clips stay and others do not, by split.
    fn broken(&self) -> Vec<(usize, BTreeSet<&'a str>)> {
        let mut staying: BTreeMap<usize, BTreeSet<&str>> = BTreeMap::new();
        let mut broken = BTreeSet::new();
        for (index, clip) in self.recorded.clips.iter().enumerate() {
            let staying = staying.entry(clip.shard).or_default();
            if self.stays(index) {
                staying.insert(clip.id.as_str());
            } else {
                broken.insert(clip.shard);
            }
        }
        staying.retain(|shard, _| broken.contains(shard));
        staying
            .into_iter()
            .filter(|(_, ids)| !ids.is_empty())
            .collect()
    }

    /// Number of shards of each split that are written again.
    pub(super) fn rewritten(&self) -> BTreeMap<Split, usize> {
        let mut counts = BTreeMap::new();
        for (shard, _) in self.broken() {
            *counts.entry(self.recorded.shards[shard].split).or_default() += 1;
        }
        counts
    }

    /// The files of the clips that stay. Shards of which all clips stay are kept; of others, the rows
    /// that stay are written anew. `of` is the number of shards by split that this run writes.
    pub(super) fn shards(
        &self,
        transaction: &Transaction,
        of: &BTreeMap<Split, usize>,
        facts: &[(&str, String)],
    ) -> Result<Files, Error> {
        let mut files = Files::new();
        let all: BTreeSet<usize> = self.recorded.clips.iter().map(|clip| clip.shard).collect();
        let leaving: BTreeSet<usize> = self
            .recorded
            .clips
            .iter()
            .enumerate()
            .filter(|(index, _)| !self.stays(*index))
            .map(|(_, clip)| clip.shard)
            .collect();
        for shard in all.difference(&leaving) {
            for (table, file) in &self.recorded.shards[*shard].files {
                files
                    .entry((*table).to_owned())
                    .or_default()
                    .push(file.clone());
            }
        }
        let mut next: BTreeMap<Split, usize> = BTreeMap::new();
        for (shard, ids) in self.broken() {
            let shard = &self.recorded.shards[shard];
            let index = next.entry(shard.split).or_default();
            for (table, file) in &shard.files {
                let name = ShardName {
                    table,
                    split: Some(shard.split),
                    index: *index,
                    of: of.get(&shard.split).copied().unwrap_or(0),
                };
                let rewrite = match *table {
                    MotionRow::TABLE => rewrite::<MotionRow>,
                    MarkerRow::TABLE => rewrite::<MarkerRow>,
                    _ => rewrite::<HumanMl3dRow>,
                };
                let written = rewrite(transaction, &name, file, facts, &ids)?;
                files
                    .entry((*table).to_owned())
                    .or_default()
                    .extend(written);
            }
            *index += 1;
        }
        Ok(files)
    }

    /// The labels of clips that are still there. `ingested` are the clips that were read in this run;
    /// before reading, all are taken to be.
    pub(super) fn labels(
        &self,
        masks: Vec<MaskRow>,
        pairs: Vec<PairRow>,
        ingested: Option<&BTreeSet<String>>,
    ) -> Labels {
        let mut labels = Labels::default();
        for mask in masks {
            // Reading the source makes its masks again, and a stage makes the automatic ones.
            let from_source =
                mask.text_origin == "imported" && format_named(&mask.author).is_some();
            match self.place(&mask.motion_id, ingested) {
                Ok(Place::ReadAgain) if from_source => {}
                Ok(_) => labels.masks.push(mask),
                Err(_) if from_source || mask.text_origin == "automatic" => {}
                Err(reason) => labels.lose(MaskRow::TABLE, mask.id, reason),
            }
        }
        for pair in pairs {
            let from_source = format_named(&pair.source).is_some();
            let [source, target] =
                [&pair.source_id, &pair.target_id].map(|id| self.place(id, ingested));
            match source.and(target) {
                Ok(Place::ReadAgain) if from_source => {}
                Ok(_) => labels.pairs.push(pair),
                Err(_) if from_source || is_from_labels(&pair) => {}
                Err(reason) => labels.lose(PairRow::TABLE, pair.id, reason),
            }
        }
        labels
    }

    /// Recorded problems of labels that are as they were.
    pub(super) fn label_problems(
        &self,
        plan: &Plan,
        recorded: Vec<LabelProblem>,
    ) -> Vec<LabelProblem> {
        let labels = plan.all_labels(self.recorded);
        let hashes: BTreeMap<&str, &str> = self
            .recorded
            .skipped
            .iter()
            .map(|row| (row.path.as_str(), row.source_hash.as_str()))
            .collect();
        let is_same = |file: &str| {
            let now = plan
                .sources
                .get(file)
                .and_then(|source| source.hash.as_deref().ok());
            now.is_some() && now == hashes.get(file).copied()
        };
        let mut problems = recorded;
        problems
            .retain(|problem| is_same(&problem.file) || !plan.is_of_run(&problem.file, &labels));
        problems
    }

    /// Where a clip with a label is; an error if its labels do not hold for it any more.
    fn place(&self, id: &MotionId, ingested: Option<&BTreeSet<String>>) -> Result<Place, String> {
        let fate = self.of_id.get(id.as_str()).map(|&index| self.fates[index]);
        let is_rejected = || ingested.is_some_and(|ingested| !ingested.contains(id.as_str()));
        match fate {
            Some(Fate::Kept | Fate::Elsewhere) => Ok(Place::Stays),
            Some(Fate::ReadAgain { .. }) if is_rejected() => {
                Err(format!("{id} cannot be used any more"))
            }
            Some(Fate::ReadAgain { is_same_file: true }) => Ok(Place::ReadAgain),
            Some(Fate::ReadAgain { .. }) => Err(format!("the file of {id} changed")),
            Some(Fate::Gone) => Err(format!("the file of {id} is gone")),
            None => Err(format!("{id} is not in the dataset")),
        }
    }

    /// What became of the clips. `plan` is the one the fates are of.
    pub(super) fn report(&self, plan: &Plan, ingested: &BTreeSet<String>) -> Growth {
        let with = |wanted: fn(Fate) -> bool| -> Vec<String> {
            let clips = self.recorded.clips.iter().zip(&self.fates);
            let found = clips.filter(|(_, fate)| wanted(**fate));
            found.map(|(clip, _)| clip.id.to_string()).collect()
        };
        let moved = plan.items.iter().filter(|item| {
            let clip = item.known.map(|index| &self.recorded.clips[index]);
            clip.is_some_and(|clip| clip.path != item.entry.file)
        });
        let new = ingested
            .iter()
            .filter(|id| !self.of_id.contains_key(id.as_str()));
        Growth {
            new: new.count() as u64,
            kept: self.staying().count() as u64,
            read_again: with(|fate| fate == Fate::ReadAgain { is_same_file: true }),
            changed: with(|fate| {
                fate == Fate::ReadAgain {
                    is_same_file: false,
                }
            }),
            moved: moved.map(|item| item.id.clone()).collect(),
            gone: with(|fate| fate == Fate::Gone),
            ..Growth::default()
        }
    }
}

/// Rejected items of sources that a run does not read.
#[derive(Default)]
pub(super) struct Outside {
    pub(super) quarantine: Vec<QuarantineRow>,
    pub(super) skipped: Vec<SkippedRow>,
}

impl Plan {
    /// The rejected items of sources that are not of this run.
    pub(super) fn outside(&self, recorded: &Recorded) -> Outside {
        let labels: Vec<SourceLabel> = self.all_labels(recorded);
        let is_outside = |path: &str| {
            // The path of one of several motions ends in its key.
            let file = path.split_once('#').map_or(path, |(file, _)| file);
            let here = |path| self.sources.contains_key(path) || self.is_of_run(path, &labels);
            !here(path) && !here(file)
        };
        let quarantine = recorded.quarantine.iter();
        let skipped = recorded.skipped.iter();
        Outside {
            quarantine: quarantine
                .filter(|row| is_outside(&row.path))
                .cloned()
                .collect(),
            skipped: skipped
                .filter(|row| is_outside(&row.path))
                .cloned()
                .collect(),
        }
    }

    /// Whether this run rejects what is recorded as rejected.
    pub(super) fn has_rejected(&self, recorded: &Recorded, outside: &Outside) -> bool {
        let codes = |rows: &[QuarantineRow]| -> BTreeSet<(String, String, String)> {
            let rows = rows.iter();
            rows.map(|row| (row.path.clone(), row.source_hash.clone(), row.code.clone()))
                .collect()
        };
        let reasons = |rows: &[SkippedRow]| -> BTreeSet<(String, String, String)> {
            let rows = rows.iter();
            rows.map(|row| {
                (
                    row.path.clone(),
                    row.source_hash.clone(),
                    row.reason.clone(),
                )
            })
            .collect()
        };
        let (mut now, mut skipped) = (codes(&self.rejected), reasons(&self.skipped));
        now.extend(codes(&outside.quarantine));
        skipped.extend(reasons(&outside.skipped));
        now == codes(&recorded.quarantine) && skipped == reasons(&recorded.skipped)
    }

    /// The sources of the dataset with those of this run.
    pub(super) fn all_labels(&self, recorded: &Recorded) -> Vec<SourceLabel> {
        let mut sources = recorded.sources.clone();
        for (source, is_file) in &self.labels {
            let known = sources.iter().any(|known| known.label == source.label);
            if !known && !is_file {
                sources.push(source.clone());
            }
        }
        sources.sort_by(|a, b| a.label.cmp(&b.label));
        sources
    }

    /// The sources of the dataset, as JSON.
    pub(super) fn all_sources(&self, recorded: &Recorded) -> String {
        serde_json::to_string(&self.all_labels(recorded)).expect("texts serialise")
    }
}

/// Where a clip is whose labels stay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Stays,
    ReadAgain,
}

impl Labels {
    /// Brings the labels into the splits of their clips. Pairs whose clips are in two splits now are lost.
    pub(super) fn follow(&mut self, splits: &BTreeMap<&str, Split>) {
        for mask in &mut self.masks {
            let split = splits.get(mask.motion_id.as_str());
            mask.split = split.copied().unwrap_or(mask.split);
        }
        for mut pair in std::mem::take(&mut self.pairs) {
            let [source, target] =
                [&pair.source_id, &pair.target_id].map(|id| splits.get(id.as_str()));
            if source == target {
                pair.split = source.copied().unwrap_or(pair.split);
                self.pairs.push(pair);
            } else {
                let reason = "its clips are in two splits now".to_owned();
                self.lose(PairRow::TABLE, pair.id, reason);
            }
        }
    }

    fn lose(&mut self, table: &str, id: String, reason: String) {
        self.lost.push(LostLabel {
            table: table.to_owned(),
            id,
            reason,
        });
    }
}

impl Plan {
    /// Whether a path lies in a folder that could not be listed.
    fn is_unlisted(&self, path: &str) -> bool {
        self.unlisted.iter().any(|folder| {
            let folder = folder.strip_suffix('.').unwrap_or(folder);
            folder.is_empty() || path.starts_with(&format!("{}/", folder.trim_end_matches('/')))
        })
    }

    /// Whether a recorded path lies in one of the sources of this run, and can be read if it is there.
    pub(super) fn is_of_run(&self, path: &str, labels: &[SourceLabel]) -> bool {
        match self.sources.get(path) {
            Some(source) => source.hash.is_ok() && !self.staying.contains(path),
            None if self.is_unlisted(path) => false,
            None => self
                .labels
                .iter()
                .any(|(source, is_file)| !is_file && lies_in(&source.label, path, labels)),
        }
    }
}

/// Writes the rows of the clips `staying` as a shard, if there are any.
fn rewrite<R: ClipRow>(
    transaction: &Transaction,
    name: &ShardName,
    file: &FileEntry,
    facts: &[(&str, String)],
    staying: &BTreeSet<&str>,
) -> Result<Option<FileEntry>, Error> {
    let mut rows: Vec<R> = read_rows(&transaction.root().join(&file.path))?;
    rows.retain(|row| staying.contains(row.id().as_str()));
    if rows.is_empty() {
        return Ok(None);
    }
    Ok(Some(transaction.write_shard(name, &rows, facts)?))
}
