//! Drafts by a language model, with a mock server.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use annotate::drafting;
use annotate::model::Model;
use annotate::motions::MotionLibrary;
use annotate::wire::{Code, Role, Suggestion, SuggestionSource, TaskKind};
use serde_json::json;

use crate::support::{CLIPS, START, Site};

/// A mock server with a fixed response, which records its requests.
struct Fake {
    url: String,
    asked: Arc<Mutex<Vec<String>>>,
    count: Arc<AtomicUsize>,
}

fn fake(response: &'static str) -> Fake {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("http://{}/v1", listener.local_addr().expect("an address"));
    let asked = Arc::new(Mutex::new(Vec::new()));
    let count = Arc::new(AtomicUsize::new(0));
    let (list, counter) = (Arc::clone(&asked), Arc::clone(&count));
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.expect("a connection");
            let mut text = Vec::new();
            let mut buffer = [0; 4096];
            loop {
                let read = stream.read(&mut buffer).expect("bytes");
                text.extend(&buffer[..read]);
                let seen = String::from_utf8_lossy(&text).into_owned();
                let Some((head, body)) = seen.split_once("\r\n\r\n") else {
                    continue;
                };
                let length = head
                    .lines()
                    .find_map(|line| {
                        line.to_lowercase()
                            .strip_prefix("content-length: ")
                            .map(str::to_owned)
                    })
                    .and_then(|length| length.parse::<usize>().ok())
                    .unwrap_or(0);
                if read == 0 || body.len() >= length {
                    list.lock().expect("no panic").push(seen);
                    break;
                }
            }
            counter.fetch_add(1, Ordering::SeqCst);
            stream.write_all(response.as_bytes()).expect("answers");
        }
    });
    Fake { url, asked, count }
}

fn suggest(site: &Site, parts: &[&str]) -> crate::support::Answered {
    let ann = site.person("ann", Role::Annotator);
    let view = ann.claim(TaskKind::MaskText);
    ann.post(
        &format!("tasks/{}/suggest", view.task.id),
        &json!({ "parts": parts }),
    )
}

#[test]
fn a_draft_is_a_suggestion_kept_apart_and_asked_for_once() {
    let fake = fake(
        "HTTP/1.1 200 OK\r\ncontent-type: application/json\r\nconnection: close\r\n\r\n{\"choices\":[{\"message\":{\"content\":\"\\\"waving <b>the</b>\\n left arm\\\"\"}}],\"usage\":{\"total_tokens\":42}}",
    );
    let model = Model::new(&fake.url, "tiny", Some("secret-key".to_owned())).expect("a model");
    let site = Site::with_model(Some(model));
    let ann = site.person("ann", Role::Annotator);
    let me = ann.get("me");
    assert!(!String::from_utf8_lossy(&me.body).contains("secret-key"));
    let view = ann.claim(TaskKind::MaskText);
    let path = format!("tasks/{}/suggest", view.task.id);
    let suggestion: Suggestion = ann.post(&path, &json!({ "parts": ["LEFT_ARM"] })).ok();
    assert_eq!(suggestion.source, SuggestionSource::Llm);
    assert_eq!(suggestion.text, "waving <b>the</b> left arm");
    let asked = fake.asked.lock().expect("no panic")[0].clone();
    assert!(
        asked
            .to_lowercase()
            .contains("authorization: bearer secret-key")
    );
    assert!(asked.contains("take clip00") && asked.contains("left arm"));
    let again: Suggestion = ann.post(&path, &json!({ "parts": ["LEFT_ARM"] })).ok();
    assert_eq!(again.text, suggestion.text);
    assert_eq!(
        fake.count.load(Ordering::SeqCst),
        1,
        "an equal question is not asked twice"
    );
    let seen: annotate::wire::TaskView = ann.get(&format!("tasks/{}", view.task.id)).ok();
    assert!(seen.mine.is_none(), "a draft is no answer");
    assert!(
        seen.suggestions
            .iter()
            .any(|known| known.text == suggestion.text)
    );
    assert_eq!(
        ann.post(&path, &json!({ "parts": ["TAIL"] }))
            .problem()
            .code,
        Code::Invalid
    );
    let refused = (0..40)
        .map(|_| ann.post(&path, &json!({ "parts": ["HEAD"] })))
        .find(|answered| answered.status == 429);
    assert_eq!(
        refused.expect("there is a limit").problem().code,
        Code::RateLimited
    );
    let bob = site.person("bob", Role::Annotator);
    assert_eq!(
        bob.post(&path, &json!({ "parts": ["HEAD"] }))
            .problem()
            .code,
        Code::NotFound
    );
}

#[test]
fn a_model_that_fails_blocks_nothing() {
    for response in [
        "HTTP/1.1 500 Internal Server Error\r\nconnection: close\r\n\r\n{}",
        "HTTP/1.1 200 OK\r\nconnection: close\r\n\r\nnot json",
        "HTTP/1.1 200 OK\r\nconnection: close\r\n\r\n{\"choices\":[]}",
        "HTTP/1.1 200 OK\r\nconnection: close\r\n\r\n{\"choices\":[{\"message\":{\"content\":\" \"}}]}",
        "HTTP/1.1 302 Found\r\nlocation: http://127.0.0.1:1/\r\nconnection: close\r\n\r\n",
        "garbage\r\n\r\n",
    ] {
        let fake = fake(response);
        let site = Site::with_model(Some(Model::new(&fake.url, "tiny", None).expect("a model")));
        assert_eq!(
            suggest(&site, &["LEFT_ARM"]).problem().code,
            Code::ModelFailed,
            "{response}"
        );
    }
    let nobody = Model::new("http://127.0.0.1:1/v1", "tiny", None).expect("a model");
    let site = Site::with_model(Some(nobody));
    assert_eq!(
        suggest(&site, &["LEFT_ARM"]).problem().code,
        Code::ModelFailed
    );
}

#[test]
fn drafts_are_asked_for_in_bulk_and_once() {
    let fake = fake(
        "HTTP/1.1 200 OK\r\ncontent-type: application/json\r\nconnection: close\r\n\r\n{\"choices\":[{\"message\":{\"content\":\"waving the arm\"}}]}",
    );
    let model = Model::new(&fake.url, "tiny", None).expect("a model");
    let site = Site::new();
    let motions = MotionLibrary::open(&site.dataset).expect("motions");
    let store = site.store.as_ref();
    let ask = |limit: usize| {
        let kind = Some(TaskKind::MaskText);
        drafting::draft_all(store, &motions, &model, kind, limit, START, &mut |_| {})
            .expect("drafts")
    };
    let first = ask(3);
    assert_eq!((first.looked_at, first.failures), (3, 0));
    assert!(first.texts >= 3 - first.without_parts);
    let prompt = fake.asked.lock().expect("no panic")[0].clone();
    assert!(prompt.contains("Leave out what other parts"), "{prompt}");
    let ann = site.person("ann", Role::Annotator);
    let view = ann.claim(TaskKind::MaskText);
    let offered = |source: SuggestionSource| {
        let all = view.suggestions.iter();
        all.filter(|draft| draft.source == source)
            .map(|draft| draft.text.as_str())
            .collect::<Vec<_>>()
    };
    assert_eq!(offered(SuggestionSource::Llm), ["waving the arm"]);
    assert_eq!(
        offered(SuggestionSource::Import),
        ["waving with their left arm"],
        "a draft completes \"The person is ...\", as the guide asks"
    );
    let rest = ask(usize::MAX);
    assert!(rest.looked_at >= CLIPS - 3, "{rest:?}");
    let again = ask(usize::MAX);
    assert_eq!(again.texts, 0, "what has a draft is not asked for again");
}

#[test]
fn a_model_that_is_gone_ends_the_drafts_and_is_named() {
    let model = Model::new("http://127.0.0.1:1/v1", "tiny", None).expect("a model");
    let site = Site::new();
    let motions = MotionLibrary::open(&site.dataset).expect("motions");
    let done = drafting::draft_all(
        site.store.as_ref(),
        &motions,
        &model,
        Some(TaskKind::MaskText),
        usize::MAX,
        START,
        &mut |_| {},
    )
    .expect("ends");
    assert_eq!(done.texts, 0);
    assert!(done.failures > 0);
    assert!(done.last_failure.expect("a reason").contains("reached"));
}
