//! Accessibility: names of controls, focus order, contrast.

use annotate_browser::{Dataset, keys};
use serde_json::json;

use crate::pictures::{SCREENS, address};
use crate::steps::{CUT, Desk};

/// Controls without an accessible name.
const NAMELESS: &str = "[...document.querySelectorAll('button, a, input, select, textarea, [tabindex], canvas, progress, dialog')] \
    .filter((element) => element.getClientRects().length > 0 && element.closest('[aria-hidden=true]') === null) \
    .filter((element) => { \
        const name = element.getAttribute('aria-label') ?? element.labels?.[0]?.textContent ?? \
            document.getElementById(element.getAttribute('aria-labelledby') ?? '')?.textContent ?? element.textContent; \
        return name.trim() === ''; }) \
    .map((element) => element.tagName + '.' + element.className)";

/// Texts with too little contrast: below 4.5 to 1, or below 3 to 1 for large text.
const FAINT: &str = "(() => { \
    const parse = (colour) => { const [r, g, b, a = '1'] = colour.match(/[\\d.]+/g) ?? ['0', '0', '0', '0']; \
        return [Number(r), Number(g), Number(b), Number(a)]; }; \
    const over = (top, under) => [0, 1, 2].map((i) => top[i] * top[3] + under[i] * (1 - top[3])).concat(1); \
    const behind = (element) => { let layers = []; \
        for (let at = element; at; at = at.parentElement) layers.push(parse(getComputedStyle(at).backgroundColor)); \
        return layers.reverse().reduce((under, top) => over(top, under), [255, 255, 255, 1]); }; \
    const light = (colour) => { const [r, g, b] = colour.slice(0, 3).map((value) => { const c = value / 255; \
        return c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; }); return 0.2126 * r + 0.7152 * g + 0.0722 * b; }; \
    const faint = []; \
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT); \
    for (let node = walker.nextNode(); node; node = walker.nextNode()) { \
        const element = node.parentElement; \
        if (node.textContent.trim() === '' || element.getClientRects().length === 0) continue; \
        const style = getComputedStyle(element); \
        const under = behind(element); \
        const [a, b] = [light(over(parse(style.color), under)), light(under)].sort((x, y) => y - x); \
        const size = parseFloat(style.fontSize); \
        const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700); \
        const ratio = (a + 0.05) / (b + 0.05); \
        if (ratio < (large ? 3 : 4.5)) faint.push(`${node.textContent.trim().slice(0, 30)}: ${ratio.toFixed(2)}`); } \
    return faint; })()";

/// Opens the first mask task, in a browser with extra command-line arguments.
fn at_a_mask(arguments: &[&str]) -> Desk {
    let desk = Desk::admin(Dataset::fresh(), arguments);
    desk.go("app/mask");
    desk.task();
    desk
}

#[test]
fn every_page_has_names_contrast_and_one_main_part_and_nothing_is_cut_or_covered() {
    const COVERED: &str = "[...document.querySelectorAll('.toast')].filter((toast) => { const box = toast.getBoundingClientRect(); \
        return [...document.querySelectorAll('.strips, .transport')].some((other) => { const under = other.getBoundingClientRect(); \
            return box.bottom > under.top && box.top < under.bottom && box.right > under.left && box.left < under.right; }); }).length";
    let desk = Desk::admin(Dataset::fresh(), &[]);
    check_pages(&desk, "light");
    for page in ["app/mask", "app/pair", "app/style"] {
        desk.go(page);
        desk.task();
        assert_eq!(desk.value(CUT), json!([]), "{page}");
        // An incomplete answer shows a message.
        desk.control(&[keys::ENTER]);
        desk.shows(".toast");
        assert_eq!(desk.value(COVERED), json!(0), "{page}");
    }
}

#[test]
fn every_page_is_dark_where_the_system_is() {
    let desk = at_a_mask(&["--force-dark-mode"]);
    desk.is("matchMedia('(prefers-color-scheme: dark)').matches", true);
    // The corner of the stage shows the background, which is dark as well.
    let corner = desk.js_async(
        "{ await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))); \
         const canvas = document.querySelector('.stage canvas'); const copy = document.createElement('canvas'); \
         copy.width = copy.height = 1; const context = copy.getContext('2d'); \
         context.drawImage(canvas, 2, 2, 1, 1, 0, 0, 1, 1); \
         return [...context.getImageData(0, 0, 1, 1).data]; }",
    );
    assert!(corner[0].as_u64().is_some_and(|red| red < 80), "{corner}");
    check_pages(&desk, "dark");
}

#[test]
fn playback_waits_for_people_who_want_less_motion() {
    let desk = at_a_mask(&["--force-prefers-reduced-motion"]);
    desk.is("document.querySelector('.viewer').dataset.playing", "false");
    desk.press(&[" "]);
    desk.shows(".viewer[data-playing=true]");
}

#[test]
fn the_focus_goes_round_nothing_holds_it_and_parts_and_screens_have_keys() {
    const REGION: &str =
        "['nav', '.panel', '.viewer'].find((own) => document.activeElement.closest(own))";
    let desk = at_a_mask(&[]);
    desk.focuses(".stage");
    desk.press(&[keys::TAB]);
    desk.is("document.activeElement.matches('.stage')", false);
    desk.press(&[keys::ESCAPE, "9", "0"]);
    for part in ["TORSO", "HEAD"] {
        desk.shows(&format!("[data-part={part}][aria-pressed=true]"));
    }
    let label = desk.value("document.querySelector('.strip').getAttribute('aria-label')");
    let label = label.as_str().expect("a label");
    assert!(label.contains("left arm:"), "{label}");
    assert!(label.contains(" s;") || label.contains("still"), "{label}");
    let mut seen = Vec::new();
    for _ in 0..3 {
        desk.press(&[keys::F6]);
        seen.push(desk.value(REGION).to_string());
    }
    seen.sort();
    let all = ["\".panel\"", "\".viewer\"", "\"nav\""];
    assert_eq!(seen, all, "F6 visits every region");
    // On a control, the browser handles Tab: focus moves on and never gets stuck.
    desk.press(&[keys::F6]);
    desk.focus(".panel-foot button");
    desk.press(&[keys::TAB]);
    desk.is("document.activeElement.textContent.includes('Skip')", true);
    // Escape moves the focus back to the stage, also from a text field.
    desk.press(&[keys::ESCAPE]);
    desk.focuses(".stage");
    desk.press(&["t"]);
    desk.focuses("textarea");
    desk.press(&[keys::ESCAPE]);
    desk.focuses(".stage");
    // Keys still work after a click.
    desk.click_with_mouse(".cameras button");
    desk.focuses(".stage");
    desk.press(&["4"]);
    desk.shows("[data-part=LEFT_ARM][aria-pressed=true]");
    for (key, shown) in [("3", ".work.pair"), ("0", ".tasks"), ("1", ".queue")] {
        desk.shift(&[key]);
        desk.shows(shown);
    }
}

/// Checks names, contrast and the frame of every page.
fn check_pages(desk: &Desk, theme: &str) {
    for (name, shown, _) in SCREENS {
        let page = address(name);
        desk.page(&page, shown);
        for (what, found) in [("without a name", NAMELESS), ("faint", FAINT)] {
            assert_eq!(desk.value(found), json!([]), "{page}, {theme}: {what}");
        }
        let parts = desk.value(
            "({ main: document.querySelectorAll('main').length, lang: document.documentElement.lang, title: document.title !== '', \
               wide: [document.documentElement, document.querySelector('main')].some((part) => part.scrollWidth > part.clientWidth) })",
        );
        let expected = json!({ "main": 1, "lang": "en", "title": true, "wide": false });
        assert_eq!(parts, expected, "{page}");
    }
}
