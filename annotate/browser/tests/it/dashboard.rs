//! Figures and decisions: what owners and reviewers see of everybody's work.

use annotate_browser::{Browser, Dataset, Graphics, Server, keys};
use serde_json::{Value, json};

use crate::steps::{claim, nothing_by_chance};

/// A server with two annotators and a reviewer, and a browser on its login page.
struct Office {
    /// Its folder lasts as long as the server.
    _dataset: Dataset,
    server: Server,
    browser: Browser,
    ann: String,
    bob: String,
    rev: String,
}

impl Office {
    async fn open(people: u32) -> Self {
        let dataset = Dataset::fresh().await;
        let ann = dataset.add_user("ann", "annotator").await;
        let bob = dataset.add_user("bob", "annotator").await;
        let boss = dataset.add_user("boss", "admin").await;
        let rev = dataset.add_user("rev", "reviewer").await;
        let server = Server::start(&dataset).await;
        let browser = Browser::start(Graphics::Software).await;
        browser.open(&server.page("")).await;
        nothing_by_chance(&browser, &boss).await;
        let mut settings = browser.request_as(&boss, "GET", "settings", None).await["body"].clone();
        settings["answers_per_task"] = json!(people);
        settings["overlap_percent"] = json!(100);
        let saved = browser
            .request_as(&boss, "PUT", "settings", Some(settings))
            .await;
        assert_eq!(saved["status"], 200, "{saved}");
        Self {
            _dataset: dataset,
            server,
            browser,
            ann,
            bob,
            rev,
        }
    }

    /// Logs the reviewer in. Her first page computes figures, which are then kept for a minute.
    async fn enter(&self) {
        self.browser
            .log_in(&self.server, &self.rev, "app/guide")
            .await;
    }

    /// Answers the next pair by HTTP after six minutes of work, and returns the task.
    async fn answer(&self, token: &str, text: &str) -> i64 {
        let view = claim(&self.browser, token, "pair").await;
        self.submit(token, &view, text).await
    }

    async fn submit(&self, token: &str, view: &Value, text: &str) -> i64 {
        let task = view["task"]["id"].as_i64().expect("a task");
        let event = json!({
            "idem_key": format!("office-{task}-{}-{}", &token[4..12], view["lease"]["epoch"]),
            "kind": "submit",
            "lease_epoch": view["lease"]["epoch"],
            "base_rev": view["mine"]["rev"].as_i64().unwrap_or(0),
            "answer": { "kind": "pair", "verdict": "keep", "parts": ["LEFT_ARM"], "edit_type": "amplitude", "text": text },
            "secs": 360,
        });
        let path = format!("tasks/{task}/events");
        let body = json!({ "events": [event] });
        let reply = self
            .browser
            .request_as(token, "POST", &path, Some(body))
            .await;
        assert_eq!(reply["body"]["results"][0]["status"], 200, "{reply}");
        task
    }

    /// Decides about the next task of the queue by HTTP, as the reviewer.
    async fn decide(&self, decision: &str, comment: &str) -> i64 {
        let queue = json!({ "queue": "disagreement" });
        let next = self
            .browser
            .request_as(&self.rev, "POST", "review/next", Some(queue))
            .await;
        let review = &next["body"]["review"];
        let task = review["task"]["id"].as_i64().expect("a task");
        let body = json!({
            "idem_key": format!("office-review-{task}-{decision}"),
            "task": task,
            "lease_epoch": review["lease"]["epoch"],
            "decision": decision,
            "author": review["candidates"][0]["revision"]["author"],
            "comment": comment,
        });
        let done = self
            .browser
            .request_as(&self.rev, "POST", "reviews", Some(body))
            .await;
        assert_eq!(done["status"], 200, "{done}");
        task
    }

    async fn page(&self, path: &str, shown: &str) {
        self.browser.open(&self.server.page(path)).await;
        self.browser
            .until(path, &format!("document.querySelector('{shown}')"))
            .await;
    }
}

/// Cells of the rows of a table, as texts.
async fn rows(browser: &Browser, selector: &str) -> Vec<Vec<String>> {
    let cells = browser
        .js_with(
            "return [...document.querySelectorAll(`${arguments[0]} tbody tr`)] \
                .map((row) => [...row.cells].map((cell) => cell.innerText.trim()));",
            vec![json!(selector)],
        )
        .await;
    serde_json::from_value(cells).expect("texts")
}

#[tokio::test(flavor = "multi_thread")]
async fn the_dashboard_tells_hours_agreement_and_the_time_left() {
    let office = Office::open(2).await;
    let browser = &office.browser;
    let shared = office.answer(&office.ann, "Raise the arm.").await;
    assert_eq!(office.answer(&office.bob, "Raise the arm.").await, shared);
    office.answer(&office.ann, "Lower the arm.").await;
    office.enter().await;
    office
        .page("app/dashboard", "[data-figures=days] tbody th")
        .await;

    let work = rows(browser, "[data-figures=days] > table").await;
    assert_eq!(work[0][0], "ann", "most hours first: {work:?}");
    assert_eq!(work[0][2..5], ["0.2 h", "2", "6 min"]);
    assert_eq!(work[1][0], "bob");
    assert_eq!(work[2][..4], ["all", "", "0.3 h", "3"]);
    // Every drawing has a name, and a table with the same figures.
    let drawings = browser
        .js("return [...document.querySelectorAll('.dashboard svg')] \
            .map((own) => [own.getAttribute('role'), own.getAttribute('aria-label').length > 10, own.closest('section').querySelector('table, dl') !== null]);")
        .await;
    let drawings = drawings.as_array().expect("drawings").clone();
    assert!(drawings.len() >= 8, "{drawings:?}");
    assert!(
        drawings
            .iter()
            .all(|own| *own == json!(["img", true, true])),
        "{drawings:?}"
    );
    let weeks = rows(browser, "[data-figures=weeks] table").await;
    assert_eq!(
        weeks.last().expect("this week")[1..],
        ["3", "0", "0", "6 min", "1.00", "1"]
    );
    let left = browser.text_of("[data-figures=outlook]").await;
    assert!(
        left.contains("3.0") && left.contains("answers are left"),
        "{left}"
    );
    assert!(
        left.contains("Nobody answered in the last seven days"),
        "{left}"
    );

    // The period is chosen, kept, and an opened table stays open when figures change.
    browser
        .js("document.querySelector('[data-figures=days] details').open = true; \
             [...document.querySelectorAll('[aria-label=Period] button')].find((own) => own.textContent === '7 days').click();")
        .await;
    browser
        .until(
            "seven days are chosen",
            "document.querySelector('[aria-label=Period] [aria-pressed=true]').textContent === '7 days'",
        )
        .await;
    office.answer(&office.bob, "Lower the arm.").await;
    browser
        .until(
            "the new answer is shown",
            "document.querySelector('[data-figures=days] > table tbody tr:last-child').cells[3].innerText === '4'",
        )
        .await;
    let by_day = rows(browser, "[data-figures=days] details table").await;
    assert_eq!(by_day.len(), 1, "{by_day:?}");
    assert_eq!(by_day[0][1], "0.4 h, 4 answers");
    assert_eq!(
        browser
            .js("return document.querySelector('[data-figures=days] details').open;")
            .await,
        json!(true)
    );
    office
        .page("app/dashboard", "[aria-label=Period] [aria-pressed=true]")
        .await;
    assert_eq!(
        browser
            .text_of("[aria-label=Period] [aria-pressed=true]")
            .await,
        "7 days"
    );
    office.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reviewer_follows_what_was_sent_back() {
    let office = Office::open(1).await;
    let browser = &office.browser;
    let first = office.answer(&office.ann, "Raise the arm.").await;
    assert_eq!(office.decide("return", "Which arm?").await, first);
    office.answer(&office.bob, "Lower the arm.").await;
    office.decide("accept", "").await;
    office.enter().await;
    office.page("app/decisions", "decision-list tbody td").await;
    let marked = browser.text_of("header nav [aria-current]").await;
    assert_eq!(marked, "Review", "the page belongs to reviewing");
    let all = rows(browser, "decision-list").await;
    assert_eq!(all.len(), 2, "{all:?}");
    assert_eq!(all[0][2..], ["accepted", "bob", "", "stands"]);
    assert_eq!(
        all[1][2..],
        ["sent back", "ann", "Which arm?", "waits for ann"]
    );
    assert!(all[1][1].starts_with(&first.to_string()), "{all:?}");
    // She answers again.
    let path = format!("tasks/{first}/claim");
    let claimed = browser.request_as(&office.ann, "POST", &path, None).await;
    office
        .submit(&office.ann, &claimed["body"], "Raise the left arm.")
        .await;
    office
        .page("app/decisions/returned", "decision-list tbody td")
        .await;
    let back = rows(browser, "decision-list").await;
    assert_eq!(back.len(), 1, "{back:?}");
    assert_eq!(back[0][5], "answered again, waits for review", "{back:?}");
    browser
        .js("[...document.querySelectorAll('[aria-label=\"Kind of decision\"] button')].find((own) => own.textContent === 'Dropped').click();")
        .await;
    browser
        .until(
            "nothing was dropped",
            "document.querySelector('decision-list td').innerText.startsWith('You have decided nothing')",
        )
        .await;
    office.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reviewer_sees_what_annotators_were_offered() {
    let office = Office::open(1).await;
    let browser = &office.browser;
    let view = claim(browser, &office.ann, "mask_text").await;
    let offered = view["suggestions"].as_array().expect("suggestions").len();
    assert!(offered > 0, "{view}");
    crate::steps::submit(
        browser,
        &office.ann,
        &view,
        crate::steps::two_masks("Wave.", "LEFT_ARM"),
    )
    .await;
    office.enter().await;
    office.page("app/review", ".offered").await;
    browser.task().await;
    assert_eq!(
        browser
            .js("return document.querySelectorAll('.offered li').length;")
            .await,
        json!(offered)
    );
    // Every box of this page can be left without a decision.
    for key in ["r", keys::DELETE] {
        browser.press(&[key]).await;
        browser
            .until(
                "a box with Cancel",
                "document.querySelector('dialog[open] [data-choice=Cancel]')",
            )
            .await;
        browser
            .js("document.querySelector('dialog[open] [data-choice=Cancel]').click();")
            .await;
        browser
            .until("the box is gone", "!document.querySelector('dialog[open]')")
            .await;
    }
    office.browser.quit().await;
}
