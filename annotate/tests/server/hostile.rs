//! Hostile input: requests, imports and names.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use annotate::wire::{Code, EventKind, EventResults, Role, TaskKind, TaskView};
use serde_json::json;

use crate::support::{Site, agent, event, masks, send};

#[test]
fn texts_are_kept_as_they_are_and_sent_as_data() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let view = ann.claim(TaskKind::MaskText);
    let lease = view.lease.as_ref().expect("a lease").epoch;
    let path = format!("tasks/{}/events", view.task.id);
    let nasty = "<script>alert(1)</script> \u{202e}evil \u{0301}' OR 1=1; DROP TABLE event; --";
    let sent: EventResults = ann
        .post(
            &path,
            &json!({ "events": [event(EventKind::Draft, lease, 0, Some(masks(nasty)))] }),
        )
        .ok();
    assert_eq!(sent.results[0].status, 200);
    let answered = ann.get(&format!("tasks/{}", view.task.id));
    assert_eq!(
        answered
            .headers
            .get("content-type")
            .and_then(|value| value.to_str().ok()),
        Some("application/json")
    );
    let again: TaskView = answered.ok();
    assert_eq!(again.mine.expect("a draft").answer, masks(nasty));
    assert!(site.store.verify().expect("checks").is_empty());
}

#[test]
fn texts_that_are_too_long_or_hold_control_characters_are_refused_and_nothing_is_logged() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let view = ann.claim(TaskKind::MaskText);
    let lease = view.lease.as_ref().expect("a lease").epoch;
    let path = format!("tasks/{}/events", view.task.id);
    let before = site.store.last_seq().expect("a place");
    for text in [
        "x".repeat(2001),
        "a\u{0}b".to_owned(),
        "\u{1b}[2J".to_owned(),
    ] {
        let sent: EventResults = ann
            .post(
                &path,
                &json!({ "events": [event(EventKind::Draft, lease, 0, Some(masks(&text)))] }),
            )
            .ok();
        assert_eq!(
            sent.results[0].problem.as_ref().map(|problem| problem.code),
            Some(Code::Invalid)
        );
    }
    let huge = format!("{{\"events\":\"{}\"}}", "x".repeat(10 << 20));
    assert_eq!(
        ann.call("POST", &path, Some(huge.as_bytes()))
            .problem()
            .code,
        Code::TooLarge
    );
    assert_eq!(site.store.last_seq().expect("a place"), before);
}

#[test]
fn deep_and_broken_json_is_refused() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let deep = "[".repeat(100_000);
    for body in [
        deep.as_bytes(),
        b"\xff\xfe",
        b"null",
        b"{\"kind\":\"mask_text\"} trailing",
    ] {
        assert_eq!(
            ann.call("POST", "queue/next", Some(body)).problem().code,
            Code::BadRequest
        );
    }
}

#[test]
fn paths_do_not_climb() {
    let site = Site::new();
    let admin = site.person("adm", Role::Admin);
    for path in [
        "/assets/../Cargo.toml",
        "/assets/..%2f..%2fCargo.toml",
        "/assets/%2e%2e/Cargo.toml",
        "/assets//etc/passwd",
    ] {
        let answered = send(&agent(), "GET", &site.url(path), &[], None);
        assert_eq!(answered.status, 404, "{path}");
    }
    for name in ["..%2f..%2fstore.sqlite", "%2fetc%2fpasswd"] {
        assert_eq!(
            admin.get(&format!("jobs/1/files/{name}")).status,
            404,
            "{name}"
        );
    }
}

#[test]
fn tokens_are_not_taken_from_the_address_or_from_odd_headers() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let bearer = format!("Bearer {}", ann.token);
    let cookie = format!("annotate-{}=x", site.store.id().expect("an id"));
    for (url, headers) in [
        (format!("/api/v1/me?token={}", ann.token), vec![]),
        (
            "/api/v1/me".to_owned(),
            vec![("authorization", ann.token.as_str())],
        ),
        (
            "/api/v1/me".to_owned(),
            vec![
                ("authorization", bearer.as_str()),
                ("authorization", "Bearer x"),
            ],
        ),
        ("/api/v1/me".to_owned(), vec![("cookie", cookie.as_str())]),
    ] {
        assert_eq!(
            send(&agent(), "GET", &site.url(&url), &headers, None).status,
            401
        );
    }
}

/// The server's response to an incomplete request; no response fails the test.
fn answer_to(site: &Site, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(site.server.address()).expect("a connection");
    stream
        .set_read_timeout(Some(Duration::from_secs(60)))
        .expect("a limit");
    stream.write_all(bytes).expect("the server reads");
    let mut answer = Vec::new();
    stream
        .read_to_end(&mut answer)
        .expect("it closes the connection");
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn requests_that_never_end_are_given_up() {
    let site = Site::with_patience(Duration::from_secs(2));
    let ann = site.person("ann", Role::Annotator);
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
    // Other requests are served during and after it.
    assert_eq!(ann.get("me").status, 200);
}

#[test]
fn an_import_that_is_no_release_fails_and_says_why() {
    let site = Site::new();
    let admin = site.person("adm", Role::Admin);
    for body in ["[]", "{", "{\"mask_all\": 7}", "{\"other\": {}}"] {
        let job: annotate::wire::Job = admin
            .call("POST", "imports?format=stance", Some(body.as_bytes()))
            .ok();
        let job = crate::transfer::finished(&admin, job.id);
        assert_eq!(job.state, "failed", "{body}");
        assert!(!job.messages.is_empty());
    }
    let job: annotate::wire::Job = admin
        .call("POST", "imports?format=annotations", Some(b"PAR1 or not"))
        .ok();
    assert_eq!(crate::transfer::finished(&admin, job.id).state, "failed");
    // The upload was stored in the server's data folder, and removed.
    let kept = std::fs::read_dir(site.folder.path().join("data").join("imports"));
    assert_eq!(kept.expect("the folder").count(), 0);
}
