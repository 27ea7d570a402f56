//! Health, metrics, and the files of the front end.

use axum::body::Body;
use axum::http::header;
use axum::response::Response;

use crate::Error;
use crate::http::app::{Context, Reply, set, text};
use crate::http::{assets, compress};
use crate::lock::lock;
use crate::wire::Code;

fn plain(text: String) -> Reply {
    let mut response = Response::new(Body::from(text));
    set(
        &mut response,
        header::CONTENT_TYPE,
        "text/plain; charset=utf-8",
    );
    set(&mut response, header::CACHE_CONTROL, "no-store");
    Reply::Full(response)
}

/// Whether the process runs.
pub(super) fn healthy(_: &Context) -> Result<Reply, Error> {
    Ok(plain("ok\n".to_owned()))
}

/// Whether answers can be saved. It writes nothing: everybody may ask, as often as they like.
pub(super) fn ready(cx: &Context) -> Result<Reply, Error> {
    if let Some(reason) = lock(&cx.app.read_only).clone() {
        return Err(Error::refused(Code::ReadOnly, reason));
    }
    cx.app.store.ready()?;
    Ok(plain("ready\n".to_owned()))
}

/// Figures for Prometheus.
pub(super) fn metrics(cx: &Context) -> Result<Reply, Error> {
    let leases = cx.app.store.leases(cx.now)?.len() as i64;
    let gauges = [
        (
            "annotate_log_entries",
            "Entries of the log.",
            cx.app.store.last_seq()?,
        ),
        ("annotate_leases", "Leases held, up to a thousand.", leases),
        (
            "annotate_motions",
            "Motions of the dataset.",
            cx.app.motions.len() as i64,
        ),
        (
            "annotate_read_only",
            "Whether the store accepts no writes.",
            i64::from(lock(&cx.app.read_only).is_some()),
        ),
    ];
    Ok(plain(cx.app.metrics.text(&gauges)))
}

pub(super) fn asset(cx: &Context) -> Result<Reply, Error> {
    let packed = compress::accepts_gzip(&cx.headers);
    let asset = assets::find(&cx.path, packed).ok_or_else(|| Error::not_found("file"))?;
    let known = text(&cx.headers, &header::IF_NONE_MATCH) == Some(asset.etag.as_str());
    let mut response = Response::new(if known {
        Body::empty()
    } else {
        Body::from(asset.bytes)
    });
    if known {
        *response.status_mut() = axum::http::StatusCode::NOT_MODIFIED;
    }
    set(&mut response, header::CONTENT_TYPE, asset.mime);
    set(&mut response, header::CACHE_CONTROL, "no-cache");
    set(&mut response, header::ETAG, &asset.etag);
    compress::vary(&mut response);
    if asset.is_packed && !known {
        compress::mark(&mut response);
    }
    Ok(Reply::Full(response))
}
