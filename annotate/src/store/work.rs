//! Hours, answers and reviews of people, and what is left to do.

use std::collections::BTreeMap;

use datasets_spec::quantile;

use super::db::{Result, Tx, params};
use super::project;
use super::records::Millis;
use super::store::Store;
use crate::Error;
use crate::clock::midnight;
use crate::wire::{DayWork, Outlook, TaskKind};

const DAY: Millis = 24 * 60 * 60 * 1000;
const QUARTER: Millis = 15 * 60 * 1000;
/// Days whose pace is taken for the coming ones.
const PACE_DAYS: i64 = 7;

impl Store {
    /// Work by person, day and kind between two times. Days begin in the project's time zone.
    pub fn work(&self, from: Millis, to: Millis) -> Result<Vec<DayWork>> {
        self.read(|tx| days(tx, from, to))
    }

    /// What is left of each kind, and when it is done at the pace of the last days.
    pub fn outlook(&self, now: Millis) -> Result<Vec<Outlook>> {
        self.read(|tx| {
            let kinds = TaskKind::ALL.iter();
            kinds.map(|&kind| outlook(tx, kind, now)).collect()
        })
    }
}

fn days(tx: &mut dyn Tx, from: Millis, to: Millis) -> Result<Vec<DayWork>> {
    let zone = project::settings(tx)?.time_zone;
    let mut days: BTreeMap<(Millis, i64, TaskKind), DayWork> = BTreeMap::new();
    // The database adds up quarters of an hour, of which the days of every time zone consist.
    let rows = tx.query(
        "SELECT w.usr, MAX(COALESCE(u.name, '')), w.at / 900000, t.kind, SUM(w.secs), CAST(SUM(w.answers) AS BIGINT),
           CAST(SUM(w.skips) AS BIGINT), CAST(SUM(w.reviews) AS BIGINT)
         FROM work w JOIN task t ON t.id = w.task LEFT JOIN usr u ON u.id = w.usr
         WHERE w.at >= ?1 AND w.at < ?2 GROUP BY w.usr, w.at / 900000, t.kind ORDER BY 3, 1, 4",
        params![from, to],
    )?;
    for row in &rows {
        let start = midnight(&zone, row.int(2)? * QUARTER);
        let (user, kind) = (row.int(0)?, row.named(3, TaskKind::parse)?);
        let name = row.string(1)?;
        let day = days.entry((start, user, kind)).or_insert_with(|| DayWork {
            start,
            user,
            name,
            kind,
            secs: 0.0,
            answers: 0,
            skips: 0,
            reviews: 0,
        });
        day.secs += row.real(4)?;
        day.answers += row.int(5)?;
        day.skips += row.int(6)?;
        day.reviews += row.int(7)?;
    }
    Ok(days.into_values().collect())
}

fn outlook(tx: &mut dyn Tx, kind: TaskKind, now: Millis) -> Result<Outlook> {
    let name = kind.as_str();
    let recent = now - PACE_DAYS * DAY;
    let left = tx.one(
        "SELECT CAST(COALESCE(SUM(CASE WHEN state IN ('open', 'leased', 'returned') THEN wanted - submitted END), 0)
             AS BIGINT),
           COUNT(CASE WHEN state IN ('submitted', 'in_review') THEN 1 END)
         FROM task WHERE kind = ?1 AND gold IS NULL",
        params![name],
    )?;
    let done = tx.one(
        "SELECT CAST(COALESCE(SUM(w.answers), 0) AS BIGINT), CAST(COALESCE(SUM(w.reviews), 0) AS BIGINT),
           CAST(COALESCE(SUM(w.secs), 0) AS DOUBLE PRECISION), MIN(w.at)
         FROM work w JOIN task t ON t.id = w.task WHERE w.at >= ?1 AND t.kind = ?2",
        params![recent, name],
    )?;
    let (left, done) = left.zip(done).ok_or(Error::Closed)?;
    let (answers_left, answers) = (left.int(0)?, done.int(0)?);
    // A project younger than the window is measured over its own days, at least one.
    let age = |first: Millis| ((now - first) as f64 / DAY as f64).max(1.0);
    let days = done.opt_int(3)?.map_or(1.0, age);
    let pace = answers as f64 / days;
    let mut times = tx.list(
        "SELECT secs FROM revision r JOIN task t ON t.id = r.task
         WHERE r.state <> 'draft' AND t.kind = ?1 AND r.at >= ?2",
        params![name, recent],
        |row| row.real(0),
    )?;
    let median_secs = quantile::median(&mut times);
    let days_left = (pace > 0.0).then(|| answers_left as f64 / pace);
    let secs = done.real(2)?;
    Ok(Outlook {
        kind,
        answers_left,
        reviews_left: left.int(1)?,
        answers_per_day: pace,
        reviews_per_day: done.int(1)? as f64 / days,
        secs_per_answer: (answers > 0).then(|| secs / answers as f64),
        hours_left: median_secs.map(|secs| secs * answers_left as f64 / 3600.0),
        days_left,
        ends: days_left.map(|days| now + (days * DAY as f64) as Millis),
    })
}
