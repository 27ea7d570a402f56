//! Masks with ranges, an existing and a new style, and pairs, reviewed by a second person on a tablet. The export is
//! imported into a new project, and equals the original row by row.

use std::collections::BTreeMap;

use annotate_browser::{Browser, Dataset, Server};
use serde_json::{Value, json};

use crate::steps::{Desk, kept, two_masks};

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
fn work_that_is_reviewed_by_touch_comes_back_row_by_row_in_a_fresh_project() {
    let desk = Desk::of(&["ann", "eve", "boss"]);
    desk.set(json!({ "overlap_percent": 0 }));
    let mut ranged = two_masks("Wave with the left arm.", "LEFT_ARM");
    ranged["masks"][1]["range"] = json!([0, 32]);
    let styled = |name: &str| json!({ "kind": "style", "verdict": "keep", "style": name, "extent": "whole", "text": "Do it in that way." });
    let view = desk.claim("ann", "style");
    let label = view["task"]["style"].as_str().expect("a label");
    let answers = [
        two_masks("Wave.", "RIGHT_ARM"),
        ranged,
        styled(label),
        styled("limping"),
        kept("Raise the left arm."),
        kept("Lower the left arm."),
    ];
    for answer in &answers {
        let kind = answer["kind"].as_str().expect("a kind");
        desk.submit("ann", &desk.claim("ann", kind), answer.clone());
    }

    desk.enter("eve", "app/home");
    // Review by touch, on a tablet in portrait orientation.
    desk.resize(820, 1180);
    desk.go("app/review");
    for _ in &answers {
        let task = desk.task();
        desk.tap(".panel-foot button.primary");
        desk.leaves(task);
    }
    let done = accepted(&desk, desk.token("eve"));
    assert_eq!(done.len(), answers.len(), "{done:?}");
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
    let other = Server::start(&fresh, None);
    desk.open(&other.page(""));
    assert_eq!(accepted(&desk, &boss), done);
}
