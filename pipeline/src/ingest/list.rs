//! Listing of the source files, with their hashes and first bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::Progress;
use datasets_spec::record::QuarantineRow;
use rayon::prelude::*;

use crate::Error;
use crate::clip::Rejected;
use crate::source::{Files, text_of_name};

/// Bytes looked at to recognise a file.
pub(super) const HEAD_BYTES: usize = 512;

/// A source file in the plan.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub(super) path: PathBuf,
    pub(super) hash: Result<String, String>,
    pub(super) head: Vec<u8>,
}

/// The regular files under the sources, and the reasons why other entries are skipped.
pub(crate) struct Listing {
    /// The files by their relative paths.
    pub(crate) files: BTreeMap<String, PathBuf>,
    /// Reasons why other entries are skipped.
    pub(crate) special: Vec<String>,
    /// Folders that cannot be listed, and why.
    pub(crate) unlisted: Vec<(String, String)>,
}

/// Why a link to a folder is skipped.
const FOLDER_LINK: &str =
    "link to a folder, not followed; name the folder it leads to as a source of its own";

/// All files under the sources by their relative path. With several sources, the path starts with the
/// name of the source's folder, made unique by a number, so that equal paths stay apart.
pub(crate) fn list_files(sources: &[PathBuf]) -> Result<Listing, Error> {
    let mut listing = Listing {
        files: BTreeMap::new(),
        special: Vec::new(),
        unlisted: Vec::new(),
    };
    let mut names = BTreeSet::new();
    for (number, source) in sources.iter().enumerate() {
        let metadata = fs::metadata(source).map_err(|_| Error::MissingSource {
            path: source.clone(),
        })?;
        let mut name = source
            .file_name()
            .map_or_else(|| format!("source{number}"), text_of_name);
        if !names.insert(name.clone()) {
            name = format!("{number}-{name}");
        }
        if metadata.is_file() {
            listing.files.insert(name, source.clone());
            continue;
        }
        let prefix = if sources.len() > 1 {
            name
        } else {
            String::new()
        };
        listing.walk(source, prefix);
    }
    if listing.files.is_empty() {
        let paths: Vec<String> = sources
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        return Err(Error::NoFiles {
            paths: paths.join(", "),
            hint: listing.why_empty(),
        });
    }
    Ok(listing)
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
            Some(reason) => self.special.push(reason.to_owned()),
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
            Some(reason) => format!("all {} entries are skipped: {reason}", self.special.len()),
            None => "is the archive unpacked there?".to_owned(),
        }
    }
}

pub(super) fn hash_sources(files: &Files, progress: &dyn Progress) -> BTreeMap<String, Source> {
    progress.begin("plan", Some(files.len() as u64));
    let listed: Vec<(&str, &Path)> = files
        .all()
        .filter_map(|relative| Some((relative, files.path(relative)?)))
        .collect();
    let sources: BTreeMap<String, Source> = listed
        .into_par_iter()
        .map(|(relative, path)| {
            let source = Source {
                hash: files.hash(path),
                head: read_head(path),
                path: path.to_owned(),
            };
            progress.advance(1);
            (relative.to_owned(), source)
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
        path: match key {
            "" => file.to_owned(),
            // Names of motions come from files and may hold anything.
            key => format!("{file}#{}", text_of_name(key.as_ref())),
        },
        source_hash,
        code: rejected.code.to_owned(),
        reason: rejected.reason,
        byte_offset: rejected.byte_offset,
        stage: rejected.stage.to_owned(),
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
