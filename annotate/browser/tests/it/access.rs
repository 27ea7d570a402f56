//! Accessibility: names of controls, focus order, contrast.

use annotate_browser::{Browser, Dataset, Graphics, Server, keys};
use serde_json::json;

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

async fn admin() -> (Server, Browser, Dataset) {
    admin_with(&[]).await
}

async fn admin_with(arguments: &[&str]) -> (Server, Browser, Dataset) {
    let dataset = Dataset::fresh().await;
    let server = Server::start(&dataset).await;
    let browser = Browser::start_with(Graphics::Software, arguments).await;
    let token = server.printed_token().to_owned();
    browser.log_in(&server, &token, "app/home").await;
    (server, browser, dataset)
}

#[tokio::test(flavor = "multi_thread")]
async fn every_page_has_names_contrast_and_one_main_part() {
    let (server, browser, _dataset) = admin().await;
    check_pages(&server, &browser, "light").await;
    browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_page_is_dark_where_the_system_is() {
    let (server, browser, _dataset) = admin_with(&["--force-dark-mode"]).await;
    let dark = browser
        .js("return matchMedia('(prefers-color-scheme: dark)').matches;")
        .await;
    assert_eq!(dark, json!(true));
    check_pages(&server, &browser, "dark").await;
    browser.open(&server.page("app/mask")).await;
    browser.task().await;
    // The corner of the stage shows its ground, next to a dark panel.
    let corner = browser
        .js_async(
            "{ await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))); \
             const canvas = document.querySelector('.stage canvas'); const copy = document.createElement('canvas'); \
             copy.width = copy.height = 1; const context = copy.getContext('2d'); \
             context.drawImage(canvas, 2, 2, 1, 1, 0, 0, 1, 1); \
             return [...context.getImageData(0, 0, 1, 1).data]; }",
        )
        .await;
    assert!(corner[0].as_u64().is_some_and(|red| red < 80), "{corner}");
    browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn playback_waits_for_people_who_want_less_motion() {
    let (server, browser, _dataset) = admin_with(&["--force-prefers-reduced-motion"]).await;
    browser.open(&server.page("app/mask")).await;
    browser.task().await;
    let playing = "return document.querySelector('.viewer').dataset.playing;";
    assert_eq!(browser.js(playing).await, json!("false"));
    browser.press(&[" "]).await;
    browser
        .until(
            "it plays when asked to",
            "document.querySelector('.viewer').dataset.playing === 'true'",
        )
        .await;
    browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tab_leaves_the_stage_and_parts_and_screens_have_keys() {
    let (server, browser, _dataset) = admin().await;
    browser.open(&server.page("app/mask")).await;
    browser.task().await;
    browser
        .until(
            "the stage has the focus",
            "document.activeElement.matches('.stage')",
        )
        .await;
    browser.press(&[keys::TAB]).await;
    let left = browser
        .js("return !document.activeElement.matches('.stage');")
        .await;
    assert_eq!(left, json!(true));
    browser.press(&[keys::ESCAPE, "9", "0"]).await;
    browser
        .until(
            "torso and head are chosen",
            "['TORSO', 'HEAD'].every((name) => document.querySelector(`[data-part=${name}]`).getAttribute('aria-pressed') === 'true')",
        )
        .await;
    let label = browser
        .js("return document.querySelector('.strip').getAttribute('aria-label');")
        .await;
    let label = label.as_str().expect("a label");
    assert!(
        label.contains("left arm:") && (label.contains(" s;") || label.contains("still")),
        "{label}"
    );
    browser.shift(&["3"]).await;
    browser
        .until("pairs are open", "document.querySelector('.work.pair')")
        .await;
    browser.shift(&["0"]).await;
    browser
        .until("the tasks are open", "document.querySelector('.tasks')")
        .await;
    browser.shift(&["1"]).await;
    browser
        .until("home is open", "document.querySelector('.queue')")
        .await;
    browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_cut_and_messages_cover_no_strip() {
    const CUT: &str = "[...document.querySelectorAll('.panel-foot button, .verdicts button, .transport button')] \
        .filter((button) => { const box = button.getBoundingClientRect(); const within = button.closest('.panel, .viewer').getBoundingClientRect(); \
            return box.left < within.left || box.right > within.right || box.bottom > innerHeight || button.scrollWidth > button.clientWidth; }) \
        .map((button) => button.textContent)";
    const COVERED: &str = "[...document.querySelectorAll('.toast')].filter((toast) => { const box = toast.getBoundingClientRect(); \
        return [...document.querySelectorAll('.strips, .transport')].some((other) => { const under = other.getBoundingClientRect(); \
            return box.bottom > under.top && box.top < under.bottom && box.right > under.left && box.left < under.right; }); }).length";
    let (server, browser, _dataset) = admin().await;
    for page in ["app/mask", "app/pair", "app/style"] {
        browser.open(&server.page(page)).await;
        browser.task().await;
        assert_eq!(
            browser.js(&format!("return {CUT};")).await,
            json!([]),
            "{page}"
        );
        // An incomplete answer shows a message.
        browser.control(&[keys::ENTER]).await;
        browser
            .until("a message", "document.querySelector('.toast')")
            .await;
        assert_eq!(
            browser.js(&format!("return {COVERED};")).await,
            json!(0),
            "{page}"
        );
    }
    browser.quit().await;
}

/// Checks names, contrast and the frame of every page.
async fn check_pages(server: &Server, browser: &Browser, theme: &str) {
    for (page, shown) in [
        ("app/home", ".queue"),
        ("app/mask", ".mask-card textarea"),
        ("app/pair", ".verdicts"),
        ("app/style", ".verdicts"),
        ("app/guide", ".guide"),
        ("app/practice", ".page.practice .queue"),
        ("app/mine", ".work.mine .shelf-list"),
        ("app/shelf", ".panel"),
        ("app/review", "#main h1, .candidates"),
        ("app/tasks", ".list-row[data-task]"),
        ("app/task/1", "task-record .facts"),
        ("app/rules", ".dashboard .note"),
        ("app/decisions", "decision-list table"),
        ("app/dashboard", ".dashboard table"),
        ("app/admin", ".numbers"),
    ] {
        browser.open(&server.page(page)).await;
        browser
            .until(page, &format!("document.querySelector('{shown}')"))
            .await;
        assert_eq!(
            browser.js(&format!("return {NAMELESS};")).await,
            json!([]),
            "{page}, {theme}: controls without a name"
        );
        assert_eq!(
            browser.js(&format!("return {FAINT};")).await,
            json!([]),
            "{page}, {theme}: faint text"
        );
        let parts = browser
            .js("return { main: document.querySelectorAll('main').length, lang: document.documentElement.lang, \
                 title: document.title !== '', wide: [document.documentElement, document.querySelector('main')].some((part) => part.scrollWidth > part.clientWidth) };")
            .await;
        assert_eq!(
            parts,
            json!({ "main": 1, "lang": "en", "title": true, "wide": false }),
            "{page}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_focus_goes_round_and_nothing_holds_it() {
    let (server, browser, _dataset) = admin().await;
    browser.open(&server.page("app/mask")).await;
    browser.task().await;
    browser
        .until(
            "the stage has the focus",
            "document.activeElement.matches('.stage')",
        )
        .await;
    let mut seen = Vec::new();
    for _ in 0..3 {
        browser.press(&[keys::F6]).await;
        let at = browser
            .js("const at = document.activeElement; return at.closest('nav') ? 'nav' : at.closest('.panel') ? 'panel' : at.closest('.viewer') ? 'viewer' : at.tagName;")
            .await;
        seen.push(at.as_str().expect("a name").to_owned());
    }
    seen.sort();
    assert_eq!(seen, ["nav", "panel", "viewer"], "F6 visits every region");
    // On a control, the browser handles Tab: focus moves on and never gets stuck.
    browser.press(&[keys::F6]).await;
    browser
        .js("document.querySelector('.panel-foot button').focus();")
        .await;
    browser.press(&[keys::TAB]).await;
    let at = browser
        .js("return document.activeElement.textContent;")
        .await;
    assert!(at.as_str().expect("a text").contains("Skip"), "{at}");
    // Escape moves the focus back to the stage, also from a text.
    browser.press(&[keys::ESCAPE]).await;
    browser
        .until(
            "the stage has the focus",
            "document.activeElement.matches('.stage')",
        )
        .await;
    browser.press(&["t"]).await;
    browser
        .until(
            "the text has the focus",
            "document.activeElement.matches('textarea')",
        )
        .await;
    browser.press(&[keys::ESCAPE]).await;
    browser
        .until(
            "the stage has the focus",
            "document.activeElement.matches('.stage')",
        )
        .await;
    browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_click_the_keys_go_on_working() {
    let (server, browser, _dataset) = admin().await;
    browser.open(&server.page("app/mask")).await;
    browser.task().await;
    let button = browser
        .client()
        .find(fantoccini::Locator::Css(".cameras button"))
        .await
        .expect("a button");
    button.click().await.expect("it can be clicked");
    browser
        .until(
            "the stage has the focus",
            "document.activeElement.matches('.stage')",
        )
        .await;
    browser.press(&["4"]).await;
    browser
        .until("the key works", "document.querySelector('[data-part=LEFT_ARM]').getAttribute('aria-pressed') === 'true'")
        .await;
    browser.quit().await;
}
