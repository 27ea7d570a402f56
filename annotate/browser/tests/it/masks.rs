//! Masks and descriptions.

use annotate_browser::keys;
use serde_json::json;

use crate::steps::Desk;

/// Names of the parts of the selected card.
const PRESSED: &str = "[...document.querySelectorAll('.mask-card.selected .part[aria-pressed=\"true\"]')].map((e) => e.dataset.part)";

#[test]
fn undo_and_redo_survive_a_reload_and_the_blend_of_the_mask_is_shown() {
    const CAPTION: &str = "document.querySelector('.stage-caption').textContent";
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
    desk.press(&["b"]);
    let blend = format!("{CAPTION}.startsWith('Blend: left arm')");
    desk.until("the blend is shown", &blend);
    desk.press(&["b"]);
    let motion = format!("!{CAPTION}.startsWith('Blend')");
    desk.until("the motion itself is back", &motion);
    desk.control_shift(&["z"]);
    desk.until("it is back", &both);
}

#[test]
fn letters_typed_in_a_text_only_type_and_remapped_keys_hold_and_stay() {
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

    desk.press(&[keys::ESCAPE]);
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
    desk.press(&["5", "n"]);
    assert_eq!(desk.count(".mask-card"), 1);
    desk.press(&["j"]);
    desk.has(".mask-card", 2);
}

#[test]
fn suggestions_are_never_chosen_beforehand_their_key_reaches_all_and_sides_are_guarded() {
    let desk = Desk::at("app/mask");
    let task = desk.task();
    desk.is(PRESSED, json!(["soft"]));
    let answer = desk.mine(task);
    assert!(answer.is_null(), "an answer begins with a person");
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

    desk.write(&["n", "5", "t"], "Wave with the left hand.");
    desk.shows("[data-lint=side]");
    desk.press(&[keys::ESCAPE, "5", "4"]);
    desk.lacks("[data-lint=side]");
    // Left arm plus right arm is stored as entered, and shown as equal to both arms.
    desk.press(&["5"]);
    desk.until(
        "it says what that equals",
        "document.querySelector('.mask-card.selected .card-title .note').textContent === '= both arms'",
    );
}

#[test]
fn a_mask_holds_for_a_range_and_a_joint_is_chosen() {
    const LAST: &str = "Number(document.querySelector('.lane-handle.last').ariaValueNow)";
    const RANGE: &str =
        "document.querySelector('.mask-card.selected .card-title [data-range]')?.textContent";
    const HIP: &str = ".mask-card.selected [data-joint=left_hip]";
    let desk = Desk::at("app/home");
    desk.focuses(".queue[data-kind=mask_text] a");
    desk.press(&[keys::ENTER]);
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
    desk.until("it is long enough", &format!("{LAST} === 33"));
    desk.lacks(".mask-problem");
    desk.shows(".stage[data-frame='32']");
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
    let revision = desk.mine(task);
    assert_eq!(revision["state"], "submitted");
    let masks = &revision["answer"]["masks"];
    let said = [0, 1].map(|at: usize| json!([masks[at]["parts"], masks[at]["text"]]));
    let arm = json!([["LEFT_ARM"], "Wave with the left arm."]);
    assert_eq!(said, [arm, json!([["LOWER_BODY"], "Bend the knees."])]);
    assert_eq!(masks.as_array().map(Vec::len), Some(2));
    assert_eq!(masks[0].get("range"), None, "the other mask has none");
    assert_eq!(masks[1]["range"], json!([0, end]));
    let joint = json!([{ "joint": "left_hip", "weight": "soft" }]);
    assert_eq!(masks[1]["joints"], joint);
    desk.go("app/mine");
    let words = format!("lower body (soft left hip, frames 1 to {end})");
    desk.says(".answer-details", &words);
    desk.has(".lane-bar", 1);
    desk.lacks(".lane-handle");
}

#[test]
fn too_few_masks_and_a_skip_need_a_reason() {
    let desk = Desk::at("app/mask");
    let task = desk.task();
    desk.write(&["4", "t"], "Wave with the left arm.");
    desk.control(&[keys::ENTER]);
    desk.shows("dialog[open]");
    desk.press(&["1"]);
    let next = desk.next_task(task);
    let revision = desk.mine(task);
    assert_eq!(revision["answer"]["count_reason"], "single_action");
    desk.press(&[keys::ESCAPE]);
    for by_mouse in [false, true] {
        desk.press(&["k"]);
        desk.shows("dialog[open]");
        if by_mouse {
            desk.press_button("dialog", "Cancel");
        } else {
            desk.press(&[keys::ESCAPE]);
        }
        desk.lacks("dialog[open]");
        assert_eq!(desk.task(), next);
    }
    desk.press(&["k"]);
    desk.shows("dialog[open]");
    desk.press(&["2"]);
    desk.next_task(next);
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
