//! Files that cannot be read now. They cost no clip of the dataset.

use std::collections::BTreeSet;

use datasets_spec::record::QuarantineRow;
use formats::source::archive::DAMAGED;

use super::list::path_of;
use super::plan::Plan;
use super::shard::PIECE_STAGE;
use super::sources::below;

/// Whether a rejection says nothing about the content of an item, which may be readable next time.
pub(super) fn is_passing(row: &QuarantineRow) -> bool {
    row.stage == PIECE_STAGE || matches!(row.code.as_str(), "E-IO" | "E-INTERNAL" | DAMAGED)
}

impl Plan {
    /// Ids of the clips of the dataset among these rejected items that could not be read this time.
    pub(super) fn unread_ids(&self, rejected: &[QuarantineRow]) -> BTreeSet<&str> {
        let passing = rejected.iter().filter(|row| is_passing(row));
        let paths: BTreeSet<&str> = passing.map(|row| row.path.as_str()).collect();
        let known = self.items.iter().filter(|item| item.known.is_some());
        let unread = known.filter(|item| {
            let path = path_of(&item.entry.file, &item.entry.key);
            paths.contains(path.as_str())
        });
        unread.map(|item| item.id.as_str()).collect()
    }

    /// Whether a file, or a motion of it, could not be read while planning.
    pub(super) fn is_unread(&self, path: &str) -> bool {
        let mut passing = self.rejected.iter().filter(|row| is_passing(row));
        passing.any(|row| {
            let key = row.path.strip_prefix(path);
            key.is_some_and(|key| key.is_empty() || key.starts_with('#'))
        })
    }

    /// The folder or archive around a path that cannot be read now.
    pub(super) fn unlisted_around(&self, path: &str) -> Option<&str> {
        let mut unlisted = self.notes.unlisted.iter().map(String::as_str);
        unlisted.find(|&folder| {
            // A source that cannot be listed itself is the folder `.`.
            let folder = match folder.strip_suffix('.') {
                Some(above) if above.is_empty() || above.ends_with('/') => above,
                _ => folder,
            };
            below(folder.trim_end_matches('/'), path).is_some()
        })
    }
}
