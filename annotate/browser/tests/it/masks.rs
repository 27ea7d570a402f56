//! Masks and descriptions.

use annotate_browser::keys;
use serde_json::json;

use crate::steps::{Desk, describe_two_masks, mine};

/// Text of the text box, part names of the selected card, and number of cards.
const PRESSED: &str = "[...document.querySelectorAll('.mask-card.selected .part[aria-pressed=\"true\"]')].map((e) => e.dataset.part)";

#[tokio::test(flavor = "multi_thread")]
async fn a_whole_task_is_done_by_keyboard_alone() {
    let desk = Desk::open("app/home").await;
    let browser = &desk.browser;
    browser
        .until(
            "the first queue has the focus",
            "document.activeElement.matches('.queue[data-kind=mask_text] a')",
        )
        .await;
    browser.press(&[keys::ENTER]).await;
    let task = browser.task().await;
    describe_two_masks(browser).await;
    browser.control(&[keys::ENTER]).await;
    let next = browser.next_task(task).await;
    assert_ne!(next, task);
    let revision = mine(browser, task).await;
    assert_eq!(revision["state"], "submitted");
    let masks = revision["answer"]["masks"].as_array().expect("masks");
    assert_eq!(masks.len(), 2);
    assert_eq!(masks[0]["parts"], json!(["LEFT_ARM"]));
    assert_eq!(masks[0]["text"], "Wave with the left arm.");
    assert_eq!(masks[1]["parts"], json!(["LOWER_BODY"]));
    assert_eq!(masks[1]["text"], "Bend the knees.");
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn undo_and_redo_survive_a_reload() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    browser.task().await;
    browser.press(&["4", "5"]).await;
    browser
        .until(
            "both arms are chosen",
            &format!("{PRESSED}.includes('RIGHT_ARM')"),
        )
        .await;
    browser.client().refresh().await.expect("the page reloads");
    browser.task().await;
    browser
        .until(
            "they still are",
            &format!("{PRESSED}.includes('RIGHT_ARM')"),
        )
        .await;
    browser.control(&["z"]).await;
    browser
        .until(
            "the right arm is undone",
            &format!("{PRESSED}.join() === 'LEFT_ARM,soft'"),
        )
        .await;
    browser.client().refresh().await.expect("the page reloads");
    browser.task().await;
    browser
        .until(
            "undone it stays",
            &format!("{PRESSED}.join() === 'LEFT_ARM,soft'"),
        )
        .await;
    browser
        .press_with(&[keys::CONTROL, keys::SHIFT], &["z"])
        .await;
    browser
        .until("it is back", &format!("{PRESSED}.includes('RIGHT_ARM')"))
        .await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn letters_typed_in_a_text_only_type() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    browser.press(&[" ", "4", "t"]).await;
    let before = browser
        .js("return document.querySelector('.stage').dataset.frame;")
        .await;
    let typed = "1 2 x u n b h s k p , . [ ] - = ?";
    browser.type_text(typed).await;
    let after = browser
        .js(&format!(
            "return {{ parts: {PRESSED}, cards: document.querySelectorAll('.mask-card').length, \
             frame: document.querySelector('.stage').dataset.frame, \
             text: document.querySelector('.mask-card.selected textarea').value, \
             boxes: document.querySelectorAll('dialog').length }};"
        ))
        .await;
    assert_eq!(
        after,
        json!({ "parts": ["LEFT_ARM", "soft"], "cards": 1, "frame": before, "text": typed, "boxes": 0 })
    );
    assert_eq!(browser.task().await, task);
    // Undo in the text field reverts typing and does not change the mask.
    browser.control(&["z"]).await;
    let parts = browser.js(&format!("return {PRESSED};")).await;
    assert_eq!(parts, json!(["LEFT_ARM", "soft"]));
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn left_and_right_are_guarded() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    browser.task().await;
    browser.press(&["5", "t"]).await;
    browser.type_text("Wave with the left hand.").await;
    browser
        .until(
            "the lint says so",
            "document.querySelector('[data-lint=side]')",
        )
        .await;
    browser.press(&[keys::ESCAPE, "5", "4"]).await;
    browser
        .until(
            "the lint is gone",
            "!document.querySelector('[data-lint=side]')",
        )
        .await;
    // Left with right arm is stored as entered, and shown like both arms.
    browser.press(&["5"]).await;
    browser
        .until(
            "it says what that equals",
            "document.querySelector('.card-title .note').textContent === '= both arms'",
        )
        .await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn suggestions_are_never_chosen_beforehand() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    let chosen = browser.js(&format!("return {PRESSED};")).await;
    assert_eq!(chosen, json!(["soft"]));
    let view = browser.request("GET", &format!("tasks/{task}"), None).await;
    assert!(
        view["body"]["mine"].is_null(),
        "an answer begins with a person"
    );
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_key_of_suggestions_reaches_every_one() {
    const CARD: &str =
        "return document.querySelector('.mask-card.selected .card-title').textContent;";
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    browser.task().await;
    let offered = browser
        .js("return document.querySelectorAll('.suggestion').length;")
        .await
        .as_u64()
        .expect("a number");
    assert!(offered > 0, "the clip moves");
    let mut seen = std::collections::BTreeSet::new();
    for _ in 0..offered {
        browser.press(&["h"]).await;
        seen.insert(browser.js(CARD).await.to_string());
    }
    assert_eq!(seen.len() as u64, offered, "{seen:?}");
    assert_eq!(
        browser
            .js("return document.querySelectorAll('.mask-card').length;")
            .await,
        json!(1),
        "the same card shows one after the other"
    );
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_blend_preview_changes_only_masked_joints() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    browser.task().await;
    browser.press(&["4", "s"]).await;
    browser.press(&["b"]).await;
    browser
        .until(
            "the blend is shown",
            "document.querySelector('.stage-caption').textContent.startsWith('Blend: left arm')",
        )
        .await;
    // Compare the blend that the page requested with the partner: only the arm below the shoulder and its hand may
    // differ. Without the soft ring the shoulder does not move.
    let moved = browser
        .js_async(
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
        )
        .await;
    let moved: Vec<i64> = moved
        .as_array()
        .expect("joints")
        .iter()
        .filter_map(serde_json::Value::as_i64)
        .collect();
    assert!(!moved.is_empty(), "the blend shows something");
    assert!(
        moved.iter().all(|joint| [18, 20, 24, 25].contains(joint)),
        "keypoints outside of the left arm moved: {moved:?}"
    );
    browser.press(&["b"]).await;
    browser
        .until(
            "the motion itself is back",
            "!document.querySelector('.stage-caption').textContent.startsWith('Blend')",
        )
        .await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mask_holds_for_a_range_and_a_joint_is_chosen() {
    const LAST: &str = "Number(document.querySelector('.lane-handle.last').ariaValueNow)";
    const RANGE: &str =
        "document.querySelector('.mask-card.selected .card-title [data-range]')?.textContent";
    const HIP: &str = ".mask-card.selected [data-joint=left_hip]";
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    describe_two_masks(browser).await;

    // From In to Out: 11 frames are too few, and cannot be handed in.
    browser.press(&[keys::ESCAPE, keys::HOME, "["]).await;
    browser.shift(&["."]).await;
    browser.press(&["]", "a"]).await;
    browser
        .until(
            "the range is said",
            &format!("{RANGE}?.startsWith('frames 1 to 11,')"),
        )
        .await;
    let problem = browser.text_of(".mask-problem").await;
    assert!(
        problem.starts_with("Mask 2 holds for 11 frames, but a range needs 31 at least"),
        "{problem}"
    );
    browser.control(&[keys::ENTER]).await;
    browser
        .until(
            "it is refused",
            "document.querySelector('.toast.error')?.textContent.includes('a range needs 31 at least')",
        )
        .await;
    assert_eq!(browser.task().await, task);

    // Its ends move by keys and by the mouse.
    browser.tab_to("Last frame of mask 2").await;
    browser.shift(&[keys::RIGHT, keys::RIGHT]).await;
    browser.press(&[keys::RIGHT, keys::RIGHT]).await;
    browser
        .until(
            "it is long enough",
            &format!("{LAST} === 33 && !document.querySelector('.mask-problem')"),
        )
        .await;
    browser
        .until(
            "the frame there is shown",
            "document.querySelector('.stage').dataset.frame === '32'",
        )
        .await;
    browser.control(&["z"]).await;
    browser
        .until("that is one step back", &format!("{LAST} === 11"))
        .await;
    browser
        .press_with(&[keys::CONTROL, keys::SHIFT], &["z"])
        .await;
    browser
        .until("and one forward", &format!("{LAST} === 33"))
        .await;
    browser.drag(".lane-handle.last", 120.0).await;
    browser
        .until("it is dragged", &format!("{LAST} > 33"))
        .await;
    let end = browser.js(&format!("return {LAST};")).await;

    // A joint of the part is soft.
    browser
        .js(&format!(
            "document.querySelector('.mask-card.selected .joints summary').click(); \
             document.querySelector('{HIP}').click();"
        ))
        .await;
    let is_soft = format!("document.querySelector('{HIP}')?.dataset.weight === 'soft'");
    browser.until("it is soft", &is_soft).await;
    browser.saved().await;
    browser.client().refresh().await.expect("the page reloads");
    browser.task().await;
    browser.press(&[keys::DOWN]).await;
    browser
        .until(
            "the range is still there",
            &format!("{RANGE}?.startsWith('frames 1 to {end},')"),
        )
        .await;
    browser.until("so is the joint", &is_soft).await;
    browser
        .until(
            "it is the loop",
            &format!("document.querySelector('.viewer').dataset.loop === '0-' + ({end} - 1)"),
        )
        .await;

    browser.control(&[keys::ENTER]).await;
    browser.next_task(task).await;
    let masks = mine(browser, task).await["answer"]["masks"].clone();
    assert_eq!(masks[0].get("range"), None, "the other mask has none");
    assert_eq!(masks[1]["range"], json!([0, end]));
    assert_eq!(
        masks[1]["joints"],
        json!([{ "joint": "left_hip", "weight": "soft" }])
    );
    browser.open(&desk.server.page("app/mine")).await;
    browser
        .until(
            "my answer says it in words",
            &format!(
                "document.querySelector('.answer-details')?.textContent.includes('lower body (soft left hip, frames 1 to {end})')"
            ),
        )
        .await;
    browser
        .until(
            "and on the timeline",
            "document.querySelectorAll('.lane-bar').length === 1 && !document.querySelector('.lane-handle')",
        )
        .await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn too_few_masks_need_a_reason() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    browser.press(&["4", "t"]).await;
    browser.type_text("Wave with the left arm.").await;
    browser.control(&[keys::ENTER]).await;
    browser
        .until(
            "the reason is asked for",
            "document.querySelector('dialog[open]')",
        )
        .await;
    browser.press(&["1"]).await;
    browser.next_task(task).await;
    let revision = mine(browser, task).await;
    assert_eq!(revision["answer"]["count_reason"], "single_action");
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_skip_needs_a_reason() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    browser.press(&["k"]).await;
    browser
        .until(
            "the reason is asked for",
            "document.querySelector('dialog[open]')",
        )
        .await;
    browser.press(&[keys::ESCAPE]).await;
    browser
        .until(
            "without one nothing happens",
            "!document.querySelector('dialog[open]')",
        )
        .await;
    assert_eq!(browser.task().await, task);
    browser.press(&["k"]).await;
    browser
        .until(
            "it can be cancelled with the mouse as well",
            "document.querySelector('dialog[open] [data-choice=Cancel]')",
        )
        .await;
    browser
        .js("document.querySelector('dialog[open] [data-choice=Cancel]').click();")
        .await;
    browser
        .until(
            "nothing happens again",
            "!document.querySelector('dialog[open]')",
        )
        .await;
    assert_eq!(browser.task().await, task);
    browser.press(&["k"]).await;
    browser
        .until(
            "the reason is asked for",
            "document.querySelector('dialog[open]')",
        )
        .await;
    browser.press(&["2"]).await;
    browser.next_task(task).await;
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_whose_clip_changed_asks_in_words_of_its_own() {
    let desk = Desk::open("app/home").await;
    let browser = &desk.browser;
    browser
        .until("the home page", "document.querySelector('.queue')")
        .await;
    // Clips are ingested anew while no server runs; here its reply says so.
    browser
        .js("const real = window.fetch; \
             window.fetch = async (...asked) => { \
                 const reply = await real(...asked); \
                 if (!String(asked[0]).endsWith('queue/next')) return reply; \
                 const next = await reply.json(); \
                 next.task.clip_changed = true; \
                 return new Response(JSON.stringify(next), { headers: { 'Content-Type': 'application/json' } }); };")
        .await;
    browser.shift(&["2"]).await;
    browser.task().await;
    let note = browser.text_of(".returned-note").await;
    assert!(note.starts_with("The clip has changed:"), "{note}");
    let notes = browser
        .js("return document.querySelectorAll('.returned-note').length;")
        .await;
    assert_eq!(notes, json!(1), "it did not come back from a reviewer");
    desk.browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn remapped_keys_hold_and_stay() {
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    browser.task().await;
    browser.shift(&["/"]).await;
    browser
        .until(
            "the key sheet is open",
            "document.querySelector('.key-sheet')",
        )
        .await;
    browser
        .js("document.querySelector('[data-action=mask_new]').click();")
        .await;
    // Keys in use are refused, free ones accepted.
    browser.press(&["b"]).await;
    browser
        .until("the clash is named", "document.querySelector('.dialog .note[role=status]').textContent.includes('Blend preview')")
        .await;
    browser.press(&["j"]).await;
    browser
        .until("the new key is named", "document.querySelector('.dialog .note[role=status]').textContent.includes('is now on J')")
        .await;
    browser.press(&[keys::ESCAPE]).await;
    browser
        .until(
            "the sheet is closed",
            "!document.querySelector('dialog[open]')",
        )
        .await;
    let expected = json!({ "mask_new": ["KeyJ"] });
    browser
        .until_stored("the key is stored", "prefs", |prefs| {
            prefs["keys"] == expected
        })
        .await;
    browser.client().refresh().await.expect("the page reloads");
    browser.task().await;
    browser.press(&["4", "n"]).await;
    assert_eq!(
        browser
            .js("return document.querySelectorAll('.mask-card').length;")
            .await,
        json!(1)
    );
    browser.press(&["j"]).await;
    browser
        .until(
            "the new key works",
            "document.querySelectorAll('.mask-card').length === 2",
        )
        .await;
    desk.browser.quit().await;
}
