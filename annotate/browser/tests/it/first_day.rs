//! The first day of an annotator: practice, qualification, ten tasks, one of them returned, and "my answers".

use annotate_browser::keys;
use serde_json::{Value, json};

use crate::steps::{Desk, kept};

/// Has the reviewer decide about the next pair that waits for review, and returns it.
fn review(desk: &Desk, decision: &str, comment: &str) -> i64 {
    let request = json!({ "queue": "sample", "kind": "pair" });
    desk.decide(request, decision, comment)
}

/// A project with two practice tasks of pairs, which Ann has not done yet. Returns the practice task whose known answer
/// rejects the pair; the known answer of the other one keeps it.
fn project() -> (Desk, i64) {
    let desk = Desk::of(&["ann", "bob", "eve", "boss"]);
    desk.set(json!({ "overlap_percent": 0 }));
    let unclear = json!({ "kind": "pair", "verdict": "unclear" });
    let copies = [unclear, kept("Raise the left arm higher.")].map(|known| {
        let answered = desk.submit("bob", &desk.claim("bob", "pair"), known);
        let task = review(&desk, "accept", "");
        assert_eq!(answered, task);
        let path = format!("tasks/{task}/practice");
        let copy = desk.ask("boss", "POST", &path, Value::Null);
        copy["id"].as_i64().expect("a task")
    });
    // The rest of Bob's bundle is free for others.
    let leases = desk.ask("boss", "GET", "leases", Value::Null);
    for held in leases.as_array().expect("leases") {
        let path = format!("leases/{}", held["lease"]["id"]);
        let reply = desk.request_as(desk.token("boss"), "DELETE", &path, None);
        assert_eq!(reply["status"], 204, "{reply}");
    }
    desk.set(json!({ "practice_tasks": 2, "practice_percent": 80 }));
    (desk, copies[0])
}

/// Waits for the feedback on a practice task, and checks its text.
fn feedback(desk: &Desk, task: i64, words: &[&str]) {
    desk.shows(&format!(".work.feedback[data-task=\"{task}\"]"));
    desk.reads(".panel-scroll", words);
}

/// Waits until "my answers" shows this task with this state.
fn standing(desk: &Desk, task: i64, words: &str) {
    let shown = format!(
        "document.querySelector('.shelf-item[data-task=\"{task}\"] .standing')?.textContent === '{words}'"
    );
    desk.until(words, &shown);
}

/// Opens "my answers" by its key.
fn my_answers(desk: &Desk) {
    desk.mark();
    desk.shift(&["m"]);
    desk.shows(".work.mine:not([data-left])");
    desk.shows(".work.mine .stage canvas");
}

fn practises(desk: &Desk, rejected: i64) {
    // Answers the practice task on the page like its known answer.
    let do_right = |task: i64| {
        if task == rejected {
            desk.press(&["u"]);
        } else {
            desk.keep();
        }
    };
    desk.enter("ann", "app/home");
    desk.shows(".queue[data-kind=pair] .practice-note");
    desk.reads(".queue[data-kind=pair]", &["Practice first: 2 tasks"]);
    desk.picture("home-practice");
    desk.tab_to("Practise: Fine-grained pairs");
    desk.press(&[keys::ENTER]);
    desk.until(
        "what practice is",
        "document.activeElement.textContent === 'Begin'",
    );
    desk.reads(".page.practice", &["80 %", "2 tasks"]);
    desk.picture("practice");
    desk.press(&[keys::ENTER]);
    let first = desk.task();
    desk.reads(".practice-note", &["task 1 of 2"]);

    // The page shows how a wrong answer differs from the known one, in words and marks.
    desk.press(&["i"]);
    feedback(desk, first, &["0 % right", "Different: verdict."]);
    desk.reads(".compared.differs", &["✗ differs", "identical"]);
    desk.press(&["s"]);
    desk.shows("[data-shown=yours][aria-pressed=true]");
    desk.picture("feedback");
    // The feedback survives a reload, and she tries again.
    desk.go(&format!("app/feedback/{first}"));
    feedback(desk, first, &[]);
    desk.press(&["a"]);
    desk.shows(".work.pair[data-task]");
    assert_eq!(desk.task(), first);
    do_right(first);
    let words = ["100 % right", "1 of 2 practice tasks done"];
    feedback(desk, first, &words);

    desk.press(&[keys::ENTER]);
    desk.shows(".work.pair .practice-note");
    let second = desk.task();
    assert_ne!(second, first);
    do_right(second);
    feedback(desk, second, &["real work is open"]);
    desk.shows(".practice-note[data-standing=passed]");
    desk.picture("qualified");
    desk.press(&[keys::ENTER]);
    desk.shows(".work.pair[data-task]");
    desk.lacks(".practice-note");
}

/// Hands in ten pairs by keyboard.
fn ten_tasks(desk: &Desk) -> Vec<i64> {
    let mut done = Vec::new();
    let mut task = desk.task();
    while done.len() < 10 {
        match done.len() {
            3 | 4 => desk.keep(),
            number => desk.press(&[["x", "u", "i"][number % 3]]),
        }
        done.push(task);
        task = desk.next_task(task);
        assert!(!done.contains(&task), "task {task} comes twice");
    }
    done
}

#[test]
fn a_new_annotator_practises_works_fixes_what_came_back_and_finds_her_answers() {
    let (desk, rejected) = project();
    practises(&desk, rejected);
    let done = ten_tasks(&desk);
    let returned = review(&desk, "return", "look at the hips");
    let accepted = review(&desk, "accept", "");
    assert!(done.contains(&returned) && done.contains(&accepted));

    my_answers(&desk);
    standing(&desk, returned, "returned to you");
    standing(&desk, accepted, "accepted by a reviewer");
    desk.picture("my-answers");
    let fields = desk.count(".work.mine textarea, .work.mine [data-part]");
    assert_eq!(fields, 0, "answers are read here, not edited");
    // Show only returned answers.
    desk.focus(".work.mine select");
    desk.press(&["r"]);
    desk.has(".shelf-item", 1);
    desk.shows(".answer-details .returned-note");
    let note = ["look at the hips"];
    desk.reads(".answer-details .returned-note", &note);
    desk.tab_to("Fix it");
    desk.press(&[keys::ENTER]);
    let in_work = format!(".work.pair[data-task=\"{returned}\"]");
    desk.shows(&in_work);
    let note = desk.text_of(".returned-note");
    assert_eq!(note, "Came back: look at the hips");
    desk.press(&["u"]);
    desk.next_task(returned);
    my_answers(&desk);
    standing(&desk, returned, "waits for a reviewer");

    // The newest answer is selected. It can be withdrawn until somebody reviews it.
    let chosen = format!(".shelf-item[aria-pressed=true][data-task=\"{returned}\"]");
    desk.shows(&chosen);
    desk.tab_to("Take back and change");
    desk.press(&[keys::ENTER]);
    desk.shows(&in_work);
    let view = desk.get(&format!("tasks/{returned}"));
    assert!(view["lease"].is_object(), "{view}");

    // The list includes practice with its known answer. Practice does not count as work.
    my_answers(&desk);
    let practice = desk.value(
        "Number(document.querySelector('.shelf-item[data-standing=practice]').dataset.task)",
    );
    let practice = practice.as_i64().expect("a task");
    standing(&desk, practice, "practice, 100 % right");
    // Nine answers are submitted; the tenth is in progress again, with the rest of its bundle.
    let home = desk.get("home");
    assert_eq!(home["today"], 9, "{home}");
    let pairs = &home["queues"][1];
    let held = pairs["held"].as_i64().expect("a number");
    assert_eq!(pairs["kind"], "pair");
    assert_eq!(pairs["mine"], 9 + held, "{home}");
}
