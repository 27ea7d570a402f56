//! Shards that are made for a plan before its commit.

use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::layout::{
    DATA, ShardName, check_free, manifest_versions, read_newest, staged_folder, tables_until,
};
use super::shards::{holds, shard_path, write_shard_at};
use super::transaction::{Transaction, write_json};
use crate::Error;
use crate::manifest::{FileEntry, Manifest};
use crate::store::{Store, aside, create_folder};
use crate::table::{Row, borrowed_groups};

/// Folder in which the shards of a plan wait for its commit.
///
/// Making a shard takes no lock, so any number of processes may do it: the files lie in a folder of the plan, apart
/// from those of the dataset, and equal shards replace each other. The commit of the plan removes the folder. In a
/// folder with a lock any other commit removes it too, because the plan then starts from an old version.
#[derive(Clone, Debug)]
pub struct Staging {
    root: PathBuf,
    store: Arc<dyn Store>,
    /// Number of the version that the commit makes.
    version: u64,
    /// Tables of this and earlier versions: new shards of these tables get other file names.
    taken: BTreeSet<String>,
    folder: PathBuf,
}

impl Staging {
    /// The staged shards of a plan for the dataset at `root`. The plan starts from the version and tables that
    /// [`Staging::base`] returned.
    pub fn new(
        store: Arc<dyn Store>,
        root: &Path,
        (base, tables): (u64, BTreeSet<String>),
        plan_hash: &str,
    ) -> Self {
        Self {
            root: root.to_owned(),
            store,
            version: base + 1,
            taken: tables,
            folder: staged_folder(root, base, plan_hash),
        }
    }

    /// Number of the newest version of a dataset; 0 if there is no dataset yet.
    ///
    /// # Errors
    /// The folder exists but cannot be listed.
    pub fn newest_version(store: &dyn Store, root: &Path) -> Result<u64, Error> {
        Ok(manifest_versions(store, root)?.pop().unwrap_or(0))
    }

    /// The newest version of a dataset that is to be written; `None` if there is no dataset yet.
    ///
    /// # Errors
    /// A manifest exists but cannot be read, or there is none and the folder holds files that a dataset would replace.
    pub fn newest(store: &dyn Store, root: &Path) -> Result<Option<Manifest>, Error> {
        check_free(store, root)?;
        read_newest(store, root)
    }

    /// Returns the number of the version that a plan starts from (0 if there is none), and the names of all tables in
    /// that version and in older ones.
    ///
    /// # Errors
    /// The manifest of one of these versions cannot be read.
    pub fn base(
        store: &dyn Store,
        root: &Path,
        newest: Option<&Manifest>,
    ) -> Result<(u64, BTreeSet<String>), Error> {
        let tables = tables_until(store, root, newest)?;
        Ok((newest.map_or(0, |newest| newest.version), tables))
    }

    /// The folder of the plan.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The store that shards are written to.
    pub fn store(&self) -> &Arc<dyn Store> {
        &self.store
    }

    /// Staged shards have no `.parquet` in their names, so that searches for Parquet files do not find them.
    fn staged_path(&self, relative: &str) -> PathBuf {
        let is_shard = relative.starts_with(DATA);
        let stem = relative.strip_suffix(".parquet").filter(|_| is_shard);
        self.folder.join(stem.unwrap_or(relative))
    }

    /// Writes a shard whole or not at all. The returned entry states the path that the file has after the commit.
    ///
    /// # Errors
    /// The rows cannot be encoded or the file cannot be written.
    pub fn write_shard<R: Row>(
        &self,
        name: &ShardName,
        rows: &[R],
        facts: &[(&str, String)],
    ) -> Result<FileEntry, Error> {
        let replaces = self.taken.contains(name.table);
        let relative = shard_path(name, replaces.then_some(self.version));
        let path = self.staged_path(&relative);
        let groups = borrowed_groups(rows);
        write_shard_at(self.store.as_ref(), relative, &path, name, groups, facts)
    }

    /// Path of a file: where it is staged, or where [`Transaction::adopt`] or a commit has moved it.
    pub fn path(&self, file: &FileEntry) -> PathBuf {
        let place = self.root.join(&file.path);
        let mut others = std::iter::once(self.staged_path(&file.path)).chain(aside(&place));
        let found = others.find(|path| self.store.size(path).is_ok());
        found.unwrap_or(place)
    }

    /// Whether the files are present and match their sizes and hashes.
    ///
    /// # Errors
    /// A file exists but cannot be read.
    pub fn holds<'a>(&self, files: impl Iterator<Item = &'a FileEntry>) -> Result<bool, Error> {
        holds(self.store.as_ref(), files, |file| self.path(file))
    }

    /// Writes a record of the plan.
    ///
    /// # Errors
    /// The record cannot be written.
    pub fn put<T: Serialize>(&self, name: &str, record: &T) -> Result<(), Error> {
        create_folder(self.store.as_ref(), &self.folder)?;
        let path = self.staged_path(&format!("{name}.json"));
        write_json(self.store.as_ref(), &path, record)
    }

    /// Reads a record of the plan; `None` if it is missing or unreadable.
    pub fn get<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        let text = self
            .store
            .read(&self.staged_path(&format!("{name}.json")))
            .ok()?;
        serde_json::from_slice(&text).ok()
    }
}

impl Transaction {
    /// The staged shards of a plan of this run.
    pub fn staging(&self, plan_hash: &str) -> Staging {
        let base = (self.version() - 1, self.taken.clone());
        Staging::new(self.store(), self.root(), base, plan_hash)
    }

    /// Moves staged files into the dataset, where they lie aside until the commit. Files moved before are skipped. On
    /// storage without locks, files are copied, and a file whose name is taken gets another, which its entry states.
    ///
    /// # Errors
    /// A file cannot be moved.
    pub fn adopt<'a>(
        &self,
        staging: &Staging,
        files: impl Iterator<Item = &'a mut FileEntry>,
    ) -> Result<(), Error> {
        let store = self.store.as_ref();
        let mut folders = BTreeSet::new();
        for file in files {
            let (staged, place) = (staging.path(file), self.root.join(&file.path));
            let Some(aside) = aside(&place).filter(|aside| ![aside, &place].contains(&&staged))
            else {
                continue;
            };
            if !self.is_alone() {
                match store.read(&staged) {
                    Ok(bytes) => file.path = self.add(&file.path, &bytes)?,
                    // Another run of the same plan has committed the file and removed the staged one.
                    Err(error) if error.kind() == ErrorKind::NotFound => {}
                    Err(error) => return Err(Error::io("read", &staged)(error)),
                }
                continue;
            }
            let folder = aside.parent().unwrap_or(&self.root).to_owned();
            if !folders.contains(&folder) {
                create_folder(store, &folder)?;
                folders.insert(folder);
            }
            store
                .rename(&staged, &aside)
                .map_err(Error::io("move into place", &aside))?;
        }
        Ok(())
    }
}
