//! The guide and its pictures.

use axum::body::Body;
use axum::http::header;
use axum::response::Response;

use crate::Error;
use crate::http::app::{Context, Reply, json, set};
use crate::wire::{Guide, KindGuide, TaskKind};

fn kind_of(cx: &Context) -> Result<TaskKind, Error> {
    TaskKind::parse(cx.param("kind")).ok_or_else(|| Error::not_found("kind of task"))
}

pub(super) fn guide(cx: &Context) -> Result<Reply, Error> {
    let settings = cx.app.store.settings()?;
    json(&Guide {
        text: settings.guide,
        kinds: settings.guides,
        forms: TaskKind::ALL
            .iter()
            .map(|&kind| (kind, kind.text_form()))
            .collect(),
    })
}

pub(super) fn put_guide(cx: &Context) -> Result<Reply, Error> {
    let (kind, guide): (TaskKind, KindGuide) = (kind_of(cx)?, cx.body()?);
    let mut settings = cx.app.store.settings()?;
    settings.guides.insert(kind, guide.clone());
    cx.app.store.put_settings(cx.who()?.id, settings, cx.now)?;
    json(&guide)
}

pub(super) fn pictures(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.pictures()?)
}

pub(super) fn picture(cx: &Context) -> Result<Reply, Error> {
    let picture = cx.app.store.picture(cx.param("name"))?;
    let mut response = Response::new(Body::from(picture.bytes));
    set(&mut response, header::CONTENT_TYPE, &picture.mime);
    set(&mut response, header::CACHE_CONTROL, "private, no-cache");
    Ok(Reply::Full(response))
}

pub(super) fn put_picture(cx: &Context) -> Result<Reply, Error> {
    let (name, who) = (cx.param("name"), cx.who()?.id);
    json(
        &cx.app
            .store
            .put_picture(who, name, cx.body.to_vec(), cx.now)?,
    )
}

pub(super) fn delete_picture(cx: &Context) -> Result<Reply, Error> {
    cx.app
        .store
        .delete_picture(cx.who()?.id, cx.param("name"), cx.now)?;
    Ok(Reply::Empty)
}
