//! The log: its entries, and how each changes the projections.

use serde::{Deserialize, Serialize};

use super::db::{Row, Tx, params};
use super::records::{Millis, TaskRecord};
use crate::Error;
use crate::state::{LogKind, Purpose, ReleaseReason, targets};
use crate::wire::{
    Answer, EditType, Lease, Revision, RevisionState, Role, Settings, SkipReason, SuggestionUse,
    TaskKind, TaskState,
};

/// Version of the entries' bodies.
const VERSION: i64 = 1;
/// Leases one entry can make: ids of leases are the entry's place times this, and a number.
const LEASES_PER_ENTRY: i64 = 100;

/// A task as the log keeps it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct LoggedTask {
    pub(crate) key: String,
    pub(crate) kind: TaskKind,
    pub(crate) source: String,
    pub(crate) target: Option<String>,
    pub(crate) split: String,
    pub(crate) bundle: Option<i64>,
    pub(crate) bundle_index: i64,
    pub(crate) category: Option<String>,
    pub(crate) hint: Option<String>,
    pub(crate) style: Option<String>,
    pub(crate) priority: i64,
    pub(crate) shuffle: i64,
    pub(crate) wanted: u32,
    pub(crate) gold: Option<Answer>,
    pub(crate) extra: Option<serde_json::Value>,
    pub(crate) accepted: Option<Answer>,
}

/// What an entry says. `request` is a hash of what was asked, by which a key used again is known to
/// be the same request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(crate) enum Body {
    Imported {
        task: Box<LoggedTask>,
    },
    Claimed {
        purpose: Purpose,
        expires: Millis,
        blind: bool,
    },
    Renewed {
        lease: i64,
        expires: Millis,
    },
    Released {
        lease: i64,
        user: i64,
        purpose: Purpose,
        reason: ReleaseReason,
    },
    DraftSaved {
        answer: Answer,
        rev: i64,
        secs: f64,
        /// Why it became no revision, if so.
        kept_aside: Option<String>,
        request: String,
    },
    Submitted {
        answer: Answer,
        rev: i64,
        secs: f64,
        distance: Option<f64>,
        request: String,
    },
    Skipped {
        postponed: bool,
        reason: Option<SkipReason>,
        note: String,
        request: String,
    },
    Returned {
        authors: Vec<i64>,
        comment: String,
        until: Millis,
        request: String,
    },
    Accepted {
        author: i64,
        comment: String,
        request: String,
    },
    Merged {
        answer: Answer,
        comment: String,
        request: String,
    },
    Dropped {
        comment: String,
        request: String,
    },
    Reopened {
        comment: String,
        request: String,
    },
    Undone {
        rev: i64,
        expires: Millis,
        request: String,
    },
    SuggestionUsed {
        suggestion: i64,
        used: SuggestionUse,
        request: String,
    },
    GoldScored {
        score: f64,
    },
    RoleChanged {
        user: i64,
        name: String,
        role: Role,
        active: bool,
    },
    SettingsChanged {
        settings: Box<Settings>,
    },
    Exported {
        export: serde_json::Value,
    },
}

impl Body {
    pub(crate) fn kind(&self) -> LogKind {
        match self {
            Self::Imported { .. } => LogKind::Imported,
            Self::Claimed { .. } => LogKind::Claimed,
            Self::Renewed { .. } => LogKind::Renewed,
            Self::Released { .. } => LogKind::Released,
            Self::DraftSaved { .. } => LogKind::DraftSaved,
            Self::Submitted { .. } => LogKind::Submitted,
            Self::Skipped { .. } => LogKind::Skipped,
            Self::Returned { .. } => LogKind::Returned,
            Self::Accepted { .. } => LogKind::Accepted,
            Self::Merged { .. } => LogKind::Merged,
            Self::Dropped { .. } => LogKind::Dropped,
            Self::Reopened { .. } => LogKind::Reopened,
            Self::Undone { .. } => LogKind::Undone,
            Self::SuggestionUsed { .. } => LogKind::SuggestionUsed,
            Self::GoldScored { .. } => LogKind::GoldScored,
            Self::RoleChanged { .. } => LogKind::RoleChanged,
            Self::SettingsChanged { .. } => LogKind::SettingsChanged,
            Self::Exported { .. } => LogKind::Exported,
        }
    }

    /// The hash of the request that made it.
    pub(crate) fn request(&self) -> Option<&str> {
        match self {
            Self::DraftSaved { request, .. }
            | Self::Submitted { request, .. }
            | Self::Skipped { request, .. }
            | Self::Returned { request, .. }
            | Self::Accepted { request, .. }
            | Self::Merged { request, .. }
            | Self::Dropped { request, .. }
            | Self::Reopened { request, .. }
            | Self::Undone { request, .. }
            | Self::SuggestionUsed { request, .. } => Some(request),
            _ => None,
        }
    }
}

/// An entry of the log.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Entry {
    pub(crate) at: Millis,
    pub(crate) actor: Option<i64>,
    pub(crate) task: Option<i64>,
    pub(crate) epoch: Option<i64>,
    pub(crate) body: Body,
}

/// The key an entry answers to, and what is answered.
pub(crate) struct Reply {
    pub(crate) idem_key: String,
    pub(crate) base_rev: i64,
    pub(crate) result: String,
}

fn json<T: Serialize>(value: &T) -> Result<String, Error> {
    serde_json::to_string(value).map_err(|error| Error::Row {
        table: "event",
        problem: error.to_string(),
    })
}

/// Writes an entry and applies it, and gives its place. `reply` says what its sender is answered, and
/// sees the projections as they are then.
pub(crate) fn write(
    tx: &mut dyn Tx,
    entry: &Entry,
    reply: impl FnOnce(&mut dyn Tx, i64) -> Result<Option<Reply>, Error>,
) -> Result<i64, Error> {
    let seq = 1 + tx.number("SELECT COALESCE(MAX(seq), 0) FROM event", &[])?;
    apply(tx, seq, entry)?;
    let reply = reply(tx, seq)?;
    let (key, base_rev, result) = match reply {
        Some(reply) => (
            Some(reply.idem_key),
            Some(reply.base_rev),
            Some(reply.result),
        ),
        None => (None, None, None),
    };
    tx.execute(
        "INSERT INTO event (seq, at, actor, kind, task, idem_key, epoch, base_rev, body, result, version)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)",
        params![
            seq,
            entry.at,
            entry.actor,
            entry.body.kind().as_str(),
            entry.task,
            key,
            entry.epoch,
            base_rev,
            json(&entry.body)?,
            result,
            VERSION
        ],
    )?;
    Ok(seq)
}

/// Writes an entry nobody waits for.
pub(crate) fn note(tx: &mut dyn Tx, entry: &Entry) -> Result<i64, Error> {
    write(tx, entry, |_, _| Ok(None))
}

/// Columns of [`read_entry`].
pub(crate) const ENTRY_COLUMNS: &str = "seq, at, actor, task, epoch, body, version";

/// Reads an entry of [`ENTRY_COLUMNS`], with its place.
pub(crate) fn read_entry(row: &Row) -> Result<(i64, Entry), Error> {
    let seq = row.int(0)?;
    if row.int(6)? != VERSION {
        return Err(Error::Row {
            table: "event",
            problem: format!(
                "entry {seq} is of version {}, this program knows {VERSION}",
                row.int(6)?
            ),
        });
    }
    let body = serde_json::from_str(row.text(5)?).map_err(|error| Error::Row {
        table: "event",
        problem: format!("entry {seq}: {error}"),
    })?;
    let entry = Entry {
        at: row.int(1)?,
        actor: row.opt_int(2)?,
        task: row.opt_int(3)?,
        epoch: row.opt_int(4)?,
        body,
    };
    Ok((seq, entry))
}

/// Whether an entry is legal where the task stands.
pub(crate) fn check_move(state: TaskState, kind: LogKind, what: &str) -> Result<(), Error> {
    if targets(state, kind).is_empty() {
        return Err(Error::wrong_state(state, what));
    }
    Ok(())
}

/// Changes the projections as an entry says.
pub(crate) fn apply(tx: &mut dyn Tx, seq: i64, entry: &Entry) -> Result<(), Error> {
    if let Body::Imported { task } = &entry.body {
        return import(tx, seq, entry, task);
    }
    let Some(task) = entry.task else {
        return Ok(());
    };
    let before = state_of(tx, task)?;
    let kind = entry.body.kind();
    change(tx, seq, entry, task)?;
    let after = state_of(tx, task)?;
    if targets(before, kind).contains(&after) {
        return Ok(());
    }
    Err(Error::Row {
        table: "task",
        problem: format!(
            "entry {seq} ({kind}) would move task {task} from {before} to {after}, which is no legal move"
        ),
    })
}

fn state_of(tx: &mut dyn Tx, task: i64) -> Result<TaskState, Error> {
    let row = tx.one("SELECT state FROM task WHERE id = ?1", params![task])?;
    state(row.ok_or_else(|| Error::not_found("task"))?.text(0)?)
}

pub(crate) fn state(text: &str) -> Result<TaskState, Error> {
    TaskState::parse(text).ok_or_else(|| Error::Row {
        table: "task",
        problem: format!("state {text:?} is not known"),
    })
}

fn import(tx: &mut dyn Tx, seq: i64, entry: &Entry, task: &LoggedTask) -> Result<(), Error> {
    let id = entry.task.ok_or_else(|| Error::Row {
        table: "event",
        problem: format!("entry {seq} imports no task"),
    })?;
    let state = if task.accepted.is_some() {
        TaskState::Accepted
    } else {
        TaskState::Open
    };
    let claimable = task.accepted.is_none() && task.gold.is_none();
    tx.execute(
        "INSERT INTO task (id, key, kind, source, target, split, bundle, bundle_index, category, hint, style,
           priority, shuffle, wanted, gold, extra, state, submitted, leases, epoch, claimable, came_back, distance)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, 0, 0, 0, ?18, 0, NULL)",
        params![
            id,
            &task.key,
            task.kind.as_str(),
            &task.source,
            task.target.clone(),
            &task.split,
            task.bundle,
            task.bundle_index,
            task.category.clone(),
            task.hint.clone(),
            task.style.clone(),
            task.priority,
            task.shuffle,
            task.wanted,
            task.gold.as_ref().map(json).transpose()?,
            task.extra.as_ref().map(json).transpose()?,
            state.as_str(),
            claimable
        ],
    )?;
    if let Some(answer) = &task.accepted {
        let actor = entry.actor.unwrap_or(0);
        tx.execute(
            "INSERT INTO accepted (task, author, reviewer, answer, merged, at, seq) VALUES (?1, ?2, ?2, ?3, 0, ?4, ?5)",
            params![id, actor, json(answer)?, entry.at, seq],
        )?;
    }
    Ok(())
}

/// A lease to be made.
struct NewLease {
    id: i64,
    task: i64,
    user: i64,
    epoch: i64,
    expires: Millis,
    purpose: Purpose,
    blind: bool,
}

fn put_lease(tx: &mut dyn Tx, lease: &NewLease) -> Result<(), Error> {
    end_lease_of(tx, lease.task, lease.user)?;
    tx.execute(
        "INSERT INTO lease (id, task, usr, epoch, expires, purpose, blind) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        params![
            lease.id,
            lease.task,
            lease.user,
            lease.epoch,
            lease.expires,
            lease.purpose.as_str(),
            lease.blind
        ],
    )?;
    tx.execute(
        "UPDATE task SET epoch = ?2 WHERE id = ?1",
        params![lease.task, lease.epoch],
    )?;
    Ok(())
}

fn end_lease_of(tx: &mut dyn Tx, task: i64, user: i64) -> Result<(), Error> {
    tx.execute(
        "DELETE FROM lease WHERE task = ?1 AND usr = ?2",
        params![task, user],
    )?;
    Ok(())
}

fn end_leases(tx: &mut dyn Tx, task: i64) -> Result<(), Error> {
    tx.execute("DELETE FROM lease WHERE task = ?1", params![task])?;
    Ok(())
}

/// Id of the lease an entry makes.
pub(crate) fn lease_id(seq: i64, number: usize) -> i64 {
    seq * LEASES_PER_ENTRY + number as i64
}

fn change(tx: &mut dyn Tx, seq: i64, entry: &Entry, task: i64) -> Result<(), Error> {
    let actor = entry.actor.unwrap_or(0);
    match &entry.body {
        Body::Claimed {
            purpose,
            expires,
            blind,
        } => {
            put_lease(
                tx,
                &NewLease {
                    id: lease_id(seq, 0),
                    task,
                    user: actor,
                    epoch: entry.epoch.unwrap_or(0),
                    expires: *expires,
                    purpose: *purpose,
                    blind: *blind,
                },
            )?;
            match purpose {
                Purpose::Review => set_state(tx, task, TaskState::InReview),
                Purpose::Annotate | Purpose::Returned => refresh(tx, task),
            }
        }
        Body::Renewed { lease, expires } => {
            tx.execute(
                "UPDATE lease SET expires = ?2 WHERE id = ?1",
                params![*lease, *expires],
            )?;
            Ok(())
        }
        Body::Released { lease, purpose, .. } => {
            tx.execute("DELETE FROM lease WHERE id = ?1", params![*lease])?;
            match purpose {
                Purpose::Review => set_state(tx, task, TaskState::Submitted),
                Purpose::Annotate | Purpose::Returned => refresh(tx, task),
            }
        }
        Body::DraftSaved {
            answer,
            rev,
            secs,
            kept_aside,
            ..
        } => {
            if kept_aside.is_some() {
                return Ok(());
            }
            put_revision(tx, entry, task, RevisionState::Draft, answer, *rev, *secs)
        }
        Body::Submitted {
            answer,
            rev,
            secs,
            distance,
            ..
        } => {
            put_revision(
                tx,
                entry,
                task,
                RevisionState::Submitted,
                answer,
                *rev,
                *secs,
            )?;
            end_lease_of(tx, task, actor)?;
            tx.execute(
                "DELETE FROM skip WHERE task = ?1 AND usr = ?2",
                params![task, actor],
            )?;
            tx.execute(
                "UPDATE task SET distance = ?2 WHERE id = ?1",
                params![task, *distance],
            )?;
            refresh(tx, task)
        }
        Body::Skipped {
            postponed,
            reason,
            note,
            ..
        } => {
            end_lease_of(tx, task, actor)?;
            tx.execute(
                "INSERT INTO skip (task, usr, postponed, reason, note, at) VALUES (?1, ?2, ?3, ?4, ?5, ?6)
                 ON CONFLICT (task, usr) DO UPDATE SET postponed = excluded.postponed,
                   reason = excluded.reason, note = excluded.note, at = excluded.at",
                params![task, actor, *postponed, reason.map(SkipReason::as_str), note, entry.at],
            )?;
            refresh(tx, task)
        }
        Body::Returned {
            authors,
            comment,
            until,
            ..
        } => {
            end_leases(tx, task)?;
            let epoch = tx.number("SELECT epoch FROM task WHERE id = ?1", params![task])?;
            for (number, &author) in authors.iter().enumerate() {
                tx.execute(
                    "UPDATE revision SET state = 'returned' WHERE task = ?1 AND author = ?2",
                    params![task, author],
                )?;
                put_lease(
                    tx,
                    &NewLease {
                        id: lease_id(seq, number),
                        task,
                        user: author,
                        epoch: epoch + 1 + number as i64,
                        expires: *until,
                        purpose: Purpose::Returned,
                        blind: false,
                    },
                )?;
            }
            tx.execute("UPDATE task SET came_back = 1 WHERE id = ?1", params![task])?;
            let author = (authors.len() == 1).then(|| authors[0]);
            put_review(tx, seq, entry, task, author, comment)?;
            refresh(tx, task)
        }
        Body::Accepted {
            author, comment, ..
        } => {
            tx.execute(
                "UPDATE revision SET state = CASE WHEN author = ?2 THEN 'accepted' ELSE 'superseded' END
                 WHERE task = ?1 AND state = 'submitted'",
                params![task, *author],
            )?;
            tx.execute(
                "INSERT INTO accepted (task, author, reviewer, answer, merged, at, seq)
                 SELECT task, author, CAST(?3 AS BIGINT), answer, 0, CAST(?4 AS BIGINT), CAST(?5 AS BIGINT) FROM revision WHERE task = ?1 AND author = ?2",
                params![task, *author, actor, entry.at, seq],
            )?;
            end_leases(tx, task)?;
            put_review(tx, seq, entry, task, Some(*author), comment)?;
            set_state(tx, task, TaskState::Accepted)
        }
        Body::Merged {
            answer, comment, ..
        } => {
            tx.execute(
                "UPDATE revision SET state = 'superseded' WHERE task = ?1 AND state = 'submitted'",
                params![task],
            )?;
            tx.execute(
                "INSERT INTO accepted (task, author, reviewer, answer, merged, at, seq) VALUES (?1, ?2, ?2, ?3, 1, ?4, ?5)",
                params![task, actor, json(answer)?, entry.at, seq],
            )?;
            end_leases(tx, task)?;
            put_review(tx, seq, entry, task, None, comment)?;
            set_state(tx, task, TaskState::Accepted)
        }
        Body::Dropped { comment, .. } => {
            end_leases(tx, task)?;
            put_review(tx, seq, entry, task, None, comment)?;
            set_state(tx, task, TaskState::Dropped)
        }
        Body::Reopened { comment, .. } => {
            tx.execute("DELETE FROM accepted WHERE task = ?1", params![task])?;
            tx.execute(
                "UPDATE revision SET state = 'submitted' WHERE task = ?1 AND state IN ('accepted', 'superseded')",
                params![task],
            )?;
            put_review(tx, seq, entry, task, None, comment)?;
            refresh(tx, task)
        }
        Body::Undone { rev, expires, .. } => {
            tx.execute(
                "UPDATE revision SET state = 'draft', rev = ?3, at = ?4 WHERE task = ?1 AND author = ?2",
                params![task, actor, *rev, entry.at],
            )?;
            let blind = tx.number(
                "SELECT blind FROM revision WHERE task = ?1 AND author = ?2",
                params![task, actor],
            )?;
            put_lease(
                tx,
                &NewLease {
                    id: lease_id(seq, 0),
                    task,
                    user: actor,
                    epoch: entry.epoch.unwrap_or(0),
                    expires: *expires,
                    purpose: Purpose::Annotate,
                    blind: blind != 0,
                },
            )?;
            tx.execute(
                "DELETE FROM gold_score WHERE task = ?1 AND usr = ?2",
                params![task, actor],
            )?;
            refresh(tx, task)
        }
        Body::SuggestionUsed {
            suggestion, used, ..
        } => {
            tx.execute(
                "INSERT INTO suggestion_use (seq, task, usr, suggestion, used) VALUES (?1, ?2, ?3, ?4, ?5)",
                params![seq, task, actor, *suggestion, used.as_str()],
            )?;
            Ok(())
        }
        Body::GoldScored { score } => {
            tx.execute(
                "INSERT INTO gold_score (task, usr, score, at) VALUES (?1, ?2, ?3, ?4)
                 ON CONFLICT (task, usr) DO UPDATE SET score = excluded.score, at = excluded.at",
                params![task, actor, *score, entry.at],
            )?;
            Ok(())
        }
        Body::Imported { .. }
        | Body::RoleChanged { .. }
        | Body::SettingsChanged { .. }
        | Body::Exported { .. } => Ok(()),
    }
}

fn put_review(
    tx: &mut dyn Tx,
    seq: i64,
    entry: &Entry,
    task: i64,
    author: Option<i64>,
    comment: &str,
) -> Result<(), Error> {
    tx.execute(
        "INSERT INTO review (seq, task, reviewer, decision, author, comment, at) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        params![
            seq,
            task,
            entry.actor.unwrap_or(0),
            entry.body.kind().as_str(),
            author,
            comment,
            entry.at
        ],
    )?;
    Ok(())
}

fn put_revision(
    tx: &mut dyn Tx,
    entry: &Entry,
    task: i64,
    state: RevisionState,
    answer: &Answer,
    rev: i64,
    secs: f64,
) -> Result<(), Error> {
    let actor = entry.actor.unwrap_or(0);
    let edit_type = match answer {
        Answer::Pair { edit_type, .. } => *edit_type,
        Answer::MaskText { .. } | Answer::Style { .. } => None,
    };
    let blind = tx.number(
        "SELECT blind FROM lease WHERE task = ?1 AND usr = ?2",
        params![task, actor],
    )?;
    tx.execute(
        "INSERT INTO revision (task, author, rev, state, answer, at, secs, blind, verdict, edit_type)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)
         ON CONFLICT (task, author) DO UPDATE SET rev = excluded.rev, state = excluded.state,
           answer = excluded.answer, at = excluded.at, secs = revision.secs + excluded.secs,
           blind = CASE WHEN excluded.blind = 1 THEN 1 ELSE revision.blind END,
           verdict = excluded.verdict, edit_type = excluded.edit_type",
        params![
            task,
            actor,
            rev,
            state.as_str(),
            json(answer)?,
            entry.at,
            secs,
            blind,
            answer.verdict().map(crate::wire::Verdict::as_str),
            edit_type.map(EditType::as_str)
        ],
    )?;
    Ok(())
}

fn set_state(tx: &mut dyn Tx, task: i64, state: TaskState) -> Result<(), Error> {
    tx.execute(
        "UPDATE task SET state = ?2, claimable = 0,
           leases = (SELECT COUNT(*) FROM lease WHERE task = ?1 AND purpose <> 'review') WHERE id = ?1",
        params![task, state.as_str()],
    )?;
    Ok(())
}

/// Counts answers and leases of a task that is not decided, and sets its state by them.
fn refresh(tx: &mut dyn Tx, task: i64) -> Result<(), Error> {
    let row = tx
        .one(
            "SELECT wanted, CASE WHEN gold IS NULL THEN 0 ELSE 1 END,
               (SELECT COUNT(*) FROM revision WHERE task = ?1 AND state IN ('submitted', 'accepted', 'superseded')),
               (SELECT COUNT(*) FROM lease WHERE task = ?1 AND purpose = 'annotate'),
               (SELECT COUNT(*) FROM lease WHERE task = ?1 AND purpose = 'returned')
             FROM task WHERE id = ?1",
            params![task],
        )?
        .ok_or_else(|| Error::not_found("task"))?;
    let (wanted, gold) = (row.int(0)?, row.flag(1)?);
    let (submitted, active, kept) = (row.int(2)?, row.int(3)?, row.int(4)?);
    let state = if submitted >= wanted {
        TaskState::Submitted
    } else if active > 0 {
        TaskState::Leased
    } else if kept > 0 {
        TaskState::Returned
    } else {
        TaskState::Open
    };
    let claimable = !gold && submitted + active + kept < wanted;
    tx.execute(
        "UPDATE task SET state = ?2, submitted = ?3, leases = ?4, claimable = ?5 WHERE id = ?1",
        params![task, state.as_str(), submitted, active + kept, claimable],
    )?;
    Ok(())
}

/// Columns of [`read_task`].
pub(crate) const TASK_COLUMNS: &str = "t.id, t.key, t.kind, t.source, t.target, t.split, t.bundle, t.bundle_index,
  t.category, t.hint, t.style, t.wanted, t.gold, t.extra, t.state, t.submitted, t.shuffle, t.distance";
/// How many they are.
pub(crate) const NUM_TASK_COLUMNS: usize = 18;

/// Reads a task of [`TASK_COLUMNS`].
pub(crate) fn read_task(row: &Row) -> Result<TaskRecord, Error> {
    let optional = |column: usize| -> Result<Option<String>, Error> { row.opt_text(column) };
    let unknown = |problem: String| Error::Row {
        table: "task",
        problem,
    };
    let gold = optional(12)?
        .map(|text| serde_json::from_str(&text))
        .transpose()
        .map_err(|error| unknown(error.to_string()))?;
    let extra = optional(13)?
        .map(|text| serde_json::from_str(&text))
        .transpose()
        .map_err(|error| unknown(error.to_string()))?;
    Ok(TaskRecord {
        id: row.int(0)?,
        key: row.string(1)?,
        kind: task_kind(row.text(2)?)?,
        source: row.string(3)?,
        target: optional(4)?,
        split: row.string(5)?,
        bundle: row.opt_int(6)?,
        bundle_index: row.int(7)?,
        category: optional(8)?,
        hint: optional(9)?,
        style: optional(10)?,
        wanted: row.count(11)?,
        gold,
        extra,
        state: state(row.text(14)?)?,
        submitted: row.count(15)?,
        shuffle: row.int(16)?,
        distance: row.opt_real(17)?,
    })
}

pub(crate) fn task_kind(text: &str) -> Result<TaskKind, Error> {
    TaskKind::parse(text).ok_or_else(|| Error::Row {
        table: "task",
        problem: format!("kind {text:?} is not known"),
    })
}

/// The task with this id.
pub(crate) fn task(tx: &mut dyn Tx, id: i64) -> Result<TaskRecord, Error> {
    let sql = format!("SELECT {TASK_COLUMNS} FROM task t WHERE t.id = ?1");
    let row = tx.one(&sql, params![id])?;
    read_task(&row.ok_or_else(|| Error::not_found("task"))?)
}

/// Columns of [`read_revision`].
pub(crate) const REVISION_COLUMNS: &str =
    "r.task, r.author, r.rev, r.state, r.answer, r.at, r.secs";

/// Reads a revision of [`REVISION_COLUMNS`], which begin at a column.
pub(crate) fn read_revision(row: &Row, from: usize) -> Result<Revision, Error> {
    Ok(Revision {
        task: row.int(from)?,
        author: row.int(from + 1)?,
        rev: row.int(from + 2)?,
        state: revision_state(row.text(from + 3)?)?,
        answer: row.json(from + 4)?,
        at: row.int(from + 5)?,
        secs: row.real(from + 6)?,
    })
}

pub(crate) fn revision_state(text: &str) -> Result<RevisionState, Error> {
    RevisionState::parse(text).ok_or_else(|| Error::Row {
        table: "revision",
        problem: format!("state {text:?} is not known"),
    })
}

/// Somebody's answer to a task.
pub(crate) fn revision(tx: &mut dyn Tx, task: i64, author: i64) -> Result<Option<Revision>, Error> {
    let sql =
        format!("SELECT {REVISION_COLUMNS} FROM revision r WHERE r.task = ?1 AND r.author = ?2");
    tx.one(&sql, params![task, author])?
        .map(|row| read_revision(&row, 0))
        .transpose()
}

/// A lease, and what it is for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LeaseRow {
    pub(crate) lease: Lease,
    pub(crate) purpose: Purpose,
    pub(crate) blind: bool,
}

/// Columns of [`read_lease`].
pub(crate) const LEASE_COLUMNS: &str =
    "l.id, l.task, l.usr, l.epoch, l.expires, l.purpose, l.blind";

/// Reads a lease of [`LEASE_COLUMNS`].
pub(crate) fn read_lease(row: &Row) -> Result<LeaseRow, Error> {
    Ok(LeaseRow {
        lease: Lease {
            id: row.int(0)?,
            task: row.int(1)?,
            user: row.int(2)?,
            epoch: row.int(3)?,
            expires: row.int(4)?,
        },
        purpose: Purpose::parse(row.text(5)?).ok_or_else(|| Error::Row {
            table: "lease",
            problem: format!("purpose {:?} is not known", row.text(5)),
        })?,
        blind: row.flag(6)?,
    })
}

/// Somebody's lease on a task.
pub(crate) fn lease_of(tx: &mut dyn Tx, task: i64, user: i64) -> Result<Option<LeaseRow>, Error> {
    let sql = format!("SELECT {LEASE_COLUMNS} FROM lease l WHERE l.task = ?1 AND l.usr = ?2");
    tx.one(&sql, params![task, user])?
        .map(|row| read_lease(&row))
        .transpose()
}

/// The lease of this id.
pub(crate) fn lease(tx: &mut dyn Tx, id: i64) -> Result<Option<LeaseRow>, Error> {
    let sql = format!("SELECT {LEASE_COLUMNS} FROM lease l WHERE l.id = ?1");
    tx.one(&sql, params![id])?
        .map(|row| read_lease(&row))
        .transpose()
}

/// The projections and the columns they are ordered by.
const PROJECTIONS: [(&str, &str); 8] = [
    ("task", "id"),
    ("lease", "id"),
    ("revision", "task, author"),
    ("review", "seq"),
    ("accepted", "task"),
    ("skip", "task, usr"),
    ("suggestion_use", "seq"),
    ("gold_score", "task, usr"),
];

/// Entries read at a time.
const BATCH: i64 = 1000;

/// Makes the projections again and gives the names of those that differ from before.
pub(crate) fn rebuild(tx: &mut dyn Tx) -> Result<Vec<&'static str>, Error> {
    let before = digests(tx)?;
    for (table, _) in PROJECTIONS {
        tx.execute(&format!("DELETE FROM {table}"), &[])?;
    }
    let sql = format!("SELECT {ENTRY_COLUMNS} FROM event WHERE seq > ?1 ORDER BY seq LIMIT ?2");
    let mut last = 0;
    loop {
        let rows = tx.query(&sql, params![last, BATCH])?;
        if rows.is_empty() {
            break;
        }
        for row in rows {
            let (seq, entry) = read_entry(&row)?;
            apply(tx, seq, &entry)?;
            last = seq;
        }
    }
    let after = digests(tx)?;
    Ok(PROJECTIONS
        .iter()
        .zip(before.iter().zip(&after))
        .filter(|(_, (before, after))| before != after)
        .map(|((table, _), _)| *table)
        .collect())
}

/// A hash of each projection.
fn digests(tx: &mut dyn Tx) -> Result<Vec<blake3::Hash>, Error> {
    const ROWS: i64 = 5000;
    let mut digests = Vec::new();
    for (table, order) in PROJECTIONS {
        let mut hasher = blake3::Hasher::new();
        let mut offset = 0;
        loop {
            let sql = format!("SELECT * FROM {table} ORDER BY {order} LIMIT ?1 OFFSET ?2");
            let rows = tx.query(&sql, params![ROWS, offset])?;
            for row in &rows {
                hasher.update(format!("{row:?}\n").as_bytes());
            }
            if (rows.len() as i64) < ROWS {
                break;
            }
            offset += ROWS;
        }
        digests.push(hasher.finalize());
    }
    Ok(digests)
}

/// What is wrong with the log and the projections; the projections are made again on the way.
pub(crate) fn verify(tx: &mut dyn Tx) -> Result<Vec<String>, Error> {
    let mut findings = Vec::new();
    let row = tx.one("SELECT COUNT(*), COALESCE(MAX(seq), 0) FROM event", &[])?;
    if let Some(row) = row
        && row.int(0)? != row.int(1)?
    {
        findings.push(format!(
            "the log has {} entries and ends at place {}",
            row.int(0)?,
            row.int(1)?
        ));
    }
    let over = tx.number(
        "SELECT COUNT(*) FROM task WHERE submitted + leases > wanted",
        &[],
    )?;
    if over > 0 {
        findings.push(format!(
            "{over} tasks have more answers and leases than they want"
        ));
    }
    findings.extend(
        rebuild(tx)?
            .into_iter()
            .map(|table| format!("table {table} does not follow from the log")),
    );
    Ok(findings)
}
