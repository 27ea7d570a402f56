//! Clips that the owner of a dataset removed, or did not select.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::record::SkippedRow;

use super::plan::{Plan, Planned};
use super::recorded::Recorded;
use crate::versions::taken_out;

impl Plan {
    /// Leaves out clips that the dataset's owner took out, while their files are as they were, in their place or
    /// elsewhere. Their rows stay.
    pub(super) fn leave_out(&mut self, items: &mut Vec<Planned>, recorded: &Recorded) {
        let mut by_hash: BTreeMap<&str, Vec<(&str, &SkippedRow)>> = BTreeMap::new();
        for row in &recorded.skipped {
            if let Some(id) = taken_out(row).filter(|_| !row.source_hash.is_empty()) {
                by_hash.entry(&row.source_hash).or_default().push((id, row));
            }
        }
        if by_hash.is_empty() {
            return;
        }
        let known: BTreeSet<&str> = recorded
            .clips
            .iter()
            .map(|clip| clip.path.as_str())
            .collect();
        let mut left = Vec::new();
        items.retain(|item| {
            let file = item.entry.file.as_str();
            let rows = by_hash.get(self.hash_of(item)).into_iter().flatten();
            let found = rows.clone().find(|(id, row)| {
                let is_there = self.sources.contains_key(&row.path);
                let moved = !is_there && !known.contains(file);
                (row.path == file || moved) && is_named(item, id)
            });
            left.extend(found.map(|(_, row)| SkippedRow {
                path: file.to_owned(),
                ..(*row).clone()
            }));
            found.is_none()
        });
        self.skipped.extend(left);
    }
}

/// Whether a motion of a file is the one that a clip with this id was read from, if the file is.
fn is_named(item: &Planned, id: &str) -> bool {
    match item.release {
        Some(_) => {
            let prefix = id.strip_suffix(&item.entry.id);
            prefix.is_some_and(|prefix| prefix.is_empty() || prefix.ends_with('/'))
        }
        None => id.split_once('#').map_or("", |(_, key)| key) == item.entry.key,
    }
}
