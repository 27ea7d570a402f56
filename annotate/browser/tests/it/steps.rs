//! Steps shared by several tests.

use annotate_browser::{Browser, Dataset, Graphics, Server, keys};
use serde_json::{Value, json};

/// A server with an annotator, and a browser logged in as her.
pub(crate) struct Desk {
    pub(crate) dataset: Dataset,
    pub(crate) server: Server,
    pub(crate) browser: Browser,
    pub(crate) token: String,
}

impl Desk {
    /// Opens a page as an annotator.
    pub(crate) async fn open(path: &str) -> Self {
        Self::open_with(path, Graphics::Software).await
    }

    /// Opens a page as an annotator, with or without WebGL.
    pub(crate) async fn open_with(path: &str, graphics: Graphics) -> Self {
        let dataset = Dataset::fresh().await;
        let token = dataset.add_user("ann", "annotator").await;
        let boss = dataset.add_user("boss", "admin").await;
        let server = Server::start(&dataset).await;
        let browser = Browser::start(graphics).await;
        browser.open(&server.page("")).await;
        nothing_by_chance(&browser, &boss).await;
        browser.log_in(&server, &token, path).await;
        Self {
            dataset,
            server,
            browser,
            token,
        }
    }
}

/// A server with an annotator, a reviewer and an admin, by their tokens, and a browser that nobody is logged in to.
pub(crate) struct Team {
    pub(crate) dataset: Dataset,
    pub(crate) server: Server,
    pub(crate) browser: Browser,
    pub(crate) ann: String,
    pub(crate) eve: String,
    pub(crate) boss: String,
}

impl Team {
    pub(crate) async fn open() -> Self {
        let dataset = Dataset::fresh().await;
        let ann = dataset.add_user("ann", "annotator").await;
        let eve = dataset.add_user("eve", "reviewer").await;
        let boss = dataset.add_user("boss", "admin").await;
        let server = Server::start(&dataset).await;
        let browser = Browser::start(Graphics::Software).await;
        browser.open(&server.page("")).await;
        nothing_by_chance(&browser, &boss).await;
        Self {
            dataset,
            server,
            browser,
            ann,
            eve,
            boss,
        }
    }
}

/// Settings without random draws: no gold tasks and no blind tasks.
pub(crate) async fn nothing_by_chance(browser: &Browser, admin: &str) {
    let settings = browser.request_as(admin, "GET", "settings", None).await;
    assert_eq!(settings["status"], 200, "{settings}");
    let mut settings = settings["body"].clone();
    settings["gold_percent"] = json!(0);
    settings["blind_percent"] = json!(0);
    settings["review_percent"] = json!(100);
    let saved = browser
        .request_as(admin, "PUT", "settings", Some(settings))
        .await;
    assert_eq!(saved["status"], 200, "{saved}");
}

/// Describes the left arm and the lower body of the current task by keyboard.
pub(crate) async fn describe_two_masks(browser: &Browser) {
    browser.press(&["4", "t"]).await;
    browser.type_text("Wave with the left arm.").await;
    browser.press(&[keys::ESCAPE, "n", "2", "t"]).await;
    browser.type_text("Bend the knees.").await;
}

/// A complete answer to a mask task.
pub(crate) fn two_masks(first: &str, part: &str) -> Value {
    json!({
        "kind": "mask_text",
        "masks": [
            { "parts": [part], "soft": true, "text": first },
            { "parts": ["LOWER_BODY"], "soft": true, "text": "Bend the knees." },
        ],
    })
}

/// Claims the next task of a kind for a token by HTTP, without the page, and returns its view.
pub(crate) async fn claim(browser: &Browser, token: &str, kind: &str) -> Value {
    let next = browser
        .request_as(token, "POST", "queue/next", Some(json!({ "kind": kind })))
        .await;
    assert_eq!(next["status"], 200, "{next}");
    next["body"]["task"].clone()
}

/// Submits an answer for a token by HTTP, without the page.
pub(crate) async fn submit(browser: &Browser, token: &str, view: &Value, answer: Value) {
    let task = view["task"]["id"].as_i64().expect("a task");
    let event = json!({
        "idem_key": format!("test-{task}-{}", &token[..8].replace('_', "-")),
        "kind": "submit",
        "lease_epoch": view["lease"]["epoch"],
        "base_rev": view["mine"]["rev"].as_i64().unwrap_or(0),
        "answer": answer,
    });
    let reply = browser
        .request_as(
            token,
            "POST",
            &format!("tasks/{task}/events"),
            Some(json!({ "events": [event] })),
        )
        .await;
    assert_eq!(reply["body"]["results"][0]["status"], 200, "{reply}");
}

/// My answer to a task on the server.
pub(crate) async fn mine(browser: &Browser, task: i64) -> Value {
    let view = browser.request("GET", &format!("tasks/{task}"), None).await;
    assert_eq!(view["status"], 200, "{view}");
    view["body"]["mine"].clone()
}
