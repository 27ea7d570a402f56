//! Users in bulk.

use annotate_browser::{Browser, Dataset};
use serde_json::json;

use crate::steps::Desk;

fn type_lines(browser: &Browser, lines: &str) {
    browser.js(&format!(
        "const field = document.querySelector('newcomers-form textarea'); field.value = {}; \
         field.dispatchEvent(new InputEvent('input', {{ bubbles: true }}));",
        json!(lines)
    ));
}

#[test]
fn a_team_is_added_from_lines_and_each_link_logs_one_person_in() {
    const FORM: &str = "newcomers-form";
    const ADD: &str = "document.querySelector('newcomers-form button.primary')";
    const LINKS: &str =
        "[...document.querySelectorAll('newcomers-form input.link')].map((own) => own.value)";
    let desk = Desk::admin(Dataset::fresh(), &[]);
    desk.page("app/admin", "newcomers-form textarea");
    let users = desk.get("users");
    let taken = users[0]["name"].as_str().expect("a name");
    type_lines(&desk, &format!("cleo\n{taken}\ndora,captain"));
    desk.has("newcomers-form tbody .trouble", 2);
    let known = "there is a user of this name already";
    desk.reads("newcomers-form table", &[known, "“captain” is no role"]);
    desk.is(&format!("{ADD}.disabled"), true);
    type_lines(&desk, "cleo\ndora,reviewer\n");
    desk.press_button(FORM, "Add 2 people");
    desk.has("newcomers-form input.link", 2);
    let links = desk.value(LINKS);
    desk.reads(FORM, &["shown only now"]);
    let people =
        desk.value("[...document.querySelectorAll('tbody th')].map((own) => own.innerText)");
    for name in ["cleo", "dora"] {
        let listed = people
            .as_array()
            .is_some_and(|all| all.contains(&json!(name)));
        assert!(listed, "{name} is in the table of people: {people}");
    }
    // The downloaded file contains the new users too.
    let file = desk.js_async(
        "{ let blob = null; const make = URL.createObjectURL; URL.createObjectURL = (own) => { blob = own; return make.call(URL, own); }; \
           [...document.querySelectorAll('newcomers-form button')].find((own) => own.textContent.trim() === 'Download as CSV').click(); \
           return blob.text(); }",
    );
    let dora = links[1].as_str().expect("a link");
    let file = file.as_str().expect("a text");
    let head = "name,role,link,ends\r\ncleo,annotator,http";
    assert!(file.starts_with(head) && file.contains(dora), "{file}");
    desk.press_button(FORM, "Done, hide the links");
    desk.lacks("newcomers-form input.link");
    desk.log_out();
    desk.open(dora);
    desk.says("header .who", "dora · reviewer");
}
