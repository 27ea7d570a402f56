//! The guide: beside the work, and as a page that its owner writes.

use std::io::Write;

use annotate_browser::{Browser, Dataset, Graphics, Server, keys};
use fantoccini::Locator;
use serde_json::json;

use crate::steps::Desk;

const HOSTILE: &str = "<img src=x onerror=\"window.canary=1\"><script>window.canary=1</script>";

/// A picture of one grey point.
const POINT: &[u8] = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x01\0\0\0\x01\x08\0\0\0\0:~\x9bU\0\0\0\nIDATx\x9cc`\0\0\0\x02\0\x01H\xaf\xa4q\0\0\0\0IEND\xaeB`\x82";

#[tokio::test(flavor = "multi_thread")]
async fn the_guide_opens_beside_the_work_and_takes_no_focus() {
    const CUT: &str = "return [...document.querySelectorAll('.panel-foot button, .transport button')] \
        .filter((button) => { const box = button.getBoundingClientRect(); const within = button.closest('.panel, .viewer').getBoundingClientRect(); \
            return box.left < within.left || box.right > within.right || box.bottom > innerHeight || button.scrollWidth > button.clientWidth; }) \
        .map((button) => button.textContent);";
    let desk = Desk::open("app/mask").await;
    let browser = &desk.browser;
    let task = browser.task().await;
    browser.press(&["4", "t"]).await;
    browser.type_text("waving").await;
    browser
        .press(&[keys::LEFT, keys::LEFT, keys::LEFT, keys::F4])
        .await;
    browser
        .until("the guide", "document.querySelector('.guide-beside p')")
        .await;
    let guide = browser.text_of(".guide-beside").await;
    assert!(
        guide.contains("actively take part") && guide.contains("The person is …"),
        "{guide}"
    );
    // The caret stays where it was.
    browser.type_text("!").await;
    browser
        .until(
            "the text goes on",
            "document.querySelector('.mask-card.selected textarea').value === 'wav!ing'",
        )
        .await;
    assert_eq!(browser.task().await, task);
    assert_eq!(browser.js(CUT).await, json!([]), "nothing is cut");
    // The button leaves the focus in the text as well.
    let button = browser.client().find(Locator::Css(".guide-button")).await;
    button
        .expect("a button")
        .click()
        .await
        .expect("it can be clicked");
    browser
        .until(
            "it is closed",
            "!document.querySelector('.guide-beside') && document.activeElement.matches('textarea')",
        )
        .await;
    // It is a region of its own, and stays open on the next task.
    browser.press(&[keys::ESCAPE, keys::F4]).await;
    browser
        .until("it is open", "document.querySelector('.guide-beside p')")
        .await;
    browser.press(&["p"]).await;
    browser.next_task(task).await;
    browser
        .until("it stays", "document.querySelector('.guide-beside p')")
        .await;
    let mut reached = false;
    for _ in 0..5 {
        browser.press(&[keys::F6]).await;
        let inside = browser
            .js("return document.activeElement.closest('.guide-beside') !== null;")
            .await;
        reached |= inside == json!(true);
    }
    assert!(reached, "F6 does not reach the guide");
    desk.browser.quit().await;
}

/// Presses a button of the guide's page by its text.
async fn press_button(browser: &Browser, section: &str, label: &str) {
    let found = browser
        .js_with(
            "const own = [...document.querySelectorAll(arguments[0] + ' button')].find((button) => button.textContent === arguments[1]); own?.click(); return own !== undefined;",
            vec![json!(section), json!(label)],
        )
        .await;
    assert_eq!(found, json!(true), "{section} has no button {label}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_admin_writes_the_guide_with_pictures_and_all_of_it_stays_text() {
    let dataset = Dataset::fresh().await;
    let ann = dataset.add_user("ann", "annotator").await;
    let boss = dataset.add_user("boss", "admin").await;
    let server = Server::start(&dataset).await;
    let browser = Browser::start(Graphics::Software).await;
    let mut file = tempfile::Builder::new()
        .prefix("right arm ")
        .suffix(".png")
        .tempfile()
        .expect("a file");
    file.write_all(POINT).expect("a picture");

    browser.log_in(&server, &boss, "app/guide/pair").await;
    let section = ".card[data-guide=pair]";
    browser
        .until("the guide", &format!("document.querySelector('{section}')"))
        .await;
    press_button(&browser, section, "Edit").await;
    browser
        .until(
            "the text has the focus",
            "document.activeElement.matches('.guide-editor textarea')",
        )
        .await;
    browser.js("document.activeElement.select();").await;
    browser.type_text("Say what differs.").await;
    browser.press(&[keys::ENTER]).await;
    browser.type_text(&format!("- {HOSTILE}")).await;
    browser
        .until(
            "the preview",
            "document.querySelector('.guide-preview li')?.textContent.includes('<script>')",
        )
        .await;
    let input = browser
        .client()
        .find(Locator::Css(".guide-editor input[type=file]"))
        .await
        .expect("a field");
    let path = file.path().to_str().expect("a path");
    input.send_keys(path).await.expect("a file is chosen");
    browser
        .until(
            "the caption is asked for",
            "document.activeElement.matches('.picture-rows input')",
        )
        .await;
    // Without a caption it is not saved.
    press_button(&browser, section, "Save").await;
    browser
        .until(
            "a message",
            "document.querySelector('.toast')?.textContent.includes('caption')",
        )
        .await;
    browser
        .js("document.querySelector('.picture-rows input').focus();")
        .await;
    browser.type_text(HOSTILE).await;
    browser
        .js("const right = document.querySelector('.picture-rows select'); right.value = 'wrong'; right.dispatchEvent(new Event('change'));")
        .await;
    // What is written survives a reload.
    browser.open(&server.page("app/guide/pair")).await;
    browser
        .until("the guide", &format!("document.querySelector('{section}')"))
        .await;
    press_button(&browser, section, "Edit").await;
    browser
        .until(
            "the text is there",
            "document.querySelector('.guide-editor textarea')?.value.startsWith('Say what differs.') && document.querySelector('.picture-rows li')",
        )
        .await;
    browser.picture("guide-editor").await;
    press_button(&browser, section, "Save").await;
    browser
        .until(
            "it is saved",
            "!document.querySelector('.guide-editor') && document.querySelector('.example img')?.naturalWidth === 1",
        )
        .await;

    browser.request("DELETE", "session", None).await;
    browser.log_in(&server, &ann, "app/guide/pair").await;
    browser
        .until(
            "the picture",
            "document.querySelector('.example.wrong img')?.naturalWidth === 1",
        )
        .await;
    let shown = browser.text_of(section).await;
    assert!(
        shown.contains("✗ Wrong") && shown.contains(HOSTILE),
        "{shown}"
    );
    let found = browser
        .js("return { canary: window.canary ?? null, images: document.querySelectorAll('img').length, \
             scripts: document.querySelectorAll('script:not([src])').length, \
             editors: [...document.querySelectorAll('button')].filter((button) => button.textContent === 'Edit').length };")
        .await;
    assert_eq!(
        found,
        json!({ "canary": null, "images": 1, "scripts": 0, "editors": 0 })
    );
    browser.picture("guide-picture").await;

    browser.request("DELETE", "session", None).await;
    browser.log_in(&server, &boss, "app/guide/pair").await;
    browser
        .until("the guide", &format!("document.querySelector('{section}')"))
        .await;
    press_button(&browser, section, "Edit").await;
    press_button(&browser, section, "Remove").await;
    press_button(&browser, section, "Save").await;
    browser
        .until_stored("the picture is gone", "guide/pictures", |pictures| {
            *pictures == json!([])
        })
        .await;
    browser.quit().await;
}
