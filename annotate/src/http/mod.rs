//! The server.
//!
//! Every route is a row of [`ROUTES`] with its required role. `serve` handles what all requests share: it
//! authenticates, checks role and origin, limits body and time, and writes the reply.

mod app;
mod assets;
mod compress;
mod limit;
mod metrics;
mod proxy;
mod routes;
mod socket;
mod stream;

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes};
use axum::extract::{FromRequestParts, RawPathParams, Request};
use axum::http::header::{self, HeaderMap, HeaderName};
use axum::http::uri::Authority;
use axum::http::{Method, StatusCode, Uri};
use axum::response::Response;
use axum::routing::{MethodFilter, on};
use hyper_util::rt::{TokioIo, TokioTimer};
use tower_service::Service;

use crate::Error;
use crate::lock::lock;
use crate::motions::MotionLibrary;
use crate::quality::KeptFigures;
use crate::store::{Store, Who};
use crate::wire::{Code, Problem};
use app::{App, bearer, blocking, credential, packed, reply_response, set, text};
use limit::Limiter;
use metrics::Metrics;
use socket::Socket;

pub use crate::clock::Clock;
pub use app::{Access, Context, Handler, PATIENCE, Reply, Route, ServerConfig, UPLOAD_PATIENCE};
pub use proxy::TrustedProxy;
pub use routes::ROUTES;

/// Maximum number of concurrent connections.
const CONNECTIONS: usize = 1024;
/// Content security policy: pages load only scripts, styles and data of this server.
const CSP: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; \
connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'";

/// How often a store that accepted no writes is tried again.
const TRY_AGAIN: Duration = Duration::from_secs(5);

/// A running server. It stops when dropped.
pub struct Server {
    address: SocketAddr,
    operators: Option<SocketAddr>,
    runtime: Option<tokio::runtime::Runtime>,
    /// Held beyond the end of the runtime: connections to PostgreSQL cannot be closed inside of one.
    _store: Arc<Store>,
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
        mut config: ServerConfig,
    ) -> Result<Self, Error> {
        let listen = config.listen;
        let failed = |source| Error::Listen {
            address: listen.to_string(),
            source,
        };
        // Leases of a store that several servers share go by one clock.
        if let Some(clock) = store.clock()? {
            config.clock = clock;
        }
        crate::jobs::abandon(store.as_ref(), (config.clock)())?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .max_blocking_threads(128)
            .thread_name("annotate-http")
            .enable_all()
            .build()
            .map_err(failed)?;
        let (listener, address) = bind(&runtime, listen)?;
        let operators = config
            .operators
            .map(|operators| bind(&runtime, operators))
            .transpose()?;
        let (last_seq, _) = tokio::sync::watch::channel(store.last_seq()?);
        let store_id = store.id()?;
        let kept = Arc::clone(&store);
        let app = Arc::new(App {
            store,
            store_id,
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
        let operators = operators.map(|(listener, address)| {
            let router = router(&app, routes::OPERATOR_ROUTES);
            runtime.spawn(accept(listener, router, patience));
            address
        });
        runtime.spawn(accept(listener, router(&app, ROUTES), patience));
        Ok(Self {
            address,
            operators,
            runtime: Some(runtime),
            _store: kept,
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

/// Listens on an address.
fn bind(
    runtime: &tokio::runtime::Runtime,
    address: SocketAddr,
) -> Result<(tokio::net::TcpListener, SocketAddr), Error> {
    let failed = |source| Error::Listen {
        address: address.to_string(),
        source,
    };
    let listener = std::net::TcpListener::bind(address).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    let _context = runtime.enter();
    let listener = tokio::net::TcpListener::from_std(listener).map_err(failed)?;
    let bound = listener.local_addr().map_err(failed)?;
    Ok((listener, bound))
}

/// Tries whether a store that accepted no writes accepts them again.
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

async fn accept(listener: tokio::net::TcpListener, router: axum::Router, patience: Duration) {
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
                .serve_connection(TokioIo::new(Socket::new(socket, patience)), service)
                .await;
            // Ignore browsers that disconnect in mid-request.
            drop(served);
        });
    }
}

#[derive(Clone, Copy)]
struct Peer(IpAddr);

fn router(app: &Arc<App>, routes: &'static [Route]) -> axum::Router {
    let mut router = axum::Router::new();
    for route in routes {
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
    let mut response = match answer(Arc::clone(&app), route, request).await {
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

/// Limits the time of a part of a request.
async fn within<T>(
    patience: Duration,
    what: &str,
    work: impl Future<Output = Result<T, Error>>,
) -> Result<T, Error> {
    let ended = tokio::time::timeout(patience, work).await;
    ended.unwrap_or_else(|_| {
        Err(Error::refused(
            Code::Timeout,
            format!(
                "{what} took more than {} seconds; send it again: a request with a key takes effect only once",
                patience.as_secs_f64()
            ),
        ))
    })
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
    check_host(&parts.headers, &app.config.hosts)?;
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
        .map_err(|error| Error::refused(Code::BadRequest, error.to_string()))?
        .iter()
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .collect();
    let body = read_body(body, route.max_body);
    let body = if route.is_upload() {
        within(app.config.upload_patience, "the upload", body).await?
    } else {
        within(patience, "the request", body).await?
    };
    let accepts_gzip = compress::accepts_gzip(&parts.headers);
    let context = Context {
        params,
        who,
        client: proxy::client(peer, &parts.headers, &app.config.trusted_proxies),
        query: query(&parts.uri)?,
        headers: parts.headers,
        body,
        path: parts.uri.path().to_owned(),
        now: app.now(),
        app,
    };
    match route.handler {
        Handler::Work(work) => {
            let work = move || {
                let reply = work(&context)?;
                Ok(if accepts_gzip { packed(reply) } else { reply })
            };
            within(patience, "the request", blocking(work)).await
        }
        // Event streams have no timeout.
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
) -> Result<Option<Who>, Error> {
    let changes = !matches!(*method, Method::GET | Method::HEAD);
    if changes && bearer(headers).is_none() {
        check_own(app, headers)?;
    }
    let Access::Role(needed) = route.access else {
        return Ok(None);
    };
    let (token, purpose) = credential(app, headers)?;
    let who = app.store.authenticate(&token, &[purpose], app.now())?;
    if who.role < needed {
        return Err(Error::refused(
            Code::Forbidden,
            format!("this requires the role {needed}, yours is {}", who.role),
        ));
    }
    Ok(Some(who))
}

/// Refuses requests to a host name that is not this server's. In DNS rebinding an attacker points a name of their own at
/// this address, and the browser takes their page and this server for one origin. `localhost` and IP addresses cannot be
/// pointed elsewhere, so they are always accepted.
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
    Err(Error::refused(
        Code::WrongHost,
        format!(
            "{name:?} is no name of this server; whoever runs it names it with --host if it should be one"
        ),
    ))
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
