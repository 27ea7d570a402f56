//! Reads tasks, revisions and leases from rows.

use super::db::{Row, Tx, params};
use super::records::TaskRecord;
use crate::Error;
use crate::state::Purpose;
use crate::wire::{Lease, Revision, RevisionState, TaskKind, TaskState};

pub(crate) fn state(text: &str) -> Result<TaskState, Error> {
    TaskState::parse(text).ok_or_else(|| Error::Row {
        table: "task",
        problem: format!("state {text:?} is not known"),
    })
}

/// Columns of [`read_task`].
pub(crate) const TASK_COLUMNS: &str = "t.id, t.key, t.kind, t.source, t.target, t.split, t.bundle, t.bundle_index,
  t.category, t.hint, t.style, t.wanted, t.gold, t.extra, t.state, t.submitted, t.shuffle, t.distance, t.practice,
  t.changed";
/// Their number.
pub(crate) const NUM_TASK_COLUMNS: usize = 20;

/// Reads a task of [`TASK_COLUMNS`].
pub(crate) fn read_task(row: &Row) -> Result<TaskRecord, Error> {
    let optional = |column: usize| -> Result<Option<String>, Error> { row.opt_text(column) };
    let unknown = |problem: String| Error::Row {
        table: "task",
        problem,
    };
    let gold = optional(12)?
        .map(|text| serde_json::from_str(&text))
        .transpose()
        .map_err(|error| unknown(error.to_string()))?;
    let extra = optional(13)?
        .map(|text| serde_json::from_str(&text))
        .transpose()
        .map_err(|error| unknown(error.to_string()))?;
    Ok(TaskRecord {
        id: row.int(0)?,
        key: row.string(1)?,
        kind: task_kind(row.text(2)?)?,
        source: row.string(3)?,
        target: optional(4)?,
        split: row.string(5)?,
        bundle: row.opt_int(6)?,
        bundle_index: row.int(7)?,
        category: optional(8)?,
        hint: optional(9)?,
        style: optional(10)?,
        wanted: row.count(11)?,
        gold,
        extra,
        state: state(row.text(14)?)?,
        submitted: row.count(15)?,
        shuffle: row.int(16)?,
        distance: row.opt_real(17)?,
        practice: row.flag(18)?,
        changed: row.flag(19)?,
    })
}

pub(crate) fn task_kind(text: &str) -> Result<TaskKind, Error> {
    TaskKind::parse(text).ok_or_else(|| Error::Row {
        table: "task",
        problem: format!("kind {text:?} is not known"),
    })
}

/// The task with this id.
pub(crate) fn task(tx: &mut dyn Tx, id: i64) -> Result<TaskRecord, Error> {
    let sql = format!("SELECT {TASK_COLUMNS} FROM task t WHERE t.id = ?1");
    let row = tx.one(&sql, params![id])?;
    read_task(&row.ok_or_else(|| Error::not_found("task"))?)
}

/// Columns of [`read_revision`].
pub(crate) const REVISION_COLUMNS: &str =
    "r.task, r.author, r.rev, r.state, r.answer, r.at, r.secs";

/// Reads a revision of [`REVISION_COLUMNS`] that start at column `from`.
pub(crate) fn read_revision(row: &Row, from: usize) -> Result<Revision, Error> {
    Ok(Revision {
        task: row.int(from)?,
        author: row.int(from + 1)?,
        rev: row.int(from + 2)?,
        state: revision_state(row.text(from + 3)?)?,
        answer: row.json(from + 4)?,
        at: row.int(from + 5)?,
        secs: row.real(from + 6)?,
    })
}

pub(crate) fn revision_state(text: &str) -> Result<RevisionState, Error> {
    RevisionState::parse(text).ok_or_else(|| Error::Row {
        table: "revision",
        problem: format!("state {text:?} is not known"),
    })
}

/// A user's answer to a task.
pub(crate) fn revision(tx: &mut dyn Tx, task: i64, author: i64) -> Result<Option<Revision>, Error> {
    let sql =
        format!("SELECT {REVISION_COLUMNS} FROM revision r WHERE r.task = ?1 AND r.author = ?2");
    tx.one(&sql, params![task, author])?
        .map(|row| read_revision(&row, 0))
        .transpose()
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
pub(crate) fn read_lease(row: &Row) -> Result<LeaseRow, Error> {
    Ok(LeaseRow {
        lease: Lease {
            id: row.int(0)?,
            task: row.int(1)?,
            user: row.int(2)?,
            epoch: row.int(3)?,
            expires: row.int(4)?,
        },
        purpose: Purpose::parse(row.text(5)?).ok_or_else(|| Error::Row {
            table: "lease",
            problem: format!("purpose {:?} is not known", row.text(5)),
        })?,
        blind: row.flag(6)?,
    })
}

/// A user's lease on a task.
pub(crate) fn lease_of(tx: &mut dyn Tx, task: i64, user: i64) -> Result<Option<LeaseRow>, Error> {
    let sql = format!("SELECT {LEASE_COLUMNS} FROM lease l WHERE l.task = ?1 AND l.usr = ?2");
    tx.one(&sql, params![task, user])?
        .map(|row| read_lease(&row))
        .transpose()
}

/// The lease of this id.
pub(crate) fn lease(tx: &mut dyn Tx, id: i64) -> Result<Option<LeaseRow>, Error> {
    let sql = format!("SELECT {LEASE_COLUMNS} FROM lease l WHERE l.id = ?1");
    tx.one(&sql, params![id])?
        .map(|row| read_lease(&row))
        .transpose()
}
