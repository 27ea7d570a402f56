//! Every screen in each size and theme. Pictures are taken if ANNOTATE_PICTURES names a folder; ANNOTATE_SEEDED names a
//! dataset whose store has work in it, as `annotate/tests/server/figures.rs` writes it.

use std::collections::BTreeMap;

use annotate_browser::{Browser, Dataset, Graphics, Server, keys};
use serde_json::json;

/// Screens, what shows that they are drawn, and who looks at them.
const SCREENS: [(&str, &str, &str); 17] = [
    ("home", ".queue", "annotator"),
    ("mask", ".mask-card textarea", "annotator"),
    ("pair", ".verdicts", "annotator"),
    ("style", ".verdicts", "annotator"),
    ("shelf", ".panel", "annotator"),
    ("guide", ".guide", "annotator"),
    ("practice", ".page.practice .queue", "annotator"),
    ("mine", ".work.mine .shelf-list", "annotator"),
    ("review", "#main h1, .candidates", "reviewer"),
    ("decisions", "decision-list table", "reviewer"),
    ("tasks", ".list-row[data-task]", "reviewer"),
    ("task", "task-record .facts", "reviewer"),
    ("rules", ".dashboard .note", "admin"),
    ("dashboard", ".dashboard table", "reviewer"),
    ("admin", ".numbers", "admin"),
    ("login", "#token", ""),
    ("keys", ".key-sheet", "annotator"),
];

/// Controls that reach out of what shows them, and parts that are wider than their frame.
const CUT: &str = "[...document.querySelectorAll('button, a, input, select, textarea, .chip')] \
    .filter((own) => own.getClientRects().length > 0) \
    .filter((own) => { const box = own.getBoundingClientRect(); return box.left < -1 || box.right > innerWidth + 1 || \
        (own.closest('header') && box.height > 40) || \
        (own.matches('button, a') && own.scrollWidth > own.clientWidth + 1 && getComputedStyle(own).display !== 'inline'); }) \
    .map((own) => own.textContent || own.tagName) \
    .concat(['html', 'main', '.panel'].filter((part) => { const own = document.querySelector(part); \
        return own && own.scrollWidth > own.clientWidth; }))";

#[tokio::test(flavor = "multi_thread")]
async fn every_screen_fits_in_both_sizes_and_themes() {
    let seeded = std::env::var_os("ANNOTATE_SEEDED").map(std::path::PathBuf::from);
    let dataset = match &seeded {
        Some(folder) => Dataset::copy_of(folder),
        None => Dataset::fresh().await,
    };
    for theme in ["light", "dark"] {
        let dark: &[&str] = if theme == "dark" {
            &["--force-dark-mode"]
        } else {
            &[]
        };
        let server = Server::start(&dataset).await;
        let browser = Browser::start_with(Graphics::Software, dark).await;
        browser
            .log_in(&server, server.printed_token(), "app/home")
            .await;
        let mut tokens = BTreeMap::new();
        for role in ["annotator", "reviewer", "admin"] {
            tokens.insert(role, token_of(&browser, role).await);
        }
        let mut as_who = "";
        for (name, shown, role) in SCREENS {
            if role != as_who {
                browser.request("DELETE", "session", None).await;
                if let Some(token) = tokens.get(role) {
                    browser.log_in(&server, token, "app/home").await;
                }
                as_who = role;
            }
            let path = match name {
                "login" => String::new(),
                "keys" => "app/home".to_owned(),
                "task" => "app/task/1".to_owned(),
                "review" => review(&browser).await,
                name => format!("app/{name}"),
            };
            browser.open(&server.page(&path)).await;
            if name == "keys" {
                browser
                    .until("the page", "document.querySelector('.queue')")
                    .await;
                browser.press(&["?"]).await;
            }
            browser
                .until(name, &format!("document.querySelector('{shown}')"))
                .await;
            if matches!(name, "mask" | "pair" | "style" | "review")
                && browser
                    .js("return document.querySelector('.work') !== null;")
                    .await
                    == json!(true)
            {
                browser.task().await;
            }
            // The screens of the README are shown in the middle of work.
            match name {
                "mask" => {
                    browser.press(&["4", "t"]).await;
                    browser
                        .type_text("swinging the left arm beside the body")
                        .await;
                    browser.press(&[keys::ESCAPE, "n", "2", "t"]).await;
                    browser
                        .type_text("stepping slowly from one foot to the other")
                        .await;
                    // The second one holds for a range of the clip.
                    browser.press(&[keys::ESCAPE, keys::HOME, "["]).await;
                    browser.shift(&[".", ".", ".", "."]).await;
                    browser.press(&["]", "a"]).await;
                }
                "pair" => {
                    browser.press(&["4", "e", "t"]).await;
                    browser.type_text("Raise the left arm higher.").await;
                    browser.press(&[keys::ESCAPE]).await;
                }
                _ => {}
            }
            let file = format!("{name}-{theme}");
            browser
                .in_each_size(&file, async |width| {
                    assert_eq!(
                        browser.js(&format!("return {CUT};")).await,
                        json!([]),
                        "{name}, {theme}, {width} pixels wide"
                    );
                })
                .await;
        }
        browser.quit().await;
        drop(server);
    }
}

/// The page of the clip whose answers differ most; the queue, if none waits.
async fn review(browser: &Browser) -> String {
    let wanted = "tasks?kind=mask_text&state=submitted&sort=distance&limit=1";
    let found = browser.request("GET", wanted, None).await;
    match found["body"]["rows"][0]["id"].as_i64() {
        Some(task) => format!("app/review/{task}"),
        None => "app/review".to_owned(),
    }
}

/// A token of the first user of a role, or of a new one.
async fn token_of(browser: &Browser, role: &str) -> String {
    let users = browser.request("GET", "users", None).await["body"].clone();
    let known = users
        .as_array()
        .and_then(|users| users.iter().find(|user| user["role"] == role));
    let shown = match known {
        Some(user) => {
            let path = format!("users/{}/tokens", user["id"]);
            let days = json!({ "days": 1 });
            browser.request("POST", &path, Some(days)).await
        }
        None => {
            let new = json!({ "name": format!("one {role}"), "role": role });
            browser.request("POST", "users", Some(new)).await
        }
    };
    shown["body"]["token"].as_str().expect("a token").to_owned()
}
