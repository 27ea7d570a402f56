//! Commits tables of edits, made by one process or in pieces.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::dataset::{Commit, Transaction, table_facts};
use datasets_spec::manifest::Manifest;
use datasets_spec::record::{EditRow, ItemRow, QuarantineRow, ScoreRow};
use datasets_spec::store::if_exists;
use datasets_spec::table::{Row, read_column};
use datasets_spec::{Dataset, Skeleton, Split};

use crate::{Error, Quarantine};

/// Files beside a table of edits: the times of making it, and the warnings about it. Its hash does not include them.
const BESIDE: [&str; 2] = ["times.json", "remarks.json"];

/// Task of an item that is an edit of one motion, without a target.
const FREE: &str = "free";

/// Commits items and the edits of these items together. Edits that they replace become an older version, with their
/// scores.
///
/// # Errors
/// The folder is locked or cannot be written, or as [`make_room`].
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
/// The folder cannot be written, or as [`make_room`].
pub fn commit_edits_in(
    transaction: Transaction,
    items: &[ItemRow],
    edits: &[EditRow],
    skeleton: &Skeleton,
    plan_hash: &str,
    quarantine: &Quarantine,
) -> Result<Dataset, Error> {
    make_room(&transaction, items, edits)?;
    let replaces = |base: &Manifest| base.tables.contains_key(EditRow::TABLE);
    let fresh = transaction.base().is_some_and(replaces);
    let item_split: fn(&ItemRow) -> Split = |row| row.split;
    let edit_split: fn(&EditRow) -> Split = |row| row.split;
    let items = transaction.write_rows(items, Some(item_split), skeleton, plan_hash)?;
    let edits = transaction.write_rows(edits, Some(edit_split), skeleton, plan_hash)?;
    let mut tables = BTreeMap::from([
        (ItemRow::TABLE.to_owned(), items),
        (EditRow::TABLE.to_owned(), edits),
    ]);
    let facts = table_facts(skeleton, plan_hash);
    let accounting = quarantine.write(&transaction, &mut tables, &facts)?;
    Ok(transaction.commit(Commit {
        tables,
        plan_hash: plan_hash.to_owned(),
        skeleton: skeleton.clone(),
        accounting,
        fresh,
        ..Commit::default()
    })?)
}

/// Prepares a folder that [`check_room`] allows for edits of one system. Edits that it holds become an older version; the
/// times and remarks beside them are removed.
///
/// # Errors
/// As [`check_room`], or a file cannot be removed.
pub fn make_room(
    transaction: &Transaction,
    items: &[ItemRow],
    edits: &[EditRow],
) -> Result<(), Error> {
    if transaction.base().is_none() {
        return Ok(());
    }
    let held = Dataset::open_unverified(transaction.root())?;
    let first = edits.first();
    let made_by = first.map(|edit| [edit.system.as_str(), edit.checkpoint_hash.as_str()]);
    check_room(&held, items, made_by)?;
    for name in BESIDE {
        let path = held.root().join(name);
        if_exists(held.store().remove_file(&path)).map_err(Error::io("remove", &path))?;
    }
    Ok(())
}

/// Checks that a dataset can take edits of these items. `made_by` is the name of the system that makes them and the hash of
/// its checkpoint; `None` if no edits are made. The dataset may hold the same items without edits, or edits by a system
/// of that name or that checkpoint.
///
/// # Errors
/// [`Error::Held`] if the folder holds anything else: other items, edits of another system, test items where the edit of
/// a single motion is written or the reverse, or other tables. Or it cannot be read.
pub fn check_room(
    held: &Dataset,
    items: &[ItemRow],
    made_by: Option<[&str; 2]>,
) -> Result<(), Error> {
    let is_free = items.iter().any(|item| item.task == FREE);
    let made = match made_by {
        Some(_) if is_free => "the edit of a single motion".to_owned(),
        Some([system, _]) => format!("edits of {system}"),
        None => "edits".to_owned(),
    };
    let refused = |said: String| {
        let path = held.root().to_owned();
        Err(Error::Held {
            path,
            held: said,
            made,
        })
    };
    let own = [
        ItemRow::TABLE,
        EditRow::TABLE,
        QuarantineRow::TABLE,
        ScoreRow::TABLE,
    ];
    let mut tables = held.manifest().tables.keys();
    if let Some(other) = tables.find(|table| !own.contains(&table.as_str())) {
        return refused(format!("tables of a dataset ({other})"));
    }
    let ids = texts::<ItemRow>(held, "id")?;
    let systems = texts::<EditRow>(held, "system")?;
    if systems.is_empty() {
        let asked = items.iter().map(|item| item.id.as_str());
        let is_same = ids.iter().eq(BTreeSet::from_iter(asked));
        return match ids.len() {
            count if count > 0 && !is_same => refused(format!("{count} other items")),
            _ => Ok(()),
        };
    }
    let checkpoints = texts::<EditRow>(held, "checkpoint_hash")?;
    let is_same = |[system, checkpoint]: [&str; 2]| {
        systems.contains(system) || !checkpoint.is_empty() && checkpoints.contains(checkpoint)
    };
    if !made_by.is_none_or(is_same) {
        return refused(format!("edits of {}", Vec::from_iter(systems).join(", ")));
    }
    let was_free = texts::<ItemRow>(held, "task")?.contains(FREE);
    match (was_free, is_free) {
        (true, false) => refused("the edit of a single motion".to_owned()),
        (false, true) => refused(format!("edits of {} test items", ids.len())),
        (true, true) | (false, false) => Ok(()),
    }
}

/// Refuses a folder with edits for items alone: the edits would stay beside items that they do not answer.
///
/// # Errors
/// [`Error::Held`], or the folder cannot be read.
pub fn refuse_items(held: &Dataset) -> Result<(), Error> {
    let systems = texts::<EditRow>(held, "system")?;
    if systems.is_empty() {
        return Ok(());
    }
    let systems = Vec::from_iter(systems).join(", ");
    Err(Error::Held {
        path: held.root().to_owned(),
        held: format!("the items of the edits of {systems}"),
        made: "other items".to_owned(),
    })
}

/// The different texts in a column.
fn texts<R: Row>(held: &Dataset, column: &'static str) -> Result<BTreeSet<String>, Error> {
    let mut texts = BTreeSet::new();
    for (path, _) in held.files(R::TABLE, None) {
        texts.extend(read_column::<R, String>(&path, column)?);
    }
    Ok(texts)
}
