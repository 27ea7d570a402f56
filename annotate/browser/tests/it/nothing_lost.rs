//! No error path loses text.

use annotate_browser::keys;
use serde_json::json;

use crate::steps::{Desk, describe_two_masks, mine};

const TEXT: &str = "document.querySelector('.mask-card.selected textarea').value";

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_ends_amid_a_text_loses_nothing() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    browser.press(&["4", "t"]).await;
    browser.type_text("Wave with ").await;
    browser.saved().await;
    let ended = browser.request("DELETE", "session", None).await;
    assert_eq!(ended["status"], 204);
    browser.type_text("the left arm.").await;
    browser
        .until(
            "the login box is over the page",
            "document.querySelector('dialog.login[open]')",
        )
        .await;
    assert_eq!(
        browser.js(&format!("return {TEXT};")).await,
        json!("Wave with the left arm.")
    );
    browser.type_text(&desk.token).await;
    browser.press(&[keys::ENTER]).await;
    browser
        .until(
            "the box is closed",
            "!document.querySelector('dialog.login')",
        )
        .await;
    browser.saved().await;
    assert_eq!(browser.task().await, task);
    let revision = mine(browser, task).await;
    assert_eq!(
        revision["answer"]["masks"][0]["text"],
        "Wave with the left arm."
    );
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn while_the_server_is_down_work_goes_on_and_is_sent_afterwards() {
    let mut desk = Desk::open("app/mask").await;
    let task = desk.browser.task().await;
    desk.server.down().await;
    let browser = &desk.browser;
    describe_two_masks(browser).await;
    browser
        .until(
            "the chip says so",
            "/^offline \\(\\d waiting\\)$/.test(document.querySelector('.chip').textContent)",
        )
        .await;
    // The page keeps retrying, and shows this state.
    browser
        .until(
            "it was tried again and again for twenty seconds",
            "(window.downSince ??= performance.now()) < performance.now() - 20000 && \
             document.querySelector('.chip').dataset.state === 'offline'",
        )
        .await;
    desk.server.up().await;
    let browser = &desk.browser;
    browser.saved().await;
    let revision = mine(browser, task).await;
    assert_eq!(revision["answer"]["masks"][1]["text"], "Bend the knees.");
    let revs = revision["rev"].as_i64().expect("a number");
    assert!(
        revs <= 2,
        "{revs} drafts were sent where one was on its way and one newer"
    );
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_that_is_closed_offline_sends_when_it_is_opened_again() {
    let mut desk = Desk::open("app/mask").await;
    let task = desk.browser.task().await;
    desk.server.down().await;
    desk.browser.press(&["4", "t"]).await;
    desk.browser.type_text("Kept in the browser.").await;
    desk.browser
        .until(
            "it waits",
            "document.querySelector('.chip').dataset.state === 'offline'",
        )
        .await;
    desk.server.up().await;
    let browser = &desk.browser;
    browser.open(&desk.server.page("app/home")).await;
    browser
        .until("the page is there", "document.querySelector('.queue')")
        .await;
    browser.saved().await;
    let revision = mine(browser, task).await;
    assert_eq!(
        revision["answer"]["masks"][0]["text"],
        "Kept in the browser."
    );
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_tabs_of_one_person_meet_and_merge() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    let first = browser.client().window().await.expect("a window");
    let second = browser
        .client()
        .new_window(true)
        .await
        .expect("a tab")
        .handle;
    browser
        .client()
        .switch_to_window(second)
        .await
        .expect("the other tab");
    browser.open(&desk.server.page("app/mask")).await;
    assert_eq!(
        browser.task().await,
        task,
        "a task that is held is given again"
    );

    browser
        .client()
        .switch_to_window(first)
        .await
        .expect("the first tab");
    browser.press(&["4", "t"]).await;
    browser.type_text("From the first tab.").await;
    browser.saved().await;
    browser.until("it has a revision", "true").await;
    assert_eq!(mine(browser, task).await["rev"], 1);

    browser
        .client()
        .switch_to_window(browser_window(browser, 1).await)
        .await
        .expect("the second tab");
    browser.press(&["5", "t"]).await;
    browser.type_text("From the second tab.").await;
    browser
        .until(
            "both texts are shown",
            "document.querySelector('dialog[open] .merge')",
        )
        .await;
    let shown = browser.text_of("dialog .merge").await;
    assert!(
        shown.contains("From the first tab.") && shown.contains("From the second tab."),
        "{shown}"
    );
    browser.press(&["3"]).await;
    browser
        .until(
            "the box is closed",
            "!document.querySelector('dialog[open]')",
        )
        .await;
    browser
        .until(
            "both masks are here",
            "document.querySelectorAll('.mask-card').length === 2",
        )
        .await;
    browser.saved().await;
    let revision = mine(browser, task).await;
    let texts: Vec<_> = revision["answer"]["masks"]
        .as_array()
        .expect("masks")
        .iter()
        .map(|mask| mask["text"].clone())
        .collect();
    assert_eq!(texts, ["From the second tab.", "From the first tab."]);
    desk.browser.quit().await;
}

async fn browser_window(
    browser: &annotate_browser::Browser,
    index: usize,
) -> fantoccini::wd::WindowHandle {
    let windows = browser.client().windows().await.expect("windows");
    windows[index].clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn answers_of_another_person_are_not_sent_as_mine() {
    let mut desk = Desk::open("app/mask").await;
    let other = desk.dataset_user().await;
    desk.browser.task().await;
    desk.browser.press(&["4", "t"]).await;
    desk.browser.type_text("Ann's text.").await;
    desk.browser.saved().await;
    let browser = &desk.browser;
    let ended = browser.request("DELETE", "session", None).await;
    assert_eq!(ended["status"], 204);
    browser.log_in(&desk.server, &other, "app/mask").await;
    let task = browser.task().await;
    let text = browser.js(&format!("return {TEXT};")).await;
    assert_eq!(text, json!(""), "task {task} of somebody else begins empty");
    desk.server.down().await;
    desk.browser.quit().await;
}

impl Desk {
    /// The token of a second annotator.
    async fn dataset_user(&self) -> String {
        self.dataset.add_user("bob", "annotator").await
    }
}
