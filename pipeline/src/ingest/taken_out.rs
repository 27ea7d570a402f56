//! Clips that the owner of a dataset removed, did not select, or does not choose for this run, and those that a dataset
//! has from the file of another source since it was merged.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::record::SkippedRow;
use formats::source::Entry;

use super::id_list::IdList;
use super::plan::{Plan, Planned};
use super::recorded::{IN_BOTH, Recorded};
use crate::versions::taken_out;

/// Why a clip that the user does not choose is skipped.
pub(super) const NOT_CHOSEN: &str = "clip that --ids does not choose";

/// A clip that is not read while its file is unchanged.
struct LeftOut<'a> {
    id: &'a str,
    path: &'a str,
    row: &'a SkippedRow,
}

/// The clips that the dataset's owner took out, and those that the dataset has from the file of another source, by the
/// hash of their file.
fn left_out(recorded: &Recorded) -> BTreeMap<&str, Vec<LeftOut<'_>>> {
    let rows = recorded.skipped.iter();
    let rows = rows.filter(|row| !row.source_hash.is_empty());
    let mut left: Vec<LeftOut<'_>> = rows
        .clone()
        .filter_map(|row| {
            let (id, path) = (taken_out(row)?, row.path.as_str());
            Some(LeftOut { id, path, row })
        })
        .collect();
    // A clip that was pruned since may be read from the other file.
    let mut known: BTreeSet<&str> = left.iter().map(|left| left.id).collect();
    known.extend(recorded.clips.iter().map(|clip| clip.id.as_str()));
    for row in rows.filter(|row| row.reason == IN_BOTH) {
        // File names may contain `#` too, so what follows each `#` is tried as the id.
        let ends = row.path.match_indices('#');
        let ends = ends.map(|(at, _)| (&row.path[..at], &row.path[at + 1..]));
        let clips = ends.filter(|(_, id)| known.contains(id));
        left.extend(clips.map(|(path, id)| LeftOut { id, path, row }));
    }
    let mut by_hash: BTreeMap<&str, Vec<LeftOut<'_>>> = BTreeMap::new();
    for left in left {
        by_hash.entry(&left.row.source_hash).or_default().push(left);
    }
    by_hash
}

impl Plan {
    /// Leaves out the clips of [`left_out`], as long as their files are unchanged, in the same place or elsewhere. Their
    /// rows stay.
    pub(super) fn leave_out(&mut self, items: &mut Vec<Planned>, recorded: &Recorded) {
        let by_hash = left_out(recorded);
        if by_hash.is_empty() {
            return;
        }
        let known = recorded.paths();
        let (mut left, mut entries) = (Vec::new(), Vec::new());
        items.retain(|item| {
            let file = item.entry.file.as_str();
            let hash = self.hash_of(item);
            let found = by_hash.get(&*hash).into_iter().flatten();
            let found = found.filter(|LeftOut { id, .. }| item.is_of(id));
            let mut found = found.filter(|LeftOut { path, row, .. }| {
                let is_there = self.sources.contains_key(*path);
                let moved = !is_there && !known.contains(file);
                // The same file in another source is another clip.
                let is_of_source =
                    row.reason != IN_BOTH || row.source_name == self.source_name(file);
                *path == file || moved && is_of_source
            });
            let Some(LeftOut { path, row, .. }) = found.next() else {
                return true;
            };
            left.push(SkippedRow {
                path: row.path.replacen(path, file, 1),
                ..(*row).clone()
            });
            entries.push(item.entry.clone());
            false
        });
        self.skipped.extend(left);
        self.notes.left_out.extend(entries);
    }

    /// Skips the clips that the user did not choose. Those that the dataset has stay unchanged.
    pub(super) fn choose(&mut self, list: &IdList, recorded: &Recorded) {
        const SHOWN: usize = 10;
        let mut known = BTreeSet::new();
        let (mut skipped, mut left, mut stay) = (Vec::new(), Vec::new(), 0u64);
        let staying = &mut self.notes.staying;
        self.items.retain(|item| {
            let names = item.names();
            let is_chosen = list.chooses(&names);
            known.extend(names);
            if is_chosen {
                return true;
            }
            left.push(item.entry.clone());
            let Entry { file, key, .. } = &item.entry;
            if let Some(clip) = item.known {
                stay += 1;
                staying.insert(recorded.clips[clip].path.clone());
            } else {
                skipped.push((file.clone(), key.clone(), item.inputs.clone()));
            }
            false
        });
        self.notes.left_out.extend(left);
        for (file, key, inputs) in skipped {
            let row = self.skipped_row(&file, &key, &inputs, NOT_CHOSEN.to_owned());
            self.skipped.push(row);
        }
        if stay > 0 {
            self.notes.choice.push(format!(
                "{stay} clips of the dataset are not among those of --ids; they were not read and stay as they are"
            ));
        }
        let unmatched = list.unmatched(&known);
        for (number, name) in unmatched.iter().take(SHOWN) {
            self.notes.choice.push(format!(
                "line {number} of --ids: no clip is called {name:?}"
            ));
        }
        if unmatched.len() > SHOWN {
            let more = unmatched.len() - SHOWN;
            self.notes
                .choice
                .push(format!("{more} more lines of --ids name no clip"));
        }
    }
}
