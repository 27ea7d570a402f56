//! Pairs in bundles, and style pairs.

use annotate_browser::{Browser, keys};
use serde_json::{Value, json};

use crate::steps::{Desk, mine};

/// Keeps the pair on the page: a part, an edit type, an instruction.
async fn keep(browser: &Browser) {
    browser.press(&["4", "e", "t"]).await;
    browser.type_text("Raise the left arm higher.").await;
    browser.control(&[keys::ENTER]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bundle_of_eight_with_three_rejects() {
    let desk = Desk::open("app/pair").await;
    let browser = &desk.browser;
    let mut task = browser.task().await;
    // Some bundles have fewer than eight pairs: reject those first.
    while browser
        .js("return document.querySelectorAll('.dot').length;")
        .await
        != json!(8)
    {
        browser.press(&["x"]).await;
        task = browser.next_task(task).await;
    }
    let bundle = browser.request("GET", &format!("tasks/{task}"), None).await;
    let tasks: Vec<i64> = bundle["body"]["task"]["bundle"]["tasks"]
        .as_array()
        .expect("a bundle")
        .iter()
        .filter_map(|item| item["task"].as_i64())
        .collect();
    assert_eq!(tasks.len(), 8);
    assert_eq!(
        browser
            .js("return document.querySelectorAll('.dot').length;")
            .await,
        json!(8)
    );
    let verdicts = [
        "unnatural",
        "keep",
        "unclear",
        "keep",
        "identical",
        "keep",
        "keep",
        "keep",
    ];
    let mut done = Vec::new();
    for verdict in verdicts {
        match verdict {
            "unnatural" => browser.press(&["x"]).await,
            "unclear" => browser.press(&["u"]).await,
            "identical" => browser.press(&["i"]).await,
            _ => keep(browser).await,
        }
        done.push((task, verdict));
        if done.len() < tasks.len() {
            task = browser.next_task(task).await;
            assert!(
                tasks.contains(&task),
                "the bundle is done one after the other"
            );
        }
    }
    browser
        .until(
            "the bundle is left",
            &format!("document.querySelector('.work')?.dataset.task !== '{task}'"),
        )
        .await;
    for (task, verdict) in done {
        let revision = mine(browser, task).await;
        assert_eq!(revision["state"], "submitted", "task {task}");
        assert_eq!(revision["answer"]["verdict"], verdict, "task {task}");
    }
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_verdict_is_taken_back_at_once() {
    let desk = Desk::open("app/pair").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    browser.press(&["x"]).await;
    browser.next_task(task).await;
    browser
        .until(
            "the offer to undo",
            "document.querySelector('.toast-action')",
        )
        .await;
    browser.control(&["z"]).await;
    browser
        .until(
            "the pair is back",
            &format!("document.querySelector('.work').dataset.task === '{task}'"),
        )
        .await;
    let revision = mine(browser, task).await;
    assert_ne!(revision["state"], "submitted");
    keep(browser).await;
    browser.next_task(task).await;
    assert_eq!(mine(browser, task).await["answer"]["verdict"], "keep");
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn views_of_a_pair_share_the_frame() {
    let desk = Desk::open("app/pair").await;
    let browser = &desk.browser;
    browser.task().await;
    browser.press(&["d"]).await;
    let frame = browser
        .js("return document.querySelector('.stage').dataset.frame;")
        .await;
    let caption = browser.text_of(".stage-caption").await;
    browser.press(&["w"]).await;
    browser
        .until(
            "swapped",
            &format!(
                "document.querySelector('.stage-caption').textContent !== {}",
                json!(caption)
            ),
        )
        .await;
    browser.press(&["g"]).await;
    browser
        .until("both on one stage", "document.querySelector('.stage').dataset.bodies === '2' && document.querySelectorAll('.stage:not([hidden])').length === 1")
        .await;
    assert_eq!(
        browser
            .js("return document.querySelector('.stage').dataset.frame;")
            .await,
        frame,
        "changing the view does not move the clock"
    );
    // The largest difference is one of poses: the ghost stands where the other body stands.
    assert_eq!(
        browser
            .js("return document.querySelector('.stage').dataset.together;")
            .await,
        json!("false")
    );
    browser.press(&["d"]).await;
    browser
        .until(
            "the ghost is moved",
            "document.querySelector('.stage').dataset.together === 'true'",
        )
        .await;
    browser.press(&["r"]).await;
    browser
        .until(
            "the ghost is back",
            "document.querySelector('.stage').dataset.together === 'false'",
        )
        .await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn phrases_fit_the_kind_of_pair() {
    const TEXT: &str = "return document.querySelector('.pair-editor textarea').value;";
    let desk = Desk::open("app/style").await;
    let browser = &desk.browser;
    browser.task().await;
    // The first style, then the first phrase.
    browser.press(&["c"]).await;
    let style = browser
        .text_of(".part[aria-pressed=true] .button-label")
        .await;
    browser.press(&["y"]).await;
    browser
        .until(
            "a phrase",
            "document.querySelector('.pair-editor textarea').value !== ''",
        )
        .await;
    let text = browser.js(TEXT).await;
    assert_eq!(text, json!(format!("in a {style} way")));
    browser.open(&desk.server.page("app/pair")).await;
    browser.task().await;
    browser.press(&["y"]).await;
    browser
        .until(
            "a phrase",
            "document.querySelector('.pair-editor textarea')?.value === 'higher'",
        )
        .await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_style_pair_is_done_by_keyboard_and_aligned_for_viewing_alone() {
    let desk = Desk::open("app/style").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    let before = motions(browser, task).await;
    browser.press(&["l"]).await;
    browser
        .until("aligned", "document.querySelector('.toast')")
        .await;
    browser.press(&["c", "o", "o", "o", "t"]).await;
    browser.type_text("Walk in a proud way.").await;
    browser.control(&[keys::ENTER]).await;
    browser
        .until(
            "it is handed in",
            &format!("document.querySelector('.work')?.dataset.task !== '{task}'"),
        )
        .await;
    let revision = mine(browser, task).await;
    assert_eq!(revision["state"], "submitted");
    assert_eq!(revision["answer"]["extent"], "whole");
    assert_eq!(
        revision["answer"]["parts"],
        json!(["UPPER_BODY", "LOWER_BODY"])
    );
    assert!(revision["answer"]["style"].is_string());
    assert_eq!(
        motions(browser, task).await,
        before,
        "what is stored is as it was"
    );
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_style_that_is_not_listed_is_typed_and_joins_the_list_once_accepted() {
    let desk = Desk::open("app/style").await;
    let browser = &desk.browser;
    let listed = "[...document.querySelectorAll('#styles-of-project option')].some((own) => own.value === 'limping')";
    let mut task = browser.task().await;
    // The first that wants one answer, so that it can be reviewed at once.
    loop {
        let view = browser.request("GET", &format!("tasks/{task}"), None).await;
        if view["body"]["task"]["wanted"] == 1 {
            break;
        }
        browser.press(&["x"]).await;
        task = browser.next_task(task).await;
    }
    assert_eq!(browser.js(&format!("return {listed};")).await, json!(false));
    browser
        .js("document.querySelector('.other-style').focus();")
        .await;
    browser.type_text("limping").await;
    browser
        .until(
            "it is said to be new",
            "document.querySelector('[data-new-style]')",
        )
        .await;
    browser.picture("style-new").await;
    browser.press(&[keys::ESCAPE, "o", "o", "o", "t"]).await;
    browser.type_text("Limp with the left leg.").await;
    browser.control(&[keys::ENTER]).await;
    browser.next_task(task).await;
    assert_eq!(mine(browser, task).await["answer"]["style"], "limping");

    let rev = desk.dataset.add_user("rev", "reviewer").await;
    let ask = json!({ "queue": "sample", "task": task });
    let review = browser
        .request_as(&rev, "POST", "review/next", Some(ask))
        .await;
    let review = &review["body"]["review"];
    let decision = json!({
        "idem_key": "test-accept-style",
        "task": task,
        "lease_epoch": review["lease"]["epoch"],
        "decision": "accept",
        "author": review["candidates"][0]["revision"]["author"],
    });
    let accepted = browser
        .request_as(&rev, "POST", "reviews", Some(decision))
        .await;
    assert_eq!(accepted["status"], 200, "{accepted}");
    browser.open(&desk.server.page("app/style")).await;
    browser.until("it is listed", listed).await;
    desk.browser.quit().await;
}

async fn motions(browser: &Browser, task: i64) -> Value {
    let view = browser.request("GET", &format!("tasks/{task}"), None).await;
    view["body"]["task"]["motions"].clone()
}
