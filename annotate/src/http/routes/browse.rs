//! The task browser, bulk actions, decisions, and my answers.

use super::review::candidates_of;
use super::tasks::{offered, task_of};
use crate::Error;
use crate::http::app::{Context, Reply, json};
use crate::store::{DecisionQuery, MineQuery, PageQuery};
use crate::wire::{
    BulkRequest, Code, EditType, MyAnswer, MyAnswers, SkipFilter, Standing, TaskFile, TaskFilter,
    TaskKind, TaskSort, TaskState, Verdict,
};

/// Rows of a page.
const ROWS: i64 = 200;
/// Answers or decisions of a page.
const ITEMS: i64 = 50;
/// Decisions by their names in the log.
const DECISIONS: [&str; 5] = ["accepted", "merged", "returned", "dropped", "reopened"];

pub(super) fn tasks(cx: &Context) -> Result<Reply, Error> {
    cx.only(&[
        "kind",
        "state",
        "q",
        "person",
        "part",
        "edit_type",
        "verdict",
        "category",
        "split",
        "min_distance",
        "max_distance",
        "skipped",
        "rule",
        "task",
        "sort",
        "reverse",
        "after",
        "limit",
    ])?;
    let text = |name: &str| {
        let text = cx.query.get(name).map(|text| text.trim().to_owned());
        text.filter(|text| !text.is_empty())
    };
    let number = |name: &str| -> Result<Option<f64>, Error> {
        text(name)
            .map(|text| {
                text.parse().map_err(|_| {
                    Error::refused(
                        Code::BadRequest,
                        format!("{name} is {text:?}, not a number"),
                    )
                })
            })
            .transpose()
    };
    let filter = TaskFilter {
        kind: cx.one_of("kind", TaskKind::parse)?,
        state: cx.one_of("state", TaskState::parse)?,
        q: text("q"),
        person: cx.number("person")?,
        part: text("part"),
        edit_type: cx.one_of("edit_type", EditType::parse)?,
        verdict: cx.one_of("verdict", Verdict::parse)?,
        category: text("category"),
        split: text("split"),
        min_distance: number("min_distance")?,
        max_distance: number("max_distance")?,
        skipped: cx.one_of("skipped", SkipFilter::parse)?,
        rule: text("rule"),
        task: cx.number("task")?,
    };
    json(&cx.app.store.browse(PageQuery {
        filter,
        sort: cx.one_of("sort", TaskSort::parse)?,
        reverse: cx.number("reverse")?.unwrap_or(0) != 0,
        after: text("after"),
        limit: cx.limit(ROWS)?,
    })?)
}

pub(super) fn task(cx: &Context) -> Result<Reply, Error> {
    let id = cx.id()?;
    let (row, decisions) = cx.app.store.task_row(id)?;
    let task = cx.app.store.task_record(id)?;
    json(&TaskFile {
        suggestions: offered(&cx.app, &task, cx.app.store.suggestions_of(id)?)?,
        task: task_of(&cx.app, task, None)?,
        row,
        answers: candidates_of(cx, cx.app.store.answers_to(id)?)?,
        accepted: cx.app.store.accepted_answer(id)?,
        decisions,
    })
}

pub(super) fn decisions(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["reviewer", "decision", "before", "limit"])?;
    let known = |text: &str| DECISIONS.iter().find(|known| **known == text).copied();
    json(&cx.app.store.decisions(DecisionQuery {
        reviewer: cx.number("reviewer")?,
        decision: cx.one_of("decision", known)?.map(str::to_owned),
        before: cx.number("before")?,
        limit: cx.limit(ITEMS)?,
    })?)
}

pub(super) fn preview(cx: &Context) -> Result<Reply, Error> {
    let request: BulkRequest = cx.body()?;
    json(&cx.app.store.preview_bulk(cx.who()?, request, cx.now)?)
}

pub(super) fn bulk(cx: &Context) -> Result<Reply, Error> {
    let request: BulkRequest = cx.body()?;
    json(&cx.app.store.bulk(cx.who()?, request, cx.now)?)
}

pub(super) fn mine(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["standing", "kind", "task", "before", "limit"])?;
    let query = MineQuery {
        task: cx.number("task")?,
        standing: cx.one_of("standing", Standing::parse)?,
        kind: cx.one_of("kind", TaskKind::parse)?,
        before: cx
            .query
            .get("before")
            .filter(|text| !text.is_empty())
            .cloned(),
        limit: cx.limit(ITEMS)?,
    };
    let (found, next) = cx.app.store.answers_of(cx.who()?.id, query, cx.now)?;
    let items = found
        .into_iter()
        .map(|own| {
            let task = task_of(&cx.app, own.task, None)?;
            Ok(MyAnswer {
                missing: if own.standing == Standing::WaitsForOthers {
                    task.wanted.saturating_sub(task.submitted)
                } else {
                    0
                },
                task,
                mine: own.mine,
                standing: own.standing,
                comment: own.comment,
                accepted: own.accepted,
                accepted_by: own.accepted_by,
                can_take_back: own.can_take_back,
                until: own.until,
                feedback: own.feedback,
            })
        })
        .collect::<Result<_, Error>>()?;
    json(&MyAnswers { items, next })
}
