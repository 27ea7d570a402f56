//! Listing of the source files, with their hashes and first bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::Progress;
use datasets_spec::record::QuarantineRow;
use datasets_spec::store::{ByPath, Store, is_url};
use rayon::prelude::*;

use crate::Error;
use crate::clip::Rejected;
use crate::source::archive::{self, Archives};
use crate::source::text_of_name;

/// Bytes looked at to recognise a file.
pub(super) const HEAD_BYTES: usize = 512;

/// A source file in the plan.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub(super) hash: Result<String, String>,
    pub(super) head: Vec<u8>,
    /// Size; 0 if it is not known.
    pub(super) bytes: u64,
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
    /// Archives and members of archives that cannot be used, with the hash of the archive.
    pub(crate) refused: Vec<(String, String, Rejected)>,
    /// Archives whose members are among the files: these can be read while this is kept.
    pub(crate) archives: Archives,
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
        if is_url(source) {
            let found = list_url(source)?;
            if !listed.iter().any(|earlier| earlier.path == found.path) {
                listed.push(found);
            }
            continue;
        }
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
    for source in &mut listed {
        source.listing.open_archives()?;
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

/// The files at a URL: the object of that name, or those below it.
fn list_url(source: &Path) -> Result<Listed, Error> {
    use std::io::ErrorKind::NotFound;

    let missing = || Error::MissingSource {
        path: source.to_owned(),
    };
    let text = source.to_string_lossy();
    let path = PathBuf::from(text.trim_end_matches('/'));
    let mut listing = Listing::default();
    let is_file = match ByPath.size(&path) {
        Ok(_) => true,
        Err(error) if error.kind() == NotFound => false,
        Err(error) => return Err(Error::io("read", source)(error)),
    };
    if is_file {
        let name = text_of_name(path.file_name().unwrap_or_default());
        listing.files.insert(name, path.clone());
    } else {
        let files = ByPath.files_below(&path);
        for file in files.map_err(Error::io("list", source))? {
            let parts = file.strip_prefix(&path).unwrap_or(&file).iter();
            let names: Vec<String> = parts.map(text_of_name).collect();
            listing.files.insert(names.join("/"), file);
        }
        if listing.files.is_empty() {
            return Err(missing());
        }
    }
    Ok(Listed {
        path,
        is_file,
        listing,
    })
}

/// The files of all sources. Each path begins with the label of its source.
pub(super) fn merged(sources: Vec<Listed>, labels: &[String]) -> Listing {
    let mut merged = Listing::default();
    for (source, label) in sources.into_iter().zip(labels) {
        let Listing {
            files,
            special,
            unlisted,
            refused,
            archives,
        } = source.listing;
        let refused = refused.into_iter();
        merged
            .refused
            .extend(refused.map(|(name, hash, why)| (labelled(label, &name), hash, why)));
        merged.archives.add(archives);
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

    /// Puts the members of archives in the place of these.
    fn open_archives(&mut self) -> Result<(), Error> {
        let opened = archive::open_all(&mut self.files)?;
        self.files.extend(opened.files);
        self.special.extend(opened.special);
        self.refused.extend(opened.refused);
        self.archives.add(opened.archives);
        Ok(())
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
        if let Some((name, _, rejected)) = self.refused.first() {
            return format!("{name} cannot be read: {}", rejected.reason);
        }
        match self.special.first() {
            Some((_, reason)) => {
                format!("all {} entries are skipped: {reason}", self.special.len())
            }
            None => "is the archive unpacked there?".to_owned(),
        }
    }
}

/// Files at URLs that are hashed at the same time.
const NUM_REQUESTS: usize = 32;

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
    let hash = |path: &PathBuf| {
        let source = Source {
            hash: store.hash(path).map_err(|error| error.to_string()),
            head: read_head(path),
            bytes: store.size(path).unwrap_or(0),
        };
        progress.advance(1);
        (path.clone(), source)
    };
    let hash = || places.par_iter().map(|path| hash(path)).collect();
    // Files at URLs are waited for, not worked on.
    let waiting = rayon::ThreadPoolBuilder::new().num_threads(NUM_REQUESTS);
    let sources: BTreeMap<PathBuf, Source> = match waiting.build() {
        Ok(pool) if places.iter().any(|path| is_url(path)) => pool.install(hash),
        _ => hash(),
    };
    progress.finish(&format!("{} files", sources.len()));
    sources
}

/// The first bytes of a file; none if it cannot be read, which the hash reports.
pub(crate) fn read_head(path: &Path) -> Vec<u8> {
    let read = || {
        let file = ByPath.open_at(path)?;
        let length = file.size().min(HEAD_BYTES as u64);
        let mut head = vec![0; usize::try_from(length).unwrap_or(HEAD_BYTES)];
        file.read_exact_at(&mut head, 0)?;
        std::io::Result::Ok(head)
    };
    read().unwrap_or_default()
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
