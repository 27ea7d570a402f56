//! Label files that were added to the sources after planning.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use formats::source::labels::{names_beside, names_in_folder};
use formats::source::name_of_text;

use super::deal::Item;
use super::inputs::folder_of;
use super::list::labelled;
use super::plan::Plan;

impl Plan {
    /// Finds a file that was not planned and may label some motions: a file beside a motion, or in a folder above one.
    /// Nothing is searched for motions that were given as single files, because their neighbours were not listed when
    /// they were planned. Beside motions of a release, nothing is searched either, because a release reads only listed
    /// files.
    pub(super) fn added(&self, items: &[Item<'_>]) -> Option<PathBuf> {
        let mut looked = BTreeSet::new();
        for item in items {
            let file = item.planned.entry.file.as_str();
            let mut folder = folder_of(file);
            let (Some(top), Some(place)) = (self.top(file), self.files.path(file)) else {
                continue;
            };
            let mut place = place.parent()?;
            let added = |folder: &str, place: &Path, name: &str| {
                let path = place.join(name_of_text(name));
                let is_there = self.files.size_beside(&path).is_some();
                (is_there && !self.is_known(&labelled(folder, name))).then_some(path)
            };
            if item.planned.release.is_none() {
                let mut names = names_beside(Path::new(file)).into_iter();
                let found = names.find_map(|name| added(folder, place, &name));
                if found.is_some() {
                    return found;
                }
            }
            while looked.insert(folder) {
                let found = names_in_folder().find_map(|name| added(folder, place, name));
                if found.is_some() {
                    return found;
                }
                if folder == top {
                    break;
                }
                folder = folder_of(folder);
                place = place.parent()?;
            }
        }
        None
    }

    /// Label of the folder that is the source of a file; `None` if the file was given alone.
    fn top(&self, file: &str) -> Option<&str> {
        let source = self.source_of(file).filter(|source| source.is_whole);
        source.map(|source| source.label.label.as_str())
    }

    /// Whether something of this name was listed. Case is ignored, because some file systems find a file by names that
    /// differ in case.
    fn is_known(&self, file: &str) -> bool {
        let special = || self.skipped.iter().map(|row| row.path.as_str());
        let mut listed = self.files.all().chain(special());
        self.files.contains(file) || listed.any(|known| known.eq_ignore_ascii_case(file))
    }
}
