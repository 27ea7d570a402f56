//! What is done to tasks: claiming, answering, reviewing.

use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::Serialize;

use super::db::{self, Database, Tx, params};
use super::log::{self, Body, Entry, LoggedTask, Reply};
use super::{
    AcceptedAnswer, AuditFilter, Claimed, Imported, IssuedToken, KeyRange, Label, Millis,
    MotionRecord, NewSuggestion, NewTask, PersonCounts, Reject, ReviewClaimed, ReviewDetail,
    ShelfFilter, Store, TaskDetail, TaskRecord, TokenUse, WeekCounts, Who, log_kind, people,
    project, read,
};
use crate::Error;
use crate::answer;
use crate::state::{LogKind, Purpose, ReleaseReason};
use crate::wire::{
    Answer, Audit, AuditEntry, Code, Decision, Empty, EventKind, EventResult, HeldLease, Home, Job,
    Lease, NewEvent, NewReview, Prefs, Problem, ReviewDone, ReviewEmpty, ReviewQueue, Revision,
    RevisionState, Role, Settings, Suggestion, TaskKind, TaskState, TokenInfo, User,
};

/// Answers a gold task takes: everybody's.
const GOLD_WANTED: u32 = 1_000_000;
/// Tasks imported in a transaction: few enough that others need not wait long.
const IMPORT_GROUP: usize = 500;
/// Expired leases ended in a claim.
const EXPIRED_AT_ONCE: i64 = 200;
const MINUTE: Millis = 60_000;
const DAY: Millis = 24 * 60 * MINUTE;
/// Longest time an event can say its author was at it.
const MAX_SECS: f64 = 3600.0;

/// A number that a key draws, the same for ever.
pub(crate) fn draw(parts: &[&str]) -> u64 {
    datasets_spec::Seed(0).draw_u64(parts)
}

fn percent(parts: &[&str]) -> u32 {
    (draw(parts) % 100) as u32
}

/// Conditions on a task `t` for somebody (`?2`) to be given it as new work.
const FOR_ME: &str = "t.claimable = 1
  AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?2 AND r.state <> 'draft')
  AND NOT EXISTS (SELECT 1 FROM lease l WHERE l.task = t.id AND l.usr = ?2)";

/// A store on a database that speaks SQL.
pub struct SqlStore {
    db: Box<dyn Database>,
    known: Mutex<people::Known>,
}

impl SqlStore {
    pub(crate) fn new(db: Box<dyn Database>) -> Self {
        Self {
            db,
            known: Mutex::default(),
        }
    }

    fn known(&self) -> MutexGuard<'_, people::Known> {
        // A panic elsewhere cannot have left it half-changed.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// [`Self::write`] of people or tokens, after which nothing is known of any.
    fn write_people<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let outcome = self.write(work);
        self.known().clear();
        outcome
    }

    fn write<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        db::write(self.db.as_ref(), work)
    }

    fn read<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        db::read(self.db.as_ref(), work)
    }
}

fn import(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    tasks: &[NewTask],
    now: Millis,
) -> Result<Imported, Error> {
    let settings = project::settings(tx)?;
    let mut done = Imported::default();
    let mut next = 1 + tx.number("SELECT COALESCE(MAX(id), 0) FROM task", &[])?;
    for task in tasks {
        if tx
            .one("SELECT 1 FROM task WHERE key = ?1", params![&task.key])?
            .is_some()
        {
            done.known += 1;
            continue;
        }
        put_task(tx, actor, next, task, &settings, now)?;
        done.new += 1;
        next += 1;
    }
    Ok(done)
}

fn put_task(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    id: i64,
    task: &NewTask,
    settings: &Settings,
    now: Millis,
) -> Result<(), Error> {
    // The tasks of a bundle go to the same people.
    let group = task.bundle.as_deref().unwrap_or(&task.key);
    let wanted = if task.gold.is_some() {
        GOLD_WANTED
    } else if percent(&["overlap", group]) < settings.overlap_percent {
        settings.answers_per_task
    } else {
        1
    };
    // Ids of bundles are numbers a browser holds exactly.
    let bundle = task
        .bundle
        .as_deref()
        .map(|name| (draw(&["bundle", name]) >> 12) as i64);
    let entry = Entry {
        at: now,
        actor,
        task: Some(id),
        epoch: None,
        body: Body::Imported {
            task: Box::new(LoggedTask {
                key: task.key.clone(),
                kind: task.kind,
                source: task.source.clone(),
                target: task.target.clone(),
                split: task.split.clone(),
                bundle,
                bundle_index: task.bundle_index,
                category: task.category.clone(),
                hint: task.hint.clone(),
                style: task.style.clone(),
                priority: task.priority,
                shuffle: percent(&["shuffle", &task.key]).into(),
                wanted,
                gold: task.gold.clone(),
                extra: task.extra.clone(),
                accepted: task.accepted.clone(),
            }),
        },
    };
    log::note(tx, &entry)?;
    for suggestion in &task.suggestions {
        project::put_suggestion(tx, id, suggestion, now)?;
    }
    Ok(())
}

/// Ends leases that ran out, those of `keep` apart: what nobody took away meanwhile, its holder may
/// still go on with.
fn expire(tx: &mut dyn Tx, keep: i64, now: Millis) -> Result<(), Error> {
    let sql = format!(
        "SELECT {} FROM lease l WHERE l.expires <= ?1 AND l.usr <> ?2 ORDER BY l.expires, l.id LIMIT ?3",
        log::LEASE_COLUMNS
    );
    for row in tx.query(&sql, params![now, keep, EXPIRED_AT_ONCE])? {
        let held = log::read_lease(&row)?;
        end(tx, &held, None, ReleaseReason::Expired, now)?;
    }
    Ok(())
}

fn end(
    tx: &mut dyn Tx,
    held: &log::LeaseRow,
    actor: Option<i64>,
    reason: ReleaseReason,
    now: Millis,
) -> Result<(), Error> {
    log::note(
        tx,
        &Entry {
            at: now,
            actor,
            task: Some(held.lease.task),
            epoch: Some(held.lease.epoch),
            body: Body::Released {
                lease: held.lease.id,
                user: held.lease.user,
                purpose: held.purpose,
                reason,
            },
        },
    )?;
    Ok(())
}

fn lease_end(settings: &Settings, now: Millis) -> Millis {
    now + Millis::from(settings.lease_minutes) * MINUTE
}

/// Takes a lease; that the task may be given is known.
fn take(
    tx: &mut dyn Tx,
    user: i64,
    task: i64,
    purpose: Purpose,
    settings: &Settings,
    now: Millis,
) -> Result<(), Error> {
    let row = tx
        .one("SELECT epoch, key FROM task WHERE id = ?1", params![task])?
        .ok_or_else(|| Error::not_found("task"))?;
    let blind = purpose == Purpose::Annotate
        && percent(&["blind", row.text(1)?, &user.to_string()]) < settings.blind_percent;
    log::note(
        tx,
        &Entry {
            at: now,
            actor: Some(user),
            task: Some(task),
            epoch: Some(row.int(0)? + 1),
            body: Body::Claimed {
                purpose,
                expires: lease_end(settings, now),
                blind,
            },
        },
    )?;
    Ok(())
}

fn prolong(
    tx: &mut dyn Tx,
    held: &log::LeaseRow,
    settings: &Settings,
    now: Millis,
) -> Result<Lease, Error> {
    let expires = lease_end(settings, now);
    log::note(
        tx,
        &Entry {
            at: now,
            actor: Some(held.lease.user),
            task: Some(held.lease.task),
            epoch: Some(held.lease.epoch),
            body: Body::Renewed {
                lease: held.lease.id,
                expires,
            },
        },
    )?;
    Ok(Lease {
        expires,
        ..held.lease.clone()
    })
}

/// [`prolong`], and the leases on the rest of its bundle with it: eight slow pairs take longer than one.
fn prolong_bundle(
    tx: &mut dyn Tx,
    held: &log::LeaseRow,
    settings: &Settings,
    now: Millis,
) -> Result<Lease, Error> {
    let sql = format!(
        "SELECT {} FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose = 'annotate' AND l.id <> ?2
           AND t.bundle = (SELECT bundle FROM task WHERE id = ?3) ORDER BY l.id",
        log::LEASE_COLUMNS
    );
    let rest = tx.query(
        &sql,
        params![held.lease.user, held.lease.id, held.lease.task],
    )?;
    for row in rest {
        prolong(tx, &log::read_lease(&row)?, settings, now)?;
    }
    prolong(tx, held, settings, now)
}

/// The task that somebody works on next, or why there is none.
fn claim(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
    now: Millis,
) -> Result<Result<i64, Empty>, Error> {
    expire(tx, user, now)?;
    let settings = project::settings(tx)?;
    let sql = format!(
        "SELECT {} FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose = 'annotate' AND t.kind = ?2
         ORDER BY t.bundle, t.bundle_index, l.id LIMIT 1",
        log::LEASE_COLUMNS
    );
    if let Some(row) = tx.one(&sql, params![user, kind.as_str()])? {
        let held = log::read_lease(&row)?;
        if held.lease.expires < lease_end(&settings, now) - MINUTE {
            prolong_bundle(tx, &held, &settings, now)?;
        }
        return Ok(Ok(held.lease.task));
    }
    let back = tx.one(
        "SELECT t.id FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose = 'returned' AND t.kind = ?2 ORDER BY l.id LIMIT 1",
        params![user, kind.as_str()],
    )?;
    if let Some(row) = back {
        let task = row.int(0)?;
        take(tx, user, task, Purpose::Annotate, &settings, now)?;
        return Ok(Ok(task));
    }
    if let Some(task) = gold_task(tx, user, kind, &settings)? {
        take(tx, user, task, Purpose::Annotate, &settings, now)?;
        return Ok(Ok(task));
    }
    let Some((first, bundle)) = candidate(tx, user, kind)? else {
        return Ok(Err(empty(tx, user, kind)?));
    };
    match bundle {
        None => take(tx, user, first, Purpose::Annotate, &settings, now)?,
        Some(bundle) => {
            let sql = format!(
                "SELECT t.id FROM task t WHERE t.bundle = ?1 AND {FOR_ME}
                   AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2 AND s.postponed = 0)
                 ORDER BY t.bundle_index, t.id"
            );
            for row in tx.query(&sql, params![bundle, user])? {
                take(tx, user, row.int(0)?, Purpose::Annotate, &settings, now)?;
            }
        }
    }
    Ok(Ok(first))
}

/// The next task for somebody and its bundle: a new one, or else one they postponed.
fn candidate(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
) -> Result<Option<(i64, Option<i64>)>, Error> {
    let fresh = format!(
        "SELECT t.id, t.bundle FROM task t WHERE t.kind = ?1 AND {FOR_ME}
           AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2)
         ORDER BY t.priority DESC, t.id LIMIT 1"
    );
    let postponed = format!(
        "SELECT t.id, t.bundle FROM skip s JOIN task t ON t.id = s.task
         WHERE t.kind = ?1 AND s.usr = ?2 AND s.postponed = 1 AND {FOR_ME}
         ORDER BY s.at, t.id LIMIT 1"
    );
    for sql in [fresh, postponed] {
        if let Some(row) = tx.one(&sql, params![kind.as_str(), user])? {
            return Ok(Some((row.int(0)?, row.opt_int(1)?)));
        }
    }
    Ok(None)
}

/// Hashes of the motions of the tasks that would follow.
fn upcoming(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
    limit: usize,
) -> Result<Vec<String>, Error> {
    let sql = format!(
        "SELECT t.source, t.target FROM task t WHERE t.kind = ?1 AND {FOR_ME}
           AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2)
         ORDER BY t.priority DESC, t.id LIMIT ?3"
    );
    let mut hashes = Vec::new();
    for row in tx.query(&sql, params![kind.as_str(), user, limit as i64])? {
        hashes.push(row.string(0)?);
        hashes.extend(row.opt_text(1)?);
    }
    Ok(hashes)
}

/// A gold task, if it is time for one: by a draw that depends on who and how many answers they gave.
fn gold_task(
    tx: &mut dyn Tx,
    user: i64,
    kind: TaskKind,
    settings: &Settings,
) -> Result<Option<i64>, Error> {
    if settings.gold_percent == 0 {
        return Ok(None);
    }
    let answers = tx.number(
        "SELECT COUNT(*) FROM revision WHERE author = ?1 AND state <> 'draft'",
        params![user],
    )?;
    let number = answers.to_string();
    if percent(&["gold", &user.to_string(), &number]) >= settings.gold_percent {
        return Ok(None);
    }
    let row = tx.one(
        "SELECT t.id FROM task t WHERE t.gold IS NOT NULL AND t.kind = ?1 AND t.state IN ('open', 'leased')
           AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?2 AND r.state <> 'draft')
           AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2)
         ORDER BY t.shuffle, t.id LIMIT 1",
        params![kind.as_str(), user],
    )?;
    row.map(|row| row.int(0)).transpose()
}

fn empty(tx: &mut dyn Tx, user: i64, kind: TaskKind) -> Result<Empty, Error> {
    let kind = kind.as_str();
    let mut empty = Empty::default();
    let counts = tx.query(
        "SELECT state, COUNT(*) FROM task WHERE kind = ?1 AND gold IS NULL GROUP BY state",
        params![kind],
    )?;
    for row in counts {
        let count = row.int(1)?;
        empty.total += count;
        match log::state(row.text(0)?)? {
            TaskState::Submitted | TaskState::InReview | TaskState::Accepted => empty.done += count,
            TaskState::Dropped => empty.dropped += count,
            TaskState::Open | TaskState::Leased | TaskState::Returned => {}
        }
    }
    empty.waiting_for_others = tx.number(
        "SELECT COUNT(*) FROM revision r JOIN task t ON t.id = r.task
         WHERE r.author = ?2 AND r.state <> 'draft' AND t.kind = ?1 AND t.gold IS NULL
           AND t.state IN ('open', 'leased', 'returned')",
        params![kind, user],
    )?;
    let held = tx.one(
        "SELECT COUNT(DISTINCT l.task), MIN(l.expires) FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr <> ?2 AND l.purpose <> 'review' AND t.kind = ?1 AND t.gold IS NULL",
        params![kind, user],
    )?;
    if let Some(row) = held {
        empty.leased_by_others = row.int(0)?;
        empty.soonest_expiry = row.opt_int(1)?;
    }
    empty.skipped_by_me = tx.number(
        "SELECT COUNT(*) FROM skip s JOIN task t ON t.id = s.task
         WHERE s.usr = ?2 AND t.kind = ?1 AND t.state IN ('open', 'leased', 'returned')",
        params![kind, user],
    )?;
    Ok(empty)
}

fn claim_task(tx: &mut dyn Tx, user: i64, id: i64, now: Millis) -> Result<(), Error> {
    expire(tx, user, now)?;
    let settings = project::settings(tx)?;
    let task = log::task(tx, id)?;
    match log::lease_of(tx, id, user)? {
        Some(held) if held.purpose == Purpose::Annotate => {
            prolong(tx, &held, &settings, now)?;
            return Ok(());
        }
        Some(held) if held.purpose == Purpose::Returned => {
            return take(tx, user, id, Purpose::Annotate, &settings, now);
        }
        Some(_) => return Err(Error::wrong_state(task.state, "answered by its reviewer")),
        None => {}
    }
    // Whoever was never given it is not to pick tasks by their numbers.
    let known = tx.one(
        "SELECT 1 FROM event WHERE task = ?1 AND +actor = ?2 AND kind = 'claimed' LIMIT 1",
        params![id, user],
    )?;
    if known.is_none() {
        return Err(Error::not_found("task"));
    }
    if let Some(mine) = log::revision(tx, id, user)?
        && mine.state != RevisionState::Draft
        && mine.state != RevisionState::Returned
    {
        return Err(Error::wrong_state(
            task.state,
            "taken again: your answer is handed in",
        ));
    }
    log::check_move(task.state, LogKind::Claimed, "taken")?;
    let free = tx.number("SELECT claimable FROM task WHERE id = ?1", params![id])?;
    if free == 0 && task.gold.is_none() {
        return Err(Error::refused(
            Code::TaskFull,
            "others have taken all places of this task; what you wrote is kept as your draft",
        ));
    }
    take(tx, user, id, Purpose::Annotate, &settings, now)
}

fn hash_of<T: Serialize>(value: &T) -> Result<String, Error> {
    let text = serde_json::to_string(value).map_err(|error| Error::Row {
        table: "event",
        problem: error.to_string(),
    })?;
    Ok(blake3::hash(text.as_bytes()).to_hex()[..32].to_owned())
}

/// A key as the log keeps it: keys of different people never meet.
fn full_key(user: i64, key: &str) -> Result<String, Error> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-';
    if (8..=64).contains(&key.len()) && key.chars().all(allowed) {
        Ok(format!("{user}:{key}"))
    } else {
        Err(Error::invalid(
            "idem_key",
            "a key is 8 to 64 letters, digits and dashes",
        ))
    }
}

/// What was answered to this key before.
fn replay(tx: &mut dyn Tx, key: &str, request: &str) -> Result<Option<String>, Error> {
    let sql = format!(
        "SELECT {}, result FROM event WHERE idem_key = ?1",
        log::ENTRY_COLUMNS
    );
    let Some(row) = tx.one(&sql, params![key])? else {
        return Ok(None);
    };
    let (_, entry) = log::read_entry(&row)?;
    if entry.body.request() != Some(request) {
        return Err(Error::refused(
            Code::KeyReused,
            "this key was used for another request; make a new one",
        ));
    }
    row.opt_text(7)
}

fn parsed<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, Error> {
    serde_json::from_str(text).map_err(|error| Error::Row {
        table: "event",
        problem: error.to_string(),
    })
}

/// What an event is taken with.
struct Taking {
    user: i64,
    task: TaskRecord,
    settings: Settings,
    now: Millis,
}

fn append(
    tx: &mut dyn Tx,
    user: i64,
    id: i64,
    events: &[NewEvent],
    now: Millis,
) -> Result<Vec<EventResult>, Error> {
    // The plus keeps to the index on tasks: a task has few entries in the log, a person has many.
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
            task: log::task(tx, id)?,
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

/// The answer to an event that left nothing in the log.
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
        rev: log::revision(tx, taking.task.id, taking.user)?.map_or(0, |mine| mine.rev),
        state: Some(taking.task.state),
        lease: annotate_lease(tx, taking.task.id, taking.user)?,
        problem: Some(problem),
    })
}

fn annotate_lease(tx: &mut dyn Tx, task: i64, user: i64) -> Result<Option<Lease>, Error> {
    Ok(log::lease_of(tx, task, user)?
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
        if event.note.chars().count() > crate::wire::MAX_TEXT_CHARS {
            return Err(Error::invalid("note", "the note is too long"));
        }
        let mine = log::revision(tx, self.task.id, self.user)?;
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

    /// Writes an entry and gives its sender's answer, which is the answer to its key from then on.
    fn log(
        &self,
        tx: &mut dyn Tx,
        entry: &Entry,
        event: &NewEvent,
        key: String,
        problem: Option<Problem>,
    ) -> Result<EventResult, Error> {
        let mut answered = None;
        log::write(tx, entry, |tx, seq| {
            let result = EventResult {
                idem_key: event.idem_key.clone(),
                status: problem.as_ref().map_or(200, |problem| problem.status),
                seq: Some(seq),
                rev: log::revision(tx, self.task.id, self.user)?.map_or(0, |mine| mine.rev),
                state: Some(log::task(tx, self.task.id)?.state),
                lease: annotate_lease(tx, self.task.id, self.user)?,
                problem,
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
            answer::check_submission(&answer, self.task.kind, &self.settings)?;
        }
        let rev = mine.as_ref().map_or(0, |mine| mine.rev);
        let secs = if event.secs.is_finite() {
            event.secs.clamp(0.0, MAX_SECS)
        } else {
            0.0
        };
        let held = log::lease_of(tx, self.task.id, self.user)?.filter(|held| {
            held.purpose == Purpose::Annotate && held.lease.epoch == event.lease_epoch
        });
        if event.base_rev != rev {
            let mut problem = Problem::new(
                Code::StaleRevision,
                format!(
                    "this was made from revision {}, and {rev} is the current one; both are in the log",
                    event.base_rev
                ),
            );
            if let Some(mine) = mine {
                problem = problem.with_theirs(mine);
            }
            let body = Body::DraftSaved {
                answer,
                rev,
                secs: 0.0,
                kept_aside: Some(Code::StaleRevision.to_string()),
                request,
            };
            return self.log(
                tx,
                &self.entry(Some(event.lease_epoch), body),
                event,
                key,
                Some(problem),
            );
        }
        let Some(held) = held else {
            let handed_in = mine.is_some_and(|mine| {
                !matches!(mine.state, RevisionState::Draft | RevisionState::Returned)
            });
            let detail = if handed_in {
                "your answer is handed in; take it back before changing it"
            } else {
                "the lease on this task ended and somebody else took the place; what you wrote is kept as your draft"
            };
            let body = Body::DraftSaved {
                answer,
                rev: if handed_in { rev } else { rev + 1 },
                secs,
                kept_aside: handed_in.then(|| Code::LeaseLost.to_string()),
                request,
            };
            let problem = Problem::new(Code::LeaseLost, detail);
            return self.log(
                tx,
                &self.entry(Some(event.lease_epoch), body),
                event,
                key,
                Some(problem),
            );
        };
        let epoch = Some(held.lease.epoch);
        if event.kind == EventKind::Draft {
            let body = Body::DraftSaved {
                answer,
                rev: rev + 1,
                secs,
                kept_aside: None,
                request,
            };
            return self.log(tx, &self.entry(epoch, body), event, key, None);
        }
        let mut answers = handed_in(tx, self.task.id, self.user)?;
        answers.push(answer.clone());
        let score = self
            .task
            .gold
            .as_ref()
            .map(|gold| 1.0 - answer::distance(gold, &answer));
        let body = Body::Submitted {
            answer,
            rev: rev + 1,
            secs,
            distance: answer::spread(&answers),
            request,
        };
        let result = self.log(tx, &self.entry(epoch, body), event, key, None)?;
        if let Some(score) = score {
            log::note(tx, &self.entry(None, Body::GoldScored { score }))?;
        }
        Ok(result)
    }

    /// Suggestions an answer names have to be of its task.
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
                format!("suggestion {id} is not of this task"),
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
                "a task is skipped for a reason; choose one",
            ));
        }
        let held = log::lease_of(tx, self.task.id, self.user)?
            .filter(|held| {
                held.purpose == Purpose::Annotate && held.lease.epoch == event.lease_epoch
            })
            .ok_or_else(|| {
                Error::refused(
                    Code::LeaseLost,
                    "the lease on this task ended; there is nothing to skip",
                )
            })?;
        let body = Body::Skipped {
            postponed,
            reason: event.reason.filter(|_| !postponed),
            note: event.note.trim().to_owned(),
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
        let mine = mine.filter(|mine| mine.state == RevisionState::Submitted);
        let Some(mine) = mine else {
            return Err(Error::wrong_state(
                self.task.state,
                "taken back: no answer of yours waits for review",
            ));
        };
        log::check_move(self.task.state, LogKind::Undone, "taken back")?;
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

/// Answers to a task that are handed in, those of one author apart.
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

fn review_next(
    tx: &mut dyn Tx,
    user: i64,
    queue: ReviewQueue,
    kind: Option<TaskKind>,
    now: Millis,
) -> Result<ReviewClaimed, Error> {
    expire(tx, user, now)?;
    let settings = project::settings(tx)?;
    let kinds = kind.map_or("", TaskKind::as_str);
    let sql = format!(
        "SELECT {} FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose = 'review' AND (?2 = '' OR t.kind = ?2) ORDER BY l.id LIMIT 1",
        log::LEASE_COLUMNS
    );
    let task = match tx.one(&sql, params![user, kinds])? {
        Some(row) => {
            let held = log::read_lease(&row)?;
            if held.lease.expires < lease_end(&settings, now) - MINUTE {
                prolong(tx, &held, &settings, now)?;
            }
            Some(held.lease.task)
        }
        None => {
            // The share of the sample is a bound for its own queue and lets everything through elsewhere.
            let (order, share, back) = match queue {
                ReviewQueue::Disagreement => ("COALESCE(t.distance, -1) DESC, t.id", 100, 0_i64),
                ReviewQueue::Sample => ("t.shuffle, t.id", i64::from(settings.review_percent), 0),
                ReviewQueue::Returned => ("t.id", 100, 1),
            };
            let sql = format!(
                "SELECT t.id FROM task t WHERE t.state = 'submitted' AND t.gold IS NULL AND (?2 = '' OR t.kind = ?2)
                   AND t.shuffle < ?3 AND t.came_back >= ?4
                   AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?1 AND r.state <> 'draft')
                 ORDER BY {order} LIMIT 1"
            );
            let found = tx.one(&sql, params![user, kinds, share, back])?;
            let task = found.map(|row| row.int(0)).transpose()?;
            if let Some(task) = task {
                take(tx, user, task, Purpose::Review, &settings, now)?;
            }
            task
        }
    };
    let Some(task) = task else {
        let of_kind = "t.gold IS NULL AND (?1 = '' OR t.kind = ?1)";
        return Ok(ReviewClaimed::Nothing(ReviewEmpty {
            waiting: tx.number(
                &format!("SELECT COUNT(*) FROM task t WHERE {of_kind} AND t.state = 'submitted'"),
                params![kinds],
            )?,
            mine: tx.number(
                &format!(
                    "SELECT COUNT(*) FROM task t WHERE {of_kind} AND t.state = 'submitted'
                       AND EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?2 AND r.state <> 'draft')"
                ),
                params![kinds, user],
            )?,
            in_review: tx.number(
                &format!("SELECT COUNT(*) FROM task t WHERE {of_kind} AND t.state = 'in_review'"),
                params![kinds],
            )?,
        }));
    };
    review_detail(tx, user, task).map(|detail| ReviewClaimed::Task(Box::new(detail)))
}

fn review_detail(tx: &mut dyn Tx, user: i64, id: i64) -> Result<ReviewDetail, Error> {
    let task = log::task(tx, id)?;
    let lease = log::lease_of(tx, id, user)?.ok_or(Error::Closed)?.lease;
    let sql = format!(
        "SELECT {}, COALESCE(u.name, '') FROM revision r LEFT JOIN usr u ON u.id = r.author
         WHERE r.task = ?1 AND r.state IN ('submitted', 'returned') ORDER BY r.state DESC, r.author",
        log::REVISION_COLUMNS
    );
    let candidates = tx
        .query(&sql, params![id])?
        .iter()
        .map(|row| Ok((log::read_revision(row, 0)?, row.string(7)?)))
        .collect::<Result<_, Error>>()?;
    let comments = tx
        .query(
            "SELECT comment FROM review WHERE task = ?1 AND comment <> '' ORDER BY seq",
            params![id],
        )?
        .iter()
        .map(|row| row.string(0))
        .collect::<Result<_, Error>>()?;
    Ok(ReviewDetail {
        task,
        lease,
        candidates,
        comments,
    })
}

fn review(
    tx: &mut dyn Tx,
    user: i64,
    review: &NewReview,
    now: Millis,
) -> Result<ReviewDone, Error> {
    let key = full_key(user, &review.idem_key)?;
    let request = hash_of(review)?;
    if let Some(result) = replay(tx, &key, &request)? {
        return parsed(&result);
    }
    let settings = project::settings(tx)?;
    let task = log::task(tx, review.task)?;
    let mine = log::revision(tx, task.id, user)?;
    if mine.is_some_and(|mine| mine.state != RevisionState::Draft) {
        return Err(Error::refused(
            Code::OwnWork,
            "you answered this task yourself; somebody else has to review it",
        ));
    }
    if task.gold.is_some() {
        return Err(Error::wrong_state(
            task.state,
            "reviewed: its answer is known",
        ));
    }
    log::check_move(task.state, log_kind(review.decision), "decided so")?;
    let comment = review.comment.trim().to_owned();
    if comment.chars().count() > crate::wire::MAX_TEXT_CHARS {
        return Err(Error::invalid("comment", "the comment is too long"));
    }
    let needs_comment = matches!(
        review.decision,
        Decision::Return | Decision::Drop | Decision::Reopen
    );
    if needs_comment && comment.is_empty() {
        return Err(Error::invalid(
            "comment",
            "say why; the author and the log need it",
        ));
    }
    let held = tx.query(
        &format!(
            "SELECT {} FROM lease l WHERE l.task = ?1 AND l.purpose = 'review'",
            log::LEASE_COLUMNS
        ),
        params![task.id],
    )?;
    let held = held.first().map(log::read_lease).transpose()?;
    let ours = held
        .as_ref()
        .is_some_and(|held| held.lease.user == user && held.lease.epoch == review.lease_epoch);
    let needs_lease = matches!(
        review.decision,
        Decision::Accept | Decision::Merge | Decision::Return
    );
    let somebody_else = held.is_some_and(|held| held.lease.user != user);
    if (needs_lease && !ours) || somebody_else {
        return Err(Error::refused(
            Code::LeaseLost,
            "your lease on this review ended; take the task again from the queue",
        ));
    }
    let authors: Vec<i64> = tx
        .query(
            "SELECT author FROM revision WHERE task = ?1 AND state = 'submitted' ORDER BY author",
            params![task.id],
        )?
        .iter()
        .map(|row| row.int(0))
        .collect::<Result<_, _>>()?;
    let chosen = match review.author {
        None => authors.clone(),
        Some(author) if authors.contains(&author) => vec![author],
        Some(author) => {
            return Err(Error::invalid(
                "author",
                format!("user {author} has no answer that waits for review"),
            ));
        }
    };
    let body = match review.decision {
        Decision::Accept => match chosen.as_slice() {
            [author] => Body::Accepted {
                author: *author,
                comment,
                request,
            },
            _ => {
                return Err(Error::invalid(
                    "author",
                    format!("{} answers wait; choose one", chosen.len()),
                ));
            }
        },
        Decision::Merge => {
            let answer = review
                .answer
                .clone()
                .ok_or_else(|| Error::invalid("answer", "the merged answer is missing"))?;
            answer::check_submission(&answer, task.kind, &settings)?;
            Body::Merged {
                answer,
                comment,
                request,
            }
        }
        Decision::Return => Body::Returned {
            authors: chosen,
            comment,
            until: now + Millis::from(settings.returned_days) * DAY,
            request,
        },
        Decision::Drop => Body::Dropped { comment, request },
        Decision::Reopen => Body::Reopened { comment, request },
    };
    let entry = Entry {
        at: now,
        actor: Some(user),
        task: Some(task.id),
        epoch: Some(review.lease_epoch),
        body,
    };
    let mut done = None;
    log::write(tx, &entry, |tx, seq| {
        let answer = ReviewDone {
            seq,
            state: log::task(tx, task.id)?.state,
        };
        let result = serde_json::to_string(&answer).map_err(|error| Error::Row {
            table: "event",
            problem: error.to_string(),
        })?;
        done = Some(answer);
        Ok(Some(Reply {
            idem_key: key,
            base_rev: 0,
            result,
        }))
    })?;
    done.ok_or(Error::Closed)
}

fn make_gold(tx: &mut dyn Tx, actor: i64, id: i64, now: Millis) -> Result<i64, Error> {
    let task = log::task(tx, id)?;
    let row = tx.one("SELECT answer FROM accepted WHERE task = ?1", params![id])?;
    let Some(row) = row else {
        return Err(Error::wrong_state(
            task.state,
            "made gold; only accepted ones are",
        ));
    };
    let key = format!("gold:{}", task.key);
    if tx
        .one("SELECT 1 FROM task WHERE key = ?1", params![&key])?
        .is_some()
    {
        return Err(Error::wrong_state(task.state, "made gold twice"));
    }
    let gold = NewTask {
        key,
        kind: task.kind,
        source: task.source,
        target: task.target,
        split: task.split,
        bundle: None,
        bundle_index: 0,
        category: task.category,
        hint: task.hint,
        style: task.style,
        priority: 0,
        gold: Some(row.json(0)?),
        extra: None,
        suggestions: Vec::new(),
        accepted: None,
    };
    let next = 1 + tx.number("SELECT COALESCE(MAX(id), 0) FROM task", &[])?;
    let settings = project::settings(tx)?;
    put_task(tx, Some(actor), next, &gold, &settings, now)?;
    Ok(next)
}

impl Store for SqlStore {
    fn put_motions(&self, motions: Vec<MotionRecord>) -> Result<(), Error> {
        for group in motions.chunks(IMPORT_GROUP) {
            let group = group.to_vec();
            self.write(move |tx| project::put_motions(tx, &group))?;
        }
        Ok(())
    }

    fn import(
        &self,
        actor: Option<i64>,
        tasks: Vec<NewTask>,
        now: Millis,
    ) -> Result<Imported, Error> {
        let mut done = Imported::default();
        for group in tasks.chunks(IMPORT_GROUP) {
            let group = group.to_vec();
            let some = self.write(move |tx| import(tx, actor, &group, now))?;
            done.new += some.new;
            done.known += some.known;
        }
        Ok(done)
    }

    fn claim(
        &self,
        user: i64,
        kind: TaskKind,
        ahead: usize,
        now: Millis,
    ) -> Result<Claimed, Error> {
        // In one transaction: the writer has at hand what a reader would have to fetch again after
        // every commit.
        self.write(move |tx| {
            Ok(match claim(tx, user, kind, now)? {
                Ok(task) => Claimed::Task {
                    detail: Box::new(read::detail(tx, user, task)?),
                    upcoming: upcoming(tx, user, kind, ahead)?,
                },
                Err(empty) => Claimed::Nothing(empty),
            })
        })
    }

    fn claim_task(&self, user: i64, task: i64, now: Millis) -> Result<TaskDetail, Error> {
        self.write(move |tx| {
            claim_task(tx, user, task, now)?;
            read::detail(tx, user, task)
        })
    }

    fn renew(&self, user: i64, lease: i64, now: Millis) -> Result<Lease, Error> {
        self.write(move |tx| {
            let settings = project::settings(tx)?;
            let held = log::lease(tx, lease)?.filter(|held| held.lease.user == user);
            let held = held.ok_or_else(|| {
                Error::refused(
                    Code::LeaseLost,
                    "this lease ended; take the task again if it still wants answers",
                )
            })?;
            // A place kept for its author is no lease to work with, and ends when it was said to.
            if held.purpose == Purpose::Returned {
                return Err(Error::wrong_state(TaskState::Returned, "renewed; claim it"));
            }
            prolong_bundle(tx, &held, &settings, now)
        })
    }

    fn release(&self, who: &Who, lease: i64, now: Millis) -> Result<(), Error> {
        let who = who.clone();
        self.write(move |tx| {
            let held = log::lease(tx, lease)?
                .filter(|held| held.lease.user == who.id || who.role >= Role::Reviewer)
                .ok_or_else(|| Error::not_found("lease"))?;
            let reason = if held.lease.user == who.id {
                ReleaseReason::GivenBack
            } else {
                ReleaseReason::TakenAway
            };
            end(tx, &held, Some(who.id), reason, now)
        })
    }

    fn append(
        &self,
        user: i64,
        task: i64,
        events: Vec<NewEvent>,
        now: Millis,
    ) -> Result<Vec<EventResult>, Error> {
        self.write(move |tx| append(tx, user, task, &events, now))
    }

    fn task(&self, who: &Who, task: i64) -> Result<TaskDetail, Error> {
        let who = who.clone();
        self.read(move |tx| {
            if who.role < Role::Reviewer && !read::concerns(tx, who.id, task)? {
                return Err(Error::not_found("task"));
            }
            read::detail(tx, who.id, task)
        })
    }

    fn task_record(&self, task: i64) -> Result<TaskRecord, Error> {
        self.read(move |tx| log::task(tx, task))
    }

    fn review_next(
        &self,
        user: i64,
        queue: ReviewQueue,
        kind: Option<TaskKind>,
        now: Millis,
    ) -> Result<ReviewClaimed, Error> {
        self.write(move |tx| review_next(tx, user, queue, kind, now))
    }

    fn review(&self, user: i64, new: NewReview, now: Millis) -> Result<ReviewDone, Error> {
        self.write(move |tx| review(tx, user, &new, now))
    }

    fn make_gold(&self, actor: i64, task: i64, now: Millis) -> Result<i64, Error> {
        self.write(move |tx| make_gold(tx, actor, task, now))
    }

    fn motions(&self, hashes: Vec<String>) -> Result<Vec<MotionRecord>, Error> {
        self.read(move |tx| project::motions(tx, &hashes))
    }

    fn all_motions(&self) -> Result<Vec<MotionRecord>, Error> {
        self.read(project::all_motions)
    }

    fn partners(&self, hash: &str, limit: usize) -> Result<Vec<MotionRecord>, Error> {
        let hash = hash.to_owned();
        self.read(move |tx| project::partners(tx, &hash, limit))
    }

    fn home(&self, user: i64, now: Millis) -> Result<Home, Error> {
        self.read(move |tx| read::home(tx, user, now))
    }

    fn shelf(&self, user: i64, filter: ShelfFilter) -> Result<Vec<AcceptedAnswer>, Error> {
        self.read(move |tx| read::shelf(tx, user, &filter))
    }

    fn funnel(&self) -> Result<Vec<(TaskKind, TaskState, i64)>, Error> {
        self.read(read::funnel)
    }

    fn weeks(&self, bounds: Vec<Millis>) -> Result<Vec<WeekCounts>, Error> {
        self.read(move |tx| read::weeks(tx, &bounds))
    }

    fn people(&self) -> Result<Vec<PersonCounts>, Error> {
        self.read(read::people)
    }

    fn labels(&self, after: i64, limit: usize) -> Result<Vec<Label>, Error> {
        self.read(move |tx| read::labels(tx, after, limit))
    }

    fn next_keys(&self, after: &str, count: usize) -> Result<Option<KeyRange>, Error> {
        let after = after.to_owned();
        self.read(move |tx| read::next_keys(tx, after, count))
    }

    fn labels_of(&self, keys: &KeyRange) -> Result<Vec<(TaskRecord, Label)>, Error> {
        let keys = keys.clone();
        self.read(move |tx| read::labels_of(tx, &keys))
    }

    fn accepted(&self, keys: &KeyRange) -> Result<Vec<AcceptedAnswer>, Error> {
        let keys = keys.clone();
        self.read(move |tx| read::accepted(tx, &keys))
    }

    fn rejects(&self, keys: &KeyRange) -> Result<Vec<Reject>, Error> {
        let keys = keys.clone();
        self.read(move |tx| read::rejects(tx, &keys))
    }

    fn kept(&self) -> Result<Vec<(Option<String>, String, i64)>, Error> {
        self.read(read::kept)
    }

    fn leases(&self, now: Millis) -> Result<Vec<HeldLease>, Error> {
        self.read(move |tx| read::leases(tx, now))
    }

    fn audit(&self, filter: AuditFilter) -> Result<Audit, Error> {
        self.read(move |tx| read::audit(tx, &filter))
    }

    fn log(&self, after: i64, limit: usize) -> Result<Vec<AuditEntry>, Error> {
        self.read(move |tx| read::log(tx, after, limit))
    }

    fn last_seq(&self) -> Result<i64, Error> {
        self.read(|tx| tx.number("SELECT COALESCE(MAX(seq), 0) FROM event", &[]))
    }

    fn concerns(&self, user: i64, task: i64) -> Result<bool, Error> {
        self.read(move |tx| read::concerns(tx, user, task))
    }

    fn suggestions(&self, ids: Vec<i64>) -> Result<Vec<Suggestion>, Error> {
        self.read(move |tx| project::suggestions(tx, &ids))
    }

    fn put_suggestion(
        &self,
        task: i64,
        suggestion: NewSuggestion,
        now: Millis,
    ) -> Result<Suggestion, Error> {
        self.write(move |tx| project::put_suggestion(tx, task, &suggestion, now))
    }

    fn cached_suggestion(&self, prompt_hash: &str) -> Result<Option<NewSuggestion>, Error> {
        let hash = prompt_hash.to_owned();
        self.read(move |tx| project::cached_suggestion(tx, &hash))
    }

    fn note(&self, name: &str) -> Result<Option<String>, Error> {
        let name = format!("note:{name}");
        self.read(move |tx| {
            let row = tx.one("SELECT body FROM setting WHERE name = ?1", params![&name])?;
            row.map(|row| row.string(0)).transpose()
        })
    }

    fn put_note(&self, name: &str, text: &str) -> Result<(), Error> {
        let (name, text) = (format!("note:{name}"), text.to_owned());
        self.write(move |tx| {
            tx.execute(
                "INSERT INTO setting (name, body) VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET body = excluded.body",
                params![&name, &text],
            )?;
            Ok(())
        })
    }

    fn settings(&self) -> Result<Settings, Error> {
        self.read(project::settings)
    }

    fn put_settings(&self, actor: i64, settings: Settings, now: Millis) -> Result<(), Error> {
        self.write(move |tx| project::put_settings(tx, actor, settings, now))
    }

    fn prefs(&self, user: i64) -> Result<Prefs, Error> {
        self.read(move |tx| project::prefs(tx, user))
    }

    fn put_prefs(&self, user: i64, prefs: Prefs) -> Result<(), Error> {
        self.write(move |tx| project::put_prefs(tx, user, &prefs))
    }

    fn users(&self) -> Result<Vec<User>, Error> {
        self.read(people::users)
    }

    fn add_user(
        &self,
        actor: Option<i64>,
        name: &str,
        role: Role,
        now: Millis,
    ) -> Result<User, Error> {
        let name = name.to_owned();
        self.write_people(move |tx| people::add(tx, actor, &name, role, now))
    }

    fn change_user(
        &self,
        actor: Option<i64>,
        user: i64,
        role: Option<Role>,
        active: Option<bool>,
        now: Millis,
    ) -> Result<User, Error> {
        self.write_people(move |tx| people::change(tx, actor, user, role, active, now))
    }

    fn issue(
        &self,
        user: i64,
        purpose: TokenUse,
        expires: Millis,
        now: Millis,
    ) -> Result<IssuedToken, Error> {
        self.write_people(move |tx| people::issue(tx, user, purpose, expires, now))
    }

    fn authenticate(&self, token: &str, purposes: &[TokenUse], now: Millis) -> Result<Who, Error> {
        let hash = people::hash(token);
        let changes = {
            let known = self.known();
            if let Some(who) = known.find(&hash, purposes, now) {
                return Ok(who);
            }
            known.changes()
        };
        let purposes = purposes.to_vec();
        let found = {
            let (hash, purposes) = (hash.clone(), purposes.clone());
            self.read(move |tx| people::find(tx, &hash, &purposes, now))?
        };
        if found.needs_note {
            return self.write(move |tx| people::used(tx, &hash, &purposes, now));
        }
        let who = found.who.clone();
        self.known().put(hash, found, changes, now);
        Ok(who)
    }

    fn tokens(&self, user: i64) -> Result<Vec<TokenInfo>, Error> {
        self.read(move |tx| people::tokens(tx, user))
    }

    fn revoke(&self, token: i64) -> Result<(), Error> {
        self.write_people(move |tx| people::revoke(tx, token))
    }

    fn log_out(&self, token: &str) -> Result<(), Error> {
        let hash = people::hash(token);
        self.write_people(move |tx| {
            tx.execute(
                "UPDATE token SET revoked = 1 WHERE hash = ?1",
                params![&hash],
            )?;
            Ok(())
        })
    }

    fn put_job(&self, job: Job) -> Result<Job, Error> {
        self.write(move |tx| project::put_job(tx, job))
    }

    fn jobs(&self) -> Result<Vec<Job>, Error> {
        self.read(project::jobs)
    }

    fn log_export(
        &self,
        actor: Option<i64>,
        body: serde_json::Value,
        now: Millis,
    ) -> Result<(), Error> {
        self.write(move |tx| {
            let entry = Entry {
                at: now,
                actor,
                task: None,
                epoch: None,
                body: Body::Exported { export: body },
            };
            log::note(tx, &entry).map(|_| ())
        })
    }

    fn rebuild(&self) -> Result<Vec<&'static str>, Error> {
        self.write(log::rebuild)
    }

    fn verify(&self) -> Result<Vec<String>, Error> {
        db::rehearse(self.db.as_ref(), log::verify)
    }

    fn backup(&self, path: &Path) -> Result<(), Error> {
        self.db.backup(path)
    }

    fn check(&self) -> Result<(), Error> {
        self.db.check()
    }
}
