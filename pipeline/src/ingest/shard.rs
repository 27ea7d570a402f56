//! Making a shard: reading its items and writing their rows.

use std::cell::Cell;
use std::path::Path;

use clip::{LabelProblem, Outcome, Rejected};
use datasets_spec::Progress;
use datasets_spec::dataset::{ShardName, Staging};
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{MaskRow, PairRow, QuarantineRow, SkippedRow};
use datasets_spec::table::Row;
use formats::source::labels::{self, ClipLabels};
use formats::source::{Entry, ReadOptions, label, read_clip};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::content::{bounded_length, companions};
use super::deal::Item;
use super::list::{path_of, source_hash};
use super::options::IngestOptions;
use super::plan::Plan;
use super::rows::{ClipRows, clip_rows, mask_row, pair_row};
use crate::Error;

/// Data of a shard for the commit, beside its file.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct ShardNotes {
    pub(super) quarantine: Vec<QuarantineRow>,
    pub(super) skipped: Vec<SkippedRow>,
    /// Files of other tables that were written with the shard.
    pub(super) beside: Vec<(String, FileEntry)>,
    pub(super) ingested: Vec<String>,
    /// Hashes of the ingested motions, in the order of `ingested`.
    #[serde(default)]
    pub(super) contents: Vec<String>,
    pub(super) pairs: Vec<PairRow>,
    /// Number of pairs whose other motion has no usable id.
    pub(super) dropped_pairs: u64,
    pub(super) masks: Vec<MaskRow>,
    pub(super) label_problems: Vec<LabelProblem>,
}

/// Size in bytes above which the headers of a file are checked before it is read.
const LARGE_LEN: usize = 64 << 20;

/// Stage of a quarantined item whose piece failed as a whole.
pub(super) const PIECE_STAGE: &str = "piece";

impl ShardNotes {
    /// Notes of a piece that failed as a whole: each of its items is rejected.
    pub(super) fn failed(plan: &Plan, items: &[Item], code: &str, reason: &str) -> Self {
        let rows = items.iter().map(|item| QuarantineRow {
            path: path_of(&item.planned.entry.file, &item.planned.entry.key),
            source_name: item.source_name.to_owned(),
            source_hash: source_hash(&plan.sources, &item.planned.entry.file).to_owned(),
            inputs_hash: item.planned.inputs.clone(),
            code: code.to_owned(),
            reason: reason.to_owned(),
            byte_offset: None,
            stage: PIECE_STAGE.to_owned(),
        });
        Self {
            quarantine: rows.collect(),
            ..Self::default()
        }
    }

    pub(super) fn files<'a>(&'a self, shard: &'a FileEntry) -> impl Iterator<Item = &'a FileEntry> {
        std::iter::once(shard).chain(self.beside.iter().map(|(_, file)| file))
    }
}

pub(super) enum Done {
    Clip(Box<ClipRows>, Vec<LabelProblem>),
    Skipped(String),
    Rejected(QuarantineRow),
}

impl Plan {
    /// Reads the items of a shard and stages their rows.
    pub(super) fn make_shard(
        &self,
        staging: &Staging,
        name: &ShardName,
        items: &[Item],
        options: &IngestOptions,
        facts: &[(&str, String)],
        progress: &dyn Progress,
    ) -> Result<(FileEntry, ShardNotes), Error> {
        let done = self.read_items(items, options, progress);
        let mut rows = Vec::with_capacity(done.len());
        let mut marker_rows = Vec::new();
        let mut feature_rows = Vec::new();
        let mut notes = ShardNotes::default();
        for (item, done) in items.iter().zip(done) {
            match done {
                Done::Clip(clip, problems) => {
                    notes.label_problems.extend(problems);
                    let ClipRows {
                        motion,
                        features,
                        markers,
                        edits,
                        masks,
                    } = *clip;
                    notes.ingested.push(motion.id.as_str().to_owned());
                    notes.contents.push(motion.content_hash.clone());
                    for edit in edits {
                        match pair_row(edit, item, &motion.id) {
                            Some(row) => notes.pairs.push(row),
                            None => notes.dropped_pairs += 1,
                        }
                    }
                    let masks = masks.into_iter();
                    let masks = masks.map(|mask| mask_row(mask, item, &motion.id));
                    notes.masks.extend(masks);
                    marker_rows.extend(markers);
                    feature_rows.extend(features);
                    rows.push(motion);
                }
                Done::Skipped(reason) => {
                    let Entry { file, key, .. } = &item.planned.entry;
                    let row = self.skipped_row(file, key, &item.planned.inputs, reason);
                    notes.skipped.push(row);
                }
                Done::Rejected(rejection) => notes.quarantine.push(rejection),
            }
        }
        let beside = &mut notes.beside;
        beside.extend(write_beside(staging, name, &marker_rows, facts)?);
        beside.extend(write_beside(staging, name, &feature_rows, facts)?);
        let entry = staging.write_shard(name, &rows, facts)?;
        Ok((entry, notes))
    }

    pub(super) fn read_items(
        &self,
        items: &[Item],
        options: &IngestOptions,
        progress: &dyn Progress,
    ) -> Vec<Done> {
        let done = items.par_iter().map(|item| {
            let done = self.ingest_item(item, options);
            progress.advance(1);
            done
        });
        done.collect()
    }

    fn ingest_item(&self, item: &Item, options: &IngestOptions) -> Done {
        let read = guarded(|| self.read_checked(item, options));
        read.unwrap_or_else(|rejected| {
            let Entry { file, key, .. } = &item.planned.entry;
            Done::Rejected(QuarantineRow {
                inputs_hash: item.planned.inputs.clone(),
                ..self.rejected_row(file, key, rejected)
            })
        })
    }

    fn read_checked(&self, item: &Item, options: &IngestOptions) -> Result<Done, Rejected> {
        let id = item
            .id
            .clone()
            .map_err(|reason| Rejected::read("E-PATH", reason))?;
        let entry = &item.planned.entry;
        let source_hash = self
            .motion_hash(item.planned.release, entry)
            .map_err(|reason| Rejected::read("E-IO", reason))?;
        let around = self.folder_labels.of(&self.files, entry);
        let outcome = match item.planned.release {
            Some(release) => self.releases[release]
                .1
                .read(&self.files, entry, &options.read)
                .map(|clip| labels::attach_around(clip, &around))
                .into(),
            None => self.read_file(item, &around, options),
        };
        let mut clip = match outcome {
            Outcome::Clip(clip) => *clip,
            Outcome::Skipped { reason } => return Ok(Done::Skipped(reason)),
            Outcome::Rejected(rejected) => return Err(rejected),
        };
        clip.check_masks(&item.planned.entry.file);
        let (rows, problems) = clip_rows(clip, id, item, source_hash, options)?;
        Ok(Done::Clip(Box::new(rows), problems))
    }

    fn read_file(&self, item: &Item, around: &ClipLabels, options: &IngestOptions) -> Outcome {
        let failure = Cell::new(None);
        let companions = companions(&self.files, &item.planned.entry.file, &failure);
        let outcome = self.read_content(item, &companions, around, &options.read);
        let outcome = outcome.unwrap_or_else(Outcome::Rejected);
        failure.take().map_or(outcome, Outcome::Rejected)
    }

    fn read_content(
        &self,
        item: &Item,
        companions: &dyn Fn(&str) -> Option<Vec<u8>>,
        around: &ClipLabels,
        options: &ReadOptions,
    ) -> Result<Outcome, Rejected> {
        let Entry { file, key, .. } = &item.planned.entry;
        let path = Path::new(file);
        let length = bounded_length(&self.files, file)?;
        if length > LARGE_LEN
            && let Some(rejected) = (item.planned.format.refuse_large)(self.files.open_at(file)?)
        {
            return Err(rejected);
        }
        let mut opened = self.files.open(file)?;
        let options = &*labels::options_of(path, companions, options);
        if let Some(outcome) = (item.planned.format.read_in_pieces)(&mut *opened, length, options) {
            return Ok(label(outcome, path, companions, around));
        }
        let bytes = self.files.read(file)?;
        Ok(read_clip(
            item.planned.format,
            path,
            key,
            &bytes,
            companions,
            around,
            options,
        ))
    }
}

/// Runs a reader. Readers should not panic, but a bug in one of them must not lose other files.
pub(crate) fn guarded<T>(read: impl FnOnce() -> Result<T, Rejected>) -> Result<T, Rejected> {
    let read = std::panic::catch_unwind(std::panic::AssertUnwindSafe(read));
    read.unwrap_or_else(|_| {
        Err(Rejected::read(
            "E-INTERNAL",
            "the reader failed on this file; please report it",
        ))
    })
}

/// Writes the rows of another table as a shard that accompanies one of motions, if there are any.
fn write_beside<R: Row>(
    staging: &Staging,
    name: &ShardName,
    rows: &[R],
    facts: &[(&str, String)],
) -> Result<Option<(String, FileEntry)>, Error> {
    if rows.is_empty() {
        return Ok(None);
    }
    let name = ShardName {
        table: R::TABLE,
        ..name.clone()
    };
    let file = staging.write_shard(&name, rows, facts)?;
    Ok(Some((R::TABLE.to_owned(), file)))
}
