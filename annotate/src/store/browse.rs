//! The task browser: filters, pages of rows, decisions, and actions on all tasks of a filter.

use std::collections::BTreeMap;

use super::apply::IMPORTED;
use super::claim::MINUTE;
use super::db::{Row, Tx, Value, params};
use super::entry::{Body, Entry};
use super::records::{Millis, TaskRecord, Who};
use super::rows::NUM_TASK_COLUMNS;
use super::{log, project, read, rows, rules};
use crate::Error;
use crate::answer;
use crate::state::{LogKind, targets};
use crate::wire::{
    AnswerBrief, BulkAction, BulkDone, BulkRequest, DecisionRow, Decisions, Holder, MAX_TEXT_CHARS,
    Settings, SkipBrief, SkipFilter, SkipReason, TaskFilter, TaskKind, TaskPage, TaskRow, TaskSort,
    TaskState,
};

/// Tasks that one bulk request looks at.
const BULK_AT_ONCE: i64 = 2000;
const DAY: Millis = 24 * 60 * MINUTE;

/// Parameters of a query that is put together.
#[derive(Default)]
struct Values(Vec<Value>);

impl Values {
    /// Adds a value and returns its place in the query.
    fn put(&mut self, value: impl Into<Value>) -> String {
        self.0.push(value.into());
        format!("?{}", self.0.len())
    }
}

/// The SQL condition of a filter on task `t`.
fn condition(filter: &TaskFilter, values: &mut Values) -> String {
    let mut all = vec!["t.gold IS NULL".to_owned()];
    let mut equal = |column: &str, value: Option<&str>, values: &mut Values| {
        if let Some(value) = value {
            all.push(format!("t.{column} = {}", values.put(value)));
        }
    };
    equal("kind", filter.kind.map(TaskKind::as_str), values);
    equal("state", filter.state.map(TaskState::as_str), values);
    equal("category", filter.category.as_deref(), values);
    equal("split", filter.split.as_deref(), values);
    if let Some(task) = filter.task {
        all.push(format!("t.id = {}", values.put(task)));
    }
    if let Some(person) = filter.person {
        let who = values.put(person);
        all.push(format!(
            "t.id IN (SELECT task FROM revision WHERE author = {who} AND state <> 'draft'
               UNION SELECT task FROM lease WHERE usr = {who} UNION SELECT task FROM skip WHERE usr = {who})"
        ));
    }
    let answered = |condition: String| {
        format!(
            "EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.state <> 'draft' AND {condition})"
        )
    };
    if let Some(part) = &filter.part {
        let like = values.put(format!("%|{part}|%"));
        all.push(format!(
            "({} OR EXISTS (SELECT 1 FROM accepted a WHERE a.task = t.id AND a.parts LIKE {like}))",
            answered(format!("r.parts LIKE {like}"))
        ));
    }
    if let Some(edit_type) = filter.edit_type {
        let value = values.put(edit_type.as_str());
        all.push(answered(format!("r.edit_type = {value}")));
    }
    if let Some(verdict) = filter.verdict {
        let value = values.put(verdict.as_str());
        all.push(answered(format!("r.verdict = {value}")));
    }
    if let Some(least) = filter.min_distance {
        all.push(format!("t.distance >= {}", values.put(least)));
    }
    if let Some(most) = filter.max_distance {
        all.push(format!("t.distance <= {}", values.put(most)));
    }
    if let Some(rule) = &filter.rule {
        let basis = values.put(format!("rule:{rule}"));
        all.push(format!(
            "EXISTS (SELECT 1 FROM accepted a WHERE a.task = t.id AND a.basis = {basis})"
        ));
    }
    let skipped = "EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.postponed = 0)";
    match filter.skipped {
        None => {}
        Some(SkipFilter::Any) => all.push(skipped.to_owned()),
        Some(SkipFilter::Everybody) => all.push(format!(
            "t.state IN ('open', 'leased', 'returned') AND {skipped} AND NOT EXISTS (
               SELECT 1 FROM usr u WHERE u.active = 1
                 AND (u.role = 'annotator'
                   OR NOT EXISTS (SELECT 1 FROM usr a WHERE a.active = 1 AND a.role = 'annotator'))
                 AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = u.id AND s.postponed = 0)
                 AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = u.id
                   AND r.state NOT IN ('draft', 'returned')))"
        )),
    }
    if let Some(text) = filter.q.as_deref().map(str::trim)
        && !text.is_empty()
    {
        let like = values.put(read::like(text));
        let fits = |column: &str| format!("{column} LIKE {like} ESCAPE '\\'");
        all.push(format!(
            "(EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.state <> 'draft' AND {})
              OR EXISTS (SELECT 1 FROM accepted a WHERE a.task = t.id AND {})
              OR EXISTS (SELECT 1 FROM motion m WHERE m.hash = t.source AND ({} OR {}))
              OR EXISTS (SELECT 1 FROM motion m WHERE m.hash = t.target AND ({} OR {}))
              OR {} OR {} OR {})",
            fits("r.words"),
            fits("a.words"),
            fits("lower(m.id)"),
            fits("lower(m.captions)"),
            fits("lower(m.id)"),
            fits("lower(m.captions)"),
            fits("lower(t.category)"),
            fits("lower(t.hint)"),
            fits("lower(t.style)"),
        ));
    }
    all.join(" AND ")
}

/// Checks a filter.
pub(super) fn check(filter: &TaskFilter) -> Result<(), Error> {
    const MAX_SEARCH: usize = 200;
    if let Some(part) = &filter.part
        && let Err(error) = part.parse::<datasets_spec::BodyPart>()
    {
        return Err(Error::invalid("part", error.to_string()));
    }
    if filter
        .q
        .as_ref()
        .is_some_and(|text| text.chars().count() > MAX_SEARCH)
    {
        return Err(Error::invalid(
            "q",
            format!("search for up to {MAX_SEARCH} characters"),
        ));
    }
    for (field, value) in [
        ("min_distance", filter.min_distance),
        ("max_distance", filter.max_distance),
    ] {
        if value.is_some_and(|value| !(0.0..=1.0).contains(&value)) {
            return Err(Error::invalid(field, "a distance is 0 to 1"));
        }
    }
    Ok(())
}

/// Which page of the browser.
#[derive(Clone, Debug, Default)]
pub struct PageQuery {
    /// Which tasks.
    pub filter: TaskFilter,
    /// Order.
    pub sort: Option<TaskSort>,
    /// The reverse order.
    pub reverse: bool,
    /// Cursor of the page before.
    pub after: Option<String>,
    /// Maximum number of rows.
    pub limit: usize,
}

/// A page of tasks. The cursor names the last row by its sort value and id, so that a late page is as fast as the first.
pub(super) fn page(tx: &mut dyn Tx, query: &PageQuery) -> Result<TaskPage, Error> {
    check(&query.filter)?;
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
        let bad = || Error::invalid("after", "this is no cursor of a page; begin at the first");
        let (value, id) = cursor.split_once(':').ok_or_else(bad)?;
        let id: i64 = id.parse().map_err(|_| bad())?;
        let value: Value = match sort {
            TaskSort::Distance => value.parse::<f64>().map_err(|_| bad())?.into(),
            TaskSort::Id | TaskSort::Touched => value.parse::<i64>().map_err(|_| bad())?.into(),
        };
        let (value, id) = (values.put(value), values.put(id));
        place += &format!(" AND ({column}, t.id) {comparison} ({value}, {id})");
    }
    let limit = values.put(query.limit as i64 + 1);
    let order = if sort == TaskSort::Id {
        format!("t.id {direction}")
    } else {
        format!("{column} {direction}, t.id {direction}")
    };
    let sql = format!(
        "SELECT {}, {column} FROM task t WHERE {place} ORDER BY {order} LIMIT {limit}",
        rows::TASK_COLUMNS
    );
    let mut found = tx.query(&sql, &values.0)?;
    let more = found.len() > query.limit;
    found.truncate(query.limit);
    let next = match found.last() {
        Some(last) if more => {
            let value = match sort {
                TaskSort::Distance => last.real(NUM_TASK_COLUMNS)?.to_string(),
                TaskSort::Id | TaskSort::Touched => last.int(NUM_TASK_COLUMNS)?.to_string(),
            };
            Some(format!("{value}:{}", last.int(0)?))
        }
        _ => None,
    };
    let total = match query.after {
        Some(_) => None,
        None => Some(count(tx, &query.filter)?),
    };
    let tasks = found
        .iter()
        .map(rows::read_task)
        .collect::<Result<_, _>>()?;
    Ok(TaskPage {
        rows: task_rows(tx, tasks)?,
        next,
        total,
        sort,
    })
}

fn count(tx: &mut dyn Tx, filter: &TaskFilter) -> Result<i64, Error> {
    let mut values = Values::default();
    let place = condition(filter, &mut values);
    tx.number(
        &format!("SELECT COUNT(*) FROM task t WHERE {place}"),
        &values.0,
    )
}

/// A row of the browser.
pub(super) fn task_row(tx: &mut dyn Tx, task: TaskRecord) -> Result<TaskRow, Error> {
    let row = task_rows(tx, vec![task])?.pop();
    row.ok_or_else(|| Error::not_found("task"))
}

/// What a query says about several tasks, by the task in its first column. The query reads the tasks of `{}`.
fn by_task<T>(
    tx: &mut dyn Tx,
    sql: &str,
    ids: &Values,
    read: impl Fn(&Row) -> Result<T, Error>,
) -> Result<BTreeMap<i64, Vec<T>>, Error> {
    let places: Vec<String> = (1..=ids.0.len()).map(|place| format!("?{place}")).collect();
    let mut all: BTreeMap<i64, Vec<T>> = BTreeMap::new();
    for row in tx.query(&sql.replace("{}", &places.join(", ")), &ids.0)? {
        all.entry(row.int(0)?).or_default().push(read(&row)?);
    }
    Ok(all)
}

/// Rows of the browser. Each table is read once for all of them.
fn task_rows(tx: &mut dyn Tx, tasks: Vec<TaskRecord>) -> Result<Vec<TaskRow>, Error> {
    if tasks.is_empty() {
        return Ok(Vec::new());
    }
    let ids = Values(tasks.iter().map(|task| task.id.into()).collect());
    let mut motions = by_task(
        tx,
        "SELECT t.id, s.id, o.id FROM task t LEFT JOIN motion s ON s.hash = t.source
         LEFT JOIN motion o ON o.hash = t.target WHERE t.id IN ({})",
        &ids,
        |row| Ok((row.opt_text(1)?, row.opt_text(2)?)),
    )?;
    let sql = format!(
        "SELECT {}, COALESCE(u.name, '') FROM revision r LEFT JOIN usr u ON u.id = r.author
         WHERE r.task IN ({{}}) AND r.state <> 'draft' ORDER BY r.at, r.author",
        rows::REVISION_COLUMNS
    );
    let mut answers = by_task(tx, &sql, &ids, |row| {
        let own = rows::read_revision(row, 0)?;
        let texts: Vec<&str> = own.answer.texts().iter().map(|(text, _)| *text).collect();
        Ok(AnswerBrief {
            author: own.author,
            name: row.string(7)?,
            state: own.state,
            text: texts.join(" · "),
            parts: own
                .answer
                .part_names()
                .into_iter()
                .map(str::to_owned)
                .collect(),
            verdict: own.answer.verdict(),
            edit_type: own.answer.edit_type(),
            at: own.at,
        })
    })?;
    let mut holders = by_task(
        tx,
        "SELECT l.task, l.id, l.usr, COALESCE(u.name, ''), l.purpose, l.expires
         FROM lease l LEFT JOIN usr u ON u.id = l.usr WHERE l.task IN ({}) ORDER BY l.id",
        &ids,
        |row| {
            Ok(Holder {
                lease: row.int(1)?,
                user: row.int(2)?,
                name: row.string(3)?,
                purpose: row.string(4)?,
                until: row.int(5)?,
            })
        },
    )?;
    let mut skips = by_task(
        tx,
        "SELECT s.task, s.usr, COALESCE(u.name, ''), s.postponed, s.reason, s.note, s.at
         FROM skip s LEFT JOIN usr u ON u.id = s.usr WHERE s.task IN ({}) ORDER BY s.at, s.usr",
        &ids,
        |row| {
            Ok(SkipBrief {
                user: row.int(1)?,
                name: row.string(2)?,
                postponed: row.flag(3)?,
                reason: row.opt_text(4)?.and_then(|text| SkipReason::parse(&text)),
                note: row.string(5)?,
                at: row.int(6)?,
            })
        },
    )?;
    let mut accepted = by_task(
        tx,
        "SELECT task, basis FROM accepted WHERE task IN ({})",
        &ids,
        |row| {
            // How it was accepted elsewhere cannot be undone here.
            let basis = row.text(1)?;
            let is_imported = basis.split(':').next() == Some(IMPORTED);
            Ok(if is_imported { IMPORTED } else { basis }.to_owned())
        },
    )?;
    let mut touched = by_task(
        tx,
        "SELECT id, touched FROM task WHERE id IN ({})",
        &ids,
        |row| row.int(1),
    )?;
    Ok(tasks
        .into_iter()
        .map(|task| {
            let id = &task.id;
            let motions = motions.remove(id).and_then(|mut one| one.pop());
            let (source, target) = motions.unwrap_or_default();
            TaskRow {
                answers: answers.remove(id).unwrap_or_default(),
                holders: holders.remove(id).unwrap_or_default(),
                skips: skips.remove(id).unwrap_or_default(),
                accepted_by: accepted.remove(id).and_then(|mut one| one.pop()),
                touched: touched
                    .remove(id)
                    .and_then(|mut one| one.pop())
                    .unwrap_or(0),
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

const DECISION_COLUMNS: &str =
    "v.seq, v.task, t.key, v.decision, v.reviewer, COALESCE(u.name, ''), v.author, v.rule,
  v.comment, v.at, t.state";

fn decision(tx: &mut dyn Tx, row: &Row) -> Result<DecisionRow, Error> {
    let (task, author) = (row.int(1)?, row.opt_int(6)?);
    let authors = tx
        .query(
            "SELECT COALESCE(u.name, '') FROM revision r LEFT JOIN usr u ON u.id = r.author
             WHERE r.task = ?1 AND r.state <> 'draft' AND (?2 = -1 OR r.author = ?2) ORDER BY r.author",
            params![task, author.unwrap_or(-1)],
        )?
        .iter()
        .map(|row| row.string(0))
        .collect::<Result<_, _>>()?;
    Ok(DecisionRow {
        seq: row.int(0)?,
        task,
        key: row.string(2)?,
        decision: row.string(3)?,
        reviewer: row.int(4)?,
        reviewer_name: row.string(5)?,
        author,
        authors,
        rule: row.opt_text(7)?,
        comment: row.string(8)?,
        at: row.int(9)?,
        state: rows::state(row.text(10)?)?,
    })
}

/// Decisions on a task, oldest first.
pub(super) fn decisions_on(tx: &mut dyn Tx, task: i64) -> Result<Vec<DecisionRow>, Error> {
    let sql = format!(
        "SELECT {DECISION_COLUMNS} FROM review v JOIN task t ON t.id = v.task LEFT JOIN usr u ON u.id = v.reviewer
         WHERE v.task = ?1 ORDER BY v.seq"
    );
    let found = tx.query(&sql, params![task])?;
    found.iter().map(|row| decision(tx, row)).collect()
}

/// Which decisions to list.
#[derive(Clone, Debug, Default)]
pub struct DecisionQuery {
    /// Of this reviewer.
    pub reviewer: Option<i64>,
    /// Of this kind: `accepted`, `merged`, `returned`, `dropped` or `reopened`.
    pub decision: Option<String>,
    /// Before this sequence number of the log.
    pub before: Option<i64>,
    /// Maximum number.
    pub limit: usize,
}

/// Decisions of people, newest first: what was sent back, to whom, and what became of it.
pub(super) fn decisions(tx: &mut dyn Tx, query: &DecisionQuery) -> Result<Decisions, Error> {
    let mut values = Values::default();
    let mut place = format!("v.seq < {}", values.put(query.before.unwrap_or(i64::MAX)));
    match query.reviewer {
        Some(reviewer) => place += &format!(" AND v.reviewer = {}", values.put(reviewer)),
        None => place += " AND v.reviewer <> 0",
    }
    if let Some(decision) = &query.decision {
        place += &format!(" AND v.decision = {}", values.put(decision));
    }
    let limit = values.put(query.limit as i64);
    let sql = format!(
        "SELECT {DECISION_COLUMNS} FROM review v JOIN task t ON t.id = v.task LEFT JOIN usr u ON u.id = v.reviewer
         WHERE {place} ORDER BY v.seq DESC LIMIT {limit}"
    );
    let found = tx.query(&sql, &values.0)?;
    let items: Vec<DecisionRow> = found
        .iter()
        .map(|row| decision(tx, row))
        .collect::<Result<_, _>>()?;
    let next = (items.len() == query.limit)
        .then(|| items.last().map(|item| item.seq))
        .flatten();
    Ok(Decisions { items, next })
}

/// Checks a bulk request. A preview needs no comment.
fn check_bulk(tx: &mut dyn Tx, request: &BulkRequest, act: bool) -> Result<(), Error> {
    check(&request.filter)?;
    if request.comment.chars().count() > MAX_TEXT_CHARS {
        return Err(Error::invalid("comment", "the comment is too long"));
    }
    let needs_comment = matches!(
        request.action,
        BulkAction::Return | BulkAction::Drop | BulkAction::Reopen
    );
    if act && needs_comment && request.comment.trim().is_empty() {
        return Err(Error::invalid(
            "comment",
            "write a comment; the authors and the log need it",
        ));
    }
    match (request.action, request.person) {
        (BulkAction::Assign, None) => Err(Error::invalid(
            "person",
            "name the person to give the tasks to",
        )),
        (BulkAction::Assign, Some(person)) => {
            let active = tx.number(
                "SELECT COUNT(*) FROM usr WHERE id = ?1 AND active = 1",
                params![person],
            )?;
            if active == 0 {
                return Err(Error::invalid(
                    "person",
                    format!("there is no active user {person}"),
                ));
            }
            Ok(())
        }
        (_, Some(_)) => Err(Error::invalid(
            "person",
            "only the action assign has a person",
        )),
        (_, None) => Ok(()),
    }
}

/// Looks at tasks of a filter, and acts on them if `act` is set. Without it all tasks are counted.
pub(super) fn bulk(
    tx: &mut dyn Tx,
    who: &Who,
    request: &BulkRequest,
    act: bool,
    now: Millis,
) -> Result<BulkDone, Error> {
    check_bulk(tx, request, act)?;
    let settings = project::settings(tx)?;
    let mut values = Values::default();
    let place = condition(&request.filter, &mut values);
    let after = values.put(request.after.unwrap_or(0));
    let limit = values.put(if act { BULK_AT_ONCE } else { i64::MAX });
    let me = values.put(who.id);
    let sql = format!(
        "SELECT {}, (SELECT COUNT(*) FROM lease l WHERE l.task = t.id AND l.purpose = 'review' AND l.usr <> {me}),
           (SELECT COUNT(*) FROM revision r WHERE r.task = t.id AND r.author = {me} AND r.state <> 'draft')
         FROM task t WHERE {place} AND t.id > {after} ORDER BY t.id LIMIT {limit}",
        rows::TASK_COLUMNS
    );
    let found = tx.query(&sql, &values.0)?;
    let mut done = BulkDone {
        looked_at: found.len() as i64,
        ..BulkDone::default()
    };
    let mut last = None;
    for row in &found {
        let one = One {
            task: rows::read_task(row)?,
            held: row.flag(NUM_TASK_COLUMNS)?,
            own: row.flag(NUM_TASK_COLUMNS + 1)?,
        };
        let id = one.task.id;
        match planned(tx, who, request, &settings, &one, now)? {
            Ok(body) => {
                done.done += 1;
                if act {
                    let entry = Entry {
                        at: now,
                        actor: Some(who.id),
                        task: Some(id),
                        epoch: None,
                        body,
                    };
                    log::note(tx, &entry)?;
                }
            }
            Err(reason) => *done.left_alone.entry(reason.to_owned()).or_default() += 1,
        }
        last = Some(id);
    }
    done.next = last.filter(|_| act && done.looked_at == BULK_AT_ONCE);
    Ok(done)
}

/// A task of a bulk action.
struct One {
    task: TaskRecord,
    /// Whether another reviewer looks at it.
    held: bool,
    /// Whether the actor answered it.
    own: bool,
}

/// What a bulk action does to a task, or why it leaves the task alone.
fn planned(
    tx: &mut dyn Tx,
    who: &Who,
    request: &BulkRequest,
    settings: &Settings,
    one: &One,
    now: Millis,
) -> Result<Result<Body, &'static str>, Error> {
    let One { task, held, own } = one;
    let comment = request.comment.trim().to_owned();
    let empty = String::new();
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
    if *own && !settings.solo && request.action != BulkAction::Assign {
        return Ok(Err("own_work"));
    }
    let body = match request.action {
        BulkAction::Accept => {
            let answers = rules::waiting_answers(tx, task.id)?;
            let all: Vec<_> = answers.iter().map(|own| own.answer.clone()).collect();
            if answer::spread(&all).is_some_and(|distance| distance > 0.0) {
                return Ok(Err("answers_differ"));
            }
            let Some(first) = answers.first() else {
                return Ok(Err("wrong_state"));
            };
            Body::Accepted {
                author: first.author,
                comment,
                secs: 0.0,
                request: empty,
                rule: None,
                own: *own && first.author == who.id,
            }
        }
        BulkAction::Return => {
            let answers = rules::waiting_answers(tx, task.id)?;
            Body::Returned {
                authors: answers.iter().map(|own| own.author).collect(),
                comment,
                until: now + Millis::from(settings.returned_days) * DAY,
                secs: 0.0,
                request: empty,
            }
        }
        BulkAction::Drop => Body::Dropped {
            comment,
            secs: 0.0,
            request: empty,
        },
        BulkAction::Reopen => Body::Reopened {
            comment,
            request: empty,
            rule: None,
        },
        BulkAction::Assign => {
            let person = request.person.unwrap_or(0);
            let row = tx.one(
                "SELECT t.wanted - t.submitted - (SELECT COUNT(*) FROM lease l WHERE l.task = t.id AND l.purpose = 'annotate'),
                   (SELECT COUNT(*) FROM lease l WHERE l.task = t.id AND l.usr = ?2),
                   (SELECT COUNT(*) FROM revision r WHERE r.task = t.id AND r.author = ?2
                      AND r.state NOT IN ('draft', 'returned'))
                 FROM task t WHERE t.id = ?1",
                params![task.id, person],
            )?;
            let row = row.ok_or_else(|| Error::not_found("task"))?;
            if row.int(1)? > 0 {
                return Ok(Err("held"));
            }
            if row.int(2)? > 0 {
                return Ok(Err("answered"));
            }
            if row.int(0)? <= 0 {
                return Ok(Err("task_full"));
            }
            Body::Assigned {
                user: person,
                until: now + Millis::from(settings.returned_days) * DAY,
            }
        }
    };
    Ok(Ok(body))
}
