//! Reads tasks, revisions and leases from rows.

use super::db::{Result, Row, Tx, Value, params};
use super::records::TaskRecord;
use crate::Error;
use crate::state::Purpose;
use crate::wire::{Lease, Revision, RevisionState, TaskKind, TaskState};

/// Columns of [`read_task`].
pub(crate) const TASK_COLUMNS: &str = "t.id, t.key, t.kind, t.source, t.target, t.split, t.bundle, t.bundle_index,
  t.category, t.hint, t.style, t.wanted, t.gold, t.extra, t.state, t.submitted, t.shuffle, t.distance, t.practice,
  t.changed";
/// Their number.
pub(crate) const NUM_TASK_COLUMNS: usize = 20;

/// Reads a task of [`TASK_COLUMNS`].
pub(crate) fn read_task(row: &Row) -> Result<TaskRecord> {
    Ok(TaskRecord {
        id: row.int(0)?,
        key: row.string(1)?,
        kind: row.named(2, TaskKind::parse)?,
        source: row.string(3)?,
        target: row.opt_text(4)?,
        split: row.string(5)?,
        bundle: row.opt_int(6)?,
        bundle_index: row.int(7)?,
        category: row.opt_text(8)?,
        hint: row.opt_text(9)?,
        style: row.opt_text(10)?,
        wanted: row.count(11)?,
        gold: row.opt(12, Row::json)?,
        extra: row.opt(13, Row::json)?,
        state: row.named(14, TaskState::parse)?,
        submitted: row.count(15)?,
        shuffle: row.int(16)?,
        distance: row.opt(17, Row::real)?,
        practice: row.flag(18)?,
        changed: row.flag(19)?,
    })
}

/// Tasks `t` that fit what follows `WHERE` in a query.
pub(crate) fn tasks(tx: &mut dyn Tx, condition: &str, params: &[Value]) -> Result<Vec<TaskRecord>> {
    let sql = format!("SELECT {TASK_COLUMNS} FROM task t WHERE {condition}");
    tx.list(&sql, params, read_task)
}

/// The task with this id.
pub(crate) fn task(tx: &mut dyn Tx, id: i64) -> Result<TaskRecord> {
    let found = tasks(tx, "t.id = ?1", params![id])?.pop();
    found.ok_or_else(|| Error::not_found("task"))
}

/// Columns of [`read_revision`].
pub(crate) const REVISION_COLUMNS: &str =
    "r.task, r.author, r.rev, r.state, r.answer, r.at, r.secs";

/// Reads a revision of [`REVISION_COLUMNS`] that start at column `from`.
pub(crate) fn read_revision(row: &Row, from: usize) -> Result<Revision> {
    Ok(Revision {
        task: row.int(from)?,
        author: row.int(from + 1)?,
        rev: row.int(from + 2)?,
        state: row.named(from + 3, RevisionState::parse)?,
        answer: row.json(from + 4)?,
        at: row.int(from + 5)?,
        secs: row.real(from + 6)?,
    })
}

/// Revisions `r` that fit what follows `WHERE` in a query.
pub(crate) fn revisions(
    tx: &mut dyn Tx,
    condition: &str,
    params: &[Value],
) -> Result<Vec<Revision>> {
    let sql = format!("SELECT {REVISION_COLUMNS} FROM revision r WHERE {condition}");
    tx.list(&sql, params, |row| read_revision(row, 0))
}

/// A user's answer to a task.
pub(crate) fn revision(tx: &mut dyn Tx, task: i64, author: i64) -> Result<Option<Revision>> {
    Ok(revisions(tx, "r.task = ?1 AND r.author = ?2", params![task, author])?.pop())
}

/// A lease and its purpose.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LeaseRow {
    pub(crate) lease: Lease,
    pub(crate) purpose: Purpose,
    pub(crate) blind: bool,
}

/// Columns of [`read_lease`].
pub(crate) const LEASE_COLUMNS: &str =
    "l.id, l.task, l.usr, l.epoch, l.expires, l.purpose, l.blind";

/// Reads a lease of [`LEASE_COLUMNS`].
pub(crate) fn read_lease(row: &Row) -> Result<LeaseRow> {
    Ok(LeaseRow {
        lease: Lease {
            id: row.int(0)?,
            task: row.int(1)?,
            user: row.int(2)?,
            epoch: row.int(3)?,
            expires: row.int(4)?,
        },
        purpose: row.named(5, Purpose::parse)?,
        blind: row.flag(6)?,
    })
}

/// Leases `l` of what follows `FROM` in a query.
pub(crate) fn leases(tx: &mut dyn Tx, from: &str, params: &[Value]) -> Result<Vec<LeaseRow>> {
    let sql = format!("SELECT {LEASE_COLUMNS} FROM {from}");
    tx.list(&sql, params, read_lease)
}

/// A user's lease on a task.
pub(crate) fn lease_of(tx: &mut dyn Tx, task: i64, user: i64) -> Result<Option<LeaseRow>> {
    let from = "lease l WHERE l.task = ?1 AND l.usr = ?2";
    Ok(leases(tx, from, params![task, user])?.pop())
}

/// The lease of this id.
pub(crate) fn lease(tx: &mut dyn Tx, id: i64) -> Result<Option<LeaseRow>> {
    Ok(leases(tx, "lease l WHERE l.id = ?1", params![id])?.pop())
}
