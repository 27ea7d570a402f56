//! Shards that a run writes or finds staged.

use std::ops::Range;
use std::path::PathBuf;

use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::layout::{DATA, META, STAGED, ShardName};
use super::transaction::{Transaction, write_json};
use crate::manifest::FileEntry;
use crate::store::{write_atomically, write_new};
use crate::table::{self, Row};
use crate::{Error, Skeleton, Split};

/// Rows of a shard: a few hundred MB of motion at most.
const SHARD_ROWS: u64 = 4096;

/// Facts that the files of a table carry.
pub fn table_facts(skeleton: &Skeleton, plan_hash: &str) -> [(&'static str, String); 2] {
    [
        ("skeleton", skeleton.name().to_owned()),
        ("plan_hash", plan_hash.to_owned()),
    ]
}

impl Transaction {
    /// Path of a shard relative to the dataset. A table that replaces an earlier one gets new names, so
    /// that readers of the earlier version keep their files.
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

    /// Writes a shard whole or not at all. Where other runs may write at the same time, it replaces no file: if
    /// one of its name holds something else, it gets another name. It belongs to the dataset once it is committed.
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
        let (relative, written) = if self.is_alone() {
            if let Some(folder) = path.parent() {
                self.store
                    .create_dir_all(folder)
                    .map_err(Error::io("create folder", folder))?;
            }
            write_atomically(self.store.as_ref(), &path, |file| {
                table::write_rows(file, &path, rows, facts)
            })?;
            // Read back, so that the hashes cover the bytes on the disk.
            let written = self.store.read(&path).map_err(Error::io("read", &path))?;
            (relative, written)
        } else {
            let bytes = table::write_rows(Vec::new(), &path, rows, facts)?;
            (self.add(&relative, &bytes)?, bytes)
        };
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

    /// Writes a file that must not replace another one, and returns its path. If a run that was interrupted,
    /// or one at the same time, has written the same, that file serves. If it has written something else under
    /// this name, the file gets another name.
    fn add(&self, relative: &str, bytes: &[u8]) -> Result<String, Error> {
        let hash = blake3::hash(bytes).to_hex().to_string();
        let stem = relative.strip_suffix(".parquet").unwrap_or(relative);
        let names = (2..).map(|number| format!("{stem}.{number}.parquet"));
        for name in std::iter::once(relative.to_owned()).chain(names) {
            let path = self.root.join(&name);
            let store = self.store.as_ref();
            if write_new(store, &path, bytes)?
                || store.hash(&path).map_err(Error::io("read", &path))? == hash
            {
                return Ok(name);
            }
        }
        unreachable!("there is always another number")
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

    /// Writes rows that `make` produces shard by shard, so that few are in memory at a time. `make` gets
    /// the range of rows.
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

    /// Records that a shard of a plan is done, with notes for the commit, so that an interrupted run
    /// continues after it.
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

    /// The shard that an earlier run of the same plan staged, if its file is unchanged.
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
        // If the note is unreadable or its file changed, the shard is made again.
        let Ok((entry, notes)) = serde_json::from_slice::<(FileEntry, T)>(&text) else {
            return Ok(None);
        };
        let whole = self.holds(std::iter::once(&entry))?;
        Ok(whole.then_some((entry, notes)))
    }

    /// Whether the files are present and as stated, as
    /// [`Store::difference`](crate::store::Store::difference) tells.
    ///
    /// # Errors
    /// A file exists but cannot be read.
    pub fn holds<'a>(&self, files: impl Iterator<Item = &'a FileEntry>) -> Result<bool, Error> {
        for file in files {
            let path = self.root.join(&file.path);
            match self.store.difference(&path, file.bytes, &file.blake3) {
                Ok(None) => {}
                Ok(Some(_)) => return Ok(false),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(false),
                Err(error) => return Err(Error::io("read", &path)(error)),
            }
        }
        Ok(true)
    }
}
