//! A person's own answers and their standings.

use serde::Deserialize;

use super::append::take_back_window;
use super::db::{Result, Tx, params};
use super::filter::cursor;
use super::records::{Millis, MineQuery, TaskRecord};
use super::rows::{self, REVISION, TASK};
use super::store::Store;
use super::{project, read};
use crate::wire::{Answer, Feedback, MyAnswer, Revision, RevisionState, Standing, TaskState};

impl Store {
    /// A person's answers, newest first, with the cursor of the next page. Refused with `invalid`.
    pub fn answers_of(
        &self,
        user: i64,
        query: MineQuery,
        now: Millis,
    ) -> Result<(Vec<MyAnswer>, Option<String>)> {
        self.read(|tx| {
            let (mut at, mut task) = match &query.before {
                None => (i64::MAX, i64::MAX),
                Some(before) => cursor("before", before)?,
            };
            let since = now - take_back_window(&project::settings(tx)?);
            let sql = format!(
                "SELECT {TASK}, {REVISION}, a.author, COALESCE(a.merged, 0), a.answer, a.at, a.basis FROM revision r
                 JOIN task t ON t.id = r.task LEFT JOIN accepted a ON a.task = r.task
                 WHERE r.author = ?1 AND (r.at, r.task) < (?2, ?3) AND (?4 = '' OR t.kind = ?4)
                   AND (CAST(?6 AS BIGINT) = 0 OR r.task = ?6)
                 ORDER BY r.at DESC, r.task DESC LIMIT ?5"
            );
            let kind = query.kind.map_or("", |kind| kind.as_str());
            let (batch, only) = (query.limit as i64 + 1, query.task.unwrap_or(0));
            let mut found: Vec<MyAnswer> = Vec::new();
            // The standing is not a column, so rows with another standing are read and skipped.
            loop {
                let rows: Vec<Found> = tx.list(&sql, params![user, at, task, kind, batch, only])?;
                let is_last = (rows.len() as i64) < batch;
                for row in rows {
                    (at, task) = (row.mine.at, row.mine.task);
                    found.extend(own_answer(tx, user, row, query.standing, since)?);
                    if found.len() > query.limit {
                        found.truncate(query.limit);
                        let last = found.last().map(|last| &last.mine);
                        let next = last.map(|mine| format!("{}:{}", mine.at, mine.task));
                        return Ok((found, next));
                    }
                }
                if is_last {
                    return Ok((found, None));
                }
            }
        })
    }
}

/// An answer, its task, and the accepted answer with its author, time and basis.
#[derive(Deserialize)]
struct Found {
    task: TaskRecord,
    mine: Revision,
    author: Option<i64>,
    merged: bool,
    accepted: Option<Answer>,
    at: Option<Millis>,
    basis: Option<String>,
}

/// A person's answer; `None` if its standing is not the wanted one. The author can take back an answer that a rule
/// accepted at `since` or later.
fn own_answer(
    tx: &mut dyn Tx,
    user: i64,
    found: Found,
    wanted: Option<Standing>,
    since: Millis,
) -> Result<Option<MyAnswer>> {
    let mine = found.mine;
    let task = read::shown(tx, found.task, user)?;
    let feedback = if task.practice && mine.state != RevisionState::Draft {
        feedback(tx, user, &task)?
    } else {
        None
    };
    let standing = match feedback {
        Some(_) => Standing::Practice,
        None => standing(task.state, mine.state),
    };
    if wanted.is_some_and(|wanted| wanted != standing) {
        return Ok(None);
    }
    let basis = found.basis.as_deref();
    let by_rule = basis.is_some_and(|basis| basis.starts_with("rule:"));
    let can_take_back = match standing {
        Standing::WaitsForOthers | Standing::WaitsForReview | Standing::Practice => true,
        Standing::Accepted | Standing::Superseded => {
            by_rule && found.at.is_some_and(|at| at >= since)
        }
        Standing::Draft | Standing::InReview | Standing::Returned | Standing::Dropped => false,
    };
    let comment = match standing {
        Standing::Returned | Standing::Draft => read::comment_to(tx, task.id, user, "returned")?,
        Standing::Dropped => read::comment_to(tx, task.id, user, "dropped")?,
        _ => None,
    };
    let until = if standing == Standing::Returned {
        rows::lease_of(tx, task.id, user)?.map(|held| held.lease.expires)
    } else {
        None
    };
    let other = found.merged || found.author != Some(user);
    let missing = match standing {
        Standing::WaitsForOthers => task.wanted.saturating_sub(task.submitted),
        _ => 0,
    };
    Ok(Some(MyAnswer {
        standing,
        missing,
        comment,
        accepted: found.accepted.filter(|_| other),
        // The author may see the rule or the kind of review that accepted the answer.
        accepted_by: found.basis,
        can_take_back,
        until,
        feedback,
        task: read::view(tx, task, None)?,
        mine,
    }))
}

/// Feedback on a practice task for a user who submitted it.
fn feedback(tx: &mut dyn Tx, user: i64, task: &TaskRecord) -> Result<Option<Feedback>> {
    let sql = "SELECT score FROM gold_score WHERE task = ?1 AND usr = ?2";
    let score = tx.find(sql, params![task.id, user])?;
    let known = score.zip(read::known_answer(tx, task)?);
    Ok(known.map(|(score, known)| Feedback { score, known }))
}

/// The standing of an answer, from the state of its task and its own state.
fn standing(task: TaskState, mine: RevisionState) -> Standing {
    match mine {
        // Nobody can work on a task that is decided, whatever became of this answer before.
        RevisionState::Returned | RevisionState::Draft if task == TaskState::Accepted => {
            Standing::Superseded
        }
        RevisionState::Returned if task != TaskState::Dropped => Standing::Returned,
        RevisionState::Draft if task != TaskState::Dropped => Standing::Draft,
        RevisionState::Accepted => Standing::Accepted,
        RevisionState::Superseded => Standing::Superseded,
        RevisionState::Submitted | RevisionState::Draft | RevisionState::Returned => match task {
            TaskState::Dropped => Standing::Dropped,
            TaskState::InReview => Standing::InReview,
            TaskState::Submitted => Standing::WaitsForReview,
            _ => Standing::WaitsForOthers,
        },
    }
}
