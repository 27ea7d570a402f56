//! No error path loses text.

use annotate_browser::{Dataset, Server, keys};
use serde_json::json;

use crate::steps::{Desk, describe_two_masks, mine, two_masks};

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
    browser.type_text("the left ").await;
    browser
        .until(
            "the page says that the session has ended",
            "document.querySelector('[data-region=session]:not([hidden])')",
        )
        .await;
    // Typing goes on: nothing takes the focus from the text.
    browser.type_text("arm.").await;
    assert_eq!(
        browser.js(&format!("return {TEXT};")).await,
        json!("Wave with the left arm.")
    );
    assert_eq!(
        browser
            .js("return document.querySelectorAll('dialog').length;")
            .await,
        json!(0)
    );
    browser.press(&[keys::ESCAPE]).await;
    browser
        .until(
            "the login box is over the page",
            "document.querySelector('dialog.login[open]')",
        )
        .await;
    // Keys that were meant for the page are no part of the token.
    browser.type_text("15sb").await;
    browser
        .until(
            "the box takes the token",
            "document.activeElement.id === 'token'",
        )
        .await;
    assert_eq!(
        browser
            .js("return document.querySelector('#token').value;")
            .await,
        json!("")
    );
    // The box can be left; the page offers to log in again.
    browser
        .js("document.querySelector('dialog.login [data-choice=Cancel]').click();")
        .await;
    browser
        .until(
            "the page says that the session has ended",
            "!document.querySelector('dialog.login') && document.querySelector('[data-region=session]:not([hidden]) button')",
        )
        .await;
    browser
        .js("document.querySelector('[data-region=session] button').click();")
        .await;
    browser
        .until(
            "the box takes the token",
            "document.activeElement.id === 'token'",
        )
        .await;
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
            "document.querySelector('.conflict .merge')",
        )
        .await;
    let shown = browser.text_of(".conflict .merge").await;
    assert!(
        shown.contains("From the first tab.") && shown.contains("From the second tab."),
        "{shown}"
    );
    enter_conflict(browser).await;
    browser.press(&["3"]).await;
    browser
        .until("the box is closed", "!document.querySelector('.conflict')")
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

#[tokio::test(flavor = "multi_thread")]
async fn a_duplicated_tab_is_a_tab_of_its_own() {
    const NAME: &str = "return sessionStorage.getItem('tab');";
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    browser.press(&["4", "t"]).await;
    browser.type_text("From the first tab.").await;
    browser.saved().await;
    let name = browser.js(NAME).await;
    // A page that opens another one gives it a copy of its storage, as duplicating a tab does.
    let first = browser.client().window().await.expect("a window");
    browser.js("window.open(location.href);").await;
    let windows = browser.client().windows().await.expect("windows");
    let second = windows.into_iter().find(|window| *window != first);
    browser
        .client()
        .switch_to_window(second.expect("a second window"))
        .await
        .expect("the other tab");
    assert_eq!(browser.task().await, task);
    let other = browser.js(NAME).await;
    assert!(other.is_string() && other != name, "{other} and {name}");
    browser.press(&["t"]).await;
    browser.type_text(" And the second.").await;
    browser.saved().await;
    assert!(mine(browser, task).await["rev"].as_i64() > Some(1));
    // The first one has not seen that: it is told, instead of writing over it.
    browser
        .client()
        .switch_to_window(first)
        .await
        .expect("the first tab");
    browser.press(&[keys::END]).await;
    browser.type_text(" More of the first.").await;
    browser
        .until(
            "both texts are shown",
            "document.querySelector('.conflict .merge')",
        )
        .await;
    // A reload keeps the name.
    browser.open(&desk.server.page("app/mask")).await;
    browser.task().await;
    assert_eq!(browser.js(NAME).await, name);
    desk.browser.quit().await;
}

/// Moves the focus into the box with two versions, once it listens.
async fn enter_conflict(browser: &annotate_browser::Browser) {
    browser
        .until(
            "the box listens",
            "document.querySelector('.conflict [aria-disabled=false]')",
        )
        .await;
    const REGIONS: usize = 6;
    for _ in 0..REGIONS {
        browser.press(&[keys::F6]).await;
        let inside = browser
            .js("return document.activeElement.closest('.conflict') !== null;")
            .await;
        if inside == json!(true) {
            return;
        }
    }
    panic!("F6 does not reach the box");
}

/// Writes a draft as another window of the same person does.
async fn write_elsewhere(browser: &annotate_browser::Browser, task: i64, text: &str) {
    let view = browser.request("GET", &format!("tasks/{task}"), None).await;
    let event = json!({
        "idem_key": format!("elsewhere-{task}"),
        "kind": "draft",
        "lease_epoch": view["body"]["lease"]["epoch"],
        "base_rev": view["body"]["mine"]["rev"],
        "answer": two_masks(text, "RIGHT_ARM"),
    });
    let reply = browser
        .request(
            "POST",
            &format!("tasks/{task}/events"),
            Some(json!({ "events": [event] })),
        )
        .await;
    assert_eq!(reply["body"]["results"][0]["status"], 200, "{reply}");
}

#[tokio::test(flavor = "multi_thread")]
async fn typing_goes_on_while_two_versions_meet() {
    const STATE: &str = "const field = document.querySelector('.mask-card.selected textarea'); \
        return { text: field.value, cards: document.querySelectorAll('.mask-card').length, \
        parts: [...document.querySelectorAll('.mask-card.selected .part[aria-pressed=\"true\"]')].map((e) => e.dataset.part), \
        here: document.activeElement === field, caret: field.selectionStart };";
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    browser.press(&["4", "t"]).await;
    browser.type_text("Wave").await;
    browser.saved().await;
    write_elsewhere(browser, task, "From another window.").await;
    browser.type_text(" with").await;
    browser
        .until(
            "the box opens in the middle of the sentence",
            "document.querySelector('.conflict')",
        )
        .await;
    // A space presses buttons, these letters and digits are commands of the stage, and 1, 2 and 3 of the box.
    let rest = " the left arm. 123 v h x u n";
    browser.type_text(rest).await;
    let text = format!("Wave with{rest}");
    let expected = json!({
        "text": text, "cards": 1, "parts": ["LEFT_ARM", "soft"], "here": true, "caret": text.len(),
    });
    assert_eq!(browser.js(STATE).await, expected);
    assert!(browser.text_of(".conflict").await.contains(&text));

    // The caret stands in the middle; the choice brings it back there.
    browser.press(&[keys::HOME, keys::RIGHT, keys::RIGHT]).await;
    enter_conflict(browser).await;
    browser.press(&["3"]).await;
    browser
        .until(
            "the text has the focus again",
            "document.activeElement === document.querySelector('.mask-card.selected textarea')",
        )
        .await;
    let merged = browser.js(STATE).await;
    assert_eq!(merged["caret"], 2);
    assert_eq!(merged["text"], text);
    assert_eq!(merged["cards"], 3);
    browser.saved().await;
    let revision = mine(browser, task).await;
    assert_eq!(revision["answer"]["masks"][0]["text"], text);
    assert_eq!(
        revision["answer"]["masks"][1]["text"],
        "From another window."
    );
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_closed_and_reopened_browser_is_no_other_window() {
    let mut desk = Desk::open("app/mask").await;
    let task = desk.browser.task().await;
    desk.browser.press(&["4", "t"]).await;
    desk.browser.type_text("Wave").await;
    desk.browser.saved().await;
    desk.server.down().await;
    desk.browser.type_text(" with the left arm.").await;
    desk.browser
        .until(
            "it waits",
            "document.querySelector('.chip').dataset.state === 'offline'",
        )
        .await;
    let client = desk.browser.client();
    let first = client.window().await.expect("a window");
    let second = client.new_window(true).await.expect("a tab").handle;
    client.switch_to_window(first).await.expect("the first tab");
    client.close_window().await.expect("the tab is closed");
    client.switch_to_window(second).await.expect("the new tab");
    desk.server.up().await;
    let browser = &desk.browser;
    browser.open(&desk.server.page("app/mask")).await;
    assert_eq!(browser.task().await, task);
    let opened = browser.js(&format!("return {TEXT};")).await;
    assert_eq!(opened, json!("Wave with the left arm."));
    browser.press(&["t", keys::END]).await;
    browser.type_text(" Slowly.").await;
    browser.saved().await;
    assert_eq!(
        browser
            .js("return document.querySelectorAll('.conflict').length;")
            .await,
        json!(0)
    );
    let revision = mine(browser, task).await;
    assert_eq!(
        revision["answer"]["masks"][0]["text"],
        "Wave with the left arm. Slowly."
    );
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_project_is_not_handed_the_texts_of_another_on_the_same_port() {
    let mut desk = Desk::open("app/mask").await;
    let task = desk.browser.task().await;
    let other = Dataset::fresh().await;
    let token = other.add_user("ann", "annotator").await;
    desk.server.down().await;
    desk.browser.press(&["4", "t"]).await;
    desk.browser.type_text("Of the first project.").await;
    desk.browser
        .until(
            "it waits",
            "document.querySelector('.chip').dataset.state === 'offline'",
        )
        .await;
    desk.browser.open("about:blank").await;
    desk.server.switch_to(&other).await;
    let browser = &desk.browser;
    browser.log_in(&desk.server, &token, "app/mask").await;
    let same = browser.task().await;
    assert_eq!(same, task, "tasks of both projects have the same numbers");
    let text = browser.js(&format!("return {TEXT};")).await;
    assert_eq!(text, json!(""), "the text belongs to the other project");
    browser.saved().await;
    assert_eq!(mine(browser, same).await, json!(null));

    desk.server.switch_to(&desk.dataset).await;
    let browser = &desk.browser;
    browser.open(&desk.server.page("app/home")).await;
    browser
        .until(
            "the session of the first project holds",
            "document.querySelector('.queue')",
        )
        .await;
    browser.saved().await;
    let revision = mine(browser, task).await;
    assert_eq!(
        revision["answer"]["masks"][0]["text"],
        "Of the first project."
    );
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_typed_in_the_last_moment_of_a_page_is_sent_by_the_next() {
    let mut desk = Desk::open("app/mask").await;
    let task = desk.browser.task().await;
    desk.browser.press(&["4", "t"]).await;
    desk.browser.saved().await;
    desk.server.down().await;
    desk.browser
        .js(
            "const box = document.querySelector('.mask-card.selected textarea'); \
             box.value = 'Typed and gone.'; \
             box.dispatchEvent(new Event('input', { bubbles: true }));",
        )
        .await;
    // Before the pause after which a draft is stored. Another process shows the blank page, and what the database of
    // this one has not finished is undone.
    desk.browser.open("about:blank").await;
    desk.server.up().await;
    let browser = &desk.browser;
    browser.open(&desk.server.page("app/home")).await;
    browser
        .until("home is shown", "document.querySelector('.queue')")
        .await;
    browser.saved().await;
    let revision = mine(browser, task).await;
    assert_eq!(revision["answer"]["masks"][0]["text"], "Typed and gone.");

    // The page that was left comes back with all it had in memory.
    for _ in 0..2 {
        browser.client().back().await.expect("the page before");
    }
    browser
        .until(
            "the task is shown",
            "document.querySelector('.mask-card textarea')",
        )
        .await;
    browser.saved().await;
    assert_eq!(
        browser.js(&format!("return {TEXT};")).await,
        json!("Typed and gone.")
    );
    assert_eq!(
        browser
            .js("return document.querySelector('button.stuck').hidden;")
            .await,
        json!(true)
    );
    assert_eq!(mine(browser, task).await["rev"], revision["rev"]);
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_earlier_version_left_unsent_is_listed_and_not_sent() {
    let desk = Desk::open("app/home").await;
    let browser = &desk.browser;
    browser
        .until("home is shown", "document.querySelector('.queue')")
        .await;
    let user = browser.request("GET", "me", None).await["body"]["user"]["id"].clone();
    let item = json!({
        "key": "left-behind", "order": 1, "user": user, "task": 1, "chain": "1:1:old", "sent": false, "problem": null,
        "event": { "idem_key": "left-behind", "kind": "draft", "lease_epoch": 1, "base_rev": 0,
                   "answer": two_masks("Of an earlier version.", "LEFT_ARM") },
    });
    // The database of earlier versions, which all projects of a host shared.
    browser
        .js_async(&format!(
            "{{ const open = indexedDB.open('annotate', 1); \
               open.onupgradeneeded = () => {{ open.result.createObjectStore('outbox'); open.result.createObjectStore('chains'); }}; \
               await new Promise((done) => {{ open.onsuccess = done; }}); \
               const write = open.result.transaction('outbox', 'readwrite'); \
               write.objectStore('outbox').put({item}, 'left-behind'); \
               await new Promise((done) => {{ write.oncomplete = done; }}); open.result.close(); return null; }}"
        ))
        .await;
    browser.open(&desk.server.page("app/home")).await;
    browser
        .until(
            "it is listed",
            "document.querySelector('.stuck:not([hidden])')?.textContent === '1 not taken'",
        )
        .await;
    browser
        .js("document.querySelector('.stuck').click();")
        .await;
    browser
        .until(
            "its text can be read",
            "document.querySelector('dialog[open]')?.textContent.includes('Of an earlier version.')",
        )
        .await;
    let tasks = browser.request("GET", "home", None).await;
    assert_eq!(tasks["body"]["held"], json!([]), "nothing was sent");
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_servers_on_one_machine_keep_their_sessions() {
    let desk = Desk::open("app/home").await;
    let other = Dataset::fresh().await;
    let token = other.add_user("ann", "annotator").await;
    let second = Server::start(&other).await;
    let browser = &desk.browser;
    browser.log_in(&second, &token, "app/home").await;
    browser.open(&desk.server.page("app/home")).await;
    browser
        .until("home is shown", "document.querySelector('.queue')")
        .await;
    assert_eq!(browser.request("GET", "me", None).await["status"], 200);
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_works_over_plain_http_from_another_host() {
    let desk = Desk::open("app/home").await;
    let browser = &desk.browser;
    browser.open("about:blank").await;
    let address = desk
        .server
        .page_from_afar(&format!("#token={}", desk.token));
    browser.open(&address).await;
    browser
        .until("home is shown", "document.querySelector('.queue')")
        .await;
    let state = browser
        .js("return { secure: isSecureContext, address: location.href };")
        .await;
    assert_eq!(state["secure"], false);
    let shown = state["address"].as_str().expect("an address");
    assert!(!shown.contains(&desk.token), "{shown}");
    browser.open(&desk.server.page_from_afar("app/mask")).await;
    let task = browser.task().await;
    browser.press(&["4", "t"]).await;
    browser.type_text("From afar.").await;
    browser.saved().await;
    let revision = mine(browser, task).await;
    assert_eq!(revision["answer"]["masks"][0]["text"], "From afar.");
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
