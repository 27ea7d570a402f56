//! The home page of a person.

use datasets_spec::quantile;

use super::db::{Tx, params};
use super::records::Millis;
use super::{claim, practice, project, rows};
use crate::Error;
use crate::clock;
use crate::wire::{Home, Lease, QueueInfo, ReturnedTask, Settings, TaskKind};

pub(super) fn home(tx: &mut dyn Tx, user: i64, now: Millis) -> Result<Home, Error> {
    let settings = project::settings(tx)?;
    let midnight = clock::midnight(&settings.time_zone, now);
    let mut queues = Vec::new();
    for &kind in TaskKind::ALL {
        queues.push(queue(tx, user, kind, &settings, now)?);
    }
    let returned = returned(tx, user)?;
    let held = held(tx, user)?;
    let handed_in = "JOIN task t ON t.id = r.task
         WHERE r.state IN ('submitted', 'accepted', 'superseded', 'returned') AND t.practice = 0";
    let mut secs = tx
        .query(
            &format!("SELECT r.secs FROM revision r {handed_in} AND r.author = ?1 AND r.at >= ?2"),
            params![user, midnight],
        )?
        .iter()
        .map(|row| row.real(0))
        .collect::<Result<Vec<f64>, _>>()?;
    let today_all = tx.number(
        &format!("SELECT COUNT(*) FROM revision r {handed_in} AND r.at >= ?1"),
        params![midnight],
    )?;
    Ok(Home {
        queues,
        returned,
        held,
        today: secs.len() as i64,
        today_secs: worked(tx, user, midnight)?,
        median_secs: quantile::median(&mut secs),
        agreement: None,
        today_all,
    })
}

/// Counts of a kind, as a person sees them.
fn queue(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
    settings: &Settings,
    now: Millis,
) -> Result<QueueInfo, Error> {
    let name = kind.as_str();
    let total = tx.number(
        "SELECT COUNT(*) FROM task WHERE kind = ?1 AND gold IS NULL AND state <> 'dropped'",
        params![name],
    )?;
    let done = tx.number(
        "SELECT COUNT(*) FROM task WHERE kind = ?1 AND gold IS NULL AND state IN ('submitted', 'in_review', 'accepted')",
        params![name],
    )?;
    let mine = tx.number(
        "SELECT COUNT(*) FROM (
               SELECT task FROM revision WHERE author = ?2 AND state IN ('submitted', 'accepted', 'superseded')
               UNION SELECT task FROM lease WHERE usr = ?2 AND purpose <> 'review'
             ) m JOIN task t ON t.id = m.task WHERE t.kind = ?1 AND t.practice = 0",
        params![name, user],
    )?;
    // Practice that is begun is counted with the practice that is left.
    let kept = tx.number(
        "SELECT COUNT(*) FROM lease l JOIN task t ON t.id = l.task
             WHERE l.usr = ?2 AND l.purpose <> 'review' AND t.kind = ?1 AND t.practice = 0",
        params![name, user],
    )?;
    let held = tx.one(
        "SELECT COUNT(*), MIN(l.expires) FROM lease l JOIN task t ON t.id = l.task
             WHERE l.usr = ?2 AND l.purpose = 'annotate' AND t.kind = ?1 AND t.practice = 0",
        params![name, user],
    )?;
    let (held, held_until) = match &held {
        Some(row) => (row.int(0)?, row.opt_int(1)?),
        None => (0, None),
    };
    let practice = practice::standing(tx, user, kind, settings)?;
    let new = if practice.passed {
        claim::on_offer(tx, user, kind, settings, now)?
    } else {
        // After the last one, those with a low score are given again.
        (practice.needed - practice.done).max(1)
    };
    Ok(QueueInfo {
        kind,
        total,
        done,
        mine,
        held,
        held_until,
        open: kept + new,
    })
}

/// Tasks whose answers were sent back to a person.
fn returned(tx: &mut dyn Tx, user: i64) -> Result<Vec<ReturnedTask>, Error> {
    tx.query(
        "SELECT t.id, t.kind, l.expires,
               (SELECT v.comment FROM review v WHERE v.task = t.id AND v.decision = 'returned' ORDER BY v.seq DESC LIMIT 1)
             FROM lease l JOIN task t ON t.id = l.task
             WHERE l.usr = ?1 AND l.purpose = 'returned' ORDER BY l.id",
        params![user],
    )?
    .iter()
    .map(|row| {
        Ok(ReturnedTask {
            task: row.int(0)?,
            kind: rows::task_kind(row.text(1)?)?,
            until: row.int(2)?,
            comment: row.opt_text(3)?.unwrap_or_default(),
        })
    })
    .collect()
}

/// The leases of a person.
fn held(tx: &mut dyn Tx, user: i64) -> Result<Vec<Lease>, Error> {
    let sql = format!(
        "SELECT {} FROM lease l WHERE l.usr = ?1 AND l.purpose = 'annotate' ORDER BY l.expires DESC, l.id",
        rows::LEASE_COLUMNS
    );
    tx.query(&sql, params![user])?
        .iter()
        .map(|row| rows::read_lease(row).map(|held| held.lease))
        .collect()
}

/// Seconds of work that a user reported since a time.
fn worked(tx: &mut dyn Tx, user: i64, since: Millis) -> Result<f64, Error> {
    let row = tx.one(
        "SELECT COALESCE(SUM(secs), 0.0) FROM work WHERE usr = ?1 AND at >= ?2",
        params![user, since],
    )?;
    row.map_or(Ok(0.0), |row| row.real(0))
}
