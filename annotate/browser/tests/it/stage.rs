//! The stage, its clock and its renderers.

use std::time::{Duration, Instant};

use annotate_browser::{Graphics, keys};
use serde_json::json;

use crate::steps::Desk;

const FRAME: &str = "Number(document.querySelector('.stage').dataset.frame)";

/// Colours in a copy of the canvas that the body is drawn on.
const COLOURS: &str = "(() => { \
    const source = document.querySelector('.stage canvas'); \
    const copy = document.createElement('canvas'); \
    copy.width = 200; copy.height = 200; \
    const context = copy.getContext('2d'); \
    context.drawImage(source, 0, 0, 200, 200); \
    const data = context.getImageData(0, 0, 200, 200).data; \
    const seen = new Set(); \
    for (let i = 0; i < data.length; i += 4) seen.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]); \
    return seen.size; })()";

#[tokio::test(flavor = "multi_thread")]
async fn webgl_is_alive_and_draws() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    browser.task().await;
    assert_eq!(
        browser
            .js("return document.querySelector('.stage').dataset.renderer;")
            .await,
        json!("webgl2")
    );
    browser
        .until("the picture is not flat", &format!("{COLOURS} > 50"))
        .await;
    let lost = browser
        .js("return document.querySelector('.stage canvas').getContext('webgl2').isContextLost();")
        .await;
    assert_eq!(lost, json!(false));
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn without_webgl_the_same_body_is_drawn_in_2d() {
    let desk = Desk::open_with("app/mask", Graphics::None).await;
    let browser = &desk.browser;
    browser.task().await;
    assert_eq!(
        browser
            .js("return document.querySelector('.stage').dataset.renderer;")
            .await,
        json!("canvas2d")
    );
    browser
        .until("the picture is not flat", &format!("{COLOURS} > 20"))
        .await;
    browser.press(&[keys::HOME, "."]).await;
    browser
        .until("the clock works", &format!("{FRAME} === 1"))
        .await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_context_falls_back_without_losing_the_frame() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    browser.task().await;
    browser.press(&[keys::HOME, ".", "."]).await;
    browser
        .js("document.querySelector('.stage canvas').getContext('webgl2').getExtension('WEBGL_lose_context').loseContext();")
        .await;
    browser
        .until(
            "Canvas 2D takes over",
            "document.querySelector('.stage').dataset.renderer === 'canvas2d'",
        )
        .await;
    browser.until("it draws", &format!("{COLOURS} > 20")).await;
    assert_eq!(browser.js(&format!("return {FRAME};")).await, json!(2));
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn stepping_scrubbing_and_looping_are_exact() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    browser.task().await;
    browser.press(&[keys::HOME]).await;
    browser
        .until("the first frame", &format!("{FRAME} === 0"))
        .await;
    browser.press(&[".", ".", "."]).await;
    browser
        .until("three frames on", &format!("{FRAME} === 3"))
        .await;
    browser.press(&[","]).await;
    browser.until("one back", &format!("{FRAME} === 2")).await;
    browser.shift(&["."]).await;
    browser.until("ten on", &format!("{FRAME} === 12")).await;
    browser.press(&["["]).await;
    browser
        .press(&[keys::RIGHT, keys::RIGHT, keys::RIGHT, "]"])
        .await;
    browser
        .until(
            "the loop is set",
            "document.querySelector('.viewer').dataset.loop === '12-15'",
        )
        .await;
    // A few times round the loop; nothing outside of it is shown meanwhile.
    let seen = browser
        .js_async(
            "{ const stage = document.querySelector('.stage'); const seen = new Set(); \
               document.querySelector('.stage').focus(); \
               document.querySelector('.play').click(); \
               for (let i = 0; i < 60; i += 1) { \
                 await new Promise(requestAnimationFrame); seen.add(Number(stage.dataset.frame)); } \
               document.querySelector('.play').click(); \
               return [...seen].sort((a, b) => a - b); }",
        )
        .await;
    assert_eq!(seen, json!([12, 13, 14, 15]));
    // The slider is the same clock.
    browser
        .js("const range = document.querySelector('.scrub'); range.value = '7'; range.dispatchEvent(new Event('input'));")
        .await;
    browser.until("scrubbed", &format!("{FRAME} === 7")).await;
    browser.press(&["\\", "-"]).await;
    browser
        .until(
            "slower",
            "document.querySelector('.viewer').dataset.speed === '0.75'",
        )
        .await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn cameras_are_fixed_and_follow() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    browser.task().await;
    for (key, name) in [(keys::F1, "front"), (keys::F2, "side"), (keys::F3, "top")] {
        browser.press(&[key]).await;
        browser
            .until(
                "the camera is fixed",
                &format!("document.querySelector('.stage').dataset.camera === '{name}'"),
            )
            .await;
    }
    let follows =
        "document.querySelector('.cameras button:last-child').getAttribute('aria-pressed')";
    assert_eq!(
        browser.js(&format!("return {follows};")).await,
        json!("true")
    );
    browser.press(&["f"]).await;
    browser
        .until("it stays", &format!("{follows} === 'false'"))
        .await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_stages_never_differ_in_frame() {
    let desk = Desk::open("app/pair").await;
    let browser = &desk.browser;
    browser.task().await;
    browser
        .until(
            "two stages are shown",
            "document.querySelectorAll('.stage:not([hidden])').length === 2",
        )
        .await;
    let watched = browser
        .js_async(
            "{ const stages = [...document.querySelectorAll('.stage')]; \
               let apart = 0; const seen = new Set(); \
               for (let i = 0; i < 300; i += 1) { \
                 await new Promise(requestAnimationFrame); \
                 if (stages[0].dataset.frame !== stages[1].dataset.frame) apart += 1; \
                 seen.add(stages[0].dataset.frame); } \
               return { apart, moved: seen.size > 3 }; }",
        )
        .await;
    assert_eq!(watched, json!({ "apart": 0, "moved": true }));
    desk.browser.quit().await;
}

/// Frames played between two measurements of the heap.
const SOAK_FRAMES: usize = 300;

/// Allowed growth of the heap, for code and caches of the browser. A leak of 64 bytes per frame would exceed it
/// twice within an hour.
const SOAK_SLACK_BYTES: u64 = 4 << 20;

/// Plays two bodies at double speed. A short version runs with the other tests; half an hour (one hour of motion) is
///
/// ```sh
/// ANNOTATE_SOAK=1800 bash annotate/browser/run playback
/// ```
#[tokio::test(flavor = "multi_thread")]
async fn playback_does_not_grow_the_heap() {
    let secs = std::env::var("ANNOTATE_SOAK").map_or(0, |secs| secs.parse().expect("seconds"));
    let desk = Desk::open("app/pair").await;
    let browser = &desk.browser;
    browser.task().await;
    browser.press(&["=", "=", "=", "=", "=", "=", "="]).await;
    browser
        .until(
            "double speed",
            "document.querySelector('.viewer').dataset.speed === '2'",
        )
        .await;
    let play = format!(
        "{{ const stage = document.querySelector('.stage'); const seen = new Set(); \
           for (let i = 0; i < {SOAK_FRAMES}; i += 1) {{ \
             await new Promise(requestAnimationFrame); seen.add(stage.dataset.frame); }} \
           return seen.size; }}"
    );
    let mut heaps: Vec<u64> = Vec::new();
    let begun = Instant::now();
    // Measure the heap first after some playback.
    while heaps.len() < 3 || begun.elapsed() < Duration::from_secs(secs) {
        let moved = browser.js_async(&play).await;
        assert!(moved.as_u64() > Some(3), "it plays: {moved}");
        heaps.push(browser.heap_bytes().await);
        if secs > 0 && heaps.len() % 20 == 1 {
            let (frames, now) = (heaps.len() * SOAK_FRAMES, begun.elapsed().as_secs());
            println!("{now} s, {frames} frames: {} bytes", heaps[heaps.len() - 1]);
        }
    }
    let (first, last) = (heaps[0], heaps[heaps.len() - 1]);
    println!(
        "{} frames in {} s: heap of {first} bytes, then {last}",
        heaps.len() * SOAK_FRAMES,
        begun.elapsed().as_secs()
    );
    assert!(last < first + SOAK_SLACK_BYTES, "{heaps:?}");
    desk.browser.quit().await;
}
