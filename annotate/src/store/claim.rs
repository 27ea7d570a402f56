//! Leases: assignment of tasks to people for a limited time.

use super::db::{Tx, params};
use super::draw::percent;
use super::entry::{Body, Entry};
use super::project;
use super::records::Millis;
use super::{apply, log, rows};
use crate::Error;
use crate::state::{LogKind, Purpose, ReleaseReason};
use crate::wire::{Code, Empty, Lease, RevisionState, Settings, TaskKind, TaskState};

/// Maximum number of expired leases that one claim ends.
const EXPIRED_AT_ONCE: i64 = 200;
pub(super) const MINUTE: Millis = 60_000;

/// SQL condition: user `?2` can get task `t` as new work.
const FOR_ME: &str = "t.claimable = 1
  AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?2 AND r.state <> 'draft')
  AND NOT EXISTS (SELECT 1 FROM lease l WHERE l.task = t.id AND l.usr = ?2)";

/// Ends leases past their deadline, except those of `keep`, who may renew a lease that nobody has
/// taken.
pub(super) fn expire(tx: &mut dyn Tx, keep: i64, now: Millis) -> Result<(), Error> {
    let sql = format!(
        "SELECT {} FROM lease l WHERE l.expires <= ?1 AND l.usr <> ?2 ORDER BY l.expires, l.id LIMIT ?3",
        rows::LEASE_COLUMNS
    );
    for row in tx.query(&sql, params![now, keep, EXPIRED_AT_ONCE])? {
        let held = rows::read_lease(&row)?;
        end(tx, &held, None, ReleaseReason::Expired, now)?;
    }
    Ok(())
}

pub(super) fn end(
    tx: &mut dyn Tx,
    held: &rows::LeaseRow,
    actor: Option<i64>,
    reason: ReleaseReason,
    now: Millis,
) -> Result<(), Error> {
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
            },
        },
    )?;
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
        "SELECT {} FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose = 'annotate' AND l.id <> ?2
           AND t.bundle = (SELECT bundle FROM task WHERE id = ?3) ORDER BY l.id",
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

/// The next task of a user, or why there is none.
pub(super) fn claim(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
    now: Millis,
) -> Result<Result<i64, Empty>, Error> {
    expire(tx, user, now)?;
    let settings = project::settings(tx)?;
    let sql = format!(
        "SELECT {} FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose = 'annotate' AND t.kind = ?2
         ORDER BY t.bundle, t.bundle_index, l.id LIMIT 1",
        rows::LEASE_COLUMNS
    );
    if let Some(row) = tx.one(&sql, params![user, kind.as_str()])? {
        let held = rows::read_lease(&row)?;
        if held.lease.expires < lease_end(&settings, now) - MINUTE {
            prolong_bundle(tx, &held, &settings, now)?;
        }
        return Ok(Ok(held.lease.task));
    }
    let back = tx.one(
        "SELECT t.id FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose = 'returned' AND t.kind = ?2 ORDER BY l.id LIMIT 1",
        params![user, kind.as_str()],
    )?;
    if let Some(row) = back {
        let task = row.int(0)?;
        take(tx, user, task, Purpose::Annotate, &settings, now)?;
        return Ok(Ok(task));
    }
    if let Some(task) = gold_task(tx, user, kind, &settings)? {
        take(tx, user, task, Purpose::Annotate, &settings, now)?;
        return Ok(Ok(task));
    }
    let Some((first, bundle)) = candidate(tx, user, kind)? else {
        return Ok(Err(empty(tx, user, kind)?));
    };
    match bundle {
        None => take(tx, user, first, Purpose::Annotate, &settings, now)?,
        Some(bundle) => {
            let sql = format!(
                "SELECT t.id FROM task t WHERE t.bundle = ?1 AND {FOR_ME}
                   AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2 AND s.postponed = 0)
                 ORDER BY t.bundle_index, t.id"
            );
            for row in tx.query(&sql, params![bundle, user])? {
                take(tx, user, row.int(0)?, Purpose::Annotate, &settings, now)?;
            }
        }
    }
    Ok(Ok(first))
}

/// The next task of a user with its bundle: a new one, else a postponed one.
fn candidate(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
) -> Result<Option<(i64, Option<i64>)>, Error> {
    let fresh = format!(
        "SELECT t.id, t.bundle FROM task t WHERE t.kind = ?1 AND {FOR_ME}
           AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2)
         ORDER BY t.priority DESC, t.id LIMIT 1"
    );
    let postponed = format!(
        "SELECT t.id, t.bundle FROM skip s JOIN task t ON t.id = s.task
         WHERE t.kind = ?1 AND s.usr = ?2 AND s.postponed = 1 AND {FOR_ME}
         ORDER BY s.at, t.id LIMIT 1"
    );
    for sql in [fresh, postponed] {
        if let Some(row) = tx.one(&sql, params![kind.as_str(), user])? {
            return Ok(Some((row.int(0)?, row.opt_int(1)?)));
        }
    }
    Ok(None)
}

/// Hashes of the motions of the following tasks.
pub(super) fn upcoming(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
    limit: usize,
) -> Result<Vec<String>, Error> {
    let sql = format!(
        "SELECT t.source, t.target FROM task t WHERE t.kind = ?1 AND {FOR_ME}
           AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2)
         ORDER BY t.priority DESC, t.id LIMIT ?3"
    );
    let mut hashes = Vec::new();
    for row in tx.query(&sql, params![kind.as_str(), user, limit as i64])? {
        hashes.push(row.string(0)?);
        hashes.extend(row.opt_text(1)?);
    }
    Ok(hashes)
}

/// A gold task, if one is due. The draw depends on the user and their number of answers.
fn gold_task(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
    settings: &Settings,
) -> Result<Option<i64>, Error> {
    if settings.gold_percent == 0 {
        return Ok(None);
    }
    let answers = tx.number(
        "SELECT COUNT(*) FROM revision WHERE author = ?1 AND state <> 'draft'",
        params![user],
    )?;
    let number = answers.to_string();
    if percent(&["gold", &user.to_string(), &number]) >= settings.gold_percent {
        return Ok(None);
    }
    let row = tx.one(
        "SELECT t.id FROM task t WHERE t.gold IS NOT NULL AND t.kind = ?1 AND t.state IN ('open', 'leased')
           AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?2 AND r.state <> 'draft')
           AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2)
         ORDER BY t.shuffle, t.id LIMIT 1",
        params![kind.as_str(), user],
    )?;
    row.map(|row| row.int(0)).transpose()
}

fn empty(tx: &mut dyn Tx, user: i64, kind: TaskKind) -> Result<Empty, Error> {
    let kind = kind.as_str();
    let mut empty = Empty::default();
    let counts = tx.query(
        "SELECT state, COUNT(*) FROM task WHERE kind = ?1 AND gold IS NULL GROUP BY state",
        params![kind],
    )?;
    for row in counts {
        let count = row.int(1)?;
        empty.total += count;
        match rows::state(row.text(0)?)? {
            TaskState::Submitted | TaskState::InReview | TaskState::Accepted => empty.done += count,
            TaskState::Dropped => empty.dropped += count,
            TaskState::Open | TaskState::Leased | TaskState::Returned => {}
        }
    }
    empty.waiting_for_others = tx.number(
        "SELECT COUNT(*) FROM revision r JOIN task t ON t.id = r.task
         WHERE r.author = ?2 AND r.state <> 'draft' AND t.kind = ?1 AND t.gold IS NULL
           AND t.state IN ('open', 'leased', 'returned')",
        params![kind, user],
    )?;
    let held = tx.one(
        "SELECT COUNT(DISTINCT l.task), MIN(l.expires) FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr <> ?2 AND l.purpose <> 'review' AND t.kind = ?1 AND t.gold IS NULL",
        params![kind, user],
    )?;
    if let Some(row) = held {
        empty.leased_by_others = row.int(0)?;
        empty.soonest_expiry = row.opt_int(1)?;
    }
    empty.skipped_by_me = tx.number(
        "SELECT COUNT(*) FROM skip s JOIN task t ON t.id = s.task
         WHERE s.usr = ?2 AND t.kind = ?1 AND t.state IN ('open', 'leased', 'returned')",
        params![kind, user],
    )?;
    Ok(empty)
}

pub(super) fn claim_task(tx: &mut dyn Tx, user: i64, id: i64, now: Millis) -> Result<(), Error> {
    expire(tx, user, now)?;
    let settings = project::settings(tx)?;
    let task = rows::task(tx, id)?;
    match rows::lease_of(tx, id, user)? {
        Some(held) if held.purpose == Purpose::Annotate => {
            prolong(tx, &held, &settings, now)?;
            return Ok(());
        }
        Some(held) if held.purpose == Purpose::Returned => {
            return take(tx, user, id, Purpose::Annotate, &settings, now);
        }
        Some(_) => return Err(Error::wrong_state(task.state, "answered by its reviewer")),
        None => {}
    }
    // Only users who have held the task may open it by number.
    let known = tx.one(
        "SELECT 1 FROM event WHERE task = ?1 AND +actor = ?2 AND kind = 'claimed' LIMIT 1",
        params![id, user],
    )?;
    if known.is_none() {
        return Err(Error::not_found("task"));
    }
    if let Some(mine) = rows::revision(tx, id, user)?
        && mine.state != RevisionState::Draft
        && mine.state != RevisionState::Returned
    {
        return Err(Error::wrong_state(
            task.state,
            "taken again: your answer is handed in",
        ));
    }
    apply::check_move(task.state, LogKind::Claimed, "taken")?;
    let free = tx.number("SELECT claimable FROM task WHERE id = ?1", params![id])?;
    if free == 0 && task.gold.is_none() {
        return Err(Error::refused(
            Code::TaskFull,
            "the task has enough annotators by now; your text is kept as a draft",
        ));
    }
    take(tx, user, id, Purpose::Annotate, &settings, now)
}
