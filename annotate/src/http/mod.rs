//! The server.
//!
//! Every route is a row of [`ROUTES`] with its required role. `serve` handles what all requests share: it
//! authenticates, checks role and origin, limits body and time, and writes the reply.

mod app;
mod assets;
mod limit;
mod metrics;
mod routes;
mod stream;

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes};
use axum::extract::{FromRequestParts, RawPathParams, Request};
use axum::http::header::{self, HeaderMap, HeaderName};
use axum::http::{Method, StatusCode, Uri};
use axum::response::Response;
use axum::routing::{MethodFilter, on};
use hyper_util::rt::{TokioIo, TokioTimer};
use tower_service::Service;

use crate::Error;
use crate::lock::lock;
use crate::motions::MotionLibrary;
use crate::store::{Store, TokenUse, Who};
use crate::wire::{Code, Problem, Role};
use app::{App, blocking, cookie, reply_response, set, text};
use limit::Limiter;
use metrics::Metrics;

pub use crate::clock::Clock;
pub use app::{Access, Context, Handler, PATIENCE, Reply, Route, ServerConfig};
pub use routes::ROUTES;

/// Maximum number of concurrent connections.
const CONNECTIONS: usize = 1024;
/// Content security policy: pages load only scripts, styles and data of this server.
const CSP: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; \
connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'";

/// A running server. It stops when dropped.
pub struct Server {
    address: SocketAddr,
    runtime: Option<tokio::runtime::Runtime>,
}

impl std::fmt::Debug for Server {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Server")
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

impl Server {
    /// Starts a server and returns once it listens.
    ///
    /// # Errors
    /// The address cannot be bound, or the store does not answer.
    pub fn start(
        store: Arc<Store>,
        motions: Arc<MotionLibrary>,
        config: ServerConfig,
    ) -> Result<Self, Error> {
        let listen = config.listen;
        let failed = |source| Error::Listen {
            address: listen.to_string(),
            source,
        };
        crate::jobs::abandon(store.as_ref(), (config.clock)())?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .max_blocking_threads(128)
            .thread_name("annotate-http")
            .enable_all()
            .build()
            .map_err(failed)?;
        let listener = std::net::TcpListener::bind(listen).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let (last_seq, _) = tokio::sync::watch::channel(store.last_seq()?);
        let store_id = store.id()?;
        let app = Arc::new(App {
            store,
            store_id,
            motions,
            config,
            limiter: Limiter::default(),
            metrics: Metrics::default(),
            read_only: Mutex::new(None),
            figures: Mutex::new(None),
            last_seq,
        });
        let listener = {
            let _context = runtime.enter();
            tokio::net::TcpListener::from_std(listener).map_err(failed)?
        };
        runtime.spawn(stream::watch(Arc::clone(&app)));
        runtime.spawn(accept(listener, app));
        Ok(Self {
            address,
            runtime: Some(runtime),
        })
    }

    /// Address that the server listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_secs(5));
        }
    }
}

async fn accept(listener: tokio::net::TcpListener, app: Arc<App>) {
    let router = router(&app);
    let patience = app.config.patience;
    let places = Arc::new(tokio::sync::Semaphore::new(CONNECTIONS));
    loop {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else {
            return;
        };
        let (socket, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(_) => {
                // Most likely out of file descriptors: wait until some are closed.
                tokio::time::sleep(Duration::from_millis(50)).await;
                continue;
            }
        };
        let router = router.clone();
        tokio::spawn(async move {
            let _place = place;
            // Send small responses at once.
            let _set = socket.set_nodelay(true);
            let service = hyper::service::service_fn(
                move |request: hyper::Request<hyper::body::Incoming>| {
                    let mut request = request.map(Body::new);
                    request.extensions_mut().insert(Peer(peer.ip()));
                    router.clone().call(request)
                },
            );
            let served = hyper::server::conn::http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(patience)
                .max_buf_size(64 * 1024)
                .serve_connection(TokioIo::new(socket), service)
                .await;
            // Ignore browsers that disconnect in mid-request.
            drop(served);
        });
    }
}

#[derive(Clone, Copy)]
struct Peer(IpAddr);

fn router(app: &Arc<App>) -> axum::Router {
    let mut router = axum::Router::new();
    for route in ROUTES {
        let app = Arc::clone(app);
        let filter = match route.method {
            "GET" => MethodFilter::GET,
            "PUT" => MethodFilter::PUT,
            "PATCH" => MethodFilter::PATCH,
            "DELETE" => MethodFilter::DELETE,
            _ => MethodFilter::POST,
        };
        let handler = move |request: Request| {
            let app = Arc::clone(&app);
            async move { serve(app, route, request).await }
        };
        router = router.route(route.path, on(filter, handler));
    }
    let lost = |app: &Arc<App>, code: Code| {
        let secure = app.config.secure;
        move |request: Request| async move {
            let path = request.uri().path().to_owned();
            let detail = match code {
                Code::MethodNotAllowed => format!("{path} does not support {}", request.method()),
                _ => format!("{path} does not exist"),
            };
            let mut response = problem_response(&Problem::new(code, detail));
            harden(&mut response, secure);
            response
        }
    };
    router
        .fallback(lost(app, Code::NotFound))
        .method_not_allowed_fallback(lost(app, Code::MethodNotAllowed))
}

async fn serve(app: Arc<App>, route: &'static Route, request: Request) -> Response {
    let begun = Instant::now();
    let outcome = match route.handler {
        // Event streams have no timeout.
        Handler::Stream => answer(Arc::clone(&app), route, request).await,
        Handler::Work(_) => {
            let patience = app.config.patience;
            match tokio::time::timeout(patience, answer(Arc::clone(&app), route, request)).await {
                Ok(outcome) => outcome,
                Err(_) => Err(Error::refused(
                    Code::Timeout,
                    format!(
                        "the request took more than {} seconds; send it again: a request with a key takes effect only once",
                        patience.as_secs_f64()
                    ),
                )),
            }
        }
    };
    let mut response = match outcome {
        Ok(reply) => reply_response(reply),
        Err(error) => {
            let problem = error.problem();
            match problem.code {
                Code::Internal => (app.config.log)(&format!(
                    "{} {}: {}",
                    route.method,
                    route.path,
                    chain(&error)
                )),
                Code::ReadOnly => *lock(&app.read_only) = Some(error.to_string()),
                _ => {}
            }
            problem_response(&problem)
        }
    };
    harden(&mut response, app.config.secure);
    app.metrics.count(
        route.method,
        route.path,
        response.status().as_u16(),
        begun.elapsed(),
    );
    response
}

/// Formats an error with its causes.
fn chain(error: &Error) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        text += &format!(": {error}");
        cause = error.source();
    }
    text
}

async fn answer(app: Arc<App>, route: &'static Route, request: Request) -> Result<Reply, Error> {
    let (mut parts, body) = request.into_parts();
    let peer = parts
        .extensions
        .get::<Peer>()
        .map_or(IpAddr::from([0, 0, 0, 0]), |peer| peer.0);
    let who = {
        let app = Arc::clone(&app);
        let (method, headers) = (parts.method.clone(), parts.headers.clone());
        blocking(move || admit(&app, route, &method, &headers, peer)).await?
    };
    let params = RawPathParams::from_request_parts(&mut parts, &())
        .await
        .map_err(|error| Error::refused(Code::BadRequest, error.to_string()))?
        .iter()
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .collect();
    let context = Context {
        params,
        who,
        peer,
        query: query(&parts.uri)?,
        headers: parts.headers,
        body: read_body(body, route.max_body).await?,
        path: parts.uri.path().to_owned(),
        now: app.now(),
        app,
    };
    match route.handler {
        Handler::Work(work) => blocking(move || work(&context)).await,
        Handler::Stream => stream::open(context).await,
    }
}

/// Bytes of a too large body that are still read: a browser whose upload is cut off does not show the
/// response.
const DRAINED_BYTES: usize = 32 * 1024 * 1024;

async fn read_body(body: Body, limit: usize) -> Result<Bytes, Error> {
    let mut chunks = body.into_data_stream();
    let mut bytes = Vec::new();
    let mut total = 0;
    while let Some(chunk) = std::future::poll_fn(|context| {
        futures_core::Stream::poll_next(std::pin::Pin::new(&mut chunks), context)
    })
    .await
    {
        let chunk = chunk.map_err(|error| Error::refused(Code::BadRequest, error.to_string()))?;
        total += chunk.len();
        if total <= limit {
            bytes.extend_from_slice(&chunk);
        } else {
            bytes = Vec::new();
            if total > limit + DRAINED_BYTES {
                break;
            }
        }
    }
    if total > limit {
        return Err(Error::refused(
            Code::TooLarge,
            format!("the body exceeds {limit} bytes; send less at a time"),
        ));
    }
    Ok(bytes.into())
}

/// Parses the query parameters.
fn query(uri: &Uri) -> Result<BTreeMap<String, String>, Error> {
    let refused = |detail: String| Error::refused(Code::BadRequest, detail);
    let text = uri.query().unwrap_or("");
    // The parser would accept malformed escapes literally.
    let is_escape = |rest: &str| {
        let digits = rest.as_bytes().get(..2);
        digits.is_some_and(|digits| digits.iter().all(u8::is_ascii_hexdigit))
    };
    if !text.split('%').skip(1).all(is_escape) {
        return Err(refused(
            "the query has a malformed percent escape".to_owned(),
        ));
    }
    let mut pairs = BTreeMap::new();
    for (name, value) in form_urlencoded::parse(text.as_bytes()) {
        if pairs.insert(name.to_string(), value.into_owned()).is_some() {
            return Err(refused(format!("query parameter {name:?} is given twice")));
        }
    }
    Ok(pairs)
}

/// Authorises a request and identifies its user.
fn admit(
    app: &App,
    route: &Route,
    method: &Method,
    headers: &HeaderMap,
    peer: IpAddr,
) -> Result<Option<Who>, Error> {
    let bearer = bearer(headers);
    let changes = !matches!(*method, Method::GET | Method::HEAD);
    if changes && bearer.is_none() {
        check_own(app, headers)?;
    }
    let needed = match route.access {
        Access::Public => return Ok(None),
        Access::Local if peer.is_loopback() && bearer.is_none() => return Ok(None),
        Access::Local => Role::Admin,
        Access::Role(role) => role,
    };
    let now = app.now();
    let who = match (bearer, cookie(headers, &app.cookie_name())) {
        (Some(token), _) => app.store.authenticate(token, &[TokenUse::Token], now)?,
        (None, Some(token)) => app.store.authenticate(&token, &[TokenUse::Session], now)?,
        (None, None) => {
            return Err(Error::refused(Code::Unauthenticated, "log in first"));
        }
    };
    if who.role < needed {
        return Err(Error::refused(
            Code::Forbidden,
            format!("this requires the role {needed}, yours is {}", who.role),
        ));
    }
    Ok(Some(who))
}

/// Checks that a changing request with a cookie comes from the page itself (CSRF protection).
fn check_own(app: &App, headers: &HeaderMap) -> Result<(), Error> {
    if text(headers, &HeaderName::from_static("x-annotate")) != Some("1") {
        return Err(Error::refused(
            Code::Csrf,
            "requests that change something need the header X-Annotate: 1, or a bearer token",
        ));
    }
    let scheme = if app.config.secure { "https" } else { "http" };
    let own = text(headers, &header::HOST).map(|host| format!("{scheme}://{host}"));
    if own.is_none() || text(headers, &header::ORIGIN) != own.as_deref() {
        return Err(Error::refused(
            Code::WrongOrigin,
            "the Origin of this request is not this server; behind a proxy with TLS, start the server with --secure",
        ));
    }
    Ok(())
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    text(headers, &header::AUTHORIZATION)?
        .strip_prefix("Bearer ")
        .map(str::trim)
}

fn problem_response(problem: &Problem) -> Response {
    let body = serde_json::to_vec(problem).unwrap_or_default();
    let mut response = Response::new(Body::from(body));
    *response.status_mut() =
        StatusCode::from_u16(problem.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    set(
        &mut response,
        header::CONTENT_TYPE,
        "application/problem+json",
    );
    set(&mut response, header::CACHE_CONTROL, "no-store");
    if let Some(seconds) = problem.retry_after_secs {
        set(&mut response, header::RETRY_AFTER, &seconds.to_string());
    }
    response
}

/// Sets the headers of every response.
fn harden(response: &mut Response, secure: bool) {
    for (name, value) in [
        ("content-security-policy", CSP),
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-resource-policy", "same-origin"),
        ("cross-origin-opener-policy", "same-origin"),
        (
            "permissions-policy",
            "camera=(), microphone=(), geolocation=()",
        ),
    ] {
        set(response, HeaderName::from_static(name), value);
    }
    if secure {
        set(
            response,
            header::STRICT_TRANSPORT_SECURITY,
            "max-age=31536000",
        );
    }
}
