//! Review: accept, return, merge; and texts that contain markup.

use std::ops::Deref;

use annotate_browser::keys;
use serde_json::{Value, json};

use crate::steps::{Desk, two_masks};

const WAVE: &str = "Wave with the left arm.";
const HOSTILE: &str =
    "<img src=x onerror=\"window.canary=1\"><script>window.canary=1</script>\u{202e}desrever";

/// A desk with an answer of ann's to a task, and a reviewer who is logged in.
struct Bench {
    desk: Desk,
    answered: i64,
}

impl Deref for Bench {
    type Target = Desk;

    fn deref(&self) -> &Desk {
        &self.desk
    }
}

impl Bench {
    fn with_answer(text: &str) -> Self {
        let desk = Desk::of(&["ann", "eve", "boss"]);
        // Find the first task that needs only one answer before review.
        let answered = loop {
            let view = desk.claim("ann", "mask_text");
            let task = desk.submit("ann", &view, two_masks(text, "LEFT_ARM"));
            if view["task"]["wanted"] == 1 {
                break task;
            }
        };
        desk.enter("eve", "app/home");
        desk.go("app/review");
        Self { desk, answered }
    }

    /// The task as its author sees it.
    fn view(&self) -> Value {
        let path = format!("tasks/{}", self.answered);
        self.ask("ann", "GET", &path, Value::Null)
    }

    /// Waits until the page shows the decision, and checks the state on the server.
    fn decided(&self, state: &str) {
        self.says(".toast", state);
        assert_eq!(self.view()["mine"]["state"], state);
    }
}

#[test]
fn an_answer_goes_back_with_a_comment_to_its_author() {
    let bench = Bench::with_answer(WAVE);
    bench.task();
    bench.press(&["r"]);
    bench.comment("Which hand?");
    bench.decided("returned");
    assert_eq!(bench.view()["comment"], "Which hand?");
    // The author finds the returned task on her home page and corrects it.
    bench.log_out();
    bench.enter("ann", "app/home");
    bench.until(
        "it is the first thing on her page",
        "document.activeElement.textContent.startsWith('Fix task')",
    );
    bench.press(&[keys::ENTER]);
    assert_eq!(bench.task(), bench.answered);
    bench.reads(".returned-note", &["Which hand?"]);
    bench.write(&["t"], " Twice.");
    bench.control(&[keys::ENTER]);
    bench.next_task(bench.answered);
    assert_eq!(bench.view()["mine"]["state"], "submitted");
}

/// Resizes a review page to a size in pixels. Checks that `stage` pixels of the stage and all decisions are visible and
/// that nothing overflows or is cut off. Returns the height of the smallest button and the size of the smallest text.
fn fits(bench: &Bench, [width, height]: [u32; 2], stage: f64) -> [f64; 2] {
    bench.task();
    bench.resize(width, height);
    bench.photograph(&format!("review-{width}-{height}"));
    let page = bench.js(
        "const box = (selector) => document.querySelector(selector).getBoundingClientRect();
             const [stage, foot] = [box('.stage-area'), box('.panel-foot')];
             const buttons = [...document.querySelectorAll('.panel-foot button, .transport button')];
             const heights = buttons.map((own) => own.getBoundingClientRect().height).filter((own) => own > 0);
             return {
               width: innerWidth,
               over: document.documentElement.scrollWidth - innerWidth,
               stage: Math.min(stage.bottom, innerHeight) - Math.max(stage.top, 0),
               foot: innerHeight - foot.bottom,
               cut: Math.max(...[...document.querySelectorAll('.viewer, .panel')].map((own) => own.scrollHeight - own.clientHeight)),
               button: Math.min(...heights),
               text: Math.min(...[...document.querySelectorAll('.panel-scroll *')]
                 .filter((own) => own.childElementCount === 0 && own.textContent.trim() && own.tagName !== 'KBD')
                 .map((own) => parseFloat(getComputedStyle(own).fontSize))),
             };",
        );
    let number = |name: &str| page[name].as_f64().expect("a number");
    assert_eq!(page["width"], width, "{page}");
    assert!(number("over") <= 0.0 && number("foot") >= 0.0, "{page}");
    assert!(number("stage") >= stage && number("cut") <= 1.0, "{page}");
    [number("button"), number("text")]
}

#[test]
fn answers_are_reviewed_by_touch_on_a_tablet_held_upright() {
    let bench = Bench::with_answer(WAVE);
    let [button, _] = fits(&bench, [820, 1180], 300.0);
    assert!(button >= 40.0, "{button}");
    // The clip plays by itself; a tap on the button stops it, and a tap on the bar seeks.
    let label = "document.querySelector('.transport .play').textContent";
    bench.until("it plays", &format!("{label}.includes('Pause')"));
    bench.tap(".transport .play");
    bench.until("it stands", &format!("{label}.includes('Play')"));
    bench.press(&[keys::HOME]);
    let begin = "document.querySelector('.scrub').value === '0'";
    bench.until("it is at its begin", begin);
    bench.tap(".scrub");
    let moved = "Number(document.querySelector('.scrub').value) > 5";
    bench.until("it is moved", moved);
    bench.tap(".panel-foot button:nth-child(2)");
    bench.shows("dialog[open] textarea");
    bench.tap("dialog[open] textarea");
    bench.type_text("Which hand?");
    bench.tap("dialog[open] button.primary");
    bench.says(".toast", "returned");
    assert_eq!(bench.view()["comment"], "Which hand?");
}

#[test]
fn an_answer_is_read_and_accepted_on_a_telephone() {
    let bench = Bench::with_answer(WAVE);
    for (size, stage) in [
        ([390, 844], 200.0),
        // On its side, and windows that are low.
        ([844, 390], 120.0),
        ([640, 380], 120.0),
        ([960, 470], 120.0),
        ([800, 600], 200.0),
    ] {
        let [_, text] = fits(&bench, size, stage);
        assert!(text >= 12.0, "{size:?} {text}");
    }
    bench.tap(".panel-foot button.primary");
    bench.decided("accepted");
}

#[test]
fn an_answer_is_merged_and_edited_beside_what_its_author_was_offered() {
    let bench = Bench::with_answer(WAVE);
    bench.task();
    let offered = bench.view()["suggestions"].as_array().map(Vec::len);
    assert!(offered > Some(0), "{offered:?}");
    bench.shows(".offered");
    assert_eq!(Some(bench.count(".offered li") as usize), offered);
    // Every dialog of this page can be cancelled without a decision.
    for key in ["r", keys::DELETE] {
        bench.press(&[key]);
        bench.press_button("dialog", "Cancel");
        bench.lacks("dialog[open]");
    }
    bench.press(&["m"]);
    bench.shows(".merge-box:not([hidden]) .mask-card");
    bench.press(&["5"]);
    bench.control(&[keys::ENTER]);
    bench.says(".toast", "accepted");
    let shelf = bench.get("shelf?limit=5");
    let parts = &shelf["items"][0]["answer"]["masks"][0]["parts"];
    assert_eq!(*parts, json!(["LEFT_ARM", "RIGHT_ARM"]));
}

#[test]
fn an_answer_is_accepted_with_one_key_and_hostile_text_stays_text_on_every_page() {
    let bench = Bench::with_answer(HOSTILE);
    assert_eq!(bench.task(), bench.answered);
    bench.reads(".candidates", &[HOSTILE]);
    bench.press(&["a"]);
    bench.decided("accepted");
    let record = format!("app/task/{}", bench.answered);
    for (page, shown) in [
        ("app/tasks", ".list-row[data-task]"),
        (record.as_str(), "task-record .candidate"),
        ("app/dashboard", ".dashboard table"),
        ("app/home", ".queue"),
        ("app/shelf", ".shelf-item"),
    ] {
        bench.page(page, shown);
        bench.check_canary(page, 0);
    }
    bench.reads(".shelf-item", &["<script>"]);
}
