//! Drafts by a language model, with a mock server.

use annotate_browser::{Browser, Dataset, Graphics, Server};
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;

use crate::steps::{mine, nothing_by_chance};

const DRAFT: &str = "The person is waving <b>slowly</b> with their left arm.";

/// The draft as it completes "The person is …".
const SHOWN: &str = "waving <b>slowly</b> with their left arm";

/// Starts a mock server that answers every request with this text, and returns its address.
pub(crate) async fn model(says: &'static str) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("an address");
    tokio::spawn(async move {
        while let Ok((mut stream, _)) = listener.accept().await {
            tokio::spawn(async move {
                let mut seen = Vec::new();
                let mut buffer = [0; 4096];
                // The request ends with the last brace of its JSON.
                while !seen.ends_with(b"}") {
                    match stream.read(&mut buffer).await {
                        Ok(0) | Err(_) => return,
                        Ok(read) => seen.extend(&buffer[..read]),
                    }
                }
                let body = json!({ "choices": [{ "message": { "content": says } }] }).to_string();
                let answer = format!(
                    "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}",
                    body.len()
                );
                let _gone = stream.write_all(answer.as_bytes()).await;
            });
        }
    });
    format!("http://{address}/v1")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_draft_is_asked_for_by_key_edited_and_told_apart() {
    let dataset = Dataset::fresh().await;
    let ann = dataset.add_user("ann", "annotator").await;
    let boss = dataset.add_user("boss", "admin").await;
    let server = Server::start_with(&dataset, Some(model(DRAFT).await)).await;
    let browser = Browser::start(Graphics::Software).await;
    browser.open(&server.page("")).await;
    nothing_by_chance(&browser, &boss).await;
    browser.log_in(&server, &ann, "app/mask").await;
    let task = browser.task().await;
    // The pipeline has no suggestion for these two parts together.
    browser.press(&["4", "2", "v"]).await;
    browser
        .until(
            "the draft is shown",
            &format!(
                "document.querySelector('.draft')?.textContent.includes({})",
                json!(SHOWN)
            ),
        )
        .await;
    assert_eq!(
        browser
            .js("return document.querySelector('.mask-card textarea').value;")
            .await,
        "",
        "a draft is offered, not taken"
    );
    browser.press(&["v"]).await;
    browser
        .until(
            "the draft is in the box",
            &format!(
                "document.querySelector('.mask-card textarea')?.value === {}",
                json!(SHOWN)
            ),
        )
        .await;
    assert_eq!(
        browser
            .js("return document.querySelector('b') === null;")
            .await,
        json!(true),
        "a draft is text"
    );
    // The text has the focus.
    browser.type_text(" twice").await;
    browser.saved().await;
    let mask = mine(&browser, task).await["answer"]["masks"][0].clone();
    assert_eq!(mask["text"], format!("{SHOWN} twice"));
    assert!(mask["suggestion"].is_i64(), "{mask}");
    let view = browser.request("GET", &format!("tasks/{task}"), None).await;
    let drafts = view["body"]["suggestions"].as_array().expect("suggestions");
    let draft = drafts
        .iter()
        .find(|draft| draft["id"] == mask["suggestion"]);
    assert_eq!(draft.expect("kept apart")["text"], SHOWN);
    assert_eq!(draft.expect("kept apart")["model"], "tiny");
    browser.quit().await;
}
