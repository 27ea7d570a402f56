//! Hours, answers and reviews of people, and what is left to do.

use std::collections::BTreeMap;

use datasets_spec::quantile;

use super::db::{Result, Tx, params};
use super::project;
use super::records::Millis;
use super::store::Store;
use crate::clock::{DAY, midnight};
use crate::wire::{DayWork, Outlook, TaskKind};

const QUARTER: Millis = 15 * 60 * 1000;
/// Number of past days whose pace is extrapolated.
const PACE_DAYS: i64 = 7;

impl Store {
    /// Work by person, day and kind between two times. Days begin in the project's time zone.
    pub fn work(&self, from: Millis, to: Millis) -> Result<Vec<DayWork>> {
        self.read(|tx| days(tx, from, to))
    }

    /// Remaining tasks of each kind, and the expected date of completion at the pace of the last days.
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
    // The database sums by quarters of an hour, because day boundaries of every time zone fall on quarter hours.
    let rows = tx.list::<(i64, String, Millis, TaskKind, f64, [i64; 3])>(
        "SELECT w.usr, MAX(COALESCE(u.name, '')), w.at / 900000, t.kind, SUM(w.secs),
           CAST(SUM(CASE WHEN t.practice = 0 THEN w.answers ELSE 0 END) AS BIGINT),
           CAST(SUM(w.skips) AS BIGINT), CAST(SUM(w.reviews) AS BIGINT)
         FROM work w JOIN task t ON t.id = w.task LEFT JOIN usr u ON u.id = w.usr
         WHERE w.at >= ?1 AND w.at < ?2 GROUP BY w.usr, w.at / 900000, t.kind ORDER BY 3, 1, 4",
        params![from, to],
    )?;
    for (user, name, quarter, kind, secs, [answers, skips, reviews]) in rows {
        let start = midnight(&zone, quarter * QUARTER);
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
        day.secs += secs;
        day.answers += answers;
        day.skips += skips;
        day.reviews += reviews;
    }
    Ok(days.into_values().collect())
}

fn outlook(tx: &mut dyn Tx, kind: TaskKind, now: Millis) -> Result<Outlook> {
    let recent = now - PACE_DAYS * DAY;
    let (answers_left, reviews_left): (i64, i64) = tx.get(
        "SELECT CAST(COALESCE(SUM(CASE WHEN state IN ('open', 'leased', 'returned') THEN wanted - submitted END), 0)
             AS BIGINT),
           COUNT(CASE WHEN state IN ('submitted', 'in_review') THEN 1 END)
         FROM task WHERE kind = ?1 AND gold IS NULL",
        params![kind],
    )?;
    let (answers, reviews, secs, [first, first_review]): (i64, i64, f64, [Option<Millis>; 2]) = tx.get(
        "SELECT CAST(COALESCE(SUM(w.answers), 0) AS BIGINT), CAST(COALESCE(SUM(w.reviews), 0) AS BIGINT),
           CAST(COALESCE(SUM(w.secs), 0) AS DOUBLE PRECISION), MIN(CASE WHEN w.answers > 0 THEN w.at END),
           MIN(CASE WHEN w.reviews > 0 THEN w.at END)
         FROM work w JOIN task t ON t.id = w.task WHERE w.at >= ?1 AND t.kind = ?2 AND t.gold IS NULL",
        params![recent, kind],
    )?;
    // If the work began within these days, the pace is measured from then on, over at least one day.
    let age = |first: Millis| ((now - first) as f64 / DAY as f64).max(1.0);
    let pace = answers as f64 / first.map_or(1.0, age);
    let mut times: Vec<f64> = tx.list(
        "SELECT secs FROM revision r JOIN task t ON t.id = r.task
         WHERE r.state <> 'draft' AND t.kind = ?1 AND r.at >= ?2 AND t.gold IS NULL",
        params![kind, recent],
    )?;
    let median_secs = quantile::median(&mut times);
    let days_left = (pace > 0.0).then(|| answers_left as f64 / pace);
    Ok(Outlook {
        kind,
        answers_left,
        reviews_left,
        answers_per_day: pace,
        reviews_per_day: reviews as f64 / first_review.map_or(1.0, age),
        secs_per_answer: (answers > 0).then(|| secs / answers as f64),
        hours_left: median_secs.map(|secs| secs * answers_left as f64 / 3600.0),
        days_left,
        ends: days_left.map(|days| now + (days * DAY as f64) as Millis),
    })
}
