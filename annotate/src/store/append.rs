//! Events of a task: drafts, submissions, skips and undo.

use super::db::{Tx, params};
use super::entry::{Body, Entry, Reply};
use super::leases::{MINUTE, lease_end};
use super::project;
use super::records::{Millis, TaskRecord};
use super::replies::{full_key, hash_of, parsed, replay};
use super::{apply, log, read, rows, rules};
use crate::Error;
use crate::answer;
use crate::state::{LogKind, Purpose};
use crate::wire::{
    Answer, Code, EventKind, EventResult, Feedback, Lease, MAX_TEXT_CHARS, NewEvent, Problem,
    Revision, RevisionState, Settings, TaskState,
};

/// Maximum working time that one event can report.
const MAX_SECS: f64 = 3600.0;

/// Working time as it is logged.
pub(super) fn working(secs: f64) -> f64 {
    if secs.is_finite() {
        secs.clamp(0.0, MAX_SECS)
    } else {
        0.0
    }
}

/// Context of an event: its author, its task, the settings and the time.
struct Taking {
    user: i64,
    task: TaskRecord,
    settings: Settings,
    now: Millis,
}

/// An answer that came with an event.
struct Written<'a> {
    event: &'a NewEvent,
    key: String,
    request: String,
    answer: Answer,
    /// The number of the current revision.
    rev: i64,
}

/// Applies events of a task in order, up to the first that fails.
pub(super) fn append(
    tx: &mut dyn Tx,
    user: i64,
    id: i64,
    events: &[NewEvent],
    now: Millis,
) -> Result<Vec<EventResult>, Error> {
    // `+actor` makes SQLite use the index on tasks: a task has few log entries, a person has many.
    let known = tx.one(
        "SELECT 1 FROM event WHERE task = ?1 AND +actor = ?2 LIMIT 1",
        params![id, user],
    )?;
    if known.is_none() {
        return Err(Error::not_found("task"));
    }
    let settings = project::settings(tx)?;
    let mut results = Vec::new();
    for event in events {
        let taking = Taking {
            user,
            task: rows::task(tx, id)?,
            settings: settings.clone(),
            now,
        };
        let result = match taking.event(tx, event) {
            Ok(result) => result,
            Err(Error::Refused(problem)) => refused(tx, &taking, event, *problem)?,
            Err(error) => return Err(error),
        };
        let ok = result.status == 200;
        results.push(result);
        if !ok {
            break;
        }
    }
    Ok(results)
}

/// The reply to an event that was not logged.
fn refused(
    tx: &mut dyn Tx,
    taking: &Taking,
    event: &NewEvent,
    problem: Problem,
) -> Result<EventResult, Error> {
    Ok(EventResult {
        idem_key: event.idem_key.clone(),
        status: problem.status,
        seq: None,
        rev: rows::revision(tx, taking.task.id, taking.user)?.map_or(0, |mine| mine.rev),
        state: Some(state_for(tx, taking.task.id, taking.user)?),
        lease: annotate_lease(tx, taking.task.id, taking.user)?,
        problem: Some(problem),
        feedback: None,
    })
}

/// State of a task as its user is told it.
fn state_for(tx: &mut dyn Tx, task: i64, user: i64) -> Result<TaskState, Error> {
    let task = rows::task(tx, task)?;
    Ok(read::shown(tx, task, user)?.state)
}

fn annotate_lease(tx: &mut dyn Tx, task: i64, user: i64) -> Result<Option<Lease>, Error> {
    Ok(rows::lease_of(tx, task, user)?
        .filter(|held| held.purpose == Purpose::Annotate)
        .map(|held| held.lease))
}

impl Taking {
    fn event(&self, tx: &mut dyn Tx, event: &NewEvent) -> Result<EventResult, Error> {
        let key = full_key(self.user, &event.idem_key)?;
        let request = hash_of(&(self.task.id, event))?;
        if let Some(result) = replay(tx, &key, &request)? {
            return parsed(&result);
        }
        if event.note.chars().count() > MAX_TEXT_CHARS {
            return Err(Error::invalid("note", "the note is too long"));
        }
        let mine = rows::revision(tx, self.task.id, self.user)?;
        match event.kind {
            EventKind::Draft | EventKind::Submit => self.answer(tx, event, key, request, mine),
            EventKind::Skip | EventKind::Postpone => self.skip(tx, event, key, request),
            EventKind::Undo => self.undo(tx, event, key, request, mine),
            EventKind::SuggestionUsed => self.suggestion_used(tx, event, key, request),
        }
    }

    fn entry(&self, epoch: Option<i64>, body: Body) -> Entry {
        Entry {
            at: self.now,
            actor: Some(self.user),
            task: Some(self.task.id),
            epoch,
            body,
        }
    }

    /// Writes an entry and returns the reply, which is stored for repetitions of the same key.
    fn log(
        &self,
        tx: &mut dyn Tx,
        entry: &Entry,
        event: &NewEvent,
        key: String,
        problem: Option<Problem>,
    ) -> Result<EventResult, Error> {
        self.log_with(tx, entry, event, key, problem, None)
    }

    /// [`Self::log`] with the known answer of a practice task.
    fn log_with(
        &self,
        tx: &mut dyn Tx,
        entry: &Entry,
        event: &NewEvent,
        key: String,
        problem: Option<Problem>,
        feedback: Option<Feedback>,
    ) -> Result<EventResult, Error> {
        let mut answered = None;
        log::write(tx, entry, |tx, seq| {
            let result = EventResult {
                idem_key: event.idem_key.clone(),
                status: problem.as_ref().map_or(200, |problem| problem.status),
                seq: Some(seq),
                rev: rows::revision(tx, self.task.id, self.user)?.map_or(0, |mine| mine.rev),
                state: Some(state_for(tx, self.task.id, self.user)?),
                lease: annotate_lease(tx, self.task.id, self.user)?,
                problem,
                feedback,
            };
            let text = serde_json::to_string(&result).map_err(|error| Error::Row {
                table: "event",
                problem: error.to_string(),
            })?;
            answered = Some(result);
            Ok(Some(Reply {
                idem_key: key,
                base_rev: event.base_rev,
                result: text,
            }))
        })?;
        answered.ok_or(Error::Closed)
    }

    fn answer(
        &self,
        tx: &mut dyn Tx,
        event: &NewEvent,
        key: String,
        request: String,
        mine: Option<Revision>,
    ) -> Result<EventResult, Error> {
        let answer = event
            .answer
            .clone()
            .ok_or_else(|| Error::invalid("answer", "the answer is missing"))?;
        answer::check_draft(&answer, self.task.kind)?;
        self.check_suggestions(tx, &answer)?;
        if event.kind == EventKind::Submit {
            let frames = project::frames(tx, &self.task.source)?;
            answer::check_submission(&answer, self.task.kind, &self.settings, frames)?;
        }
        let held = rows::lease_of(tx, self.task.id, self.user)?.filter(|held| {
            held.purpose == Purpose::Annotate && held.lease.epoch == event.lease_epoch
        });
        let written = Written {
            event,
            key,
            request,
            answer,
            rev: mine.as_ref().map_or(0, |mine| mine.rev),
        };
        if event.base_rev != written.rev {
            return self.stale(tx, written, mine);
        }
        let Some(held) = held else {
            return self.without_lease(tx, written, mine);
        };
        let epoch = Some(held.lease.epoch);
        if event.kind == EventKind::Submit {
            return self.submit(tx, written, epoch);
        }
        let body = Body::DraftSaved {
            answer: written.answer,
            rev: written.rev + 1,
            secs: working(event.secs),
            kept_aside: None,
            request: written.request,
        };
        self.log(tx, &self.entry(epoch, body), event, written.key, None)
    }

    /// Keeps an answer that is not based on the current one, `mine`, in the log alone.
    fn stale(
        &self,
        tx: &mut dyn Tx,
        written: Written<'_>,
        mine: Option<Revision>,
    ) -> Result<EventResult, Error> {
        let Written { event, rev, .. } = written;
        let mut problem = Problem::new(
            Code::StaleRevision,
            format!(
                "this change is based on revision {}, but {rev} is current; both are in the log",
                event.base_rev
            ),
        );
        if let Some(mine) = mine {
            problem = problem.with_theirs(mine);
        }
        let body = Body::DraftSaved {
            answer: written.answer,
            rev,
            secs: 0.0,
            kept_aside: Some(Code::StaleRevision.to_string()),
            request: written.request,
        };
        let entry = self.entry(Some(event.lease_epoch), body);
        self.log(tx, &entry, event, written.key, Some(problem))
    }

    /// Keeps the answer of a person whose lease has ended: as a draft, or in the log alone if an answer of theirs is submitted.
    fn without_lease(
        &self,
        tx: &mut dyn Tx,
        written: Written<'_>,
        mine: Option<Revision>,
    ) -> Result<EventResult, Error> {
        let Written { event, rev, .. } = written;
        let handed_in = mine.is_some_and(|mine| {
            !matches!(mine.state, RevisionState::Draft | RevisionState::Returned)
        });
        let detail = if handed_in {
            "your answer is submitted; undo the submission before changing it"
        } else if self.taken(tx)? {
            "your lease on this task expired and somebody else has the task; your text is kept as a draft"
        } else {
            "your lease on this task expired; your text is kept as a draft, claim the task again to go on"
        };
        let body = Body::DraftSaved {
            answer: written.answer,
            rev: if handed_in { rev } else { rev + 1 },
            secs: working(event.secs),
            kept_aside: handed_in.then(|| Code::LeaseLost.to_string()),
            request: written.request,
        };
        let problem = Problem::new(Code::LeaseLost, detail);
        let entry = self.entry(Some(event.lease_epoch), body);
        self.log(tx, &entry, event, written.key, Some(problem))
    }

    /// Hands an answer in, scores it if the right one is known, and lets the rules decide about it.
    fn submit(
        &self,
        tx: &mut dyn Tx,
        written: Written<'_>,
        epoch: Option<i64>,
    ) -> Result<EventResult, Error> {
        let Written { event, answer, .. } = written;
        let mut answers = handed_in(tx, self.task.id, self.user)?;
        answers.push(answer.clone());
        let frames = project::frames(tx, &self.task.source)?;
        let score = self
            .task
            .gold
            .as_ref()
            .map(|gold| 1.0 - answer::distance(gold, &answer, frames));
        let body = Body::Submitted {
            answer,
            rev: written.rev + 1,
            secs: working(event.secs),
            distance: answer::spread(&answers, frames),
            request: written.request,
        };
        let feedback = self
            .task
            .gold
            .clone()
            .zip(score)
            .filter(|_| self.task.practice)
            .map(|(known, score)| Feedback { score, known });
        let entry = self.entry(epoch, body);
        let result = self.log_with(tx, &entry, event, written.key, None, feedback)?;
        if let Some(score) = score {
            log::note(tx, &self.entry(None, Body::GoldScored { score }))?;
        }
        rules::on_answer(tx, &self.settings, self.task.id, self.now)?;
        Ok(result)
    }

    /// Whether somebody else holds the task, or it wants no more answers.
    fn taken(&self, tx: &mut dyn Tx) -> Result<bool, Error> {
        let others = tx.number(
            "SELECT COUNT(*) FROM lease WHERE task = ?1 AND usr <> ?2",
            params![self.task.id, self.user],
        )?;
        let free = tx.number(
            "SELECT claimable FROM task WHERE id = ?1",
            params![self.task.id],
        )?;
        Ok(others > 0 && free == 0)
    }

    /// Checks that the suggestions an answer names belong to its task.
    fn check_suggestions(&self, tx: &mut dyn Tx, answer: &Answer) -> Result<(), Error> {
        for (_, suggestion) in answer.texts() {
            if let Some(id) = suggestion {
                self.check_suggestion(tx, id)?;
            }
        }
        Ok(())
    }

    fn check_suggestion(&self, tx: &mut dyn Tx, id: i64) -> Result<(), Error> {
        let found = tx.one(
            "SELECT 1 FROM suggestion WHERE id = ?1 AND task = ?2",
            params![id, self.task.id],
        )?;
        match found {
            Some(_) => Ok(()),
            None => Err(Error::invalid(
                "suggestion",
                format!("suggestion {id} does not belong to this task"),
            )),
        }
    }

    fn skip(
        &self,
        tx: &mut dyn Tx,
        event: &NewEvent,
        key: String,
        request: String,
    ) -> Result<EventResult, Error> {
        let postponed = event.kind == EventKind::Postpone;
        if !postponed && event.reason.is_none() {
            return Err(Error::invalid(
                "reason",
                "choose a reason for skipping the task",
            ));
        }
        let held = rows::lease_of(tx, self.task.id, self.user)?
            .filter(|held| {
                held.purpose == Purpose::Annotate && held.lease.epoch == event.lease_epoch
            })
            .ok_or_else(|| {
                Error::refused(
                    Code::LeaseLost,
                    "your lease on this task expired; there is nothing to skip",
                )
            })?;
        let body = Body::Skipped {
            postponed,
            reason: event.reason.filter(|_| !postponed),
            note: event.note.trim().to_owned(),
            secs: working(event.secs),
            request,
        };
        self.log(
            tx,
            &self.entry(Some(held.lease.epoch), body),
            event,
            key,
            None,
        )
    }

    fn undo(
        &self,
        tx: &mut dyn Tx,
        event: &NewEvent,
        key: String,
        request: String,
        mine: Option<Revision>,
    ) -> Result<EventResult, Error> {
        let handed_in = mine
            .filter(|mine| !matches!(mine.state, RevisionState::Draft | RevisionState::Returned));
        let Some(mine) = handed_in else {
            return Err(Error::wrong_state(
                self.task.state,
                "taken back: you have no answer waiting for review",
            ));
        };
        let mut state = self.task.state;
        // No person has decided yet: the rule's acceptance goes first.
        if let Some((rule, at)) = rules::accepted_by_rule(tx, self.task.id)?
            && self.now - at <= take_back_window(&self.settings)
        {
            let comment = "taken back by its author";
            rules::reopen(tx, Some(self.user), self.task.id, &rule, comment, self.now)?;
            state = TaskState::Submitted;
        }
        apply::check_move(state, LogKind::Undone, "taken back")?;
        let epoch = 1 + tx.number(
            "SELECT epoch FROM task WHERE id = ?1",
            params![self.task.id],
        )?;
        let body = Body::Undone {
            rev: mine.rev + 1,
            expires: lease_end(&self.settings, self.now),
            request,
        };
        self.log(tx, &self.entry(Some(epoch), body), event, key, None)
    }

    fn suggestion_used(
        &self,
        tx: &mut dyn Tx,
        event: &NewEvent,
        key: String,
        request: String,
    ) -> Result<EventResult, Error> {
        let (Some(suggestion), Some(used)) = (event.suggestion, event.used) else {
            return Err(Error::invalid(
                "suggestion",
                "the suggestion, or what became of it, is missing",
            ));
        };
        self.check_suggestion(tx, suggestion)?;
        let body = Body::SuggestionUsed {
            suggestion,
            used,
            request,
        };
        self.log(
            tx,
            &self.entry(Some(event.lease_epoch), body),
            event,
            key,
            None,
        )
    }
}

/// How long an author may take back an answer that a rule accepted, in milliseconds.
pub(super) fn take_back_window(settings: &Settings) -> Millis {
    Millis::from(settings.take_back_minutes) * MINUTE
}

/// Submitted answers to a task, except those of one author.
fn handed_in(tx: &mut dyn Tx, task: i64, but: i64) -> Result<Vec<Answer>, Error> {
    tx.query(
        "SELECT answer FROM revision WHERE task = ?1 AND author <> ?2
           AND state IN ('submitted', 'accepted', 'superseded') ORDER BY author",
        params![task, but],
    )?
    .iter()
    .map(|row| row.json(0))
    .collect()
}
