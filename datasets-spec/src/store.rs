//! The file operations a dataset is written with, so that a test can make any of them fail.

use std::fmt::Debug;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::Error;

/// A file being written.
pub trait StoreFile: Write + Send {
    /// Makes what was written durable.
    ///
    /// # Errors
    /// The storage refuses or fails.
    fn sync(&mut self) -> io::Result<()>;
}

impl StoreFile for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_all()
    }
}

/// Where files are read and written: the disk, or in a test a disk that fails.
pub trait Store: Debug + Send + Sync {
    /// Makes a folder and those above it.
    ///
    /// # Errors
    /// The storage refuses or fails; so for every operation below.
    fn create_dir_all(&self, path: &Path) -> io::Result<()>;
    /// Opens a new or emptied file for writing.
    fn create(&self, path: &Path) -> io::Result<Box<dyn StoreFile>>;
    /// Gives a file another name, replacing what had it.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Makes the names in a folder durable.
    fn sync_dir(&self, path: &Path) -> io::Result<()>;
    /// The bytes of a file.
    fn read(&self, path: &Path) -> io::Result<Vec<u8>>;
    /// Opens a file to be read from its beginning.
    fn open(&self, path: &Path) -> io::Result<Box<dyn Read>>;
    /// BLAKE3 of a file, hexadecimal.
    fn hash(&self, path: &Path) -> io::Result<String>;
    /// The entries of a folder, sorted, and whether each is a folder.
    fn list(&self, path: &Path) -> io::Result<Vec<(PathBuf, bool)>>;
    /// Removes a file.
    fn remove_file(&self, path: &Path) -> io::Result<()>;
    /// Removes a folder and all in it.
    fn remove_dir_all(&self, path: &Path) -> io::Result<()>;
}

/// The file system.
#[derive(Clone, Copy, Debug, Default)]
pub struct Disk;

impl Disk {
    /// The file system behind the trait.
    pub fn store() -> Arc<dyn Store> {
        Arc::new(Self)
    }
}

impl Store for Disk {
    fn create_dir_all(&self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn StoreFile>> {
        Ok(Box::new(File::create(path)?))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn sync_dir(&self, path: &Path) -> io::Result<()> {
        // Elsewhere a folder cannot be opened as a file, and a rename is durable by itself.
        if cfg!(unix) {
            File::open(path)?.sync_all()?;
        }
        Ok(())
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        fs::read(path)
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn Read>> {
        Ok(Box::new(File::open(path)?))
    }

    fn hash(&self, path: &Path) -> io::Result<String> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_mmap(path)?;
        Ok(hasher.finalize().to_hex().to_string())
    }

    fn list(&self, path: &Path) -> io::Result<Vec<(PathBuf, bool)>> {
        let mut entries = Vec::new();
        for entry in fs::read_dir(path)? {
            let path = entry?.path();
            let is_dir = path.is_dir();
            entries.push((path, is_dir));
        }
        entries.sort();
        Ok(entries)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn remove_dir_all(&self, path: &Path) -> io::Result<()> {
        fs::remove_dir_all(path)
    }
}

/// Writes a file whole or not at all: to a temporary name beside it, synced, then renamed.
///
/// # Errors
/// Any step fails; the temporary file is then removed.
pub(crate) fn write_atomically(
    store: &dyn Store,
    path: &Path,
    write: impl FnOnce(Box<dyn StoreFile>) -> Result<Box<dyn StoreFile>, Error>,
) -> Result<(), Error> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let staged = path.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
    let attempt = || {
        let file = store
            .create(&staged)
            .map_err(Error::io("create", &staged))?;
        let mut file = write(file)?;
        file.flush().map_err(Error::io("write", &staged))?;
        file.sync().map_err(Error::io("sync", &staged))?;
        drop(file);
        store
            .rename(&staged, path)
            .map_err(Error::io("rename into place", path))?;
        let folder = path.parent().unwrap_or(Path::new("."));
        store.sync_dir(folder).map_err(Error::io("sync", folder))
    };
    attempt().inspect_err(|_| {
        // The staged file may not exist; what matters is reported already.
        let _removed = store.remove_file(&staged);
    })
}
