//! The guide: beside a task, and as a page that project owners edit.

use std::io::Write;

use annotate_browser::keys;
use serde_json::json;

use crate::steps::{CUT, Desk};

const HOSTILE: &str = "<img src=x onerror=\"window.canary=1\"><script>window.canary=1</script>";

/// A PNG image of one grey pixel.
const POINT: &[u8] = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x01\0\0\0\x01\x08\0\0\0\0:~\x9bU\0\0\0\nIDATx\x9cc`\0\0\0\x02\0\x01H\xaf\xa4q\0\0\0\0IEND\xaeB`\x82";

#[test]
fn the_guide_opens_beside_the_work_and_takes_no_focus() {
    let desk = Desk::at("app/mask");
    let task = desk.task();
    desk.write(&["4", "t"], "waving");
    desk.press(&[keys::LEFT, keys::LEFT, keys::LEFT, keys::F4]);
    desk.shows(".guide-beside p");
    let words = ["actively take part", "The person is …"];
    desk.reads(".guide-beside", &words);
    // The caret stays where it was.
    desk.type_text("!");
    desk.until(
        "the text goes on",
        "document.querySelector('.mask-card.selected textarea').value === 'wav!ing'",
    );
    assert_eq!(desk.task(), task);
    assert_eq!(desk.value(CUT), json!([]), "nothing is cut");
    desk.picture("guide-beside");
    // The button leaves the focus in the text as well.
    desk.click_with_mouse(".guide-button");
    desk.lacks(".guide-beside");
    desk.focuses("textarea");
    // The guide is a separate region, and stays open on the next task.
    desk.press(&[keys::ESCAPE, keys::F4]);
    desk.shows(".guide-beside p");
    desk.press(&["p"]);
    desk.next_task(task);
    desk.shows(".guide-beside p");
    assert!(desk.reaches(".guide-beside"), "F6 does not reach the guide");
}

#[test]
fn an_admin_writes_the_guide_with_pictures_and_all_of_it_stays_text() {
    const SECTION: &str = ".card[data-guide=pair]";
    const CAPTION: &str = ".picture-rows input";
    let desk = Desk::of(&["ann", "boss"]);
    let mut file = tempfile::Builder::new();
    let file = file.prefix("right arm ").suffix(".png").tempfile();
    let mut file = file.expect("a file");
    file.write_all(POINT).expect("a picture");
    let edit = || {
        desk.shows(SECTION);
        desk.press_button(SECTION, "Edit");
    };
    let save = || desk.press_button(SECTION, "Save");

    desk.enter("boss", "app/guide/pair");
    edit();
    desk.focuses(".guide-editor textarea");
    desk.js("document.activeElement.select();");
    desk.type_text("Say what differs.");
    desk.write(&[keys::ENTER], &format!("- {HOSTILE}"));
    desk.says(".guide-preview li", "<script>");
    let path = file.path().to_str().expect("a path");
    desk.choose_file(".guide-editor input[type=file]", path);
    desk.focuses(CAPTION);
    // A picture without a caption is not saved.
    save();
    desk.says(".toast", "caption");
    desk.focus(CAPTION);
    desk.type_text(HOSTILE);
    desk.js("const right = document.querySelector('.picture-rows select'); right.value = 'wrong'; right.dispatchEvent(new Event('change'));");
    // Written text survives a reload.
    desk.go("app/guide/pair");
    edit();
    desk.until(
        "the text is there",
        "document.querySelector('.guide-editor textarea')?.value.startsWith('Say what differs.') && document.querySelector('.picture-rows li')",
    );
    desk.picture("guide-editor");
    save();
    desk.lacks(".guide-editor");
    desk.until(
        "it is saved",
        "document.querySelector('.example img')?.naturalWidth === 1",
    );

    desk.log_out();
    desk.enter("ann", "app/guide/pair");
    desk.until(
        "the picture",
        "document.querySelector('.example.wrong img')?.naturalWidth === 1",
    );
    desk.reads(SECTION, &["✗ Wrong", HOSTILE]);
    desk.check_canary("the guide", 1);
    desk.is(
        "[...document.querySelectorAll('button')].some((button) => button.textContent === 'Edit')",
        false,
    );
    desk.picture("guide-picture");

    desk.log_out();
    desk.enter("boss", "app/guide/pair");
    edit();
    desk.click(&format!("{SECTION} .picture-rows button.danger"));
    save();
    desk.until_stored("the picture is gone", "guide/pictures", |pictures| {
        *pictures == json!([])
    });
}
