//! Queries.

use super::db::{Row, Tx, Value, params};
use super::projections::IMPORTED;
use super::records::{
    AcceptedAnswer, AuditFilter, BundleEntry, KeyRange, Label, Millis, PersonCounts, Reject,
    ShelfFilter, TaskDetail, TaskRecord, WeekCounts,
};
use super::rows;
use super::rows::NUM_TASK_COLUMNS;
use super::{people, project};
use crate::Error;
use crate::state::Purpose;
use crate::wire::{
    Audit, AuditEntry, HeldLease, Lease, RevisionState, TaskKind, TaskState, Verdict,
};

pub(super) fn concerns(tx: &mut dyn Tx, user: i64, task: i64) -> Result<bool, Error> {
    let held = rows::lease_of(tx, task, user)?.is_some();
    Ok(held || rows::revision(tx, task, user)?.is_some())
}

/// Task details for a user who may see the task.
pub(super) fn detail(tx: &mut dyn Tx, user: i64, id: i64) -> Result<TaskDetail, Error> {
    let held = rows::lease_of(tx, id, user)?;
    let mine = rows::revision(tx, id, user)?;
    let task = rows::task(tx, id)?;
    let task = shown(tx, task, user)?;
    let blind = match &held {
        Some(held) => held.blind,
        None => {
            tx.number(
                "SELECT blind FROM revision WHERE task = ?1 AND author = ?2",
                params![id, user],
            )? != 0
        }
    };
    let comment = tx.one(
        "SELECT comment FROM review WHERE task = ?1 AND decision = 'returned'
           AND (author IS NULL OR author = ?2) ORDER BY seq DESC LIMIT 1",
        params![id, user],
    )?;
    let came_back = mine
        .as_ref()
        .is_some_and(|mine| matches!(mine.state, RevisionState::Returned | RevisionState::Draft));
    Ok(TaskDetail {
        bundle: bundle(tx, &task, user)?,
        lease: held
            .filter(|held| held.purpose == Purpose::Annotate)
            .map(|held| held.lease),
        comment: comment
            .filter(|_| came_back)
            .map(|row| row.string(0))
            .transpose()?,
        clip_changed: task.changed && mine.is_some(),
        suggestions: if blind {
            Vec::new()
        } else {
            project::suggestions_of(tx, id)?
        },
        blind,
        mine,
        task,
    })
}

/// A task as a user may see it: a gold task looks like one that wants one answer, and stands in a bundle.
pub(super) fn shown(tx: &mut dyn Tx, mut task: TaskRecord, user: i64) -> Result<TaskRecord, Error> {
    if task.gold.is_none() {
        return Ok(task);
    }
    task.wanted = 1;
    let mine = rows::revision(tx, task.id, user)?;
    let is_answered = mine.is_some_and(|mine| mine.state != RevisionState::Draft);
    task.submitted = is_answered.into();
    task.state = if is_answered {
        TaskState::Submitted
    } else if rows::lease_of(tx, task.id, user)?.is_some() {
        TaskState::Leased
    } else {
        TaskState::Open
    };
    let place = tx.one(
        "SELECT bundle, bundle_index FROM gold_place WHERE task = ?1 AND usr = ?2",
        params![task.id, user],
    )?;
    if let Some(place) = place {
        task.bundle = Some(place.int(0)?);
        task.bundle_index = place.int(1)?;
    }
    Ok(task)
}

/// Key and motions of each task about two motions.
pub(super) fn pairs(tx: &mut dyn Tx) -> Result<Vec<(String, String, String)>, Error> {
    tx.query(
        "SELECT key, source, target FROM task WHERE target IS NOT NULL AND gold IS NULL ORDER BY id",
        &[],
    )?
    .iter()
    .map(|row| Ok((row.string(0)?, row.string(1)?, row.string(2)?)))
    .collect()
}

/// Tasks whose clip was ingested anew after somebody answered.
pub(super) fn changed(tx: &mut dyn Tx) -> Result<Vec<TaskRecord>, Error> {
    let sql = format!(
        "SELECT {} FROM task t WHERE t.changed = 1 ORDER BY t.id",
        rows::TASK_COLUMNS
    );
    tx.query(&sql, &[])?.iter().map(rows::read_task).collect()
}

fn bundle(tx: &mut dyn Tx, task: &TaskRecord, user: i64) -> Result<Vec<BundleEntry>, Error> {
    let Some(bundle) = task.bundle else {
        return Ok(Vec::new());
    };
    let read = |row: &Row| -> Result<(i64, BundleEntry), Error> {
        let entry = BundleEntry {
            task: row.int(1)?,
            mine: row
                .opt_text(2)?
                .map(|state| rows::revision_state(&state))
                .transpose()?,
            verdict: row
                .opt_text(3)?
                .and_then(|verdict| Verdict::parse(&verdict)),
            leased: row.flag(4)?,
        };
        Ok((row.int(0)?, entry))
    };
    let columns = |index: &str| {
        format!(
            "{index}, t.id, r.state, r.verdict,
               (SELECT COUNT(*) FROM lease l WHERE l.task = t.id AND l.usr = ?2 AND l.purpose = 'annotate')"
        )
    };
    let tasks = format!(
        "SELECT {} FROM task t LEFT JOIN revision r ON r.task = t.id AND r.author = ?2
         WHERE t.bundle = ?1 ORDER BY t.bundle_index, t.id",
        columns("t.bundle_index")
    );
    let golds = format!(
        "SELECT {} FROM gold_place g JOIN task t ON t.id = g.task
         LEFT JOIN revision r ON r.task = t.id AND r.author = ?2
         WHERE g.usr = ?2 AND g.bundle = ?1 ORDER BY g.bundle_index, t.id",
        columns("g.bundle_index")
    );
    let mut all = |sql: &str| -> Result<Vec<(i64, BundleEntry)>, Error> {
        tx.query(sql, params![bundle, user])?
            .iter()
            .map(read)
            .collect()
    };
    let (tasks, golds) = (all(&tasks)?, all(&golds)?);
    let is_mine = |entry: &BundleEntry| entry.leased || entry.mine.is_some();
    Ok(tasks
        .into_iter()
        .map(|(index, entry)| {
            if is_mine(&entry) {
                return entry;
            }
            // A gold task stands in for this one until the user gets it; of several, the one held.
            golds
                .iter()
                .filter(|(at, gold)| *at == index && is_mine(gold))
                .max_by_key(|(_, gold)| gold.leased)
                .map_or(entry, |(_, gold)| gold.clone())
        })
        .collect())
}

/// The pattern of a text anywhere in a lower-case column.
pub(super) fn like(text: &str) -> String {
    let escaped = text
        .to_lowercase()
        .replace('\\', "\\\\")
        .replace('%', "\\%")
        .replace('_', "\\_");
    format!("%{escaped}%")
}

pub(super) fn shelf(
    tx: &mut dyn Tx,
    user: i64,
    filter: &ShelfFilter,
) -> Result<Vec<AcceptedAnswer>, Error> {
    let columns = rows::TASK_COLUMNS;
    let part = filter
        .part
        .as_deref()
        .map_or(String::new(), |part| format!("%|{part}|%"));
    let text = filter.text.as_deref().map_or(String::new(), like);
    // Exclude the motions of tasks that the user holds: their answers would be visible.
    let sql = format!(
        "SELECT {columns}, a.author, a.merged, a.answer, a.at, a.seq, a.credit, a.basis FROM accepted a JOIN task t ON t.id = a.task
         WHERE a.seq < ?1 AND (?2 = '' OR t.kind = ?2)
           AND (?3 = '' OR a.parts LIKE ?3)
           AND (?4 = '' OR a.words LIKE ?4 ESCAPE '\\')
           AND NOT EXISTS (SELECT 1 FROM lease l JOIN task h ON h.id = l.task WHERE l.usr = ?5
             AND (h.source = t.source OR h.target = t.source OR h.source = t.target OR h.target = t.target))
         ORDER BY a.seq DESC LIMIT ?6"
    );
    tx.query(
        &sql,
        params![
            filter.before.unwrap_or(i64::MAX),
            filter.kind.map_or("", TaskKind::as_str),
            part,
            text,
            user,
            filter.limit as i64
        ],
    )?
    .iter()
    .map(read_accepted)
    .collect()
}

fn read_accepted(row: &Row) -> Result<AcceptedAnswer, Error> {
    let from = NUM_TASK_COLUMNS;
    Ok(AcceptedAnswer {
        task: rows::read_task(row)?,
        author: row.int(from)?,
        merged: row.flag(from + 1)?,
        answer: row.json(from + 2)?,
        at: row.int(from + 3)?,
        seq: row.int(from + 4)?,
        credit: row.opt_text(from + 5)?,
        accepted_by: {
            let basis = row.text(from + 6)?;
            let elsewhere = basis
                .strip_prefix(IMPORTED)
                .and_then(|rest| rest.strip_prefix(':'));
            elsewhere.unwrap_or(basis).to_owned()
        },
    })
}

/// The range of the next keys.
pub(super) fn next_keys(
    tx: &mut dyn Tx,
    after: String,
    count: usize,
) -> Result<Option<KeyRange>, Error> {
    let last = tx.one(
        "SELECT MAX(n.key) FROM (SELECT key FROM task WHERE key > ?1 ORDER BY key LIMIT ?2) n",
        params![after.as_str(), count as i64],
    )?;
    let up_to = last
        .and_then(|row| row.opt_text(0).transpose())
        .transpose()?;
    Ok(up_to.map(|up_to| KeyRange { after, up_to }))
}

pub(super) fn accepted(tx: &mut dyn Tx, keys: &KeyRange) -> Result<Vec<AcceptedAnswer>, Error> {
    let sql = format!(
        "SELECT {}, a.author, a.merged, a.answer, a.at, a.seq, a.credit, a.basis FROM task t JOIN accepted a ON a.task = t.id
         WHERE t.key > ?1 AND t.key <= ?2 ORDER BY t.key",
        rows::TASK_COLUMNS
    );
    tx.query(&sql, params![keys.after.as_str(), keys.up_to.as_str()])?
        .iter()
        .map(read_accepted)
        .collect()
}

const LABEL_COLUMNS: &str = "t.kind, CASE WHEN t.gold IS NULL THEN 0 ELSE 1 END, t.category, t.source, t.target, t.split, r.blind";

/// Reads a label of the columns of a revision and [`LABEL_COLUMNS`].
fn read_label(row: &Row) -> Result<Label, Error> {
    Ok(Label {
        revision: rows::read_revision(row, 0)?,
        task: row.int(0)?,
        kind: rows::task_kind(row.text(7)?)?,
        gold: row.flag(8)?,
        category: row.opt_text(9)?,
        source: row.string(10)?,
        target: row.opt_text(11)?,
        split: row.string(12)?,
        blind: row.flag(13)?,
        accepted_by: None,
    })
}

pub(super) fn labels(tx: &mut dyn Tx, after: i64, limit: usize) -> Result<Vec<Label>, Error> {
    let sql = format!(
        "SELECT {}, {LABEL_COLUMNS} FROM revision r JOIN task t ON t.id = r.task
         WHERE r.state <> 'draft' AND r.task > ?1 AND r.task <= (
           SELECT COALESCE(MAX(x.task), 0) FROM (
             SELECT DISTINCT task FROM revision WHERE state <> 'draft' AND task > ?1 ORDER BY task LIMIT ?2) x)
         ORDER BY r.task, r.author",
        rows::REVISION_COLUMNS
    );
    tx.query(&sql, params![after, limit as i64])?
        .iter()
        .map(read_label)
        .collect()
}

/// Tasks that still want answers and have no draft of a language model.
pub(super) fn undrafted(
    tx: &mut dyn Tx,
    kind: Option<TaskKind>,
    after: i64,
    limit: usize,
) -> Result<Vec<TaskRecord>, Error> {
    let sql = format!(
        "SELECT {} FROM task t WHERE t.id > ?1 AND (?2 = '' OR t.kind = ?2) AND t.gold IS NULL
           AND t.state IN ('open', 'leased', 'returned')
           AND NOT EXISTS (SELECT 1 FROM suggestion g WHERE g.task = t.id AND g.source = 'llm')
         ORDER BY t.id LIMIT ?3",
        rows::TASK_COLUMNS
    );
    let kind = kind.map_or("", TaskKind::as_str);
    tx.query(&sql, params![after, kind, limit as i64])?
        .iter()
        .map(rows::read_task)
        .collect()
}

/// Submitted answers to some tasks.
pub(super) fn labels_to(tx: &mut dyn Tx, tasks: &[i64]) -> Result<Vec<Label>, Error> {
    let sql = format!(
        "SELECT {}, {LABEL_COLUMNS} FROM revision r JOIN task t ON t.id = r.task
         WHERE r.state <> 'draft' AND r.task = ?1 ORDER BY r.author",
        rows::REVISION_COLUMNS
    );
    let mut labels = Vec::new();
    for task in tasks {
        for row in tx.query(&sql, params![*task])? {
            labels.push(read_label(&row)?);
        }
    }
    Ok(labels)
}

/// Tasks whose answers changed after a place in the log, and its last place.
pub(super) fn answered_since(tx: &mut dyn Tx, after: i64) -> Result<(Vec<i64>, i64), Error> {
    let last = tx.number("SELECT COALESCE(MAX(seq), 0) FROM event", &[])?;
    let tasks = tx
        .query(
            "SELECT DISTINCT task FROM event WHERE seq > ?1 AND task IS NOT NULL
               AND kind IN ('submitted', 'undone', 'draft_saved', 'accepted', 'merged', 'returned', 'reopened')
             ORDER BY task",
            params![after],
        )?
        .iter()
        .map(|row| row.int(0))
        .collect::<Result<_, _>>()?;
    Ok((tasks, last))
}

pub(super) fn labels_of(
    tx: &mut dyn Tx,
    keys: &KeyRange,
) -> Result<Vec<(TaskRecord, Label)>, Error> {
    let (task, revision) = (rows::TASK_COLUMNS, rows::REVISION_COLUMNS);
    let sql = format!(
        "SELECT {task}, r.blind, {revision}, a.basis FROM task t JOIN revision r ON r.task = t.id
         LEFT JOIN accepted a ON a.task = r.task AND a.author = r.author AND a.merged = 0 AND r.state = 'accepted'
         WHERE r.state <> 'draft' AND t.key > ?1 AND t.key <= ?2 ORDER BY t.key, r.author"
    );
    tx.query(&sql, params![keys.after.as_str(), keys.up_to.as_str()])?
        .iter()
        .map(|row| {
            let task = rows::read_task(row)?;
            let label = Label {
                revision: rows::read_revision(row, NUM_TASK_COLUMNS + 1)?,
                task: task.id,
                kind: task.kind,
                gold: task.gold.is_some(),
                category: task.category.clone(),
                source: task.source.clone(),
                target: task.target.clone(),
                split: task.split.clone(),
                blind: row.flag(NUM_TASK_COLUMNS)?,
                accepted_by: row.opt_text(NUM_TASK_COLUMNS + 8)?,
            };
            Ok((task, label))
        })
        .collect()
}

/// Number of accepted answers by how they were accepted.
pub(super) fn accepted_by(tx: &mut dyn Tx) -> Result<Vec<(String, i64)>, Error> {
    tx.query(
        "SELECT basis, COUNT(*) FROM accepted GROUP BY basis ORDER BY basis",
        &[],
    )?
    .iter()
    .map(|row| Ok((row.string(0)?, row.int(1)?)))
    .collect()
}

pub(super) fn rejects(tx: &mut dyn Tx, keys: &KeyRange) -> Result<Vec<Reject>, Error> {
    let columns = rows::TASK_COLUMNS;
    let from = NUM_TASK_COLUMNS;
    let mut all = Vec::new();
    let skipped = format!(
        "SELECT {columns}, s.usr, COALESCE(s.reason, ''), s.note FROM skip s JOIN task t ON t.id = s.task
         WHERE s.postponed = 0 AND t.key > ?1 AND t.key <= ?2 ORDER BY t.key, s.usr"
    );
    let dropped = format!(
        "SELECT {columns}, v.reviewer, 'dropped', v.comment FROM task t JOIN review v ON v.task = t.id
         WHERE t.state = 'dropped' AND t.key > ?1 AND t.key <= ?2 AND v.seq = (
           SELECT MAX(w.seq) FROM review w WHERE w.task = t.id AND w.decision = 'dropped')
         ORDER BY t.key"
    );
    for sql in [dropped, skipped] {
        for row in tx.query(&sql, params![keys.after.as_str(), keys.up_to.as_str()])? {
            all.push(Reject {
                task: rows::read_task(&row)?,
                user: row.opt_int(from)?,
                reason: row.string(from + 1)?,
                note: row.string(from + 2)?,
            });
        }
    }
    Ok(all)
}

pub(super) fn kept(tx: &mut dyn Tx) -> Result<Vec<(Option<String>, String, i64)>, Error> {
    tx.query(
        "SELECT category, kept_type, COUNT(*) FROM task WHERE kind = 'pair' AND counted = 1 AND kept_type IS NOT NULL
         GROUP BY category, kept_type ORDER BY category, kept_type",
        &[],
    )?
    .iter()
    .map(|row| Ok((row.opt_text(0)?, row.string(1)?, row.int(2)?)))
    .collect()
}

pub(super) fn funnel(tx: &mut dyn Tx) -> Result<Vec<(TaskKind, TaskState, i64)>, Error> {
    tx.query(
        "SELECT kind, state, COUNT(*) FROM task WHERE gold IS NULL GROUP BY kind, state ORDER BY kind, state",
        &[],
    )?
    .iter()
    .map(|row| {
        Ok((
            rows::task_kind(row.text(0)?)?,
            rows::state(row.text(1)?)?,
            row.int(2)?,
        ))
    })
    .collect()
}

pub(super) fn weeks(tx: &mut dyn Tx, bounds: &[Millis]) -> Result<Vec<WeekCounts>, Error> {
    let mut weeks = Vec::new();
    for pair in bounds.windows(2) {
        let mut week = WeekCounts::default();
        let rows = tx.query(
            "SELECT kind, COUNT(*) FROM event WHERE at >= ?1 AND at < ?2
               AND kind IN ('submitted', 'accepted', 'merged', 'returned') GROUP BY kind",
            params![pair[0], pair[1]],
        )?;
        for row in rows {
            match row.text(0)? {
                "submitted" => week.submitted += row.int(1)?,
                "returned" => week.returned += row.int(1)?,
                _ => week.accepted += row.int(1)?,
            }
        }
        weeks.push(week);
    }
    Ok(weeks)
}

pub(super) fn people(tx: &mut dyn Tx) -> Result<Vec<PersonCounts>, Error> {
    let mut all = Vec::new();
    for user in people::users(tx)? {
        let id = user.id;
        let done = tx.number(
            "SELECT COUNT(*) FROM revision WHERE author = ?1 AND state <> 'draft'",
            params![id],
        )?;
        let accepted = tx.number(
            "SELECT COUNT(*) FROM revision WHERE author = ?1 AND state = 'accepted'",
            params![id],
        )?;
        let returned = tx.number(
            "SELECT COUNT(*) FROM review v JOIN revision r ON r.task = v.task AND r.author = ?1
             WHERE v.decision = 'returned' AND (v.author IS NULL OR v.author = ?1)",
            params![id],
        )?;
        let gold = tx
            .query(
                "SELECT g.score FROM gold_score g JOIN task t ON t.id = g.task
                 WHERE g.usr = ?1 AND t.practice = 0 ORDER BY g.task",
                params![id],
            )?
            .iter()
            .map(|row| row.real(0))
            .collect::<Result<_, _>>()?;
        let last = tx.one(
            "SELECT at FROM event WHERE actor = ?1 ORDER BY seq DESC LIMIT 1",
            params![id],
        )?;
        all.push(PersonCounts {
            user,
            done,
            accepted,
            returned,
            gold,
            last_seen: last.map(|row| row.int(0)).transpose()?,
        });
    }
    Ok(all)
}

pub(super) fn leases(tx: &mut dyn Tx, now: Millis) -> Result<Vec<HeldLease>, Error> {
    let sql = format!(
        "SELECT {}, COALESCE(u.name, ''), t.kind FROM lease l JOIN task t ON t.id = l.task
         LEFT JOIN usr u ON u.id = l.usr WHERE l.expires > ?1 ORDER BY l.expires, l.id LIMIT 1000",
        rows::LEASE_COLUMNS
    );
    tx.query(&sql, params![now])?
        .iter()
        .map(|row| {
            let held = rows::read_lease(row)?;
            Ok(HeldLease {
                lease: Lease::clone(&held.lease),
                user_name: row.string(7)?,
                kind: rows::task_kind(row.text(8)?)?,
                purpose: held.purpose.to_string(),
            })
        })
        .collect()
}

fn read_audit(row: &Row) -> Result<AuditEntry, Error> {
    Ok(AuditEntry {
        seq: row.int(0)?,
        at: row.int(1)?,
        actor: row.opt_int(2)?,
        actor_name: row.opt_text(3)?,
        kind: row.string(4)?,
        task: row.opt_int(5)?,
        body: row.json(6)?,
    })
}

const AUDIT_COLUMNS: &str = "e.seq, e.at, e.actor, u.name, e.kind, e.task, e.body";

pub(super) fn audit(tx: &mut dyn Tx, filter: &AuditFilter) -> Result<Audit, Error> {
    let mut sql = format!(
        "SELECT {AUDIT_COLUMNS} FROM event e LEFT JOIN usr u ON u.id = e.actor WHERE e.seq < ?1"
    );
    let mut values = vec![Value::from(filter.before.unwrap_or(i64::MAX))];
    let mut also = |column: &str, value: Value| {
        values.push(value);
        sql += &format!(" AND e.{column} = ?{}", values.len());
    };
    if let Some(actor) = filter.actor {
        also("actor", actor.into());
    }
    if let Some(kind) = filter.kind {
        also("kind", kind.as_str().into());
    }
    if let Some(task) = filter.task {
        also("task", task.into());
    }
    values.push(Value::from(filter.limit as i64));
    sql += &format!(" ORDER BY e.seq DESC LIMIT ?{}", values.len());
    let entries: Vec<AuditEntry> = tx
        .query(&sql, &values)?
        .iter()
        .map(read_audit)
        .collect::<Result<_, _>>()?;
    let next = (entries.len() == filter.limit)
        .then(|| entries.last().map(|entry| entry.seq))
        .flatten();
    Ok(Audit { entries, next })
}

pub(super) fn log(tx: &mut dyn Tx, after: i64, limit: usize) -> Result<Vec<AuditEntry>, Error> {
    let sql = format!(
        "SELECT {AUDIT_COLUMNS} FROM event e LEFT JOIN usr u ON u.id = e.actor
         WHERE e.seq > ?1 ORDER BY e.seq LIMIT ?2"
    );
    tx.query(&sql, params![after, limit as i64])?
        .iter()
        .map(read_audit)
        .collect()
}
