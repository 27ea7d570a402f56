//! Users in bulk.

use annotate_browser::{Browser, Dataset, Graphics, Server};
use serde_json::json;

async fn type_lines(browser: &Browser, lines: &str) {
    browser
        .js_with(
            "const field = document.querySelector('newcomers-form textarea'); field.value = arguments[0]; \
             field.dispatchEvent(new InputEvent('input', { bubbles: true }));",
            vec![json!(lines)],
        )
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_team_is_added_from_lines_and_each_link_logs_one_person_in() {
    let dataset = Dataset::fresh().await;
    let server = Server::start(&dataset).await;
    let browser = Browser::start(Graphics::Software).await;
    browser
        .log_in(&server, server.printed_token(), "app/admin")
        .await;
    browser
        .until(
            "the form",
            "document.querySelector('newcomers-form textarea')",
        )
        .await;
    let users = browser.request("GET", "users", None).await["body"].clone();
    let taken = users[0]["name"].as_str().expect("a name").to_owned();
    let add = "document.querySelector('newcomers-form button.primary')";
    type_lines(&browser, &format!("cleo\n{taken}\ndora,captain")).await;
    browser
        .until(
            "a problem by line",
            "document.querySelectorAll('newcomers-form tbody .trouble').length === 2",
        )
        .await;
    let preview = browser.text_of("newcomers-form table").await;
    assert!(
        preview.contains("there is a user of this name already"),
        "{preview}"
    );
    assert!(preview.contains("“captain” is no role"), "{preview}");
    assert_eq!(
        browser.js(&format!("return {add}.disabled;")).await,
        json!(true)
    );
    type_lines(&browser, "cleo\ndora,reviewer\n").await;
    browser
        .until(
            "two can be added",
            &format!("!{add}.disabled && {add}.textContent === 'Add 2 people'"),
        )
        .await;
    browser.js(&format!("{add}.click();")).await;
    browser
        .until(
            "their links",
            "document.querySelectorAll('newcomers-form input.link').length === 2",
        )
        .await;
    let shown = browser
        .js("const form = document.querySelector('newcomers-form'); \
             return { links: [...form.querySelectorAll('input.link')].map((own) => own.value), said: form.innerText, \
                 people: [...document.querySelectorAll('tbody th')].map((own) => own.innerText) };")
        .await;
    let said = shown["said"].as_str().expect("a text");
    assert!(said.contains("shown only now"), "{said}");
    for name in ["cleo", "dora"] {
        assert!(
            shown["people"]
                .as_array()
                .expect("people")
                .contains(&json!(name)),
            "{name} is in the table of people: {shown}"
        );
    }
    // The file for download holds them too.
    let file = browser
        .js_async(
            "{ let blob = null; const make = URL.createObjectURL; URL.createObjectURL = (own) => { blob = own; return make.call(URL, own); }; \
               [...document.querySelectorAll('newcomers-form button')].find((own) => own.textContent.trim() === 'Download as CSV').click(); \
               return blob.text(); }",
        )
        .await;
    let dora = shown["links"][1].as_str().expect("a link").to_owned();
    let file = file.as_str().expect("a text");
    assert!(
        file.starts_with("name,role,link,ends\r\ncleo,annotator,http"),
        "{file}"
    );
    assert!(file.contains(&dora), "{file}");
    browser
        .js("[...document.querySelectorAll('newcomers-form button')].find((own) => own.textContent.trim().startsWith('Done')).click();")
        .await;
    browser
        .until(
            "the links are gone",
            "!document.querySelector('newcomers-form input.link')",
        )
        .await;
    browser.request("DELETE", "session", None).await;
    browser.open(&dora).await;
    browser
        .until(
            "the link logs her in",
            "document.querySelector('header .who')?.textContent === 'dora · reviewer'",
        )
        .await;
    browser.quit().await;
}
