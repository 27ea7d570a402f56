//! Shards that a run writes.

use std::ops::Range;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::layout::{DATA, ShardName};
use super::transaction::Transaction;
use crate::manifest::FileEntry;
use crate::store::{Store, aside, is_url, write_atomically, write_new};
use crate::table::{self, Row};
use crate::{Error, Skeleton, Split};

/// Rows of a shard: a few hundred MB of motion at most.
pub const SHARD_ROWS: u64 = 4096;

/// Facts that the files of a table carry.
pub fn table_facts(skeleton: &Skeleton, plan_hash: &str) -> [(&'static str, String); 2] {
    [
        ("skeleton", skeleton.name().to_owned()),
        ("plan_hash", plan_hash.to_owned()),
    ]
}

/// Path of a shard relative to the dataset. A table that an earlier version has gets new names, so that this version
/// keeps its files; `replacing` is then the number of the new version.
pub(super) fn shard_path(name: &ShardName, replacing: Option<u64>) -> String {
    let suffix = replacing.map_or(String::new(), |version| format!(".v{version}"));
    format!("{DATA}/{}/{}{suffix}.parquet", name.table, name.stem())
}

/// Writes a shard to a path, complete or not at all. Its entry has the path `relative`.
pub(super) fn write_shard_at<R: Row>(
    store: &dyn Store,
    relative: String,
    path: &Path,
    name: &ShardName,
    rows: &[R],
    facts: &[(&str, String)],
) -> Result<FileEntry, Error> {
    if let Some(folder) = path.parent() {
        store
            .create_dir_all(folder)
            .map_err(Error::io("create folder", folder))?;
    }
    if is_url(path) {
        // An object store verifies what it receives, so the file is not read back.
        let written = table::write_rows(Vec::new(), path, rows, facts)?;
        write_atomically(store, path, |mut file| {
            file.write_all(&written).map_err(Error::io("write", path))?;
            Ok(file)
        })?;
        return Ok(entry(relative, name, rows.len(), &written));
    }
    write_atomically(store, path, |file| {
        table::write_rows(file, path, rows, facts)
    })?;
    // Read back, so that the hashes cover the bytes on the disk.
    let written = store.read(path).map_err(Error::io("read", path))?;
    Ok(entry(relative, name, rows.len(), &written))
}

fn entry(path: String, name: &ShardName, num_rows: usize, written: &[u8]) -> FileEntry {
    let sha256 = Sha256::digest(written);
    FileEntry {
        path,
        split: name.split,
        rows: num_rows as u64,
        bytes: written.len() as u64,
        blake3: blake3::hash(written).to_hex().to_string(),
        sha256: sha256.iter().map(|byte| format!("{byte:02x}")).collect(),
    }
}

/// Whether all files are present and match their entries (see [`Store::difference`]).
pub(super) fn holds<'a>(
    store: &dyn Store,
    files: impl Iterator<Item = &'a FileEntry>,
    path_of: impl Fn(&FileEntry) -> PathBuf,
) -> Result<bool, Error> {
    for file in files {
        let path = path_of(file);
        match store.difference(&path, file.bytes, &file.blake3) {
            Ok(None) => {}
            Ok(Some(_)) => return Ok(false),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(false),
            Err(error) => return Err(Error::io("read", &path)(error)),
        }
    }
    Ok(true)
}

impl Transaction {
    /// Writes a shard whole or not at all. Where other runs may write at the same time, it replaces no file: if a file
    /// of this name holds something else, the shard gets another name. The shard belongs to the dataset once it is
    /// committed.
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
        let relative = shard_path(name, replaces.then(|| self.version()));
        let path = self.root.join(&relative);
        if self.is_alone() {
            let path = aside(&path).unwrap_or(path);
            return write_shard_at(self.store.as_ref(), relative, &path, name, rows, facts);
        }
        let bytes = table::write_rows(Vec::new(), &path, rows, facts)?;
        let relative = self.add(&relative, &bytes)?;
        Ok(entry(relative, name, rows.len(), &bytes))
    }

    /// Writes a file that must not replace another one, and returns its path. If an interrupted or concurrent run has
    /// written the same content, its file is used. If a file of this name holds something else, the new file gets
    /// another name.
    pub(super) fn add(&self, relative: &str, bytes: &[u8]) -> Result<String, Error> {
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
        let made = |range: Range<u64>| -> Result<Vec<R>, Error> {
            Ok(rows[range.start as usize..range.end as usize].to_vec())
        };
        self.write_made(split, rows.len() as u64, made, facts)
    }

    /// Writes rows that `make` produces for one shard after another, so that only one shard's rows are in memory.
    /// `make` gets the range of rows.
    ///
    /// # Errors
    /// `make` fails, the rows cannot be encoded, or a file cannot be written.
    pub fn write_made<R: Row, E: From<Error>>(
        &self,
        split: Option<Split>,
        num_rows: u64,
        mut make: impl FnMut(Range<u64>) -> Result<Vec<R>, E>,
        facts: &[(&str, String)],
    ) -> Result<Vec<FileEntry>, E> {
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
                Ok(self.write_shard(&name, &make(index * SHARD_ROWS..end)?, facts)?)
            })
            .collect()
    }
}
