//! Events of a task: drafts, submissions, skips and undo.

use super::db::{Result, Tx, params};
use super::entry::{Body, Entry};
use super::leases::{MINUTE, Turn};
use super::log::{self, Request};
use super::records::{Millis, TaskRecord};
use super::store::Store;
use super::{apply, project, read, rows, rules};
use crate::answer;
use crate::error::{Error, require};
use crate::state::{LogKind, Purpose};
use crate::wire::{
    Answer, Code, EventKind, EventResult, Feedback, Lease, NewEvent, Problem, Revision,
    RevisionState, Settings, TaskState,
};

/// Maximum working time that one event can report.
const MAX_SECS: f64 = 3600.0;

/// Working time for the log: a finite number from 0 to [`MAX_SECS`].
pub(super) fn working(secs: f64) -> f64 {
    if secs.is_finite() {
        secs.clamp(0.0, MAX_SECS)
    } else {
        0.0
    }
}

impl Store {
    /// Applies events of a task in order, up to the first that fails. Refused with `not_found`.
    pub fn append(
        &self,
        user: i64,
        task: i64,
        events: Vec<NewEvent>,
        now: Millis,
    ) -> Result<Vec<EventResult>> {
        self.write(move |tx| {
            // `+actor` makes SQLite use the index on tasks: a task has few log entries, a person has many.
            let known = "SELECT 1 FROM event WHERE task = ?1 AND +actor = ?2 LIMIT 1";
            if !tx.has(known, params![task, user])? {
                return Err(Error::not_found("task"));
            }
            let turn = Turn::of(tx, user, now)?;
            let mut results = Vec::new();
            for event in &events {
                let result = match take(tx, &turn, task, event) {
                    Err(Error::Refused(problem)) => {
                        told(tx, user, task, event, None, Some(*problem), None)?
                    }
                    result => result?,
                };
                let ok = result.status == 200;
                results.push(result);
                if !ok {
                    break;
                }
            }
            Ok(results)
        })
    }
}

/// The reply to an event; `seq` is the sequence number of its log entry, if it was logged.
fn told(
    tx: &mut dyn Tx,
    user: i64,
    id: i64,
    event: &NewEvent,
    seq: Option<i64>,
    problem: Option<Problem>,
    feedback: Option<Feedback>,
) -> Result<EventResult> {
    let task = rows::task(tx, id)?;
    Ok(EventResult {
        idem_key: event.idem_key.clone(),
        status: problem.as_ref().map_or(200, |problem| problem.status),
        seq,
        rev: rev_of(rows::revision(tx, id, user)?.as_ref()),
        state: Some(read::shown(tx, task, user)?.state),
        lease: annotate_lease(tx, id, user)?,
        problem,
        feedback,
    })
}

fn annotate_lease(tx: &mut dyn Tx, task: i64, user: i64) -> Result<Option<Lease>> {
    Ok(rows::lease_of(tx, task, user)?
        .filter(|held| held.purpose == Purpose::Annotate)
        .map(|held| held.lease))
}

/// The number of an answer's current revision; 0 without an answer.
fn rev_of(mine: Option<&Revision>) -> i64 {
    mine.map_or(0, |mine| mine.rev)
}

/// Applies an event, or returns the stored reply to a repeated event.
fn take(tx: &mut dyn Tx, turn: &Turn, id: i64, event: &NewEvent) -> Result<EventResult> {
    let request = Request::new(turn.user, &event.idem_key, &(id, event))?;
    if let Some(result) = request.replay(tx)? {
        return Ok(result);
    }
    answer::check_text("note", &event.note)?;
    let taking = Taking {
        turn,
        task: rows::task(tx, id)?,
        event,
        request,
        mine: rows::revision(tx, id, turn.user)?,
    };
    match event.kind {
        EventKind::Draft | EventKind::Submit => taking.answer(tx),
        EventKind::Skip | EventKind::Postpone => taking.skip(tx),
        EventKind::Undo => taking.undo(tx),
        EventKind::SuggestionUsed => taking.suggestion_used(tx),
    }
}

/// An event with its author, its task, and the other data that its log entry depends on.
struct Taking<'a> {
    turn: &'a Turn,
    task: TaskRecord,
    event: &'a NewEvent,
    request: Request,
    /// The author's current answer.
    mine: Option<Revision>,
}

impl Taking<'_> {
    /// Writes an entry and returns the reply, which is stored for repetitions of the same key.
    fn log(
        &self,
        tx: &mut dyn Tx,
        epoch: Option<i64>,
        body: Body,
        problem: Option<Problem>,
        feedback: Option<Feedback>,
    ) -> Result<EventResult> {
        let (user, id, event) = (self.turn.user, self.task.id, self.event);
        let entry = Entry::new(self.turn.now, Some(user), Some(id), epoch, body);
        self.request.log(tx, &entry, event.base_rev, |tx, seq| {
            told(tx, user, id, event, Some(seq), problem, feedback)
        })
    }

    /// The user's lease on the task, if the event was sent under it.
    fn held(&self, tx: &mut dyn Tx) -> Result<Option<Lease>> {
        let held = annotate_lease(tx, self.task.id, self.turn.user)?;
        Ok(held.filter(|held| held.epoch == self.event.lease_epoch))
    }

    /// The author's answer, if it is submitted and was not sent back.
    fn handed_in(&self) -> Option<&Revision> {
        let is_handed_in = |mine: &&Revision| {
            !matches!(mine.state, RevisionState::Draft | RevisionState::Returned)
        };
        self.mine.as_ref().filter(is_handed_in)
    }

    /// The log entry that saves an answer as a draft.
    fn draft(&self, answer: Answer, rev: i64, secs: f64, kept_aside: Option<Code>) -> Body {
        Body::DraftSaved {
            answer,
            rev,
            secs,
            kept_aside: kept_aside.map(|code| code.to_string()),
            request: self.request.hash.clone(),
        }
    }

    fn answer(&self, tx: &mut dyn Tx) -> Result<EventResult> {
        let event = self.event;
        let answer = event.answer.clone();
        let answer = answer.ok_or_else(|| Error::invalid("answer", "the answer is missing"))?;
        answer::check_draft(&answer, self.task.kind)?;
        for id in answer.texts().into_iter().filter_map(|(_, id)| id) {
            self.check_suggestion(tx, id)?;
        }
        if event.kind == EventKind::Submit {
            let length = project::length(tx, &self.task.source)?;
            answer::check_submission(&answer, self.task.kind, &self.turn.settings, length)?;
        }
        let held = self.held(tx)?;
        let rev = rev_of(self.mine.as_ref());
        if event.base_rev != rev {
            return self.stale(tx, answer, rev);
        }
        let Some(held) = held else {
            return self.without_lease(tx, answer, rev);
        };
        if event.kind == EventKind::Submit {
            return self.submit(tx, answer, rev, held.epoch);
        }
        let body = self.draft(answer, rev + 1, working(event.secs), None);
        self.log(tx, Some(held.epoch), body, None, None)
    }

    /// Writes an answer that is not based on the current revision to the log, without making it a revision.
    fn stale(&self, tx: &mut dyn Tx, answer: Answer, rev: i64) -> Result<EventResult> {
        let detail = format!(
            "this change is based on revision {}, but {rev} is current; both are in the log",
            self.event.base_rev
        );
        let mut problem = Problem::new(Code::StaleRevision, detail);
        problem.theirs = self.mine.clone().map(Box::new);
        let body = self.draft(answer, rev, 0.0, Some(Code::StaleRevision));
        self.log(tx, Some(self.event.lease_epoch), body, Some(problem), None)
    }

    /// Keeps the answer of a person whose lease has ended: as a draft, or only in the log if the person has already
    /// submitted an answer.
    fn without_lease(&self, tx: &mut dyn Tx, answer: Answer, rev: i64) -> Result<EventResult> {
        let handed_in = self.handed_in().is_some();
        let detail = if handed_in {
            "your answer is submitted; undo the submission before changing it"
        } else if self.is_of_earlier_clip(tx)? {
            "the clip of this task was ingested anew, with other content; your text is kept as a draft, claim the task \
             again and look at the clip"
        } else if self.taken(tx)? {
            "your lease on this task expired and somebody else has the task; your text is kept as a draft"
        } else {
            "your lease on this task expired; your text is kept as a draft, claim the task again to go on"
        };
        let kept_aside = handed_in.then_some(Code::LeaseLost);
        let rev = if handed_in { rev } else { rev + 1 };
        let body = self.draft(answer, rev, working(self.event.secs), kept_aside);
        let problem = Problem::new(Code::LeaseLost, detail);
        self.log(tx, Some(self.event.lease_epoch), body, Some(problem), None)
    }

    /// Submits an answer, scores it if the task has a known answer, and applies the rules.
    fn submit(&self, tx: &mut dyn Tx, answer: Answer, rev: i64, epoch: i64) -> Result<EventResult> {
        let mut answers = others(tx, self.task.id, self.turn.user)?;
        answers.push(answer.clone());
        let frames = project::frames(tx, &self.task.source)?;
        let known = read::known_answer(tx, &self.task)?;
        let scored = known.map(|known| Feedback {
            score: 1.0 - answer::distance(&known, &answer, frames),
            known,
        });
        let score = scored.as_ref().map(|feedback| feedback.score);
        let body = Body::Submitted {
            answer,
            rev: rev + 1,
            secs: working(self.event.secs),
            distance: answer::spread(&answers, frames),
            request: self.request.hash.clone(),
        };
        let feedback = scored.filter(|_| self.task.practice);
        let result = self.log(tx, Some(epoch), body, None, feedback)?;
        if let Some(score) = score {
            let (user, task) = (Some(self.turn.user), Some(self.task.id));
            log::note(tx, self.turn.now, user, task, Body::GoldScored { score })?;
        }
        rules::on_answer(tx, self.turn, self.task.id)?;
        Ok(result)
    }

    /// Whether others have taken the task: somebody else holds it, and it takes no more annotators.
    fn taken(&self, tx: &mut dyn Tx) -> Result<bool> {
        tx.has(
            "SELECT 1 FROM task t WHERE t.id = ?1 AND t.claimable = 0
               AND EXISTS (SELECT 1 FROM lease l WHERE l.task = t.id AND l.usr <> ?2)",
            params![self.task.id, self.turn.user],
        )
    }

    /// Whether the clip changed after the user got the task.
    fn is_of_earlier_clip(&self, tx: &mut dyn Tx) -> Result<bool> {
        tx.has(
            "SELECT 1 FROM event c WHERE c.task = ?1 AND c.kind = 'clip_changed' AND c.seq > (
               SELECT MAX(e.seq) FROM event e WHERE e.task = ?1 AND +e.actor = ?2 AND e.kind IN ('claimed', 'undone'))
             LIMIT 1",
            params![self.task.id, self.turn.user],
        )
    }

    /// Checks that a suggestion belongs to the task.
    fn check_suggestion(&self, tx: &mut dyn Tx, id: i64) -> Result<()> {
        let sql = "SELECT 1 FROM suggestion WHERE id = ?1 AND task = ?2";
        let belongs = tx.has(sql, params![id, self.task.id])?;
        let problem = format!("suggestion {id} does not belong to this task");
        require(belongs, "suggestion", problem)
    }

    fn skip(&self, tx: &mut dyn Tx) -> Result<EventResult> {
        let event = self.event;
        let postponed = event.kind == EventKind::Postpone;
        let problem = "choose a reason for skipping the task";
        require(postponed || event.reason.is_some(), "reason", problem)?;
        let problem = "your lease on this task expired; there is nothing to skip";
        let held = self.held(tx)?;
        let held = held.ok_or_else(|| Error::refused(Code::LeaseLost, problem))?;
        let body = Body::Skipped {
            postponed,
            reason: event.reason.filter(|_| !postponed),
            note: event.note.trim().to_owned(),
            secs: working(event.secs),
            request: self.request.hash.clone(),
        };
        self.log(tx, Some(held.epoch), body, None, None)
    }

    fn undo(&self, tx: &mut dyn Tx) -> Result<EventResult> {
        let mut state = self.task.state;
        let Some(mine) = self.handed_in() else {
            let problem = "taken back: you have no answer waiting for review";
            return Err(Error::wrong_state(state, problem));
        };
        // If a rule accepted the answer, and not too long ago, take that acceptance back first.
        if let Some((rule, at)) = rules::accepted_by_rule(tx, self.task.id)?
            && self.turn.now - at <= take_back_window(&self.turn.settings)
        {
            let (user, now) = (self.turn.user, self.turn.now);
            let comment = "taken back by its author";
            rules::reopen(tx, user, self.task.id, &rule, comment, now)?;
            state = TaskState::Submitted;
        }
        apply::check_move(state, LogKind::Undone, "taken back")?;
        let sql = "SELECT epoch FROM task WHERE id = ?1";
        let epoch = 1 + tx.number(sql, params![self.task.id])?;
        let body = Body::Undone {
            rev: mine.rev + 1,
            expires: self.turn.lease_end(),
            request: self.request.hash.clone(),
        };
        self.log(tx, Some(epoch), body, None, None)
    }

    fn suggestion_used(&self, tx: &mut dyn Tx) -> Result<EventResult> {
        let (Some(suggestion), Some(used)) = (self.event.suggestion, self.event.used) else {
            let problem = "the suggestion, or what became of it, is missing";
            return Err(Error::invalid("suggestion", problem));
        };
        self.check_suggestion(tx, suggestion)?;
        let body = Body::SuggestionUsed {
            suggestion,
            used,
            request: self.request.hash.clone(),
        };
        self.log(tx, Some(self.event.lease_epoch), body, None, None)
    }
}

/// How long an author may take back an answer that a rule accepted, in milliseconds.
pub(super) fn take_back_window(settings: &Settings) -> Millis {
    Millis::from(settings.take_back_minutes) * MINUTE
}

/// Submitted answers to a task, except those of one author.
fn others(tx: &mut dyn Tx, task: i64, but: i64) -> Result<Vec<Answer>> {
    tx.list(
        "SELECT answer FROM revision WHERE task = ?1 AND author <> ?2
           AND state IN ('submitted', 'accepted', 'superseded') ORDER BY author",
        params![task, but],
    )
}
