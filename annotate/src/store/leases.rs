//! Leases: assignment of tasks to people for a limited time.

use super::db::{Result, Tx, params};
use super::draw::is_blind;
use super::entry::{Body, ENTRY_COLUMNS, Entry, Place, read_entry};
use super::records::{Millis, Who};
use super::rows::{self, LeaseRow};
use super::store::Store;
use super::{log, project};
use crate::Error;
use crate::clock::DAY;
use crate::state::{Purpose, ReleaseReason};
use crate::wire::{Code, Lease, Role, Settings};

/// Maximum number of expired leases that one claim ends.
const EXPIRED_AT_ONCE: i64 = 200;
pub(super) const MINUTE: Millis = 60_000;

/// Leases with their tasks, and the place of a gold task in a bundle.
pub(super) const PLACED: &str = "lease l JOIN task t ON t.id = l.task
  LEFT JOIN gold_place g ON g.task = l.task AND g.usr = l.usr";

/// SQL condition: the clips of task `t` are in the dataset, as far as the last import tells.
pub(super) const HERE: &str =
    "NOT EXISTS (SELECT 1 FROM motion m WHERE m.current = 2 AND m.hash IN (t.source, t.target))";

impl Store {
    /// Renews a lease. Refused with `lease_lost`.
    pub fn renew(&self, user: i64, lease: i64, now: Millis) -> Result<Lease> {
        self.write(move |tx| {
            let held = lease_of_id(tx, lease)?.filter(|held| held.lease.user == user);
            let problem = "this lease ended; take the task again if it still wants answers";
            let held = held.ok_or_else(|| Error::refused(Code::LeaseLost, problem))?;
            // A reservation for one person cannot be renewed.
            if matches!(held.purpose, Purpose::Returned | Purpose::Assigned) {
                return Err(Error::wrong_state(held.purpose, "renewed; claim it"));
            }
            Turn::of(tx, user, now)?.prolong_bundle(tx, &held)
        })
    }

    /// Releases a lease; a reviewer may release other users' leases. Refused with `not_found`.
    pub fn release(&self, who: &Who, lease: i64, now: Millis) -> Result<()> {
        let (user, role) = (who.id, who.role);
        self.write(move |tx| {
            let held = lease_of_id(tx, lease)?
                .filter(|held| held.lease.user == user || role >= Role::Reviewer)
                .ok_or_else(|| Error::not_found("lease"))?;
            let reason = if held.lease.user == user {
                ReleaseReason::GivenBack
            } else {
                ReleaseReason::TakenAway
            };
            end(tx, &held, Some(user), reason, now)
        })
    }
}

fn lease_of_id(tx: &mut dyn Tx, id: i64) -> Result<Option<LeaseRow>> {
    Ok(rows::leases(tx, "lease l WHERE l.id = ?1", params![id])?.pop())
}

/// Ends up to [`EXPIRED_AT_ONCE`] expired leases and returns how many it ended. Leases of user `keep` stay: their
/// holder may still renew them.
pub(super) fn expire(tx: &mut dyn Tx, keep: i64, now: Millis) -> Result<usize> {
    let from = "lease l WHERE l.expires <= ?1 AND l.usr <> ?2 ORDER BY l.expires, l.id LIMIT ?3";
    let expired = rows::leases(tx, from, params![now, keep, EXPIRED_AT_ONCE])?;
    for held in &expired {
        end(tx, held, None, ReleaseReason::Expired, now)?;
    }
    Ok(expired.len())
}

/// The time until which the task of an ending lease stays reserved for its holder; `None` if it does not. It does if
/// the holder's answer was returned and no new one has been submitted.
pub(super) fn reserved_after(
    tx: &mut dyn Tx,
    held: &LeaseRow,
    reason: ReleaseReason,
    now: Millis,
) -> Result<Option<Millis>> {
    // A task that a reviewer took away is free for others.
    if held.purpose != Purpose::Annotate || reason == ReleaseReason::TakenAway {
        return Ok(None);
    }
    let (task, user) = (held.lease.task, held.lease.user);
    let unanswered = tx.has(
        "SELECT 1 FROM revision r JOIN task t ON t.id = r.task
         WHERE r.task = ?1 AND r.author = ?2 AND r.state IN ('draft', 'returned') AND t.came_back = 1",
        params![task, user],
    )?;
    if !unanswered {
        return Ok(None);
    }
    let sql = format!(
        "SELECT {ENTRY_COLUMNS} FROM event WHERE task = ?1 AND kind = 'returned' ORDER BY seq DESC"
    );
    for row in tx.query(&sql, params![task])? {
        if let Body::Returned { authors, until, .. } = read_entry(&row)?.1.body
            && authors.contains(&user)
        {
            return Ok((until > now).then_some(until));
        }
    }
    Ok(None)
}

/// Writes an entry about a lease.
fn note(
    tx: &mut dyn Tx,
    held: &LeaseRow,
    actor: Option<i64>,
    now: Millis,
    body: Body,
) -> Result<()> {
    let (task, epoch) = (Some(held.lease.task), Some(held.lease.epoch));
    log::write(tx, &Entry::new(now, actor, task, epoch, body))
}

pub(super) fn end(
    tx: &mut dyn Tx,
    held: &LeaseRow,
    actor: Option<i64>,
    reason: ReleaseReason,
    now: Millis,
) -> Result<()> {
    let body = Body::Released {
        lease: held.lease.id,
        user: held.lease.user,
        purpose: held.purpose,
        reason,
        reserved: reserved_after(tx, held, reason, now)?,
    };
    note(tx, held, actor, now, body)
}

/// Ends the reservations of a task for people who were disabled, so that others can take it.
pub(super) fn free_of_the_disabled(tx: &mut dyn Tx, turn: &Turn, task: i64) -> Result<()> {
    let from = "lease l JOIN usr u ON u.id = l.usr
         WHERE l.task = ?1 AND l.purpose = 'returned' AND u.active = 0 ORDER BY l.id";
    for held in rows::leases(tx, from, params![task])? {
        let actor = Some(turn.user);
        end(tx, &held, actor, ReleaseReason::TakenAway, turn.now)?;
    }
    Ok(())
}

/// The user of a request, its time, and the settings of the project.
pub(super) struct Turn {
    pub(super) user: i64,
    pub(super) settings: Settings,
    pub(super) now: Millis,
}

impl Turn {
    pub(super) fn of(tx: &mut dyn Tx, user: i64, now: Millis) -> Result<Self> {
        let settings = project::settings(tx)?;
        Ok(Self {
            user,
            settings,
            now,
        })
    }

    /// As [`Self::of`], after ending expired leases of others.
    pub(super) fn begin(tx: &mut dyn Tx, user: i64, now: Millis) -> Result<Self> {
        expire(tx, user, now)?;
        Self::of(tx, user, now)
    }

    pub(super) fn lease_end(&self) -> Millis {
        self.now + Millis::from(self.settings.lease_minutes) * MINUTE
    }

    /// The time until which a task returned or assigned now is reserved for its author or the assigned person.
    pub(super) fn until_returned(&self) -> Millis {
        self.now + Millis::from(self.settings.returned_days) * DAY
    }

    /// Leases a task to the user. The caller has checked that it is free. `place` is the position in a bundle that a
    /// gold task takes.
    pub(super) fn take(
        &self,
        tx: &mut dyn Tx,
        task: i64,
        purpose: Purpose,
        place: Option<Place>,
    ) -> Result<()> {
        let user = self.user;
        let found = tx.find("SELECT epoch, key FROM task WHERE id = ?1", params![task])?;
        let (epoch, key): (i64, String) = found.ok_or_else(|| Error::not_found("task"))?;
        let blind = purpose == Purpose::Annotate && is_blind(&self.settings, &key, user);
        let body = Body::Claimed {
            purpose,
            expires: self.lease_end(),
            blind,
            place,
        };
        let entry = Entry::new(self.now, Some(user), Some(task), Some(epoch + 1), body);
        log::write(tx, &entry)
    }

    pub(super) fn prolong(&self, tx: &mut dyn Tx, held: &LeaseRow) -> Result<Lease> {
        let expires = self.lease_end();
        let lease = held.lease.id;
        let body = Body::Renewed { lease, expires };
        note(tx, held, Some(held.lease.user), self.now, body)?;
        Ok(Lease {
            expires,
            ..held.lease.clone()
        })
    }

    /// [`Self::prolong`] for a lease and all leases of its bundle, since a bundle takes longer than one task.
    pub(super) fn prolong_bundle(&self, tx: &mut dyn Tx, held: &LeaseRow) -> Result<Lease> {
        let from = format!(
            "{PLACED}
             WHERE l.usr = ?1 AND l.purpose = 'annotate' AND l.id <> ?2 AND COALESCE(g.bundle, t.bundle) = (
               SELECT COALESCE(p.bundle, x.bundle) FROM task x
                 LEFT JOIN gold_place p ON p.task = x.id AND p.usr = ?1 WHERE x.id = ?3)
             ORDER BY l.id"
        );
        let lease = &held.lease;
        for other in rows::leases(tx, &from, params![lease.user, lease.id, lease.task])? {
            self.prolong(tx, &other)?;
        }
        self.prolong(tx, held)
    }

    /// Extends the leases of a resumed task and its bundle, but at most once a minute.
    pub(super) fn resume(&self, tx: &mut dyn Tx, held: &LeaseRow) -> Result<i64> {
        if held.lease.expires < self.lease_end() - MINUTE {
            self.prolong_bundle(tx, held)?;
        }
        Ok(held.lease.task)
    }
}
