//! The first day of an annotator: practice, qualification, ten tasks, one that comes back, and "my answers".

use annotate_browser::{Browser, Dataset, Graphics, Server, keys};
use serde_json::{Value, json};

use crate::steps::{claim, nothing_by_chance, submit};

/// Sends a request as somebody and returns the body of the reply.
async fn ask(browser: &Browser, token: &str, method: &str, path: &str, body: Value) -> Value {
    let body = (!body.is_null()).then_some(body);
    let reply = browser.request_as(token, method, path, body).await;
    assert_eq!(reply["status"], 200, "{method} {path}: {reply}");
    reply["body"].clone()
}

fn known(verdict: &str) -> Value {
    let kept = verdict == "keep";
    json!({
        "kind": "pair",
        "verdict": verdict,
        "parts": if kept { json!(["LEFT_ARM"]) } else { json!([]) },
        "edit_type": if kept { json!("amplitude") } else { Value::Null },
        "text": if kept { "raise the left arm higher" } else { "" },
    })
}

/// Decides about the next task that waits for review, and returns its id.
async fn review(browser: &Browser, token: &str, decision: &str, comment: &str) -> i64 {
    let next = json!({ "queue": "sample", "kind": "pair" });
    let next = ask(browser, token, "POST", "review/next", next).await;
    let review = &next["review"];
    let task = review["task"]["id"].as_i64().expect("a task to review");
    let decided = json!({
        "idem_key": format!("{decision}-{task}-key"),
        "task": task,
        "lease_epoch": review["lease"]["epoch"],
        "decision": decision,
        "author": review["candidates"][0]["revision"]["author"],
        "comment": comment,
    });
    ask(browser, token, "POST", "reviews", decided).await;
    task
}

struct Project {
    _dataset: Dataset,
    server: Server,
    browser: Browser,
    ann: String,
    rev: String,
    /// The practice task whose known answer rejects the pair; that of the other one keeps it.
    rejected: i64,
}

/// A project with two practice tasks of pairs, and an annotator who never saw it.
async fn project() -> Project {
    let dataset = Dataset::fresh().await;
    let ann = dataset.add_user("ann", "annotator").await;
    let bob = dataset.add_user("bob", "annotator").await;
    let rev = dataset.add_user("rev", "reviewer").await;
    let boss = dataset.add_user("boss", "admin").await;
    let server = Server::start(&dataset).await;
    let browser = Browser::start(Graphics::Software).await;
    browser.open(&server.page("")).await;
    nothing_by_chance(&browser, &boss).await;
    let settings = |change: Value| {
        let (browser, boss) = (&browser, &boss);
        async move {
            let mut settings = ask(browser, boss, "GET", "settings", Value::Null).await;
            for (name, value) in change.as_object().expect("fields") {
                settings[name] = value.clone();
            }
            ask(browser, boss, "PUT", "settings", settings).await;
        }
    };
    settings(json!({ "overlap_percent": 0 })).await;
    let mut copies = Vec::new();
    for verdict in ["unclear", "keep"] {
        let view = claim(&browser, &bob, "pair").await;
        submit(&browser, &bob, &view, known(verdict)).await;
        let task = review(&browser, &rev, "accept", "").await;
        assert_eq!(view["task"]["id"], task);
        let path = format!("tasks/{task}/practice");
        let copy = ask(&browser, &boss, "POST", &path, Value::Null).await;
        copies.push(copy["id"].as_i64().expect("a task"));
    }
    // The rest of Bob's bundle is free for others.
    let leases = ask(&browser, &boss, "GET", "leases", Value::Null).await;
    for held in leases.as_array().expect("leases") {
        let path = format!("leases/{}", held["lease"]["id"]);
        let reply = browser.request_as(&boss, "DELETE", &path, None).await;
        assert_eq!(reply["status"], 204, "{reply}");
    }
    settings(json!({ "practice_tasks": 2, "practice_percent": 80 })).await;
    Project {
        _dataset: dataset,
        server,
        browser,
        ann,
        rev,
        rejected: copies[0],
    }
}

/// Waits for the feedback on a practice task and returns what it says.
async fn feedback(browser: &Browser, task: i64) -> String {
    browser
        .until(
            "the feedback",
            &format!("document.querySelector('.work.feedback')?.dataset.task === '{task}'"),
        )
        .await;
    browser.text_of(".panel-scroll").await
}

/// Writes an instruction for the pair on the page, and hands it in.
async fn keep(browser: &Browser) {
    browser.press(&["4", "e", "t"]).await;
    browser.type_text("raise the left arm higher").await;
    browser.control(&[keys::ENTER]).await;
}

/// Does the practice task on the page as the known answer has it.
async fn do_right(project: &Project, task: i64) {
    if task == project.rejected {
        project.browser.press(&["u"]).await;
    } else {
        keep(&project.browser).await;
    }
}

/// Waits until the list of my answers shows one in a state.
async fn standing(browser: &Browser, task: i64, words: &str) {
    browser
        .until(
            words,
            &format!(
                "document.querySelector('.shelf-item[data-task=\"{task}\"] .standing')?.textContent === '{words}'"
            ),
        )
        .await;
}

/// Opens "my answers" by its key.
async fn my_answers(browser: &Browser) {
    browser
        .js("document.querySelector('#main')?.firstElementChild?.setAttribute('data-left', '');")
        .await;
    browser.shift(&["m"]).await;
    browser
        .until(
            "my answers",
            "document.querySelector('.work.mine:not([data-left])') && document.querySelector('.work.mine .stage canvas')",
        )
        .await;
}

async fn practises(project: &Project) {
    let browser = &project.browser;
    browser
        .log_in(&project.server, &project.ann, "app/home")
        .await;
    browser
        .until(
            "the home page",
            "document.querySelector('.queue[data-kind=pair] .practice-note')",
        )
        .await;
    let card = browser.text_of(".queue[data-kind=pair]").await;
    assert!(card.contains("Practice first: 2 tasks"), "{card}");
    browser.picture("home-practice").await;
    browser.tab_to("Practise: Fine-grained pairs").await;
    browser.press(&[keys::ENTER]).await;
    browser
        .until(
            "what practice is",
            "document.activeElement.textContent === 'Begin'",
        )
        .await;
    let page = browser.text_of(".page.practice").await;
    assert!(page.contains("80 %") && page.contains("2 tasks"), "{page}");
    browser.picture("practice").await;
    browser.press(&[keys::ENTER]).await;
    let first = browser.task().await;
    let note = browser.text_of(".practice-note").await;
    assert!(note.contains("task 1 of 2"), "{note}");

    // A wrong answer is told from the known one, in words and marks.
    browser.press(&["i"]).await;
    let said = feedback(browser, first).await;
    assert!(said.contains("0 % right"), "{said}");
    assert!(said.contains("Different: verdict."), "{said}");
    let marks = browser.text_of(".compared.differs").await;
    assert!(
        marks.contains("✗ differs") && marks.contains("identical"),
        "{marks}"
    );
    browser.press(&["s"]).await;
    browser
        .until(
            "her parts are shown",
            "document.querySelector('[data-shown=yours]').getAttribute('aria-pressed') === 'true'",
        )
        .await;
    browser.picture("feedback").await;
    // It is still there after a reload, and she tries again.
    browser
        .open(&project.server.page(&format!("app/feedback/{first}")))
        .await;
    feedback(browser, first).await;
    browser.press(&["a"]).await;
    browser
        .until(
            "the task again",
            "document.querySelector('.work.pair[data-task]') && document.querySelector('.stage canvas')",
        )
        .await;
    assert_eq!(browser.task().await, first);
    do_right(project, first).await;
    let said = feedback(browser, first).await;
    assert!(said.contains("100 % right"), "{said}");
    assert!(said.contains("1 of 2 practice tasks done"), "{said}");

    browser.press(&[keys::ENTER]).await;
    browser
        .until(
            "the second practice task",
            "document.querySelector('.work.pair .practice-note')",
        )
        .await;
    let second = browser.task().await;
    assert_ne!(second, first);
    do_right(project, second).await;
    let said = feedback(browser, second).await;
    assert!(said.contains("real work is open"), "{said}");
    assert_eq!(
        browser
            .js("return document.querySelector('.practice-note').dataset.standing;")
            .await,
        json!("passed")
    );
    browser.picture("qualified").await;
    browser.press(&[keys::ENTER]).await;
    browser
        .until(
            "real work",
            "document.querySelector('.work.pair[data-task]') && !document.querySelector('.practice-note')",
        )
        .await;
}

/// Hands in ten pairs by keyboard, one of them with the guide open.
async fn ten_tasks(browser: &Browser) -> Vec<i64> {
    let mut done = Vec::new();
    let mut task = browser.task().await;
    while done.len() < 10 {
        match done.len() {
            3 => {
                browser.press(&["4", "e", "t"]).await;
                browser.type_text("raise the ").await;
                browser.press(&[keys::F4]).await;
                browser
                    .until(
                        "the guide beside the text",
                        "document.querySelector('.guide-beside p') && document.activeElement.matches('textarea')",
                    )
                    .await;
                browser.type_text("left arm").await;
                browser
                    .until(
                        "the text goes on",
                        "document.querySelector('.pair-editor textarea').value === 'raise the left arm'",
                    )
                    .await;
                browser.picture("guide-beside").await;
                browser.control(&[keys::ENTER]).await;
            }
            4 => {
                browser
                    .until(
                        "the guide stays open",
                        "document.querySelector('.guide-beside')",
                    )
                    .await;
                browser.press(&[keys::F4]).await;
                browser
                    .until(
                        "the guide is closed",
                        "!document.querySelector('.guide-beside')",
                    )
                    .await;
                keep(browser).await;
            }
            number => browser.press(&[["x", "u", "i"][number % 3]]).await,
        }
        done.push(task);
        task = browser.next_task(task).await;
        assert!(!done.contains(&task), "task {task} comes twice");
    }
    done
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_annotator_practises_works_fixes_what_came_back_and_finds_her_answers() {
    let project = project().await;
    let browser = &project.browser;
    practises(&project).await;
    let done = ten_tasks(browser).await;
    let returned = review(browser, &project.rev, "return", "look at the hips").await;
    let accepted = review(browser, &project.rev, "accept", "").await;
    assert!(done.contains(&returned) && done.contains(&accepted));

    my_answers(browser).await;
    standing(browser, returned, "returned to you").await;
    standing(browser, accepted, "accepted by a reviewer").await;
    browser.picture("my-answers").await;
    let fields = browser
        .js("return document.querySelectorAll('.work.mine textarea, .work.mine [data-part]').length;")
        .await;
    assert_eq!(fields, json!(0), "answers are read here, not edited");
    // Only what came back.
    browser
        .js("document.querySelector('.work.mine select').focus();")
        .await;
    browser.press(&["r"]).await;
    browser
        .until(
            "one answer",
            "document.querySelectorAll('.shelf-item').length === 1 && document.querySelector('.answer-details .returned-note')",
        )
        .await;
    let note = browser.text_of(".answer-details .returned-note").await;
    assert!(note.contains("look at the hips"), "{note}");
    browser.tab_to("Fix it").await;
    browser.press(&[keys::ENTER]).await;
    browser
        .until(
            "the returned task",
            &format!("document.querySelector('.work.pair')?.dataset.task === '{returned}'"),
        )
        .await;
    let note = browser.text_of(".returned-note").await;
    assert_eq!(note, "Came back: look at the hips");
    browser.press(&["u"]).await;
    browser.next_task(returned).await;
    my_answers(browser).await;
    standing(browser, returned, "waits for a reviewer").await;

    // Until somebody reviews it, it can be taken back.
    browser
        .until(
            "it is chosen, as the newest",
            &format!(
                "document.querySelector('.shelf-item[aria-pressed=true]')?.dataset.task === '{returned}'"
            ),
        )
        .await;
    browser.tab_to("Take back and change").await;
    browser.press(&[keys::ENTER]).await;
    browser
        .until(
            "it is in work again",
            &format!("document.querySelector('.work.pair')?.dataset.task === '{returned}'"),
        )
        .await;
    let view = browser
        .request("GET", &format!("tasks/{returned}"), None)
        .await;
    assert!(view["body"]["lease"].is_object(), "{view}");

    // Practice is among the answers, with the known answer, and is no work.
    my_answers(browser).await;
    let practice = browser
        .js("return Number(document.querySelector('.shelf-item[data-standing=practice]').dataset.task);")
        .await;
    let practice = practice.as_i64().expect("a task");
    standing(browser, practice, "practice, 100 % right").await;
    // Nine answers are handed in; the tenth is in work again, with the rest of a bundle.
    let home = browser.request("GET", "home", None).await;
    assert_eq!(home["body"]["today"], 9, "{home}");
    let pairs = &home["body"]["queues"][1];
    let held = pairs["held"].as_i64().expect("a number");
    assert_eq!(pairs["kind"], "pair");
    assert_eq!(pairs["mine"], 9 + held, "{home}");
    project.browser.quit().await;
}
