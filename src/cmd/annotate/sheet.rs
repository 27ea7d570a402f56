//! The performers' sheet: a self-contained HTML page to send, read on a phone, and print.

use std::collections::BTreeMap;
use std::path::Path;

use annotate::store::Store;
use annotate::wire::{CaptureCell, Captures, Style};
use eval::draw::escaped;
use serde_json::json;

use crate::exit::Exit;
use crate::global::Global;
use crate::local;

/// Beginning of the page, up to its title.
const BEGIN: &str = "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
    <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<style>\n\
    body { max-width: 40em; margin: 0 auto; padding: 1em; font: 17px/1.5 system-ui, sans-serif; }\n\
    h2 { margin-top: 2em; border-bottom: 1px solid; }\n\
    ul { padding: 0; list-style: none; }\n\
    li { margin-bottom: 0.5em; padding-left: 1.6em; text-indent: -1.6em; }\n\
    li { break-inside: avoid; overflow-wrap: anywhere; }\n\
    .mark { display: inline-block; width: 0.8em; height: 0.8em; margin-right: 0.4em; print-color-adjust: exact; }\n\
    .note { font-style: italic; }\n\
    @media print { body { padding: 0; font-size: 11pt; } h2 { break-after: avoid; } }\n\
    </style>\n";

pub(super) fn write_sheet(
    store: &Store,
    captures: &Captures,
    path: &Path,
    global: &Global,
) -> anyhow::Result<Exit> {
    let settings = store.settings()?;
    let motions = store.all_motions()?;
    let captions: Captions<'_> = motions
        .iter()
        .map(|motion| (motion.id.as_str(), motion.captions.as_slice()))
        .collect();
    let page = page(&settings.name, &settings.styles, &captures.cells, &captions);
    local::write(path, page.as_bytes())?;
    let document = json!({ "sheet": path, "bytes": page.len() });
    let text = format!("{} ({} kB)", path.display(), page.len() / 1000);
    global.say(&document, &text)
}

type Captions<'a> = BTreeMap<&'a str, &'a [String]>;

/// The page: a section for each style that has a guideline or something to capture.
fn page(project: &str, styles: &[Style], cells: &[CaptureCell], captions: &Captions<'_>) -> String {
    let missing: u32 = cells.iter().map(|cell| cell.missing).sum();
    let project = escaped(project);
    let mut page = format!(
        "{BEGIN}<title>Captures for {project}</title>\n</head>\n<body>\n<h1>Captures for {project}</h1>\n\
         <p>Takes still to capture: {missing}</p>\n"
    );
    let mut styles = styles.to_vec();
    for cell in cells {
        // An admin may have removed the style from the project since the cell was planned.
        if !styles.iter().any(|style| style.name == cell.style) {
            styles.push(Style::named(&cell.style));
        }
    }
    for style in &styles {
        let open: Vec<&CaptureCell> = cells
            .iter()
            .filter(|cell| cell.style == style.name && cell.missing > 0)
            .collect();
        if !open.is_empty() || !style.guideline.is_empty() {
            page += &section(style, &open, captions);
        }
    }
    page + "</body>\n</html>\n"
}

fn section(style: &Style, open: &[&CaptureCell], captions: &Captions<'_>) -> String {
    let mark = style.colour.as_ref().map_or(String::new(), |colour| {
        let colour = escaped(colour);
        format!("<span class=\"mark\" style=\"background: {colour}\"></span>")
    });
    let mut text = format!("<section>\n<h2>{mark}{}</h2>\n", escaped(&style.name));
    let texts = [&style.text, &style.guideline];
    for paragraph in texts.iter().flat_map(|text| paragraphs(text)) {
        text += &format!("<p>{}</p>\n", escaped(&paragraph));
    }
    if !open.is_empty() {
        let lines: Vec<String> = open.iter().map(|cell| line(cell, captions)).collect();
        text += &format!("<h3>Still to capture</h3>\n<ul>\n{}</ul>\n", lines.concat());
    }
    text + "</section>\n"
}

/// A motion that is still to capture, with a box to tick.
fn line(cell: &CaptureCell, captions: &Captions<'_>) -> String {
    let takes = match cell.missing {
        1 => "1 take".to_owned(),
        takes => format!("{takes} takes"),
    };
    let said = match captions.get(cell.motion.as_str()) {
        Some(captions) if !captions.is_empty() => format!(": {}", escaped(&captions.join("; "))),
        _ => String::new(),
    };
    let notes: String = notes(cell)
        .iter()
        .map(|note| format!(" <span class=\"note\">({note})</span>"))
        .collect();
    let motion = escaped(&cell.motion);
    format!("<li>\u{2610} <strong>{motion}</strong>, {takes}{said}{notes}</li>\n")
}

/// Notes on a cell with missing takes.
pub(super) fn notes(cell: &CaptureCell) -> Vec<&'static str> {
    let mut notes = Vec::new();
    if cell.rejected > 0 {
        notes.push("rejected, capture again");
    }
    if !cell.known {
        notes.push("the project has no motion of this id");
    }
    notes
}

/// The paragraphs of a text; an empty line ends a paragraph.
fn paragraphs(text: &str) -> Vec<String> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    lines
        .split(|line| line.is_empty())
        .filter(|lines| !lines.is_empty())
        .map(|lines| lines.join(" "))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sheet_has_a_section_for_each_style_to_perform_and_no_markup_of_the_data() {
        let styles = [
            Style {
                text: "Stiff.".to_owned(),
                guideline: "Bend the knees,\nand keep them bent.\r\n\r\nDo not <limp>.".to_owned(),
                colour: Some("#8f6b00".to_owned()),
                ..Style::named("old")
            },
            Style::named("proud"),
            Style::named("angry"),
        ];
        let cell = |style: &str, missing, rejected| CaptureCell {
            motion: "walk & turn".to_owned(),
            style: style.to_owned(),
            takes: 2,
            arrived: 2 - missing,
            rejected,
            missing,
            known: true,
        };
        let said = ["a person walks".to_owned()];
        let captions = BTreeMap::from([("walk & turn", &said[..])]);
        let cells = [cell("proud", 2, 1), cell("angry", 0, 0)];
        let page = page("lab", &styles, &cells, &captions);
        for part in [
            "<p>Takes still to capture: 2</p>",
            "<p>Stiff.</p>\n<p>Bend the knees, and keep them bent.</p>\n<p>Do not &lt;limp&gt;.</p>",
            "<strong>walk &amp; turn</strong>, 2 takes: a person walks <span class=\"note\">(rejected, capture again)",
        ] {
            assert!(page.contains(part), "{part} in {page}");
        }
        // The angry cell is complete.
        assert_eq!(page.matches("<section>").count(), 2, "{page}");
    }
}
