//! Drafts by a language model, with a mock server.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};

use annotate::drafting;
use annotate::model::Model;
use annotate::motions::MotionLibrary;
use annotate::wire::{Code, Suggestion, SuggestionSource, TaskKind, TaskView};
use serde_json::json;

use crate::support::{Answered, CLIPS, Client, START, Site};

/// A mock server with a fixed response, which records its requests.
struct Fake {
    url: String,
    asked: Arc<Mutex<Vec<String>>>,
}

fn fake(response: String) -> Fake {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("http://{}/v1", listener.local_addr().expect("an address"));
    let asked = Arc::new(Mutex::new(Vec::new()));
    let list = Arc::clone(&asked);
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let stream = stream.expect("a connection");
            let mut reader = BufReader::new(&stream);
            let (mut text, mut length) = (String::new(), 0);
            while !text.ends_with("\r\n\r\n") {
                let begin = text.len();
                let read = reader.read_line(&mut text).expect("a line");
                assert!(read > 0, "the request ends: {text}");
                let line = text[begin..].to_lowercase();
                if let Some(number) = line.strip_prefix("content-length: ") {
                    length = number.trim().parse().expect("a length");
                }
            }
            let mut body = vec![0; length];
            reader.read_exact(&mut body).expect("a body");
            text.push_str(&String::from_utf8_lossy(&body));
            list.lock().expect("no panic").push(text);
            (&stream).write_all(response.as_bytes()).expect("answers");
        }
    });
    Fake { url, asked }
}

fn said(content: &str) -> String {
    let body = json!({
        "choices": [{ "message": { "content": content } }], "usage": { "total_tokens": 42 },
    });
    format!("HTTP/1.1 200 OK\r\ncontent-type: application/json\r\nconnection: close\r\n\r\n{body}")
}

fn model(url: &str) -> Model {
    Model::new(url, "tiny", None).expect("a model")
}

/// Asks for a draft of a part of a task.
fn suggest(person: &Client, view: &TaskView, part: &str) -> Answered {
    let path = format!("tasks/{}/suggest", view.task.id);
    person.post(&path, &json!({ "parts": [part] }))
}

#[test]
fn a_draft_is_a_suggestion_kept_apart_and_asked_for_once() {
    let fake = fake(said("\"waving <b>the</b>\n left arm\""));
    let model = Model::new(&fake.url, "tiny", Some("secret-key".to_owned())).expect("a model");
    let site = Site::with(|config| config.model = Some(model));
    let ann = site.person("ann");
    let me = ann.get("me");
    assert!(!String::from_utf8_lossy(&me.body).contains("secret-key"));
    let view = ann.claim(TaskKind::MaskText);
    let suggestion: Suggestion = suggest(&ann, &view, "LEFT_ARM").ok();
    assert_eq!(suggestion.source, SuggestionSource::Llm);
    assert_eq!(suggestion.text, "waving <b>the</b> left arm");
    let asked = fake.asked.lock().expect("no panic")[0].clone();
    let bearer = "authorization: bearer secret-key";
    assert!(asked.to_lowercase().contains(bearer));
    assert!(asked.contains("take clip00") && asked.contains("left arm"));
    let again: Suggestion = suggest(&ann, &view, "LEFT_ARM").ok();
    assert_eq!(again.text, suggestion.text);
    // The same prompt is not sent twice.
    assert_eq!(fake.asked.lock().expect("no panic").len(), 1);
    let seen: TaskView = ann.get(&format!("tasks/{}", view.task.id)).ok();
    assert!(seen.mine.is_none(), "a draft is no answer");
    let mut texts = seen.suggestions.iter().map(|known| &known.text);
    assert!(texts.any(|text| *text == suggestion.text));
    assert_eq!(suggest(&ann, &view, "TAIL").code(), Code::Invalid);
    let mut asked = (0..40).map(|_| suggest(&ann, &view, "HEAD"));
    let refused = asked.find(|answered| answered.status == 429);
    let refused = refused.expect("there is a limit");
    assert_eq!(refused.code(), Code::RateLimited);
    let bob = site.person("bob");
    assert_eq!(suggest(&bob, &view, "HEAD").code(), Code::NotFound);
}

#[test]
fn a_model_that_fails_blocks_nothing() {
    let check = |url: &str, response: &str| {
        let site = Site::with(|config| config.model = Some(model(url)));
        let ann = site.person("ann");
        let view = ann.claim(TaskKind::MaskText);
        let refused = suggest(&ann, &view, "LEFT_ARM").code();
        assert_eq!(refused, Code::ModelFailed, "{response}");
    };
    let closed = |head: &str, body: &str| format!("{head}\r\nconnection: close\r\n\r\n{body}");
    for response in [
        closed("HTTP/1.1 500 Internal Server Error", "{}"),
        closed("HTTP/1.1 200 OK", "not json"),
        closed("HTTP/1.1 200 OK", "{\"choices\":[]}"),
        closed("HTTP/1.1 302 Found\r\nlocation: http://127.0.0.1:1/", ""),
        said(" "),
        "garbage\r\n\r\n".to_owned(),
    ] {
        check(&fake(response.clone()).url, &response);
    }
    check("http://127.0.0.1:1/v1", "nobody");
}

#[test]
fn drafts_are_asked_for_in_bulk_and_once_and_a_model_that_is_gone_is_named() {
    let fake = fake(said("waving the arm"));
    let (gone, model) = (model("http://127.0.0.1:1/v1"), model(&fake.url));
    let site = Site::new();
    let motions = MotionLibrary::open(&site.dataset).expect("motions");
    let store = site.store.as_ref();
    let ask_for = |kind, model: &Model, limit: usize| {
        let kind = Some(kind);
        let done = drafting::draft_all(store, &motions, model, kind, limit, START, &mut |_| {});
        done.expect("drafts")
    };
    let ask = |model: &Model, limit: usize| ask_for(TaskKind::MaskText, model, limit);
    let none = ask(&gone, usize::MAX);
    assert_eq!(none.texts, 0);
    assert!(none.failures > 0);
    assert!(none.last_failure.expect("a reason").contains("reached"));
    let first = ask(&model, 3);
    assert_eq!((first.looked_at, first.failures), (3, 0));
    assert!(first.texts >= 3 - first.without_parts);
    assert_eq!(first.pairs_without_parts, 0);
    let pairs = ask_for(TaskKind::Pair, &model, 3);
    assert_eq!((pairs.without_parts, pairs.pairs_without_parts), (3, 3));
    let prompt = fake.asked.lock().expect("no panic")[0].clone();
    assert!(prompt.contains("Leave out what other parts"), "{prompt}");
    let ann = site.person("ann");
    let view = ann.claim(TaskKind::MaskText);
    // A draft completes "The person is ...", as the guide asks.
    for (source, text) in [
        (SuggestionSource::Llm, "waving the arm"),
        (SuggestionSource::Import, "waving with their left arm"),
    ] {
        let mut offered = view.suggestions.clone();
        offered.retain(|draft| draft.source == source);
        assert_eq!((offered.len(), offered[0].text.as_str()), (1, text));
    }
    let rest = ask(&model, usize::MAX);
    assert!(rest.looked_at >= CLIPS - 3, "{rest:?}");
    let again = ask(&model, usize::MAX);
    assert_eq!(again.texts, 0, "what has a draft is not asked for again");
}
