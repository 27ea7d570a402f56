//! The quick start of `docs/annotators.md`: one task of each kind is annotated, reviewed and exported, from login to the
//! tables, without a mouse.

use annotate_browser::{Browser, keys};
use serde_json::json;

use crate::steps::{Team, describe_two_masks};

/// Pastes a token into the login page.
async fn log_in(browser: &Browser, token: &str) {
    browser
        .until(
            "the login page waits for a token",
            "document.activeElement?.id === 'token'",
        )
        .await;
    browser.type_text(token).await;
    browser.press(&[keys::ENTER]).await;
    browser
        .until(
            "logged in",
            "document.querySelector('header.top:not([hidden])') && document.querySelector('.page.home')",
        )
        .await;
}

/// Opens a page by its link in the navigation. On task screens Tab moves between cards, and F6 between regions.
async fn follow(browser: &Browser, label: &str) {
    const REGIONS: usize = 5;
    for _ in 0..REGIONS {
        let at_top = browser
            .js("return document.activeElement.closest('header') !== null;")
            .await;
        if at_top == json!(true) {
            break;
        }
        browser.press(&[keys::F6]).await;
    }
    browser.tab_to(label).await;
    browser
        .js("document.querySelector('#main')?.firstElementChild?.setAttribute('data-left', '');")
        .await;
    browser.press(&[keys::ENTER]).await;
    browser
        .until(
            "another page is shown",
            "!document.querySelector('[data-left]')",
        )
        .await;
}

async fn log_out(browser: &Browser) {
    follow(browser, "Log out").await;
}

/// Submits the answer on the page, and repeats until a task needs no second answer.
async fn answer(
    browser: &Browser,
    token: &str,
    picture: &str,
    keys_of: &[&str],
    text: &str,
) -> i64 {
    loop {
        let task = browser.task().await;
        if keys_of.is_empty() {
            describe_two_masks(browser).await;
        } else {
            browser.press(keys_of).await;
            browser.type_text(text).await;
        }
        browser.saved().await;
        browser.picture(picture).await;
        let view = browser
            .request_as(token, "GET", &format!("tasks/{task}"), None)
            .await;
        browser.control(&[keys::ENTER]).await;
        browser
            .until(
                "it is handed in",
                &format!("document.querySelector('.work')?.dataset.task !== '{task}'"),
            )
            .await;
        let path = format!("tasks/{task}");
        let after = browser.request_as(token, "GET", &path, None).await;
        assert_eq!(after["body"]["mine"]["state"], "submitted", "{after}");
        if view["body"]["task"]["wanted"] == 1 {
            return task;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_clip_of_each_kind_goes_from_the_token_to_the_tables_by_keys_alone() {
    let Team {
        dataset,
        server,
        browser,
        ann,
        eve,
        boss,
    } = Team::open().await;
    browser.picture("login").await;

    log_in(&browser, &ann).await;
    browser.picture("home").await;
    follow(&browser, "Masks").await;
    let mask = answer(&browser, &ann, "masks", &[], "").await;
    browser.press(&["?"]).await;
    browser
        .until("the key sheet", "document.querySelector('dialog[open]')")
        .await;
    browser.picture("keys").await;
    browser.press(&[keys::ESCAPE]).await;
    follow(&browser, "Pairs").await;
    let kept = ["4", "e", "t"];
    let text = "Raise the left arm higher.";
    let pair = answer(&browser, &ann, "pairs", &kept, text).await;
    follow(&browser, "Styles").await;
    let style = answer(
        &browser,
        &ann,
        "styles",
        &["c", "o", "o", "o", "t"],
        "Walk in a proud way.",
    )
    .await;
    follow(&browser, "Guide").await;
    browser
        .until("the guide", "document.querySelector('.guide')")
        .await;
    browser.picture("guide").await;
    log_out(&browser).await;

    log_in(&browser, &eve).await;
    follow(&browser, "Review").await;
    let mut accepted = Vec::new();
    while accepted.len() < 3 {
        let task = browser.task().await;
        browser.picture(&format!("review-{}", accepted.len())).await;
        browser.press(&["a"]).await;
        browser
            .until(
                "it is decided",
                &format!("document.querySelector('.work')?.dataset.task !== '{task}'"),
            )
            .await;
        accepted.push(task);
    }
    accepted.sort_unstable();
    let mut wanted = [mask, pair, style];
    wanted.sort_unstable();
    assert_eq!(accepted, wanted);
    follow(&browser, "Examples").await;
    browser
        .until("the examples", "document.querySelector('.panel')")
        .await;
    browser.picture("examples").await;
    follow(&browser, "Dashboard").await;
    browser
        .until(
            "the dashboard",
            "document.querySelector('.dashboard table')",
        )
        .await;
    browser.picture("dashboard").await;
    log_out(&browser).await;
    log_in(&browser, &boss).await;
    follow(&browser, "Admin").await;
    browser
        .until("the admin page", "document.querySelector('.numbers')")
        .await;
    browser.picture("admin").await;
    browser.quit().await;
    drop(server);

    let counts = dataset.annotate(&["export"]).await;
    assert_eq!(counts["counts"]["motions_described"], 1, "{counts}");
    assert_eq!(counts["counts"]["pairs_judged"], 2, "{counts}");
}
