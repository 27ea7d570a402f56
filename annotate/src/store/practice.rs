//! Practice: tasks with known answers that a new annotator does before real work.

use super::db::{Result, Tx, params};
use super::project;
use super::store::Store;
use crate::wire::{Practice, Settings, TaskKind};

impl Store {
    /// A user's practice of each kind.
    pub fn practice(&self, user: i64) -> Result<Vec<Practice>> {
        self.read(|tx| {
            let settings = project::settings(tx)?;
            let kinds = TaskKind::ALL.iter();
            kinds
                .map(|&kind| standing(tx, user, kind, &settings))
                .collect()
        })
    }
}

/// Where a user stands with the practice tasks of a kind. Reviewers and admins need no practice.
pub(super) fn standing(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
    settings: &Settings,
) -> Result<Practice> {
    let sql = "SELECT COUNT(*) FROM task WHERE practice = 1 AND kind = ?1 AND state IN ('open', 'leased')";
    let there = tx.number(sql, params![kind.as_str()])?;
    let needed = there.min(settings.practice_tasks.into());
    let scores = tx.list(
        "SELECT g.score FROM gold_score g JOIN task t ON t.id = g.task
         WHERE g.usr = ?1 AND t.practice = 1 AND t.kind = ?2 ORDER BY g.at DESC, g.task DESC LIMIT ?3",
        params![user, kind.as_str(), needed],
        |row| row.real(0),
    )?;
    let done = scores.len() as i64;
    let score = (done > 0).then(|| scores.iter().sum::<f64>() / done as f64);
    let threshold = f64::from(settings.practice_percent) / 100.0;
    let sql = "SELECT 1 FROM usr WHERE id = ?1 AND role = 'annotator'";
    let annotates = tx.has(sql, params![user])?;
    Ok(Practice {
        kind,
        needed,
        done,
        score,
        threshold,
        passed: !annotates
            || done >= needed && (needed == 0 || score.is_some_and(|score| score >= threshold)),
    })
}

/// The practice task that a user has to do next, if real work of the kind is not open to them yet. New tasks come
/// first, then the one answered longest ago.
pub(super) fn next(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
    settings: &Settings,
) -> Result<Option<i64>> {
    if settings.practice_tasks == 0 || standing(tx, user, kind, settings)?.passed {
        return Ok(None);
    }
    tx.find(
        "SELECT t.id FROM task t LEFT JOIN gold_score g ON g.task = t.id AND g.usr = ?2
         WHERE t.practice = 1 AND t.kind = ?1 AND t.state IN ('open', 'leased')
         ORDER BY CASE WHEN g.at IS NULL THEN 0 ELSE 1 END,
           (SELECT COUNT(*) FROM skip s WHERE s.task = t.id AND s.usr = ?2), g.at, t.shuffle, t.id LIMIT 1",
        params![kind.as_str(), user],
        |row| row.int(0),
    )
}
