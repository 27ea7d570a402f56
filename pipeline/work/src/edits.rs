//! Commits tables of edits, made by one process or in pieces.

use std::collections::BTreeMap;
use std::path::Path;

use datasets_spec::dataset::{Commit, Transaction, table_facts};
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Skeleton, Split};

use crate::{Error, Quarantine};

/// Commits items and the edits of these items together.
///
/// # Errors
/// The folder is locked or cannot be written.
pub fn commit_edits(
    out: &Path,
    items: &[ItemRow],
    edits: &[EditRow],
    skeleton: &Skeleton,
    plan_hash: &str,
    holder: &str,
) -> Result<Dataset, Error> {
    let transaction = Transaction::begin(out, holder)?;
    let none = Quarantine::default();
    commit_edits_in(transaction, items, edits, skeleton, plan_hash, &none)
}

/// As [`commit_edits`], in a transaction that has begun, and with the pieces that failed.
///
/// # Errors
/// The folder cannot be written.
pub fn commit_edits_in(
    transaction: Transaction,
    items: &[ItemRow],
    edits: &[EditRow],
    skeleton: &Skeleton,
    plan_hash: &str,
    quarantine: &Quarantine,
) -> Result<Dataset, Error> {
    let item_split: fn(&ItemRow) -> Split = |row| row.split;
    let edit_split: fn(&EditRow) -> Split = |row| row.split;
    let mut tables = BTreeMap::from([
        (
            ItemRow::TABLE.to_owned(),
            transaction.write_rows(items, Some(item_split), skeleton, plan_hash)?,
        ),
        (
            EditRow::TABLE.to_owned(),
            transaction.write_rows(edits, Some(edit_split), skeleton, plan_hash)?,
        ),
    ]);
    let facts = table_facts(skeleton, plan_hash);
    let accounting = quarantine.write(&transaction, &mut tables, &facts)?;
    Ok(transaction.commit(Commit {
        tables,
        plan_hash: plan_hash.to_owned(),
        skeleton: skeleton.clone(),
        accounting,
        ..Commit::default()
    })?)
}
