//! The HTTP server.
//!
//! Every route is a row of [`ROUTES`] with its required role. `serve` handles what all requests share: it
//! authenticates, checks role and origin, limits body and time, and writes the reply.

mod app;
mod assets;
mod limit;
mod metrics;
mod proxy;
mod routes;
mod socket;
mod stream;

use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes};
use axum::extract::{FromRequestParts, RawPathParams, Request};
use axum::http::header::{self, HeaderMap, HeaderName};
use axum::http::uri::Authority;
use axum::http::{Method, StatusCode, Uri};
use axum::middleware::map_response;
use axum::response::{IntoResponse as _, Response};
use axum::routing::on;
use futures_util::StreamExt as _;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpListener;
use tower_http::compression::predicate::{NotForContentType, SizeAbove};
use tower_http::compression::{CompressionLayer, DefaultPredicate, Predicate as _};
use tower_service::Service;

use crate::Error;
use crate::lock::lock;
use crate::motions::MotionLibrary;
use crate::quality::KeptFigures;
use crate::store::{Store, Who};
use crate::wire::{Code, MAX_BODY_BYTES, Problem};
use app::{bearer, blocking, content, credential, text};
use limit::Limiter;
use metrics::Metrics;
use socket::Socket;

pub use crate::clock::Clock;
pub(crate) use app::App;
pub use app::{Context, PATIENCE, Route, ServerConfig, UPLOAD_PATIENCE};
pub use proxy::TrustedProxy;
pub use routes::ROUTES;

/// Maximum number of concurrent connections.
const CONNECTIONS: usize = 1024;
/// Content security policy: pages load only scripts, styles and data of this server.
const CSP: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; \
connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'";

/// Minimum bytes of a body that is compressed: smaller ones fit into one packet.
const WORTHWHILE: u16 = 1400;

/// Interval between write attempts on a store that accepted no writes.
const TRY_AGAIN: Duration = Duration::from_secs(5);

/// A running server. It stops when dropped.
pub struct Server {
    address: SocketAddr,
    operators: Option<SocketAddr>,
    runtime: Option<tokio::runtime::Runtime>,
    /// Kept until the runtime has ended: PostgreSQL connections cannot be closed inside a runtime.
    _store: Arc<Store>,
}

impl Server {
    /// Starts a server and returns once it listens.
    ///
    /// # Errors
    /// The address cannot be bound, or the store does not answer.
    pub fn start(
        store: Arc<Store>,
        motions: Arc<MotionLibrary>,
        mut config: ServerConfig,
    ) -> Result<Self, Error> {
        // Servers that share a store use one clock for its leases.
        if let Some(clock) = store.clock()? {
            config.clock = clock;
        }
        store.abandon((config.clock)())?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .max_blocking_threads(128)
            .thread_name("annotate-http")
            .enable_all()
            .build()
            .map_err(failed(config.listen))?;
        let bind = |address: SocketAddr| {
            runtime
                .block_on(TcpListener::bind(address))
                .and_then(|listener| Ok((listener.local_addr()?, listener)))
                .map_err(failed(address))
        };
        let (address, listener) = bind(config.listen)?;
        let operators = config.operators.map(bind).transpose()?;
        let (last_seq, _) = tokio::sync::watch::channel(store.last_seq()?);
        let app = Arc::new(App {
            store_id: store.id()?,
            store,
            motions,
            config,
            limiter: Limiter::default(),
            metrics: Metrics::default(),
            read_only: Mutex::new(None),
            figures: KeptFigures::default(),
            last_seq,
        });
        runtime.spawn(stream::watch(Arc::clone(&app)));
        runtime.spawn(recover(Arc::clone(&app)));
        let patience = app.config.patience;
        let operators = operators.map(|(address, listener)| {
            let router = router(&app, routes::OPERATOR_ROUTES);
            runtime.spawn(accept(listener, router, patience));
            address
        });
        runtime.spawn(accept(listener, router(&app, ROUTES), patience));
        Ok(Self {
            address,
            operators,
            runtime: Some(runtime),
            _store: Arc::clone(&app.store),
        })
    }

    /// Address that the server listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Address for operators, if there is one.
    pub fn operators(&self) -> Option<SocketAddr> {
        self.operators
    }
}

/// The error for an address on which the server cannot listen.
fn failed(address: SocketAddr) -> impl FnOnce(std::io::Error) -> Error {
    move |source| Error::Listen {
        address: address.to_string(),
        source,
    }
}

/// After a failed write, checks the store every [`TRY_AGAIN`] until it accepts writes again.
async fn recover(app: Arc<App>) {
    loop {
        tokio::time::sleep(TRY_AGAIN).await;
        if lock(&app.read_only).is_none() {
            continue;
        }
        let store = Arc::clone(&app.store);
        if blocking(move || store.check()).await.is_ok() {
            *lock(&app.read_only) = None;
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_secs(5));
        }
    }
}

async fn accept(listener: TcpListener, router: axum::Router, patience: Duration) {
    let places = Arc::new(tokio::sync::Semaphore::new(CONNECTIONS));
    loop {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else {
            return;
        };
        let Ok((socket, peer)) = listener.accept().await else {
            // Most likely out of file descriptors: wait until some are closed.
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
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
            // Ignore browsers that disconnect in mid-request.
            let _served = hyper::server::conn::http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(patience)
                .max_buf_size(64 * 1024)
                .serve_connection(TokioIo::new(Socket::new(socket, patience)), service)
                .await;
        });
    }
}

#[derive(Clone, Copy)]
struct Peer(IpAddr);

fn router(app: &Arc<App>, routes: &'static [Route]) -> axum::Router {
    let mut router = axum::Router::new();
    for route in routes {
        let app = Arc::clone(app);
        let handler = move |request: Request| {
            let app = Arc::clone(&app);
            async move { serve(app, route, request).await }
        };
        router = router.route(route.path, on(route.filter, handler));
    }
    let lost = |code: Code| {
        move |request: Request| async move {
            let path = request.uri().path();
            let detail = match code {
                Code::MethodNotAllowed => format!("{path} does not support {}", request.method()),
                _ => format!("{path} does not exist"),
            };
            problem_response(&Problem::new(code, detail))
        }
    };
    // Do not compress motion data: it hardly shrinks.
    let shrinks = DefaultPredicate::new()
        .and(SizeAbove::new(WORTHWHILE))
        .and(NotForContentType::const_new("application/octet-stream"));
    let secure = app.config.secure;
    router
        .fallback(lost(Code::NotFound))
        .method_not_allowed_fallback(lost(Code::MethodNotAllowed))
        .layer(CompressionLayer::new().compress_when(shrinks))
        .layer(map_response(move |response: Response| async move {
            hardened(response, secure)
        }))
}

async fn serve(app: Arc<App>, route: &'static Route, request: Request) -> Response {
    let begun = Instant::now();
    let answered = answer(Arc::clone(&app), route, request).await;
    let response = answered.unwrap_or_else(|error| {
        let problem = error.problem();
        match problem.code {
            Code::Internal => {
                let (method, path) = (route.method, route.path);
                (app.config.log)(&format!("{method} {path}: {}", error.full()));
            }
            Code::ReadOnly => *lock(&app.read_only) = Some(error.to_string()),
            _ => {}
        }
        problem_response(&problem)
    });
    let (name, status) = ((route.method, route.path), response.status().as_u16());
    app.metrics.count(name, status, begun.elapsed());
    response
}

/// Refuses with `timeout` if `work`, a part of a request that `what` names, takes longer than `patience`.
async fn within<T>(
    patience: Duration,
    what: &str,
    work: impl Future<Output = Result<T, Error>>,
) -> Result<T, Error> {
    let ended = tokio::time::timeout(patience, work).await;
    ended.unwrap_or_else(|_| {
        let problem = format!(
            "{what} took more than {} seconds; send it again: a request with a key takes effect only once",
            patience.as_secs_f64()
        );
        Err(Error::refused(Code::Timeout, problem))
    })
}

async fn answer(app: Arc<App>, route: &'static Route, request: Request) -> Result<Response, Error> {
    let (mut parts, body) = request.into_parts();
    check_host(&parts.headers, &app.config.hosts)?;
    check_address(&parts.uri)?;
    let peer = parts
        .extensions
        .get::<Peer>()
        .map_or(IpAddr::from([0, 0, 0, 0]), |peer| peer.0);
    let patience = app.config.patience;
    let who = {
        let app = Arc::clone(&app);
        let (method, headers) = (parts.method.clone(), parts.headers.clone());
        let admitted = blocking(move || admit(&app, route, &method, &headers));
        within(patience, "the request", admitted).await?
    };
    let params = RawPathParams::from_request_parts(&mut parts, &())
        .await
        .map_err(|error| Error::refused(Code::BadRequest, error.to_string()))?;
    // Routes with a larger body limit (files, settings, capture plans) have the timeout of an upload.
    let (what, time) = match route.max_body > MAX_BODY_BYTES {
        true => ("the upload", app.config.upload_patience),
        false => ("the request", patience),
    };
    let body = within(time, what, read_body(body, route.max_body)).await?;
    let work = blocking(move || {
        (route.handler)(&Context {
            body,
            params,
            who,
            client: proxy::client(peer, &parts.headers, &app.config.trusted_proxies),
            uri: parts.uri,
            headers: parts.headers,
            now: app.now(),
            app,
        })
    });
    within(patience, "the request", work).await
}

/// Maximum number of bytes beyond the body limit that are read and discarded: a browser whose upload is cut off does
/// not show the response.
const DRAINED_BYTES: usize = 32 * 1024 * 1024;

async fn read_body(body: Body, limit: usize) -> Result<Bytes, Error> {
    let mut chunks = body.into_data_stream();
    let mut bytes = Vec::new();
    let mut total = 0;
    while let Some(chunk) = chunks.next().await {
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
        let problem = format!("the body exceeds {limit} bytes; send less at a time");
        return Err(Error::refused(Code::TooLarge, problem));
    }
    Ok(bytes.into())
}

/// Authorises a request and returns its user; `None` on a route without a role.
fn admit(
    app: &App,
    route: &Route,
    method: &Method,
    headers: &HeaderMap,
) -> Result<Option<Who>, Error> {
    let changes = !matches!(*method, Method::GET | Method::HEAD);
    if changes && bearer(headers).is_none() {
        check_own(app, headers)?;
    }
    let Some(needed) = route.role else {
        return Ok(None);
    };
    let (token, purpose) = credential(app, headers)?;
    let who = app.store.authenticate(&token, purpose, app.now())?;
    if who.role < needed {
        let problem = format!("this requires the role {needed}, yours is {}", who.role);
        return Err(Error::refused(Code::Forbidden, problem));
    }
    Ok(Some(who))
}

/// Refuses requests to a host name that is not this server's. In DNS rebinding an attacker points a name of their own
/// at this address, and the browser treats their page and this server as one origin. `localhost` and IP addresses
/// cannot be pointed elsewhere, so they are always accepted.
fn check_host(headers: &HeaderMap, hosts: &[String]) -> Result<(), Error> {
    let asked = text(headers, &header::HOST).and_then(|host| host.parse::<Authority>().ok());
    let name = asked.as_ref().map_or("", |asked| asked.host());
    let bare = name.trim_start_matches('[').trim_end_matches(']');
    let is_own = name.eq_ignore_ascii_case("localhost")
        || bare.parse::<IpAddr>().is_ok()
        || hosts.iter().any(|host| host.eq_ignore_ascii_case(name));
    if is_own {
        return Ok(());
    }
    let problem = format!(
        "{name:?} is no name of this server; whoever runs it names it with --host if it should be one"
    );
    Err(Error::refused(Code::WrongHost, problem))
}

/// Refuses escaped control characters in an address, as texts have none: PostgreSQL cannot search for NUL.
fn check_address(uri: &Uri) -> Result<(), Error> {
    let is_control = |escape: &str| {
        let digits = escape.get(..2);
        let byte = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
        byte.is_some_and(|byte| byte.is_ascii_control() && !matches!(byte, b'\n' | b'\t'))
    };
    let address = uri.path_and_query().map_or("", |address| address.as_str());
    if address.split('%').skip(1).any(is_control) {
        let problem = "the address holds a control character; remove it";
        return Err(Error::refused(Code::BadRequest, problem));
    }
    Ok(())
}

/// Checks that a changing request with a cookie comes from the page itself (CSRF protection).
fn check_own(app: &App, headers: &HeaderMap) -> Result<(), Error> {
    if text(headers, &HeaderName::from_static("x-annotate")) != Some("1") {
        let problem =
            "requests that change something need the header X-Annotate: 1, or a bearer token";
        return Err(Error::refused(Code::Csrf, problem));
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

fn problem_response(problem: &Problem) -> Response {
    let body = serde_json::to_vec(problem).unwrap_or_default();
    let body = content("application/problem+json", "no-store", body);
    let status = StatusCode::from_u16(problem.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    let seconds = problem.retry_after_secs;
    let retry = seconds.map(|seconds| [(header::RETRY_AFTER, seconds.to_string())]);
    (status, retry, body).into_response()
}

/// Sets the headers of every response.
fn hardened(response: Response, secure: bool) -> Response {
    let of_all = [
        ("content-security-policy", CSP),
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-resource-policy", "same-origin"),
        ("cross-origin-opener-policy", "same-origin"),
        (
            "permissions-policy",
            "camera=(), microphone=(), geolocation=()",
        ),
    ];
    let of_tls = secure.then_some([("strict-transport-security", "max-age=31536000")]);
    (of_all, of_tls, response).into_response()
}
