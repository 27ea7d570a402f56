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
    let dataset = Dataset::fresh().await;
    let server = Server::start(&dataset).await;
    let browser = Browser::start(Graphics::Software).await;
    let token = server.printed_token().to_owned();
    browser.log_in(&server, &token, "app/home").await;
    (server, browser, dataset)
}

#[tokio::test(flavor = "multi_thread")]
async fn every_page_has_names_contrast_and_one_main_part() {
    let (server, browser, _dataset) = admin().await;
    for (page, shown) in [
        ("app/home", ".queue"),
        ("app/mask", ".mask-card textarea"),
        ("app/pair", ".verdicts"),
        ("app/style", ".verdicts"),
        ("app/guide", ".guide"),
        ("app/shelf", ".panel"),
        ("app/review", "#main h1, .candidates"),
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
            "{page}: controls without a name"
        );
        assert_eq!(
            browser.js(&format!("return {FAINT};")).await,
            json!([]),
            "{page}: faint text"
        );
        let parts = browser
            .js("return { main: document.querySelectorAll('main').length, lang: document.documentElement.lang, \
                 title: document.title !== '', wide: document.documentElement.scrollWidth > innerWidth };")
            .await;
        assert_eq!(
            parts,
            json!({ "main": 1, "lang": "en", "title": true, "wide": false }),
            "{page}"
        );
    }
    browser.quit().await;
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
