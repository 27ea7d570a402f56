//! Hostile input: requests, imports and names.

use std::io::{Read, Write};
use std::time::Duration;

use annotate::wire::{Code, EventKind, Job, TaskKind, TaskView};

use crate::deployment::connect;
use crate::support::{Site, event, masks};
use crate::transfer::finished;

#[test]
fn texts_are_kept_as_they_are_and_sent_as_data() {
    let site = Site::new();
    let ann = site.person("ann");
    let view = ann.claim(TaskKind::MaskText);
    let lease = view.lease.as_ref().expect("a lease").epoch;
    let nasty = "<script>alert(1)</script> \u{202e}evil \u{0301}' OR 1=1; DROP TABLE event; --";
    let sent = ann.tell(&view, event(EventKind::Draft, lease, 0, masks(nasty)));
    assert_eq!(sent.status, 200);
    let answered = ann.get(&format!("tasks/{}", view.task.id));
    let mime = answered.header("content-type");
    assert_eq!(mime, Some("application/json"));
    let again: TaskView = answered.ok();
    assert_eq!(again.mine.expect("a draft").answer, masks(nasty));
    site.whole();
}

#[test]
fn texts_that_are_too_long_or_hold_control_characters_are_refused_and_nothing_is_logged() {
    let site = Site::new();
    let ann = site.person("ann");
    let view = ann.claim(TaskKind::MaskText);
    let lease = view.lease.as_ref().expect("a lease").epoch;
    let before = site.store.last_seq().expect("a place");
    for text in [
        "x".repeat(2001),
        "a\u{0}b".to_owned(),
        "\u{1b}[2J".to_owned(),
    ] {
        let draft = event(EventKind::Draft, lease, 0, masks(&text));
        let problem = ann.tell(&view, draft).problem;
        assert_eq!(problem.expect("a problem").code, Code::Invalid);
    }
    let huge = format!("{{\"events\":\"{}\"}}", "x".repeat(10 << 20));
    let path = format!("tasks/{}/events", view.task.id);
    let refused = ann.call("POST", &path, Some(huge.as_bytes()));
    assert_eq!(refused.code(), Code::TooLarge);
    assert_eq!(site.store.last_seq().expect("a place"), before);
}

#[test]
fn deep_and_broken_json_is_refused() {
    let site = Site::new();
    let ann = site.person("ann");
    let deep = "[".repeat(100_000);
    for body in [
        deep.as_bytes(),
        b"\xff\xfe",
        b"null",
        b"{\"kind\":\"mask_text\"} trailing",
    ] {
        let refused = ann.call("POST", "queue/next", Some(body));
        assert_eq!(refused.code(), Code::BadRequest);
    }
}

#[test]
fn paths_do_not_climb() {
    let site = Site::new();
    let boss = site.person("boss");
    for path in [
        "/assets/../Cargo.toml",
        "/assets/..%2f..%2fCargo.toml",
        "/assets/%2e%2e/Cargo.toml",
        "/assets//etc/passwd",
    ] {
        assert_eq!(site.get(path).status, 404, "{path}");
    }
    for name in ["..%2f..%2fstore.sqlite", "%2fetc%2fpasswd"] {
        let answered = boss.get(&format!("jobs/1/files/{name}"));
        assert_eq!(answered.status, 404, "{name}");
    }
}

#[test]
fn tokens_are_not_taken_from_the_address_or_from_odd_headers() {
    let site = Site::new();
    let ann = site.person("ann");
    let bearer = format!("Bearer {}", ann.token);
    let cookie = format!("annotate-{}=x", site.store.id().expect("an id"));
    let by_query = format!("/api/v1/me?token={}", ann.token);
    assert_eq!(site.get(&by_query).status, 401);
    let good = ("authorization", bearer.as_str());
    let bare = ("authorization", ann.token.as_str());
    let cookie = ("cookie", cookie.as_str());
    let cases: [&[(&str, &str)]; 3] = [&[bare], &[good, ("authorization", "Bearer x")], &[cookie]];
    for headers in cases {
        assert_eq!(site.get_with("/api/v1/me", headers).status, 401);
    }
}

/// The server's response to an incomplete request. The server has to close the connection in time.
fn answer_to(site: &Site, bytes: &[u8]) -> String {
    let mut stream = connect(site);
    stream.write_all(bytes).expect("the server reads");
    let mut answer = Vec::new();
    let read = stream.read_to_end(&mut answer);
    read.expect("it closes the connection");
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn requests_that_never_end_are_given_up() {
    let site = Site::with_patience(Duration::from_secs(2));
    let ann = site.person("ann");
    // Headers without an end.
    let head = "GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Slow: ";
    let answer = answer_to(&site, head.as_bytes());
    assert!(!answer.contains("200 OK"), "{answer}");
    // A body shorter than its content length.
    let body = format!(
        "POST /api/v1/queue/next HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\
         Authorization: Bearer {}\r\nContent-Length: 100\r\n\r\n{{",
        ann.token
    );
    let answer = answer_to(&site, body.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 503"), "{answer}");
    assert!(answer.contains("\"timeout\""), "{answer}");
    // Other requests are served during and after an incomplete one.
    assert_eq!(ann.get("me").status, 200);
}

#[test]
fn an_import_that_is_no_release_fails_and_says_why() {
    let site = Site::new();
    let boss = site.person("boss");
    let import = |format: &str, body: &[u8]| {
        let path = format!("imports?format={format}");
        let job: Job = boss.call("POST", &path, Some(body)).ok();
        finished(&boss, job.id)
    };
    for body in ["[]", "{", "{\"mask_all\": 7}", "{\"other\": {}}"] {
        let job = import("stance", body.as_bytes());
        assert_eq!(job.state, "failed", "{body}");
        assert!(!job.messages.is_empty());
    }
    assert_eq!(import("annotations", b"PAR1 or not").state, "failed");
    // The upload was stored in the server's data folder, and removed.
    let kept = std::fs::read_dir(site.folder.path().join("data").join("imports"));
    assert_eq!(kept.expect("the folder").count(), 0);
}
