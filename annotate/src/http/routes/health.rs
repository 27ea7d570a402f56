//! Health, metrics, and the files of the front end.

use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};

use crate::Error;
use crate::http::app::{Context, content, text};
use crate::http::assets;
use crate::lock::lock;
use crate::wire::Code;

fn plain(text: impl Into<String>) -> Response {
    content("text/plain; charset=utf-8", "no-store", text.into())
}

/// Whether the process runs.
pub(super) fn healthy(_: &Context) -> Result<Response, Error> {
    Ok(plain("ok\n"))
}

/// Whether answers can be saved. The check writes nothing: anybody may call it at any rate.
pub(super) fn ready(cx: &Context) -> Result<Response, Error> {
    if let Some(reason) = lock(&cx.app.read_only).clone() {
        return Err(Error::refused(Code::ReadOnly, reason));
    }
    cx.store().ready()?;
    Ok(plain("ready\n"))
}

/// Figures for Prometheus.
pub(super) fn metrics(cx: &Context) -> Result<Response, Error> {
    let entries = cx.store().last_seq()?;
    let leases = cx.store().leases(cx.now)?.len() as i64;
    let motions = cx.app.motions.len() as i64;
    let read_only = i64::from(lock(&cx.app.read_only).is_some());
    let gauges = [
        ("annotate_log_entries", "Entries of the log.", entries),
        ("annotate_leases", "Leases held, up to a thousand.", leases),
        ("annotate_motions", "Motions of the dataset.", motions),
        (
            "annotate_read_only",
            "Whether the store accepts no writes.",
            read_only,
        ),
    ];
    Ok(plain(cx.app.metrics.text(&gauges)))
}

/// A file of the front end.
pub(super) fn asset(cx: &Context) -> Result<Response, Error> {
    let asset = assets::find(cx.uri.path()).ok_or_else(|| Error::not_found("file"))?;
    let etag = asset.etag();
    let is_known = text(&cx.headers, &header::IF_NONE_MATCH) == Some(etag.as_str());
    if is_known {
        // The headers for caches are those of the whole file (RFC 9110, section 15.4.5).
        let headers = [
            (header::ETAG, etag.as_str()),
            (header::CACHE_CONTROL, "no-cache"),
            (header::VARY, "accept-encoding"),
        ];
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    let file = content(asset.mime, "no-cache", asset.bytes);
    Ok(([(header::ETAG, etag)], file).into_response())
}
