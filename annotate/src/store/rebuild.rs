//! Rebuilds the projections from the log, and checks them.

use super::apply::apply;
use super::db::{Tx, params};
use super::entry::{ENTRY_COLUMNS, read_entry};
use crate::Error;

/// The projections and their sort columns.
const PROJECTIONS: [(&str, &str); 8] = [
    ("task", "id"),
    ("lease", "id"),
    ("revision", "task, author"),
    ("review", "seq"),
    ("accepted", "task"),
    ("skip", "task, usr"),
    ("suggestion_use", "seq"),
    ("gold_score", "task, usr"),
];

/// Entries read at a time.
const BATCH: i64 = 1000;

/// Rebuilds the projections and returns the names of those that changed.
pub(crate) fn rebuild(tx: &mut dyn Tx) -> Result<Vec<&'static str>, Error> {
    let before = digests(tx)?;
    for (table, _) in PROJECTIONS {
        tx.execute(&format!("DELETE FROM {table}"), &[])?;
    }
    let sql = format!("SELECT {ENTRY_COLUMNS} FROM event WHERE seq > ?1 ORDER BY seq LIMIT ?2");
    let mut last = 0;
    loop {
        let rows = tx.query(&sql, params![last, BATCH])?;
        if rows.is_empty() {
            break;
        }
        for row in rows {
            let (seq, entry) = read_entry(&row)?;
            apply(tx, seq, &entry)?;
            last = seq;
        }
    }
    let after = digests(tx)?;
    Ok(PROJECTIONS
        .iter()
        .zip(before.iter().zip(&after))
        .filter(|(_, (before, after))| before != after)
        .map(|((table, _), _)| *table)
        .collect())
}

/// A hash of each projection.
fn digests(tx: &mut dyn Tx) -> Result<Vec<blake3::Hash>, Error> {
    const ROWS: i64 = 5000;
    let mut digests = Vec::new();
    for (table, order) in PROJECTIONS {
        let mut hasher = blake3::Hasher::new();
        let mut offset = 0;
        loop {
            let sql = format!("SELECT * FROM {table} ORDER BY {order} LIMIT ?1 OFFSET ?2");
            let rows = tx.query(&sql, params![ROWS, offset])?;
            for row in &rows {
                hasher.update(format!("{row:?}\n").as_bytes());
            }
            if (rows.len() as i64) < ROWS {
                break;
            }
            offset += ROWS;
        }
        digests.push(hasher.finalize());
    }
    Ok(digests)
}

/// Findings about the log and the projections; rebuilds the projections.
pub(crate) fn verify(tx: &mut dyn Tx) -> Result<Vec<String>, Error> {
    let mut findings = Vec::new();
    let row = tx.one("SELECT COUNT(*), COALESCE(MAX(seq), 0) FROM event", &[])?;
    if let Some(row) = row
        && row.int(0)? != row.int(1)?
    {
        findings.push(format!(
            "the log has {} entries, but its last sequence number is {}",
            row.int(0)?,
            row.int(1)?
        ));
    }
    let over = tx.number(
        "SELECT COUNT(*) FROM task WHERE submitted + leases > wanted",
        &[],
    )?;
    if over > 0 {
        findings.push(format!(
            "{over} tasks have more answers and leases than wanted"
        ));
    }
    findings.extend(
        rebuild(tx)?
            .into_iter()
            .map(|table| format!("table {table} does not follow from the log")),
    );
    Ok(findings)
}
