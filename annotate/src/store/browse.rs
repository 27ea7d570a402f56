//! The task browser: pages of rows, and decisions.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};

use super::db::{Params, Result, ToSql, Tx, params};
use super::filter::{self, Values, condition};
use super::projections::concerns;
use super::records::TaskRecord;
use super::rows::{self, REVISION, TASK};
use super::store::Store;
use crate::Error;
use crate::groups::grouped;
use crate::wire::{
    AnswerBrief, DecisionRow, Decisions, Revision, TaskFilter, TaskPage, TaskRow, TaskSort,
};

/// Query of a page of the task browser.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct PageQuery {
    /// The tasks to list.
    #[serde(skip)]
    pub filter: TaskFilter,
    /// Order; by id if missing.
    pub sort: Option<TaskSort>,
    /// Whether to reverse the order.
    #[serde(deserialize_with = "flag")]
    pub reverse: bool,
    /// Cursor of the previous page.
    pub after: Option<String>,
    /// Maximum number of rows.
    pub limit: usize,
}

/// Reads a flag that is written as a number: 0 for no, any other for yes.
fn flag<'de, D: Deserializer<'de>>(number: D) -> Result<bool, D::Error> {
    Ok(i64::deserialize(number)? != 0)
}

/// Query of a page of decisions.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DecisionQuery {
    /// Only decisions of this reviewer.
    pub reviewer: Option<i64>,
    /// Only decisions of this kind: `accepted`, `merged`, `returned`, `dropped` or `reopened`.
    pub decision: Option<String>,
    /// Only decisions before this sequence number of the log.
    pub before: Option<i64>,
    /// Maximum number of decisions.
    pub limit: usize,
}

impl Store {
    /// A page of the task browser. Refused with `invalid`.
    pub fn browse(&self, query: PageQuery) -> Result<TaskPage> {
        self.read(|tx| page(tx, &query))
    }

    /// The row of a task in the browser, and the decisions on it, oldest first. Refused with `not_found`.
    pub fn task_row(&self, task: i64) -> Result<(TaskRow, Vec<DecisionRow>)> {
        self.read(|tx| {
            let record = rows::task(tx, task)?;
            let row = task_rows(tx, vec![record])?.pop();
            let decisions = decisions(tx, "v.task = ?1 ORDER BY v.seq", params![task])?;
            Ok((row.ok_or_else(|| Error::not_found("task"))?, decisions))
        })
    }

    /// Decisions of reviewers, newest first, each with the authors it concerns and the current state of its task.
    /// Decisions by rules are included only for reviewer 0.
    pub fn decisions(&self, query: DecisionQuery) -> Result<Decisions> {
        let mut values = Values::default();
        let mut place = format!("v.seq < {}", values.put(query.before.unwrap_or(i64::MAX)));
        place += match query.reviewer {
            Some(_) => "",
            None => " AND v.reviewer <> 0",
        };
        place += &values.equal("v.reviewer", query.reviewer);
        place += &values.equal("v.decision", query.decision);
        let limit = values.put(query.limit as i64);
        place += &format!(" ORDER BY v.seq DESC LIMIT {limit}");
        let items = self.read(|tx| decisions(tx, &place, &values.all()))?;
        let last = items.last().map(|item| item.seq);
        let next = last.filter(|_| items.len() == query.limit);
        Ok(Decisions { items, next })
    }
}

/// A page of tasks. The cursor names the last row by its sort value and id, so that a late page is as fast as the
/// first.
fn page(tx: &mut dyn Tx, query: &PageQuery) -> Result<TaskPage> {
    filter::check(&query.filter)?;
    let sort = query.sort.unwrap_or(TaskSort::Id);
    let (column, mut descending) = match sort {
        TaskSort::Id => ("t.id", false),
        TaskSort::Distance => ("COALESCE(t.distance, -1)", true),
        TaskSort::Touched => ("t.touched", true),
    };
    descending ^= query.reverse;
    let mut values = Values::default();
    let mut place = condition(&query.filter, &mut values);
    let (direction, comparison) = if descending {
        ("DESC", "<")
    } else {
        ("ASC", ">")
    };
    if let Some(cursor) = &query.after {
        let (value, id) = match sort {
            TaskSort::Distance => {
                let (value, id) = filter::cursor::<f64>("after", cursor)?;
                (values.put(value), id)
            }
            TaskSort::Id | TaskSort::Touched => {
                let (value, id) = filter::cursor::<i64>("after", cursor)?;
                (values.put(value), id)
            }
        };
        let id = values.put(id);
        place += &format!(" AND ({column}, t.id) {comparison} ({value}, {id})");
    }
    let limit = values.put(query.limit as i64 + 1);
    let order = if sort == TaskSort::Id {
        format!("t.id {direction}")
    } else {
        format!("{column} {direction}, t.id {direction}")
    };
    let sql =
        format!("SELECT {TASK}, {column} FROM task t WHERE {place} ORDER BY {order} LIMIT {limit}");
    let mut found: Vec<(TaskRecord, f64)> = tx.list(&sql, &values.all())?;
    let more = found.len() > query.limit;
    found.truncate(query.limit);
    let last = found.last().filter(|_| more);
    let next = last.map(|(task, value)| format!("{value}:{}", task.id));
    let total = match query.after {
        Some(_) => None,
        None => {
            let mut values = Values::default();
            let place = condition(&query.filter, &mut values);
            let sql = format!("SELECT COUNT(*) FROM task t WHERE {place}");
            Some(tx.number(&sql, &values.all())?)
        }
    };
    let tasks = found.into_iter().map(|(task, _)| task).collect();
    Ok(TaskPage {
        rows: task_rows(tx, tasks)?,
        next,
        total,
        sort,
    })
}

/// Values of several tasks, by task id.
type ByTask<T> = BTreeMap<i64, Vec<T>>;

/// Groups the rows of a query by the task in their first column. `{}` in the query stands for the ids of the tasks.
fn by_task<T: DeserializeOwned>(
    tx: &mut dyn Tx,
    sql: &str,
    tasks: &[TaskRecord],
) -> Result<ByTask<T>> {
    let places: Vec<String> = (1..=tasks.len()).map(|place| format!("?{place}")).collect();
    let ids: Vec<_> = tasks.iter().map(|task| &task.id as &dyn ToSql).collect();
    let sql = sql.replace("{}", &places.join(", "));
    Ok(grouped(tx.list::<(i64, T)>(&sql, &ids)?))
}

/// Rows of the browser. Each table is read once for all rows.
fn task_rows(tx: &mut dyn Tx, tasks: Vec<TaskRecord>) -> Result<Vec<TaskRow>> {
    if tasks.is_empty() {
        return Ok(Vec::new());
    }
    // How an imported answer was accepted elsewhere is left out: that acceptance cannot be undone here.
    let mut facts = by_task::<(Option<String>, Option<String>, i64, Option<String>)>(
        tx,
        "SELECT t.id, s.id, o.id, t.touched, CASE WHEN a.basis LIKE 'import%' THEN 'import' ELSE a.basis END
         FROM task t LEFT JOIN motion s ON s.hash = t.source LEFT JOIN motion o ON o.hash = t.target
         LEFT JOIN accepted a ON a.task = t.id WHERE t.id IN ({})",
        &tasks,
    )?;
    // All answers except drafts, by time.
    let sql = format!(
        "SELECT r.task, {REVISION}, COALESCE(u.name, '') FROM revision r LEFT JOIN usr u ON u.id = r.author
         WHERE r.task IN ({{}}) AND r.state <> 'draft' ORDER BY r.at, r.author"
    );
    let mut answers = by_task(tx, &sql, &tasks)?;
    let mut holders = by_task(
        tx,
        "SELECT l.task, l.id, l.usr, COALESCE(u.name, ''), l.purpose, l.expires
         FROM lease l LEFT JOIN usr u ON u.id = l.usr WHERE l.task IN ({}) ORDER BY l.id",
        &tasks,
    )?;
    let mut skips = by_task(
        tx,
        "SELECT s.task, s.usr, COALESCE(u.name, ''), s.postponed, s.reason, s.note, s.at
         FROM skip s LEFT JOIN usr u ON u.id = s.usr WHERE s.task IN ({}) ORDER BY s.at, s.usr",
        &tasks,
    )?;
    Ok(tasks
        .into_iter()
        .map(|task| {
            let id = &task.id;
            let facts = facts.remove(id).and_then(|mut one| one.pop());
            let (source, target, touched, accepted_by) = facts.unwrap_or_default();
            let answers = answers.remove(id).unwrap_or_default();
            TaskRow {
                answers: answers.into_iter().map(brief).collect(),
                holders: holders.remove(id).unwrap_or_default(),
                skips: skips.remove(id).unwrap_or_default(),
                accepted_by,
                touched,
                source_id: source.unwrap_or(task.source),
                target_id: target.or(task.target),
                id: task.id,
                key: task.key,
                kind: task.kind,
                state: task.state,
                split: task.split,
                category: task.category,
                hint: task.hint,
                style: task.style,
                wanted: task.wanted,
                submitted: task.submitted,
                distance: task.distance,
            }
        })
        .collect())
}

fn brief((own, name): (Revision, String)) -> AnswerBrief {
    let texts: Vec<&str> = own.answer.texts().iter().map(|(text, _)| *text).collect();
    let parts = own.answer.part_names().into_iter();
    AnswerBrief {
        author: own.author,
        name,
        state: own.state,
        text: texts.join(" · "),
        parts: parts.map(str::to_owned).collect(),
        verdict: own.answer.verdict(),
        edit_type: own.answer.fields().edit_type,
        at: own.at,
    }
}

/// Decisions `v` that match an SQL condition.
fn decisions(tx: &mut dyn Tx, condition: &str, params: Params) -> Result<Vec<DecisionRow>> {
    let sql = format!(
        "SELECT v.seq, v.task, t.key, v.decision, v.reviewer, COALESCE(u.name, ''), '[]', v.rule, v.comment,
           v.at, t.state
         FROM review v JOIN task t ON t.id = v.task LEFT JOIN usr u ON u.id = v.reviewer WHERE {condition}"
    );
    let mut found: Vec<DecisionRow> = tx.list(&sql, params)?;
    let authors = format!(
        "SELECT u.name FROM review v JOIN usr u ON {} WHERE v.seq = ?1 ORDER BY u.id",
        concerns("u.id")
    );
    for row in &mut found {
        row.authors = tx.list(&authors, params![row.seq])?;
    }
    Ok(found)
}
