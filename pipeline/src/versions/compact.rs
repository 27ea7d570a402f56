//! Rewrites a dataset into as few files as a new one has.

use std::collections::BTreeMap;
use std::path::PathBuf;

use datasets_spec::dataset::{Commit, SHARD_ROWS};
use datasets_spec::manifest::{FileEntry, LAID_OUT_FACT, Manifest, plan_hash};
use datasets_spec::record::{MaskRow, PairRow, QuarantineRow, SkippedRow};
use datasets_spec::table::{Row, ShardReader, read_rows};
use datasets_spec::{Dataset, Progress, Split, Transaction};
use serde::Serialize;

use super::rows::ClipIndex;
use crate::Error;
use crate::clip_table::{CLIP_TABLES, borrowed};

/// Files of a dataset, and their size.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Layout {
    /// Files of all tables.
    pub files: u64,
    /// Total size of the files in bytes.
    pub bytes: u64,
    /// Files of each table.
    pub tables: BTreeMap<String, u64>,
}

impl Layout {
    fn of(manifest: &Manifest) -> Self {
        let files = manifest.tables.values().flatten();
        let tables = manifest.tables.iter();
        Self {
            files: files.clone().count() as u64,
            bytes: files.map(|file| file.bytes).sum(),
            tables: tables
                .map(|(table, files)| (table.clone(), files.len() as u64))
                .collect(),
        }
    }
}

/// Result of [`compact`].
#[derive(Clone, Debug, Serialize)]
pub struct Compacted {
    /// Number of the version that was made, or of the newest one if there was nothing to do.
    pub version: u64,
    /// Whether the dataset was as compact as it can be.
    pub already_compact: bool,
    /// Files of the previous version.
    pub before: Layout,
    /// Files of the result.
    pub after: Layout,
    /// Hash of the result.
    pub root_hash: String,
}

/// Writes the rows of every table into as few files as a new dataset has. Their order and content stay, and so do the
/// hashes that stages recorded. Memory holds one shard.
///
/// # Errors
/// A file is damaged, or the folder cannot be written.
pub fn compact(transaction: Transaction, progress: &dyn Progress) -> Result<Compacted, Error> {
    let dataset = Dataset::open(transaction.root())?;
    let manifest = dataset.manifest();
    let before = Layout::of(manifest);
    let mut tables = BTreeMap::new();
    let index = ClipIndex::read(&dataset)?;
    let num_shards = |table: &str| manifest.tables.get(table).map_or(0, Vec::len);
    if CLIP_TABLES
        .into_iter()
        .any(|table| num_shards(table) > index.num_shards().max(1))
    {
        tables = index.write(&transaction, progress)?;
    }
    let place = (&dataset, &transaction);
    rewrite::<MaskRow>(place, &mut tables)?;
    rewrite::<PairRow>(place, &mut tables)?;
    rewrite::<QuarantineRow>(place, &mut tables)?;
    rewrite::<SkippedRow>(place, &mut tables)?;
    if tables.is_empty() {
        transaction.finish()?;
        return Ok(Compacted {
            version: manifest.version,
            already_compact: true,
            after: before.clone(),
            before,
            root_hash: manifest.root_hash.clone(),
        });
    }
    let rewritten = tables.keys();
    let plans =
        rewritten.filter_map(|table| Some((table.clone(), manifest.plans.get(table)?.clone())));
    let done = transaction.commit(Commit {
        plans: plans.collect(),
        plan_hash: plan_hash("compact", &manifest.root_hash),
        skeleton: dataset.skeleton()?,
        facts: BTreeMap::from([(LAID_OUT_FACT.to_owned(), manifest.laid_out(&tables))]),
        tables,
        ..Commit::default()
    })?;
    Ok(Compacted {
        version: done.manifest().version,
        already_compact: false,
        before,
        after: Layout::of(done.manifest()),
        root_hash: done.manifest().root_hash.clone(),
    })
}

/// Writes a table of small rows into fewer files, if that is possible.
fn rewrite<R: Row>(
    (dataset, transaction): (&Dataset, &Transaction),
    tables: &mut BTreeMap<String, Vec<FileEntry>>,
) -> Result<(), Error> {
    let all = dataset.files(R::TABLE, None);
    let splits = std::iter::once(None).chain(Split::ALL.map(Some));
    let by_split = splits.map(|split| {
        let files = all.iter().filter(|(_, file)| file.split == split);
        (split, files.collect::<Vec<_>>())
    });
    let by_split: Vec<_> = by_split.filter(|(_, files)| !files.is_empty()).collect();
    let is_compact = |files: &[&(PathBuf, &FileEntry)]| {
        let rows: u64 = files.iter().map(|(_, file)| file.rows).sum();
        files.len() as u64 <= rows.div_ceil(SHARD_ROWS).max(1)
    };
    if by_split.iter().all(|(_, files)| is_compact(files)) {
        return Ok(());
    }
    let mut entries = Vec::new();
    for (split, files) in by_split {
        let facts = ShardReader::open(&files[0].0)?.facts();
        let mut rows: Vec<R> = Vec::new();
        for (path, _) in files {
            rows.extend(read_rows::<R>(path)?);
        }
        entries.extend(transaction.write_shards(split, &rows, &borrowed(&facts))?);
    }
    tables.insert(R::TABLE.to_owned(), entries);
    Ok(())
}
