//! Rewrites a dataset into as few files as a new one has.

use std::collections::BTreeMap;

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
    /// Number of the version that was made; that of the newest one where there was nothing to do.
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
    let source = Source {
        dataset: &dataset,
        transaction: &transaction,
    };
    source.rewrite::<MaskRow>(&mut tables)?;
    source.rewrite::<PairRow>(&mut tables)?;
    source.rewrite::<QuarantineRow>(&mut tables)?;
    source.rewrite::<SkippedRow>(&mut tables)?;
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

struct Source<'a> {
    dataset: &'a Dataset,
    transaction: &'a Transaction,
}

impl Source<'_> {
    /// Writes a table of small rows into fewer files, if that is possible.
    fn rewrite<R: Row>(&self, tables: &mut BTreeMap<String, Vec<FileEntry>>) -> Result<(), Error> {
        let splits = std::iter::once(None).chain(Split::ALL.map(Some));
        let mut written = Vec::new();
        let all = self.dataset.files(R::TABLE, None);
        for split in splits {
            let files: Vec<_> = all.iter().filter(|(_, file)| file.split == split).collect();
            let rows: u64 = files.iter().map(|(_, file)| file.rows).sum();
            let few = rows.div_ceil(SHARD_ROWS).max(1);
            written.push((split, files, few));
        }
        if written
            .iter()
            .all(|(_, files, few)| files.len() as u64 <= *few)
        {
            return Ok(());
        }
        let mut entries = Vec::new();
        for (split, files, _) in written {
            let mut rows: Vec<R> = Vec::new();
            let mut facts = Vec::new();
            for (path, _) in &files {
                if facts.is_empty() {
                    facts = ShardReader::open(path)?.facts();
                }
                rows.extend(read_rows::<R>(path)?);
            }
            if files.is_empty() {
                continue;
            }
            entries.extend(
                self.transaction
                    .write_shards(split, &rows, &borrowed(&facts))?,
            );
        }
        tables.insert(R::TABLE.to_owned(), entries);
        Ok(())
    }
}
