//! Masks and pairs as rows of a dataset's tables, by motion.

use std::collections::BTreeMap;

use datasets_spec::record::{MaskRow, PairRow};

use clip::{EditOf, SourceMask};

/// Masks of motions, and pairs with their targets.
#[derive(Debug, Default)]
pub(super) struct StoredLabels {
    /// Masks by motion.
    pub(super) masks: BTreeMap<String, Vec<MaskRow>>,
    /// Pairs by target.
    pub(super) pairs: BTreeMap<String, Vec<PairRow>>,
}

impl StoredLabels {
    pub(super) fn add_masks(&mut self, rows: Vec<MaskRow>) {
        for mask in rows {
            let of_motion = self.masks.entry(mask.motion_id.to_string());
            of_motion.or_default().push(mask);
        }
    }

    pub(super) fn add_pairs(&mut self, rows: Vec<PairRow>) {
        for pair in rows {
            let of_target = self.pairs.entry(pair.target_id.to_string());
            of_target.or_default().push(pair);
        }
    }

    pub(super) fn masks_of(&self, id: &str) -> Vec<SourceMask> {
        let masks = self.masks.get(id).into_iter().flatten();
        masks.cloned().map(SourceMask::of_row).collect()
    }

    pub(super) fn edits_of(&self, id: &str) -> Vec<EditOf> {
        let pairs = self.pairs.get(id).into_iter().flatten();
        pairs.cloned().map(EditOf::of_row).collect()
    }
}
