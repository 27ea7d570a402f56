//! Actions on all tasks of a filter.

use serde::Deserialize;

use super::db::{Result, Tx, params};
use super::entry::Body;
use super::filter::{self, Values, condition};
use super::leases::Turn;
use super::records::{Millis, TaskRecord, Who};
use super::store::Store;
use super::{leases, log, project, review, rows, rules};
use crate::answer;
use crate::error::{Error, require};
use crate::state::{LogKind, targets};
use crate::wire::{BulkAction, BulkDone, BulkRequest};

/// Maximum number of tasks that one bulk request checks.
const BULK_AT_ONCE: i64 = 2000;

impl Store {
    /// Counts what a bulk action would change. Refused with `invalid`.
    pub fn preview_bulk(&self, who: &Who, request: BulkRequest, now: Millis) -> Result<BulkDone> {
        self.read(|tx| bulk(tx, who.id, &request, false, now))
    }

    /// Acts on up to 2,000 tasks of a filter. Refused with `invalid`.
    pub fn bulk(&self, who: &Who, request: BulkRequest, now: Millis) -> Result<BulkDone> {
        let who = who.id;
        self.write(move |tx| bulk(tx, who, &request, true, now))
    }
}

/// Checks a bulk request. A preview needs no comment.
fn check_bulk(tx: &mut dyn Tx, request: &BulkRequest, act: bool) -> Result<()> {
    filter::check(&request.filter)?;
    let needs_comment = matches!(
        request.action,
        BulkAction::Return | BulkAction::Drop | BulkAction::Reopen
    );
    review::comment(&request.comment, act && needs_comment, "authors")?;
    match (request.action, request.person) {
        (BulkAction::Assign, None) => {
            let problem = "name the person to give the tasks to";
            Err(Error::invalid("person", problem))
        }
        (BulkAction::Assign, Some(person)) => {
            let active = "SELECT 1 FROM usr WHERE id = ?1 AND active = 1";
            let problem = format!("there is no active user {person}");
            require(tx.has(active, params![person])?, "person", problem)
        }
        (_, person) => {
            let problem = "only the action assign has a person";
            require(person.is_none(), "person", problem)
        }
    }
}

/// Plans an action on the tasks of a filter. With `act`, applies it to up to [`BULK_AT_ONCE`] of them; otherwise only
/// counts what it would change, among all of them.
fn bulk(
    tx: &mut dyn Tx,
    who: i64,
    request: &BulkRequest,
    act: bool,
    now: Millis,
) -> Result<BulkDone> {
    check_bulk(tx, request, act)?;
    let turn = Turn::of(tx, who, now)?;
    let mut values = Values::default();
    let place = condition(&request.filter, &mut values);
    let after = values.put(request.after.unwrap_or(0));
    let limit = values.put(if act { BULK_AT_ONCE } else { i64::MAX });
    let me = values.put(who);
    let sql = format!(
        "SELECT {}, (SELECT COUNT(*) FROM lease l WHERE l.task = t.id AND l.purpose = 'review' AND l.usr <> {me}),
           (SELECT COUNT(*) FROM revision r WHERE r.task = t.id AND r.author = {me} AND r.state <> 'draft')
         FROM task t WHERE {place} AND t.id > {after} ORDER BY t.id LIMIT {limit}",
        rows::TASK
    );
    let found: Vec<One> = tx.list(&sql, &values.all())?;
    let mut done = BulkDone {
        looked_at: found.len() as i64,
        ..BulkDone::default()
    };
    for one in &found {
        match planned(tx, &turn, request, one)? {
            Ok(body) => {
                done.done += 1;
                if act {
                    log::note(tx, now, Some(who), Some(one.task.id), body)?;
                    leases::free_of_the_disabled(tx, &turn, one.task.id)?;
                }
            }
            Err(reason) => *done.left_alone.entry(reason.to_owned()).or_default() += 1,
        }
    }
    let last = found.last().map(|one| one.task.id);
    done.next = last.filter(|_| act && done.looked_at == BULK_AT_ONCE);
    Ok(done)
}

/// A task of a bulk action.
#[derive(Deserialize)]
struct One {
    task: TaskRecord,
    /// Whether another reviewer holds the task.
    held: bool,
    /// Whether the actor answered the task.
    own: bool,
}

/// The entry to write about a task, or why the task is skipped.
type Planned = Result<Body, &'static str>;

/// Decides what a bulk action does with a task.
fn planned(tx: &mut dyn Tx, turn: &Turn, request: &BulkRequest, one: &One) -> Result<Planned> {
    let One { task, held, own } = one;
    let comment = request.comment.trim().to_owned();
    let kind = match request.action {
        BulkAction::Accept => LogKind::Accepted,
        BulkAction::Return => LogKind::Returned,
        BulkAction::Drop => LogKind::Dropped,
        BulkAction::Reopen => LogKind::Reopened,
        BulkAction::Assign => LogKind::Assigned,
    };
    if targets(task.state, kind).is_empty() {
        return Ok(Err("wrong_state"));
    }
    if *held {
        return Ok(Err("held"));
    }
    if task.changed && request.action == BulkAction::Accept {
        return Ok(Err("clip_changed"));
    }
    if *own && !turn.settings.solo && request.action != BulkAction::Assign {
        return Ok(Err("own_work"));
    }
    let until = turn.until_returned();
    let body = match request.action {
        BulkAction::Accept => return accepted(tx, turn, one, comment),
        BulkAction::Return => {
            let answers = rules::waiting_answers(tx, task.id)?;
            Body::Returned {
                authors: answers.iter().map(|own| own.author).collect(),
                comment,
                until,
                secs: 0.0,
                request: String::new(),
            }
        }
        BulkAction::Drop => Body::Dropped {
            comment,
            secs: 0.0,
            request: String::new(),
        },
        BulkAction::Reopen => Body::Reopened {
            comment,
            request: String::new(),
            rule: None,
        },
        BulkAction::Assign => {
            let person = request.person.unwrap_or(0);
            return assigned(tx, task.id, person, until);
        }
    };
    Ok(Ok(body))
}

/// Plans the acceptance of the first answer if all answers agree.
fn accepted(tx: &mut dyn Tx, turn: &Turn, one: &One, comment: String) -> Result<Planned> {
    let answers = rules::waiting_answers(tx, one.task.id)?;
    let all: Vec<_> = answers.iter().map(|own| own.answer.clone()).collect();
    let frames = project::frames(tx, &one.task.source)?;
    let is_apart = answer::spread(&all, frames).is_some_and(|distance| distance > 0.0);
    // The distance does not compare texts, which may contradict each other.
    if is_apart || !answer::share_words(&all) {
        return Ok(Err("answers_differ"));
    }
    let Some(first) = answers.first() else {
        return Ok(Err("wrong_state"));
    };
    if first.answer.new_style(&turn.settings).is_some() {
        return Ok(Err("new_style"));
    }
    Ok(Ok(Body::Accepted {
        author: first.author,
        comment,
        secs: 0.0,
        request: String::new(),
        rule: None,
        own: one.own && first.author == turn.user,
    }))
}

/// Plans the reservation of a task for a person who neither holds nor answered it.
fn assigned(tx: &mut dyn Tx, task: i64, person: i64, until: Millis) -> Result<Planned> {
    let found = tx.find(
        "SELECT t.wanted - t.submitted - (SELECT COUNT(*) FROM lease l WHERE l.task = t.id AND l.purpose = 'annotate'),
                   (SELECT COUNT(*) FROM lease l WHERE l.task = t.id AND l.usr = ?2),
                   (SELECT COUNT(*) FROM revision r WHERE r.task = t.id AND r.author = ?2
                      AND r.state NOT IN ('draft', 'returned'))
                 FROM task t WHERE t.id = ?1",
        params![task, person],
    )?;
    let (room, held, answered): (i64, bool, bool) =
        found.ok_or_else(|| Error::not_found("task"))?;
    Ok(match (held, answered, room > 0) {
        (true, ..) => Err("held"),
        (_, true, _) => Err("answered"),
        (.., false) => Err("task_full"),
        _ => Ok(Body::Assigned {
            user: person,
            until,
        }),
    })
}
