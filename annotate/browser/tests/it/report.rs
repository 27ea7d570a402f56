//! The report page of a run, opened as a file: its viewers draw, use one clock each, and need no network.

use annotate_browser::{Browser, Graphics, keys, report_page};

/// The viewer at the top of the page, and the viewer of all items.
const VIEWERS: [&str; 2] = ["opening-viewer", "viewer"];

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

/// Checks that hold with and without WebGL.
fn check(graphics: Graphics, renderer: &str, name: &str) {
    let browser = Browser::start(graphics, &[]);
    browser.open(&format!("file://{}", report_page().display()));
    for viewer in VIEWERS {
        browser.shows(&format!("#{viewer}[data-renderer={renderer}]"));
        browser.until("it draws", &format!("{} >= 0", frame(viewer)));
    }
    let [opening, items] = VIEWERS;
    browser.until("the opening plays", &format!("{} > 1", frame(opening)));
    // A viewer outside the window is paused.
    browser.is(&frame(items), 0);
    let labels = |viewer: &str| browser.count(&format!("#{viewer} .labels span"));
    assert_eq!(labels(opening), 3);
    assert!(labels(items) >= 3, "original, edit and target");
    for viewer in VIEWERS {
        check_viewer(&browser, viewer);
        browser.picture(&format!("{name}-{viewer}"));
    }
    // The page loads no other files.
    browser.is("performance.getEntriesByType('resource').length", 0);
    assert!(browser.count("table") > 0 && browser.count("svg") > 0);
    browser.is("document.documentElement.scrollWidth > innerWidth", false);
}

/// Plays a viewer, and steps it by keys.
fn check_viewer(browser: &Browser, viewer: &str) {
    let shown = frame(viewer);
    let at = |frame: &str| browser.until(frame, &format!("{shown} === {frame}"));
    browser.js(&format!(
        "document.querySelector('#{viewer}').scrollIntoView();"
    ));
    // The report's animation plays by itself; a key stops it, and steps are exact.
    browser.until("it plays", &format!("{shown} > 1"));
    browser.focus(&format!("#{viewer} canvas"));
    browser.press(&[" ", keys::HOME]);
    at("0");
    browser.press(&[keys::RIGHT, keys::RIGHT, keys::LEFT]);
    at("1");
    browser.shift(&[keys::RIGHT]);
    at("11");
    browser.press(&[keys::END]);
    at(&format!(
        "Number(document.querySelector('#{viewer} input[type=range]').max)"
    ));
    let colours = browser.js_async(COLOURS);
    assert!(
        colours.as_u64() > Some(30),
        "the picture is flat: {colours} colours"
    );
}

#[test]
fn a_report_plays_its_motions_in_3d_without_a_server() {
    check(Graphics::Software, "webgl2", "report");
}

#[test]
fn a_report_plays_its_motions_without_webgl() {
    check(Graphics::None, "canvas2d", "report-flat");
}
