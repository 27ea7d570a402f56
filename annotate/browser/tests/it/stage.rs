//! The stage, its clock and its renderers.

use std::time::{Duration, Instant};

use annotate_browser::{Dataset, Graphics, keys};
use serde_json::json;

use crate::steps::Desk;

const FRAME: &str = "Number(document.querySelector('.stage').dataset.frame)";
const RENDERER: &str = "document.querySelector('.stage').dataset.renderer";

/// Number of colours in a copy of the stage's canvas.
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

fn at(path: &str) -> Desk {
    let desk = Desk::at(path);
    desk.task();
    desk
}

fn frame(desk: &Desk, number: u32) {
    desk.until("a frame", &format!("{FRAME} === {number}"));
}

fn draws(desk: &Desk, colours: u32) {
    desk.until("it draws", &format!("{COLOURS} > {colours}"));
}

#[test]
fn the_stage_draws_steps_exactly_and_goes_on_when_its_context_is_lost() {
    const CONTEXT: &str = "document.querySelector('.stage canvas').getContext('webgl2')";
    let desk = at("app/mask");
    desk.is(RENDERER, "webgl2");
    draws(&desk, 50);
    desk.is(&format!("{CONTEXT}.isContextLost()"), false);

    desk.press(&[keys::HOME]);
    frame(&desk, 0);
    desk.press(&[".", ".", "."]);
    frame(&desk, 3);
    desk.press(&[","]);
    frame(&desk, 2);
    desk.shift(&["."]);
    frame(&desk, 12);
    desk.press(&["[", keys::RIGHT, keys::RIGHT, keys::RIGHT, "]"]);
    desk.shows(".viewer[data-loop='12-15']");
    // The clip loops a few times; no frame outside the loop is shown.
    let seen = desk.js_async(
        "{ const stage = document.querySelector('.stage'); const seen = new Set(); \
               document.querySelector('.stage').focus(); \
               document.querySelector('.play').click(); \
               for (let i = 0; i < 60; i += 1) { \
                 await new Promise(requestAnimationFrame); seen.add(Number(stage.dataset.frame)); } \
               document.querySelector('.play').click(); \
               return [...seen].sort((a, b) => a - b); }",
    );
    assert_eq!(seen, json!([12, 13, 14, 15]));
    // The slider sets the same clock.
    desk.js("const range = document.querySelector('.scrub'); range.value = '7'; range.dispatchEvent(new Event('input'));");
    frame(&desk, 7);
    desk.press(&["\\", "-"]);
    desk.shows(".viewer[data-speed='0.75']");

    for (key, name) in [(keys::F1, "front"), (keys::F2, "side"), (keys::F3, "top")] {
        desk.press(&[key]);
        desk.shows(&format!(".stage[data-camera={name}]"));
    }
    let follows = ".cameras button:last-child[aria-pressed=true]";
    assert_eq!(desk.count(follows), 1);
    desk.press(&["f"]);
    desk.lacks(follows);

    desk.press(&[keys::HOME, ".", "."]);
    desk.js(&format!(
        "{CONTEXT}.getExtension('WEBGL_lose_context').loseContext();"
    ));
    let flat = format!("{RENDERER} === 'canvas2d'");
    desk.until("Canvas 2D takes over", &flat);
    draws(&desk, 20);
    desk.is(FRAME, 2);
}

#[test]
fn without_webgl_the_same_body_is_drawn_in_2d() {
    let people = ["ann", "boss"];
    let desk = Desk::with(Dataset::fresh(), Graphics::None, None, &people);
    desk.enter("ann", "app/mask");
    desk.task();
    desk.is(RENDERER, "canvas2d");
    draws(&desk, 20);
    desk.press(&[keys::HOME, "."]);
    frame(&desk, 1);
}

/// Frames played between two measurements of the heap.
const SOAK_FRAMES: usize = 300;

/// Allowed growth of the heap, for code and caches of the browser. A leak of 64 bytes per frame exceeds it within half
/// an hour of 60 frames per second.
const SOAK_SLACK_BYTES: u64 = 4 << 20;

/// Plays two bodies at double speed. A short version runs with the other tests; this command runs half an hour (one
/// hour of motion):
///
/// ```sh
/// ANNOTATE_SOAK=1800 bash annotate/browser/run playback
/// ```
#[test]
fn playback_keeps_two_stages_on_one_frame_and_does_not_grow_the_heap() {
    let secs = std::env::var("ANNOTATE_SOAK").map_or(0, |secs| secs.parse().expect("seconds"));
    let desk = at("app/pair");
    desk.has(".stage:not([hidden])", 2);
    let play = format!(
        "{{ const stages = [...document.querySelectorAll('.stage')]; \
               let apart = 0; const seen = new Set(); \
               for (let i = 0; i < {SOAK_FRAMES}; i += 1) {{ \
                 await new Promise(requestAnimationFrame); \
                 if (stages[0].dataset.frame !== stages[1].dataset.frame) apart += 1; \
                 seen.add(stages[0].dataset.frame); }} \
               return {{ apart, moved: seen.size > 3 }}; }}"
    );
    let plays = || assert_eq!(desk.js_async(&play), json!({ "apart": 0, "moved": true }));
    plays();
    desk.press(&["=", "=", "=", "=", "=", "=", "="]);
    desk.shows(".viewer[data-speed='2']");
    let mut heaps: Vec<u64> = Vec::new();
    let begun = Instant::now();
    // Measure the heap first after some playback.
    while heaps.len() < 3 || begun.elapsed() < Duration::from_secs(secs) {
        plays();
        heaps.push(desk.heap_bytes());
        if secs > 0 && heaps.len() % 20 == 1 {
            let (frames, now) = (heaps.len() * SOAK_FRAMES, begun.elapsed().as_secs());
            println!("{now} s, {frames} frames: {} bytes", heaps[heaps.len() - 1]);
        }
    }
    let (first, last) = (heaps[0], heaps[heaps.len() - 1]);
    assert!(last < first + SOAK_SLACK_BYTES, "{heaps:?}");
}
