//! Clips that the owner of a dataset removed, did not select, or does not choose for this run.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::record::SkippedRow;
use formats::source::Entry;

use super::id_list::IdList;
use super::plan::{Plan, Planned};
use super::recorded::Recorded;
use crate::versions::taken_out;

/// Why a clip that the user does not choose is skipped.
pub(super) const NOT_CHOSEN: &str = "clip that --ids does not choose";

impl Plan {
    /// Leaves out clips that the dataset's owner took out, as long as their files are unchanged, in the same place or
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
        let known = recorded.paths();
        let (mut left, mut entries) = (Vec::new(), Vec::new());
        items.retain(|item| {
            let file = item.entry.file.as_str();
            let rows = by_hash.get(self.hash_of(item)).into_iter().flatten();
            let found = rows.clone().find(|(id, row)| {
                let is_there = self.sources.contains_key(&row.path);
                let moved = !is_there && !known.contains(file);
                (row.path == file || moved) && item.is_of(id)
            });
            let Some((_, row)) = found else { return true };
            left.push(SkippedRow {
                path: file.to_owned(),
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
