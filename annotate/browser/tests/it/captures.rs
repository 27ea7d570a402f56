//! Captures: how a style is performed, and what is still to capture.

use serde_json::json;

use crate::steps::{Team, claim};

#[tokio::test(flavor = "multi_thread")]
async fn a_guideline_goes_from_the_admin_to_the_annotator_and_the_dashboard_shows_the_plan() {
    let Team {
        dataset: _dataset,
        server,
        browser,
        ann,
        boss,
        ..
    } = Team::open().await;

    browser.log_in(&server, &boss, "app/admin").await;
    browser
        .until("the styles", "document.querySelector('.style-row')")
        .await;
    browser
        .js("document.querySelector('.style-row textarea:last-child').focus();")
        .await;
    browser.type_text("Bend the knees.").await;
    browser
        .js("[...document.querySelectorAll('button')].find((own) => own.textContent === 'Save settings').click();")
        .await;
    browser
        .until_stored("the guideline is stored", "settings", |settings| {
            settings["styles"][0]["guideline"] == "Bend the knees."
        })
        .await;

    // One pair of the dataset is planned, and a motion that it does not have.
    let view = claim(&browser, &ann, "style").await;
    let style = &view["task"]["style"];
    let motion = &view["task"]["motions"][0]["id"];
    let plan = json!({ "cells": [
        { "motion": motion, "style": style, "takes": 1 },
        { "motion": "not-yet", "style": style, "takes": 2 },
    ] });
    let planned = browser
        .request_as(&boss, "PUT", "captures", Some(plan))
        .await;
    assert_eq!(planned["status"], 200, "{planned}");
    browser.open(&server.page("app/dashboard")).await;
    browser
        .until(
            "the matrix",
            "document.querySelectorAll('[data-figures=captures] .matrix tbody tr').length === 2",
        )
        .await;
    let board = browser.text_of("[data-figures=captures]").await;
    assert!(board.contains("1 of 3 takes are here"), "{board}");
    assert!(board.contains("no motion of this id"), "{board}");
    let cells = browser
        .js("return [...document.querySelectorAll('[data-figures=captures] .matrix td')].map((own) => own.querySelector('.full') !== null);")
        .await;
    assert_eq!(cells, json!([true, false]), "{board}");
    browser.picture("captures").await;

    browser.log_in(&server, &ann, "app/style").await;
    browser.task().await;
    // The first style of the project.
    browser.press(&["c"]).await;
    browser
        .until(
            "its guideline, folded",
            "document.querySelector('[data-guideline]')?.open === false",
        )
        .await;
    browser
        .js("document.querySelector('[data-guideline] summary').click();")
        .await;
    browser
        .until(
            "it is open",
            "document.querySelector('[data-guideline]').open",
        )
        .await;
    let said = browser.text_of("[data-guideline] p").await;
    assert_eq!(said, "Bend the knees.");
    browser.picture("guideline").await;
    browser.quit().await;
}
