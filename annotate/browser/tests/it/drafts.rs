//! Drafts by a language model, with a mock server.

use std::io::{Read, Write};
use std::net::TcpListener;

use annotate_browser::{Dataset, Graphics};
use serde_json::json;

use crate::steps::Desk;

const DRAFT: &str = "The person is waving <b>slowly</b> with their left arm.";

/// The draft, as the completion of "The person is …".
const SHOWN: &str = "waving <b>slowly</b> with their left arm";

/// Starts a mock server that answers every request with this text, and returns its address.
fn model(says: &'static str) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.expect("a connection");
            let mut seen = Vec::new();
            let mut buffer = [0; 4096];
            // The request ends with the last brace of its JSON.
            while !seen.ends_with(b"}") {
                match stream.read(&mut buffer) {
                    Ok(0) | Err(_) => break,
                    Ok(read) => seen.extend(&buffer[..read]),
                }
            }
            let body = json!({ "choices": [{ "message": { "content": says } }] }).to_string();
            let answer = format!(
                "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}",
                body.len()
            );
            let _gone = stream.write_all(answer.as_bytes());
        }
    });
    format!("http://{address}/v1")
}

#[test]
fn a_draft_is_asked_for_by_key_edited_and_told_apart() {
    const BOX: &str = "document.querySelector('.mask-card textarea')?.value";
    let model = Some(model(DRAFT));
    let people = ["ann", "boss"];
    let desk = Desk::with(Dataset::fresh(), Graphics::Software, model, &people);
    desk.enter("ann", "app/mask");
    let task = desk.task();
    // The pipeline has no suggestion for these two parts together.
    desk.press(&["4", "2", "v"]);
    desk.says(".draft", SHOWN);
    // A draft is offered; a key inserts it.
    desk.is(BOX, "");
    desk.press(&["v"]);
    desk.until("it is taken", &format!("{BOX} === {}", json!(SHOWN)));
    assert_eq!(desk.count("b"), 0, "a draft is text");
    // The text has the focus.
    desk.type_text(" twice");
    desk.saved();
    let view = desk.get(&format!("tasks/{task}"));
    let mask = &view["mine"]["answer"]["masks"][0];
    assert_eq!(mask["text"], format!("{SHOWN} twice"));
    assert!(mask["suggestion"].is_i64(), "{mask}");
    let mut drafts = view["suggestions"].as_array().expect("suggestions").iter();
    let draft = drafts.find(|draft| draft["id"] == mask["suggestion"]);
    let draft = draft.expect("it is kept apart");
    assert_eq!(
        (&draft["text"], &draft["model"]),
        (&json!(SHOWN), &json!("tiny"))
    );
}
