//! The task browser, bulk actions, decisions, and my answers.

use axum::response::Response;

use super::review::candidates_of;
use super::tasks::offered;
use crate::Error;
use crate::http::app::{Context, json, page_size, parse_query};
use crate::store::{DecisionQuery, MineQuery, PageQuery};
use crate::wire::{Code, MyAnswers, TaskFile};

/// Rows per page.
const ROWS: usize = 200;
/// Answers or decisions per page.
const ITEMS: usize = 50;
/// Decisions by their names in the log.
const DECISIONS: [&str; 5] = ["accepted", "merged", "returned", "dropped", "reopened"];

pub(super) fn tasks(cx: &Context) -> Result<Response, Error> {
    // The other parameters are the filter.
    let of_page = |pair: &&str| {
        let name = pair.split('=').next();
        name.is_some_and(|name| ["sort", "reverse", "after", "limit"].contains(&name))
    };
    let query = cx.uri.query().unwrap_or("").split('&');
    let (page, filter): (Vec<&str>, Vec<&str>) = query.partition(of_page);
    let page: PageQuery = parse_query(&page.join("&"))?;
    json(&cx.store().browse(PageQuery {
        filter: parse_query(&filter.join("&"))?,
        limit: page_size(page.limit, ROWS),
        ..page
    })?)
}

pub(super) fn task(cx: &Context) -> Result<Response, Error> {
    let (id, store) = (cx.id()?, cx.store());
    let (row, decisions) = store.task_row(id)?;
    let task = store.task_record(id)?;
    json(&TaskFile {
        suggestions: offered(&cx.app, &task, store.suggestions_of(id)?)?,
        task: store.view(task, None)?,
        row,
        answers: candidates_of(cx, store.answers_to(id)?)?,
        accepted: store.accepted_answer(id)?,
        decisions,
    })
}

pub(super) fn decisions(cx: &Context) -> Result<Response, Error> {
    let mut query: DecisionQuery = cx.query()?;
    if let Some(name) = &query.decision
        && !DECISIONS.contains(&name.as_str())
    {
        let problem = format!("decision {name:?} is not known");
        return Err(Error::refused(Code::BadRequest, problem));
    }
    query.limit = page_size(query.limit, ITEMS);
    json(&cx.store().decisions(query)?)
}

pub(super) fn mine(cx: &Context) -> Result<Response, Error> {
    let mut query: MineQuery = cx.query()?;
    query.limit = page_size(query.limit, ITEMS);
    let (items, next) = cx.store().answers_of(cx.user()?, query, cx.now)?;
    json(&MyAnswers { items, next })
}
