//! Selection of clips of a dataset, and the accounting of the rest.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use datasets_spec::manifest::Accounting;
use datasets_spec::record::{MarkerRow, MotionRow, SkippedRow};
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{Dataset, MotionId};
use tables::Condition;

use crate::Error;
use crate::clip_table::{clip_facts, clip_ids};
use crate::clips::Clips;
use crate::ingest::IdList;

const SHOWN: usize = 5;

/// Text after the id in the reason of a clip that its owner removed.
pub(super) const REMOVED: &str = " was removed by its owner";
/// Text after the id in the reason of a clip that is not in a selection.
pub(super) const NOT_SELECTED: &str = " was not selected";

/// A choice of clips.
#[derive(Clone, Debug)]
pub enum Choice {
    /// Clips for which a condition is true.
    Where(Condition),
    /// Clips whose ids are listed in a file, one per line.
    Ids {
        /// The file, for errors.
        path: PathBuf,
        /// The ids.
        ids: BTreeSet<String>,
    },
}

impl Choice {
    /// Reads a list of ids, one per line, with the comments of [`IdList`].
    ///
    /// # Errors
    /// The file cannot be read, is no text, or names nothing.
    pub fn ids(path: &Path) -> Result<Self, Error> {
        Ok(Self::Ids {
            path: path.to_owned(),
            ids: IdList::read(path)?.into_names(),
        })
    }

    pub(super) fn of(&self, dataset: &Dataset) -> Result<BTreeSet<MotionId>, Error> {
        match self {
            Self::Where(filter) => {
                let mut ids = BTreeSet::new();
                for shard in Clips::chosen(dataset, filter)?.shards(None) {
                    ids.extend(shard.column::<MotionId>("id")?);
                }
                Ok(ids)
            }
            Self::Ids { path, ids } => {
                let mut known = BTreeSet::new();
                for table in [MotionRow::TABLE, MarkerRow::TABLE] {
                    for (file, _) in dataset.files(table, None) {
                        known.extend(clip_ids(table, &ShardReader::open(&file)?)?);
                    }
                }
                let (chosen, unknown): (Vec<&String>, Vec<&String>) = ids
                    .iter()
                    .partition(|id| MotionId::parse(id).is_ok_and(|id| known.contains(&id)));
                if !unknown.is_empty() || chosen.is_empty() {
                    let shown: Vec<&str> =
                        unknown.iter().take(SHOWN).map(|id| id.as_str()).collect();
                    let root = dataset.root().display();
                    return Err(Error::refused(format!(
                        "{} ids of {} name no clip of {root}: {}; nothing was changed. `stance inspect {root} --list \
                         clips` shows the ids",
                        unknown.len(),
                        path.display(),
                        shown.join(", ")
                    )));
                }
                known.retain(|id| ids.contains(id.as_str()));
                Ok(known)
            }
        }
    }
}

/// Id of the clip of a skipped row, if its owner removed it or did not select it: ingestion leaves the clip out as long
/// as its file is unchanged.
pub fn taken_out(row: &SkippedRow) -> Option<&str> {
    let reason = row.reason.as_str();
    let id = reason.strip_suffix(REMOVED);
    id.or_else(|| reason.strip_suffix(NOT_SELECTED))
}

/// Rows that account for clips that are left out.
pub(super) fn left_out(
    dataset: &Dataset,
    leaves: impl Fn(&MotionId) -> bool,
    reason: &str,
) -> Result<Vec<SkippedRow>, Error> {
    let clips = clip_facts(dataset)?.into_iter().map(|(_, clip)| clip);
    let mut rows: Vec<SkippedRow> = clips
        .filter(|clip| leaves(&clip.id))
        .map(|clip| SkippedRow {
            path: clip.source_path,
            source_name: clip.source_name,
            source_hash: clip.source_hash,
            inputs_hash: clip.inputs_hash,
            reason: format!("{}{reason}", clip.id),
        })
        .collect();
    rows.sort_by(|a, b| (&a.path, &a.reason).cmp(&(&b.path, &b.reason)));
    Ok(rows)
}

/// The accounting after clips were left out: each of them now counts as a skipped source.
pub(super) fn accounting(before: &Accounting, left_out: u64) -> Accounting {
    let ingested = before.ingested.saturating_sub(left_out);
    let skipped = before.skipped + left_out;
    Accounting {
        sources: ingested + before.quarantined + skipped,
        ingested,
        skipped,
        ..before.clone()
    }
}
