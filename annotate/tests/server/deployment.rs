//! The server in production setups: behind a proxy, beside other servers, and monitored.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::Duration;

use annotate::store::{TokenUse, open_sqlite};
use annotate::wire::{Code, Decision, Job, Me, ReviewDone, Role, TaskKind, TaskPage, TaskView};
use flate2::read::GzDecoder;
use serde_json::json;

#[cfg(feature = "postgres")]
use crate::support::person;
use crate::support::{Client, DAY, MINUTE, ROOT, Site, agent, masks, send, serve};

/// The refusal of a login with an unknown token, sent with additional headers.
fn guess(site: &Site, headers: &[(&str, &str)]) -> Code {
    site.log_in("guess", headers).code()
}

#[test]
fn behind_a_trusted_proxy_each_client_has_limits_of_its_own() {
    let proxy = "127.0.0.1".parse().expect("an address");
    let site = Site::with(|config| config.trusted_proxies = vec![proxy]);
    let from = |headers: &[(&str, &str)]| guess(&site, headers);
    for _ in 0..10 {
        let client = [("x-forwarded-for", "192.0.2.1")];
        assert_eq!(from(&client), Code::Unauthenticated);
    }
    assert_eq!(from(&[("x-forwarded-for", "192.0.2.1")]), Code::RateLimited);
    // Addresses written by the client precede the address that the proxy appends.
    for spoofed in ["192.0.2.9, 192.0.2.1", "127.0.0.1, 192.0.2.1"] {
        assert_eq!(from(&[("x-forwarded-for", spoofed)]), Code::RateLimited);
    }
    assert_eq!(from(&[("forwarded", "for=192.0.2.1")]), Code::RateLimited);
    for other in [
        [("x-forwarded-for", "192.0.2.2")],
        [("forwarded", "for=192.0.2.3;proto=https")],
    ] {
        assert_eq!(from(&other), Code::Unauthenticated);
    }
}

#[test]
fn a_right_token_is_never_locked_out_and_counts_for_nothing() {
    let site = Site::new();
    let ann = site.person("ann");
    let log_in = || site.log_in(&ann.token, &[]).status;
    // Several people log in from one address.
    for _ in 0..30 {
        assert_eq!(log_in(), 200);
    }
    for _ in 0..10 {
        assert_eq!(guess(&site, &[]), Code::Unauthenticated);
    }
    assert_eq!(guess(&site, &[]), Code::RateLimited);
    assert_eq!(log_in(), 200);
}

#[test]
fn the_page_stands_at_its_folder_with_and_without_a_slash() {
    let site = Site::new();
    for path in ["/", "/app", "/app/", "/app/mask"] {
        let answered = site.get(path);
        assert_eq!(answered.status, 200, "{path}");
        assert!(answered.body.starts_with(b"<!doctype html>"), "{path}");
    }
}

#[test]
fn only_requests_to_the_servers_own_names_are_answered() {
    let site = Site::with(|config| config.hosts = vec!["annotate.example".to_owned()]);
    let ask = |host: &str| site.get_with("/healthz", &[("host", host)]);
    for own in [
        "127.0.0.1:8765",
        "[::1]:8765",
        "localhost",
        "Annotate.Example",
        "annotate.example:443",
        "192.0.2.7",
    ] {
        assert_eq!(ask(own).status, 200, "{own}");
    }
    for other in [
        "evil.example",
        "annotate.example.evil.example",
        "localhost.evil.example",
    ] {
        let refused = ask(other).problem();
        let said = (refused.status, refused.code);
        assert_eq!(said, (421, Code::WrongHost), "{other}");
    }
    // After DNS rebinding, the attacker's page has the same origin as the request.
    let rebound = [("host", "evil.example"), ("origin", "http://evil.example")];
    assert_eq!(guess(&site, &rebound), Code::WrongHost);
}

#[test]
fn a_client_that_is_no_trusted_proxy_is_counted_by_its_own_address() {
    let site = Site::new();
    let from = |client: &str| guess(&site, &[("x-forwarded-for", client)]);
    for number in 0..10 {
        assert_eq!(from(&format!("192.0.2.{number}")), Code::Unauthenticated);
    }
    assert_eq!(from("192.0.2.99"), Code::RateLimited);
}

#[test]
fn asking_whether_the_server_is_ready_writes_nothing() {
    let site = Site::new();
    let log = site.folder.path().join("store.sqlite-wal");
    let before = std::fs::read(&log).expect("a write-ahead log");
    for _ in 0..3 {
        let ready = site.get("/readyz");
        assert_eq!((ready.status, ready.text().as_str()), (200, "ready\n"));
    }
    assert_eq!(std::fs::read(&log).expect("a write-ahead log"), before);
}

#[test]
fn figures_for_operators_have_an_address_of_their_own() {
    let free = ([127, 0, 0, 1], 0).into();
    let site = Site::with(|config| config.operators = Some(free));
    let operators = site.server.operators().expect("a second address");
    let get = |path: &str| {
        let url = format!("http://{operators}{path}");
        send(&agent(), "GET", &url, &[], None)
    };
    let figures = get("/metrics");
    assert_eq!(figures.status, 200);
    let text = figures.text();
    assert!(text.contains("annotate_log_entries"), "{text}");
    for path in ["/healthz", "/readyz"] {
        assert_eq!(get(path).status, 200, "{path}");
    }
    // The address for operators serves nothing else.
    for path in ["/", "/api/v1/me", "/api/v1/session"] {
        assert_eq!(get(path).code(), Code::NotFound, "{path}");
    }
    assert!(Site::new().server.operators().is_none());
}

/// A connection to the server with a timeout of one minute.
pub(crate) fn connect(site: &Site) -> TcpStream {
    let stream = TcpStream::connect(site.server.address()).expect("a connection");
    let minute = Some(Duration::from_secs(60));
    stream.set_read_timeout(minute).expect("a limit");
    stream.set_write_timeout(minute).expect("a limit");
    stream
}

/// Sends the head of a request with a body, on a new connection.
fn begin(site: &Site, client: &Client, path: &str, length: usize) -> TcpStream {
    let mut stream = connect(site);
    let head = format!(
        "POST {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAuthorization: Bearer {}\r\n\
         Content-Length: {length}\r\n\r\n",
        client.token
    );
    stream.write_all(head.as_bytes()).expect("the server reads");
    stream
}

fn status_line(mut stream: TcpStream) -> String {
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer");
    answer.lines().next().unwrap_or_default().to_owned()
}

#[test]
fn an_upload_may_take_longer_than_other_requests() {
    let site = Site::with_patience(Duration::from_secs(2));
    let boss = site.person("boss");
    let mut upload = begin(&site, &boss, "/api/v1/imports?format=stance", 2);
    upload.write_all(b"{").expect("the server reads");
    // Another request with half a body is aborted after the timeout.
    let late = begin(&site, &boss, "/api/v1/queue/next", 2);
    assert_eq!(status_line(late), "HTTP/1.1 503 Service Unavailable");
    upload.write_all(b"}").expect("the server still reads");
    assert_eq!(status_line(upload), "HTTP/1.1 200 OK");
}

#[test]
fn an_upload_that_never_ends_is_given_up() {
    let site = Site::with(|config| config.upload_patience = Duration::from_millis(200));
    let boss = site.person("boss");
    let upload = begin(&site, &boss, "/api/v1/imports?format=stance", 2);
    assert_eq!(status_line(upload), "HTTP/1.1 503 Service Unavailable");
}

#[test]
fn a_reader_that_takes_nothing_is_dropped() {
    let site = Site::with_patience(Duration::from_secs(2));
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
fn session(site: &Site, token: &str) -> (String, i64) {
    let answered = site.log_in(token, &[]);
    let cookie = answered.cookie().to_owned();
    let _: Me = answered.ok();
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
pub(crate) fn stream(client: &Client) -> impl Iterator<Item = String> + use<> {
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
fn the_event_stream_of_a_disabled_user_ends() {
    let site = Site::new();
    let [ann, eve] = site.people(["ann", "eve"]);
    let (of_ann, mut of_eve) = (stream(&ann), stream(&eve));
    let change = |user: i64, role, active| {
        let now = site.clock.now();
        let changed = site.store.change_user(None, user, role, active, now);
        changed.expect("a change");
    };
    change(ann.user.id, None, Some(false));
    // The stream ends without an error and sends no more events.
    assert!(!of_ann.into_iter().any(|line| line.starts_with("data:")));
    assert!(of_eve.any(|line| line.contains("role_changed")));
    // A reviewer who becomes an annotator no longer receives events of others.
    change(eve.user.id, Some(Role::Annotator), None);
    let bob = site.person("bob");
    bob.claim(TaskKind::MaskText);
    let task = eve.claim(TaskKind::MaskText).task.id;
    let next = of_eve.find(|line| line.starts_with("data:"));
    let next = next.expect("a change");
    let hers = format!("\"task\":{task},\"mine\":true");
    assert!(next.contains(&hers), "{next}");
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
    store: Arc<annotate::store::Store>,
    folder: tempfile::TempDir,
}

#[cfg(feature = "postgres")]
impl Pair {
    /// `None` without PostgreSQL.
    fn new(test: &str) -> Option<Self> {
        use crate::support::{Hands, START, dataset, plain_settings};
        let Ok(url) = std::env::var("ANNOTATE_TEST_PG") else {
            crate::store::skipped(test);
            return None;
        };
        let schema = format!("d{}_{test}", std::process::id());
        let open = || annotate::store::open_postgres(&url, &schema).expect("a store on PostgreSQL");
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
fn leases_go_by_the_clock_of_the_database_and_not_by_those_of_the_servers() {
    let Some(site) = Pair::new("clock") else {
        return;
    };
    let ([ann, _], [_, bob]) = (site.person("ann"), site.person("bob"));
    // The database runs on this machine.
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
}

#[test]
#[cfg(feature = "postgres")]
fn an_export_is_reachable_through_both_servers() {
    let Some(site) = Pair::new("exports") else {
        return;
    };
    let admins = site.person("boss");
    let started: Job = admins[0]
        .post("exports", &json!({ "format": "parquet", "events": true }))
        .ok();
    let job = crate::transfer::finished(&admins[0], started.id);
    assert_eq!(job.state, "done", "{:?}", job.messages);
    assert!(!job.files.is_empty());
    let files = || {
        job.files.iter().map(|name| {
            let path = format!("jobs/{}/files/{name}", job.id);
            (name, admins.each_ref().map(|admin| admin.get(&path)))
        })
    };
    let check = || {
        for (name, [one, other]) in files() {
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
fn a_connection_to_postgresql_is_encrypted_and_its_certificate_checked() {
    use annotate::store::open_postgres;
    let addresses = ["ANNOTATE_TEST_PG_TLS", "ANNOTATE_TEST_PG_CA"].map(std::env::var);
    let [Ok(url), Ok(authority)] = addresses else {
        crate::store::skipped("tls");
        return;
    };
    // This server accepts only encrypted connections.
    let schema = format!("d{}_tls", std::process::id());
    let trusted = format!("{url}?sslmode=verify-full&sslrootcert={authority}");
    let store = open_postgres(&trusted, &schema).expect("an encrypted store");
    store.ready().expect("it answers");
    let refused = |url: &str| match open_postgres(url, &schema) {
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
    let lease = eve.review().expect("a review").lease.epoch;
    let author = json!({ "author": bob.user.id });
    let _: ReviewDone = eve.decide(known, lease, Decision::Accept, author).ok();
    let gold = site.store.make_gold(ROOT, known, site.clock.now());
    let gold = gold.expect("a gold task");
    site.set(|settings| settings.gold_percent = 100);
    let (to_ann, mut to_eve) = (stream(&ann), stream(&eve));
    assert_eq!(ann.answer(masks("waving")), gold);
    let other = ann.claim(TaskKind::MaskText);
    let view: TaskView = ann.get(&format!("tasks/{gold}")).ok();
    let drafts = |view: &TaskView| view.suggestions.iter().any(|draft| draft.id > 0);
    assert!(drafts(&view), "the drafts of the task it was copied from");
    let mut told = to_ann.filter(|line| line.starts_with("data:"));
    let last = format!("\"task\":{}", other.task.id);
    for (kind, words) in [
        ("claimed", ""),
        ("submitted", ""),
        ("claimed", last.as_str()),
    ] {
        let line = told.next().expect("a change");
        let kind = format!("\"kind\":\"{kind}\"");
        assert!(line.contains(&kind) && line.contains(words), "{line}");
    }
    assert!(to_eve.any(|line| line.contains("gold_scored")));
    let everybody = "tasks?kind=mask_text&skipped=everybody&limit=5";
    let skipped: TaskPage = eve.get(everybody).ok();
    assert_eq!((skipped.rows.len(), skipped.next), (0, None));
}
