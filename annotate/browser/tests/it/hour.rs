//! The work of a small team: masks with ranges, an existing and a new style, pairs, and review by a second person on a
//! tablet. The export is imported into a new project, and equals the original row by row.

use std::collections::BTreeMap;

use annotate_browser::{Browser, Dataset, Server, keys};
use serde_json::{Value, json};

use crate::steps::Desk;

/// Number of tasks of each kind.
const TASKS: usize = 2;

/// Two masks; the range of the second starts at the first frame and is a little longer than the minimum.
fn mask(desk: &Desk) {
    desk.describe_two_masks();
    desk.press(&[keys::ESCAPE, keys::HOME, "["]);
    desk.shift(&[".", ".", "."]);
    desk.press(&[".", "]", "a"]);
    desk.until(
        "the range is said",
        "document.querySelector('.mask-card.selected .card-title [data-range]')?.textContent.startsWith('frames 1 to 32')",
    );
    desk.control(&[keys::ENTER]);
}

/// Keeps a style pair, with a typed style name.
fn style(desk: &Desk, name: &str) {
    desk.focus(".other-style");
    desk.type_text(name);
    let keep = [keys::ESCAPE, "o", "o", "o", "t"];
    desk.write(&keep, "Do it in that way.");
    desk.control(&[keys::ENTER]);
}

/// Opens a page, and does `count` of its tasks.
fn tasks(desk: &Desk, path: &str, count: usize, work: impl Fn(usize)) {
    desk.go(path);
    for number in 0..count {
        let task = desk.task();
        work(number);
        desk.leaves(task);
    }
}

/// Motions, style and answer of each accepted task.
fn accepted(browser: &Browser, token: &str) -> BTreeMap<String, Value> {
    let get = |path: &str| browser.request_as(token, "GET", path, None)["body"].take();
    let page = get("tasks?state=accepted&limit=100");
    let what = |row: &Value| {
        let file = get(&format!("tasks/{}/record", row["id"]));
        let fields = ["kind", "source_id", "target_id", "style"].map(|field| &row[field]);
        let key = row["key"].as_str().expect("a key").to_owned();
        (key, json!([fields, file["accepted"]]))
    };
    let rows = page["rows"].as_array().expect("rows");
    rows.iter().map(what).collect()
}

#[test]
fn an_hour_of_work_comes_back_row_by_row_in_a_fresh_project() {
    let desk = Desk::of(&["ann", "eve", "boss"]);
    desk.set(json!({ "overlap_percent": 0 }));
    desk.enter("ann", "app/mask");
    tasks(&desk, "app/mask", TASKS, |_| mask(&desk));
    desk.go("app/style");
    let view = desk.get(&format!("tasks/{}", desk.task()));
    let label = view["task"]["style"].as_str().expect("a label");
    let styles: [&str; TASKS] = [label, "limping"];
    tasks(&desk, "app/style", TASKS, |number| {
        style(&desk, styles[number])
    });
    tasks(&desk, "app/pair", TASKS, |_| desk.keep());

    desk.log_out();
    desk.enter("eve", "app/home");
    // Review by touch, on a tablet in portrait orientation.
    desk.resize(820, 1180);
    let accept = |_| desk.tap(".panel-foot button.primary");
    tasks(&desk, "app/review", 3 * TASKS, accept);
    let done = accepted(&desk, desk.token("eve"));
    assert_eq!(done.len(), 3 * TASKS, "{done:?}");
    let text = json!(done).to_string();
    for said in ["\"range\":[0,32]", "\"style\":\"limping\"", label] {
        assert!(text.contains(said), "{said}: {text}");
    }

    let folder = desk.dataset.path().join("annotate/answers");
    let folder = folder.to_str().expect("a path of text");
    let export = ["export", "--format", "parquet", "--to", folder];
    desk.dataset.annotate(&export);
    let fresh = Dataset::fresh();
    let boss = fresh.add_user("boss", "admin");
    fresh.annotate(&["import"]);
    fresh.annotate(&["import", folder]);
    let other = Server::start(&fresh);
    desk.open(&other.page(""));
    assert_eq!(accepted(&desk, &boss), done);
}
