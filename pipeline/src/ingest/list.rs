//! Listing of the source files, with their hashes and first bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::Progress;
use datasets_spec::record::QuarantineRow;
use datasets_spec::store::Store;
use rayon::prelude::*;

use crate::Error;
use crate::clip::Rejected;
use crate::source::text_of_name;

/// Bytes looked at to recognise a file.
pub(super) const HEAD_BYTES: usize = 512;

/// A source file in the plan.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub(super) hash: Result<String, String>,
    pub(super) head: Vec<u8>,
}

/// The regular files under some sources, by their relative paths, and other entries with the reason why
/// each is skipped.
#[derive(Default)]
pub(crate) struct Listing {
    /// The files by their relative paths.
    pub(crate) files: BTreeMap<String, PathBuf>,
    /// Relative path and reason of other entries.
    pub(crate) special: Vec<(String, String)>,
    /// Folders that cannot be listed, and why.
    pub(crate) unlisted: Vec<(String, String)>,
}

/// Why a link to a folder is skipped.
const FOLDER_LINK: &str =
    "link to a folder, not followed; name the folder it leads to as a source of its own";

/// The files of one source.
pub(super) struct Listed {
    /// The folder or file, as an absolute path without links where that can be had.
    pub(super) path: PathBuf,
    pub(super) is_file: bool,
    pub(super) listing: Listing,
}

/// The files of every source, by their paths relative to it. A source that is given twice is listed once.
pub(super) fn list_sources(sources: &[PathBuf]) -> Result<Vec<Listed>, Error> {
    let mut listed: Vec<Listed> = Vec::new();
    for source in sources {
        let metadata = fs::metadata(source).map_err(|_| Error::MissingSource {
            path: source.clone(),
        })?;
        let path = fs::canonicalize(source).unwrap_or_else(|_| source.clone());
        if listed.iter().any(|earlier| earlier.path == path) {
            continue;
        }
        let mut listing = Listing::default();
        if metadata.is_file() {
            let name = text_of_name(path.file_name().unwrap_or_default());
            listing.files.insert(name, source.clone());
        } else {
            listing.walk(source, String::new());
        }
        listed.push(Listed {
            path,
            is_file: metadata.is_file(),
            listing,
        });
    }
    if listed.iter().all(|source| source.listing.files.is_empty()) {
        let paths: Vec<String> = sources
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        return Err(Error::NoFiles {
            paths: paths.join(", "),
            hint: listed[0].listing.why_empty(),
        });
    }
    Ok(listed)
}

/// The files of all sources. Each path begins with the label of its source.
pub(super) fn merged(sources: Vec<Listed>, labels: &[String]) -> Listing {
    let mut merged = Listing::default();
    for (source, label) in sources.into_iter().zip(labels) {
        let Listing {
            files,
            special,
            unlisted,
        } = source.listing;
        let files = files.into_iter();
        merged
            .files
            .extend(files.map(|(name, path)| (labelled(label, &name), path)));
        let special = special.into_iter();
        merged
            .special
            .extend(special.map(|(name, reason)| (labelled(label, &name), reason)));
        let unlisted = unlisted.into_iter();
        merged
            .unlisted
            .extend(unlisted.map(|(name, reason)| (labelled(label, &name), reason)));
    }
    merged
}

/// A path relative to a source, behind the label of the source.
pub(crate) fn labelled(label: &str, name: &str) -> String {
    match label {
        "" => name.to_owned(),
        label => format!("{label}/{name}"),
    }
}

impl Listing {
    fn walk(&mut self, source: &Path, prefix: String) {
        let mut folders = vec![(source.to_owned(), prefix)];
        while let Some((folder, relative)) = folders.pop() {
            let listed = fs::read_dir(&folder).and_then(|entries| {
                for entry in entries {
                    let entry = entry?;
                    let name = text_of_name(&entry.file_name());
                    let relative = match relative.as_str() {
                        "" => name,
                        parent => format!("{parent}/{name}"),
                    };
                    let kind = entry.file_type()?;
                    if kind.is_dir() {
                        folders.push((entry.path(), relative));
                    } else {
                        self.take(&entry.path(), relative, kind.is_file());
                    }
                }
                Ok(())
            });
            if let Err(error) = listed {
                let name = match relative.as_str() {
                    "" => ".".to_owned(),
                    relative => relative.to_owned(),
                };
                self.unlisted.push((name, error.to_string()));
            }
        }
    }

    /// Takes an entry that is no folder.
    fn take(&mut self, path: &Path, relative: String, is_file: bool) {
        // A link to a folder could lead back here, and opening a pipe waits for ever. A dangling link
        // is kept, so that reading it reports what is missing.
        let special = match (is_file, fs::metadata(path)) {
            (true, _) | (_, Err(_)) => None,
            (false, Ok(target)) if target.is_file() => None,
            (false, Ok(target)) if target.is_dir() => Some(FOLDER_LINK),
            (false, Ok(_)) => Some("pipe, socket or device"),
        };
        match special {
            Some(reason) => self.special.push((relative, reason.to_owned())),
            None => {
                self.files.insert(relative, path.to_owned());
            }
        }
    }

    /// What is there in place of files.
    fn why_empty(&self) -> String {
        if let Some((folder, reason)) = self.unlisted.first() {
            return format!("folder {folder} cannot be listed: {reason}");
        }
        match self.special.first() {
            Some((_, reason)) => {
                format!("all {} entries are skipped: {reason}", self.special.len())
            }
            None => "is the archive unpacked there?".to_owned(),
        }
    }
}

/// Hashes and first bytes of all files, by their place on the disk.
pub(super) fn hash_files(
    store: &dyn Store,
    listed: &[Listed],
    progress: &dyn Progress,
) -> BTreeMap<PathBuf, Source> {
    let places = listed
        .iter()
        .flat_map(|source| source.listing.files.values());
    let places: BTreeSet<&PathBuf> = places.collect();
    progress.begin("plan", Some(places.len() as u64));
    let sources: BTreeMap<PathBuf, Source> = places
        .into_par_iter()
        .map(|path| {
            let source = Source {
                hash: store.hash(path).map_err(|error| error.to_string()),
                head: read_head(path),
            };
            progress.advance(1);
            (path.clone(), source)
        })
        .collect();
    progress.finish(&format!("{} files", sources.len()));
    sources
}

/// The first bytes of a file; none if it cannot be read, which the hash reports.
pub(crate) fn read_head(path: &Path) -> Vec<u8> {
    use std::io::Read;

    let mut head = Vec::new();
    let read =
        fs::File::open(path).and_then(|file| file.take(HEAD_BYTES as u64).read_to_end(&mut head));
    match read {
        Ok(_) => head,
        Err(_) => Vec::new(),
    }
}

/// The row of a file that was rejected; `key` names one of several motions of it.
pub(super) fn quarantine_row(
    file: &str,
    key: &str,
    source_hash: String,
    rejected: Rejected,
) -> QuarantineRow {
    QuarantineRow {
        path: path_of(file, key),
        source_hash,
        inputs_hash: String::new(),
        code: rejected.code.to_owned(),
        reason: rejected.reason,
        byte_offset: rejected.byte_offset,
        stage: rejected.stage.to_owned(),
    }
}

/// Path of a motion: that of its file, and its key if the file holds several.
pub(super) fn path_of(file: &str, key: &str) -> String {
    match key {
        "" => file.to_owned(),
        // Names of motions come from files and may hold anything.
        key => format!("{file}#{}", text_of_name(key.as_ref())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_motions_are_listed_without_control_characters() {
        let row = |key| {
            let rejected = Rejected::read("E-PATH", "unusable");
            quarantine_row("a.glb", key, String::new(), rejected).path
        };
        assert_eq!(row(""), "a.glb");
        assert_eq!(row("Walk A"), "a.glb#Walk A");
        assert_eq!(row("Walk\u{1b}[2J\n"), r"a.glb#Walk\x1b[2J\x0a");
    }
}
