//! Review: accept, return, merge; and texts that contain markup.

use annotate_browser::{Browser, Dataset, Graphics, Server, keys};
use serde_json::{Value, json};

use crate::steps::{claim, nothing_by_chance, submit, two_masks};

const HOSTILE: &str =
    "<img src=x onerror=\"window.canary=1\"><script>window.canary=1</script>\u{202e}desrever";

/// A server with an answer of ann's to a task, and a browser logged in as a reviewer.
struct Bench {
    server: Server,
    browser: Browser,
    ann: String,
    task: i64,
    /// Kept on disk while the server runs.
    _dataset: Dataset,
}

impl Bench {
    async fn with_answer(text: &str) -> Self {
        let dataset = Dataset::fresh().await;
        let ann = dataset.add_user("ann", "annotator").await;
        let boss = dataset.add_user("boss", "admin").await;
        let rev = dataset.add_user("rev", "reviewer").await;
        let server = Server::start(&dataset).await;
        let browser = Browser::start(Graphics::Software).await;
        browser.open(&server.page("")).await;
        nothing_by_chance(&browser, &boss).await;
        // Find the first task that needs only one answer before review.
        let view = loop {
            let view = claim(&browser, &ann, "mask_text").await;
            submit(&browser, &ann, &view, two_masks(text, "LEFT_ARM")).await;
            if view["task"]["wanted"] == 1 {
                break view;
            }
        };
        let task = view["task"]["id"].as_i64().expect("a task");
        browser.log_in(&server, &rev, "app/home").await;
        browser.open(&server.page("app/review")).await;
        Self {
            _dataset: dataset,
            server,
            browser,
            ann,
            task,
        }
    }

    /// The task as its author sees it.
    async fn view(&self) -> Value {
        let path = format!("tasks/{}", self.task);
        let view = self.browser.request_as(&self.ann, "GET", &path, None).await;
        assert_eq!(view["status"], 200, "{view}");
        view["body"].clone()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_is_accepted_with_one_key() {
    let bench = Bench::with_answer("Wave with the left arm.").await;
    let browser = &bench.browser;
    assert_eq!(browser.task().await, bench.task);
    browser.press(&["a"]).await;
    browser
        .until(
            "it is decided",
            "document.querySelector('.toast')?.textContent.includes('accepted')",
        )
        .await;
    assert_eq!(bench.view().await["mine"]["state"], "accepted");
    bench.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_goes_back_with_a_comment_to_its_author() {
    let bench = Bench::with_answer("Wave with the left arm.").await;
    let browser = &bench.browser;
    browser.task().await;
    browser.press(&["r"]).await;
    browser
        .until(
            "the comment is asked for",
            "document.querySelector('dialog[open] textarea')",
        )
        .await;
    browser.type_text("Which hand?").await;
    browser.control(&[keys::ENTER]).await;
    browser
        .until(
            "it is decided",
            "document.querySelector('.toast')?.textContent.includes('returned')",
        )
        .await;
    let view = bench.view().await;
    assert_eq!(view["mine"]["state"], "returned");
    assert_eq!(view["comment"], "Which hand?");
    // The author finds the returned task on her home page and corrects it.
    browser.request("DELETE", "session", None).await;
    browser.log_in(&bench.server, &bench.ann, "app/home").await;
    browser
        .until(
            "it is the first thing on her page",
            "document.activeElement.textContent.startsWith('Fix task')",
        )
        .await;
    browser.press(&[keys::ENTER]).await;
    assert_eq!(browser.task().await, bench.task);
    assert!(
        browser
            .text_of(".returned-note")
            .await
            .contains("Which hand?")
    );
    browser.press(&["t"]).await;
    browser.type_text(" Twice.").await;
    browser.control(&[keys::ENTER]).await;
    browser.next_task(bench.task).await;
    assert_eq!(bench.view().await["mine"]["state"], "submitted");
    bench.browser.quit().await;
}

/// Gives a review page a size in pixels, and checks that `stage` pixels of the stage and all decisions are on the screen
/// and nothing hangs over. Returns the height of the smallest button and the size of the smallest text.
async fn fits(bench: &Bench, [width, height]: [u32; 2], stage: f64) -> [f64; 2] {
    let browser = &bench.browser;
    browser.task().await;
    browser.resize(width, height).await;
    browser.photograph(&format!("review-{width}")).await;
    let page = browser
        .js(
            "const box = (selector) => document.querySelector(selector).getBoundingClientRect();
             const [stage, foot] = [box('.stage-area'), box('.panel-foot')];
             const buttons = [...document.querySelectorAll('.panel-foot button, .transport button')];
             const heights = buttons.map((own) => own.getBoundingClientRect().height).filter((own) => own > 0);
             return {
               width: innerWidth,
               over: document.documentElement.scrollWidth - innerWidth,
               stage: Math.min(stage.bottom, innerHeight) - Math.max(stage.top, 0),
               foot: innerHeight - foot.bottom,
               button: Math.min(...heights),
               text: Math.min(...[...document.querySelectorAll('.panel-scroll *')]
                 .filter((own) => own.childElementCount === 0 && own.textContent.trim() && own.tagName !== 'KBD')
                 .map((own) => parseFloat(getComputedStyle(own).fontSize))),
             };",
        )
        .await;
    let number = |name: &str| page[name].as_f64().expect("a number");
    assert_eq!(page["width"], width, "{page}");
    assert!(number("over") <= 0.0 && number("foot") >= 0.0, "{page}");
    assert!(number("stage") >= stage, "{page}");
    [number("button"), number("text")]
}

#[tokio::test(flavor = "multi_thread")]
async fn answers_are_reviewed_by_touch_on_a_tablet_held_upright() {
    let bench = Bench::with_answer("Wave with the left arm.").await;
    let browser = &bench.browser;
    let [button, _] = fits(&bench, [820, 1180], 300.0).await;
    assert!(button >= 40.0, "{button}");
    // It plays by itself: a finger stops it, and moves through the clip.
    let label = "document.querySelector('.transport .play').textContent";
    browser
        .until("it plays", &format!("{label}.includes('Pause')"))
        .await;
    browser.tap(".transport .play").await;
    browser
        .until("it stands", &format!("{label}.includes('Play')"))
        .await;
    browser.press(&[keys::HOME]).await;
    let begin = "document.querySelector('.scrub').value === '0'";
    browser.until("it is at its begin", begin).await;
    browser.tap(".scrub").await;
    let moved = "Number(document.querySelector('.scrub').value) > 5";
    browser.until("it is moved", moved).await;
    browser.tap(".panel-foot button:nth-child(2)").await;
    browser
        .until(
            "the comment is asked for",
            "document.querySelector('dialog[open] textarea')",
        )
        .await;
    browser.tap("dialog[open] textarea").await;
    browser.type_text("Which hand?").await;
    browser.tap("dialog[open] button.primary").await;
    browser
        .until(
            "it is decided",
            "document.querySelector('.toast')?.textContent.includes('returned')",
        )
        .await;
    assert_eq!(bench.view().await["comment"], "Which hand?");
    bench.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_is_read_and_accepted_on_a_telephone() {
    let bench = Bench::with_answer("Wave with the left arm.").await;
    let browser = &bench.browser;
    let [_, text] = fits(&bench, [390, 844], 200.0).await;
    assert!(text >= 12.0, "{text}");
    browser.tap(".panel-foot button.primary").await;
    browser
        .until(
            "it is decided",
            "document.querySelector('.toast')?.textContent.includes('accepted')",
        )
        .await;
    assert_eq!(bench.view().await["mine"]["state"], "accepted");
    bench.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_is_merged_and_edited() {
    let bench = Bench::with_answer("Wave with the left arm.").await;
    let browser = &bench.browser;
    browser.task().await;
    browser.press(&["m"]).await;
    browser
        .until(
            "the editor is open",
            "document.querySelector('.merge-box:not([hidden]) .mask-card')",
        )
        .await;
    browser.press(&["5"]).await;
    browser.control(&[keys::ENTER]).await;
    browser
        .until(
            "it is decided",
            "document.querySelector('.toast')?.textContent.includes('accepted')",
        )
        .await;
    let shelf = browser.request("GET", "shelf?limit=5", None).await;
    let parts = &shelf["body"]["items"][0]["answer"]["masks"][0]["parts"];
    assert_eq!(parts, &json!(["LEFT_ARM", "RIGHT_ARM"]));
    bench.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn hostile_text_stays_text_on_every_page() {
    let bench = Bench::with_answer(HOSTILE).await;
    let browser = &bench.browser;
    browser.task().await;
    assert!(browser.text_of(".candidates").await.contains(HOSTILE));
    browser.press(&["a"]).await;
    browser
        .until(
            "it is decided",
            "document.querySelector('.toast')?.textContent.includes('accepted')",
        )
        .await;
    let record = format!("app/task/{}", bench.task);
    for (page, shown) in [
        ("app/tasks", ".list-row[data-task]"),
        (record.as_str(), "task-record .candidate"),
        ("app/shelf", ".shelf-item"),
        ("app/dashboard", ".dashboard table"),
        ("app/home", ".queue"),
    ] {
        browser.open(&bench.server.page(page)).await;
        browser
            .until(page, &format!("document.querySelector('{shown}')"))
            .await;
        let found = browser
            .js("return { canary: window.canary ?? null, images: document.querySelectorAll('img').length, \
                 scripts: document.querySelectorAll('script:not([src])').length };")
            .await;
        assert_eq!(
            found,
            json!({ "canary": null, "images": 0, "scripts": 0 }),
            "{page}"
        );
    }
    browser.open(&bench.server.page("app/shelf")).await;
    browser
        .until("the shelf", "document.querySelector('.shelf-item')")
        .await;
    assert!(browser.text_of(".shelf-item").await.contains("<script>"));
    bench.browser.quit().await;
}
