//! Every screen in each size and theme. Screenshots are saved if ANNOTATE_PICTURES names a folder. ANNOTATE_SEEDED
//! names a dataset with work in its store, as `annotate/tests/server/figures.rs` writes it.

use std::collections::BTreeMap;

use annotate_browser::{Browser, Dataset, keys};
use serde_json::json;

use crate::steps::Desk;

/// Each page, a selector that matches once it is drawn, and the role that opens it.
pub(crate) const SCREENS: [(&str, &str, &str); 15] = [
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
];

/// Screens that are no pages of their own.
const OTHERS: [(&str, &str, &str); 2] =
    [("login", "#token", ""), ("keys", ".key-sheet", "annotator")];

pub(crate) fn address(name: &str) -> String {
    match name {
        "task" => "app/task/1".to_owned(),
        name => format!("app/{name}"),
    }
}

/// Controls outside the visible area, and parts wider than their frame.
const CUT: &str = "[...document.querySelectorAll('button, a, input, select, textarea, .chip')] \
    .filter((own) => own.getClientRects().length > 0) \
    .filter((own) => { const box = own.getBoundingClientRect(); return box.left < -1 || box.right > innerWidth + 1 || \
        (own.closest('header') && box.height > 40) || \
        (own.matches('button, a') && own.scrollWidth > own.clientWidth + 1 && getComputedStyle(own).display !== 'inline'); }) \
    .map((own) => own.textContent || own.tagName) \
    .concat(['html', 'main', '.panel'].filter((part) => { const own = document.querySelector(part); \
        return own && own.scrollWidth > own.clientWidth; }))";

#[test]
fn every_screen_fits_in_both_sizes_and_themes() {
    let seeded = std::env::var_os("ANNOTATE_SEEDED").map(std::path::PathBuf::from);
    let themes: [(&str, &[&str]); 2] = [("light", &[]), ("dark", &["--force-dark-mode"])];
    for (theme, arguments) in themes {
        let dataset = match &seeded {
            Some(folder) => Dataset::copy_of(folder),
            None => Dataset::fresh(),
        };
        let desk = Desk::admin(dataset, arguments);
        let roles = ["annotator", "reviewer", "admin"];
        let tokens = BTreeMap::from(roles.map(|role| (role, token_of(&desk, role))));
        let mut as_who = "";
        for (name, shown, role) in SCREENS.into_iter().chain(OTHERS) {
            if role != as_who {
                desk.request("DELETE", "session", None);
                if let Some(token) = tokens.get(role) {
                    desk.log_in(&desk.server, token, "app/home");
                }
                as_who = role;
            }
            open(&desk, name, shown);
            let file = format!("{name}-{theme}");
            desk.in_each_size(&file, |width| {
                let cut = desk.value(CUT);
                assert_eq!(cut, json!([]), "{name}, {theme}, {width} pixels wide");
            });
        }
    }
}

/// Opens a screen. The README's screens are shown with work in progress.
fn open(desk: &Desk, name: &str, shown: &str) {
    match name {
        "login" => desk.go(""),
        "keys" => {
            desk.page("app/home", ".queue");
            desk.press(&["?"]);
        }
        "review" => desk.go(&review(desk)),
        name => desk.go(&address(name)),
    }
    desk.shows(shown);
    if matches!(name, "mask" | "pair" | "style" | "review") && desk.count(".work") > 0 {
        desk.task();
    }
    match name {
        "mask" => {
            let text = "swinging the left arm beside the body";
            desk.write(&["4", "t"], text);
            let text = "stepping slowly from one foot to the other";
            desk.write(&[keys::ESCAPE, "n", "2", "t"], text);
            // The second mask covers a range of the clip.
            desk.press(&[keys::ESCAPE, keys::HOME, "["]);
            desk.shift(&[".", ".", ".", "."]);
            desk.press(&["]", "a"]);
        }
        "pair" => {
            desk.write(&["4", "e", "t"], "Raise the left arm higher.");
            desk.press(&[keys::ESCAPE]);
        }
        _ => {}
    }
}

/// The review page of the clip whose answers differ most, or the review queue if no clip is waiting.
fn review(browser: &Browser) -> String {
    let wanted = "tasks?kind=mask_text&state=submitted&sort=distance&limit=1";
    match browser.get(wanted)["rows"][0]["id"].as_i64() {
        Some(task) => format!("app/review/{task}"),
        None => "app/review".to_owned(),
    }
}

/// A token of the first user with a role; adds such a user if there is none.
fn token_of(browser: &Browser, role: &str) -> String {
    let users = browser.get("users");
    let mut users = users.as_array().expect("users").iter();
    let known = users.find(|user| user["role"] == role);
    let shown = match known {
        Some(user) => {
            let path = format!("users/{}/tokens", user["id"]);
            let days = json!({ "days": 1 });
            browser.request("POST", &path, Some(days))
        }
        None => {
            let new = json!({ "name": format!("one {role}"), "role": role });
            browser.request("POST", "users", Some(new))
        }
    };
    shown["body"]["token"].as_str().expect("a token").to_owned()
}
