//! Projections: applies log entries to the derived tables.

use super::db::{Tx, params};
use super::entry::{Body, Entry, LoggedTask, json};
use super::records::{Credit, Millis};
use super::rows::state;
use crate::Error;
use crate::state::{LogKind, Purpose, targets};
use crate::wire::{Answer, EditType, RevisionState, SkipReason, TaskState, Verdict};

/// Maximum number of leases of one entry. The id of a lease is the sequence number of its entry times this,
/// plus its index.
const LEASES_PER_ENTRY: i64 = 100;

/// Checks that an entry is legal in the current state of the task.
pub(crate) fn check_move(state: TaskState, kind: LogKind, what: &str) -> Result<(), Error> {
    if targets(state, kind).is_empty() {
        return Err(Error::wrong_state(state, what));
    }
    Ok(())
}

/// Applies an entry to the projections.
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
        tx.execute(
            "UPDATE task SET touched = ?2 WHERE id = ?1",
            params![task, entry.at],
        )?;
    }
    count_work(tx, seq, entry, task)?;
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

/// Adds an entry to the work of its actor. What rules and bulk actions decide is nobody's work.
fn count_work(tx: &mut dyn Tx, seq: i64, entry: &Entry, task: i64) -> Result<(), Error> {
    let (answers, skips, reviews): (i64, i64, i64) = match &entry.body {
        Body::Submitted { .. } => (1, 0, 0),
        Body::Skipped { .. } => (0, 1, 0),
        Body::Accepted { request, .. }
        | Body::Merged { request, .. }
        | Body::Returned { request, .. }
        | Body::Dropped { request, .. }
            if !request.is_empty() =>
        {
            (0, 0, 1)
        }
        _ => (0, 0, 0),
    };
    let secs = entry.body.secs();
    let Some(actor) = entry
        .actor
        .filter(|_| secs > 0.0 || answers + skips + reviews > 0)
    else {
        return Ok(());
    };
    tx.execute(
        "INSERT INTO work (seq, task, usr, at, secs, answers, skips, reviews) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
        params![seq, task, actor, entry.at, secs, answers, skips, reviews],
    )?;
    Ok(())
}

fn state_of(tx: &mut dyn Tx, task: i64) -> Result<TaskState, Error> {
    let row = tx.one("SELECT state FROM task WHERE id = ?1", params![task])?;
    state(row.ok_or_else(|| Error::not_found("task"))?.text(0)?)
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
           priority, shuffle, wanted, gold, extra, state, submitted, leases, epoch, claimable, came_back, changed,
           counted, distance, touched, practice)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, 0, 0, 0, ?18, 0, 0, ?19,
           NULL, 0, ?20)",
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
            claimable,
            task.accepted.as_ref().is_some_and(is_kept_pair),
            task.practice
        ],
    )?;
    if let Some(answer) = &task.accepted {
        accept_imported(tx, seq, entry, id, answer, task.credit.as_ref())?;
    }
    Ok(())
}

/// Whether an answer keeps a fine-grained pair, which counts toward the quota of its category.
fn is_kept_pair(answer: &Answer) -> bool {
    matches!(
        answer,
        Answer::Pair {
            verdict: Verdict::Keep,
            ..
        }
    )
}

fn accept_imported(
    tx: &mut dyn Tx,
    seq: i64,
    entry: &Entry,
    task: i64,
    answer: &Answer,
    credit: Option<&Credit>,
) -> Result<(), Error> {
    tx.execute(
        "INSERT INTO accepted (task, author, reviewer, answer, merged, credit, keeps, at, seq, basis, words, parts)
         VALUES (?1, ?2, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)",
        params![
            task,
            entry.actor.unwrap_or(0),
            json(answer)?,
            credit.is_some_and(|credit| credit.merged),
            credit.and_then(|credit| credit.author.clone()),
            is_kept_pair(answer),
            entry.at,
            seq,
            match credit.and_then(|credit| credit.accepted_by.as_deref()) {
                Some(basis) => format!("{IMPORTED}:{basis}"),
                None => IMPORTED.to_owned(),
            },
            words(answer),
            part_list(answer)
        ],
    )?;
    Ok(())
}

/// A lease to create.
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

/// Id of a lease created by an entry.
pub(crate) fn lease_id(seq: i64, number: usize) -> i64 {
    seq * LEASES_PER_ENTRY + number as i64
}

fn change(tx: &mut dyn Tx, seq: i64, entry: &Entry, task: i64) -> Result<(), Error> {
    let actor = entry.actor.unwrap_or(0);
    match &entry.body {
        Body::Filled {
            answer,
            credit,
            extra,
        } => {
            accept_imported(tx, seq, entry, task, answer, credit.as_ref())?;
            if let Some(extra) = extra {
                tx.execute(
                    "UPDATE task SET extra = ?2 WHERE id = ?1",
                    params![task, json(extra)?],
                )?;
            }
            set_state(tx, task, TaskState::Accepted)
        }
        Body::ClipChanged { source, target } => {
            // Nobody has to be asked about a task without an answer.
            tx.execute(
                "UPDATE task SET source = ?2, target = ?3, changed = CASE WHEN gold IS NOT NULL
                     OR EXISTS (SELECT 1 FROM revision WHERE task = ?1)
                     OR EXISTS (SELECT 1 FROM accepted WHERE task = ?1) THEN 1 ELSE 0 END
                 WHERE id = ?1",
                params![task, source, target.clone()],
            )?;
            Ok(())
        }
        Body::ClipKept => settle_clip(tx, task),
        Body::Claimed {
            purpose,
            expires,
            blind,
            place,
        } => {
            if let Some(place) = place {
                tx.execute(
                    "INSERT INTO gold_place (task, usr, bundle, bundle_index) VALUES (?1, ?2, ?3, ?4)
                     ON CONFLICT (task, usr) DO UPDATE SET bundle = excluded.bundle, bundle_index = excluded.bundle_index",
                    params![task, actor, place.bundle, place.index],
                )?;
            }
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
                Purpose::Annotate | Purpose::Returned | Purpose::Assigned => refresh(tx, task),
            }
        }
        Body::Renewed { lease, expires } => {
            tx.execute(
                "UPDATE lease SET expires = ?2 WHERE id = ?1",
                params![*lease, *expires],
            )?;
            Ok(())
        }
        Body::Released {
            lease,
            user,
            purpose,
            reserved,
            ..
        } => {
            tx.execute("DELETE FROM lease WHERE id = ?1", params![*lease])?;
            if let Some(until) = reserved {
                let epoch = tx.number("SELECT epoch FROM task WHERE id = ?1", params![task])?;
                put_lease(
                    tx,
                    &NewLease {
                        id: lease_id(seq, 0),
                        task,
                        user: *user,
                        epoch: epoch + 1,
                        expires: *until,
                        purpose: Purpose::Returned,
                        blind: false,
                    },
                )?;
            }
            match purpose {
                Purpose::Review => set_state(tx, task, TaskState::Submitted),
                Purpose::Annotate | Purpose::Returned | Purpose::Assigned => refresh(tx, task),
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
            // Its author saw the clip as it is now.
            tx.execute(
                "UPDATE task SET distance = ?2, changed = CASE WHEN EXISTS (
                     SELECT 1 FROM revision WHERE task = ?1 AND author <> ?3) THEN changed ELSE 0 END
                 WHERE id = ?1",
                params![task, *distance, actor],
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
            put_review(tx, seq, entry, task, author, comment, None)?;
            refresh(tx, task)
        }
        Body::Accepted {
            author,
            comment,
            rule,
            own,
            ..
        } => {
            tx.execute(
                "UPDATE revision SET state = CASE WHEN author = ?2 THEN 'accepted' ELSE 'superseded' END
                 WHERE task = ?1 AND state = 'submitted'",
                params![task, *author],
            )?;
            tx.execute(
                "INSERT INTO accepted (task, author, reviewer, answer, merged, keeps, at, seq, basis, words, parts)
                 SELECT task, author, CAST(?3 AS BIGINT), answer, 0, CASE WHEN verdict = 'keep' THEN 1 ELSE 0 END,
                   CAST(?4 AS BIGINT), CAST(?5 AS BIGINT), ?6, words, parts
                 FROM revision WHERE task = ?1 AND author = ?2",
                params![task, *author, actor, entry.at, seq, basis(rule.as_deref(), *own)],
            )?;
            end_leases(tx, task)?;
            put_review(
                tx,
                seq,
                entry,
                task,
                Some(*author),
                comment,
                rule.as_deref(),
            )?;
            settle_clip(tx, task)?;
            set_state(tx, task, TaskState::Accepted)
        }
        Body::Merged {
            answer,
            comment,
            own,
            ..
        } => {
            tx.execute(
                "UPDATE revision SET state = 'superseded' WHERE task = ?1 AND state = 'submitted'",
                params![task],
            )?;
            tx.execute(
                "INSERT INTO accepted (task, author, reviewer, answer, merged, keeps, at, seq, basis, words, parts)
                 VALUES (?1, ?2, ?2, ?3, 1, ?4, ?5, ?6, ?7, ?8, ?9)",
                params![
                    task,
                    actor,
                    json(answer)?,
                    is_kept_pair(answer),
                    entry.at,
                    seq,
                    basis(None, *own),
                    words(answer),
                    part_list(answer)
                ],
            )?;
            end_leases(tx, task)?;
            put_review(tx, seq, entry, task, None, comment, None)?;
            settle_clip(tx, task)?;
            set_state(tx, task, TaskState::Accepted)
        }
        Body::Dropped { comment, .. } => {
            end_leases(tx, task)?;
            put_review(tx, seq, entry, task, None, comment, None)?;
            settle_clip(tx, task)?;
            set_state(tx, task, TaskState::Dropped)
        }
        Body::Reopened { comment, rule, .. } => {
            tx.execute("DELETE FROM accepted WHERE task = ?1", params![task])?;
            tx.execute(
                "UPDATE revision SET state = 'submitted' WHERE task = ?1 AND state IN ('accepted', 'superseded')",
                params![task],
            )?;
            put_review(tx, seq, entry, task, None, comment, rule.as_deref())?;
            refresh(tx, task)
        }
        Body::Assigned { user, until } => {
            // The task leaves the person it was reserved for before.
            tx.execute(
                "DELETE FROM lease WHERE task = ?1 AND purpose IN ('returned', 'assigned')",
                params![task],
            )?;
            let epoch = tx.number("SELECT epoch FROM task WHERE id = ?1", params![task])?;
            put_lease(
                tx,
                &NewLease {
                    id: lease_id(seq, 0),
                    task,
                    user: *user,
                    epoch: epoch + 1,
                    expires: *until,
                    purpose: Purpose::Assigned,
                    blind: false,
                },
            )?;
            refresh(tx, task)
        }
        Body::Retargeted { wanted } => {
            tx.execute(
                "UPDATE task SET wanted = ?2 WHERE id = ?1",
                params![task, *wanted],
            )?;
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
        | Body::GuidePicture { .. }
        | Body::ParaphraseJudged { .. }
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
    rule: Option<&str>,
) -> Result<(), Error> {
    tx.execute(
        "INSERT INTO review (seq, task, reviewer, decision, author, comment, at, rule) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
        params![
            seq,
            task,
            entry.actor.unwrap_or(0),
            entry.body.kind().as_str(),
            author,
            comment,
            entry.at,
            rule
        ],
    )?;
    Ok(())
}

/// Column `accepted.basis` of an imported answer; behind a colon follows how it was accepted elsewhere.
pub(super) const IMPORTED: &str = "import";

/// How an answer was accepted, for the column `accepted.basis`.
fn basis(rule: Option<&str>, own: bool) -> String {
    match rule {
        Some(rule) => format!("rule:{rule}"),
        None if own => "own".to_owned(),
        None => "review".to_owned(),
    }
}

/// Lower-case texts of an answer, for searches.
fn words(answer: &Answer) -> String {
    let texts: Vec<String> = answer
        .texts()
        .into_iter()
        .map(|(text, _)| text)
        .chain([answer.note()])
        .filter(|text| !text.is_empty())
        .map(str::to_lowercase)
        .collect();
    texts.join("\n")
}

/// Names of the parts of an answer, each between bars: `|LEFT_ARM|LOWER_BODY|`.
fn part_list(answer: &Answer) -> String {
    let names: Vec<&str> = answer.part_names().into_iter().collect();
    if names.is_empty() {
        return String::new();
    }
    format!("|{}|", names.join("|"))
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
    let blind = tx.number(
        "SELECT blind FROM lease WHERE task = ?1 AND usr = ?2",
        params![task, actor],
    )?;
    tx.execute(
        "INSERT INTO revision (task, author, rev, state, answer, at, secs, blind, verdict, edit_type, words, parts)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12)
         ON CONFLICT (task, author) DO UPDATE SET rev = excluded.rev, state = excluded.state,
           answer = excluded.answer, at = excluded.at, secs = revision.secs + excluded.secs,
           blind = CASE WHEN excluded.blind = 1 THEN 1 ELSE revision.blind END,
           verdict = excluded.verdict, edit_type = excluded.edit_type,
           words = excluded.words, parts = excluded.parts",
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
            answer.edit_type().map(EditType::as_str),
            words(answer),
            part_list(answer)
        ],
    )?;
    Ok(())
}

/// Notes that somebody decided about a task with its clip as it is now.
fn settle_clip(tx: &mut dyn Tx, task: i64) -> Result<(), Error> {
    tx.execute("UPDATE task SET changed = 0 WHERE id = ?1", params![task])?;
    Ok(())
}

fn set_state(tx: &mut dyn Tx, task: i64, state: TaskState) -> Result<(), Error> {
    tx.execute(
        "UPDATE task SET state = ?2, claimable = 0,
           leases = (SELECT COUNT(*) FROM lease WHERE task = ?1 AND purpose <> 'review') WHERE id = ?1",
        params![task, state.as_str()],
    )?;
    count(tx, task)
}

/// Derives whether a pair counts toward the quota of its category: an accepted answer keeps it; or, before a decision,
/// a submitted answer keeps it, or somebody is at work on it. A claim can so leave room for those who are at work.
fn count(tx: &mut dyn Tx, task: i64) -> Result<(), Error> {
    tx.execute(
        "UPDATE task SET counted = CASE
             WHEN gold IS NOT NULL OR state = 'dropped' THEN 0
             WHEN state = 'accepted' THEN COALESCE((SELECT a.keeps FROM accepted a WHERE a.task = ?1), 0)
             WHEN EXISTS (SELECT 1 FROM revision r WHERE r.task = ?1 AND r.state = 'submitted' AND r.verdict = 'keep')
               OR EXISTS (SELECT 1 FROM lease l WHERE l.task = ?1 AND l.purpose <> 'review') THEN 1
             ELSE 0 END
         WHERE id = ?1 AND kind = 'pair'",
        params![task],
    )?;
    Ok(())
}

/// Counts the answers and leases of an undecided task and derives its state.
fn refresh(tx: &mut dyn Tx, task: i64) -> Result<(), Error> {
    let row = tx
        .one(
            "SELECT wanted, CASE WHEN gold IS NULL THEN 0 ELSE 1 END,
               (SELECT COUNT(*) FROM revision WHERE task = ?1 AND state IN ('submitted', 'accepted', 'superseded')),
               (SELECT COUNT(*) FROM lease WHERE task = ?1 AND purpose IN ('annotate', 'assigned')),
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
    count(tx, task)
}
