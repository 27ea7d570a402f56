//! Masks and descriptions.

use annotate_browser::keys;
use serde_json::json;

use crate::steps::Desk;

/// Names of the parts of the selected card.
const PRESSED: &str = "[...document.querySelectorAll('.mask-card.selected .part[aria-pressed=\"true\"]')].map((e) => e.dataset.part)";

#[test]
fn a_whole_task_is_done_by_keyboard_alone() {
    let desk = Desk::at("app/home");
    desk.focuses(".queue[data-kind=mask_text] a");
    desk.press(&[keys::ENTER]);
    let task = desk.task();
    desk.describe_two_masks();
    desk.control(&[keys::ENTER]);
    let next = desk.next_task(task);
    assert_ne!(next, task);
    let revision = desk.mine(task);
    assert_eq!(revision["state"], "submitted");
    let masks = revision["answer"]["masks"].as_array().expect("masks");
    let said = masks
        .iter()
        .map(|mask| json!([mask["parts"], mask["text"]]));
    let expected = [
        json!([["LEFT_ARM"], "Wave with the left arm."]),
        json!([["LOWER_BODY"], "Bend the knees."]),
    ];
    assert_eq!(Vec::from_iter(said), expected);
}

#[test]
fn undo_and_redo_survive_a_reload() {
    let both = format!("{PRESSED}.includes('RIGHT_ARM')");
    let left = format!("{PRESSED}.join() === 'LEFT_ARM,soft'");
    let desk = Desk::at("app/mask");
    desk.task();
    desk.press(&["4", "5"]);
    desk.until("both arms are chosen", &both);
    desk.reload();
    desk.task();
    desk.until("they still are", &both);
    desk.control(&["z"]);
    desk.until("the right arm is undone", &left);
    desk.reload();
    desk.task();
    desk.until("undone it stays", &left);
    desk.control_shift(&["z"]);
    desk.until("it is back", &both);
}

#[test]
fn letters_typed_in_a_text_only_type() {
    let desk = Desk::at("app/mask");
    let task = desk.task();
    desk.press(&[" ", "4", "t"]);
    let before = desk.value("document.querySelector('.stage').dataset.frame");
    let typed = "1 2 x u n b h s k p , . [ ] - = ?";
    desk.type_text(typed);
    let after = format!(
        "({{ parts: {PRESSED}, cards: document.querySelectorAll('.mask-card').length, \
            frame: document.querySelector('.stage').dataset.frame, \
            text: document.querySelector('.mask-card.selected textarea').value, \
            boxes: document.querySelectorAll('dialog').length }})"
    );
    desk.is(
        &after,
        json!({ "parts": ["LEFT_ARM", "soft"], "cards": 1, "frame": before, "text": typed, "boxes": 0 }),
    );
    assert_eq!(desk.task(), task);
    // Undo in the text field reverts typing and does not change the mask.
    desk.control(&["z"]);
    desk.is(PRESSED, json!(["LEFT_ARM", "soft"]));
}

#[test]
fn left_and_right_are_guarded() {
    let desk = Desk::at("app/mask");
    desk.task();
    desk.write(&["5", "t"], "Wave with the left hand.");
    desk.shows("[data-lint=side]");
    desk.press(&[keys::ESCAPE, "5", "4"]);
    desk.lacks("[data-lint=side]");
    // Left arm plus right arm is stored as entered, and shown as equal to both arms.
    desk.press(&["5"]);
    desk.until(
        "it says what that equals",
        "document.querySelector('.card-title .note').textContent === '= both arms'",
    );
}

#[test]
fn suggestions_are_never_chosen_beforehand() {
    let desk = Desk::at("app/mask");
    let task = desk.task();
    desk.is(PRESSED, json!(["soft"]));
    let answer = desk.mine(task);
    assert!(answer.is_null(), "an answer begins with a person");
}

#[test]
fn the_key_of_suggestions_reaches_every_one() {
    let desk = Desk::at("app/mask");
    desk.task();
    let offered = desk.count(".suggestion");
    assert!(offered > 0, "the clip moves");
    let mut seen = std::collections::BTreeSet::new();
    for _ in 0..offered {
        desk.press(&["h"]);
        seen.insert(desk.text_of(".mask-card.selected .card-title"));
    }
    assert_eq!(seen.len() as u64, offered, "{seen:?}");
    let cards = desk.count(".mask-card");
    assert_eq!(cards, 1, "the same card shows one after the other");
}

#[test]
fn the_blend_preview_changes_only_masked_joints() {
    let desk = Desk::at("app/mask");
    desk.task();
    desk.press(&["4", "s", "b"]);
    desk.until(
        "the blend is shown",
        "document.querySelector('.stage-caption').textContent.startsWith('Blend: left arm')",
    );
    // Compare the blend that the page requested with the partner: only the arm below the shoulder and its hand may
    // differ. Without the soft ring the shoulder does not move.
    let moved = desk.js_async(
        "{ const view = await (await fetch('/api/v1/queue/next', { method: 'POST', \
             headers: { 'X-Annotate': '1', 'Content-Type': 'application/json' }, \
             body: JSON.stringify({ kind: 'mask_text' }) })).json(); \
           const own = view.task.task.motions[0].hash; \
           const partners = await (await fetch(`/api/v1/motions/partners?of=${own}&n=8`)).json(); \
           const floats = async (response) => new Float32Array(await (await response).arrayBuffer()); \
           const blend = await floats(fetch('/api/v1/blend', { method: 'POST', \
             headers: { 'X-Annotate': '1', 'Content-Type': 'application/json' }, \
             body: JSON.stringify({ src: partners[0].hash, tgt: own, parts: ['LEFT_ARM'], soft: false, alpha: 0.5 }) })); \
           const partner = await floats(fetch(`/api/v1/motions/${partners[0].hash}/joints`)); \
           const frames = Math.min(blend.length, partner.length) / 84; \
           const moved = new Set(); \
           for (let frame = 0; frame < frames; frame += 1) \
             for (let joint = 0; joint < 28; joint += 1) \
               for (let axis = 0; axis < 3; axis += 1) { \
                 const at = frame * 84 + joint * 3 + axis; \
                 if (Math.abs(blend[at] - partner[at]) > 1e-5) moved.add(joint); \
               } \
           return [...moved].sort((a, b) => a - b); }",
    );
    let moved: Vec<u32> = serde_json::from_value(moved).expect("joints");
    assert!(!moved.is_empty(), "the blend shows something");
    let arm = [18, 20, 24, 25];
    let others = moved.iter().filter(|joint| !arm.contains(joint));
    assert_eq!(others.count(), 0, "more than the left arm moved: {moved:?}");
    desk.press(&["b"]);
    desk.until(
        "the motion itself is back",
        "!document.querySelector('.stage-caption').textContent.startsWith('Blend')",
    );
}

#[test]
fn a_mask_holds_for_a_range_and_a_joint_is_chosen() {
    const LAST: &str = "Number(document.querySelector('.lane-handle.last').ariaValueNow)";
    const RANGE: &str =
        "document.querySelector('.mask-card.selected .card-title [data-range]')?.textContent";
    const HIP: &str = ".mask-card.selected [data-joint=left_hip]";
    let desk = Desk::at("app/mask");
    let task = desk.task();
    desk.describe_two_masks();

    // A range of 11 frames is too short and cannot be submitted.
    desk.press(&[keys::ESCAPE, keys::HOME, "["]);
    desk.shift(&["."]);
    desk.press(&["]", "a"]);
    let said = |end: &str| format!("{RANGE}?.startsWith('frames 1 to {end},')");
    desk.until("the range is said", &said("11"));
    let problem = "Mask 2 holds for 11 frames, but a range needs 31 at least";
    desk.reads(".mask-problem", &[problem]);
    desk.control(&[keys::ENTER]);
    desk.says(".toast.error", "a range needs 31 at least");
    assert_eq!(desk.task(), task);

    // Keys and the mouse move the ends of the range.
    desk.tab_to("Last frame of mask 2");
    desk.shift(&[keys::RIGHT, keys::RIGHT]);
    desk.press(&[keys::RIGHT, keys::RIGHT]);
    desk.until(
        "it is long enough",
        &format!("{LAST} === 33 && !document.querySelector('.mask-problem')"),
    );
    desk.until(
        "the frame there is shown",
        "document.querySelector('.stage').dataset.frame === '32'",
    );
    desk.control(&["z"]);
    desk.until("that is one step back", &format!("{LAST} === 11"));
    desk.control_shift(&["z"]);
    desk.until("and one forward", &format!("{LAST} === 33"));
    desk.drag(".lane-handle.last", 120.0);
    desk.until("it is dragged", &format!("{LAST} > 33"));
    let end = desk.value(LAST);

    // Make a joint of the part soft.
    desk.click(".mask-card.selected .joints summary");
    desk.click(HIP);
    let soft = format!("{HIP}[data-weight=soft]");
    desk.shows(&soft);
    desk.saved();
    desk.reload();
    desk.task();
    desk.press(&[keys::DOWN]);
    desk.until("the range is still there", &said(&end.to_string()));
    desk.shows(&soft);
    desk.until(
        "it is the loop",
        &format!("document.querySelector('.viewer').dataset.loop === '0-' + ({end} - 1)"),
    );

    desk.control(&[keys::ENTER]);
    desk.next_task(task);
    let masks = desk.mine(task)["answer"]["masks"].clone();
    assert_eq!(masks[0].get("range"), None, "the other mask has none");
    assert_eq!(masks[1]["range"], json!([0, end]));
    let joint = json!([{ "joint": "left_hip", "weight": "soft" }]);
    assert_eq!(masks[1]["joints"], joint);
    desk.go("app/mine");
    let words = format!("lower body (soft left hip, frames 1 to {end})");
    desk.says(".answer-details", &words);
    desk.until(
        "and on the timeline",
        "document.querySelectorAll('.lane-bar').length === 1 && !document.querySelector('.lane-handle')",
    );
}

#[test]
fn too_few_masks_need_a_reason() {
    let desk = Desk::at("app/mask");
    let task = desk.task();
    desk.write(&["4", "t"], "Wave with the left arm.");
    desk.control(&[keys::ENTER]);
    desk.shows("dialog[open]");
    desk.press(&["1"]);
    desk.next_task(task);
    let revision = desk.mine(task);
    assert_eq!(revision["answer"]["count_reason"], "single_action");
}

#[test]
fn a_skip_needs_a_reason() {
    let desk = Desk::at("app/mask");
    let task = desk.task();
    for by_mouse in [false, true] {
        desk.press(&["k"]);
        desk.shows("dialog[open]");
        if by_mouse {
            desk.press_button("dialog", "Cancel");
        } else {
            desk.press(&[keys::ESCAPE]);
        }
        desk.lacks("dialog[open]");
        assert_eq!(desk.task(), task);
    }
    desk.press(&["k"]);
    desk.shows("dialog[open]");
    desk.press(&["2"]);
    desk.next_task(task);
}

#[test]
fn a_task_whose_clip_changed_asks_in_words_of_its_own() {
    let desk = Desk::at("app/home");
    desk.shows(".queue");
    // Clips are ingested again only while no server runs, so the test fakes the server's reply.
    desk.js(
        "const real = window.fetch; \
             window.fetch = async (...asked) => { \
                 const reply = await real(...asked); \
                 if (!String(asked[0]).endsWith('queue/next')) return reply; \
                 const next = await reply.json(); \
                 next.task.clip_changed = true; \
                 return new Response(JSON.stringify(next), { headers: { 'Content-Type': 'application/json' } }); };",
    );
    desk.shift(&["2"]);
    desk.task();
    let note = desk.text_of(".returned-note");
    assert!(note.starts_with("The clip has changed:"), "{note}");
    let notes = desk.count(".returned-note");
    assert_eq!(notes, 1, "it did not come back from a reviewer");
}

#[test]
fn remapped_keys_hold_and_stay() {
    let desk = Desk::at("app/mask");
    desk.task();
    desk.shift(&["/"]);
    desk.shows(".key-sheet");
    desk.click("[data-action=mask_new]");
    // Keys in use are refused, free ones accepted.
    desk.press(&["b"]);
    desk.says(".dialog .note[role=status]", "Blend preview");
    desk.press(&["j"]);
    desk.says(".dialog .note[role=status]", "is now on J");
    desk.press(&[keys::ESCAPE]);
    desk.lacks("dialog[open]");
    let expected = json!({ "mask_new": ["KeyJ"] });
    desk.until_stored("the key is stored", "prefs", |prefs| {
        prefs["keys"] == expected
    });
    desk.reload();
    desk.task();
    desk.press(&["4", "n"]);
    assert_eq!(desk.count(".mask-card"), 1);
    desk.press(&["j"]);
    desk.until(
        "the new key works",
        "document.querySelectorAll('.mask-card').length === 2",
    );
}
