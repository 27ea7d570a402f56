//! The projections, and how they are derived from the log.

use super::apply::apply;
use super::db::{Result, Tx, params};
use super::entry::{ENTRY_COLUMNS, Entry, read_entry};

/// A projection: its table, the column that holds the id of the task, and the columns that give its rows an order.
pub(super) type Projection = (&'static str, &'static str, &'static str);

/// All projections.
pub(super) const PROJECTIONS: [Projection; 10] = [
    ("task", "id", "id"),
    ("lease", "task", "id"),
    ("revision", "task", "task, author"),
    ("review", "task", "seq"),
    ("accepted", "task", "task"),
    ("skip", "task", "task, usr"),
    ("suggestion_use", "task", "seq"),
    ("gold_score", "task", "task, usr"),
    ("work", "task", "seq"),
    ("gold_place", "task", "task, usr"),
];

/// SQL that creates the projections.
pub(super) const SCHEMA: &str = include_str!("projections.sql");
/// Entries read at a time.
const BATCH: i64 = 1000;

/// Entries of the log after a sequence number, up to [`BATCH`].
pub(super) fn entries(tx: &mut dyn Tx, after: i64) -> Result<Vec<(i64, Entry)>> {
    let sql = format!("SELECT {ENTRY_COLUMNS} FROM event WHERE seq > ?1 ORDER BY seq LIMIT ?2");
    let rows = tx.query(&sql, params![after, BATCH])?;
    rows.iter().map(read_entry).collect()
}

/// Fills the empty projections of a store from its log.
pub(super) fn derive(tx: &mut dyn Tx) -> Result<()> {
    let mut last = 0;
    loop {
        let some = entries(tx, last)?;
        if some.is_empty() {
            return Ok(());
        }
        for (seq, entry) in some {
            apply(tx, seq, &entry)?;
            last = seq;
        }
    }
}
