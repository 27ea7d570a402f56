//! The home page, preferences, and the shelf of accepted answers.

use axum::response::Response;
use datasets_spec::BodyPart;

use super::dashboard::figures;
use crate::Error;
use crate::http::app::{Context, json, page_size};
use crate::store::{AcceptedAnswer, ShelfFilter};
use crate::wire::{Code, Prefs, Shelf, ShelfItem};

pub(super) fn put_prefs(cx: &Context) -> Result<Response, Error> {
    let prefs: Prefs = cx.body()?;
    cx.store().put_prefs(cx.user()?, prefs.clone())?;
    json(&prefs)
}

pub(super) fn home(cx: &Context) -> Result<Response, Error> {
    let user = cx.user()?;
    let mut home = cx.store().home(user, cx.now)?;
    let figures = figures(cx)?;
    home.agreement = figures.people.get(&user).and_then(|own| own.agreement);
    json(&home)
}

pub(super) fn shelf(cx: &Context) -> Result<Response, Error> {
    let mut filter: ShelfFilter = cx.query()?;
    if let Some(name) = &filter.part {
        name.parse::<BodyPart>()
            .map_err(|error| Error::refused(Code::BadRequest, error.to_string()))?;
    }
    let limit = page_size(filter.limit, 50);
    filter.limit = limit;
    let found: Vec<AcceptedAnswer> = cx.store().shelf(cx.user()?, filter)?;
    let last = found.last().map(|answer| answer.seq);
    let next = last.filter(|_| found.len() == limit);
    let items = found
        .into_iter()
        .map(|found| {
            Ok(ShelfItem {
                task: cx.store().view(found.task, None)?,
                answer: found.answer,
                at: found.at,
            })
        })
        .collect::<Result<_, Error>>()?;
    json(&Shelf { items, next })
}
