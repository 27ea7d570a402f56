//! Motions, differences of pairs, and blends for the viewer.

use axum::response::Response;
use serde::Deserialize;

use crate::error::{Error, require};
use crate::http::app::{Context, binary, content, json};
use crate::mask::{check_names, known_parts, mask_of};
use crate::motions::row_bytes;
use crate::wire::{BlendRequest, MotionInfo};

/// Positions of a motion, found by its hash. They never change, so caches may keep them.
pub(super) fn joints(cx: &Context) -> Result<Response, Error> {
    let bytes = cx.app.motions.joints(cx.param("hash"))?;
    let cache = "private, max-age=31536000, immutable";
    Ok(content("application/octet-stream", cache, bytes))
}

/// Activity of a motion. It is relative to the other clips of the dataset, which may change.
pub(super) fn heat(cx: &Context) -> Result<Response, Error> {
    Ok(binary(row_bytes(&cx.app.motions.heat(cx.param("hash"))?)))
}

/// The query of `motions/partners`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Partners {
    #[serde(default)]
    of: String,
    n: Option<usize>,
}

pub(super) fn partners(cx: &Context) -> Result<Response, Error> {
    let Partners { of, n } = cx.query()?;
    let found = cx.store().partners(&of, n.unwrap_or(8).clamp(1, 50))?;
    let found: Vec<MotionInfo> = found.into_iter().map(MotionInfo::from).collect();
    json(&found)
}

/// Alignment of two motions that are compared.
#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Align {
    None,
    Stretch,
}

/// The query of `pairs/{id}/diff`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Compared {
    align: Option<Align>,
}

pub(super) fn difference(cx: &Context) -> Result<Response, Error> {
    let Compared { align } = cx.query()?;
    let task = cx.store().task(cx.who()?, cx.id()?)?.task;
    let target = task
        .target
        .ok_or_else(|| Error::invalid("id", "this task has one motion, not two"))?;
    let stretch = matches!(align, Some(Align::Stretch));
    let rows = cx.app.motions.difference(&task.source, &target, stretch)?;
    Ok(binary(row_bytes(&rows)))
}

pub(super) fn blend(cx: &Context) -> Result<Response, Error> {
    let request: BlendRequest = cx.body()?;
    let is_share = (0.0..=1.0).contains(&request.alpha);
    let problem = "the weight of the soft ring must be 0 to 1";
    require(is_share, "alpha", problem)?;
    let count = request.parts.len();
    let are_known = count > 0 && known_parts(&request.parts).len() == count;
    let problem = "name the parts to take from the other motion";
    require(are_known, "parts", problem)?;
    check_names(&request.joints).map_err(|problem| Error::invalid("joints", problem))?;
    let mask = mask_of(&request.parts, request.soft, &request.joints);
    let (source, target) = (&request.src, &request.tgt);
    let bytes = cx.app.motions.blend(source, target, mask, request.alpha)?;
    Ok(binary(bytes))
}
