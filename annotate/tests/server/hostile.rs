//! Hostile input: requests, imports and names.

use annotate::wire::{
    Code, Decision, EventKind, Job, NewEvent, SkipReason, Style, TaskKind, TaskView,
};
use serde_json::json;

use crate::support::{Site, event, masks};
use crate::transfer::finished;

#[test]
fn texts_are_kept_as_they_are_unless_they_are_too_long_or_hold_control_characters() {
    let site = Site::new();
    let ann = site.person("ann");
    let view = ann.claim(TaskKind::MaskText);
    let lease = view.lease.as_ref().expect("a lease").epoch;
    let save = |text: &str| ann.tell(&view, event(EventKind::Draft, lease, 0, masks(text)));
    let before = site.store.last_seq().expect("a place");
    for text in ["a\u{0}b", "\u{1b}[2J", &"x".repeat(2001)] {
        let problem = save(text).problem.expect("a problem");
        assert_eq!(problem.code, Code::Invalid);
    }
    let huge = format!("{{\"events\":\"{}\"}}", "x".repeat(10 << 20));
    let task = format!("tasks/{}", view.task.id);
    let refused = ann.call("POST", &format!("{task}/events"), Some(huge.as_bytes()));
    assert_eq!(refused.code(), Code::TooLarge);
    assert_eq!(site.store.last_seq().expect("a place"), before);
    let nasty = "<script>alert(1)</script> \u{202e}evil \u{0301}' OR 1=1; DROP TABLE event; --";
    assert_eq!(save(nasty).status, 200);
    let answered = ann.get(&task);
    let mime = answered.header("content-type");
    assert_eq!(mime, Some("application/json"));
    let again: TaskView = answered.ok();
    assert_eq!(again.mine.expect("a draft").answer, masks(nasty));
    site.whole();
}

#[test]
fn no_route_takes_control_characters() {
    const NUL: &str = "a\u{0}b";
    let site = Site::new();
    let [ann, eve, boss] = site.people(["ann", "eve", "boss"]);
    for path in [
        "tasks?q=%00",
        "tasks?category=a%00b",
        "tasks?split=%00",
        "tasks?rule=%1b",
        "tasks?part=%7F",
        "shelf?q=%00",
        "motions/partners?of=%00",
        "motions/%00/joints",
        "guide/pictures/%00",
    ] {
        assert_eq!(boss.get(path).code(), Code::BadRequest, "{path}");
    }
    assert_eq!(boss.get("tasks?q=a%09b%0Ac%2500&limit=5").status, 200);

    let task = ann.answer(masks("waving"));
    let review = eve.review().expect("a task to review");
    let note = json!({ "comment": NUL });
    let returned = eve.decide(task, review.lease.epoch, Decision::Return, note);
    let view = ann.claim(TaskKind::MaskText);
    let lease = view.lease.as_ref().expect("a lease").epoch;
    let skip = NewEvent {
        reason: Some(SkipReason::Other),
        note: NUL.to_owned(),
        ..event(EventKind::Skip, lease, 0, None)
    };
    let skipped = ann.tell(&view, skip).problem.expect("a problem");
    assert_eq!(skipped.code, Code::Invalid);
    let was = site.store.settings().expect("settings");
    let mut now = was.clone();
    now.styles.push(Style::named(NUL));
    let filtered = json!({ "filter": { "category": NUL }, "action": "accept" });
    let cells = json!({ "cells": [{ "motion": "clip00", "style": NUL, "takes": 1 }] });
    for refused in [
        returned,
        boss.put_settings(&was, &now),
        boss.post("bulk/preview", &filtered),
        boss.put("captures", &cells),
    ] {
        assert_eq!(refused.code(), Code::Invalid);
    }
}

#[test]
fn the_page_stands_at_its_folder_and_paths_do_not_climb() {
    let site = Site::new();
    for path in ["/", "/app", "/app/", "/app/mask"] {
        let answered = site.get(path);
        assert_eq!(answered.status, 200, "{path}");
        assert!(answered.body.starts_with(b"<!doctype html>"), "{path}");
    }
    for path in [
        "/assets/../Cargo.toml",
        "/assets/..%2f..%2fCargo.toml",
        "/assets/%2e%2e/Cargo.toml",
        "/assets//etc/passwd",
    ] {
        assert_eq!(site.get(path).status, 404, "{path}");
    }
    let boss = site.person("boss");
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
