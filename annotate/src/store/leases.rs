//! Leases: assignment of tasks to people for a limited time.

use super::db::{Tx, params};
use super::draw::percent;
use super::entry::{Body, ENTRY_COLUMNS, Entry, Place, read_entry};
use super::records::Millis;
use super::{log, rows};
use crate::Error;
use crate::state::{Purpose, ReleaseReason};
use crate::wire::{Lease, Settings};

/// Maximum number of expired leases that one claim ends.
const EXPIRED_AT_ONCE: i64 = 200;
pub(super) const MINUTE: Millis = 60_000;

/// Leases with their tasks, and the place of a gold task in a bundle.
pub(super) const PLACED: &str = "lease l JOIN task t ON t.id = l.task
  LEFT JOIN gold_place g ON g.task = l.task AND g.usr = l.usr";

/// Ends leases past their deadline, except those of `keep`, who may renew a lease that nobody has
/// taken. Returns how many it ended.
pub(super) fn expire(tx: &mut dyn Tx, keep: i64, now: Millis) -> Result<usize, Error> {
    let sql = format!(
        "SELECT {} FROM lease l WHERE l.expires <= ?1 AND l.usr <> ?2 ORDER BY l.expires, l.id LIMIT ?3",
        rows::LEASE_COLUMNS
    );
    let expired = tx.query(&sql, params![now, keep, EXPIRED_AT_ONCE])?;
    for row in &expired {
        end(
            tx,
            &rows::read_lease(row)?,
            None,
            ReleaseReason::Expired,
            now,
        )?;
    }
    Ok(expired.len())
}

/// Until when a task is kept for a user whose returned answer it waits for.
fn reservation(
    tx: &mut dyn Tx,
    task: i64,
    user: i64,
    now: Millis,
) -> Result<Option<Millis>, Error> {
    let unanswered = tx.one(
        "SELECT 1 FROM revision r JOIN task t ON t.id = r.task
         WHERE r.task = ?1 AND r.author = ?2 AND r.state IN ('draft', 'returned') AND t.came_back = 1",
        params![task, user],
    )?;
    if unanswered.is_none() {
        return Ok(None);
    }
    let sql = format!(
        "SELECT {ENTRY_COLUMNS} FROM event WHERE task = ?1 AND kind = 'returned' ORDER BY seq DESC"
    );
    for row in tx.query(&sql, params![task])? {
        if let (
            _,
            Entry {
                body: Body::Returned { authors, until, .. },
                ..
            },
        ) = read_entry(&row)?
            && authors.contains(&user)
        {
            return Ok((until > now).then_some(until));
        }
    }
    Ok(None)
}

/// Until when the task of a lease that ends is kept for its holder.
pub(super) fn reserved_after(
    tx: &mut dyn Tx,
    held: &rows::LeaseRow,
    reason: ReleaseReason,
    now: Millis,
) -> Result<Option<Millis>, Error> {
    // A reviewer who takes a task away wants others to have it.
    if held.purpose != Purpose::Annotate || reason == ReleaseReason::TakenAway {
        return Ok(None);
    }
    reservation(tx, held.lease.task, held.lease.user, now)
}

pub(super) fn end(
    tx: &mut dyn Tx,
    held: &rows::LeaseRow,
    actor: Option<i64>,
    reason: ReleaseReason,
    now: Millis,
) -> Result<(), Error> {
    let reserved = reserved_after(tx, held, reason, now)?;
    log::note(
        tx,
        &Entry {
            at: now,
            actor,
            task: Some(held.lease.task),
            epoch: Some(held.lease.epoch),
            body: Body::Released {
                lease: held.lease.id,
                user: held.lease.user,
                purpose: held.purpose,
                reason,
                reserved,
            },
        },
    )?;
    Ok(())
}

/// Ends all leases of a user, so that others can take the tasks.
pub(super) fn end_all(
    tx: &mut dyn Tx,
    user: i64,
    actor: Option<i64>,
    now: Millis,
) -> Result<(), Error> {
    let sql = format!(
        "SELECT {} FROM lease l WHERE l.usr = ?1 ORDER BY l.id",
        rows::LEASE_COLUMNS
    );
    for row in tx.query(&sql, params![user])? {
        end(
            tx,
            &rows::read_lease(&row)?,
            actor,
            ReleaseReason::TakenAway,
            now,
        )?;
    }
    Ok(())
}

pub(super) fn lease_end(settings: &Settings, now: Millis) -> Millis {
    now + Millis::from(settings.lease_minutes) * MINUTE
}

/// Leases a task that the caller has checked to be free.
pub(super) fn take(
    tx: &mut dyn Tx,
    user: i64,
    task: i64,
    purpose: Purpose,
    settings: &Settings,
    now: Millis,
) -> Result<(), Error> {
    take_at(tx, user, task, purpose, None, settings, now)
}

/// [`take`], of a gold task at a place in a bundle.
pub(super) fn take_at(
    tx: &mut dyn Tx,
    user: i64,
    task: i64,
    purpose: Purpose,
    place: Option<Place>,
    settings: &Settings,
    now: Millis,
) -> Result<(), Error> {
    let row = tx
        .one("SELECT epoch, key FROM task WHERE id = ?1", params![task])?
        .ok_or_else(|| Error::not_found("task"))?;
    let blind = purpose == Purpose::Annotate
        && percent(&["blind", row.text(1)?, &user.to_string()]) < settings.blind_percent;
    log::note(
        tx,
        &Entry {
            at: now,
            actor: Some(user),
            task: Some(task),
            epoch: Some(row.int(0)? + 1),
            body: Body::Claimed {
                purpose,
                expires: lease_end(settings, now),
                blind,
                place,
            },
        },
    )?;
    Ok(())
}

pub(super) fn prolong(
    tx: &mut dyn Tx,
    held: &rows::LeaseRow,
    settings: &Settings,
    now: Millis,
) -> Result<Lease, Error> {
    let expires = lease_end(settings, now);
    log::note(
        tx,
        &Entry {
            at: now,
            actor: Some(held.lease.user),
            task: Some(held.lease.task),
            epoch: Some(held.lease.epoch),
            body: Body::Renewed {
                lease: held.lease.id,
                expires,
            },
        },
    )?;
    Ok(Lease {
        expires,
        ..held.lease.clone()
    })
}

/// [`prolong`] for a lease and all leases of its bundle, since a bundle takes longer than one task.
pub(super) fn prolong_bundle(
    tx: &mut dyn Tx,
    held: &rows::LeaseRow,
    settings: &Settings,
    now: Millis,
) -> Result<Lease, Error> {
    let sql = format!(
        "SELECT {} FROM {PLACED}
         WHERE l.usr = ?1 AND l.purpose = 'annotate' AND l.id <> ?2 AND COALESCE(g.bundle, t.bundle) = (
           SELECT COALESCE(p.bundle, x.bundle) FROM task x
             LEFT JOIN gold_place p ON p.task = x.id AND p.usr = ?1 WHERE x.id = ?3)
         ORDER BY l.id",
        rows::LEASE_COLUMNS
    );
    let rest = tx.query(
        &sql,
        params![held.lease.user, held.lease.id, held.lease.task],
    )?;
    for row in rest {
        prolong(tx, &rows::read_lease(&row)?, settings, now)?;
    }
    prolong(tx, held, settings, now)
}
