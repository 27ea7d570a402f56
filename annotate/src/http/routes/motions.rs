//! Motions, differences of pairs, and blends for the viewer.

use axum::body::Body;
use axum::http::header;
use axum::response::Response;

use super::tasks::motion_info;
use crate::Error;
use crate::http::app::{Context, Reply, json, set};
use crate::mask::{check_names, known_parts, mask_of};
use crate::motions::row_bytes;
use crate::wire::{BlendRequest, Code, MotionInfo};

fn binary(bytes: Vec<u8>, lasting: bool) -> Reply {
    let mut response = Response::new(Body::from(bytes));
    set(
        &mut response,
        header::CONTENT_TYPE,
        "application/octet-stream",
    );
    let cache = if lasting {
        "private, max-age=31536000, immutable"
    } else {
        "no-store"
    };
    set(&mut response, header::CACHE_CONTROL, cache);
    Reply::Full(response)
}

pub(super) fn joints(cx: &Context) -> Result<Reply, Error> {
    Ok(binary(cx.app.motions.joints(cx.param("hash"))?, true))
}

pub(super) fn heat(cx: &Context) -> Result<Reply, Error> {
    Ok(binary(
        row_bytes(&cx.app.motions.heat(cx.param("hash"))?),
        true,
    ))
}

pub(super) fn partners(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["of", "n"])?;
    let n = usize::try_from(cx.number("n")?.unwrap_or(8).clamp(1, 50)).unwrap_or(8);
    let hash = cx.query.get("of").map_or("", String::as_str);
    let found: Vec<MotionInfo> = cx
        .app
        .store
        .partners(hash, n)?
        .into_iter()
        .map(motion_info)
        .collect();
    json(&found)
}

pub(super) fn difference(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["align"])?;
    let stretch = match cx.query.get("align").map(String::as_str) {
        None | Some("none") => false,
        Some("stretch") => true,
        Some(other) => {
            return Err(Error::refused(
                Code::BadRequest,
                format!("align {other:?} is not known; use none or stretch"),
            ));
        }
    };
    let detail = cx.app.store.task(cx.who()?, cx.id()?)?;
    let target = detail
        .task
        .target
        .ok_or_else(|| Error::invalid("id", "this task has one motion, not two"))?;
    let rows = cx
        .app
        .motions
        .difference(&detail.task.source, &target, stretch)?;
    Ok(binary(row_bytes(&rows), false))
}

pub(super) fn blend(cx: &Context) -> Result<Reply, Error> {
    let request: BlendRequest = cx.body()?;
    if !(0.0..=1.0).contains(&request.alpha) {
        return Err(Error::invalid(
            "alpha",
            "the weight of the soft ring must be 0 to 1",
        ));
    }
    if known_parts(&request.parts).len() != request.parts.len() || request.parts.is_empty() {
        return Err(Error::invalid(
            "parts",
            "name the parts to take from the other motion",
        ));
    }
    check_names(&request.joints).map_err(|problem| Error::invalid("joints", problem))?;
    let mask = mask_of(&request.parts, request.soft, &request.joints);
    let bytes = cx
        .app
        .motions
        .blend(&request.src, &request.tgt, mask, request.alpha)?;
    Ok(binary(bytes, false))
}
