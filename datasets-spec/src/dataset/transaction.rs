//! Runs that change a dataset: lock, commit and clean-up.

use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;

use super::layout::{
    DATA, META, SKELETON_FACT, STAGED, manifest_path, manifest_versions, newest_manifest,
    read_manifest, tables_until,
};
use super::open::Dataset;
use super::staging::folder_of;
use crate::manifest::{Accounting, FORMAT, FileEntry, Manifest};
use crate::store::{ByPath, Lock, Locking, Store, write_atomically, write_new};
use crate::table::SCHEMA_VERSION;
use crate::{Error, Skeleton, card, croissant};

/// A run that writes to a dataset. It holds the folder's lock until it is committed or dropped; at a URL
/// there is no lock, and of two runs that commit the same version the later one fails.
#[derive(Debug)]
pub struct Transaction {
    pub(super) root: PathBuf,
    pub(super) store: Arc<dyn Store>,
    pub(super) base: Option<Manifest>,
    /// Tables of all versions: shards of them get new names.
    pub(super) taken: BTreeSet<String>,
    /// None where the storage has no locks.
    lock: Option<Box<dyn Lock>>,
}

/// What a commit adds to the dataset.
#[derive(Clone, Debug, Default)]
pub struct Commit {
    /// Files of the tables that this run made; they replace the earlier files of these tables.
    pub tables: BTreeMap<String, Vec<FileEntry>>,
    /// Hash of the plan that made them.
    pub plan_hash: String,
    /// Hashes of the plans of tables that have one of their own.
    pub plans: BTreeMap<String, String>,
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
    /// is reported to other runs while this one holds the lock. What is staged stays, because those who make it
    /// hold no lock.
    ///
    /// # Errors
    /// Another run holds the lock, or the folder cannot be written.
    pub fn begin(root: &Path, holder: &str) -> Result<Self, Error> {
        Self::begin_on(ByPath::store(), root, holder)
    }

    /// [`Transaction::begin`], writing through the given store.
    ///
    /// # Errors
    /// As [`Transaction::begin`].
    pub fn begin_on(store: Arc<dyn Store>, root: &Path, holder: &str) -> Result<Self, Error> {
        for folder in [root.to_owned(), root.join(META), root.join(DATA)] {
            store
                .create_dir_all(&folder)
                .map_err(Error::io("create folder", &folder))?;
        }
        let path = root.to_owned();
        let lock = match store.lock(root, holder).map_err(Error::io("lock", root))? {
            Locking::Held(lock) => Some(lock),
            Locking::Taken { holder } => return Err(Error::Locked { path, holder }),
            Locking::NoLocks => None,
        };
        let base = newest_manifest(store.as_ref(), root)?;
        let transaction = Self {
            taken: tables_until(store.as_ref(), root, base.as_ref())?,
            base,
            root: path,
            store,
            lock,
        };
        // Where others may write, nothing of theirs is removed. Object stores have no temporary files.
        if transaction.is_alone() {
            transaction.remove_files(|name, _| name.starts_with('.') && name.ends_with(".tmp"))?;
            transaction.remove_half_written_cards()?;
        }
        Ok(transaction)
    }

    /// Whether the lock keeps other runs from writing to the dataset.
    pub fn is_alone(&self) -> bool {
        self.lock.is_some()
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
    /// The manifest cannot be written, or another run has committed this version; the dataset is then as it was.
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
        manifest.plans.extend(commit.plans);
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
        if !write_new(self.store.as_ref(), &path, &json(&path, &manifest)?)? {
            // What was staged for this version serves no other one. If it cannot be removed, pruning removes it.
            let staged = folder_of(&self.root, manifest.version - 1, &commit.plan_hash);
            let _removed = self.store.remove_dir_all(&staged);
            return Err(Error::Overtaken {
                path: self.root,
                version: manifest.version,
            });
        }
        self.settle(&manifest)?;
        Ok(Dataset::new(self.root, manifest, self.store))
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
    /// `dry_run` nothing is removed. At a URL no other run may write at the same time: its files, which no
    /// version names yet, would be removed too.
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
            self.remove_staged(None)?;
            self.remove_unnamed()?;
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
        if self.is_alone() {
            self.remove_staged(None)?;
            self.remove_unnamed()
        } else {
            // Files that no manifest names may be those of a run that has not committed yet.
            self.remove_staged(Some(manifest))
        }
    }

    /// Removes what is staged for plans that start from an earlier version, or only for those that a version was
    /// made by.
    fn remove_staged(&self, of: Option<&Manifest>) -> Result<(), Error> {
        let newest = manifest_versions(self.store.as_ref(), &self.root)?.pop();
        let staged = self.root.join(META).join(STAGED);
        let folders = match self.store.list(&staged) {
            Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
            folders => folders.map_err(Error::io("list", &staged))?,
        };
        for (folder, _) in folders {
            let name = folder.file_name().unwrap_or_default().to_string_lossy();
            let (base, plan) = name.split_once('-').unwrap_or_default();
            let is_over = match of {
                Some(of) => of.plans.values().any(|made_by| made_by == plan),
                None => base.parse().ok().is_none_or(|base| Some(base) < newest),
            };
            if !is_over {
                continue;
            }
            match self.store.remove_dir_all(&folder) {
                // A late worker may still write to it; what it leaves goes with the next commit.
                Err(error) if error.kind() == ErrorKind::DirectoryNotEmpty => {}
                removed => removed.map_err(Error::io("remove", &folder))?,
            }
        }
        Ok(())
    }

    /// Removes data files that no manifest names.
    fn remove_unnamed(&self) -> Result<(), Error> {
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

    /// Removes the files under `data/` and `meta/`, but not those that are staged, for which
    /// `unwanted(name, relative path)` holds.
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
                if is_dir && relative == format!("{META}/{STAGED}") {
                    // Those who make what is staged hold no lock.
                } else if is_dir {
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

/// The text of a JSON file.
fn json<T: Serialize>(path: &Path, value: &T) -> Result<Vec<u8>, Error> {
    let mut text = serde_json::to_vec_pretty(value).map_err(|source| Error::Json {
        path: path.to_owned(),
        source,
    })?;
    text.push(b'\n');
    Ok(text)
}

pub(super) fn write_json<T: Serialize>(
    store: &dyn Store,
    path: &Path,
    value: &T,
) -> Result<(), Error> {
    let text = json(path, value)?;
    write_atomically(store, path, |mut file| {
        file.write_all(&text).map_err(Error::io("write", path))?;
        Ok(file)
    })
}
