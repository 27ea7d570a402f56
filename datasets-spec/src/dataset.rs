//! Opening datasets, and committing them so that they appear whole or not at all.
//!
//! A dataset is a folder: `data/<table>/<split>-<i>-of-<n>.parquet`, `meta/manifest-<n>.json`,
//! and a `README.md` that the Hugging Face `datasets` library reads. A run locks the folder, writes
//! its files to temporary names, syncs and renames them, and writes the manifest last; whoever
//! opens the folder sees the version before or the version after, never something between.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::io::{Seek, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use crate::manifest::{Accounting, FORMAT, FileEntry, Manifest};
use crate::record::ItemRow;
use crate::store::{Disk, Store, write_atomically};
use crate::table::{self, Row, SCHEMA_VERSION};
use crate::{Error, Skeleton, Split, card, croissant};

const META: &str = "meta";
const DATA: &str = "data";
const LOCK: &str = "LOCK";
const STAGED: &str = "staged";
/// The fact that holds a skeleton that is not built in.
const SKELETON_FACT: &str = "skeleton_rest";

/// A dataset opened for reading; every file has been checked against its hash.
#[derive(Clone, Debug)]
pub struct Dataset {
    root: PathBuf,
    manifest: Manifest,
}

impl Dataset {
    /// Opens the newest committed version and verifies the hash of every file.
    ///
    /// # Errors
    /// The folder is no dataset, is of a newer format, or a file is missing or altered.
    pub fn open(root: &Path) -> Result<Self, Error> {
        let dataset = Self::open_unverified(root)?;
        let files: Vec<&FileEntry> = dataset.manifest.tables.values().flatten().collect();
        files.par_iter().try_for_each(|file| {
            let path = root.join(&file.path);
            let found = hash_file(&path)?;
            if found == file.blake3 {
                return Ok(());
            }
            Err(Error::Corrupt {
                path,
                detail: format!("BLAKE3 expected {}, found {found}", file.blake3),
            })
        })?;
        Ok(dataset)
    }

    /// Opens the newest committed version without reading its files.
    ///
    /// # Errors
    /// The folder is no dataset or is of a newer format.
    pub fn open_unverified(root: &Path) -> Result<Self, Error> {
        let manifest = newest_manifest(&Disk, root)?.ok_or_else(|| Error::NotADataset {
            path: root.to_owned(),
            reason: if root.is_dir() {
                "it has no meta/manifest-<n>.json; was the run that made it interrupted?".to_owned()
            } else {
                "there is no such folder".to_owned()
            },
        })?;
        Ok(Self {
            root: root.to_owned(),
            manifest,
        })
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// What identifies the rows of some tables, as [`Manifest::content_hash`] has it.
    pub fn content_hash(&self, tables: &[&str]) -> String {
        self.manifest.content_hash(tables)
    }

    /// The skeleton its motions are posed on.
    ///
    /// # Errors
    /// The manifest names a skeleton that is not built in and does not say where its joints are.
    pub fn skeleton(&self) -> Result<Skeleton, Error> {
        let built_in = Skeleton::smplx_neutral();
        let name = &self.manifest.skeleton;
        let facts = &self.manifest.facts;
        let stored = facts
            .get(SKELETON_FACT)
            .and_then(|text| serde_json::from_str::<Skeleton>(text).ok())
            .filter(|skeleton| skeleton.name() == name);
        match stored {
            Some(skeleton) => Ok(skeleton),
            None if name == built_in.name() => Ok(built_in),
            None => Err(Error::NotADataset {
                path: self.root.clone(),
                reason: format!(
                    "its manifest names skeleton {name:?} without saying where its joints are"
                ),
            }),
        }
    }

    /// Files of a table, with their paths.
    pub fn files(&self, table: &str, split: Option<Split>) -> Vec<(PathBuf, &FileEntry)> {
        self.manifest
            .tables
            .get(table)
            .into_iter()
            .flatten()
            .filter(|file| split.is_none() || file.split == split)
            .map(|file| (self.root.join(&file.path), file))
            .collect()
    }

    /// All rows of a table, or those of one split, in the order of the files.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn read<R: Row>(&self, split: Option<Split>) -> Result<Vec<R>, Error> {
        let shards: Vec<Vec<R>> = self
            .files(R::TABLE, split)
            .par_iter()
            .map(|(path, _)| table::read_rows(path))
            .collect::<Result<_, _>>()?;
        Ok(shards.into_iter().flatten().collect())
    }

    /// The test questions of the folder, each checked against its id.
    ///
    /// # Errors
    /// There are none, one was changed after it was drawn, or a file cannot be read.
    pub fn items(&self) -> Result<Vec<ItemRow>, Error> {
        let rows: Vec<ItemRow> = self.read(None)?;
        if rows.is_empty() {
            return Err(Error::NoItems {
                path: self.root.clone(),
            });
        }
        for row in &rows {
            row.check().map_err(|source| Error::ItemOf {
                path: self.root.clone(),
                source: Box::new(source),
            })?;
        }
        Ok(rows)
    }
}

/// BLAKE3 of a file, hexadecimal.
///
/// # Errors
/// The file cannot be read.
pub fn hash_file(path: &Path) -> Result<String, Error> {
    Disk.hash(path).map_err(Error::io("read", path))
}

fn manifest_path(root: &Path, version: u64) -> PathBuf {
    root.join(META).join(format!("manifest-{version}.json"))
}

fn newest_manifest(store: &dyn Store, root: &Path) -> Result<Option<Manifest>, Error> {
    let Some(version) = manifest_versions(store, root)?.pop() else {
        return Ok(None);
    };
    read_manifest(store, root, version).map(Some)
}

fn manifest_versions(store: &dyn Store, root: &Path) -> Result<Vec<u64>, Error> {
    let meta = root.join(META);
    let entries = match store.list(&meta) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(Error::io("list", meta)(error)),
    };
    let mut versions = Vec::new();
    for (path, _) in entries {
        let version: Option<u64> = path.file_name().and_then(|name| {
            name.to_str()?
                .strip_prefix("manifest-")?
                .strip_suffix(".json")?
                .parse()
                .ok()
        });
        versions.extend(version);
    }
    versions.sort_unstable();
    Ok(versions)
}

fn read_manifest(store: &dyn Store, root: &Path, version: u64) -> Result<Manifest, Error> {
    let path = manifest_path(root, version);
    let text = store.read(&path).map_err(Error::io("read", &path))?;
    let manifest: Manifest = serde_json::from_slice(&text).map_err(|source| Error::Json {
        path: path.clone(),
        source,
    })?;
    if manifest.format != FORMAT {
        return Err(Error::NotADataset {
            path,
            reason: format!("its manifest says format {:?}", manifest.format),
        });
    }
    let major = |version: &str| version.split('.').next().unwrap_or("").to_owned();
    if major(&manifest.schema_version) != major(SCHEMA_VERSION) {
        return Err(Error::Version {
            path,
            found: manifest.schema_version,
            supported: SCHEMA_VERSION,
        });
    }
    let expected = Manifest::compute_root_hash(&manifest.tables);
    if expected != manifest.root_hash {
        return Err(Error::Corrupt {
            path,
            detail: format!("root hash {} does not cover its files", manifest.root_hash),
        });
    }
    Ok(manifest)
}

/// The place of a shard among those of its table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ShardName {
    /// Table.
    pub table: &'static str,
    /// Split; none for tables without splits.
    pub split: Option<Split>,
    /// Number of the shard, from 0.
    pub index: usize,
    /// Shards of this table and split.
    pub of: usize,
}

impl ShardName {
    fn stem(&self) -> String {
        let split = self.split.map_or("all", Split::as_str);
        format!("{split}-{:05}-of-{:05}", self.index, self.of)
    }
}

/// A run that writes to a dataset. It holds the folder's lock until it is committed or dropped.
#[derive(Debug)]
pub struct Transaction {
    root: PathBuf,
    store: Arc<dyn Store>,
    base: Option<Manifest>,
    _lock: Lock,
}

/// The lock of a dataset while it is changed.
#[derive(Debug)]
struct Lock(File);

impl Drop for Lock {
    /// Lets go of the lock and does not merely close the file: a process that is being started
    /// elsewhere in this one holds a copy of the handle, and with it the lock, until it begins.
    fn drop(&mut self) {
        // What cannot be unlocked is closed right after.
        let _closed = self.0.unlock();
    }
}

/// Rows of a shard: a few hundred MB of motion at most.
const SHARD_ROWS: u64 = 4096;

/// Facts that the files of a table carry.
pub fn table_facts(skeleton: &Skeleton, plan_hash: &str) -> [(&'static str, String); 2] {
    [
        ("skeleton", skeleton.name().to_owned()),
        ("plan_hash", plan_hash.to_owned()),
    ]
}

/// Commits a table of rows that are all in memory. If the folder already holds this table by the
/// same plan, nothing is written. `split_of` is none for tables without splits.
///
/// # Errors
/// The folder is locked or cannot be written.
pub fn commit_rows<R: Row>(
    root: &Path,
    rows: &[R],
    split_of: Option<fn(&R) -> Split>,
    skeleton: &Skeleton,
    plan_hash: &str,
    holder: &str,
) -> Result<Dataset, Error> {
    commit_table::<R>(root, skeleton, plan_hash, holder, |transaction| {
        transaction.write_rows(rows, split_of, skeleton, plan_hash)
    })
}

/// Commits the files of a table that `write` writes. If the folder already holds this table by the
/// same plan, nothing is written.
///
/// # Errors
/// The folder is locked or cannot be written, or `write` fails.
pub fn commit_table<R: Row>(
    root: &Path,
    skeleton: &Skeleton,
    plan_hash: &str,
    holder: &str,
    write: impl FnOnce(&Transaction) -> Result<Vec<FileEntry>, Error>,
) -> Result<Dataset, Error> {
    let transaction = Transaction::begin(root, holder)?;
    let recorded = transaction.base().and_then(|base| base.plans.get(R::TABLE));
    if recorded.is_some_and(|recorded| recorded == plan_hash) {
        drop(transaction);
        return Dataset::open(root);
    }
    let entries = write(&transaction)?;
    transaction.commit(Commit {
        tables: BTreeMap::from([(R::TABLE.to_owned(), entries)]),
        plan_hash: plan_hash.to_owned(),
        skeleton: skeleton.clone(),
        ..Commit::default()
    })
}

/// What a commit adds to the dataset.
#[derive(Clone, Debug, Default)]
pub struct Commit {
    /// Files of the tables that this run made; they replace those of the same table.
    pub tables: BTreeMap<String, Vec<FileEntry>>,
    /// Hash of the plan that made them.
    pub plan_hash: String,
    /// The skeleton motions are posed on.
    pub skeleton: Skeleton,
    /// What became of the sources, for a run that read any.
    pub accounting: Option<Accounting>,
    /// Facts to add.
    pub facts: BTreeMap<String, String>,
    /// Keep no table of the version before: they followed from motions that are replaced.
    pub fresh: bool,
}

impl Transaction {
    /// Locks a folder, creating it if needed, and clears what a killed run left half-written.
    /// `holder` is what another run is told while this one holds the lock.
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

    /// The card and the metadata lie in the dataset's own folder, among files that may be anybody's.
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

    fn version(&self) -> u64 {
        self.base.as_ref().map_or(1, |base| base.version + 1)
    }

    /// Path of a shard relative to the dataset. A table that replaces an earlier one gets names of
    /// its own, so that readers of the earlier version keep their files.
    fn shard_path(&self, name: &ShardName) -> String {
        let replaces = self
            .base
            .as_ref()
            .is_some_and(|base| base.tables.contains_key(name.table));
        let suffix = if replaces {
            format!(".v{}", self.version())
        } else {
            String::new()
        };
        format!("{DATA}/{}/{}{suffix}.parquet", name.table, name.stem())
    }

    /// Writes a shard whole or not at all. It belongs to the dataset once it is committed.
    ///
    /// # Errors
    /// The rows cannot be encoded or the file cannot be written.
    pub fn write_shard<R: Row>(
        &self,
        name: &ShardName,
        rows: &[R],
        facts: &[(&str, String)],
    ) -> Result<FileEntry, Error> {
        let relative = self.shard_path(name);
        let path = self.root.join(&relative);
        if let Some(folder) = path.parent() {
            self.store
                .create_dir_all(folder)
                .map_err(Error::io("create folder", folder))?;
        }
        write_atomically(self.store.as_ref(), &path, |file| {
            table::write_rows(file, &path, rows, facts)
        })?;
        // Read back, so that the hashes are of what is on the disk.
        let written = self.store.read(&path).map_err(Error::io("read", &path))?;
        let sha256 = Sha256::digest(&written);
        Ok(FileEntry {
            path: relative,
            split: name.split,
            rows: rows.len() as u64,
            bytes: written.len() as u64,
            blake3: blake3::hash(&written).to_hex().to_string(),
            sha256: sha256.iter().map(|byte| format!("{byte:02x}")).collect(),
        })
    }

    /// Writes all rows of a table, shard by shard. They belong to the dataset once they are
    /// committed. `split_of` is none for tables without splits.
    ///
    /// # Errors
    /// The rows cannot be encoded or a file cannot be written.
    pub fn write_rows<R: Row>(
        &self,
        rows: &[R],
        split_of: Option<fn(&R) -> Split>,
        skeleton: &Skeleton,
        plan_hash: &str,
    ) -> Result<Vec<FileEntry>, Error> {
        let facts = table_facts(skeleton, plan_hash);
        let Some(split_of) = split_of else {
            return self.write_shards(None, rows, &facts);
        };
        let mut entries = Vec::new();
        for split in Split::ALL {
            let rows = rows.iter().filter(|row| split_of(row) == split);
            let rows: Vec<R> = rows.cloned().collect();
            entries.extend(self.write_shards(Some(split), &rows, &facts)?);
        }
        Ok(entries)
    }

    /// Writes the rows of a split, or of a table without splits: one shard even if there are none.
    ///
    /// # Errors
    /// As [`Transaction::write_rows`].
    pub fn write_shards<R: Row>(
        &self,
        split: Option<Split>,
        rows: &[R],
        facts: &[(&str, String)],
    ) -> Result<Vec<FileEntry>, Error> {
        let made = |range: Range<u64>| rows[range.start as usize..range.end as usize].to_vec();
        self.write_made(split, rows.len() as u64, made, facts)
    }

    /// Writes rows that are made shard by shard, so that few are in memory at a time. `make` gets the
    /// range of rows it is to give.
    ///
    /// # Errors
    /// As [`Transaction::write_rows`].
    pub fn write_made<R: Row>(
        &self,
        split: Option<Split>,
        num_rows: u64,
        mut make: impl FnMut(Range<u64>) -> Vec<R>,
        facts: &[(&str, String)],
    ) -> Result<Vec<FileEntry>, Error> {
        let of = num_rows.div_ceil(SHARD_ROWS).max(1);
        (0..of)
            .map(|index| {
                let name = ShardName {
                    table: R::TABLE,
                    split,
                    index: index as usize,
                    of: of as usize,
                };
                let end = num_rows.min((index + 1) * SHARD_ROWS);
                self.write_shard(&name, &make(index * SHARD_ROWS..end), facts)
            })
            .collect()
    }

    fn staged_path(&self, plan_hash: &str, name: &ShardName) -> PathBuf {
        self.root
            .join(META)
            .join(STAGED)
            .join(plan_hash)
            .join(format!("{}-{}.json", name.table, name.stem()))
    }

    /// Remembers that a shard of a plan is done, with whatever its maker needs at the commit, so
    /// that an interrupted run continues after it.
    ///
    /// # Errors
    /// The note cannot be written.
    pub fn stage<T: Serialize>(
        &self,
        plan_hash: &str,
        name: &ShardName,
        entry: &FileEntry,
        notes: &T,
    ) -> Result<(), Error> {
        let path = self.staged_path(plan_hash, name);
        if let Some(folder) = path.parent() {
            self.store
                .create_dir_all(folder)
                .map_err(Error::io("create folder", folder))?;
        }
        write_json(self.store.as_ref(), &path, &(entry, notes))
    }

    fn hash(&self, path: &Path) -> Result<String, Error> {
        self.store.hash(path).map_err(Error::io("read", path))
    }

    /// The shard a run of the same plan has staged before, if its file is still whole.
    ///
    /// # Errors
    /// The shard's file exists but cannot be read.
    pub fn staged<T: DeserializeOwned>(
        &self,
        plan_hash: &str,
        name: &ShardName,
    ) -> Result<Option<(FileEntry, T)>, Error> {
        let Ok(text) = self.store.read(&self.staged_path(plan_hash, name)) else {
            return Ok(None);
        };
        // A note that cannot be read, or whose file changed, only means doing the shard again.
        let Ok((entry, notes)) = serde_json::from_slice::<(FileEntry, T)>(&text) else {
            return Ok(None);
        };
        let whole = self.holds(std::iter::once(&entry))?;
        Ok(whole.then_some((entry, notes)))
    }

    /// What the run writes through.
    pub fn store(&self) -> Arc<dyn Store> {
        Arc::clone(&self.store)
    }

    /// The dataset's folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Whether files this run or an interrupted one wrote are still whole.
    ///
    /// # Errors
    /// A file exists but cannot be read.
    pub fn holds<'a>(&self, files: impl Iterator<Item = &'a FileEntry>) -> Result<bool, Error> {
        for file in files {
            let path = self.root.join(&file.path);
            if !path.is_file() || self.hash(&path)? != file.blake3 {
                return Ok(false);
            }
        }
        Ok(true)
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
            manifest.tables.clear();
            manifest.plans.clear();
            manifest.facts.clear();
        }
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

    /// Finishes what a run that was killed right after its commit left undone: the files that
    /// follow from the manifest, and the removal of those that no manifest names.
    ///
    /// # Errors
    /// A file cannot be written or removed; the dataset itself is whole.
    pub fn finish(self) -> Result<(), Error> {
        match &self.base {
            Some(manifest) => self.settle(manifest),
            None => Ok(()),
        }
    }

    fn settle(&self, manifest: &Manifest) -> Result<(), Error> {
        for (name, text) in [
            (card::FILE, card::text(manifest)),
            (croissant::FILE, croissant::text(manifest)),
        ] {
            let path = self.root.join(name);
            // A file that cannot be read is written anew like one that differs.
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

    /// Removes notes of finished plans and data files that no manifest names.
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

    /// Removes the files under `data/` and `meta/` that `unwanted(name, relative path)` picks.
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

fn write_json<T: Serialize>(store: &dyn Store, path: &Path, value: &T) -> Result<(), Error> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{MaskRow, MotionRow};
    use crate::table::{Caption, PartCaption, Quality};
    use crate::{Fps, Motion, MotionId, Pose};

    fn row(index: usize) -> MotionRow {
        let poses: Vec<Pose> = (0..5 + index)
            .map(|frame| {
                let mut pose = Pose::REST;
                pose.transl.x = frame as f64 * 0.01 + index as f64;
                pose.rotations[5] = kinematics::rotation::from_axis_angle(glam::DVec3::X * 0.1);
                pose
            })
            .collect();
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        MotionRow {
            id: MotionId::parse(&format!("clip{index}")).expect("valid"),
            split: Split::Train,
            source: "bvh".to_owned(),
            source_path: format!("clip{index}.bvh"),
            source_hash: "00".to_owned(),
            license: index.is_multiple_of(2).then(|| "CC0-1.0".to_owned()),
            mirrored_of: None,
            skeleton: "smplx-neutral".to_owned(),
            fps: 20.0,
            fps_source: 30.0,
            start_frame: 0,
            end_frame: 9,
            n_frames: motion.len() as i32,
            transl: motion.transl().to_vec(),
            global_orient: motion.global_orient().to_vec(),
            body_pose: motion.body_pose().to_vec(),
            rotation_source: "native".to_owned(),
            fit_error_m: index.is_multiple_of(3).then_some(0.01),
            captions: vec![
                Caption {
                    text: "a person walks, \"proudly\"".to_owned(),
                    ..Caption::default()
                };
                index % 3
            ],
            part_captions: vec![PartCaption::default(); index % 2],
            action: None,
            style: Some("proud".to_owned()),
            notes: vec!["frame 0 was dropped".to_owned()],
            content_hash: motion.content_hash(),
            quality: Quality {
                flags: 3,
                max_speed: 1.5,
                foot_skate: 0.25,
            },
        }
    }

    fn shard(index: usize, of: usize) -> ShardName {
        ShardName {
            table: MotionRow::TABLE,
            split: Some(Split::Train),
            index,
            of,
        }
    }

    fn commit_motions(root: &Path, rows: &[MotionRow]) -> Dataset {
        let transaction = Transaction::begin(root, "test").expect("lock");
        let entry = transaction
            .write_shard(&shard(0, 1), rows, &[("units", "m".to_owned())])
            .expect("writes");
        transaction
            .commit(Commit {
                tables: BTreeMap::from([(MotionRow::TABLE.to_owned(), vec![entry])]),
                plan_hash: "p".to_owned(),
                skeleton: Skeleton::smplx_neutral(),
                ..Commit::default()
            })
            .expect("commits")
    }

    #[test]
    fn single_clips_are_read_as_they_were_written() {
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("shard.parquet");
        let rows: Vec<MotionRow> = (0..40).map(row).collect();
        let bytes = crate::table::write_rows(Vec::new(), &path, &rows, &[]).expect("written");
        std::fs::write(&path, bytes).expect("written");
        let reader = crate::table::ClipReader::open(&path).expect("a shard");
        assert_eq!(reader.ids().len(), rows.len());
        // On several threads: they share the file and nothing else.
        std::thread::scope(|scope| {
            for start in 0..4 {
                let (reader, rows, path) = (&reader, &rows, &path);
                scope.spawn(move || {
                    for at in (0..rows.len()).map(|i| (i * 7 + start) % rows.len()) {
                        assert_eq!(reader.ids()[at], rows[at].id);
                        let motion = reader.motion(at).expect("read");
                        assert_eq!(motion, rows[at].motion().expect("valid"));
                        let one: Vec<MotionRow> =
                            crate::table::read_rows_at(path, &[at]).expect("read");
                        assert_eq!(one[0], rows[at]);
                    }
                });
            }
        });
    }

    #[test]
    fn rows_come_back_bit_for_bit_and_bytes_repeat() {
        let (a, b) = (
            tempfile::tempdir().expect("dir"),
            tempfile::tempdir().expect("dir"),
        );
        let rows: Vec<MotionRow> = (0..300).map(row).collect();
        let first = commit_motions(a.path(), &rows);
        let second = commit_motions(b.path(), &rows);
        assert_eq!(first.manifest().root_hash, second.manifest().root_hash);
        let read: Vec<MotionRow> = Dataset::open(a.path())
            .expect("opens")
            .read(None)
            .expect("reads");
        assert_eq!(read, rows);
        assert_eq!(
            read[7].motion().expect("valid").content_hash(),
            rows[7].content_hash
        );
    }

    #[test]
    fn single_rows_are_read_by_their_place() {
        let dir = tempfile::tempdir().expect("dir");
        let rows: Vec<MotionRow> = (0..300).map(row).collect();
        let dataset = commit_motions(dir.path(), &rows);
        let (path, _) = &dataset.files(MotionRow::TABLE, None)[0];
        let some: Vec<MotionRow> = table::read_rows_at(path, &[299, 0, 257, 0]).expect("reads");
        assert_eq!(
            some,
            [rows[0].clone(), rows[257].clone(), rows[299].clone()]
        );
    }

    #[test]
    fn an_altered_byte_is_found_on_open() {
        let dir = tempfile::tempdir().expect("dir");
        let dataset = commit_motions(dir.path(), &[row(0), row(1)]);
        let (path, _) = dataset.files(MotionRow::TABLE, None).remove(0);
        let mut bytes = fs::read(&path).expect("reads");
        let middle = bytes.len() / 3;
        bytes[middle] ^= 1;
        fs::write(&path, bytes).expect("writes");
        assert!(matches!(
            Dataset::open(dir.path()),
            Err(Error::Corrupt { .. })
        ));
    }

    #[test]
    fn the_lock_names_its_holder_and_ends_with_the_run() {
        let dir = tempfile::tempdir().expect("dir");
        let first = Transaction::begin(dir.path(), "run 1 of tests").expect("lock");
        match Transaction::begin(dir.path(), "run 2") {
            Err(Error::Locked { holder, .. }) => assert_eq!(holder, "run 1 of tests"),
            other => panic!("expected a lock error, got {other:?}"),
        }
        drop(first);
        assert!(Transaction::begin(dir.path(), "run 3").is_ok());
    }

    #[test]
    fn a_staged_shard_is_found_again_unless_its_file_changed() {
        let dir = tempfile::tempdir().expect("dir");
        let transaction = Transaction::begin(dir.path(), "t").expect("lock");
        let name = shard(0, 2);
        let entry = transaction
            .write_shard(&name, &[row(1)], &[])
            .expect("writes");
        transaction
            .stage("plan", &name, &entry, &vec![1u32, 2])
            .expect("stages");
        drop(transaction);

        let transaction = Transaction::begin(dir.path(), "t").expect("lock");
        let found = transaction
            .staged::<Vec<u32>>("plan", &name)
            .expect("reads");
        assert_eq!(found, Some((entry.clone(), vec![1, 2])));
        assert_eq!(
            transaction
                .staged::<Vec<u32>>("other plan", &name)
                .expect("reads"),
            None
        );
        fs::write(dir.path().join(&entry.path), b"cut off").expect("writes");
        assert_eq!(
            transaction
                .staged::<Vec<u32>>("plan", &name)
                .expect("reads"),
            None
        );
    }

    #[test]
    fn a_replaced_table_keeps_the_old_version_readable() {
        let dir = tempfile::tempdir().expect("dir");
        let old = commit_motions(dir.path(), &[row(0)]);
        let new = commit_motions(dir.path(), &[row(1), row(2)]);
        assert_eq!(new.manifest().version, 2);
        assert_eq!(old.read::<MotionRow>(None).expect("reads"), [row(0)]);
        assert_eq!(
            Dataset::open(dir.path())
                .expect("opens")
                .read::<MotionRow>(None)
                .expect("reads")
                .len(),
            2
        );
        // Nothing temporary and nothing unnamed is left.
        let names: Vec<_> = fs::read_dir(dir.path().join("data/motions"))
            .expect("lists")
            .map(|entry| entry.expect("entry").file_name())
            .collect();
        assert_eq!(names.len(), 2);
    }

    #[test]
    fn another_table_in_place_of_the_expected_one_is_an_error() {
        let dir = tempfile::tempdir().expect("dir");
        let dataset = commit_motions(dir.path(), &[row(0)]);
        let (path, _) = &dataset.files(MotionRow::TABLE, None)[0];
        assert!(matches!(
            table::read_rows::<MaskRow>(path),
            Err(Error::Column { column, .. }) if column == "motion_id"
        ));
    }

    #[test]
    fn folders_that_are_no_dataset_say_so() {
        let dir = tempfile::tempdir().expect("dir");
        assert!(matches!(
            Dataset::open(dir.path()),
            Err(Error::NotADataset { .. })
        ));
        let missing = dir.path().join("missing");
        assert!(matches!(
            Dataset::open(&missing),
            Err(Error::NotADataset { .. })
        ));
    }
}
