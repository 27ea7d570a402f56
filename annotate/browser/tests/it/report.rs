//! The report page of a run, opened as a file: its viewers draw, use one clock each, and need no network.

use annotate_browser::{Browser, Graphics, keys, report_page};
use serde_json::json;

/// The viewer of the edit that the page opens with, and that of all items.
const VIEWERS: [&str; 2] = ["opening-viewer", "viewer"];

/// The frame that a viewer shows.
fn frame(viewer: &str) -> String {
    format!("Number(document.querySelector('#{viewer} canvas').dataset.frame)")
}

/// Redraws the viewer in focus and counts the colours of a small copy.
const COLOURS: &str = "{ const canvas = document.activeElement; \
    canvas.dispatchEvent(new KeyboardEvent('keydown', { key: 'Home', bubbles: true })); \
    return await new Promise((done) => requestAnimationFrame(() => { \
        const copy = document.createElement('canvas'); \
        copy.width = 300; copy.height = 200; \
        const context = copy.getContext('2d'); \
        context.drawImage(canvas, 0, 0, 300, 200); \
        const data = context.getImageData(0, 0, 300, 200).data; \
        const seen = new Set(); \
        for (let i = 0; i < data.length; i += 4) seen.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]); \
        done(seen.size); })); }";

async fn opened(graphics: Graphics, renderer: &str) -> Browser {
    let browser = Browser::start(graphics).await;
    browser
        .open(&format!("file://{}", report_page().await.display()))
        .await;
    for viewer in VIEWERS {
        let renders =
            format!("document.querySelector('#{viewer}')?.dataset.renderer === '{renderer}'");
        browser
            .until(
                "the viewer draws",
                &format!("{renders} && {} >= 0", frame(viewer)),
            )
            .await;
    }
    browser
}

/// Checks that hold with and without WebGL.
async fn check(browser: &Browser, name: &str) {
    let [opening, items] = VIEWERS;
    browser
        .until("the opening plays", &format!("{} > 1", frame(opening)))
        .await;
    let hidden = browser.js(&format!("return {};", frame(items))).await;
    assert_eq!(hidden, json!(0), "a viewer out of sight stands still");
    let labels = |viewer: &str| {
        format!("return document.querySelectorAll('#{viewer} .labels span').length;")
    };
    assert_eq!(browser.js(&labels(opening)).await, json!(3));
    let motions = browser.js(&labels(items)).await;
    assert!(
        motions.as_u64().is_some_and(|count| count >= 3),
        "original, edit and target: {motions}"
    );
    for viewer in VIEWERS {
        check_viewer(browser, viewer).await;
        browser.picture(&format!("{name}-{viewer}")).await;
    }
    assert_eq!(
        browser
            .js("return performance.getEntriesByType('resource').length;")
            .await,
        json!(0),
        "the page loads something"
    );
    let page = browser
        .js("return { tables: document.querySelectorAll('table').length, pictures: document.querySelectorAll('svg').length, \
             wide: document.documentElement.scrollWidth > innerWidth };")
        .await;
    assert!(page["tables"].as_u64() > Some(0), "{page}");
    assert!(page["pictures"].as_u64() > Some(0), "{page}");
    assert_eq!(page["wide"], false);
}

/// Plays a viewer, and steps it by keys.
async fn check_viewer(browser: &Browser, viewer: &str) {
    let shown = frame(viewer);
    browser
        .js(&format!(
            "document.querySelector('#{viewer}').scrollIntoView();"
        ))
        .await;
    // It plays by itself; a key stops it, and steps are exact.
    browser.until("it plays", &format!("{shown} > 1")).await;
    browser
        .js(&format!(
            "document.querySelector('#{viewer} canvas').focus();"
        ))
        .await;
    browser.press(&[" ", keys::HOME]).await;
    browser
        .until("the first frame", &format!("{shown} === 0"))
        .await;
    browser.press(&[keys::RIGHT, keys::RIGHT, keys::LEFT]).await;
    browser
        .until("the second frame", &format!("{shown} === 1"))
        .await;
    browser.shift(&[keys::RIGHT]).await;
    browser
        .until("ten further", &format!("{shown} === 11"))
        .await;
    browser.press(&[keys::END]).await;
    browser
        .until(
            "the last frame",
            &format!(
                "{shown} === Number(document.querySelector('#{viewer} input[type=range]').max)"
            ),
        )
        .await;
    let colours = browser.js_async(COLOURS).await;
    assert!(
        colours.as_u64().is_some_and(|count| count > 30),
        "the picture is flat: {colours} colours"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_report_plays_its_motions_in_3d_without_a_server() {
    let browser = opened(Graphics::Software, "webgl2").await;
    check(&browser, "report").await;
    browser.quit().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_report_plays_its_motions_without_webgl() {
    let browser = opened(Graphics::None, "canvas2d").await;
    check(&browser, "report-flat").await;
    browser.quit().await;
}
