//! The server in production setups: behind a proxy, beside other servers, and monitored.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use annotate::store::{TokenUse, open_sqlite};
use annotate::wire::{Change, Code, Job, Me, Role, TaskKind, TaskPage, TaskView};
use flate2::read::GzDecoder;

#[cfg(feature = "postgres")]
use crate::support::person;
use crate::support::{Answered, Client, DAY, MINUTE, ROOT, Site, agent, masks, send, serve};

/// The response to a login with an unknown token, sent with additional headers.
fn guess(site: &Site, headers: &[(&str, &str)]) -> Answered {
    site.log_in("guess", headers)
}

#[test]
fn behind_a_trusted_proxy_each_client_has_limits_of_its_own() {
    let proxy = "127.0.0.1".parse().expect("an address");
    let site = Site::with(|config| config.trusted_proxies = vec![proxy]);
    let of = |list: &str| guess(&site, &[("x-forwarded-for", list)]).code();
    for _ in 0..10 {
        assert_eq!(of("192.0.2.1"), Code::Unauthenticated);
    }
    // Addresses written by the client precede the address that the proxy appends.
    for list in ["192.0.2.1", "192.0.2.9, 192.0.2.1", "127.0.0.1, 192.0.2.1"] {
        assert_eq!(of(list), Code::RateLimited);
    }
    assert_eq!(of("192.0.2.2"), Code::Unauthenticated);
    for (host, code) in [
        ("192.0.2.1", Code::RateLimited),
        ("192.0.2.3", Code::Unauthenticated),
    ] {
        let field = format!("for={host};proto=https");
        assert_eq!(guess(&site, &[("forwarded", &field)]).code(), code);
    }
}

#[test]
fn wrong_tokens_are_few_in_a_minute_and_a_right_one_is_never_locked_out() {
    let site = Site::new();
    let ann = site.person("ann");
    let log_in = || site.log_in(&ann.token, &[]).status;
    // This client is no trusted proxy, so the address that it names does not count.
    let from = |number: usize| {
        let address = format!("192.0.2.{number}");
        guess(&site, &[("x-forwarded-for", &address)])
    };
    // Several people log in from one address.
    for _ in 0..30 {
        assert_eq!(log_in(), 200);
    }
    for number in 0..10 {
        assert_eq!(from(number).code(), Code::Unauthenticated);
    }
    let refused = from(99);
    assert_eq!(refused.code(), Code::RateLimited);
    assert_eq!(refused.header("retry-after"), Some("60"));
    assert_eq!(log_in(), 200);
    site.clock.advance(MINUTE);
    assert_eq!(from(0).code(), Code::Unauthenticated);
}

#[test]
fn only_requests_to_the_servers_own_names_are_answered() {
    let site = Site::with(|config| config.hosts = vec!["annotate.example".to_owned()]);
    let ask = |host: &str| site.get_with("/healthz", &[("host", host)]);
    let own = "127.0.0.1:8765 [::1]:8765 localhost Annotate.Example annotate.example:443 192.0.2.7";
    for host in own.split(' ') {
        assert_eq!(ask(host).status, 200, "{host}");
    }
    for host in [
        "evil.example",
        "annotate.example.evil.example",
        "localhost.evil.example",
    ] {
        let refused = ask(host).problem();
        let said = (refused.status, refused.code);
        assert_eq!(said, (421, Code::WrongHost), "{host}");
    }
    // After DNS rebinding, the attacker's page has the same origin as the request.
    let rebound = [("host", "evil.example"), ("origin", "http://evil.example")];
    assert_eq!(guess(&site, &rebound).code(), Code::WrongHost);
}

#[test]
fn figures_for_operators_have_an_address_of_their_own_and_asking_for_them_writes_nothing() {
    let free = ([127, 0, 0, 1], 0).into();
    let site = Site::with(|config| config.operators = Some(free));
    let operators = site.server.operators().expect("a second address");
    let get = |path: &str| {
        let url = format!("http://{operators}{path}");
        send(&agent(), "GET", &url, &[], None)
    };
    let log = site.folder.path().join("store.sqlite-wal");
    let before = std::fs::read(&log).expect("a write-ahead log");
    let figures = get("/metrics");
    assert_eq!(figures.status, 200);
    let text = figures.text();
    assert!(text.contains("annotate_log_entries"), "{text}");
    assert_eq!(get("/healthz").status, 200);
    for ready in [get("/readyz"), site.get("/readyz")] {
        assert_eq!((ready.status, ready.text().as_str()), (200, "ready\n"));
    }
    assert_eq!(std::fs::read(&log).expect("a write-ahead log"), before);
    // The address for operators serves nothing else.
    for path in ["/", "/api/v1/me", "/api/v1/session"] {
        assert_eq!(get(path).code(), Code::NotFound, "{path}");
    }
    assert!(Site::new().server.operators().is_none());
}

/// A connection to the server with a timeout of one minute.
fn connect(site: &Site) -> TcpStream {
    let stream = TcpStream::connect(site.server.address()).expect("a connection");
    let minute = Some(Duration::from_secs(60));
    stream.set_read_timeout(minute).expect("a limit");
    stream.set_write_timeout(minute).expect("a limit");
    stream
}

/// Sends the head of a request with a body of two bytes, on a new connection.
fn begin(site: &Site, client: &Client, path: &str) -> TcpStream {
    let mut stream = connect(site);
    let head = format!(
        "POST {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAuthorization: Bearer {}\r\n\
         Content-Length: 2\r\n\r\n",
        client.token
    );
    stream.write_all(head.as_bytes()).expect("the server reads");
    stream
}

/// The text that the server sends until it closes the connection.
fn said(mut stream: TcpStream) -> String {
    let mut answer = Vec::new();
    let read = stream.read_to_end(&mut answer);
    read.expect("it closes the connection");
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn requests_that_never_end_are_given_up_and_an_upload_may_take_longer() {
    const UPLOAD: &str = "/api/v1/imports?format=stance";
    let given_up = "HTTP/1.1 503 Service Unavailable";
    let site = Site::with(|config| config.patience = Duration::from_secs(2));
    let boss = site.person("boss");
    // These headers never end.
    let mut headers = connect(&site);
    let begun = headers.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Slow: ");
    begun.expect("the server reads");
    let answer = said(headers);
    assert!(!answer.contains("200 OK"), "{answer}");
    let mut upload = begin(&site, &boss, UPLOAD);
    upload.write_all(b"{").expect("the server reads");
    // Another request with half a body is aborted after the timeout.
    let mut late = begin(&site, &boss, "/api/v1/queue/next");
    late.write_all(b"{").expect("the server reads");
    let answer = said(late);
    assert!(answer.starts_with(given_up), "{answer}");
    assert!(answer.contains("\"timeout\""), "{answer}");
    // Other requests are served during and after an incomplete one.
    assert_eq!(boss.get("me").status, 200);
    upload.write_all(b"}").expect("the server still reads");
    assert!(said(upload).starts_with("HTTP/1.1 200 OK"));

    let site = Site::with(|config| config.upload_patience = Duration::from_millis(200));
    let upload = begin(&site, &site.person("boss"), UPLOAD);
    assert!(said(upload).starts_with(given_up));
}

#[test]
fn a_reader_that_takes_nothing_is_dropped() {
    let site = Site::with(|config| config.patience = Duration::from_secs(2));
    let mut stream = connect(&site);
    // Send requests until the responses fill all buffers and the server stops reading.
    let request = b"GET /assets/vendor-three.js HTTP/1.1\r\nHost: localhost\r\n\r\n";
    let error = loop {
        if let Err(error) = stream.write_all(request) {
            break error;
        }
    };
    let dropped = [ErrorKind::ConnectionReset, ErrorKind::BrokenPipe];
    let is_dropped = dropped.contains(&error.kind());
    assert!(is_dropped, "the server keeps the connection: {error}");
    assert_eq!(site.get("/healthz").status, 200);
}

#[test]
fn responses_are_compressed_for_those_who_accept_it() {
    let site = Site::new();
    let unpacked = |bytes: &[u8]| {
        let mut plain = Vec::new();
        GzDecoder::new(bytes).read_to_end(&mut plain).expect("gzip");
        plain
    };
    for name in ["app.js", "vendor-three.js", "app.css"] {
        let path = format!("/assets/{name}");
        let plain = site.get_with(&path, &[("accept-encoding", "identity")]);
        assert_eq!(plain.header("content-encoding"), None, "{name}");
        let all = [("accept-encoding", "gzip, deflate, br, zstd")];
        let packed = site.get_with(&path, &all);
        let (encoding, vary) = (packed.header("content-encoding"), packed.header("vary"));
        assert_eq!(encoding, Some("gzip"), "{name}");
        assert_eq!(vary, Some("accept-encoding"), "{name}");
        assert!(packed.body.len() * 5 < plain.body.len() * 2, "{name}");
        assert_eq!(unpacked(&packed.body), plain.body, "{name}");
        let tag = packed.header("etag").expect("a tag");
        // A tag shared by both encodings has to be weak.
        assert!(tag.starts_with("W/"), "{name}");
        assert_eq!(plain.header("etag"), Some(tag), "{name}");
        let known = [("accept-encoding", "gzip"), ("if-none-match", tag)];
        let again = site.get_with(&path, &known);
        assert_eq!((again.status, again.body.len()), (304, 0), "{name}");
        assert_eq!(again.header("content-encoding"), None, "{name}");
        for (field, value) in [("cache-control", "no-cache"), ("vary", "accept-encoding")] {
            assert_eq!(again.header(field), Some(value), "{name}");
        }
    }
    let bearer = format!("Bearer {}", site.person("boss").token);
    let ask = |encoding: &str| {
        let bearer = ("authorization", bearer.as_str());
        site.get_with("/api/v1/settings", &[bearer, ("accept-encoding", encoding)])
    };
    let (plain, packed) = (ask("identity"), ask("gzip"));
    assert_eq!(packed.header("content-encoding"), Some("gzip"));
    assert_eq!(packed.header("content-type"), Some("application/json"));
    assert_eq!(unpacked(&packed.body), plain.body);
}

/// A session begun with a token: its cookie, and the seconds it is kept for.
pub(crate) fn session(site: &Site, token: &str) -> (String, i64) {
    let answered = site.log_in(token, &[]);
    let cookie = answered.header("set-cookie").expect("a cookie").to_owned();
    let _: Me = answered.ok();
    for part in ["HttpOnly", "SameSite=Strict", "Path=/"] {
        assert!(cookie.contains(part), "{cookie}");
    }
    let age = cookie.split("Max-Age=").nth(1);
    let age = age.and_then(|rest| rest.split(';').next()?.parse().ok());
    let pair = cookie.split(';').next().expect("a pair");
    (pair.to_owned(), age.expect("an age"))
}

#[test]
fn a_session_ends_with_the_token_it_was_begun_by() {
    let site = Site::new();
    let ann = site.person("ann").user.id;
    let issue = |purpose, days| {
        let now = site.clock.now();
        let issued = site.store.issue(ann, purpose, now + days * DAY, now);
        issued.expect("a token").token
    };
    let status = |cookie: &String| {
        let me = site.get_with("/api/v1/me", &[("cookie", cookie)]);
        me.status
    };
    let (short, age) = session(&site, &issue(TokenUse::Token, 2));
    assert_eq!(age, 2 * DAY / 1000);
    let (long, age) = session(&site, &issue(TokenUse::Token, 30));
    assert_eq!(age, 7 * DAY / 1000);
    // A link can be used for one login, and its session lasts as long as any other.
    let (linked, age) = session(&site, &issue(TokenUse::Once, 1));
    assert_eq!(age, 7 * DAY / 1000);
    site.clock.advance(2 * DAY);
    let all = [&short, &long, &linked].map(status);
    assert_eq!(all, [401, 200, 200]);
    site.clock.advance(5 * DAY);
    assert_eq!([status(&long), status(&linked)], [401, 401]);
}

/// The lines of a user's event stream after the first.
fn stream(client: &Client) -> impl Iterator<Item = String> + use<> {
    let agent = ureq::Agent::config_builder()
        .timeout_recv_body(Some(Duration::from_secs(60)))
        .build()
        .new_agent();
    let response = agent
        .get(format!("{}/api/v1/stream", client.base))
        .header("authorization", format!("Bearer {}", client.token))
        .call()
        .expect("a stream");
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    let mut lines = BufReader::new(response.into_body().into_reader())
        .lines()
        .map(|line| line.expect("the stream goes on or ends"));
    assert_eq!(lines.next().as_deref(), Some(": connected"));
    lines
}

#[test]
fn the_stream_tells_reviewers_of_all_changes_and_others_nothing() {
    let site = Site::new();
    let [ann, eve, zoe] = site.people(["ann", "eve", "zoe"]);
    assert_eq!(ann.get("stream").code(), Code::Forbidden);
    let mut of_eve = stream(&eve);
    let hers = ann.claim(TaskKind::MaskText).task.id;
    let data = of_eve.find_map(|line| line.strip_prefix("data: ").map(str::to_owned));
    let told: Change = serde_json::from_str(&data.expect("a change")).expect("a change");
    assert_eq!((told.task, told.kind.as_str()), (Some(hers), "claimed"));

    let change = |user: i64, role, active| {
        let now = site.clock.now();
        let changed = site.store.change_user(None, user, role, active, now);
        changed.expect("a change");
    };
    change(zoe.user.id, Some(Role::Reviewer), None);
    let mut of_zoe = stream(&zoe);
    change(zoe.user.id, None, Some(false));
    // The stream ends without an error and sends no more events.
    assert!(!of_zoe.any(|line| line.starts_with("data:")));
    assert!(of_eve.any(|line| line.contains("role_changed")));
    // A reviewer who becomes an annotator is told nothing more.
    change(eve.user.id, Some(Role::Annotator), None);
    assert!(!of_eve.any(|line| line.contains("claimed")));
}

#[test]
fn a_server_that_starts_leaves_the_jobs_of_others_running_and_lost_ones_fail() {
    let site = Site::new();
    let boss = site.person("boss");
    let put = || {
        let running = Job {
            kind: "export".to_owned(),
            format: "parquet".to_owned(),
            state: "running".to_owned(),
            ..Job::default()
        };
        let put = site.store.put_job(running, site.clock.now());
        put.expect("a job").id
    };
    let (lost, kept) = (put(), put());
    let data = site.folder.path().join("other");
    let store = open_sqlite(&site.folder.path().join("store.sqlite")).expect("the same store");
    let server = serve(&store, &site.clock, &site.dataset, data, |_| {});
    let other = boss.at(format!("http://{}", server.address()));
    let state = |job: i64| other.get(&format!("jobs/{job}")).ok::<Job>().state;
    assert_eq!([state(lost), state(kept)], ["running", "running"]);
    // One of the two jobs keeps reporting, and the other stops.
    for _ in 0..4 {
        site.clock.advance(MINUTE / 2);
        site.store.beat(kept, site.clock.now()).expect("a report");
    }
    assert_eq!([state(lost), state(kept)], ["failed", "running"]);
    let jobs: Vec<Job> = boss.get("jobs").ok();
    let lost = jobs.iter().find(|job| job.id == lost).expect("the job");
    assert!(lost.finished.is_some() && lost.messages[0].contains("start the job again"));
    // A late report does not make the job run again.
    let late = site.store.beat(lost.id, site.clock.now());
    late.expect("a report");
    assert_eq!(state(lost.id), "failed");
}

/// Two servers on one store on PostgreSQL, each with a separate folder for files.
#[cfg(feature = "postgres")]
struct Pair {
    servers: [annotate::http::Server; 2],
    store: std::sync::Arc<annotate::store::Store>,
    folder: tempfile::TempDir,
}

#[cfg(feature = "postgres")]
impl Pair {
    /// `None` without PostgreSQL.
    fn new(test: &str) -> Option<Self> {
        use crate::support::{Hands, START, dataset, plain_settings};
        let Ok(url) = std::env::var("ANNOTATE_TEST_PG") else {
            crate::fixture::skipped(test);
            return None;
        };
        let schema = format!("d{}_{test}", std::process::id());
        let open = || {
            let opened = annotate::store::open_postgres(&url, &schema, true);
            opened.expect("a store on PostgreSQL")
        };
        let folder = tempfile::tempdir().expect("a folder");
        let root = folder.path().join("dataset");
        dataset(&root);
        let stores = [open(), open()];
        plain_settings(&stores[0]);
        annotate::transfer::from_dataset(&stores[0], &root, None, START, &mut |_, _| {})
            .expect("imports");
        // The clock of each server is wrong by a different amount.
        let server = |index: usize| {
            let clock = Hands::at(START + 100 * DAY * index as i64);
            let data = folder.path().join(format!("data{index}"));
            serve(&stores[index], &clock, &root, data, |_| {})
        };
        let servers = [server(0), server(1)];
        let [store, _] = stores;
        Some(Self {
            servers,
            store,
            folder,
        })
    }

    /// A user, with a client for each of the servers.
    fn person(&self, name: &str) -> [Client; 2] {
        let bases = [0, 1].map(|index| format!("http://{}", self.servers[index].address()));
        let [one, other] = bases;
        let first = person(&self.store, &one, name, 0);
        let second = first.at(other);
        [first, second]
    }
}

#[test]
#[cfg(feature = "postgres")]
fn two_servers_share_the_clock_of_the_database_and_its_exports() {
    let Some(site) = Pair::new("servers") else {
        return;
    };
    let ([ann, _], [_, bob]) = (site.person("ann"), site.person("bob"));
    // The database runs on this machine, so this is its time too.
    let now = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .expect("after 1970")
        .as_millis() as i64;
    let hers = ann.claim(TaskKind::MaskText);
    let his = bob.claim(TaskKind::MaskText);
    assert_ne!(hers.task.id, his.task.id, "her lease has not expired");
    for view in [hers, his] {
        let left = view.lease.expect("a lease").expires - now;
        assert!((14 * MINUTE..17 * MINUTE).contains(&left), "{left}");
    }

    let admins = site.person("boss");
    let what = serde_json::json!({ "format": "parquet", "events": true });
    let started: Job = admins[0].post("exports", &what).ok();
    let job = crate::transfer::finished(&admins[0], started.id);
    assert_eq!(job.state, "done", "{:?}", job.messages);
    assert!(!job.files.is_empty());
    let check = || {
        for name in &job.files {
            let path = format!("jobs/{}/files/{name}", job.id);
            let [one, other] = admins.each_ref().map(|admin| admin.get(&path));
            assert_eq!((one.status, other.status), (200, 200));
            assert_eq!(one.body, other.body);
            let begin: &[u8] = if name == "export.json" { b"{" } else { b"PAR1" };
            assert!(one.body.starts_with(begin), "{name}");
        }
    };
    check();
    // The files remain available if the server that wrote them loses its disk.
    std::fs::remove_dir_all(site.folder.path().join("data0")).expect("a folder");
    check();
}

#[test]
#[cfg(feature = "postgres")]
fn a_store_on_postgresql_is_only_created_on_purpose() {
    use annotate::store::open_postgres;
    let Ok(url) = std::env::var("ANNOTATE_TEST_PG") else {
        crate::fixture::skipped("existing");
        return;
    };
    let schema = format!("d{}_existing", std::process::id());
    // The second try finds what the first one left.
    for _ in 0..2 {
        let Err(missing) = open_postgres(&url, &schema, false) else {
            panic!("there is a store");
        };
        assert!(matches!(missing, annotate::Error::Missing { .. }));
        let said = missing.to_string();
        for part in ["there is no store", &schema, "stance annotate"] {
            assert!(said.contains(part), "{said}");
        }
    }
    let id = open_postgres(&url, &schema, true)
        .expect("a new store")
        .id();
    let found = open_postgres(&url, &schema, false).expect("the store");
    assert_eq!(found.id().expect("an id"), id.expect("an id"));
}

#[test]
#[cfg(feature = "postgres")]
fn a_connection_to_postgresql_is_encrypted_and_its_certificate_checked() {
    use annotate::store::open_postgres;
    let addresses = ["ANNOTATE_TEST_PG_TLS", "ANNOTATE_TEST_PG_CA"].map(std::env::var);
    let [Ok(url), Ok(authority)] = addresses else {
        crate::fixture::skipped("tls");
        return;
    };
    // This server accepts only encrypted connections.
    let schema = format!("d{}_tls", std::process::id());
    let trusted = format!("{url}?sslmode=verify-full&sslrootcert={authority}");
    let store = open_postgres(&trusted, &schema, true).expect("an encrypted store");
    store.ready().expect("it answers");
    let refused = |url: &str| match open_postgres(url, &schema, true) {
        Ok(_) => panic!("{url} is taken"),
        Err(error) => error.to_string(),
    };
    let plain = refused(&format!("{url}?sslmode=disable"));
    assert!(plain.contains("no encryption"), "{plain}");
    let unknown = refused(&format!("{url}?sslmode=require"));
    assert!(unknown.contains("sslrootcert=FILE"), "{unknown}");
    let elsewhere = refused(&trusted.replace("localhost", "127.0.0.1"));
    let why = "name the host as the certificate";
    assert!(elsewhere.contains(why), "{elsewhere}");
}

#[test]
fn annotators_are_not_told_which_tasks_are_gold() {
    let site = Site::new();
    let [ann, bob, eve] = site.people(["ann", "bob", "eve"]);
    let known = bob.answer(masks("waving"));
    assert_eq!(eve.accept_all(), 1);
    let gold = site.store.make_gold(ROOT, known, site.clock.now());
    let gold = gold.expect("a gold task");
    site.set(|settings| settings.gold_percent = 100);
    let mut to_eve = stream(&eve);
    assert_eq!(ann.answer(masks("waving")), gold);
    let view: TaskView = ann.get(&format!("tasks/{gold}")).ok();
    let drafts = |view: &TaskView| view.suggestions.iter().any(|draft| draft.id > 0);
    assert!(drafts(&view), "the drafts of the task it was copied from");
    let original = site.store.task_record(known).expect("a task");
    assert_eq!(view.task.wanted, original.wanted);
    assert!(to_eve.any(|line| line.contains("gold_scored")));
    let everybody = "tasks?kind=mask_text&skipped=everybody&limit=5";
    let skipped: TaskPage = eve.get(everybody).ok();
    assert_eq!((skipped.rows.len(), skipped.next), (0, None));
}
