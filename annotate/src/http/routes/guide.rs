//! The guide and its pictures.

use axum::response::Response;

use crate::Error;
use crate::http::app::{Context, content, empty, json};
use crate::wire::{Guide, GuideChange, TaskKind};

pub(super) fn guide(cx: &Context) -> Result<Response, Error> {
    let settings = cx.store().settings()?;
    json(&Guide {
        text: settings.guide,
        kinds: settings.guides,
        forms: TaskKind::ALL
            .iter()
            .map(|&kind| (kind, kind.text_form()))
            .collect(),
    })
}

pub(super) fn put_guide(cx: &Context) -> Result<Response, Error> {
    let kind = TaskKind::parse(cx.param("kind")).ok_or_else(|| Error::not_found("kind of task"))?;
    let change: GuideChange = cx.body()?;
    let guide = change.now.clone();
    cx.store().change_guide(cx.user()?, kind, change, cx.now)?;
    json(&guide)
}

pub(super) fn picture(cx: &Context) -> Result<Response, Error> {
    let (mime, bytes) = cx.store().picture(cx.param("name"))?;
    Ok(content(&mime, "private, no-cache", bytes))
}

pub(super) fn put_picture(cx: &Context) -> Result<Response, Error> {
    let (user, name, bytes) = (cx.user()?, cx.param("name"), cx.body.to_vec());
    json(&cx.store().put_picture(user, name, bytes, cx.now)?)
}

pub(super) fn delete_picture(cx: &Context) -> Result<Response, Error> {
    let (user, name) = (cx.user()?, cx.param("name"));
    cx.store()
        .delete_picture(user, name, cx.now)
        .and_then(empty)
}
