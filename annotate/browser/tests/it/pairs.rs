//! Pairs in bundles, and style pairs.

use annotate_browser::keys;
use serde_json::json;

use crate::steps::Desk;

#[test]
fn a_bundle_of_eight_with_three_rejects() {
    let desk = Desk::at("app/pair");
    let mut task = desk.task();
    // Some bundles have fewer than eight pairs: reject those first.
    while desk.count(".dot") != 8 {
        desk.press(&["x"]);
        task = desk.next_task(task);
    }
    let bundle = desk.get(&format!("tasks/{task}"))["task"]["bundle"]["tasks"].take();
    let bundle = bundle.as_array().expect("a bundle").iter();
    let tasks: Vec<i64> = bundle.filter_map(|item| item["task"].as_i64()).collect();
    assert_eq!(tasks.len(), 8);
    let rejects = [("x", "unnatural"), ("u", "unclear"), ("i", "identical")];
    let keep = ("", "keep");
    let [unnatural, unclear, identical] = rejects;
    let verdicts = [unnatural, keep, unclear, keep, identical, keep, keep, keep];
    let mut done = Vec::new();
    for (key, verdict) in verdicts {
        if key.is_empty() {
            desk.keep();
        } else {
            desk.press(&[key]);
        }
        done.push((task, verdict));
        if done.len() < tasks.len() {
            task = desk.next_task(task);
            assert!(tasks.contains(&task), "one after the other");
        }
    }
    desk.leaves(task);
    for (task, verdict) in done {
        let revision = desk.mine(task);
        assert_eq!(revision["state"], "submitted", "task {task}");
        assert_eq!(revision["answer"]["verdict"], verdict, "task {task}");
    }
}

#[test]
fn views_of_a_pair_share_the_frame_and_a_verdict_is_taken_back_at_once() {
    const FRAME: &str = "document.querySelector('.stage').dataset.frame";
    const TOGETHER: &str = "document.querySelector('.stage').dataset.together";
    let desk = Desk::at("app/pair");
    let task = desk.task();
    desk.press(&["d"]);
    let frame = desk.value(FRAME);
    let caption = json!(desk.text_of(".stage-caption"));
    desk.press(&["w"]);
    desk.until(
        "swapped",
        &format!("document.querySelector('.stage-caption').textContent !== {caption}"),
    );
    desk.press(&["g"]);
    desk.until("both on one stage", "document.querySelector('.stage').dataset.bodies === '2' && document.querySelectorAll('.stage:not([hidden])').length === 1");
    // Changing the view does not move the clock.
    desk.is(FRAME, frame);
    // The largest difference is one of poses, so its key moves the ghost onto the other body. Another key moves it
    // back.
    desk.is(TOGETHER, "false");
    desk.press(&["d"]);
    desk.until("the ghost is moved", &format!("{TOGETHER} === 'true'"));
    desk.press(&["r"]);
    desk.until("the ghost is back", &format!("{TOGETHER} === 'false'"));

    desk.press(&["x"]);
    desk.next_task(task);
    desk.shows(".toast-action");
    desk.control(&["z"]);
    desk.shows(&format!(".work[data-task=\"{task}\"]"));
    assert_ne!(desk.mine(task)["state"], "submitted");
    desk.keep();
    desk.next_task(task);
    assert_eq!(desk.mine(task)["answer"]["verdict"], "keep");
}

#[test]
fn phrases_fit_the_kind_of_pair() {
    const TEXT: &str = "document.querySelector('.pair-editor textarea')?.value";
    let desk = Desk::at("app/style");
    desk.task();
    // Choose the first style, then the first phrase.
    desk.press(&["c"]);
    let style = desk.text_of(".part[aria-pressed=true] .button-label");
    desk.press(&["y"]);
    let phrase = |text: &str| desk.until("a phrase", &format!("{TEXT} === '{text}'"));
    phrase(&format!("in a {style} way"));
    desk.go("app/pair");
    desk.task();
    desk.press(&["y"]);
    phrase("higher");
}

#[test]
fn a_style_pair_is_done_by_keyboard_and_a_typed_style_joins_the_list_once_accepted() {
    let mut desk = Desk::at("app/style");
    let task = desk.task();
    let motions = || desk.get(&format!("tasks/{task}"))["task"]["motions"].take();
    let before = motions();
    desk.press(&["l"]);
    desk.shows(".toast");
    desk.write(&["c", "o", "o", "o", "t"], "Walk in a proud way.");
    desk.control(&[keys::ENTER]);
    desk.leaves(task);
    let revision = desk.mine(task);
    assert_eq!(revision["state"], "submitted");
    assert_eq!(revision["answer"]["extent"], "whole");
    let parts = json!(["UPPER_BODY", "LOWER_BODY"]);
    assert_eq!(revision["answer"]["parts"], parts);
    assert!(revision["answer"]["style"].is_string());
    assert_eq!(motions(), before, "they are aligned for viewing alone");

    let listed = "[...document.querySelectorAll('#styles-of-project option')].some((own) => own.value === 'limping')";
    let mut task = desk.task();
    // The first pair that needs only one answer, so that it can be reviewed at once.
    while desk.get(&format!("tasks/{task}"))["task"]["wanted"] != 1 {
        desk.press(&["x"]);
        task = desk.next_task(task);
    }
    desk.is(listed, false);
    desk.focus(".other-style");
    desk.type_text("limping");
    desk.shows("[data-new-style]");
    desk.picture("style-new");
    let keep = [keys::ESCAPE, "o", "o", "o", "t"];
    desk.write(&keep, "Limp with the left leg.");
    desk.control(&[keys::ENTER]);
    desk.next_task(task);
    assert_eq!(desk.mine(task)["answer"]["style"], "limping");

    desk.join("eve");
    let request = json!({ "queue": "sample", "task": task });
    desk.decide(request, "accept", "");
    desk.go("app/style");
    desk.until("it is listed", listed);
}
