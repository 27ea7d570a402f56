//! Queries on tasks and answers, for people, figures, exports and the log.

use std::collections::BTreeMap;

use super::db::{Params, Result, Tx, params, unreadable};
use super::draw::{is_blind, wanted};
use super::entry::Body;
use super::filter::{Values, like};
use super::project;
use super::projections::concerns as concerns_answer;
use super::records::{
    AcceptedAnswer, AuditFilter, BundleEntry, KeyRange, Label, Millis, Reject, ShelfFilter,
    TaskDetail, TaskRecord, Who,
};
use super::rows::{self, LEASE, REVISION, TASK};
use super::store::Store;
use crate::Error;
use crate::state::Purpose;
use crate::wire::{
    Answer, Audit, AuditEntry, Bundle, EditType, HeldLease, MotionInfo, Person, RevisionState,
    Role, Task, TaskKind, TaskState, Week,
};

impl Store {
    /// Task details for a user who may see the task. Refused with `not_found`.
    pub fn task(&self, who: &Who, task: i64) -> Result<TaskDetail> {
        self.read(|tx| {
            if who.role < Role::Reviewer && !concerns(tx, who.id, task)? {
                return Err(Error::not_found("task"));
            }
            detail(tx, who.id, task)
        })
    }

    /// A task, without access check. Refused with `not_found`.
    pub fn task_record(&self, task: i64) -> Result<TaskRecord> {
        self.read(|tx| rows::task(tx, task))
    }

    /// A task in the form that the page shows.
    pub(crate) fn view(&self, task: TaskRecord, bundle: Option<Bundle>) -> Result<Task> {
        self.read(|tx| view(tx, task, bundle))
    }

    /// Key, source and target of each task about two motions, without gold tasks.
    pub fn pairs(&self) -> Result<Vec<(String, String, String)>> {
        let sql = "SELECT key, source, target FROM task WHERE target IS NOT NULL AND gold IS NULL ORDER BY id";
        self.read(|tx| tx.list(sql, &[]))
    }

    /// Tasks whose clip was ingested again with other content after somebody answered.
    pub fn changed_tasks(&self) -> Result<Vec<TaskRecord>> {
        self.read(|tx| rows::tasks(tx, "t.changed = 1 AND t.gold IS NULL ORDER BY t.id", &[]))
    }

    /// Tasks that still want answers and have no draft of a language model, with ids above `after`.
    pub fn undrafted(
        &self,
        kind: Option<TaskKind>,
        after: i64,
        limit: usize,
    ) -> Result<Vec<TaskRecord>> {
        let condition = "t.id > ?1 AND (?2 = '' OR t.kind = ?2) AND t.gold IS NULL
           AND t.state IN ('open', 'leased', 'returned')
           AND NOT EXISTS (SELECT 1 FROM suggestion g WHERE g.task = t.id AND g.source = 'llm')
         ORDER BY t.id LIMIT ?3";
        let kind = kind.map_or("", TaskKind::as_str);
        self.read(|tx| rows::tasks(tx, condition, params![after, kind, limit as i64]))
    }

    /// The accepted answer to a task.
    pub fn accepted_answer(&self, task: i64) -> Result<Option<Answer>> {
        self.read(|tx| accepted_answer(tx, task))
    }

    /// All answers that a task ever had: imported, submitted and merged ones.
    pub(crate) fn answers_ever(&self, task: i64) -> Result<Vec<Answer>> {
        self.read(|tx| answers_ever(tx, task))
    }

    /// Accepted answers that match a filter.
    pub fn shelf(&self, user: i64, filter: ShelfFilter) -> Result<Vec<AcceptedAnswer>> {
        let part = filter.part.map(|part| format!("%|{part}|%"));
        let text = filter.text.as_deref().map(like);
        // Exclude the motions of tasks that the user holds: their answers would be visible.
        let from = "accepted a JOIN task t ON t.id = a.task
         WHERE a.seq < ?1 AND (?2 = '' OR t.kind = ?2)
           AND (?3 = '' OR a.parts LIKE ?3)
           AND (?4 = '' OR a.words LIKE ?4 ESCAPE '\\')
           AND NOT EXISTS (SELECT 1 FROM lease l JOIN task h ON h.id = l.task WHERE l.usr = ?5
             AND (h.source = t.source OR h.target = t.source OR h.source = t.target OR h.target = t.target))
         ORDER BY a.seq DESC LIMIT ?6";
        self.read(|tx| {
            let values = params![
                filter.before.unwrap_or(i64::MAX),
                filter.kind.map_or("", TaskKind::as_str),
                part.unwrap_or_default(),
                text.unwrap_or_default(),
                user,
                filter.limit as i64
            ];
            accepted(tx, from, values)
        })
    }

    /// The range of the next `count` task keys after a key, or `None` after the last.
    pub fn next_keys(&self, after: &str, count: usize) -> Result<Option<KeyRange>> {
        let sql =
            "SELECT MAX(n.key) FROM (SELECT key FROM task WHERE key > ?1 ORDER BY key LIMIT ?2) n";
        let last: Option<Option<String>> =
            self.read(|tx| tx.find(sql, params![after, count as i64]))?;
        Ok(last.flatten().map(|up_to| KeyRange {
            after: after.to_owned(),
            up_to,
        }))
    }

    /// Accepted answers to a range of tasks, sorted by task key.
    pub fn accepted(&self, keys: &KeyRange) -> Result<Vec<AcceptedAnswer>> {
        let from = "task t JOIN accepted a ON a.task = t.id WHERE t.key > ?1 AND t.key <= ?2 ORDER BY t.key";
        self.read(|tx| accepted(tx, from, params![keys.after, keys.up_to]))
    }

    /// Keys of the tasks that were reopened and are not accepted now. The value says whether an export wrote an answer to
    /// the task if it was made when entry `seq` was the last of the log.
    pub fn reopened(&self, seq: i64) -> Result<BTreeMap<String, bool>> {
        // Only accepted and dropped tasks can be reopened.
        let decisions = "FROM event e WHERE e.task = t.id
           AND e.kind IN ('imported', 'filled', 'accepted', 'merged', 'dropped', 'reopened')";
        // Exports to a dataset do not write its own labels. In a text of an entry, quotes are escaped.
        let is_written = r#"CASE WHEN e.kind = 'dropped' OR e.body LIKE '%"of_dataset":true%' THEN 0 ELSE 1 END"#;
        let sql = format!(
            "SELECT t.key, CASE WHEN (SELECT e.kind {decisions} AND e.seq > ?1 ORDER BY e.seq LIMIT 1) = 'reopened'
               AND (SELECT {is_written} {decisions} AND e.seq <= ?1 ORDER BY e.seq DESC LIMIT 1) = 1 THEN 1 ELSE 0 END
             FROM task t WHERE t.gold IS NULL AND t.state <> 'accepted'
               AND EXISTS (SELECT 1 FROM review v WHERE v.task = t.id AND v.decision = 'reopened')"
        );
        let found: Vec<(String, bool)> = self.read(|tx| tx.list(&sql, params![seq]))?;
        Ok(found.into_iter().collect())
    }

    /// Tasks whose answers changed after a sequence number, and the last sequence number of the log.
    pub fn answered_since(&self, after: i64) -> Result<(Vec<i64>, i64)> {
        self.read(|tx| {
            let last = last_seq(tx)?;
            let tasks = tx.list(
                "SELECT DISTINCT task FROM event WHERE seq > ?1 AND task IS NOT NULL
                   AND kind IN ('submitted', 'undone', 'draft_saved', 'accepted', 'merged', 'returned', 'reopened')
                 ORDER BY task",
                params![after],
            )?;
            Ok((tasks, last))
        })
    }

    /// Answers to these tasks, without drafts, in the order of `tasks`.
    pub fn labels_to(&self, tasks: Vec<i64>) -> Result<Vec<Label>> {
        let sql = labels("", "r.task = ?1 ORDER BY r.author");
        self.read(|tx| {
            let mut labels = Vec::new();
            for task in tasks {
                labels.extend(tx.list::<Label>(&sql, params![task])?);
            }
            Ok(labels)
        })
    }

    /// Answers to a range of tasks, without drafts, sorted by task key and author.
    pub fn labels_of(&self, keys: &KeyRange) -> Result<Vec<(TaskRecord, Label)>> {
        let range = "t.key > ?1 AND t.key <= ?2 ORDER BY t.key, r.author";
        let sql = labels(&format!("{TASK},"), range);
        self.read(|tx| tx.list(&sql, params![keys.after, keys.up_to]))
    }

    /// Dropped and skipped tasks of a range.
    pub fn rejects(&self, keys: &KeyRange) -> Result<Vec<Reject>> {
        let dropped = format!(
            "SELECT {TASK}, v.reviewer, 'dropped', v.comment FROM task t JOIN review v ON v.task = t.id
             WHERE t.state = 'dropped' AND t.key > ?1 AND t.key <= ?2 AND v.seq = (
               SELECT MAX(w.seq) FROM review w WHERE w.task = t.id AND w.decision = 'dropped')
             ORDER BY t.key"
        );
        let skipped = format!(
            "SELECT {TASK}, s.usr, COALESCE(s.reason, ''), s.note FROM skip s JOIN task t ON t.id = s.task
             WHERE s.postponed = 0 AND t.key > ?1 AND t.key <= ?2 ORDER BY t.key, s.usr"
        );
        self.read(|tx| {
            let range = params![keys.after, keys.up_to];
            let mut all: Vec<Reject> = tx.list(&dropped, range)?;
            all.extend(tx.list::<Reject>(&skipped, range)?);
            Ok(all)
        })
    }

    /// Number of kept pairs by category and edit type.
    pub fn kept(&self) -> Result<Vec<(Option<String>, EditType, i64)>> {
        let sql = "SELECT category, kept_type, COUNT(*) FROM task
             WHERE kind = 'pair' AND counted = 1 AND kept_type IS NOT NULL
             GROUP BY category, kept_type ORDER BY category, kept_type";
        self.read(|tx| tx.list(sql, &[]))
    }

    /// Number of tasks by kind and state, without gold tasks.
    pub fn funnel(&self) -> Result<Vec<(TaskKind, TaskState, i64)>> {
        let sql = "SELECT kind, state, COUNT(*) FROM task WHERE gold IS NULL
             GROUP BY kind, state ORDER BY kind, state";
        self.read(|tx| tx.list(sql, &[]))
    }

    /// Weeks with their counts, without figures of agreement. `bounds` holds their starts and the end of the last one.
    pub fn weeks(&self, bounds: &[Millis]) -> Result<Vec<Week>> {
        let sql = "SELECT CAST(?1 AS BIGINT),
               (SELECT CAST(COALESCE(SUM(w.answers), 0) AS BIGINT) FROM work w JOIN task t ON t.id = w.task
                WHERE w.at >= ?1 AND w.at < ?2 AND t.practice = 0),
               COUNT(CASE WHEN e.kind IN ('accepted', 'merged') THEN 1 END),
               COUNT(CASE WHEN e.kind = 'returned' THEN 1 END), NULL, NULL, 0
             FROM event e JOIN task t ON t.id = e.task
             WHERE e.at >= ?1 AND e.at < ?2 AND e.kind IN ('accepted', 'merged', 'returned')
               AND t.practice = 0";
        self.read(|tx| {
            let weeks = bounds.windows(2);
            let counts = weeks.map(|week| tx.get(sql, params![week[0], week[1]]));
            counts.collect()
        })
    }

    /// Totals of every person, without figures of quality.
    pub fn people(&self) -> Result<Vec<Person>> {
        let returned = concerns_answer("u.id");
        let sql = format!(
            "SELECT u.id, u.name, u.role, u.active,
               (SELECT COUNT(*) FROM revision r JOIN task t ON t.id = r.task
                WHERE r.author = u.id AND r.state <> 'draft' AND t.practice = 0), NULL,
               (SELECT COUNT(*) FROM revision WHERE author = u.id AND state = 'accepted'),
               (SELECT COUNT(*) FROM review v WHERE v.decision = 'returned' AND {returned}), NULL, NULL,
               (SELECT COUNT(*) FROM gold_score g JOIN task t ON t.id = g.task WHERE g.usr = u.id AND t.practice = 0),
               (SELECT AVG(g.score) FROM gold_score g JOIN task t ON t.id = g.task WHERE g.usr = u.id AND t.practice = 0),
               NULL, (SELECT at FROM event WHERE actor = u.id ORDER BY seq DESC LIMIT 1)
             FROM usr u ORDER BY u.id"
        );
        self.read(|tx| tx.list(&sql, &[]))
    }

    /// Up to 1,000 leases that have not expired, the first to expire first.
    pub fn leases(&self, now: Millis) -> Result<Vec<HeldLease>> {
        let sql = format!(
            "SELECT {LEASE}, COALESCE(u.name, ''), t.kind, l.purpose FROM lease l JOIN task t ON t.id = l.task
             LEFT JOIN usr u ON u.id = l.usr WHERE l.expires > ?1 ORDER BY l.expires, l.id LIMIT 1000"
        );
        self.read(|tx| tx.list(&sql, params![now]))
    }

    /// Entries of the log, newest first.
    pub fn audit(&self, filter: AuditFilter) -> Result<Audit> {
        let mut values = Values::default();
        let mut condition = format!("e.seq < {}", values.put(filter.before.unwrap_or(i64::MAX)));
        condition += &values.equal("e.actor", filter.actor);
        condition += &values.equal("e.kind", filter.kind);
        condition += &values.equal("e.task", filter.task);
        let limit = values.put(filter.limit as i64);
        condition += &format!(" ORDER BY e.seq DESC LIMIT {limit}");
        let entries = self.read(|tx| log(tx, &condition, &values.all()))?;
        let last = entries.last().map(|entry| entry.seq);
        let next = last.filter(|_| entries.len() == filter.limit);
        Ok(Audit { entries, next })
    }

    /// Entries of the log after a sequence number, oldest first.
    pub fn log(&self, after: i64, limit: usize) -> Result<Vec<AuditEntry>> {
        let condition = "e.seq > ?1 ORDER BY e.seq LIMIT ?2";
        self.read(|tx| log(tx, condition, params![after, limit as i64]))
    }

    /// Last sequence number of the log.
    pub fn last_seq(&self) -> Result<i64> {
        self.read(last_seq)
    }
}

pub(super) fn last_seq(tx: &mut dyn Tx) -> Result<i64> {
    tx.number("SELECT COALESCE(MAX(seq), 0) FROM event", &[])
}

/// Whether a user holds or answered a task.
fn concerns(tx: &mut dyn Tx, user: i64, task: i64) -> Result<bool> {
    let held = rows::lease_of(tx, task, user)?.is_some();
    Ok(held || rows::revision(tx, task, user)?.is_some())
}

/// The accepted answer to a task.
pub(super) fn accepted_answer(tx: &mut dyn Tx, task: i64) -> Result<Option<Answer>> {
    tx.find("SELECT answer FROM accepted WHERE task = ?1", params![task])
}

/// The known answer of a gold or practice task: the answer that is accepted now of the task that it is a copy of, or,
/// while there is none, the one that it was made with.
pub(super) fn known_answer(tx: &mut dyn Tx, task: &TaskRecord) -> Result<Option<Answer>> {
    let Some(first) = &task.gold else {
        return Ok(None);
    };
    // The key of a copy is `gold:` or `practice:`, and the key of that task.
    let key = task.key.split_once(':').map_or("", |(_, key)| key);
    let sql = "SELECT a.answer FROM task o JOIN accepted a ON a.task = o.id WHERE o.key = ?1";
    let accepted: Option<Answer> = tx.find(sql, params![key])?;
    Ok(Some(accepted.unwrap_or_else(|| first.clone())))
}

/// All answers that a task ever had: imported, submitted and merged ones.
pub(super) fn answers_ever(tx: &mut dyn Tx, task: i64) -> Result<Vec<Answer>> {
    let sql = "SELECT body FROM event WHERE task = ?1 AND kind IN ('imported', 'filled', 'submitted', 'merged')";
    let bodies: Vec<serde_json::Value> = tx.list(sql, params![task])?;
    let answers = bodies.into_iter().map(answer_in);
    answers.filter_map(Result::transpose).collect()
}

/// The imported or merged answer that was accepted, if none was accepted after it. Once the task is reopened, only the log
/// holds it.
pub(super) fn former_answer(tx: &mut dyn Tx, task: i64) -> Result<Option<Answer>> {
    let sql = "SELECT body FROM event WHERE task = ?1 AND kind IN ('imported', 'filled', 'accepted', 'merged')
         ORDER BY seq DESC LIMIT 1";
    let body: Option<serde_json::Value> = tx.find(sql, params![task])?;
    body.map_or(Ok(None), answer_in)
}

/// The answer in the body of a log entry.
fn answer_in(body: serde_json::Value) -> Result<Option<Answer>> {
    let body = serde_json::from_value(body).map_err(|error| unreadable("event", error))?;
    Ok(match body {
        Body::Imported { task } => task.accepted,
        Body::Filled { answer, .. }
        | Body::Submitted { answer, .. }
        | Body::Merged { answer, .. } => Some(answer),
        _ => None,
    })
}

/// The comment of the last decision of a kind on a user's answer to a task. Dropping a task concerns everybody.
pub(super) fn comment_to(
    tx: &mut dyn Tx,
    task: i64,
    user: i64,
    decision: &str,
) -> Result<Option<String>> {
    let sql = format!(
        "SELECT v.comment FROM review v WHERE v.task = ?1 AND v.decision = ?3
           AND (v.decision = 'dropped' OR {}) ORDER BY v.seq DESC LIMIT 1",
        concerns_answer("?2")
    );
    tx.find(&sql, params![task, user.to_string(), decision])
}

/// Task details for a user who may see the task.
pub(super) fn detail(tx: &mut dyn Tx, user: i64, id: i64) -> Result<TaskDetail> {
    let held = rows::lease_of(tx, id, user)?;
    let mine = rows::revision(tx, id, user)?;
    let task = rows::task(tx, id)?;
    let task = shown(tx, task, user)?;
    let blind = match &held {
        Some(held) if matches!(held.purpose, Purpose::Annotate | Purpose::Review) => held.blind,
        // A task that is reserved for the user, or that they answered, is as blind as it is when they claim it.
        _ => {
            let sql = "SELECT 1 FROM revision WHERE task = ?1 AND author = ?2 AND blind = 1";
            is_blind(&project::settings(tx)?, &task.key, user) || tx.has(sql, params![id, user])?
        }
    };
    let comment = comment_to(tx, id, user, "returned")?;
    let came_back = mine
        .as_ref()
        .is_some_and(|mine| matches!(mine.state, RevisionState::Returned | RevisionState::Draft));
    Ok(TaskDetail {
        bundle: bundle(tx, &task, user)?,
        lease: held
            .filter(|held| held.purpose == Purpose::Annotate)
            .map(|held| held.lease),
        comment: comment.filter(|_| came_back),
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

/// Number of answers that a task wants, as people are told: a gold task takes answers without limit, and looks as if it
/// wanted as many as the task that it is a copy of.
fn shown_wanted(tx: &mut dyn Tx, task: &TaskRecord) -> Result<u32> {
    if task.gold.is_none() {
        return Ok(task.wanted);
    }
    if task.practice {
        return Ok(1);
    }
    let original = task.key.split_once(':').map_or("", |(_, key)| key);
    Ok(wanted(&project::settings(tx)?, original, task.bundle))
}

/// A task as shown to a user: a gold task looks like a normal task of a bundle.
pub(super) fn shown(tx: &mut dyn Tx, mut task: TaskRecord, user: i64) -> Result<TaskRecord> {
    if task.gold.is_none() {
        return Ok(task);
    }
    task.wanted = shown_wanted(tx, &task)?;
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
    let sql = "SELECT bundle, bundle_index FROM gold_place WHERE task = ?1 AND usr = ?2";
    if let Some((bundle, index)) = tx.find(sql, params![task.id, user])? {
        (task.bundle, task.bundle_index) = (Some(bundle), index);
    }
    Ok(task)
}

/// A task in the form that the page shows.
pub(super) fn view(tx: &mut dyn Tx, task: TaskRecord, bundle: Option<Bundle>) -> Result<Task> {
    let motions = project::motions(tx, std::iter::once(&task.source).chain(&task.target))?;
    let wanted = shown_wanted(tx, &task)?;
    Ok(Task {
        id: task.id,
        kind: task.kind,
        state: task.state,
        motions: motions.into_iter().map(MotionInfo::from).collect(),
        category: task.category,
        hint: task.hint,
        style: task.style,
        wanted,
        submitted: task.submitted,
        bundle,
        practice: task.practice,
    })
}

fn bundle(tx: &mut dyn Tx, task: &TaskRecord, user: i64) -> Result<Vec<BundleEntry>> {
    let Some(bundle) = task.bundle else {
        return Ok(Vec::new());
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
    let tasks: Vec<(i64, BundleEntry)> = tx.list(&tasks, params![bundle, user])?;
    let golds: Vec<(i64, BundleEntry)> = tx.list(&golds, params![bundle, user])?;
    let is_mine = |entry: &BundleEntry| entry.leased || entry.mine.is_some();
    Ok(tasks
        .into_iter()
        .map(|(index, entry)| {
            if is_mine(&entry) {
                return entry;
            }
            // A gold task may stand in this place for the user; of several, the held one is shown.
            golds
                .iter()
                .filter(|(at, gold)| *at == index && is_mine(gold))
                .max_by_key(|(_, gold)| gold.leased)
                .map_or(entry, |(_, gold)| gold.clone())
        })
        .collect())
}

/// Accepted answers `a` to tasks `t`, selected by an SQL `FROM` clause.
fn accepted(tx: &mut dyn Tx, from: &str, params: Params) -> Result<Vec<AcceptedAnswer>> {
    let columns = "a.author, a.merged, a.credit, a.basis, a.answer, a.at, a.seq";
    tx.list(&format!("SELECT {TASK}, {columns} FROM {from}"), params)
}

/// SQL for labels that match a condition, after the given columns.
fn labels(columns: &str, condition: &str) -> String {
    let returned = concerns_answer("r.author");
    format!(
        "SELECT {columns} r.task, t.kind, CASE WHEN t.gold IS NULL THEN 0 ELSE 1 END,
           COALESCE((SELECT m.frames FROM motion m WHERE m.hash = t.source), 1), {REVISION}, r.blind,
           CASE WHEN EXISTS (SELECT 1 FROM review v WHERE v.task = r.task AND v.decision = 'returned' AND {returned})
             THEN 1 ELSE 0 END,
           a.basis FROM task t JOIN revision r ON r.task = t.id
         LEFT JOIN accepted a ON a.task = r.task AND a.author = r.author AND a.merged = 0 AND r.state = 'accepted'
         WHERE r.state <> 'draft' AND {condition}"
    )
}

/// Log entries `e` that match an SQL condition.
fn log(tx: &mut dyn Tx, condition: &str, params: Params) -> Result<Vec<AuditEntry>> {
    let sql = format!(
        "SELECT e.seq, e.at, e.actor, u.name, e.kind, e.task, e.body
         FROM event e LEFT JOIN usr u ON u.id = e.actor WHERE {condition}"
    );
    tx.list(&sql, params)
}
