//! No error path loses text.

use annotate_browser::{Dataset, keys};
use serde_json::json;

use crate::steps::{Desk, two_masks};

const TEXT: &str = "document.querySelector('.mask-card.selected textarea').value";

/// Checks the text of the first mask of the user's answer on the server.
fn stored(desk: &Desk, task: i64, text: &str) {
    assert_eq!(desk.mine(task)["answer"]["masks"][0]["text"], text);
}

#[test]
fn a_session_that_ends_amid_a_text_loses_nothing_and_the_next_person_begins_anew() {
    let mut desk = Desk::at("app/mask");
    let task = desk.task();
    desk.write(&["4", "t"], "Wave with ");
    desk.saved();
    desk.log_out();
    desk.type_text("the left ");
    desk.shows("[data-region=session]:not([hidden])");
    // Typing continues: the text field keeps the focus.
    desk.type_text("arm.");
    desk.is(TEXT, "Wave with the left arm.");
    assert_eq!(desk.count("dialog"), 0);
    desk.press(&[keys::ESCAPE]);
    desk.shows("dialog.login[open]");
    // Keys for the page must not end up in the token.
    desk.type_text("15sb");
    desk.focuses("#token");
    desk.is("document.querySelector('#token').value", "");
    // The dialog can be cancelled; the page offers to log in again.
    desk.click("dialog.login [data-choice=Cancel]");
    desk.lacks("dialog.login");
    desk.shows("[data-region=session]:not([hidden]) button");
    desk.click("[data-region=session] button");
    desk.focuses("#token");
    desk.type_text(desk.token("ann"));
    desk.press(&[keys::ENTER]);
    desk.lacks("dialog.login");
    desk.saved();
    assert_eq!(desk.task(), task);
    stored(&desk, task, "Wave with the left arm.");
    // Another person's task begins empty.
    desk.join("bob");
    desk.log_out();
    desk.enter("bob", "app/mask");
    desk.task();
    desk.is(TEXT, "");
}

#[test]
fn while_the_server_is_down_work_goes_on_and_is_sent_afterwards() {
    let mut desk = Desk::at("app/mask");
    let task = desk.task();
    desk.server.down();
    desk.describe_two_masks();
    desk.until(
        "the chip says so",
        "/^offline \\(\\d waiting\\)$/.test(document.querySelector('.chip').textContent)",
    );
    // The page keeps retrying, and shows this state.
    desk.until(
        "it was tried again and again for twenty seconds",
        "(window.downSince ??= performance.now()) < performance.now() - 20000 && \
         document.querySelector('.chip').dataset.state === 'offline'",
    );
    desk.server.up();
    desk.saved();
    let revision = desk.mine(task);
    assert_eq!(revision["answer"]["masks"][1]["text"], "Bend the knees.");
    let revs = revision["rev"].as_i64().expect("a number");
    assert!(revs <= 2, "{revs} drafts: one on its way and one newer");
}

#[test]
fn two_tabs_of_one_person_meet_and_merge() {
    let desk = Desk::at("app/mask");
    let task = desk.task();
    let (first, second) = (desk.window(), desk.new_tab());
    desk.switch_to(&second);
    desk.go("app/mask");
    assert_eq!(desk.task(), task, "a task that is held is given again");

    desk.switch_to(&first);
    desk.write(&["4", "t"], "From the first tab.");
    desk.saved();
    assert_eq!(desk.mine(task)["rev"], 1);

    desk.switch_to(&second);
    desk.write(&["5", "t"], "From the second tab.");
    desk.shows(".conflict .merge");
    let [mine, theirs] = ["From the second tab.", "From the first tab."];
    desk.reads(".conflict .merge", &[mine, theirs]);
    merge(&desk);
    desk.lacks(".conflict");
    desk.has(".mask-card", 2);
    desk.saved();
    let revision = desk.mine(task);
    let masks = &revision["answer"]["masks"];
    assert_eq!(masks.as_array().map(Vec::len), Some(2));
    assert_eq!([&masks[0]["text"], &masks[1]["text"]], [mine, theirs]);
}

#[test]
fn a_duplicated_tab_is_a_tab_of_its_own() {
    const NAME: &str = "sessionStorage.getItem('tab')";
    let desk = Desk::at("app/mask");
    let task = desk.task();
    desk.write(&["4", "t"], "From the first tab.");
    desk.saved();
    let name = desk.value(NAME);
    // A window opened by a page gets a copy of its session storage, like a duplicated tab.
    let first = desk.window();
    desk.js("window.open(location.href);");
    let second = desk.windows().into_iter().find(|window| *window != first);
    desk.switch_to(&second.expect("a second window"));
    assert_eq!(desk.task(), task);
    let other = desk.value(NAME);
    assert!(other.is_string() && other != name, "{other} and {name}");
    desk.write(&["t"], " And the second.");
    desk.saved();
    assert!(desk.mine(task)["rev"].as_i64() > Some(1));
    // The first window has not seen the new answer: it shows a conflict instead of overwriting the answer.
    desk.switch_to(&first);
    desk.press(&[keys::END]);
    desk.type_text(" More of the first.");
    desk.shows(".conflict .merge");
    // A reload keeps the name of the window.
    desk.go("app/mask");
    desk.task();
    desk.is(NAME, name);
}

/// Waits until the keys of the conflict box are active, and keeps both versions.
fn merge(desk: &Desk) {
    desk.shows(".conflict [aria-disabled=false]");
    assert!(desk.reaches(".conflict"), "F6 does not reach the box");
    desk.press(&["3"]);
}

#[test]
fn typing_goes_on_while_two_versions_meet() {
    const STATE: &str = "const field = document.querySelector('.mask-card.selected textarea'); \
        return { text: field.value, cards: document.querySelectorAll('.mask-card').length, \
        parts: [...document.querySelectorAll('.mask-card.selected .part[aria-pressed=\"true\"]')].map((e) => e.dataset.part), \
        here: document.activeElement === field, caret: field.selectionStart };";
    let desk = Desk::at("app/mask");
    let task = desk.task();
    desk.write(&["4", "t"], "Wave");
    desk.saved();
    // Saves the answer as a draft, as another window of the same user would.
    let view = desk.get(&format!("tasks/{task}"));
    let answer = two_masks("From another window.", "RIGHT_ARM");
    desk.send("ann", &view, "draft", json!({ "answer": answer }));
    desk.type_text(" with");
    desk.shows(".conflict");
    // Outside text fields, space presses buttons, and these letters and digits are shortcuts of the stage and of the
    // box.
    let rest = " the left arm. 123 v h x u n";
    desk.type_text(rest);
    let text = format!("Wave with{rest}");
    let expected = json!({
        "text": text, "cards": 1, "parts": ["LEFT_ARM", "soft"], "here": true, "caret": text.len(),
    });
    assert_eq!(desk.js(STATE), expected);
    desk.reads(".conflict", &[&text]);

    // The caret is in the middle, and returns there after the choice.
    desk.press(&[keys::HOME, keys::RIGHT, keys::RIGHT]);
    merge(&desk);
    desk.focuses(".mask-card.selected textarea");
    let merged = desk.js(STATE);
    assert_eq!(merged["caret"], 2);
    assert_eq!(merged["text"], text);
    assert_eq!(merged["cards"], 3);
    desk.saved();
    stored(&desk, task, &text);
    let masks = &desk.mine(task)["answer"]["masks"];
    assert_eq!(masks[1]["text"], "From another window.");
}

#[test]
fn a_closed_and_reopened_browser_is_no_other_window() {
    let mut desk = Desk::at("app/mask");
    let task = desk.task();
    desk.write(&["4", "t"], "Wave");
    desk.saved();
    desk.server.down();
    desk.type_text(" with the left arm.");
    desk.shows(".chip[data-state=offline]");
    let (first, second) = (desk.window(), desk.new_tab());
    desk.switch_to(&first);
    desk.close_tab();
    desk.switch_to(&second);
    desk.server.up();
    desk.go("app/mask");
    assert_eq!(desk.task(), task);
    desk.is(TEXT, "Wave with the left arm.");
    desk.press(&["t", keys::END]);
    desk.type_text(" Slowly.");
    desk.saved();
    assert_eq!(desk.count(".conflict"), 0);
    stored(&desk, task, "Wave with the left arm. Slowly.");
}

#[test]
fn a_project_is_not_handed_the_texts_of_another_on_the_same_port() {
    let mut desk = Desk::at("app/mask");
    let task = desk.task();
    let other = Dataset::fresh();
    let token = other.add_user("ann", "annotator");
    desk.server.down();
    desk.write(&["4", "t"], "Of the first project.");
    desk.shows(".chip[data-state=offline]");
    desk.open("about:blank");
    desk.server.switch_to(&other);
    desk.log_in(&desk.server, &token, "app/mask");
    let same = desk.task();
    assert_eq!(same, task, "tasks of both projects have the same numbers");
    // The unsaved text belongs to the other project.
    desk.is(TEXT, "");
    desk.saved();
    assert_eq!(desk.mine(same), json!(null));

    desk.server.switch_to(&desk.dataset);
    desk.go("app/home");
    desk.shows(".queue");
    desk.saved();
    stored(&desk, task, "Of the first project.");
}

#[test]
fn what_was_typed_in_the_last_moment_of_a_page_is_sent_by_the_next() {
    let mut desk = Desk::at("app/mask");
    let task = desk.task();
    desk.press(&["4", "t"]);
    desk.saved();
    desk.server.down();
    desk.js(
        "const box = document.querySelector('.mask-card.selected textarea'); \
             box.value = 'Typed and gone.'; \
             box.dispatchEvent(new Event('input', { bubbles: true }));",
    );
    // Leave before the pause that saves a draft has passed. Another process shows the blank page, and unfinished
    // transactions of the first page's database are aborted.
    desk.open("about:blank");
    desk.server.up();
    desk.go("app/home");
    desk.shows(".queue");
    desk.saved();
    stored(&desk, task, "Typed and gone.");
    let rev = desk.mine(task)["rev"].take();

    // Going back restores the page with its state in memory.
    for _ in 0..2 {
        desk.back();
    }
    desk.shows(".mask-card textarea");
    desk.saved();
    desk.is(TEXT, "Typed and gone.");
    desk.is("document.querySelector('button.stuck').hidden", true);
    assert_eq!(desk.mine(task)["rev"], rev);
}

#[test]
fn what_an_earlier_version_left_unsent_is_listed_and_not_sent() {
    let desk = Desk::at("app/home");
    desk.shows(".queue");
    let user = desk.get("me")["user"]["id"].clone();
    let item = json!({
        "key": "left-behind", "order": 1, "user": user, "task": 1, "chain": "1:1:old", "sent": false, "problem": null,
        "event": { "idem_key": "left-behind", "kind": "draft", "lease_epoch": 1, "base_rev": 0,
                   "answer": two_masks("Of an earlier version.", "LEFT_ARM") },
    });
    // The database of earlier versions, which all projects of a host shared.
    desk.js_async(&format!(
        "{{ const open = indexedDB.open('annotate', 1); \
           open.onupgradeneeded = () => {{ open.result.createObjectStore('outbox'); open.result.createObjectStore('chains'); }}; \
           await new Promise((done) => {{ open.onsuccess = done; }}); \
           const write = open.result.transaction('outbox', 'readwrite'); \
           write.objectStore('outbox').put({item}, 'left-behind'); \
           await new Promise((done) => {{ write.oncomplete = done; }}); open.result.close(); return null; }}"
    ));
    desk.go("app/home");
    desk.until(
        "it is listed",
        "document.querySelector('.stuck:not([hidden])')?.textContent === '1 not taken'",
    );
    desk.click(".stuck");
    desk.says("dialog[open]", "Of an earlier version.");
    let home = desk.get("home");
    assert_eq!(home["held"], json!([]), "nothing was sent");
}

#[test]
fn the_page_works_over_plain_http_from_another_host() {
    let desk = Desk::at("app/home");
    desk.open("about:blank");
    let token = desk.token("ann");
    let login = desk.server.page_from_afar(&format!("#token={token}"));
    desk.open(&login);
    desk.shows(".queue");
    desk.is("isSecureContext", false);
    let shown = desk.value("location.href").to_string();
    assert!(!shown.contains(token), "{shown}");
    desk.open(&desk.server.page_from_afar("app/mask"));
    let task = desk.task();
    desk.write(&["4", "t"], "From afar.");
    desk.saved();
    stored(&desk, task, "From afar.");
}
