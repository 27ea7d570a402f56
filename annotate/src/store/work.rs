//! Hours, answers and reviews of people, and what is left to do.

use std::collections::BTreeMap;

use datasets_spec::quantile;

use super::db::{Tx, params};
use super::records::Millis;
use super::{project, rows};
use crate::Error;
use crate::clock::midnight;
use crate::wire::{DayWork, Outlook, TaskKind};

const DAY: Millis = 24 * 60 * 60 * 1000;
const QUARTER: Millis = 15 * 60 * 1000;
/// Days whose pace is taken for the coming ones.
const PACE_DAYS: i64 = 7;

/// Work by person, day and kind. Days begin in the project's time zone.
pub(super) fn days(tx: &mut dyn Tx, from: Millis, to: Millis) -> Result<Vec<DayWork>, Error> {
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
        let (user, kind) = (row.int(0)?, rows::task_kind(row.text(3)?)?);
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

/// What is left of each kind, and when it is done at the pace of the last days.
pub(super) fn outlook(tx: &mut dyn Tx, now: Millis) -> Result<Vec<Outlook>, Error> {
    let mut all = Vec::new();
    for &kind in TaskKind::ALL {
        let name = kind.as_str();
        let answers_left = tx.number(
            "SELECT CAST(COALESCE(SUM(wanted - submitted), 0) AS BIGINT) FROM task
             WHERE kind = ?1 AND gold IS NULL AND state IN ('open', 'leased', 'returned')",
            params![name],
        )?;
        let reviews_left = tx.number(
            "SELECT COUNT(*) FROM task WHERE kind = ?1 AND gold IS NULL AND state IN ('submitted', 'in_review')",
            params![name],
        )?;
        let recent = now - PACE_DAYS * DAY;
        let first = tx
            .one(
                "SELECT MIN(w.at) FROM work w JOIN task t ON t.id = w.task WHERE w.at >= ?1 AND t.kind = ?2",
                params![recent, name],
            )?
            .map_or(Ok(None), |row| row.opt_int(0))?;
        let sums = tx.one(
            "SELECT CAST(COALESCE(SUM(w.answers), 0) AS BIGINT), CAST(COALESCE(SUM(w.reviews), 0) AS BIGINT),
               CAST(COALESCE(SUM(w.secs), 0) AS DOUBLE PRECISION)
             FROM work w JOIN task t ON t.id = w.task WHERE w.at >= ?1 AND t.kind = ?2",
            params![recent, name],
        )?;
        let (answers, reviews, secs) = match &sums {
            Some(row) => (row.int(0)?, row.int(1)?, row.real(2)?),
            None => (0, 0, 0.0),
        };
        // A project younger than the window is measured over its own days, at least one.
        let days = first.map_or(1.0, |first| ((now - first) as f64 / DAY as f64).max(1.0));
        let pace = answers as f64 / days;
        let mut times = tx
            .query(
                "SELECT secs FROM revision r JOIN task t ON t.id = r.task
                 WHERE r.state <> 'draft' AND t.kind = ?1 AND r.at >= ?2",
                params![name, now - PACE_DAYS * DAY],
            )?
            .iter()
            .map(|row| row.real(0))
            .collect::<Result<Vec<f64>, _>>()?;
        let median_secs = quantile::median(&mut times);
        let days_left = (pace > 0.0).then(|| answers_left as f64 / pace);
        all.push(Outlook {
            kind,
            answers_left,
            reviews_left,
            answers_per_day: pace,
            reviews_per_day: reviews as f64 / days,
            secs_per_answer: (answers > 0).then(|| secs / answers as f64),
            hours_left: median_secs.map(|secs| secs * answers_left as f64 / 3600.0),
            days_left,
            ends: days_left.map(|days| now + (days * DAY as f64) as Millis),
        });
    }
    Ok(all)
}
