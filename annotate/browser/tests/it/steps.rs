//! A server with users and a browser, and steps shared by several tests.

use std::collections::BTreeMap;
use std::ops::Deref;

use annotate_browser::{Browser, Dataset, Graphics, Server, keys};
use serde_json::{Value, json};

/// A server with users, and a browser. Requests outside the page are sent by user name.
pub(crate) struct Desk {
    // Dropped first, so that the page does not outlive its server.
    browser: Browser,
    pub(crate) server: Server,
    pub(crate) dataset: Dataset,
    tokens: BTreeMap<&'static str, String>,
}

impl Deref for Desk {
    type Target = Browser;

    fn deref(&self) -> &Browser {
        &self.browser
    }
}

impl Desk {
    /// A server with these users, who must include the boss, and a browser on its login page.
    pub(crate) fn of(people: &[&'static str]) -> Self {
        Self::with(Dataset::fresh(), Graphics::Software, None, people)
    }

    /// Like `of`, with the given dataset, graphics and address of a language model.
    pub(crate) fn with(
        dataset: Dataset,
        graphics: Graphics,
        model: Option<String>,
        people: &[&'static str],
    ) -> Self {
        let token = |name: &&'static str| (*name, dataset.add_user(name, role(name)));
        let tokens = people.iter().map(token).collect();
        let server = Server::start(&dataset, model);
        let browser = Browser::start(graphics, &[]);
        browser.open(&server.page(""));
        let desk = Self {
            browser,
            server,
            dataset,
            tokens,
        };
        // Give out neither gold tasks nor blind tasks, which are drawn at random.
        desk.set(json!({ "gold_percent": 0, "blind_percent": 0, "review_percent": 100 }));
        desk
    }

    pub(crate) fn at(path: &str) -> Self {
        let desk = Self::of(&["ann", "boss"]);
        desk.enter("ann", path);
        desk
    }

    /// Opens the home page of the admin whose token the server prints, in a browser with extra command-line arguments.
    pub(crate) fn admin(dataset: Dataset, arguments: &[&str]) -> Self {
        let server = Server::start(&dataset, None);
        let browser = Browser::start(Graphics::Software, arguments);
        browser.log_in(&server, server.printed_token(), "app/home");
        Self {
            browser,
            server,
            dataset,
            tokens: BTreeMap::new(),
        }
    }

    pub(crate) fn join(&mut self, name: &'static str) {
        let token = self.dataset.add_user(name, role(name));
        self.tokens.insert(name, token);
    }

    pub(crate) fn token(&self, name: &str) -> &str {
        &self.tokens[name]
    }

    /// Logs a person in, and opens a page.
    pub(crate) fn enter(&self, name: &str, path: &str) {
        self.log_in(&self.server, self.token(name), path);
    }

    pub(crate) fn go(&self, path: &str) {
        self.open(&self.server.page(path));
    }

    pub(crate) fn page(&self, path: &str, shown: &str) {
        self.go(path);
        self.shows(shown);
    }

    /// Response of the server to a request by a person; `null` sends no body.
    pub(crate) fn ask(&self, name: &str, method: &str, path: &str, body: Value) -> Value {
        let body = Some(body).filter(|body| !body.is_null());
        let mut reply = self.request_as(self.token(name), method, path, body);
        assert_eq!(reply["status"], 200, "{method} {path}: {reply}");
        reply["body"].take()
    }

    pub(crate) fn set(&self, change: Value) {
        let settings = self.ask("boss", "GET", "settings", Value::Null);
        let change = json!({ "was": settings, "now": with(settings.clone(), change) });
        self.ask("boss", "PUT", "settings", change);
    }

    /// Claims the next task of a kind for a person, and returns its view.
    pub(crate) fn claim(&self, name: &str, kind: &str) -> Value {
        self.ask(name, "POST", "queue/next", json!({ "kind": kind }))["task"].take()
    }

    /// Sends an event of a claimed task for a person, with extra fields, and returns the task.
    pub(crate) fn send(&self, name: &str, view: &Value, kind: &str, more: Value) -> i64 {
        let task = view["task"]["id"].as_i64().expect("a task");
        let epoch = &view["lease"]["epoch"];
        let event = json!({
            "idem_key": format!("{kind}-{task}-{epoch}-{name}"),
            "kind": kind,
            "lease_epoch": epoch,
            "base_rev": view["mine"]["rev"].as_i64().unwrap_or(0),
        });
        let events = json!({ "events": [with(event, more)] });
        let reply = self.ask(name, "POST", &format!("tasks/{task}/events"), events);
        assert_eq!(reply["results"][0]["status"], 200, "{reply}");
        task
    }

    /// Submits a person's answer to a claimed task after six minutes of work, and returns the task.
    pub(crate) fn submit(&self, name: &str, view: &Value, answer: Value) -> i64 {
        let more = json!({ "answer": answer, "secs": 360 });
        self.send(name, view, "submit", more)
    }

    /// Requests a review as the reviewer, decides about its task, and returns the task.
    pub(crate) fn decide(&self, request: Value, decision: &str, comment: &str) -> i64 {
        let next = self.ask("eve", "POST", "review/next", request);
        let review = &next["review"];
        let task = review["task"]["id"].as_i64().expect("a task to review");
        let decided = json!({
            "idem_key": format!("{decision}-{task}-key"),
            "task": task,
            "lease_epoch": review["lease"]["epoch"],
            "decision": decision,
            "author": review["candidates"][0]["revision"]["author"],
            "comment": comment,
        });
        self.ask("eve", "POST", "reviews", decided);
        task
    }

    /// Describes the left arm and the lower body of the task on the page by keyboard.
    pub(crate) fn describe_two_masks(&self) {
        self.write(&["4", "t"], "Wave with the left arm.");
        self.write(&[keys::ESCAPE, "n", "2", "t"], "Bend the knees.");
    }

    /// Keeps the pair on the page by keyboard: a part, an edit type, an instruction.
    pub(crate) fn keep(&self) {
        self.write(&["4", "e", "t"], "Raise the left arm higher.");
        self.control(&[keys::ENTER]);
    }

    /// Writes the comment that the open dialog asks for.
    pub(crate) fn comment(&self, text: &str) {
        self.shows("dialog[open] textarea");
        self.type_text(text);
        self.control(&[keys::ENTER]);
    }

    /// Checks that no text was parsed as HTML.
    pub(crate) fn check_canary(&self, page: &str, images: u64) {
        let found = self.value(
            "({ canary: window.canary ?? null, images: document.querySelectorAll('img').length, \
               scripts: document.querySelectorAll('script:not([src])').length })",
        );
        let expected = json!({ "canary": null, "images": images, "scripts": 0 });
        assert_eq!(found, expected, "{page}");
    }
}

/// Roles in the tests: eve reviews, two people are admins, and all others annotate.
fn role(name: &str) -> &'static str {
    match name {
        "eve" => "reviewer",
        "boss" | "solo" => "admin",
        _ => "annotator",
    }
}

/// A document with fields added or replaced.
fn with(mut document: Value, more: Value) -> Value {
    for (name, value) in more.as_object().expect("fields") {
        document[name] = value.clone();
    }
    document
}

/// Texts of the buttons of a task that leave their frame or the window, or are too narrow for their text.
pub(crate) const CUT: &str = "[...document.querySelectorAll('.panel-foot button, .verdicts button, .transport button')] \
    .filter((button) => { const box = button.getBoundingClientRect(); const within = button.closest('.panel, .viewer').getBoundingClientRect(); \
        return box.left < within.left || box.right > within.right || box.bottom > innerHeight || button.scrollWidth > button.clientWidth; }) \
    .map((button) => button.textContent)";

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

/// An answer that keeps a pair.
pub(crate) fn kept(text: &str) -> Value {
    json!({ "kind": "pair", "verdict": "keep", "parts": ["LEFT_ARM"], "edit_type": "amplitude", "text": text })
}
