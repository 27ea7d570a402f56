//! Applies log entries to the projections, the tables derived from the log.

use super::db::{Result, ToSql, Tx, json, params, unreadable};
use super::entry::{Body, Entry, LoggedTask};
use super::projections::{
    Acceptance, barred, end_leases, is_kept_pair, kept_type, part_list, put_lease, refresh,
    set_state, words,
};
use super::records::Millis;
use super::rows;
use crate::Error;
use crate::state::{LogKind, Purpose, targets};
use crate::wire::{Answer, Lease, RevisionState, TaskState, Verdict};

/// Maximum number of leases of one entry. The id of a lease is the sequence number of its entry times this,
/// plus its index.
const LEASES_PER_ENTRY: i64 = 100;

/// Checks that an entry is legal in the current state of the task. `what` completes the error "cannot be …".
pub(crate) fn check_move(state: TaskState, kind: LogKind, what: &str) -> Result<()> {
    if targets(state, kind).is_empty() {
        return Err(Error::wrong_state(state, what));
    }
    Ok(())
}

/// Applies an entry to the projections.
pub(crate) fn apply(tx: &mut dyn Tx, seq: i64, entry: &Entry) -> Result<()> {
    if let Body::Imported { task } = &entry.body {
        return import(tx, seq, entry, task);
    }
    let Some(task) = entry.task else {
        return Ok(());
    };
    let before = state_of(tx, task)?;
    let kind = entry.body.kind();
    let change = Change {
        seq,
        entry,
        task,
        actor: entry.actor.unwrap_or(0),
    };
    change.apply(tx)?;
    if matches!(
        kind,
        LogKind::Submitted
            | LogKind::Skipped
            | LogKind::Returned
            | LogKind::Accepted
            | LogKind::Merged
            | LogKind::Dropped
            | LogKind::Reopened
            | LogKind::Undone
    ) {
        change.set(tx, "touched", entry.at)?;
    }
    count_work(tx, seq, entry, task)?;
    let after = state_of(tx, task)?;
    if targets(before, kind).contains(&after) {
        return Ok(());
    }
    Err(unreadable(
        "task",
        format!(
            "entry {seq} ({kind}) would move task {task} from {before} to {after}, which is no legal move"
        ),
    ))
}

/// Adds an entry to its actor's work. Decisions by rules and bulk actions do not count as work.
fn count_work(tx: &mut dyn Tx, seq: i64, entry: &Entry, task: i64) -> Result<()> {
    let (secs, request) = entry.body.work();
    let (answers, skips, reviews): (i64, i64, i64) = match &entry.body {
        Body::Submitted { .. } => (1, 0, 0),
        Body::Skipped { .. } => (0, 1, 0),
        Body::Accepted { .. }
        | Body::Merged { .. }
        | Body::Returned { .. }
        | Body::Dropped { .. }
            if request != Some("") =>
        {
            (0, 0, 1)
        }
        _ => (0, 0, 0),
    };
    let Some(actor) = entry
        .actor
        .filter(|_| secs > 0.0 || answers + skips + reviews > 0)
    else {
        return Ok(());
    };
    tx.run(
        "INSERT INTO work (seq, task, usr, at, secs, answers, skips, reviews) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
        params![seq, task, actor, entry.at, secs, answers, skips, reviews],
    )
}

fn state_of(tx: &mut dyn Tx, task: i64) -> Result<TaskState> {
    let sql = "SELECT state FROM task WHERE id = ?1";
    let state = tx.find(sql, params![task])?;
    state.ok_or_else(|| Error::not_found("task"))
}

fn import(tx: &mut dyn Tx, seq: i64, entry: &Entry, task: &LoggedTask) -> Result<()> {
    let id = entry
        .task
        .ok_or_else(|| unreadable("event", format!("entry {seq} imports no task")))?;
    let state = if task.accepted.is_some() {
        TaskState::Accepted
    } else {
        TaskState::Open
    };
    let claimable = task.accepted.is_none() && task.gold.is_none();
    tx.execute(
        "INSERT INTO task (id, key, kind, source, target, split, bundle, bundle_index, category, hint, style,
           priority, shuffle, wanted, gold, extra, state, submitted, leases, epoch, claimable, came_back, changed,
           counted, distance, touched, practice, stated_type, kept_type)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, 0, 0, 0, ?18, 0, 0, ?19,
           NULL, 0, ?20, ?21, ?22)",
        params![
            id,
            task.key,
            task.kind,
            task.source,
            task.target,
            task.split,
            task.bundle,
            task.bundle_index,
            task.category,
            task.hint,
            task.style,
            task.priority,
            task.shuffle,
            task.wanted,
            task.gold.as_ref().map(json).transpose()?,
            task.extra.as_ref().map(json).transpose()?,
            state,
            claimable,
            task.accepted.as_ref().is_some_and(is_kept_pair),
            task.practice,
            task.edit_type,
            task.accepted.as_ref().and_then(kept_type)
        ],
    )?;
    match &task.accepted {
        Some(answer) => {
            Acceptance::imported(answer, task.credit.as_ref(), entry).put(tx, seq, id, entry.at)
        }
        None => Ok(()),
    }
}

/// Id of the lease with index `number` among those that an entry creates.
fn lease_id(seq: i64, number: usize) -> i64 {
    seq * LEASES_PER_ENTRY + number as i64
}

/// An entry about a task, as it is applied.
struct Change<'a> {
    seq: i64,
    entry: &'a Entry,
    task: i64,
    /// The actor of the entry; 0 for none.
    actor: i64,
}

impl Change<'_> {
    /// Names every kind of entry, so that a new one does not compile until somebody applies it.
    fn apply(&self, tx: &mut dyn Tx) -> Result<()> {
        match &self.entry.body {
            Body::Claimed { .. }
            | Body::Renewed { .. }
            | Body::Released { .. }
            | Body::Assigned { .. }
            | Body::Retargeted { .. } => self.apply_lease(tx),
            Body::DraftSaved { .. }
            | Body::Submitted { .. }
            | Body::Skipped { .. }
            | Body::Undone { .. }
            | Body::SuggestionUsed { .. }
            | Body::GoldScored { .. } => self.apply_answer(tx),
            Body::Filled { .. } | Body::ClipChanged { .. } | Body::ClipKept => {
                self.apply_import(tx)
            }
            Body::Returned { .. }
            | Body::Accepted { .. }
            | Body::Merged { .. }
            | Body::Dropped { .. }
            | Body::Reopened { .. } => self.apply_decision(tx),
            Body::Imported { .. }
            | Body::RoleChanged { .. }
            | Body::SettingsChanged { .. }
            | Body::CapturesPlanned { .. }
            | Body::GuidePicture { .. }
            | Body::ParaphraseJudged { .. }
            | Body::Exported { .. } => Ok(()),
        }
    }

    /// Applies entries that change the leases of the task or the number of answers it wants.
    fn apply_lease(&self, tx: &mut dyn Tx) -> Result<()> {
        let task = self.task;
        match &self.entry.body {
            Body::Claimed {
                purpose,
                expires,
                blind,
                place,
            } => {
                if let Some(place) = place {
                    tx.run(
                        "INSERT INTO gold_place (task, usr, bundle, bundle_index) VALUES (?1, ?2, ?3, ?4)
                         ON CONFLICT (task, usr) DO UPDATE SET bundle = excluded.bundle,
                           bundle_index = excluded.bundle_index",
                        params![task, self.actor, place.bundle, place.index],
                    )?;
                }
                self.lease_to_actor(tx, *purpose, *expires, *blind)?;
                self.after_lease(tx, *purpose, TaskState::InReview)
            }
            Body::Renewed { lease, expires } => {
                let sql = "UPDATE lease SET expires = ?2 WHERE id = ?1";
                tx.run(sql, params![lease, expires])
            }
            Body::Released {
                lease,
                user,
                purpose,
                reserved,
                ..
            } => {
                tx.run("DELETE FROM lease WHERE id = ?1", params![lease])?;
                if let Some(until) = reserved {
                    self.reserve(tx, &[*user], *until, Purpose::Returned)?;
                }
                self.after_lease(tx, *purpose, TaskState::Submitted)
            }
            Body::Assigned { user, until } => {
                // Remove earlier reservations of the task.
                let sql =
                    "DELETE FROM lease WHERE task = ?1 AND purpose IN ('returned', 'assigned')";
                tx.run(sql, params![task])?;
                self.reserve(tx, &[*user], *until, Purpose::Assigned)?;
                refresh(tx, task)
            }
            Body::Retargeted { wanted } => {
                self.set(tx, "wanted", wanted)?;
                refresh(tx, task)
            }
            _ => Ok(()),
        }
    }

    /// Applies an author's entries about their answer.
    fn apply_answer(&self, tx: &mut dyn Tx) -> Result<()> {
        let (task, actor, at) = (self.task, self.actor, self.entry.at);
        match &self.entry.body {
            Body::DraftSaved {
                answer,
                rev,
                secs,
                kept_aside: None,
                ..
            } => self.put_revision(tx, RevisionState::Draft, answer, *rev, *secs),
            Body::Submitted {
                answer,
                rev,
                secs,
                distance,
                ..
            } => {
                self.put_revision(tx, RevisionState::Submitted, answer, *rev, *secs)?;
                self.forget(tx, "lease")?;
                self.forget(tx, "skip")?;
                // The author saw the clip as it is now; only answers of others can be about earlier content.
                tx.run(
                    "UPDATE task SET distance = ?2, changed = CASE WHEN EXISTS (
                       SELECT 1 FROM revision WHERE task = ?1 AND author <> ?3) THEN changed ELSE 0 END
                     WHERE id = ?1",
                    params![task, distance, actor],
                )?;
                refresh(tx, task)
            }
            Body::Skipped {
                postponed,
                reason,
                note,
                ..
            } => {
                self.forget(tx, "lease")?;
                tx.run(
                    "INSERT INTO skip (task, usr, postponed, reason, note, at) VALUES (?1, ?2, ?3, ?4, ?5, ?6)
                     ON CONFLICT (task, usr) DO UPDATE SET postponed = excluded.postponed,
                       reason = excluded.reason, note = excluded.note, at = excluded.at",
                    params![task, actor, postponed, reason, note, at],
                )?;
                refresh(tx, task)
            }
            Body::Undone { rev, expires, .. } => {
                let sql = "UPDATE revision SET state = 'draft', rev = ?3, at = ?4 WHERE task = ?1 AND author = ?2";
                tx.run(sql, params![task, actor, rev, at])?;
                let blind = "SELECT blind FROM revision WHERE task = ?1 AND author = ?2";
                let blind = tx.number(blind, params![task, actor])? != 0;
                self.lease_to_actor(tx, Purpose::Annotate, *expires, blind)?;
                self.forget(tx, "gold_score")?;
                // An answer that was taken back does not count until it is handed in again.
                tx.run(
                    "UPDATE work SET answers = 0 WHERE seq = (
                       SELECT MAX(seq) FROM work WHERE task = ?1 AND usr = ?2 AND answers = 1)",
                    params![task, actor],
                )?;
                refresh(tx, task)
            }
            Body::SuggestionUsed {
                suggestion, used, ..
            } => tx.run(
                "INSERT INTO suggestion_use (seq, task, usr, suggestion, used) VALUES (?1, ?2, ?3, ?4, ?5)",
                params![self.seq, task, actor, suggestion, used],
            ),
            Body::GoldScored { score } => tx.run(
                "INSERT INTO gold_score (task, usr, score, at) VALUES (?1, ?2, ?3, ?4)
                 ON CONFLICT (task, usr) DO UPDATE SET score = excluded.score, at = excluded.at",
                params![task, actor, score, at],
            ),
            _ => Ok(()),
        }
    }

    /// Applies entries of dataset imports, and decisions about changed clips.
    fn apply_import(&self, tx: &mut dyn Tx) -> Result<()> {
        match &self.entry.body {
            Body::Filled {
                answer,
                credit,
                extra,
            } => {
                if let Some(extra) = extra {
                    self.set(tx, "extra", json(extra)?)?;
                }
                let acceptance = Acceptance::imported(answer, credit.as_ref(), self.entry);
                // It may replace a label of the dataset.
                tx.run("DELETE FROM accepted WHERE task = ?1", params![self.task])?;
                self.accept(tx, &acceptance)
            }
            // A task without an answer needs no new decision.
            Body::ClipChanged { source, target } => tx.run(
                "UPDATE task SET source = ?2, target = ?3, changed = CASE WHEN gold IS NOT NULL
                   OR EXISTS (SELECT 1 FROM revision WHERE task = ?1)
                   OR EXISTS (SELECT 1 FROM accepted WHERE task = ?1) THEN 1 ELSE 0 END
                 WHERE id = ?1",
                params![self.task, source, target],
            ),
            Body::ClipKept => self.set(tx, "changed", false),
            _ => Ok(()),
        }
    }

    /// Applies decisions of reviewers and rules about answers.
    fn apply_decision(&self, tx: &mut dyn Tx) -> Result<()> {
        let task = self.task;
        match &self.entry.body {
            Body::Returned {
                authors,
                comment,
                until,
                ..
            } => {
                end_leases(tx, task)?;
                let sql = "UPDATE revision SET state = 'returned' WHERE task = ?1 AND author = ?2";
                for author in authors {
                    tx.run(sql, params![task, author])?;
                }
                self.reserve(tx, authors, *until, Purpose::Returned)?;
                self.set(tx, "came_back", true)?;
                self.put_review(tx, authors, comment, None)?;
                refresh(tx, task)
            }
            Body::Accepted {
                author,
                comment,
                rule,
                own,
                ..
            } => {
                self.decide_on_answers(tx, *author)?;
                let accepted = rows::revision(tx, task, *author)?;
                let answer = accepted.ok_or_else(|| Error::not_found("answer"))?.answer;
                self.settle(tx, &[*author], comment, rule.as_deref())?;
                let acceptance = Acceptance {
                    author: *author,
                    keeps: answer.verdict() == Some(Verdict::Keep),
                    ..Acceptance::by(self.actor, &answer, basis(rule.as_deref(), *own))
                };
                self.accept(tx, &acceptance)
            }
            Body::Merged {
                answer,
                comment,
                own,
                ..
            } => {
                // No user has the id 0: all submitted answers are superseded.
                self.decide_on_answers(tx, 0)?;
                let authors = self.authors(tx)?;
                self.settle(tx, &authors, comment, None)?;
                let acceptance = Acceptance {
                    merged: true,
                    ..Acceptance::by(self.actor, answer, basis(None, *own))
                };
                self.accept(tx, &acceptance)
            }
            Body::Dropped { comment, .. } => {
                let authors = self.authors(tx)?;
                self.settle(tx, &authors, comment, None)?;
                set_state(tx, task, TaskState::Dropped)
            }
            Body::Reopened { comment, rule, .. } => {
                tx.run("DELETE FROM accepted WHERE task = ?1", params![task])?;
                tx.run(
                    "UPDATE revision SET state = 'submitted' WHERE task = ?1 AND state IN ('accepted', 'superseded')",
                    params![task],
                )?;
                let authors = self.authors(tx)?;
                self.put_review(tx, &authors, comment, rule.as_deref())?;
                refresh(tx, task)
            }
            _ => Ok(()),
        }
    }

    /// Sets a column of the task.
    fn set(&self, tx: &mut dyn Tx, column: &str, value: impl ToSql) -> Result<()> {
        let sql = format!("UPDATE task SET {column} = ?2 WHERE id = ?1");
        tx.run(&sql, params![self.task, value])
    }

    /// Deletes the actor's row about the task from `table`.
    fn forget(&self, tx: &mut dyn Tx, table: &str) -> Result<()> {
        let sql = format!("DELETE FROM {table} WHERE task = ?1 AND usr = ?2");
        tx.run(&sql, params![self.task, self.actor])
    }

    /// Marks the submitted answer of the author `accepted` as accepted, and the others as superseded.
    fn decide_on_answers(&self, tx: &mut dyn Tx, accepted: i64) -> Result<()> {
        tx.run(
            "UPDATE revision SET state = CASE WHEN author = ?2 THEN 'accepted' ELSE 'superseded' END
             WHERE task = ?1 AND state = 'submitted'",
            params![self.task, accepted],
        )
    }

    /// Ends all leases and records the decision for the current content of the clip.
    fn settle(
        &self,
        tx: &mut dyn Tx,
        authors: &[i64],
        comment: &str,
        rule: Option<&str>,
    ) -> Result<()> {
        end_leases(tx, self.task)?;
        self.put_review(tx, authors, comment, rule)?;
        self.set(tx, "changed", false)
    }

    fn accept(&self, tx: &mut dyn Tx, acceptance: &Acceptance<'_>) -> Result<()> {
        acceptance.put(tx, self.seq, self.task, self.entry.at)?;
        set_state(tx, self.task, TaskState::Accepted)
    }

    /// Derives the state of the task after a lease for `purpose` began or ended. For the lease of a review, the state
    /// becomes `of_review`.
    fn after_lease(&self, tx: &mut dyn Tx, purpose: Purpose, of_review: TaskState) -> Result<()> {
        match purpose {
            Purpose::Review => set_state(tx, self.task, of_review),
            Purpose::Annotate | Purpose::Returned | Purpose::Assigned => refresh(tx, self.task),
        }
    }

    /// Gives the actor a lease with the epoch of the entry.
    fn lease_to_actor(
        &self,
        tx: &mut dyn Tx,
        purpose: Purpose,
        expires: Millis,
        blind: bool,
    ) -> Result<()> {
        let lease = Lease {
            id: lease_id(self.seq, 0),
            task: self.task,
            user: self.actor,
            epoch: self.entry.epoch.unwrap_or(0),
            expires,
        };
        put_lease(tx, &lease, purpose, blind)
    }

    /// Reserves the task for people.
    fn reserve(
        &self,
        tx: &mut dyn Tx,
        users: &[i64],
        expires: Millis,
        purpose: Purpose,
    ) -> Result<()> {
        let epoch = tx.number("SELECT epoch FROM task WHERE id = ?1", params![self.task])?;
        for (number, &user) in users.iter().enumerate() {
            let lease = Lease {
                id: lease_id(self.seq, number),
                task: self.task,
                user,
                epoch: epoch + 1 + number as i64,
                expires,
            };
            put_lease(tx, &lease, purpose, false)?;
        }
        Ok(())
    }

    fn put_revision(
        &self,
        tx: &mut dyn Tx,
        state: RevisionState,
        answer: &Answer,
        rev: i64,
        secs: f64,
    ) -> Result<()> {
        let sql = "SELECT blind FROM lease WHERE task = ?1 AND usr = ?2";
        let blind = tx.number(sql, params![self.task, self.actor])?;
        tx.run(
            "INSERT INTO revision (task, author, rev, state, answer, at, secs, blind, verdict, edit_type, words, parts)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12)
         ON CONFLICT (task, author) DO UPDATE SET rev = excluded.rev, state = excluded.state,
           answer = excluded.answer, at = excluded.at, secs = revision.secs + excluded.secs,
           blind = CASE WHEN excluded.blind = 1 THEN 1 ELSE revision.blind END,
           verdict = excluded.verdict, edit_type = excluded.edit_type,
           words = excluded.words, parts = excluded.parts",
            params![
                self.task,
                self.actor,
                rev,
                state,
                json(answer)?,
                self.entry.at,
                secs,
                blind,
                answer.verdict(),
                answer.fields().edit_type,
                words(answer),
                part_list(answer)
            ],
        )
    }

    /// Everybody who answered the task.
    fn authors(&self, tx: &mut dyn Tx) -> Result<Vec<i64>> {
        let sql =
            "SELECT author FROM revision WHERE task = ?1 AND state <> 'draft' ORDER BY author";
        tx.list(sql, params![self.task])
    }

    fn put_review(
        &self,
        tx: &mut dyn Tx,
        authors: &[i64],
        comment: &str,
        rule: Option<&str>,
    ) -> Result<()> {
        let authors = barred(authors.iter().map(ToString::to_string));
        tx.run(
            "INSERT INTO review (seq, task, reviewer, decision, authors, comment, at, rule)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
            params![
                self.seq,
                self.task,
                self.actor,
                self.entry.body.kind(),
                authors,
                comment,
                self.entry.at,
                rule
            ],
        )
    }
}

/// How an answer was accepted, for the column `accepted.basis`.
fn basis(rule: Option<&str>, own: bool) -> String {
    match rule {
        Some(rule) => format!("rule:{rule}"),
        None if own => "own".to_owned(),
        None => "review".to_owned(),
    }
}
