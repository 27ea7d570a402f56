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

/// Calls `each` with the log and every entry after number `last`, and leaves the number of the newest entry in `last`.
pub(super) fn follow(
    log: &mut dyn Tx,
    last: &mut i64,
    mut each: impl FnMut(&mut dyn Tx, i64, &Entry) -> Result<()>,
) -> Result<()> {
    let sql = format!("SELECT {ENTRY_COLUMNS} FROM event WHERE seq > ?1 ORDER BY seq LIMIT ?2");
    loop {
        let rows = log.query(&sql, params![*last, BATCH])?;
        if rows.is_empty() {
            return Ok(());
        }
        for row in &rows {
            let (seq, entry) = read_entry(row)?;
            each(log, seq, &entry)?;
            *last = seq;
        }
    }
}

/// Fills the empty projections of a store from its log.
pub(super) fn derive(tx: &mut dyn Tx) -> Result<()> {
    follow(tx, &mut 0, apply)
}
