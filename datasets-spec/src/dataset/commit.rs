//! Commits of one table.

use std::collections::BTreeMap;
use std::path::Path;

use super::open::Dataset;
use super::transaction::{Commit, Transaction};
use crate::manifest::FileEntry;
use crate::table::Row;
use crate::{Error, Skeleton, Split};

/// Refuses a folder that holds other tables than those in `own`. `made` says what is to be written there, in the plural.
///
/// # Errors
/// It holds one, or cannot be read.
pub fn refuse_others(root: &Path, own: &[&str], made: &str) -> Result<(), Error> {
    let held = match Dataset::open_unverified(root) {
        Ok(held) => held,
        Err(Error::NotADataset { .. }) => return Ok(()),
        Err(error) => return Err(error),
    };
    let mut tables = held.manifest().tables.keys();
    match tables.find(|table| !own.contains(&table.as_str())) {
        None => Ok(()),
        Some(table) => Err(Error::Occupied {
            path: root.to_owned(),
            problem: format!(
                "holds the table {table}, and {made} do not belong beside it; name another folder"
            ),
        }),
    }
}

/// Commits a table of rows that are all in memory. If the folder already holds this table, made by the same plan,
/// nothing is written. `split_of` is `None` for tables without splits.
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
    commit_table::<R, Error>(root, skeleton, plan_hash, holder, |transaction| {
        transaction.write_rows(rows, split_of, skeleton, plan_hash)
    })
}

/// Commits the files of a table that `write` writes. If the folder already holds this table, made by the same plan,
/// nothing is written.
///
/// # Errors
/// The folder is locked or cannot be written, or `write` fails.
pub fn commit_table<R: Row, E: From<Error>>(
    root: &Path,
    skeleton: &Skeleton,
    plan_hash: &str,
    holder: &str,
    write: impl FnOnce(&Transaction) -> Result<Vec<FileEntry>, E>,
) -> Result<Dataset, E> {
    let transaction = Transaction::begin(root, holder)?;
    let recorded = transaction.base().and_then(|base| base.plans.get(R::TABLE));
    if recorded.is_some_and(|recorded| recorded == plan_hash) {
        drop(transaction);
        return Ok(Dataset::open(root)?);
    }
    let entries = write(&transaction)?;
    let dataset = transaction.commit(Commit {
        tables: BTreeMap::from([(R::TABLE.to_owned(), entries)]),
        plan_hash: plan_hash.to_owned(),
        skeleton: skeleton.clone(),
        ..Commit::default()
    })?;
    Ok(dataset)
}
