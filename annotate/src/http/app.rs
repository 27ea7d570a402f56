//! What routes share: the state of the server, a request, and a reply.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::StatusCode;
use axum::http::header::{self, HeaderMap, HeaderName, HeaderValue};
use axum::response::Response;
use flate2::Compression;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::compress;
use super::limit::Limiter;
use super::metrics::Metrics;
use super::proxy::TrustedProxy;
use crate::Error;
use crate::clock::Clock;
use crate::model::Model;
use crate::motions::MotionLibrary;
use crate::quality::KeptFigures;
use crate::store::{Millis, Store, TokenUse, Who};
use crate::wire::{Code, MAX_BODY_BYTES, Role};

/// Default timeout of a request.
pub const PATIENCE: Duration = Duration::from_secs(15);
/// Default timeout of an upload: 64 MB at 110 kB/s.
pub const UPLOAD_PATIENCE: Duration = Duration::from_secs(600);
/// Who may use a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Everybody. Routes that change something still need the header and origin of the page.
    Public,
    /// Users with this role or a higher one.
    Role(Role),
}

/// Kind of a handler.
#[derive(Clone, Copy, Debug)]
pub enum Handler {
    /// Blocking work on the store or the disk.
    Work(fn(&Context) -> Result<Reply, Error>),
    /// A stream of server-sent events.
    Stream,
}

/// A route.
#[derive(Clone, Copy, Debug)]
pub struct Route {
    /// Method.
    pub method: &'static str,
    /// Path, with parameters in braces.
    pub path: &'static str,
    /// Required role.
    pub access: Access,
    /// Maximum size of the body in bytes.
    pub max_body: usize,
    /// Handler.
    pub handler: Handler,
}

impl Route {
    /// Whether its body is a file.
    pub(super) fn is_upload(&self) -> bool {
        self.max_body > MAX_BODY_BYTES
    }
}

/// An authorised request.
pub struct Context {
    pub(crate) app: Arc<App>,
    pub(crate) who: Option<Who>,
    /// Address of the client: that of the connection, or the one that a trusted proxy names.
    pub(crate) client: IpAddr,
    pub(crate) params: BTreeMap<String, String>,
    pub(crate) query: BTreeMap<String, String>,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Bytes,
    pub(crate) path: String,
    pub(crate) now: Millis,
}

impl std::fmt::Debug for Context {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Context")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

/// A response.
#[derive(Debug)]
pub enum Reply {
    /// A JSON document.
    Json(Vec<u8>),
    /// A compressed JSON document.
    PackedJson(Vec<u8>),
    /// 204 without a body.
    Empty,
    /// A complete response.
    Full(Response),
}

/// Settings of a server.
pub struct ServerConfig {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// A second address, for `/metrics`, `/healthz` and `/readyz` without login.
    pub operators: Option<SocketAddr>,
    /// Whether browsers reach it through TLS.
    pub secure: bool,
    /// Names by which browsers reach it, beside `localhost` and addresses.
    pub hosts: Vec<String>,
    /// Proxies whose word on the address of a client is taken.
    pub trusted_proxies: Vec<TrustedProxy>,
    /// Folder for exports.
    pub data: PathBuf,
    /// The dataset, for imports.
    pub dataset: PathBuf,
    /// The language model, if there is one.
    pub model: Option<Model>,
    /// Timeout of a request, of its headers, and of a reader that takes nothing; [`PATIENCE`] in production.
    pub patience: Duration,
    /// Timeout of an upload; [`UPLOAD_PATIENCE`] in production.
    pub upload_patience: Duration,
    /// Tells the time, unless the store has a clock.
    pub clock: Clock,
    /// Receives messages for the operator.
    pub log: fn(&str),
}

impl std::fmt::Debug for ServerConfig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ServerConfig")
            .field("listen", &self.listen)
            .field("secure", &self.secure)
            .finish_non_exhaustive()
    }
}

/// State shared by all requests.
pub(crate) struct App {
    pub(crate) store: Arc<Store>,
    pub(crate) store_id: String,
    pub(crate) motions: Arc<MotionLibrary>,
    pub(crate) config: ServerConfig,
    pub(crate) limiter: Limiter,
    pub(crate) metrics: Metrics,
    /// Why the store accepts no writes, if it does not.
    pub(crate) read_only: Mutex<Option<String>>,
    /// Agreement figures.
    pub(crate) figures: KeptFigures,
    pub(crate) last_seq: tokio::sync::watch::Sender<i64>,
}

impl App {
    pub(super) fn now(&self) -> Millis {
        (self.config.clock)()
    }

    /// Name of the session's cookie. Browsers share cookies between all ports of a host, so each store has its own.
    pub(super) fn cookie_name(&self) -> String {
        let prefix = if self.config.secure { "__Host-" } else { "" };
        format!("{prefix}annotate-{}", self.store_id)
    }
}

impl Context {
    pub(super) fn who(&self) -> Result<&Who, Error> {
        self.who
            .as_ref()
            .ok_or_else(|| Error::refused(Code::Unauthenticated, "log in first"))
    }

    pub(super) fn id(&self) -> Result<i64, Error> {
        let text = self.params.get("id").map_or("", String::as_str);
        text.parse().map_err(|_| Error::not_found("id"))
    }

    pub(super) fn param(&self, name: &str) -> &str {
        self.params.get(name).map_or("", String::as_str)
    }

    pub(super) fn body<T: DeserializeOwned>(&self) -> Result<T, Error> {
        serde_json::from_slice(&self.body)
            .map_err(|error| Error::refused(Code::BadRequest, format!("invalid body: {error}")))
    }

    /// Checks that the query has only known parameters.
    pub(super) fn only(&self, known: &[&str]) -> Result<(), Error> {
        match self
            .query
            .keys()
            .find(|name| !known.contains(&name.as_str()))
        {
            None => Ok(()),
            Some(name) => Err(Error::refused(
                Code::BadRequest,
                format!(
                    "unknown query parameter {name:?}; expected {}",
                    known.join(", ")
                ),
            )),
        }
    }

    pub(super) fn number(&self, name: &str) -> Result<Option<i64>, Error> {
        match self.query.get(name) {
            None => Ok(None),
            Some(text) => text.parse().map(Some).map_err(|_| {
                Error::refused(
                    Code::BadRequest,
                    format!("{name} is {text:?}, not a whole number"),
                )
            }),
        }
    }

    pub(super) fn one_of<T: Copy>(
        &self,
        name: &str,
        parse: fn(&str) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        match self.query.get(name).map(String::as_str) {
            None | Some("") => Ok(None),
            Some(text) => parse(text).map(Some).ok_or_else(|| {
                Error::refused(Code::BadRequest, format!("{name} {text:?} is not known"))
            }),
        }
    }

    pub(super) fn limit(&self, most: i64) -> Result<usize, Error> {
        let limit = self.number("limit")?.unwrap_or(most).clamp(1, most);
        Ok(usize::try_from(limit).unwrap_or(1))
    }
}

/// A JSON reply.
pub(super) fn json<T: Serialize>(value: &T) -> Result<Reply, Error> {
    serde_json::to_vec(value)
        .map(Reply::Json)
        .map_err(|error| Error::Row {
            table: "of an answer",
            problem: error.to_string(),
        })
}

/// Compresses a reply of JSON.
pub(super) fn packed(reply: Reply) -> Reply {
    match reply {
        Reply::Json(bytes) => match compress::gzip(&bytes, Compression::fast()) {
            Some(packed) => Reply::PackedJson(packed),
            None => Reply::Json(bytes),
        },
        other => other,
    }
}

/// Converts a reply to an HTTP response.
pub(super) fn reply_response(reply: Reply) -> Response {
    match reply {
        Reply::PackedJson(bytes) => {
            let mut response = reply_response(Reply::Json(bytes));
            compress::mark(&mut response);
            compress::vary(&mut response);
            response
        }
        Reply::Full(response) => response,
        Reply::Empty => {
            let mut response = Response::new(Body::empty());
            *response.status_mut() = StatusCode::NO_CONTENT;
            response
        }
        Reply::Json(bytes) => {
            let mut response = Response::new(Body::from(bytes));
            set(&mut response, header::CONTENT_TYPE, "application/json");
            set(&mut response, header::CACHE_CONTROL, "no-store");
            response
        }
    }
}

/// Sets a header; an invalid value is ignored.
pub(super) fn set(response: &mut Response, name: HeaderName, value: &str) {
    if let Ok(value) = HeaderValue::from_str(value) {
        response.headers_mut().insert(name, value);
    }
}

/// The value of a header that occurs exactly once.
pub(super) fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    let mut all = headers.get_all(name).iter();
    let only = all.next()?;
    // Duplicate headers are ambiguous: trust neither.
    if all.next().is_some() {
        None
    } else {
        only.to_str().ok()
    }
}

/// The value of a cookie.
pub(super) fn cookie(headers: &HeaderMap, name: &str) -> Option<String> {
    headers
        .get_all(header::COOKIE)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(';'))
        .filter_map(|pair| pair.trim().split_once('='))
        .find(|(known, _)| *known == name)
        .map(|(_, value)| value.to_owned())
}

pub(super) fn bearer(headers: &HeaderMap) -> Option<&str> {
    text(headers, &header::AUTHORIZATION)?
        .strip_prefix("Bearer ")
        .map(str::trim)
}

/// The token of a request, from its bearer header or its cookie.
pub(super) fn credential(app: &App, headers: &HeaderMap) -> Result<(String, TokenUse), Error> {
    match (bearer(headers), cookie(headers, &app.cookie_name())) {
        (Some(token), _) => Ok((token.to_owned(), TokenUse::Token)),
        (None, Some(token)) => Ok((token, TokenUse::Session)),
        (None, None) => Err(Error::refused(Code::Unauthenticated, "log in first")),
    }
}

/// Runs blocking work on the blocking thread pool.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    match tokio::task::spawn_blocking(work).await {
        Ok(outcome) => outcome,
        // The work panicked; the panic message is in the log.
        Err(_) => Err(Error::Closed),
    }
}
