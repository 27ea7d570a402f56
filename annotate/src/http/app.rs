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
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::limit::Limiter;
use super::metrics::Metrics;
use crate::Error;
use crate::clock::Clock;
use crate::model::Model;
use crate::motions::MotionLibrary;
use crate::quality::Figures;
use crate::store::{Millis, Store, Who};
use crate::wire::{Code, Role};

/// How long a server waits for a request unless told otherwise.
pub const PATIENCE: Duration = Duration::from_secs(15);
/// Who may use a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Everybody. Routes that change something still need the browser's own request.
    Public,
    /// Whoever is logged in with this role or a higher one.
    Role(Role),
    /// The machine itself, or an admin.
    Local,
}

/// How a request becomes an answer.
#[derive(Clone, Copy, Debug)]
pub enum Handler {
    /// By work that may wait for the store or the disk.
    Work(fn(&Context) -> Result<Reply, Error>),
    /// By a stream of events.
    Stream,
}

/// A route.
#[derive(Clone, Copy, Debug)]
pub struct Route {
    /// Method.
    pub method: &'static str,
    /// Path, with parameters in braces.
    pub path: &'static str,
    /// Who may use it.
    pub access: Access,
    /// Largest body.
    pub max_body: usize,
    /// What it does.
    pub handler: Handler,
}

/// A request that may be served.
pub struct Context {
    pub(crate) app: Arc<App>,
    pub(crate) who: Option<Who>,
    pub(crate) peer: IpAddr,
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

/// An answer.
#[derive(Debug)]
pub enum Reply {
    /// A JSON document.
    Json(Vec<u8>),
    /// Nothing more to say.
    Empty,
    /// A response with everything set.
    Full(Response),
}

/// What a server is started with.
pub struct ServerConfig {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Whether browsers reach it through TLS.
    pub secure: bool,
    /// Folder for exports.
    pub data: PathBuf,
    /// The dataset, for imports.
    pub dataset: PathBuf,
    /// The language model, if there is one.
    pub model: Option<Model>,
    /// Longest a request may take, and its head to arrive; [`PATIENCE`] for people.
    pub patience: Duration,
    /// Tells the time.
    pub clock: Clock,
    /// Takes what the operator should read.
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

/// What all requests share.
pub(crate) struct App {
    pub(crate) store: Arc<Store>,
    pub(crate) motions: Arc<MotionLibrary>,
    pub(crate) config: ServerConfig,
    pub(crate) limiter: Limiter,
    pub(crate) metrics: Metrics,
    /// Why nothing can be saved, if so.
    pub(crate) read_only: Mutex<Option<String>>,
    /// Figures of agreement and when they were made.
    pub(crate) figures: Mutex<Option<(Millis, Arc<Figures>)>>,
    pub(crate) last_seq: tokio::sync::watch::Sender<i64>,
}

impl App {
    pub(super) fn now(&self) -> Millis {
        (self.config.clock)()
    }

    pub(super) fn cookie_name(&self) -> &'static str {
        if self.config.secure {
            "__Host-annotate"
        } else {
            "annotate"
        }
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
        text.parse()
            .map_err(|_| Error::not_found("thing of this number"))
    }

    pub(super) fn param(&self, name: &str) -> &str {
        self.params.get(name).map_or("", String::as_str)
    }

    pub(super) fn body<T: DeserializeOwned>(&self) -> Result<T, Error> {
        serde_json::from_slice(&self.body).map_err(|error| {
            Error::refused(
                Code::BadRequest,
                format!("the body is not what this route takes: {error}"),
            )
        })
    }

    /// The parameters of the address, none but those known.
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
                    "{name:?} is no parameter here; known are {}",
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

/// A reply of one JSON document.
pub(super) fn json<T: Serialize>(value: &T) -> Result<Reply, Error> {
    serde_json::to_vec(value)
        .map(Reply::Json)
        .map_err(|error| Error::Row {
            table: "of an answer",
            problem: error.to_string(),
        })
}

/// A reply as an HTTP response.
pub(super) fn reply_response(reply: Reply) -> Response {
    match reply {
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

/// Sets a header; a value that is none is left out.
pub(super) fn set(response: &mut Response, name: HeaderName, value: &str) {
    if let Ok(value) = HeaderValue::from_str(value) {
        response.headers_mut().insert(name, value);
    }
}

/// The value of a header that is given once.
pub(super) fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    let mut all = headers.get_all(name).iter();
    let only = all.next()?;
    // Two of them are one too many to trust either.
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

/// Runs work that may wait, where waiting holds nobody up.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    match tokio::task::spawn_blocking(work).await {
        Ok(outcome) => outcome,
        // The work panicked: a defect, which its own message in the log tells of.
        Err(_) => Err(Error::Closed),
    }
}
