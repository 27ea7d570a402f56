//! Columns of tasks, revisions and leases, and queries for these.

use serde::Deserialize;

use super::db::{Params, Result, Tx, params};
use super::records::TaskRecord;
use crate::Error;
use crate::state::Purpose;
use crate::wire::{Lease, Revision};

/// Columns of a [`TaskRecord`]. The split is that of its first motion now, which may have another than when the task
/// was made.
pub(crate) const TASK: &str = "t.id, t.key, t.kind, t.source, t.target,
  COALESCE((SELECT m.split FROM motion m WHERE m.hash = t.source), t.split), t.bundle, t.bundle_index,
  t.category, t.hint, t.style, t.wanted, t.gold, t.extra, t.state, t.submitted, t.shuffle, t.distance, t.practice,
  t.changed";

/// Tasks `t` that match an SQL condition.
pub(crate) fn tasks(tx: &mut dyn Tx, condition: &str, params: Params) -> Result<Vec<TaskRecord>> {
    let sql = format!("SELECT {TASK} FROM task t WHERE {condition}");
    tx.list(&sql, params)
}

/// The task with this id.
pub(crate) fn task(tx: &mut dyn Tx, id: i64) -> Result<TaskRecord> {
    let found = tasks(tx, "t.id = ?1", params![id])?.pop();
    found.ok_or_else(|| Error::not_found("task"))
}

/// Columns of a [`Revision`].
pub(crate) const REVISION: &str = "r.task, r.author, r.rev, r.state, r.answer, r.at, r.secs";

/// Revisions `r` that match an SQL condition.
pub(crate) fn revisions(tx: &mut dyn Tx, condition: &str, params: Params) -> Result<Vec<Revision>> {
    let sql = format!("SELECT {REVISION} FROM revision r WHERE {condition}");
    tx.list(&sql, params)
}

/// A user's answer to a task.
pub(crate) fn revision(tx: &mut dyn Tx, task: i64, author: i64) -> Result<Option<Revision>> {
    Ok(revisions(tx, "r.task = ?1 AND r.author = ?2", params![task, author])?.pop())
}

/// A lease and its purpose.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(crate) struct LeaseRow {
    pub(crate) lease: Lease,
    pub(crate) purpose: Purpose,
    pub(crate) blind: bool,
}

/// Columns of a [`Lease`].
pub(crate) const LEASE: &str = "l.id, l.task, l.usr, l.epoch, l.expires";

/// Leases `l`, selected by an SQL `FROM` clause.
pub(crate) fn leases(tx: &mut dyn Tx, from: &str, params: Params) -> Result<Vec<LeaseRow>> {
    let sql = format!("SELECT {LEASE}, l.purpose, l.blind FROM {from}");
    tx.list(&sql, params)
}

/// A user's lease on a task.
pub(crate) fn lease_of(tx: &mut dyn Tx, task: i64, user: i64) -> Result<Option<LeaseRow>> {
    let from = "lease l WHERE l.task = ?1 AND l.usr = ?2";
    Ok(leases(tx, from, params![task, user])?.pop())
}
