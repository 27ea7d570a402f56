//! The task browser, the record of a task, bulk actions, and rules.

use annotate_browser::{Dataset, Graphics, keys};
use serde_json::{Value, json};

use crate::steps::{Desk, two_masks};

impl Desk {
    /// A server, and a browser logged in as an admin.
    fn office(dataset: Dataset) -> Self {
        let people = ["ann", "boss"];
        let office = Self::with(dataset, Graphics::Software, None, &people);
        office.enter("boss", "app/home");
        office.set(json!({ "overlap_percent": 0 }));
        office
    }

    fn answer(&self, text: &str) -> i64 {
        let view = self.claim("ann", "mask_text");
        self.submit("ann", &view, two_masks(text, "LEFT_ARM"))
    }

    fn state(&self, task: i64) -> Value {
        self.get(&format!("tasks/{task}/record"))["row"]["state"].take()
    }

    /// The sequence number of the last entry of the log.
    fn last_entry(&self) -> Value {
        self.get("audit?limit=1")["entries"][0]["seq"].take()
    }

    fn ann(&self) -> String {
        let people = self.get("stats/people");
        let mut people = people.as_array().expect("people").iter();
        let ann = people.find(|person| person["user"]["name"] == "ann");
        ann.expect("ann")["user"]["id"].to_string()
    }

    fn listed(&self) {
        self.says(".count", "task");
    }

    /// Opens a page, and waits until its list is loaded.
    fn list(&self, query: &str) {
        self.go(&format!("app/tasks{query}"));
        self.listed();
    }

    /// Waits until the list shows this number of tasks.
    fn counts(&self, tasks: i64) {
        let words = match tasks {
            1 => "1 task".to_owned(),
            tasks => format!("{tasks} tasks"),
        };
        let shown =
            format!("document.querySelector('.count').textContent.split(';')[0] === '{words}'");
        self.until(&words, &shown);
    }

    /// Tasks of the rows that are in the DOM.
    fn rows(&self) -> Vec<i64> {
        let rows = self.value(
            "[...document.querySelectorAll('.list-row[data-task]')].map((row) => Number(row.dataset.task))",
        );
        serde_json::from_value(rows).expect("numbers")
    }

    /// Waits until the row of this task is chosen.
    fn chosen(&self, task: &Value) {
        self.shows(&format!(
            ".list-row[aria-selected=true][data-task=\"{task}\"]"
        ));
    }

    /// Sets a field of the form and sends its change event, as user input does.
    fn choose(&self, label: &str, value: &str) {
        let done = self.js_with(
            "const label = [...document.querySelectorAll('label')].find((own) => own.textContent.trim().startsWith(arguments[0])); \
             const input = label.control; input.value = arguments[1]; \
             input.dispatchEvent(new Event('change', { bubbles: true })); return input.value;",
            vec![json!(label), json!(value)],
        );
        assert_eq!(done, value, "{label}");
    }

    /// Presses buttons of the open dialog, or of the page if none is open, one after the other.
    fn push(&self, labels: &[&str]) {
        for label in labels {
            self.press_button("body", label);
        }
    }

    /// Waits until a dialog with this heading is open, and checks its text.
    fn dialog(&self, heading: &str, words: &[&str]) {
        let shown = format!(
            "document.querySelector('dialog[open] h2')?.textContent === {}",
            json!(heading)
        );
        self.until(heading, &shown);
        self.reads("dialog[open]", words);
    }

    /// Waits until the record shows this text.
    fn record_says(&self, words: &str) {
        let shown = format!(
            "document.querySelector('task-record')?.textContent.replace(/\\s+/g, ' ').includes({})",
            json!(words)
        );
        self.until(words, &shown);
    }
}

#[test]
fn a_filter_is_in_the_address_and_a_reload_or_a_link_shows_the_same() {
    let mut office = Desk::office(Dataset::fresh());
    let masked = office.answer("Wave like one behind a mask.");
    let other = office.answer("Wave with the left arm.");
    office.list("");
    let all = office.get("tasks?limit=1")["total"].as_i64();
    office.counts(all.expect("a number"));
    office.choose("Kind", "mask_text");
    office.choose("State", "submitted");
    office.counts(2);
    assert_eq!(office.rows(), [masked, other]);
    // Every stored answer has a field `masks`; the search covers only texts.
    office.choose("Words", "mask");
    office.counts(1);
    assert_eq!(office.rows(), [masked]);
    let query = "location.pathname + location.search";
    let address = "/app/tasks?q=mask&kind=mask_text&state=submitted";
    office.is(query, address);
    let form =
        "[...document.querySelectorAll('.filters input, .filters select')].map((own) => own.value)";
    let fields = office.value(form);
    office.reload();
    office.listed();
    assert_eq!(office.rows(), [masked]);
    office.is(form, fields);
    // Another person opens the link, and has to log in first.
    office.join("eve");
    office.log_out();
    office.go(address.trim_start_matches('/'));
    office.focuses("#token");
    office.type_text(office.token("eve"));
    office.press(&[keys::ENTER]);
    office.listed();
    assert_eq!(office.rows(), [masked]);
    office.is(query, address);
    // Names load after the list, and the chosen name stays chosen.
    office.list(&format!("?person={}", office.ann()));
    office.counts(2);
    office.until(
        "her name",
        "[...document.querySelectorAll('option')].some((own) => own.selected && own.textContent === 'ann')",
    );
    // Unreadable parts of a link are reported.
    office.list("?kind=mask_text&colour=red");
    office.reads(".tasks-main .list-trouble", &["colour=red"]);
}

#[test]
fn ten_thousand_tasks_are_a_few_rows_of_the_page_and_the_last_one_is_reached() {
    const MANY: i64 = 10_000;
    let office = Desk::office(Dataset::with_pairs(MANY));
    let backwards = office.get("tasks?reverse=1&limit=1");
    let total = backwards["total"].as_i64().expect("a number");
    assert!(total >= MANY, "{total}");
    office.list("");
    office.focuses("task-list");
    let most = office.count(".list-row");
    assert!((10..60).contains(&most), "{most} rows");
    office.press(&[keys::END]);
    office.chosen(&backwards["rows"][0]["id"]);
    let seen = office.js(
        "const row = document.querySelector('.list-row[aria-selected=true]').getBoundingClientRect(); \
             const list = document.querySelector('task-list'); const box = list.getBoundingClientRect(); \
             return { inside: row.top >= box.top && row.bottom <= box.bottom + 1, \
                 row: list.getAttribute('aria-activedescendant'), count: list.getAttribute('aria-rowcount') };",
    );
    let expected = json!({ "inside": true, "row": format!("list-row-{}", total - 1), "count": (total + 1).to_string() });
    assert_eq!(seen, expected);
    // Anywhere in the list only a few rows are drawn, and they match the scroll position.
    for share in [0.75, 0.5, 0.1] {
        let place = office.js_with(
            "const list = document.querySelector('task-list'); list.scrollTop = list.scrollHeight * arguments[0]; \
             list.dispatchEvent(new Event('scroll')); return list.scrollTop;",
            vec![json!(share)],
        );
        office.until(
            "the rows follow",
            "(() => { const box = document.querySelector('task-list').getBoundingClientRect(); \
                    const at = document.elementFromPoint(box.left + 40, box.top + box.height / 2); \
                    return at?.closest('.list-row[data-task]'); })()",
        );
        let rows = office.count(".list-row");
        assert!(rows <= most + 16, "{rows} rows at {place}");
    }
    office.press(&[keys::HOME, keys::DOWN, keys::DOWN, keys::UP, keys::ENTER]);
    office.shows("task-record");
    let second = &office.get("tasks?limit=2")["rows"][1]["id"];
    assert_eq!(*second, office.task());
    // Back in the list the same task is chosen.
    office.back();
    office.chosen(second);
}

#[test]
fn a_bulk_action_says_what_it_will_do_and_what_it_left_alone() {
    let mut office = Desk::office(Dataset::fresh());
    let tasks = [0, 1, 2].map(|number| office.answer(&format!("Wave {number} times.")));
    // One of the tasks is held by another reviewer.
    office.join("eve");
    let held = json!({ "queue": "sample", "task": tasks[0] });
    office.ask("eve", "POST", "review/next", held);
    office.list("?q=wave&kind=mask_text");
    let page = office.get("tasks?q=wave&kind=mask_text&limit=1");
    let total = page["total"].as_i64().expect("a number");
    office.counts(total);
    // Cancel changes nothing, neither before the count nor after it.
    office.push(&["Act on all of them…"]);
    let filter = ["words: “wave”", "kind: Masks and descriptions"];
    office.dialog("Act on all tasks of this filter", &filter);
    office.push(&["Cancel"]);
    let before = office.last_entry();
    office.push(&["Act on all of them…", "Count first"]);
    let all = format!("2 tasks of {total} will be accepted");
    let held = "1: somebody holds them";
    office.dialog("Accept 2 tasks?", &[&all, held]);
    if total > 3 {
        let others = format!("{}: their state does not allow it", total - 3);
        office.reads("dialog[open]", &[&others]);
    }
    office.push(&["Cancel"]);
    assert_eq!(office.last_entry(), before);
    office.push(&["Act on all of them…", "Count first", "Accept 2 tasks"]);
    office.dialog("2 tasks accepted", &[held]);
    office.push(&["Close"]);
    let states = tasks.map(|task| office.state(task));
    assert_eq!(states, ["in_review", "accepted", "accepted"]);
    // Reopening accepted tasks requires a comment, because their authors need one.
    office.list("?state=accepted&kind=mask_text");
    office.counts(2);
    office.push(&["Act on all of them…"]);
    office.choose("Action", "reopen");
    office.push(&["Count first"]);
    office.says("dialog[open] .trouble", "comment");
    office.choose("Comment", "Once more, please.");
    office.push(&["Count first", "Reopen 2 tasks"]);
    office.dialog("2 tasks reopened", &[]);
    office.push(&["Close"]);
    office.counts(0);
    assert_eq!(office.state(tasks[1]), "submitted");
}

#[test]
fn a_rule_is_added_applied_named_in_the_record_and_undone() {
    let mut office = Desk::office(Dataset::fresh());
    let task = office.answer("Wave with the left arm.");
    office.answer("Wave with both arms.");
    office.go("app/rules");
    office.push(&["Add a rule"]);
    office.dialog("A new rule", &[]);
    // If the server rejects the name, the form asks again and keeps its other fields.
    office.choose("Accepts", "sampled");
    office.choose("Name", "not a name");
    office.choose("Fewest answers", "1");
    office.choose("Left to reviewers", "0");
    office.push(&["Add, off at first"]);
    office.says("dialog[open] .trouble", "letters, digits and dashes");
    office.choose("Name", "all-of-them");
    office.push(&["Add, off at first"]);
    let row = "document.querySelector('[data-rule=all-of-them]')?.closest('tr')?.textContent ?? ''";
    let is = |state: &str| office.until(state, &format!("/{state}/.test({row})"));
    // The row reads: off, 0 tasks accepted, 2 would be accepted.
    is("off02");
    assert_eq!(office.state(task), "submitted");
    office.push(&["Turn on: all-of-them"]);
    is("on02");
    office.push(&["Apply to what waits…"]);
    office.dialog(
        "Apply the rules to 2 tasks that wait for review?",
        &["all-of-them: would accept 2"],
    );
    office.push(&["Apply"]);
    office.dialog("2 tasks accepted", &["all-of-them: accepted 2 tasks"]);
    office.push(&["Close"]);
    is("on20");
    office.js("document.querySelector('[data-rule=all-of-them]').closest('tr').querySelector('a').click();");
    office.listed();
    office.counts(2);
    assert_eq!(office.value("location.search"), "?rule=all-of-them");
    office.press(&[keys::ENTER]);
    office.record_says("accepted by rule all-of-them");
    office.record_says("rule all-of-them: accepted");
    office.go("app/rules");
    office.push(&["Undo…: all-of-them"]);
    office.dialog("Undo rule all-of-them?", &[]);
    office.push(&["Cancel"]);
    assert_eq!(office.state(task), "accepted");
    office.push(&["Undo…: all-of-them", "Take back 2 acceptances"]);
    is("off02");
    assert_eq!(office.state(task), "submitted");
    // A removed rule stays listed while tasks that it accepted are accepted. Reviewers see it, but cannot change it.
    office.push(&["Remove: all-of-them", "Remove"]);
    office.says(".dashboard", "There are no rules");
    office.join("eve");
    office.log_out();
    office.enter("eve", "app/rules");
    office.says(".dashboard", "There are no rules");
    assert_eq!(office.count("#main button"), 0);
}

#[test]
fn a_record_shows_the_story_of_a_task_and_acts_on_it() {
    let office = Desk::office(Dataset::fresh());
    let task = office.answer("Wave with the left arm.");
    office.go(&format!("app/task/{task}"));
    assert_eq!(office.task(), task);
    office.record_says("waits for review; 1 of 1 answer handed in");
    office.record_says("Wave with the left arm.");
    office.record_says("ann: handed in an answer");
    // The task is opened for review, decided, and shown again.
    office.push(&["Review"]);
    office.shows("review-panel");
    office.press(&["a"]);
    office.record_says("accepted by a reviewer");
    office.record_says("boss: accepted");
    office.push(&["Make gold"]);
    office.says(".toast", "gold");
    office.push(&["Reopen"]);
    office.comment("Too hasty.");
    office.record_says("took the decision back, “Too hasty.”");
    office.push(&["Drop"]);
    office.comment("No.");
    office.record_says("dropped; 1 of 1");
    // Assign another task to a person. The page shows the name and the end of the reservation. Then cancel it.
    let open = office.get("tasks?state=open&kind=mask_text&limit=1");
    let open = &open["rows"][0]["id"];
    office.go(&format!("app/task/{open}"));
    office.push(&["Assign"]);
    office.choose("Person", &office.ann());
    office.push(&["Assign"]);
    office.record_says("ann reserved: it was given to this person, ends on");
    office.push(&["Release the task of ann"]);
    office.record_says("open; 0 of 1 answer handed in");
    office.lacks(".holders");
    // Changes by another person appear without a reload.
    let view = office.claim("ann", "mask_text");
    assert_eq!(view["task"]["id"], *open);
    office.record_says("ann answers it, ends in");
}

#[test]
fn what_nobody_is_left_for_is_listed_with_the_reasons_and_ones_own_acceptance_is_marked() {
    let mut office = Desk::office(Dataset::fresh());
    let view = office.claim("ann", "mask_text");
    let reason = json!({ "reason": "cannot_tell" });
    let task = office.send("ann", &view, "skip", reason);
    office.list("");
    office.js("[...document.querySelectorAll('.tasks-bar a')].find((own) => own.textContent === 'Nobody is left').click();");
    office.until("the filter", "location.search === '?skipped=everybody'");
    office.listed();
    office.counts(1);
    assert_eq!(office.rows(), [task]);
    let why = "skipped by ann: The action cannot be recognised";
    office.reads(".list-row", &[why]);
    office.press(&[keys::ENTER]);
    office.record_says("ann: The action cannot be recognised");
    office.push(&["Drop"]);
    office.comment("Nobody can tell.");
    office.record_says("dropped");
    office.list("?skipped=everybody");
    office.counts(0);

    office.set(json!({ "solo": true }));
    office.join("solo");
    let view = office.claim("solo", "mask_text");
    let task = office.submit("solo", &view, two_masks("Wave.", "LEFT_ARM"));
    office.log_out();
    office.enter("solo", &format!("app/review/{task}"));
    assert_eq!(office.task(), task);
    office.press(&["a"]);
    office.record_says("accepted by its own author");
    office.list("?state=accepted");
    office.counts(1);
    office.reads(".list-row", &["by its own author"]);
}
