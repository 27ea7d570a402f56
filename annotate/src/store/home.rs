//! The home page of a person.

use datasets_spec::quantile;

use super::db::{Result, Tx, params};
use super::leases::Turn;
use super::projections::concerns;
use super::records::Millis;
use super::store::Store;
use super::{claim, rows};
use crate::clock;
use crate::wire::{Home, QueueInfo, ReturnedTask, TaskKind};

impl Store {
    /// Contents of a user's home page.
    pub fn home(&self, user: i64, now: Millis) -> Result<Home> {
        self.read(|tx| home(tx, user, now))
    }
}

fn home(tx: &mut dyn Tx, user: i64, now: Millis) -> Result<Home> {
    let turn = Turn::of(tx, user, now)?;
    let midnight = clock::midnight(&turn.settings.time_zone, now);
    let mut queues = Vec::new();
    for &kind in TaskKind::ALL {
        queues.push(queue(tx, &turn, kind)?);
    }
    let held = "lease l WHERE l.usr = ?1 AND l.purpose = 'annotate' ORDER BY l.expires DESC, l.id";
    let held = rows::leases(tx, held, params![user])?;
    let handed_in = "JOIN task t ON t.id = r.task
         WHERE r.state IN ('submitted', 'accepted', 'superseded', 'returned') AND t.practice = 0";
    let sql = format!("SELECT r.secs FROM revision r {handed_in} AND r.author = ?1 AND r.at >= ?2");
    let mut secs: Vec<f64> = tx.list(&sql, params![user, midnight])?;
    let sql = format!("SELECT COUNT(*) FROM revision r {handed_in} AND r.at >= ?1");
    let today_all = tx.number(&sql, params![midnight])?;
    let sql = "SELECT COALESCE(SUM(secs), 0.0) FROM work WHERE usr = ?1 AND at >= ?2";
    Ok(Home {
        queues,
        returned: returned(tx, user)?,
        held: held.into_iter().map(|held| held.lease).collect(),
        today: secs.len() as i64,
        today_secs: tx.get(sql, params![user, midnight])?,
        median_secs: quantile::median(&mut secs),
        agreement: None,
        today_all,
    })
}

/// Counts of the tasks of a kind that a person may work on.
fn queue(tx: &mut dyn Tx, turn: &Turn, kind: TaskKind) -> Result<QueueInfo> {
    let (total, done, mine) = tx.get(
        "SELECT COUNT(*), COUNT(CASE WHEN state IN ('submitted', 'in_review', 'accepted') THEN 1 END),
           (SELECT COUNT(*) FROM (
               SELECT task FROM revision WHERE author = ?2 AND state IN ('submitted', 'accepted', 'superseded')
               UNION SELECT task FROM lease WHERE usr = ?2 AND purpose <> 'review'
             ) m JOIN task t ON t.id = m.task WHERE t.kind = ?1 AND t.practice = 0)
         FROM task WHERE kind = ?1 AND gold IS NULL AND state <> 'dropped'",
        params![kind, turn.user],
    )?;
    // A practice task in progress counts as remaining practice.
    let (kept, held, held_until): (i64, _, _) = tx.get(
        "SELECT COUNT(*), COUNT(CASE WHEN l.purpose = 'annotate' THEN 1 END),
           MIN(CASE WHEN l.purpose = 'annotate' THEN l.expires END)
         FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?2 AND l.purpose <> 'review' AND t.kind = ?1 AND t.practice = 0",
        params![kind, turn.user],
    )?;
    let practice = claim::standing(tx, turn, kind)?;
    let new = if practice.passed {
        claim::on_offer(tx, turn, kind)?
    } else {
        // If all practice tasks are done and the score is too low, the next one is given again.
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
fn returned(tx: &mut dyn Tx, user: i64) -> Result<Vec<ReturnedTask>> {
    let sql = format!(
        "SELECT t.id, t.kind, COALESCE((SELECT v.comment FROM review v
             WHERE v.task = t.id AND v.decision = 'returned' AND {} ORDER BY v.seq DESC LIMIT 1), ''), l.expires
         FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose = 'returned' ORDER BY l.id",
        concerns("l.usr")
    );
    tx.list(&sql, params![user])
}
