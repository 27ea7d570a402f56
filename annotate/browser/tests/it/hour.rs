//! The work of a small team, from the first mask to a fresh project: masks with ranges, a style of the dataset's own and one
//! that is new, pairs; a second person reviews on a tablet; export and import; equal, row by row.

use std::collections::BTreeMap;

use annotate_browser::{Browser, Dataset, Server, keys};
use serde_json::{Value, json};

use crate::steps::{Team, describe_two_masks};

/// Tasks of each kind that are done.
const TASKS: usize = 2;

/// Waits until the page shows another task, or that there is none.
async fn handed_in(browser: &Browser, task: i64) {
    let left = format!("document.querySelector('.work')?.dataset.task !== '{task}'");
    browser.until("it is handed in", &left).await;
}

/// Two masks; the second one holds from the first frame on for as many frames as a range must have, and more.
async fn mask(browser: &Browser) {
    let task = browser.task().await;
    describe_two_masks(browser).await;
    browser.press(&[keys::ESCAPE, keys::HOME, "["]).await;
    browser.shift(&[".", ".", "."]).await;
    browser.press(&[".", "]", "a"]).await;
    browser
        .until(
            "the range is said",
            "document.querySelector('.mask-card.selected .card-title [data-range]')?.textContent.startsWith('frames 1 to 32')",
        )
        .await;
    browser.control(&[keys::ENTER]).await;
    handed_in(browser, task).await;
}

/// A style pair is kept, in a style that is typed.
async fn style(browser: &Browser, name: &str) {
    let task = browser.task().await;
    browser
        .js("document.querySelector('.other-style').focus();")
        .await;
    browser.type_text(name).await;
    browser.press(&[keys::ESCAPE, "o", "o", "o", "t"]).await;
    browser.type_text("Do it in that way.").await;
    browser.control(&[keys::ENTER]).await;
    handed_in(browser, task).await;
}

/// A pair is kept.
async fn pair(browser: &Browser) {
    let task = browser.task().await;
    browser.press(&["4", "e", "t"]).await;
    browser.type_text("Raise the left arm higher.").await;
    browser.control(&[keys::ENTER]).await;
    handed_in(browser, task).await;
}

/// What was accepted: by task, its motions, style and answer.
async fn accepted(browser: &Browser, token: &str) -> BTreeMap<String, Value> {
    let list = "tasks?state=accepted&limit=100";
    let page = browser.request_as(token, "GET", list, None).await;
    let mut found = BTreeMap::new();
    for row in page["body"]["rows"].as_array().expect("rows") {
        let path = format!("tasks/{}/record", row["id"]);
        let file = browser.request_as(token, "GET", &path, None).await;
        let key = row["key"].as_str().expect("a key").to_owned();
        let what = json!([
            row["kind"],
            row["source_id"],
            row["target_id"],
            row["style"],
            file["body"]["accepted"]
        ]);
        found.insert(key, what);
    }
    found
}

/// A task that is still to be reviewed is accepted with a finger, on a tablet that is held upright.
async fn accept_by_touch(browser: &Browser) {
    let task = browser.task().await;
    browser.tap(".panel-foot button.primary").await;
    handed_in(browser, task).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_hour_of_work_comes_back_row_by_row_in_a_fresh_project() {
    let Team {
        dataset,
        server,
        browser,
        ann,
        eve,
        boss,
    } = Team::open().await;
    let mut settings = browser.request_as(&boss, "GET", "settings", None).await["body"].clone();
    settings["overlap_percent"] = json!(0);
    let saved = browser.request_as(&boss, "PUT", "settings", Some(settings));
    assert_eq!(saved.await["status"], 200);

    browser.log_in(&server, &ann, "app/mask").await;
    for _ in 0..TASKS {
        mask(&browser).await;
    }
    browser.open(&server.page("app/style")).await;
    let first = browser.task().await;
    let view = browser
        .request("GET", &format!("tasks/{first}"), None)
        .await;
    let label = view["body"]["task"]["style"].as_str().expect("a label");
    style(&browser, label).await;
    style(&browser, "limping").await;
    browser.open(&server.page("app/pair")).await;
    for _ in 0..TASKS {
        pair(&browser).await;
    }

    browser.request("DELETE", "session", None).await;
    browser.log_in(&server, &eve, "app/home").await;
    browser.resize(820, 1180).await;
    browser.open(&server.page("app/review")).await;
    for _ in 0..3 * TASKS {
        accept_by_touch(&browser).await;
    }
    let done = accepted(&browser, &eve).await;
    assert_eq!(done.len(), 3 * TASKS, "{done:?}");
    let text = json!(done).to_string();
    for said in ["\"range\":[0,32]", "\"style\":\"limping\"", label] {
        assert!(text.contains(said), "{said}: {text}");
    }

    let fresh = Dataset::fresh().await;
    let folder = dataset.path().join("annotate/answers");
    dataset
        .annotate(&["export", "--format", "parquet", "--to", arg(&folder)])
        .await;
    let boss = fresh.add_user("boss", "admin").await;
    fresh.annotate(&["import"]).await;
    fresh.annotate(&["import", arg(&folder)]).await;
    let other = Server::start(&fresh).await;
    browser.open(&other.page("")).await;
    let again = accepted(&browser, &boss).await;
    assert_eq!(again, done);
    browser.quit().await;
}

fn arg(path: &std::path::Path) -> &str {
    path.to_str().expect("a path of text")
}
