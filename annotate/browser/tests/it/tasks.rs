//! The task browser, the record of a task, bulk actions, and rules.

use annotate_browser::{Browser, Dataset, Graphics, Server, keys};
use serde_json::{Value, json};

use crate::steps::{claim, nothing_by_chance, submit, two_masks};

/// A server, and a browser logged in as an admin.
struct Office {
    dataset: Dataset,
    server: Server,
    browser: Browser,
    ann: String,
}

impl Office {
    async fn open(dataset: Dataset) -> Self {
        let ann = dataset.add_user("ann", "annotator").await;
        let boss = dataset.add_user("boss", "admin").await;
        let server = Server::start(&dataset).await;
        let browser = Browser::start(Graphics::Software).await;
        browser.open(&server.page("")).await;
        nothing_by_chance(&browser, &boss).await;
        browser.log_in(&server, &boss, "app/home").await;
        let office = Self {
            dataset,
            server,
            browser,
            ann,
        };
        office.set(json!({ "overlap_percent": 0 })).await;
        office
    }

    /// Changes settings.
    async fn set(&self, change: Value) {
        let mut settings = self.get("settings").await;
        for (name, value) in change.as_object().expect("fields") {
            settings[name] = value.clone();
        }
        let saved = self
            .browser
            .request("PUT", "settings", Some(settings))
            .await;
        assert_eq!(saved["status"], 200, "{saved}");
    }

    async fn get(&self, path: &str) -> Value {
        let reply = self.browser.request("GET", path, None).await;
        assert_eq!(reply["status"], 200, "{path}: {reply}");
        reply["body"].clone()
    }

    /// Answers the next mask task as ann.
    async fn answer(&self, text: &str) -> i64 {
        let view = claim(&self.browser, &self.ann, "mask_text").await;
        submit(&self.browser, &self.ann, &view, two_masks(text, "LEFT_ARM")).await;
        view["task"]["id"].as_i64().expect("a task")
    }

    async fn state(&self, task: i64) -> Value {
        self.get(&format!("tasks/{task}/record")).await["row"]["state"].clone()
    }

    /// Opens a page, and waits until its list is loaded.
    async fn list(&self, query: &str) {
        let page = self.server.page(&format!("app/tasks{query}"));
        self.browser.open(&page).await;
        self.browser.until("a list", LISTED).await;
    }

    /// Waits until the list has as many tasks.
    async fn counts(&self, tasks: i64) {
        let words = if tasks == 1 {
            "1 task"
        } else {
            &format!("{tasks} tasks")
        };
        let shown =
            format!("document.querySelector('.count').textContent.split(';')[0] === '{words}'");
        self.browser.until(words, &shown).await;
    }

    /// Tasks of the rows that are elements of the page.
    async fn rows(&self) -> Vec<i64> {
        let rows = self
            .browser
            .js("return [...document.querySelectorAll('.list-row[data-task]')].map((row) => Number(row.dataset.task));")
            .await;
        let rows = rows.as_array().expect("numbers");
        rows.iter().filter_map(Value::as_i64).collect()
    }

    /// Sets a field of the form, as a person does: the element changes and says so.
    async fn choose(&self, label: &str, value: &str) {
        let done = self
            .browser
            .js_with(
                "const label = [...document.querySelectorAll('label')].find((own) => own.textContent.trim().startsWith(arguments[0])); \
                 const input = label.control; input.value = arguments[1]; \
                 input.dispatchEvent(new Event('change', { bubbles: true })); return input.value;",
                vec![json!(label), json!(value)],
            )
            .await;
        assert_eq!(done, json!(value), "{label}");
    }

    /// Presses a button of the page or of the open dialog.
    async fn press(&self, label: &str) {
        let find = "[...(document.querySelector('dialog[open]') ?? document).querySelectorAll('button:not([disabled])')] \
            .find((own) => (own.dataset.choice ?? own.getAttribute('aria-label') ?? own.textContent).trim() === arguments[0])";
        self.browser
            .until(
                label,
                &find.replace("arguments[0]", &json!(label).to_string()),
            )
            .await;
        self.browser
            .js_with(&format!("{find}.click();"), vec![json!(label)])
            .await;
    }

    /// The text of the open dialog, once its heading is this.
    async fn dialog(&self, heading: &str) -> String {
        let shown = format!(
            "document.querySelector('dialog[open] h2')?.textContent === {}",
            json!(heading)
        );
        self.browser.until(heading, &shown).await;
        self.browser.text_of("dialog[open]").await
    }

    /// Waits until the record says this.
    async fn record_says(&self, words: &str) {
        let shown = format!(
            "document.querySelector('task-record')?.textContent.replace(/\\s+/g, ' ').includes({})",
            json!(words)
        );
        self.browser.until(words, &shown).await;
    }
}

const LISTED: &str = "document.querySelector('.count')?.textContent.includes('task')";

#[tokio::test(flavor = "multi_thread")]
async fn a_filter_is_in_the_address_and_a_reload_or_a_link_shows_the_same() {
    let office = Office::open(Dataset::fresh().await).await;
    let browser = &office.browser;
    let masked = office.answer("Wave like one behind a mask.").await;
    let other = office.answer("Wave with the left arm.").await;
    office.list("").await;
    let all = office.get("tasks?limit=1").await["total"].as_i64();
    office.counts(all.expect("a number")).await;
    office.choose("Kind", "mask_text").await;
    office.choose("State", "submitted").await;
    office.counts(2).await;
    assert_eq!(office.rows().await, [masked, other]);
    // Every answer is stored with a field `masks`: a search finds texts alone.
    office.choose("Words", "mask").await;
    office.counts(1).await;
    assert_eq!(office.rows().await, [masked]);
    let query = "return location.pathname + location.search;";
    let address = browser.js(query).await;
    assert_eq!(
        address,
        json!("/app/tasks?q=mask&kind=mask_text&state=submitted")
    );
    let form = "return [...document.querySelectorAll('.filters input, .filters select')].map((own) => own.value);";
    let fields = browser.js(form).await;
    browser.client().refresh().await.expect("the page reloads");
    browser.until("a list", LISTED).await;
    assert_eq!(office.rows().await, [masked]);
    assert_eq!(browser.js(form).await, fields);
    // Another person opens the link, and has to log in first.
    let eve = office.dataset.add_user("eve", "reviewer").await;
    browser.request("DELETE", "session", None).await;
    let link = address
        .as_str()
        .expect("an address")
        .trim_start_matches('/');
    browser.open(&office.server.page(link)).await;
    browser
        .until("the login", "document.activeElement?.id === 'token'")
        .await;
    browser.type_text(&eve).await;
    browser.press(&[keys::ENTER]).await;
    browser.until("a list", LISTED).await;
    assert_eq!(office.rows().await, [masked]);
    assert_eq!(browser.js(query).await, address);
    // Names come later than the list, and what was chosen stays.
    let ann = office.get("stats/people").await;
    let ann = ann
        .as_array()
        .expect("people")
        .iter()
        .find(|person| person["user"]["name"] == "ann");
    let ann = ann.expect("ann")["user"]["id"].clone();
    office.list(&format!("?person={ann}")).await;
    office.counts(2).await;
    browser
        .until(
            "her name",
            "[...document.querySelectorAll('option')].some((own) => own.selected && own.textContent === 'ann')",
        )
        .await;
    // What the page cannot read in a link is said.
    office.list("?kind=mask_text&colour=red").await;
    assert!(
        browser
            .text_of(".tasks-main .list-trouble")
            .await
            .contains("colour=red")
    );
    office.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_thousand_tasks_are_a_few_rows_of_the_page_and_the_last_one_is_reached() {
    const MANY: i64 = 10_000;
    let office = Office::open(Dataset::with_pairs(MANY).await).await;
    let browser = &office.browser;
    let backwards = office.get("tasks?reverse=1&limit=1").await;
    let total = backwards["total"].as_i64().expect("a number");
    assert!(total >= MANY, "{total}");
    let last = backwards["rows"][0]["id"].as_i64().expect("a task");
    office.list("").await;
    browser
        .until(
            "the list has the focus",
            "document.activeElement.matches('task-list')",
        )
        .await;
    let drawn = "return document.querySelectorAll('.list-row').length;";
    let most = browser.js(drawn).await.as_i64().expect("a number");
    assert!((10..60).contains(&most), "{most} rows");
    browser.press(&[keys::END]).await;
    let shown = format!(
        "document.querySelector('.list-row[aria-selected=true]')?.dataset.task === '{last}'"
    );
    browser.until("the last task is chosen", &shown).await;
    let seen = browser
        .js("const row = document.querySelector('.list-row[aria-selected=true]').getBoundingClientRect(); \
             const list = document.querySelector('task-list'); const box = list.getBoundingClientRect(); \
             return { inside: row.top >= box.top && row.bottom <= box.bottom + 1, \
                 row: list.getAttribute('aria-activedescendant'), count: list.getAttribute('aria-rowcount') };")
        .await;
    let expected = json!({ "inside": true, "row": format!("list-row-{}", total - 1), "count": (total + 1).to_string() });
    assert_eq!(seen, expected);
    // Everywhere in the list there are few rows, and they are those of the place.
    for share in [0.75, 0.5, 0.1] {
        let place = browser
            .js_with(
                "const list = document.querySelector('task-list'); list.scrollTop = list.scrollHeight * arguments[0]; \
                 list.dispatchEvent(new Event('scroll')); return list.scrollTop;",
                vec![json!(share)],
            )
            .await;
        browser
            .until(
                "the rows follow",
                "(() => { const box = document.querySelector('task-list').getBoundingClientRect(); \
                    const at = document.elementFromPoint(box.left + 40, box.top + box.height / 2); \
                    return at?.closest('.list-row[data-task]'); })()",
            )
            .await;
        let rows = browser.js(drawn).await.as_i64().expect("a number");
        assert!(rows <= most + 16, "{rows} rows at {place}");
    }
    browser
        .press(&[keys::HOME, keys::DOWN, keys::DOWN, keys::UP, keys::ENTER])
        .await;
    browser
        .until("its record", "document.querySelector('task-record')")
        .await;
    let second = office.get("tasks?limit=2").await["rows"][1]["id"].clone();
    assert_eq!(json!(browser.task().await), second);
    // Back in the list the same task is chosen.
    browser.client().back().await.expect("the page before");
    let shown = format!(
        "document.querySelector('.list-row[aria-selected=true]')?.dataset.task === '{second}'"
    );
    browser.until("it is chosen", &shown).await;
    office.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bulk_action_says_what_it_will_do_and_what_it_left_alone() {
    let office = Office::open(Dataset::fresh().await).await;
    let browser = &office.browser;
    let mut tasks = Vec::new();
    for number in 0..3 {
        tasks.push(office.answer(&format!("Wave {number} times.")).await);
    }
    // One of the tasks is held by another reviewer.
    let eve = office.dataset.add_user("eve", "reviewer").await;
    let body = json!({ "queue": "sample", "task": tasks[0] });
    let held = browser
        .request_as(&eve, "POST", "review/next", Some(body))
        .await;
    assert_eq!(held["status"], 200, "{held}");
    office.list("?q=wave&kind=mask_text").await;
    let total = office.get("tasks?q=wave&kind=mask_text&limit=1").await["total"].clone();
    let total = total.as_i64().expect("a number");
    office.counts(total).await;
    // Cancel changes nothing, neither before the count nor after it.
    office.press("Act on all of them…").await;
    let said = office.dialog("Act on all tasks of this filter").await;
    assert!(
        said.contains("words: “wave”") && said.contains("kind: Masks and descriptions"),
        "{said}"
    );
    office.press("Cancel").await;
    let before = office.get("audit?limit=1").await["entries"][0]["seq"].clone();
    office.press("Act on all of them…").await;
    office.press("Count first").await;
    let said = office.dialog("Accept 2 tasks?").await;
    assert!(
        said.contains(&format!("2 tasks of {total} will be accepted")),
        "{said}"
    );
    assert!(
        said.contains(&format!("{}: their state does not allow it", total - 3)) || total == 3,
        "{said}"
    );
    assert!(said.contains("1: somebody holds them"), "{said}");
    office.press("Cancel").await;
    assert_eq!(
        office.get("audit?limit=1").await["entries"][0]["seq"],
        before
    );
    office.press("Act on all of them…").await;
    office.press("Count first").await;
    office.press("Accept 2 tasks").await;
    let said = office.dialog("2 tasks accepted").await;
    assert!(said.contains("1: somebody holds them"), "{said}");
    office.press("Close").await;
    assert_eq!(office.state(tasks[0]).await, "in_review");
    assert_eq!(office.state(tasks[1]).await, "accepted");
    assert_eq!(office.state(tasks[2]).await, "accepted");
    // A comment is asked for where the authors need one.
    office.list("?state=accepted&kind=mask_text").await;
    office.counts(2).await;
    office.press("Act on all of them…").await;
    office.choose("Action", "reopen").await;
    office.press("Count first").await;
    browser
        .until(
            "it is missing",
            "document.querySelector('dialog[open] .trouble')?.textContent.includes('comment')",
        )
        .await;
    office.choose("Comment", "Once more, please.").await;
    office.press("Count first").await;
    office.press("Reopen 2 tasks").await;
    office.dialog("2 tasks reopened").await;
    office.press("Close").await;
    office.counts(0).await;
    assert_eq!(office.state(tasks[1]).await, "submitted");
    office.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rule_is_added_applied_named_in_the_record_and_undone() {
    let office = Office::open(Dataset::fresh().await).await;
    let browser = &office.browser;
    let task = office.answer("Wave with the left arm.").await;
    office.answer("Wave with both arms.").await;
    browser.open(&office.server.page("app/rules")).await;
    office.press("Add a rule").await;
    office.dialog("A new rule").await;
    // A name that the server does not take is asked for again, and the rest stays.
    office.choose("Accepts", "sampled").await;
    office.choose("Name", "not a name").await;
    office.choose("Fewest answers", "1").await;
    office.choose("Left to reviewers", "0").await;
    office.press("Add, off at first").await;
    browser
        .until(
            "the name is refused",
            "document.querySelector('dialog[open] .trouble')?.textContent.includes('letters, digits and dashes')",
        )
        .await;
    office.choose("Name", "all-of-them").await;
    office.press("Add, off at first").await;
    let row = "document.querySelector('[data-rule=all-of-them]')?.closest('tr')?.textContent ?? ''";
    browser
        .until(
            "it is off, and would accept two",
            &format!("/off02/.test({row})"),
        )
        .await;
    assert_eq!(office.state(task).await, "submitted");
    office.press("Turn on: all-of-them").await;
    browser
        .until("it is on", &format!("/on02/.test({row})"))
        .await;
    office.press("Apply to what waits…").await;
    let said = office
        .dialog("Apply the rules to 2 tasks that wait for review?")
        .await;
    assert!(said.contains("all-of-them: would accept 2"), "{said}");
    office.press("Apply").await;
    let said = office.dialog("2 tasks accepted").await;
    assert!(said.contains("all-of-them: accepted 2 tasks"), "{said}");
    office.press("Close").await;
    browser
        .until("the count", &format!("/on20/.test({row})"))
        .await;
    browser
        .js("document.querySelector('[data-rule=all-of-them]').closest('tr').querySelector('a').click();")
        .await;
    browser.until("its tasks", LISTED).await;
    office.counts(2).await;
    assert_eq!(
        browser.js("return location.search;").await,
        "?rule=all-of-them"
    );
    browser.press(&[keys::ENTER]).await;
    office.record_says("accepted by rule all-of-them").await;
    office.record_says("rule all-of-them: accepted").await;
    browser.open(&office.server.page("app/rules")).await;
    office.press("Undo…: all-of-them").await;
    office.dialog("Undo rule all-of-them?").await;
    office.press("Cancel").await;
    assert_eq!(office.state(task).await, "accepted");
    office.press("Undo…: all-of-them").await;
    office.press("Take back 2 acceptances").await;
    browser
        .until("none stands", &format!("/off02/.test({row})"))
        .await;
    assert_eq!(office.state(task).await, "submitted");
    // A rule that was removed is listed while what it accepted stands: reviewers see it, and change nothing.
    office.press("Remove: all-of-them").await;
    office.press("Remove").await;
    browser
        .until(
            "it is gone",
            "document.querySelector('.dashboard').textContent.includes('There are no rules')",
        )
        .await;
    let eve = office.dataset.add_user("eve", "reviewer").await;
    browser.request("DELETE", "session", None).await;
    browser.log_in(&office.server, &eve, "app/rules").await;
    browser
        .until(
            "she sees them",
            "document.querySelector('.dashboard')?.textContent.includes('There are no rules')",
        )
        .await;
    let buttons = browser
        .js("return document.querySelectorAll('#main button').length;")
        .await;
    assert_eq!(buttons, json!(0));
    office.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_record_shows_the_story_of_a_task_and_acts_on_it() {
    let office = Office::open(Dataset::fresh().await).await;
    let browser = &office.browser;
    let task = office.answer("Wave with the left arm.").await;
    browser
        .open(&office.server.page(&format!("app/task/{task}")))
        .await;
    assert_eq!(browser.task().await, task);
    office
        .record_says("waits for review; 1 of 1 answer handed in")
        .await;
    office.record_says("Wave with the left arm.").await;
    office.record_says("ann: handed in an answer").await;
    // It is opened for review, decided, and shown again.
    office.press("Review").await;
    browser
        .until("the review", "document.querySelector('review-panel')")
        .await;
    browser.press(&["a"]).await;
    office.record_says("accepted by a reviewer").await;
    office.record_says("boss: accepted").await;
    office.press("Make gold").await;
    browser
        .until(
            "it is said",
            "document.querySelector('.toast')?.textContent.includes('gold')",
        )
        .await;
    office.press("Reopen").await;
    browser
        .until("why?", "document.querySelector('dialog[open] textarea')")
        .await;
    browser.type_text("Too hasty.").await;
    browser.control(&[keys::ENTER]).await;
    office
        .record_says("took the decision back, “Too hasty.”")
        .await;
    office.press("Drop").await;
    browser
        .until("why?", "document.querySelector('dialog[open] textarea')")
        .await;
    browser.type_text("No.").await;
    browser.control(&[keys::ENTER]).await;
    office.record_says("dropped; 1 of 1").await;
    // Another task is given to a person, who is named with the end of the reservation, and taken back.
    let open = office.get("tasks?state=open&kind=mask_text&limit=1").await["rows"][0]["id"].clone();
    browser
        .open(&office.server.page(&format!("app/task/{open}")))
        .await;
    office.press("Assign").await;
    let people = office.get("stats/people").await;
    let ann = people
        .as_array()
        .expect("people")
        .iter()
        .find(|person| person["user"]["name"] == "ann");
    let ann = ann.expect("ann")["user"]["id"].to_string();
    office.choose("Person", &ann).await;
    office.press("Assign").await;
    office
        .record_says("ann reserved: it was given to this person, ends on")
        .await;
    office.press("Release the task of ann").await;
    office.record_says("open; 0 of 1 answer handed in").await;
    browser
        .until("nobody holds it", "!document.querySelector('.holders')")
        .await;
    // What another person does meanwhile appears by itself.
    let view = claim(browser, &office.ann, "mask_text").await;
    assert_eq!(view["task"]["id"], open);
    office.record_says("ann answers it, ends in").await;
    office.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ones_own_acceptance_is_marked_in_browser_and_record() {
    let office = Office::open(Dataset::fresh().await).await;
    let browser = &office.browser;
    office.set(json!({ "solo": true })).await;
    let boss = office.dataset.add_user("solo", "admin").await;
    let view = claim(browser, &boss, "mask_text").await;
    submit(browser, &boss, &view, two_masks("Wave.", "LEFT_ARM")).await;
    let task = view["task"]["id"].as_i64().expect("a task");
    browser.request("DELETE", "session", None).await;
    browser
        .log_in(&office.server, &boss, &format!("app/review/{task}"))
        .await;
    assert_eq!(browser.task().await, task);
    browser.press(&["a"]).await;
    office.record_says("accepted by its own author").await;
    office.list("?state=accepted").await;
    office.counts(1).await;
    assert!(
        browser
            .text_of(".list-row")
            .await
            .contains("by its own author")
    );
    office.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_nobody_is_left_for_is_listed_with_the_reasons_and_dropped() {
    let office = Office::open(Dataset::fresh().await).await;
    let browser = &office.browser;
    let view = claim(browser, &office.ann, "mask_text").await;
    let task = view["task"]["id"].as_i64().expect("a task");
    let skip = json!({ "events": [{
        "idem_key": "skipped-by-ann", "kind": "skip", "lease_epoch": view["lease"]["epoch"], "reason": "cannot_tell",
    }] });
    let path = format!("tasks/{task}/events");
    let reply = browser
        .request_as(&office.ann, "POST", &path, Some(skip))
        .await;
    assert_eq!(reply["body"]["results"][0]["status"], 200, "{reply}");
    office.list("").await;
    browser
        .js("[...document.querySelectorAll('.tasks-bar a')].find((own) => own.textContent === 'Nobody is left').click();")
        .await;
    browser
        .until("the filter", "location.search === '?skipped=everybody'")
        .await;
    browser.until("a list", LISTED).await;
    office.counts(1).await;
    assert_eq!(office.rows().await, [task]);
    let row = browser.text_of(".list-row").await;
    assert!(
        row.contains("skipped by ann: The action cannot be recognised"),
        "{row}"
    );
    browser.press(&[keys::ENTER]).await;
    office
        .record_says("ann: The action cannot be recognised")
        .await;
    office.press("Drop").await;
    browser
        .until("why?", "document.querySelector('dialog[open] textarea')")
        .await;
    browser.type_text("Nobody can tell.").await;
    browser.control(&[keys::ENTER]).await;
    office.record_says("dropped").await;
    office.list("?skipped=everybody").await;
    office.counts(0).await;
    office.browser.quit().await;
}
