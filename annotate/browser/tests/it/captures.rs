//! Captures: how a style is performed, and what is still to capture.

use serde_json::json;

use crate::steps::Desk;

#[test]
fn a_guideline_goes_from_the_admin_to_the_annotator_and_the_dashboard_shows_the_plan() {
    let desk = Desk::of(&["ann", "boss"]);
    desk.enter("boss", "app/admin");
    desk.shows(".style-row");
    desk.focus(".style-row textarea:last-child");
    desk.type_text("Bend the knees.");
    desk.press_button("body", "Save settings");
    desk.until_stored("the guideline is stored", "settings", |settings| {
        settings["styles"][0]["guideline"] == "Bend the knees."
    });

    // The plan has a pair of the dataset, and a motion that the dataset does not have.
    let view = desk.claim("ann", "style");
    let style = &view["task"]["style"];
    let motion = &view["task"]["motions"][0]["id"];
    let plan = json!({ "cells": [
        { "motion": motion, "style": style, "takes": 1 },
        { "motion": "not-yet", "style": style, "takes": 2 },
    ] });
    desk.ask("boss", "PUT", "captures", plan);
    desk.go("app/dashboard");
    desk.has("[data-figures=captures] .matrix tbody tr", 2);
    let words = ["1 of 3 takes are here", "no motion of this id"];
    desk.reads("[data-figures=captures]", &words);
    desk.is(
        "[...document.querySelectorAll('[data-figures=captures] .matrix td')].map((own) => own.querySelector('.full') !== null)",
        json!([true, false]),
    );
    desk.picture("captures");

    desk.enter("ann", "app/style");
    desk.task();
    // Choose the first style of the project.
    desk.press(&["c"]);
    desk.shows("[data-guideline]:not([open])");
    desk.click("[data-guideline] summary");
    desk.shows("[data-guideline][open]");
    assert_eq!(desk.text_of("[data-guideline] p"), "Bend the knees.");
    desk.picture("guideline");
}
