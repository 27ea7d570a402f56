//! Runs that change a dataset: lock, commit and clean-up.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;

use super::layout::{
    DATA, LOCK, META, SKELETON_FACT, STAGED, manifest_path, manifest_versions, newest_manifest,
    read_manifest,
};
use super::open::Dataset;
use crate::manifest::{Accounting, FORMAT, FileEntry, Manifest};
use crate::store::{Disk, Store, write_atomically};
use crate::table::SCHEMA_VERSION;
use crate::{Error, Skeleton, card, croissant};

/// A run that writes to a dataset. It holds the folder's lock until it is committed or dropped.
#[derive(Debug)]
pub struct Transaction {
    pub(super) root: PathBuf,
    pub(super) store: Arc<dyn Store>,
    pub(super) base: Option<Manifest>,
    _lock: Lock,
}

/// The lock of a dataset while it is changed.
#[derive(Debug)]
struct Lock(File);

impl Drop for Lock {
    /// Unlocks explicitly: a child process that another thread is starting holds a copy of the handle,
    /// and with it the lock, until it executes.
    fn drop(&mut self) {
        // On failure, closing the file unlocks it.
        let _closed = self.0.unlock();
    }
}

/// What a commit adds to the dataset.
#[derive(Clone, Debug, Default)]
pub struct Commit {
    /// Files of the tables that this run made; they replace the earlier files of these tables.
    pub tables: BTreeMap<String, Vec<FileEntry>>,
    /// Hash of the plan that made them.
    pub plan_hash: String,
    /// The skeleton motions are posed on.
    pub skeleton: Skeleton,
    /// Counts of the sources, for a run that read any.
    pub accounting: Option<Accounting>,
    /// Facts to add.
    pub facts: BTreeMap<String, String>,
    /// Drop the facts of the version before, and its tables but those in `carried`, because the motions they
    /// derive from are replaced.
    pub fresh: bool,
    /// Tables of the version before that a fresh commit keeps as they are, with their plans.
    pub carried: BTreeSet<String>,
}

/// What [`Transaction::prune`] removed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Pruned {
    /// Versions that are gone.
    pub versions: Vec<u64>,
    /// Data files that no version names any more.
    pub files: u64,
    /// Their size in bytes.
    pub bytes: u64,
}

impl Transaction {
    /// Locks a folder, creating it if needed, and removes half-written files of a killed run. `holder`
    /// is reported to other runs while this one holds the lock.
    ///
    /// # Errors
    /// Another run holds the lock, or the folder cannot be written.
    pub fn begin(root: &Path, holder: &str) -> Result<Self, Error> {
        Self::begin_on(Disk::store(), root, holder)
    }

    /// [`Transaction::begin`], writing through the given store. The lock itself is always the
    /// operating system's.
    ///
    /// # Errors
    /// As [`Transaction::begin`].
    pub fn begin_on(store: Arc<dyn Store>, root: &Path, holder: &str) -> Result<Self, Error> {
        for folder in [root.to_owned(), root.join(META), root.join(DATA)] {
            store
                .create_dir_all(&folder)
                .map_err(Error::io("create folder", &folder))?;
        }
        let path = root.join(META).join(LOCK);
        let lock = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(Error::io("open", &path))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(Error::Locked {
                    path: root.to_owned(),
                    holder: fs::read_to_string(&path)
                        .unwrap_or_default()
                        .trim()
                        .to_owned(),
                });
            }
            Err(TryLockError::Error(error)) => return Err(Error::io("lock", &path)(error)),
        }
        let mut lock = Lock(lock);
        lock.0
            .set_len(0)
            .and_then(|()| lock.0.rewind())
            .and_then(|()| writeln!(lock.0, "{holder}"))
            .map_err(Error::io("write", &path))?;
        let transaction = Self {
            base: newest_manifest(store.as_ref(), root)?,
            root: root.to_owned(),
            store,
            _lock: lock,
        };
        transaction.remove_files(|name, _| name.starts_with('.') && name.ends_with(".tmp"))?;
        transaction.remove_half_written_cards()?;
        Ok(transaction)
    }

    /// Removes half-written cards and metadata. They lie in the dataset's root, where other files may be
    /// the user's.
    fn remove_half_written_cards(&self) -> Result<(), Error> {
        let entries = self
            .store
            .list(&self.root)
            .map_err(Error::io("list", &self.root))?;
        for (path, _) in entries {
            let name = path
                .file_name()
                .map(|name| name.to_string_lossy().into_owned())
                .unwrap_or_default();
            let ours = [card::FILE, croissant::FILE]
                .iter()
                .any(|file| name.starts_with(&format!(".{file}.")));
            if ours && name.ends_with(".tmp") {
                self.store
                    .remove_file(&path)
                    .map_err(Error::io("remove", &path))?;
            }
        }
        Ok(())
    }

    /// The version this run starts from.
    pub fn base(&self) -> Option<&Manifest> {
        self.base.as_ref()
    }

    pub(super) fn version(&self) -> u64 {
        self.base.as_ref().map_or(1, |base| base.version + 1)
    }

    /// The store that the run writes to.
    pub fn store(&self) -> Arc<dyn Store> {
        Arc::clone(&self.store)
    }

    /// The dataset's folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Makes the run's tables part of the dataset and releases the lock.
    ///
    /// # Errors
    /// The manifest cannot be written; the dataset then stays at its earlier version.
    ///
    /// # Panics
    /// If the accounting does not balance, which is a bug in the run.
    pub fn commit(self, commit: Commit) -> Result<Dataset, Error> {
        let mut manifest = self.base.clone().unwrap_or_else(|| Manifest {
            format: FORMAT.to_owned(),
            schema_version: SCHEMA_VERSION.to_owned(),
            version: 0,
            tool_version: String::new(),
            skeleton: String::new(),
            tables: BTreeMap::new(),
            plans: BTreeMap::new(),
            accounting: Accounting::default(),
            facts: BTreeMap::new(),
            root_hash: String::new(),
        });
        if commit.fresh {
            manifest
                .tables
                .retain(|table, _| commit.carried.contains(table));
            manifest
                .plans
                .retain(|table, _| commit.carried.contains(table));
            manifest.facts.clear();
        }
        manifest.schema_version = newer_version(&manifest.schema_version).to_owned();
        manifest.skeleton = commit.skeleton.name().to_owned();
        if commit.skeleton != Skeleton::smplx_neutral() {
            let rest = serde_json::to_string(&commit.skeleton).map_err(|source| Error::Json {
                path: self.root.clone(),
                source,
            })?;
            manifest.facts.insert(SKELETON_FACT.to_owned(), rest);
        }
        manifest.version = self.version();
        manifest.tool_version = concat!("stance ", env!("CARGO_PKG_VERSION")).to_owned();
        for table in commit.tables.keys() {
            manifest
                .plans
                .insert(table.clone(), commit.plan_hash.clone());
        }
        manifest.tables.extend(commit.tables);
        manifest.facts.extend(commit.facts);
        if let Some(accounting) = commit.accounting {
            assert!(
                accounting.balances(),
                "sources must equal ingested + quarantined + skipped: {accounting:?}"
            );
            manifest.accounting = accounting;
        }
        manifest.root_hash = Manifest::compute_root_hash(&manifest.tables);

        let path = manifest_path(&self.root, manifest.version);
        write_json(self.store.as_ref(), &path, &manifest)?;
        self.settle(&manifest)?;
        Ok(Dataset {
            root: self.root,
            manifest,
        })
    }

    /// Completes a run that was killed right after its commit: writes the files that derive from the
    /// manifest and removes those that no manifest names.
    ///
    /// # Errors
    /// A file cannot be written or removed; the dataset itself is whole.
    pub fn finish(self) -> Result<(), Error> {
        match &self.base {
            Some(manifest) => self.settle(manifest),
            None => Ok(()),
        }
    }

    /// Removes the versions before the newest `keep`, and the data files that only they name. With
    /// `dry_run` nothing is removed.
    ///
    /// # Errors
    /// A manifest cannot be read, or a file cannot be removed.
    pub fn prune(self, keep: usize, dry_run: bool) -> Result<Pruned, Error> {
        let store = self.store.as_ref();
        let mut versions = manifest_versions(store, &self.root)?;
        let kept = versions.split_off(versions.len().saturating_sub(keep.max(1)));
        let files_of = |versions: &[u64]| -> Result<BTreeMap<String, u64>, Error> {
            let mut files = BTreeMap::new();
            for version in versions {
                let manifest = read_manifest(store, &self.root, *version)?;
                let entries = manifest.tables.into_values().flatten();
                files.extend(entries.map(|file| (file.path, file.bytes)));
            }
            Ok(files)
        };
        let (mut old, named) = (files_of(&versions)?, files_of(&kept)?);
        old.retain(|path, _| !named.contains_key(path));
        if !dry_run {
            // A version whose manifest is gone is no version, so manifests go first.
            for version in &versions {
                let path = manifest_path(&self.root, *version);
                store
                    .remove_file(&path)
                    .map_err(Error::io("remove", &path))?;
            }
            self.collect_garbage()?;
        }
        Ok(Pruned {
            versions,
            files: old.len() as u64,
            bytes: old.values().sum(),
        })
    }

    fn settle(&self, manifest: &Manifest) -> Result<(), Error> {
        for (name, text) in [
            (card::FILE, card::text(manifest)),
            (croissant::FILE, croissant::text(manifest)),
        ] {
            let path = self.root.join(name);
            // An unreadable file is rewritten like one that differs.
            if self.store.read(&path).ok().as_deref() == Some(text.as_bytes()) {
                continue;
            }
            write_atomically(self.store.as_ref(), &path, |mut file| {
                file.write_all(text.as_bytes())
                    .map_err(Error::io("write", &path))?;
                Ok(file)
            })?;
        }
        self.collect_garbage()
    }

    /// Removes the notes of staged shards, and data files that no manifest names.
    fn collect_garbage(&self) -> Result<(), Error> {
        let staged = self.root.join(META).join(STAGED);
        if staged.exists() {
            self.store
                .remove_dir_all(&staged)
                .map_err(Error::io("remove", &staged))?;
        }
        let mut named = BTreeSet::new();
        let store = self.store.as_ref();
        for version in manifest_versions(store, &self.root)? {
            let manifest = read_manifest(store, &self.root, version)?;
            named.extend(
                manifest
                    .tables
                    .into_values()
                    .flatten()
                    .map(|file| file.path),
            );
        }
        self.remove_files(|name, relative| name.ends_with(".parquet") && !named.contains(relative))
    }

    /// Removes the files under `data/` and `meta/` for which `unwanted(name, relative path)` holds.
    fn remove_files(&self, unwanted: impl Fn(&str, &str) -> bool) -> Result<(), Error> {
        let mut folders = vec![DATA.to_owned(), META.to_owned()];
        while let Some(folder) = folders.pop() {
            let path = self.root.join(&folder);
            let entries = self.store.list(&path).map_err(Error::io("list", &path))?;
            for (path, is_dir) in entries {
                let name = path
                    .file_name()
                    .map(|name| name.to_string_lossy().into_owned())
                    .unwrap_or_default();
                let relative = format!("{folder}/{name}");
                if is_dir {
                    folders.push(relative);
                } else if unwanted(&name, &relative) {
                    self.store
                        .remove_file(&path)
                        .map_err(Error::io("remove", &path))?;
                }
            }
        }
        Ok(())
    }
}

/// The newer of a schema version and this program's.
fn newer_version(version: &str) -> &str {
    let numbers = |text: &str| -> Vec<u64> {
        let parts = text.split('.');
        parts.map(|part| part.parse().unwrap_or(0)).collect()
    };
    if numbers(version) > numbers(SCHEMA_VERSION) {
        version
    } else {
        SCHEMA_VERSION
    }
}

pub(super) fn write_json<T: Serialize>(
    store: &dyn Store,
    path: &Path,
    value: &T,
) -> Result<(), Error> {
    let mut text = serde_json::to_vec_pretty(value).map_err(|source| Error::Json {
        path: path.to_owned(),
        source,
    })?;
    text.push(b'\n');
    write_atomically(store, path, |mut file| {
        file.write_all(&text).map_err(Error::io("write", path))?;
        Ok(file)
    })
}
