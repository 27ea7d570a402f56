//! The capture plan of a project and its missing takes, as CSV, because plans are made in spreadsheets.

use std::path::Path;

use annotate::store::Store;
use annotate::wire::{CaptureCell, Captures, PlannedCapture};
use anyhow::{Context, bail};
use eval::format::csv::line;
use formats::csv_lines;
use serde_json::json;

use super::shared::now;
use super::sheet::{notes, write_sheet};
use super::users::operator;
use crate::exit::Exit;
use crate::global::Global;
use crate::{local, report};

/// Header of a plan; the last column may be left out.
const HEAD: [&str; 3] = ["motion", "style", "takes"];

/// Stores the plan of a file, or prints the plan or its missing takes, or writes the performers' sheet.
pub(super) fn captures(
    store: &Store,
    file: Option<&Path>,
    missing: bool,
    sheet: Option<&Path>,
    global: &Global,
) -> anyhow::Result<Exit> {
    if let Some(file) = file {
        return take_plan(store, file, global);
    }
    let mut captures = store.captures()?;
    if let Some(path) = sheet {
        return write_sheet(store, &captures, path, global);
    }
    report::note(&summary(&captures));
    let text = if missing {
        captures.cells.retain(|cell| cell.missing > 0);
        missing_lines(&captures.cells)
    } else {
        plan_lines(&captures.cells)
    };
    global.say(&captures, &text)
}

fn take_plan(store: &Store, file: &Path, global: &Global) -> anyhow::Result<Exit> {
    let bytes = local::read(file)?;
    let cells =
        parse(&bytes).with_context(|| format!("in {}; the plan is as it was", file.display()))?;
    store.plan_captures(operator(store)?.id, cells, now(store)?)?;
    let captures = store.captures()?;
    let unknown = captures.cells.iter().filter(|cell| !cell.known).count();
    if unknown > 0 {
        report::note(&format!(
            "{unknown} cells name a motion that the project does not have; they fill once its pairs are imported"
        ));
    }
    let document = json!({ "cells": captures.cells.len(), "unknown_motions": unknown });
    global.say(&document, &summary(&captures))
}

/// Parses the cells of a plan.
///
/// # Errors
/// A line is invalid; the error names it.
fn parse(bytes: &[u8]) -> anyhow::Result<Vec<PlannedCapture>> {
    let mut cells = Vec::new();
    for (place, (number, record)) in csv_lines::records(bytes).enumerate() {
        let record = match record {
            Ok(record) => record,
            Err(reason) => bail!("line {number}: {reason}"),
        };
        let fields: Vec<&str> = record.iter().collect();
        if place == 0 && is_head(&fields) {
            continue;
        }
        let cell = cell(&fields).with_context(|| format!("line {number}"))?;
        cells.push(cell);
    }
    Ok(cells)
}

fn is_head(fields: &[&str]) -> bool {
    let names: Vec<String> = fields.iter().map(|field| field.to_lowercase()).collect();
    names == HEAD || names == HEAD[..2]
}

fn cell(fields: &[&str]) -> anyhow::Result<PlannedCapture> {
    let (motion, style, takes) = match *fields {
        [motion, style] => (motion, style, ""),
        [motion, style, takes] => (motion, style, takes),
        _ => bail!(
            "it has {} fields, expected motion, style and takes with commas between, the last of which may be left out \
             (quote a name with commas)",
            fields.len()
        ),
    };
    for (what, field) in [("motion", motion), ("style", style)] {
        if field.is_empty() {
            bail!("it names no {what}");
        }
    }
    Ok(PlannedCapture {
        motion: motion.to_owned(),
        style: style.to_owned(),
        takes: match takes {
            "" => 1,
            takes => takes
                .parse()
                .with_context(|| format!("its number of takes is {takes:?}"))?,
        },
    })
}

fn plan_lines(cells: &[CaptureCell]) -> String {
    let mut text = line(&HEAD);
    for cell in cells {
        let takes = cell.takes.to_string();
        text += &line(&[&cell.motion, &cell.style, &takes]);
    }
    text.trim_end_matches('\n').to_owned()
}

fn missing_lines(cells: &[CaptureCell]) -> String {
    let mut text = format!("{},note\n", HEAD.join(","));
    for cell in cells {
        let missing = cell.missing.to_string();
        text += &line(&[&cell.motion, &cell.style, &missing, &notes(cell).join("; ")]);
    }
    text.trim_end_matches('\n').to_owned()
}

fn summary(captures: &Captures) -> String {
    if captures.cells.is_empty() {
        return "there is no capture plan; `captures FILE` takes one".to_owned();
    }
    let sum = |count: fn(&CaptureCell) -> u32| captures.cells.iter().map(count).sum::<u32>();
    let (takes, missing) = (sum(|cell| cell.takes), sum(|cell| cell.missing));
    let rejected = sum(|cell| cell.rejected);
    format!(
        "{} of {takes} takes are here, {missing} are still to capture; {rejected} were rejected, {} style pairs are \
         not planned",
        takes - missing,
        captures.unplanned
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_is_read_as_it_is_printed() {
        let text = "\u{feff}Motion,Style,Takes\r\nwalk-1,old,2\r\n\r\n\"jump, high\",\"so \"\"old\"\"\"\r\n\
                    walk-1,proud,\r\n";
        let cells = parse(text.as_bytes()).expect("a plan");
        let cell = |motion: &str, style: &str, takes| PlannedCapture {
            motion: motion.to_owned(),
            style: style.to_owned(),
            takes,
        };
        let expected = [
            cell("walk-1", "old", 2),
            cell("jump, high", "so \"old\"", 1),
            cell("walk-1", "proud", 1),
        ];
        assert_eq!(cells, expected);
        let state = |cell: &PlannedCapture| CaptureCell {
            motion: cell.motion.clone(),
            style: cell.style.clone(),
            takes: cell.takes,
            arrived: 0,
            rejected: 0,
            missing: cell.takes,
            known: true,
        };
        let printed = plan_lines(&cells.iter().map(state).collect::<Vec<_>>());
        assert_eq!(parse(printed.as_bytes()).expect("a plan"), cells);
        let third = "\"jump, high\",\"so \"\"old\"\"\",1";
        assert_eq!(printed.lines().nth(2), Some(third));
    }

    #[test]
    fn a_wrong_line_is_named() {
        for (text, problem) in [
            ("walk-1,old\nwalk-2", "line 2: it has 1 fields"),
            ("motion,style\nwalk-1,", "line 2: it names no style"),
            ("walk-1,old,two", "line 1: its number of takes is \"two\""),
            ("walk-1,old,-1", "line 1: its number of takes is \"-1\""),
            ("walk-1,\"old", "line 1: a quote"),
        ] {
            let error = parse(text.as_bytes()).expect_err(text);
            assert!(format!("{error:#}").starts_with(problem), "{error:#}");
        }
    }
}
