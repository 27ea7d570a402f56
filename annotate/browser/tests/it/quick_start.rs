//! The quick start of `docs/annotators.md`: one task of each kind is annotated, reviewed and exported, from login to
//! the tables, without a mouse.

use annotate_browser::keys;

use crate::steps::Desk;

/// Logs a person in by typing their token into the login page.
fn log_in(desk: &Desk, name: &str) {
    desk.focuses("#token");
    desk.type_text(desk.token(name));
    desk.press(&[keys::ENTER]);
    desk.shows("header.top:not([hidden])");
    desk.shows(".page.home");
}

/// Opens a page by its link in the navigation. On task screens Tab moves between cards, and F6 between regions.
fn follow(desk: &Desk, label: &str) {
    // F6 does nothing on a page without regions. Tab then finds the link from anywhere.
    desk.reaches("header");
    desk.tab_to(label);
    desk.mark();
    desk.press(&[keys::ENTER]);
    desk.lacks("[data-left]");
}

/// Opens a page, waits for an element on it, and takes a picture with this name.
fn visit(desk: &Desk, label: &str, shown: &str, picture: &str) {
    follow(desk, label);
    desk.shows(shown);
    desk.picture(picture);
}

/// Submits answers to the tasks of a page, until a task needs no second answer.
fn answer(desk: &Desk, label: &str, picture: &str, write: impl Fn()) -> i64 {
    follow(desk, label);
    loop {
        let task = desk.task();
        write();
        desk.saved();
        desk.picture(picture);
        let path = format!("tasks/{task}");
        let view = desk.get(&path);
        desk.control(&[keys::ENTER]);
        desk.leaves(task);
        let after = desk.get(&path);
        assert_eq!(after["mine"]["state"], "submitted", "{after}");
        if view["task"]["wanted"] == 1 {
            return task;
        }
    }
}

#[test]
fn one_clip_of_each_kind_goes_from_the_token_to_the_tables_by_keys_alone() {
    let mut desk = Desk::of(&["ann", "eve", "boss"]);
    desk.picture("login");

    log_in(&desk, "ann");
    desk.picture("home");
    let mask = answer(&desk, "Masks", "masks", || desk.describe_two_masks());
    desk.press(&["?"]);
    desk.shows("dialog[open]");
    desk.picture("keys");
    desk.press(&[keys::ESCAPE]);
    let kept = || desk.write(&["4", "e", "t"], "Raise the left arm higher.");
    let pair = answer(&desk, "Pairs", "pairs", kept);
    let styled = || desk.write(&["c", "o", "o", "o", "t"], "Walk in a proud way.");
    let style = answer(&desk, "Styles", "styles", styled);
    visit(&desk, "Guide", ".guide", "guide");
    follow(&desk, "Log out");

    log_in(&desk, "eve");
    follow(&desk, "Review");
    let mut accepted = Vec::new();
    while accepted.len() < 3 {
        let task = desk.task();
        desk.picture(&format!("review-{}", accepted.len()));
        desk.press(&["a"]);
        desk.leaves(task);
        accepted.push(task);
    }
    accepted.sort_unstable();
    let mut wanted = [mask, pair, style];
    wanted.sort_unstable();
    assert_eq!(accepted, wanted);
    visit(&desk, "Examples", ".panel", "examples");
    visit(&desk, "Dashboard", ".dashboard table", "dashboard");
    follow(&desk, "Log out");
    log_in(&desk, "boss");
    visit(&desk, "Admin", ".numbers", "admin");
    desk.server.down();

    let counts = &desk.dataset.annotate(&["export"])["counts"];
    assert_eq!(counts["motions_described"], 1, "{counts}");
    assert_eq!(counts["pairs_judged"], 2, "{counts}");
}
