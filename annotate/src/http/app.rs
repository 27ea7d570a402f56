//! State of the server, requests and responses, shared by all routes.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::RawPathParams;
use axum::http::header::{self, HeaderMap, HeaderName};
use axum::http::{StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use axum::routing::MethodFilter;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::limit::Limiter;
use super::metrics::Metrics;
use super::proxy::TrustedProxy;
use crate::Error;
use crate::clock::Clock;
use crate::model::Model;
use crate::motions::MotionLibrary;
use crate::quality::KeptFigures;
use crate::store::{Millis, Store, TokenUse, Who};
use crate::wire::{Code, Role};

/// Default timeout of a request.
pub const PATIENCE: Duration = Duration::from_secs(15);
/// Default timeout of an upload: 64 MB at 110 kB/s.
pub const UPLOAD_PATIENCE: Duration = Duration::from_secs(600);

/// A route of the API.
pub struct Route {
    /// Method.
    pub method: &'static str,
    pub(super) filter: MethodFilter,
    /// Path, with parameters in braces.
    pub path: &'static str,
    /// Minimum role of the user; `None` admits everybody. A request that changes something still needs the header and
    /// the origin of the page, or a bearer token.
    pub role: Option<Role>,
    /// Maximum size of the body in bytes.
    pub max_body: usize,
    /// Answers a request, on a thread that may wait for the store or the disk.
    pub handler: fn(&Context) -> Result<Response, Error>,
}

/// An authorised request.
pub struct Context {
    pub(crate) app: Arc<App>,
    pub(crate) who: Option<Who>,
    /// Address of the client: the peer's address, or the one that a trusted proxy reports.
    pub(crate) client: IpAddr,
    pub(crate) params: RawPathParams,
    pub(crate) uri: Uri,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Bytes,
    pub(crate) now: Millis,
}

/// Settings of a server.
pub struct ServerConfig {
    /// Listening address; port 0 selects a free port.
    pub listen: SocketAddr,
    /// A second address, for `/metrics`, `/healthz` and `/readyz` without login.
    pub operators: Option<SocketAddr>,
    /// Whether browsers reach the server through TLS.
    pub secure: bool,
    /// Host names under which browsers reach the server, besides `localhost` and IP addresses.
    pub hosts: Vec<String>,
    /// Proxies whose headers `X-Forwarded-For` and `Forwarded` are trusted.
    pub trusted_proxies: Vec<TrustedProxy>,
    /// Folder for the files of exports, and for uploads while they are imported.
    pub data: PathBuf,
    /// Folder of the dataset, for imports and exports.
    pub dataset: PathBuf,
    /// The language model, if there is one.
    pub model: Option<Model>,
    /// Timeout of a request, of its headers, and of a client that stops reading; [`PATIENCE`] in production.
    pub patience: Duration,
    /// Timeout of an upload; [`UPLOAD_PATIENCE`] in production.
    pub upload_patience: Duration,
    /// Source of the time, unless the store has a clock.
    pub clock: Clock,
    /// Receives messages for the operator.
    pub log: fn(&str),
}

/// State shared by all requests.
pub(crate) struct App {
    pub(crate) store: Arc<Store>,
    pub(crate) store_id: String,
    pub(crate) motions: Arc<MotionLibrary>,
    pub(crate) config: ServerConfig,
    pub(crate) limiter: Limiter,
    pub(crate) metrics: Metrics,
    /// Why the store accepts no writes; `None` if it does.
    pub(crate) read_only: Mutex<Option<String>>,
    /// Figures of agreement and of people.
    pub(crate) figures: KeptFigures,
    pub(crate) last_seq: tokio::sync::watch::Sender<i64>,
}

impl App {
    pub(crate) fn now(&self) -> Millis {
        (self.config.clock)()
    }

    /// Name of the session's cookie. Browsers share cookies between all ports of a host, so each store has its own.
    pub(super) fn cookie_name(&self) -> String {
        let prefix = if self.config.secure { "__Host-" } else { "" };
        format!("{prefix}annotate-{}", self.store_id)
    }
}

impl Context {
    pub(super) fn store(&self) -> &Store {
        &self.app.store
    }

    pub(super) fn who(&self) -> Result<&Who, Error> {
        self.who
            .as_ref()
            .ok_or_else(|| Error::refused(Code::Unauthenticated, "log in first"))
    }

    /// The id of the user.
    pub(super) fn user(&self) -> Result<i64, Error> {
        Ok(self.who()?.id)
    }

    pub(super) fn id(&self) -> Result<i64, Error> {
        let id = self.param("id").parse();
        id.map_err(|_| Error::not_found("id"))
    }

    pub(super) fn param(&self, name: &str) -> &str {
        let mut params = self.params.iter();
        params
            .find(|(known, _)| *known == name)
            .map_or("", |(_, value)| value)
    }

    pub(super) fn body<T: DeserializeOwned>(&self) -> Result<T, Error> {
        serde_json::from_slice(&self.body)
            .map_err(|error| Error::refused(Code::BadRequest, format!("invalid body: {error}")))
    }

    /// The parameters of the query.
    pub(super) fn query<T: DeserializeOwned>(&self) -> Result<T, Error> {
        parse_query(self.uri.query().unwrap_or(""))
    }
}

/// Parses the parameters of a query. A parameter without a value counts as absent.
pub(super) fn parse_query<T: DeserializeOwned>(query: &str) -> Result<T, Error> {
    let refused = |problem: &dyn std::fmt::Display| {
        Error::refused(Code::BadRequest, format!("the query {query:?}: {problem}"))
    };
    // Refuse malformed escapes: the parser would take them literally.
    let is_escape = |rest: &str| {
        let digits = rest.as_bytes().get(..2);
        digits.is_some_and(|digits| digits.iter().all(u8::is_ascii_hexdigit))
    };
    if !query.split('%').skip(1).all(is_escape) {
        return Err(refused(&"a percent escape is malformed"));
    }
    let has_value = |pair: &&str| {
        let value = pair.split_once('=').map_or("", |(_, value)| value);
        !value.is_empty()
    };
    let given = query.split('&').filter(has_value);
    serde_urlencoded::from_str(&given.collect::<Vec<_>>().join("&"))
        .map_err(|error| refused(&error))
}

/// The number of rows per page: `asked`, but at most `most`; `most` if `asked` is 0.
pub(super) fn page_size(asked: usize, most: usize) -> usize {
    if asked == 0 { most } else { asked.min(most) }
}

/// A JSON response.
pub(super) fn json<T: Serialize>(value: &T) -> Result<Response, Error> {
    serde_json::to_vec(value)
        .map(|bytes| content("application/json", "no-store", bytes))
        .map_err(|error| Error::Row {
            table: "of an answer",
            problem: error.to_string(),
        })
}

/// A response with this content type and cache policy.
pub(super) fn content(mime: &str, cache: &str, body: impl Into<Body>) -> Response {
    let headers = [(header::CONTENT_TYPE, mime), (header::CACHE_CONTROL, cache)];
    let body: Body = body.into();
    (headers, body).into_response()
}

/// A binary response that caches must not store.
pub(super) fn binary(bytes: Vec<u8>) -> Response {
    content("application/octet-stream", "no-store", bytes)
}

/// A 204 response without a body.
pub(super) fn empty(_: ()) -> Result<Response, Error> {
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// The value of a header; `None` unless it occurs exactly once and is ASCII text.
pub(super) fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    let mut all = headers.get_all(name).iter();
    match (all.next(), all.next()) {
        (Some(only), None) => only.to_str().ok(),
        // Duplicate headers are ambiguous: trust neither.
        _ => None,
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
    let ended = tokio::task::spawn_blocking(work).await;
    // The panic hook has printed the message of work that panicked.
    ended.unwrap_or(Err(Error::Closed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Search {
        q: Option<String>,
        limit: Option<usize>,
    }

    #[test]
    fn a_parameter_without_a_value_is_left_out() {
        for (query, q, limit) in [
            ("", None, None),
            ("q=&limit=", None, None),
            ("q&limit=3", None, Some(3)),
            ("q=a+b%3D", Some("a b="), None),
            ("q=a=&limit=3", Some("a="), Some(3)),
        ] {
            let found: Search = parse_query(query).expect("a query");
            assert_eq!((found.q.as_deref(), found.limit), (q, limit), "{query}");
        }
        for query in ["other=1", "q=a&q=b", "limit=x", "limit=-1", "q=%4", "q=%zz"] {
            assert!(parse_query::<Search>(query).is_err(), "{query}");
        }
    }
}
