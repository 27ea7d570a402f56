//! Dashboard figures and decisions, as owners and reviewers see them.

use annotate_browser::Browser;
use serde_json::{Value, json};

use crate::steps::{Desk, kept};

/// A server with two annotators and a reviewer, and a browser on its login page.
fn office(answers_per_task: u32) -> Desk {
    let desk = Desk::of(&["ann", "bob", "eve", "boss"]);
    desk.set(json!({ "answers_per_task": answers_per_task, "overlap_percent": 100 }));
    desk
}

/// Answers the next pair for a person, and returns the task.
fn answer(desk: &Desk, name: &str, text: &str) -> i64 {
    desk.submit(name, &desk.claim(name, "pair"), kept(text))
}

fn disagreement() -> Value {
    json!({ "queue": "disagreement" })
}

/// Logs the reviewer in. Her first page computes the figures, which are cached for a minute.
fn enter(desk: &Desk) {
    desk.enter("eve", "app/guide");
}

/// Cells of the rows of a table, as texts.
fn rows(browser: &Browser, selector: &str) -> Vec<Vec<String>> {
    let cells = browser.value(&format!(
        "[...document.querySelectorAll('{selector} tbody tr')].map((row) => [...row.cells].map((cell) => cell.innerText.trim()))"
    ));
    serde_json::from_value(cells).expect("texts")
}

#[test]
fn the_dashboard_tells_hours_agreement_and_the_time_left() {
    const PERIOD: &str = "[aria-label=Period] [aria-pressed=true]";
    let desk = office(2);
    let shared = answer(&desk, "ann", "Raise the arm.");
    assert_eq!(answer(&desk, "bob", "Raise the arm."), shared);
    answer(&desk, "ann", "Lower the arm.");
    enter(&desk);
    desk.page("app/dashboard", "[data-figures=days] tbody th");

    let work = rows(&desk, "[data-figures=days] > table");
    assert_eq!(work[0][0], "ann", "most hours first: {work:?}");
    assert_eq!(work[0][2..5], ["0.2 h", "2", "6 min"]);
    assert_eq!(work[1][0], "bob");
    assert_eq!(work[2][..4], ["all", "", "0.3 h", "3"]);
    // Every drawing has a name, and a table with the same figures.
    let drawings = desk.value(
        "[...document.querySelectorAll('.dashboard svg')].map((own) => \
            [own.getAttribute('role'), own.getAttribute('aria-label').length > 10, own.closest('section').querySelector('table, dl') !== null])",
    );
    let drawings = drawings.as_array().expect("drawings");
    assert!(drawings.len() >= 8, "{drawings:?}");
    let named = json!(["img", true, true]);
    assert!(drawings.iter().all(|own| *own == named), "{drawings:?}");
    let weeks = rows(&desk, "[data-figures=weeks] table");
    let week = &weeks.last().expect("this week")[1..];
    assert_eq!(week, ["3", "0", "0", "6 min", "1.00", "1"]);
    let nobody = "Nobody answered in the last seven days";
    let words = ["3.0", "answers are left", nobody];
    desk.reads("[data-figures=outlook]", &words);

    // The chosen period is kept, and an open table stays open when the figures change.
    desk.js("document.querySelector('[data-figures=days] details').open = true;");
    desk.press_button("[aria-label=Period]", "7 days");
    desk.says(PERIOD, "7 days");
    answer(&desk, "bob", "Lower the arm.");
    desk.until(
        "the new answer is shown",
        "document.querySelector('[data-figures=days] > table tbody tr:last-child').cells[3].innerText === '4'",
    );
    let by_day = rows(&desk, "[data-figures=days] details table");
    assert_eq!(by_day.len(), 1, "{by_day:?}");
    assert_eq!(by_day[0][1], "0.4 h, 4 answers");
    desk.is(
        "document.querySelector('[data-figures=days] details').open",
        true,
    );
    desk.page("app/dashboard", PERIOD);
    assert_eq!(desk.text_of(PERIOD), "7 days");
}

#[test]
fn a_reviewer_follows_what_was_sent_back() {
    let desk = office(1);
    let first = answer(&desk, "ann", "Raise the arm.");
    let back = desk.decide(disagreement(), "return", "Which arm?");
    assert_eq!(back, first);
    answer(&desk, "bob", "Lower the arm.");
    desk.decide(disagreement(), "accept", "");
    enter(&desk);
    desk.page("app/decisions", "decision-list tbody td");
    let marked = desk.text_of("header nav [aria-current]");
    assert_eq!(marked, "Review", "the page belongs to reviewing");
    let all = rows(&desk, "decision-list");
    assert_eq!(all.len(), 2, "{all:?}");
    assert_eq!(all[0][2..], ["accepted", "bob", "", "stands"]);
    let sent_back = ["sent back", "ann", "Which arm?", "waits for ann"];
    assert_eq!(all[1][2..], sent_back);
    assert!(all[1][1].starts_with(&first.to_string()), "{all:?}");
    // Ann answers again.
    let path = format!("tasks/{first}/claim");
    let view = desk.ask("ann", "POST", &path, Value::Null);
    desk.submit("ann", &view, kept("Raise the left arm."));
    desk.page("app/decisions/returned", "decision-list tbody td");
    let back = rows(&desk, "decision-list");
    assert_eq!(back.len(), 1, "{back:?}");
    assert_eq!(back[0][5], "answered again, waits for review", "{back:?}");
    desk.press_button("[aria-label='Kind of decision']", "Dropped");
    desk.says("decision-list td", "You have decided nothing");
}
