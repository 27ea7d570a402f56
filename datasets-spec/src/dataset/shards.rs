//! Shards that a run writes.

use std::borrow::Cow;
use std::io::{self, BufRead, BufReader, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::layout::{DATA, ShardName};
use super::transaction::Transaction;
use crate::manifest::FileEntry;
use crate::store::{Store, aside, create_folder, is_url, write_bytes, write_new};
use crate::table::{self, Row};
use crate::{Error, Skeleton, Split};

/// Most rows in a shard. Of motions these are a few hundred MB.
pub const SHARD_ROWS: u64 = 4096;

/// Facts for the metadata of a table's files: the skeleton and the plan hash.
pub fn table_facts(skeleton: &Skeleton, plan_hash: &str) -> [(&'static str, String); 2] {
    [
        ("skeleton", skeleton.name().to_owned()),
        ("plan_hash", plan_hash.to_owned()),
    ]
}

/// Path of a shard relative to the dataset. If an earlier version has this table, `replacing` is the number of the new
/// version; it becomes part of the name, so that the earlier version keeps its files.
pub(super) fn shard_path(name: &ShardName, replacing: Option<u64>) -> String {
    let suffix = replacing.map_or(String::new(), |version| format!(".v{version}"));
    format!("{DATA}/{}/{name}{suffix}.parquet", name.table)
}

/// Writes a shard to `path`, complete or not at all. The returned entry states the path `relative`.
pub(super) fn write_shard_at<'a, R: Row + 'a, E: From<Error>>(
    store: &dyn Store,
    relative: String,
    path: &Path,
    name: &ShardName,
    groups: impl Iterator<Item = Result<Cow<'a, [R]>, E>>,
    facts: &[(&str, String)],
) -> Result<FileEntry, E> {
    if let Some(folder) = path.parent() {
        create_folder(store, folder)?;
    }
    let (mut rows, mut written) = (0, Hashes::default());
    let groups = groups.inspect(|group| rows += group.as_ref().map_or(0, |rows| rows.len()));
    if is_url(path) {
        // An object store verifies what it receives, so the file is not read back.
        let bytes = table::write_groups(Vec::new(), path, groups, facts)?;
        written.add(&bytes);
        write_bytes(store, path, &bytes)?;
    } else {
        let file = store.create(path).map_err(Error::io("create", path))?;
        let file = table::write_groups(file, path, groups, facts)?;
        file.publish().map_err(Error::io("write", path))?;
        // Read the file back, so that the hashes cover the bytes on the disk.
        let read = store.open(path).and_then(|file| written.add_all(file));
        read.map_err(Error::io("read", path))?;
    }
    Ok(entry(relative, name, rows, written))
}

/// Hashes and size of a file.
#[derive(Default)]
struct Hashes {
    blake3: blake3::Hasher,
    sha256: Sha256,
    bytes: u64,
}

impl Hashes {
    fn add(&mut self, bytes: &[u8]) {
        self.blake3.update(bytes);
        self.sha256.update(bytes);
        self.bytes += bytes.len() as u64;
    }

    fn add_all(&mut self, file: impl Read) -> io::Result<()> {
        const BUFFER: usize = 1 << 20;
        let mut file = BufReader::with_capacity(BUFFER, file);
        loop {
            let bytes = file.fill_buf()?;
            if bytes.is_empty() {
                return Ok(());
            }
            self.add(bytes);
            let length = bytes.len();
            file.consume(length);
        }
    }
}

fn entry(path: String, name: &ShardName, num_rows: usize, written: Hashes) -> FileEntry {
    let sha256 = written.sha256.finalize();
    FileEntry {
        path,
        split: name.split,
        rows: num_rows as u64,
        bytes: written.bytes,
        blake3: written.blake3.finalize().to_hex().to_string(),
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
    /// Writes a shard whole or not at all. On storage without locks no file is replaced: if a file of this name holds
    /// something else, the shard gets another name. The shard belongs to the dataset once it is committed.
    ///
    /// # Errors
    /// The rows cannot be encoded or the file cannot be written.
    pub fn write_shard<R: Row>(
        &self,
        name: &ShardName,
        rows: &[R],
        facts: &[(&str, String)],
    ) -> Result<FileEntry, Error> {
        self.write_groups(name, table::borrowed_groups(rows), facts)
    }

    fn write_groups<'a, R: Row + 'a, E: From<Error>>(
        &self,
        name: &ShardName,
        groups: impl Iterator<Item = Result<Cow<'a, [R]>, E>>,
        facts: &[(&str, String)],
    ) -> Result<FileEntry, E> {
        let replaces = self.taken.contains(name.table);
        let relative = shard_path(name, replaces.then(|| self.version()));
        let path = self.root.join(&relative);
        if self.is_alone() {
            let path = aside(&path).unwrap_or(path);
            return write_shard_at(self.store.as_ref(), relative, &path, name, groups, facts);
        }
        let mut rows = 0;
        let groups = groups.inspect(|group| rows += group.as_ref().map_or(0, |rows| rows.len()));
        let bytes = table::write_groups(Vec::new(), &path, groups, facts)?;
        let relative = self.add(&relative, &bytes)?;
        let mut written = Hashes::default();
        written.add(&bytes);
        Ok(entry(relative, name, rows, written))
    }

    /// Writes a file without replacing another one, and returns its relative path. If an interrupted or concurrent run
    /// has written the same content, its file is used. If a file of this name holds something else, the new file gets
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

    /// Writes all rows of a table, shard by shard. They belong to the dataset once they are committed. `split_of` is
    /// `None` for tables without splits.
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
            let rows: Vec<&R> = rows.iter().filter(|row| split_of(row) == split).collect();
            let made = |range: Range<usize>| Ok(rows[range].iter().copied().cloned().collect());
            entries.extend(self.write_made::<R, Error>(Some(split), rows.len(), made, &facts)?);
        }
        Ok(entries)
    }

    /// Writes the rows of a split, or of a table without splits. If there are none, it writes one empty shard.
    ///
    /// # Errors
    /// As [`Transaction::write_rows`].
    pub fn write_shards<R: Row>(
        &self,
        split: Option<Split>,
        rows: &[R],
        facts: &[(&str, String)],
    ) -> Result<Vec<FileEntry>, Error> {
        shards_of::<R>(split, rows.len())
            .map(|(name, range)| self.write_shard(&name, &rows[range], facts))
            .collect()
    }

    /// Writes rows that `make` produces, one row group after another, so that only one group is in memory. `make` gets
    /// the range of rows to produce.
    ///
    /// # Errors
    /// `make` fails, the rows cannot be encoded, or a file cannot be written.
    pub fn write_made<R: Row, E: From<Error>>(
        &self,
        split: Option<Split>,
        num_rows: usize,
        mut make: impl FnMut(Range<usize>) -> Result<Vec<R>, E>,
        facts: &[(&str, String)],
    ) -> Result<Vec<FileEntry>, E> {
        shards_of::<R>(split, num_rows)
            .map(|(name, range)| {
                let starts = range.clone().step_by(table::group_rows::<R>());
                let groups = starts.map(|start| {
                    let end = range.end.min(start + table::group_rows::<R>());
                    make(start..end).map(Cow::Owned)
                });
                self.write_groups(&name, groups, facts)
            })
            .collect()
    }
}

/// Names of the shards of a table with this number of rows, and the rows of each.
fn shards_of<R: Row>(
    split: Option<Split>,
    num_rows: usize,
) -> impl Iterator<Item = (ShardName, Range<usize>)> {
    let each = SHARD_ROWS as usize;
    let of = num_rows.div_ceil(each).max(1);
    (0..of).map(move |index| {
        let name = ShardName {
            table: R::TABLE,
            split,
            index,
            of,
        };
        (name, index * each..num_rows.min((index + 1) * each))
    })
}
