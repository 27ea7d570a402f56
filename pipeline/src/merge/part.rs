//! One of the two datasets of a merge.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::record::{QuarantineRow, SkippedRow};
use datasets_spec::{Dataset, MotionId, Split};

use crate::Error;
use crate::clip_table::{ClipRow, clip_facts};
use crate::ingest::{MergedSources, with_label};

/// One of the two datasets, with the new ids and splits of its clips.
pub(super) struct Part<'a> {
    pub(super) dataset: &'a Dataset,
    /// 0 for the first dataset, 1 for the second.
    pub(super) number: usize,
    pub(super) sources: &'a MergedSources,
    /// Prefix of this dataset's paths in the result.
    pub(super) label: String,
    pub(super) shared: BTreeSet<MotionId>,
    pub(super) ids: BTreeMap<MotionId, MotionId>,
    pub(super) splits: BTreeMap<MotionId, Split>,
}

impl<'a> Part<'a> {
    pub(super) fn new(
        dataset: &'a Dataset,
        number: usize,
        sources: &'a MergedSources,
        label: &str,
    ) -> Self {
        Self {
            dataset,
            number,
            sources,
            label: label.to_owned(),
            shared: BTreeSet::new(),
            ids: BTreeMap::new(),
            splits: BTreeMap::new(),
        }
    }

    pub(super) fn id(&self, id: &MotionId) -> MotionId {
        self.ids.get(id).unwrap_or(id).clone()
    }

    pub(super) fn path(&self, path: &str) -> String {
        with_label(&self.label, path)
    }

    /// The row and its split in the result; `None` if the other dataset has the clip.
    pub(super) fn take<R: ClipRow>(&self, mut row: R) -> Option<(Split, R)> {
        let clip = row.of_clip();
        if self.shared.contains(&*clip.id) {
            return None;
        }
        if let Some([name, path]) = clip.source {
            *name = self.sources.name(self.number, name, path);
            *path = self.path(path);
        }
        if let Some(mirrored) = clip.mirrored_of
            && let Ok(id) = MotionId::parse(mirrored)
        {
            *mirrored = self.id(&id).to_string();
        }
        let split = *self.splits.get(&*clip.id).unwrap_or(&*clip.split);
        *clip.split = split;
        *clip.id = self.id(clip.id);
        Some((split, row))
    }

    /// Adds the items that the dataset rejected or skipped, and its clips that the other dataset already has.
    pub(super) fn passed_over(
        &self,
        quarantine: &mut Vec<QuarantineRow>,
        skipped: &mut Vec<SkippedRow>,
    ) -> Result<(), Error> {
        let name = |name: &str, path: &str| self.sources.name(self.number, name, path);
        for row in self.dataset.read::<QuarantineRow>(None)? {
            quarantine.push(QuarantineRow {
                source_name: name(&row.source_name, &row.path),
                path: self.path(&row.path),
                ..row
            });
        }
        for row in self.dataset.read::<SkippedRow>(None)? {
            skipped.push(SkippedRow {
                source_name: name(&row.source_name, &row.path),
                path: self.path(&row.path),
                ..row
            });
        }
        let clips = clip_facts(self.dataset)?.into_iter().map(|(_, clip)| clip);
        let shared = clips.filter(|clip| self.shared.contains(&clip.id));
        skipped.extend(shared.map(|clip| self.sources.shared_row(clip)));
        Ok(())
    }
}
