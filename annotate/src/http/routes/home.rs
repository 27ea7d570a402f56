//! The home page, preferences, and the shelf of accepted answers.

use super::dashboard::figures;
use super::tasks::task_of;
use crate::Error;
use crate::body::skeleton_info;
use crate::http::app::{Context, Reply, json};
use crate::store::{AcceptedAnswer, ShelfFilter};
use crate::wire::{Prefs, Shelf, ShelfItem, TaskKind};

pub(super) fn prefs(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.prefs(cx.who()?.id)?)
}

pub(super) fn put_prefs(cx: &Context) -> Result<Reply, Error> {
    let prefs: Prefs = cx.body()?;
    cx.app.store.put_prefs(cx.who()?.id, prefs.clone())?;
    json(&prefs)
}

pub(super) fn skeleton(_: &Context) -> Result<Reply, Error> {
    json(&skeleton_info())
}

pub(super) fn home(cx: &Context) -> Result<Reply, Error> {
    let who = cx.who()?;
    let mut home = cx.app.store.home(who.id, cx.now)?;
    home.agreement = figures(&cx.app, cx.now)?
        .people
        .get(&who.id)
        .and_then(|person| person.agreement);
    json(&home)
}

pub(super) fn shelf(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["kind", "part", "q", "before", "limit"])?;
    let limit = cx.limit(50)?;
    let filter = ShelfFilter {
        kind: cx.one_of("kind", TaskKind::parse)?,
        part: cx
            .one_of("part", |text| text.parse::<datasets_spec::BodyPart>().ok())?
            .map(|part| part.name().to_owned()),
        text: cx
            .query
            .get("q")
            .filter(|text| !text.trim().is_empty())
            .cloned(),
        before: cx.number("before")?,
        limit,
    };
    let found: Vec<AcceptedAnswer> = cx.app.store.shelf(cx.who()?.id, filter)?;
    let next = (found.len() == limit)
        .then(|| found.last().map(|answer| answer.seq))
        .flatten();
    let items = found
        .into_iter()
        .map(|found| {
            Ok(ShelfItem {
                task: task_of(&cx.app, found.task, None)?,
                answer: found.answer,
                at: found.at,
            })
        })
        .collect::<Result<_, Error>>()?;
    json(&Shelf { items, next })
}
