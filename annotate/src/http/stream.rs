//! Server-sent events: log entries as they are written.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::http::HeaderName;
use axum::http::header::CACHE_CONTROL;
use axum::response::sse::{Event, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use tokio::sync::mpsc;

use super::app::{App, Context, blocking, credential, text};
use crate::Error;
use crate::store::{Store, TokenUse};
use crate::wire::{Change, Code, Role};

/// Interval at which the log is polled while clients are connected. Another server on the same store cannot notify this
/// one.
const LOOK: Duration = Duration::from_millis(300);
/// How often a comment is sent, so that proxies keep the connection open.
const BEAT: Duration = Duration::from_secs(15);
/// Maximum number of concurrent listeners.
const LISTENERS: usize = 200;
/// Maximum number of missed entries sent after a reconnect.
const MISSED: i64 = 1000;
/// Entries read at a time.
const BATCH: usize = 200;

/// Polls the end of the log for all listeners.
pub(super) async fn watch(app: Arc<App>) {
    loop {
        tokio::time::sleep(LOOK).await;
        if app.last_seq.receiver_count() == 0 {
            continue;
        }
        let store = Arc::clone(&app.store);
        // Skip this poll if the store does not answer.
        if let Ok(seq) = blocking(move || store.last_seq()).await {
            app.last_seq
                .send_if_modified(|known| std::mem::replace(known, seq) != seq);
        }
    }
}

/// Opens a stream of new events, or of events after the last one that the client received.
pub(super) fn open(cx: &Context) -> Result<Response, Error> {
    let app = Arc::clone(&cx.app);
    let login = credential(&app, &cx.headers)?;
    if app.last_seq.receiver_count() >= LISTENERS {
        let problem = format!("{LISTENERS} pages are already connected; reload later");
        return Err(Error::refused(Code::RateLimited, problem));
    }
    let newest = app.store.last_seq()?;
    let from = text(&cx.headers, &HeaderName::from_static("last-event-id"));
    let (sender, receiver) = mpsc::channel(16);
    let start = match from.and_then(|seq| seq.parse::<i64>().ok()) {
        Some(from) if newest - from > MISSED || from > newest => {
            // The channel has capacity for the first event.
            let _sent = sender.try_send(Event::default().event("reset").data("{}"));
            newest
        }
        Some(from) => from,
        None => newest,
    };
    tokio::spawn(listen(app, login, start, sender));
    let events = stream::unfold(receiver, |mut receiver| async move {
        let event = receiver.recv().await?;
        Some((Ok::<_, Infallible>(event), receiver))
    });
    // Without this header, proxies such as nginx buffer the events.
    let buffering = HeaderName::from_static("x-accel-buffering");
    let headers = [(CACHE_CONTROL, "no-store"), (buffering, "no")];
    Ok((headers, Sse::new(events)).into_response())
}

/// Sends new entries until the listener disconnects, is no reviewer any more, or their token or session ends.
async fn listen(
    app: Arc<App>,
    login: (String, TokenUse),
    mut after: i64,
    sender: mpsc::Sender<Event>,
) -> Option<()> {
    let mut news = app.last_seq.subscribe();
    let comment = |text| Event::default().comment(text);
    sender.send(comment("connected")).await.ok()?;
    loop {
        let (app, (token, purpose)) = (Arc::clone(&app), login.clone());
        let work = move || {
            let who = app.store.recognise(&token, purpose, app.now())?;
            let may = who.role >= Role::Reviewer;
            may.then(|| changes(&app.store, after)).transpose()
        };
        let (seq, events) = blocking(work).await.ok()??;
        let more = seq - after >= BATCH as i64;
        after = seq;
        for event in events {
            sender.send(event).await.ok()?;
        }
        if more {
            continue;
        }
        match tokio::time::timeout(BEAT, news.changed()).await {
            Ok(changed) => changed.ok()?,
            Err(_) => sender.send(comment("beat")).await.ok()?,
        }
    }
}

/// Log entries after a sequence number, and the last number read.
fn changes(store: &Store, after: i64) -> Result<(i64, Vec<Event>), Error> {
    let mut events = Vec::new();
    let mut last = after;
    for entry in store.log(after, BATCH)? {
        last = entry.seq;
        let change = Change {
            seq: entry.seq,
            kind: entry.kind,
            task: entry.task,
        };
        let data = serde_json::to_string(&change).unwrap_or_default();
        let id = change.seq.to_string();
        events.push(Event::default().id(id).event("change").data(data));
    }
    Ok((last, events))
}
