//! The labels of an export, which replace those implied by the layout of the release.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::MotionId;
use datasets_spec::record::{MaskRow, PairRow};
use serde::de::DeserializeOwned;

use super::origin::{self, CODE_OF_ORIGIN, Origin, Record};
use crate::source::format::Entry;
use crate::source::stored_labels::StoredLabels;
use clip::{Rejected, RotationSource, SourceClip, rejected};

/// Labels of an export's motions.
pub(super) struct Labels {
    pub(super) record: Record,
    stored: StoredLabels,
    /// Motion ids by content hash.
    contents: BTreeMap<String, String>,
}

impl Labels {
    pub(super) fn new(record: Record, masks: Vec<MaskRow>, pairs: Vec<PairRow>) -> Self {
        let mut stored = StoredLabels::default();
        stored.add_masks(masks);
        stored.add_pairs(pairs);
        let origins = record.motions.values();
        let contents = origins.map(|origin| {
            let hash = origin.content_hash.clone().unwrap_or_default();
            (hash, origin.id.clone())
        });
        Self {
            contents: contents.collect(),
            stored,
            record,
        }
    }

    /// Refuses a file whose motion differs from the recorded one.
    pub(super) fn check(
        &self,
        entry: &Entry,
        origin: &Origin,
        clip: &SourceClip,
    ) -> Result<(), Rejected> {
        let found = clip.motion.content_hash();
        let Some(written) = origin.content_hash.as_ref().filter(|hash| **hash != found) else {
            return Ok(());
        };
        let holds = match self.contents.get(&found) {
            Some(other) => format!("that of {other:?}"),
            None => format!("another one, of content {found}"),
        };
        Err(rejected!(
            CODE_OF_ORIGIN,
            "{} says that {} holds the motion of {:?}, of content {written}, but it holds {holds}; restore the \
                 file, or remove its entry to ingest it as a motion of its own",
            origin::FILE_NAME,
            entry.file,
            origin.id
        ))
    }

    /// Adds the labels of a motion other than captions and names.
    pub(super) fn attach(&self, origin: &Origin, clip: &mut SourceClip) {
        let rotation_source = RotationSource::of_name(&origin.rotation_source);
        clip.rotation_source = rotation_source.unwrap_or_default();
        clip.fit_error_m = origin.fit_error_m;
        clip.part_captions.clone_from(&origin.part_captions);
        clip.masks.extend(self.stored.masks_of(&origin.id));
        clip.edits.extend(self.stored.edits_of(&origin.id));
    }

    /// A remark on the motions without a file, and on their labels; `None` if every motion has its file.
    pub(super) fn missing(&self, is_there: impl Fn(&str) -> bool) -> Option<String> {
        let ids = self
            .record
            .motions
            .values()
            .map(|origin| origin.id.as_str());
        let ids: BTreeSet<&str> = ids.filter(|id| !is_there(id)).collect();
        let masks = self
            .stored
            .masks
            .iter()
            .filter(|(id, _)| ids.contains(id.as_str()));
        let masks: usize = masks.map(|(_, masks)| masks.len()).sum();
        let pairs = self.stored.pairs.values().flatten().filter(|pair| {
            ids.contains(pair.source_id.as_str()) || ids.contains(pair.target_id.as_str())
        });
        let pairs = pairs.count();
        let first = ids.first()?;
        Some(format!(
            "{} motions of {} have no file, such as {first:?}; their {masks} masks and {pairs} pairs are left out",
            ids.len(),
            origin::FILE_NAME
        ))
    }
}

/// Reads masks or pairs, and checks that the motions that they name are known.
pub(super) fn rows_of<R: DeserializeOwned>(
    bytes: &[u8],
    ids: &BTreeSet<&str>,
    named: fn(&R) -> Vec<&MotionId>,
) -> Result<Vec<R>, String> {
    let rows: Vec<R> = origin::rows(bytes)?;
    let named = rows.iter().flat_map(named);
    let unknown = named.map(MotionId::as_str).find(|id| !ids.contains(id));
    let problem = unknown.map(|id| format!("{} has no motion {id:?}", origin::FILE_NAME));
    problem.map_or(Ok(rows), Err)
}
