//! The files that are ingested.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use datasets_spec::store::{ByPath, Reader, Store, is_url};

use super::archive::Archives;
use clip::{Rejected, rejected};

/// The files under the sources, by relative path with forward slashes.
#[derive(Clone, Debug)]
pub struct Files {
    store: Arc<dyn Store>,
    paths: BTreeMap<String, PathBuf>,
    /// Listings of folders at URLs, made on first use; `None` for folders that cannot be listed.
    folders: Folders,
    /// The archives that some of the files are in.
    archives: Archives,
}

type Folders = Arc<Mutex<BTreeMap<PathBuf, Option<BTreeSet<PathBuf>>>>>;

impl Files {
    /// Makes the list. `paths` maps the relative path of each file to its path or URL.
    pub fn new(paths: BTreeMap<String, PathBuf>) -> Self {
        Self::on(ByPath::store(), paths)
    }

    /// [`Files::new`] with the store to read through.
    pub fn on(store: Arc<dyn Store>, paths: BTreeMap<String, PathBuf>) -> Self {
        Self {
            store,
            paths,
            folders: Folders::default(),
            archives: Archives::default(),
        }
    }

    /// Keeps the archives open as long as these files.
    pub fn with_archives(mut self, archives: Archives) -> Self {
        self.archives = archives;
        self
    }

    /// The archives that some of the files are in.
    pub fn archives(&self) -> &Archives {
        &self.archives
    }

    /// BLAKE3 hash of a file in hexadecimal, or the reason why it cannot be read.
    pub fn hash(&self, path: &Path) -> Result<String, String> {
        self.store.hash(path).map_err(|error| error.to_string())
    }

    /// Whether a file exists with this size and this BLAKE3 hash. The hash is computed only if the size is equal.
    pub fn is_equal(&self, path: &Path, bytes: u64, blake3: &str) -> io::Result<bool> {
        let size = self.store.size(path);
        let found = size.and_then(|size| Ok(size == bytes && self.store.hash(path)? == blake3));
        match found {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            found => found,
        }
    }

    /// Size of a file in bytes.
    ///
    /// # Errors
    /// As [`Files::read`].
    pub fn size(&self, relative: &str) -> Result<u64, Rejected> {
        self.with(relative, |path| self.store.size(path))
    }

    fn with<T>(
        &self,
        relative: &str,
        read: impl FnOnce(&Path) -> io::Result<T>,
    ) -> Result<T, Rejected> {
        let path = self
            .paths
            .get(relative)
            .ok_or_else(|| rejected!("E-IO", "there is no file {relative} in the source"))?;
        read(path).map_err(|error| rejected!("E-IO", "cannot read {relative}: {error}"))
    }

    /// Size in bytes of a file beside a source; `None` if it cannot be determined.
    pub fn size_beside(&self, path: &Path) -> Option<u64> {
        self.may_be_there(path)
            .then(|| self.store.size(path).ok())?
    }

    /// Number of files.
    pub fn len(&self) -> usize {
        self.paths.len()
    }

    /// Whether there are no files.
    pub fn is_empty(&self) -> bool {
        self.paths.is_empty()
    }

    /// Whether there is a file with this relative path.
    pub fn contains(&self, relative: &str) -> bool {
        self.paths.contains_key(relative)
    }

    /// The path of a file; `None` if there is no such file.
    pub fn path(&self, relative: &str) -> Option<&Path> {
        self.paths.get(relative).map(PathBuf::as_path)
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// `E-IO` if there is no such file or it cannot be read.
    pub fn read(&self, relative: &str) -> Result<Vec<u8>, Rejected> {
        self.with(relative, |path| self.store.read(path))
    }

    /// Opens a file for sequential reading.
    ///
    /// # Errors
    /// As [`Files::read`].
    pub fn open(&self, relative: &str) -> Result<Box<dyn Read>, Rejected> {
        self.with(relative, |path| self.store.open(path))
    }

    /// Opens a file for random access.
    ///
    /// # Errors
    /// As [`Files::read`].
    pub fn open_at(&self, relative: &str) -> Result<Reader, Rejected> {
        self.with(relative, |path| self.store.open_at(path).map(Reader::new))
    }

    /// Whether there can be a file at a path. At a URL, where every check costs a request, the folder is listed once. Local
    /// pipes and devices are no files, because reading them may never end.
    fn may_be_there(&self, path: &Path) -> bool {
        let Some(folder) = path.parent().filter(|_| is_url(path)) else {
            let found = std::fs::metadata(path);
            return found.map_or(true, |found| found.is_file() || found.is_dir());
        };
        let mut folders = self.folders.lock().unwrap_or_else(PoisonError::into_inner);
        let listed = folders.entry(folder.to_owned()).or_insert_with(|| {
            let entries = self.store.list(folder).ok()?;
            let files = entries.into_iter().filter(|(_, is_dir)| !is_dir);
            Some(files.map(|(path, _)| path).collect())
        });
        listed.as_ref().is_none_or(|files| files.contains(path))
    }

    /// The bytes of a file that lies beside a source; `None` if there is no such file.
    pub fn read_beside(&self, path: &Path) -> Result<Option<Vec<u8>>, Rejected> {
        use std::io::ErrorKind::{InvalidFilename, IsADirectory, NotADirectory, NotFound};

        if !self.may_be_there(path) {
            return Ok(None);
        }
        match self.store.read(path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) => match error.kind() {
                NotFound | NotADirectory | IsADirectory | InvalidFilename => Ok(None),
                _ => Err(rejected!("E-IO", "cannot read {}: {error}", path.display())),
            },
        }
    }

    /// Relative paths of all files, sorted.
    pub fn all(&self) -> impl Iterator<Item = &str> {
        self.paths.keys().map(String::as_str)
    }

    /// Relative paths of the files under a folder (`""` for all, otherwise ending in `/`), sorted.
    pub fn under<'a>(&'a self, folder: &'a str) -> impl Iterator<Item = &'a str> {
        self.paths
            .range(folder.to_owned()..)
            .map(|(relative, _)| relative.as_str())
            .take_while(move |relative| relative.starts_with(folder))
    }
}
