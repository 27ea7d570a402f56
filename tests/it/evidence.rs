//! Pages of results show the scores that `stance reproduce` recorded, and their verdicts quote them.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::tables::cells;
use crate::util::json_lines;

fn read(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// A page of results: its file, the plan whose record it shows, and the heading above its verdicts, if it has any.
struct Page {
    file: &'static str,
    plan: &'static str,
    verdicts: Option<&'static str>,
}

const PAGES: [Page; 3] = [
    Page {
        file: "eval/RESULTS.md",
        plan: "real-few",
        verdicts: Some("## What is shown, and what is not"),
    },
    Page {
        file: "eval/plans/real-few/RESULTS.md",
        plan: "real-few",
        verdicts: None,
    },
    Page {
        file: "eval/plans/real-small/RESULTS.md",
        plan: "real-small",
        verdicts: Some("## The claims"),
    },
];

/// Maximum number of words of the first page, outside of its tables.
const MOST_WORDS: usize = 1_500;

/// A table of a page.
struct Shown {
    /// Plan of the results.
    plan: String,
    /// Name of the result file that it was copied from, such as `table-1`.
    file: String,
    /// Heading above the table.
    heading: String,
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

/// Cells of a line of a table, without the marks of the best values.
fn unmarked(line: &str) -> Vec<String> {
    let cells = cells(line).into_iter();
    let unmarked = cells.map(|cell| cell.trim_matches('*').to_owned());
    unmarked.collect()
}

/// Tables between `<!-- tables/FILE.md -->`, or `<!-- tables/FILE.md of PLAN -->`, and `<!-- end -->`.
fn shown(document: &str, plan_of_page: &str) -> Vec<Shown> {
    let mut tables: Vec<Shown> = Vec::new();
    let mut copied: Option<(String, String)> = None;
    let mut heading = String::new();
    let mut is_open = false;
    for line in document.lines() {
        let marked = line.strip_prefix("<!-- tables/");
        if let Some(name) = marked.and_then(|rest| rest.strip_suffix(" -->")) {
            let (file, plan) = name.split_once(" of ").unwrap_or((name, plan_of_page));
            let file = file.strip_suffix(".md").expect("a file of Markdown");
            copied = Some((file.to_owned(), plan.to_owned()));
        } else if line == "<!-- end -->" {
            copied = None;
        } else if let Some(text) = line.strip_prefix("### ") {
            heading = text.to_owned();
        }
        let Some((file, plan)) = copied.as_ref().filter(|_| line.starts_with('|')) else {
            is_open = false;
            continue;
        };
        if !is_open {
            tables.push(Shown {
                plan: plan.clone(),
                file: file.clone(),
                heading: heading.clone(),
                head: unmarked(line),
                rows: Vec::new(),
            });
        } else if !line.starts_with("| :--") {
            let rows = tables.last_mut().map(|table| &mut table.rows);
            rows.expect("a table is open").push(unmarked(line));
        }
        is_open = true;
    }
    tables
}

/// The mean and half width of a recorded row, with as many decimals as the cell `like` has.
fn printed(row: &Value, like: &str) -> String {
    let number = |text: &str, value: &Value| {
        let decimals = text.split_once('.').map_or(0, |(_, digits)| digits.len());
        let value = value.as_f64().expect("a number");
        format!("{value:.decimals$}")
    };
    match like.split_once(" ±") {
        Some((mean, half)) => format!(
            "{} ±{}",
            number(mean, &row["mean"]),
            number(half, &row["ci95"])
        ),
        None => {
            assert!(row["ci95"].is_null(), "{row} is shown without its interval");
            number(like, &row["mean"])
        }
    }
}

/// Values of a figure's point as a table shows them; empty for a score of a table.
fn point_of(row: &Value) -> String {
    let values = row["at"].as_array().into_iter().flatten();
    let labels = values.map(|value| match value.as_str() {
        Some(text) => text.to_owned(),
        None => value.to_string(),
    });
    labels.collect::<Vec<_>>().join(", ")
}

#[test]
fn every_number_of_the_results_is_a_recorded_score() {
    for page in PAGES {
        let tables = shown(&read(page.file), page.plan);
        let checked: usize = tables.iter().map(check_numbers).sum();
        assert!(checked > 50, "{checked} cells of {} were found", page.file);
    }
}

/// Checks the numbers of a table, and returns how many there are.
fn check_numbers(table: &Shown) -> usize {
    let record = json_lines(&read(&format!("eval/plans/{}.record.jsonl", table.plan)));
    let is_figure = record.iter().any(|row| row["shown_in"] == *table.heading);
    let mut checked = 0;
    for row in &table.rows {
        for (head, cell) in std::iter::zip(&table.head, row).skip(1) {
            let first = row[0].as_str();
            let (metric, task) = match is_figure {
                true => head.rsplit_once(", ").unwrap_or((head, "all")),
                false => (head.trim_end_matches([' ', '↑', '↓', '→']), &*table.heading),
            };
            let found = record.iter().find(|row| {
                let of_cell = match is_figure {
                    true => row["shown_in"] == *table.heading && point_of(row) == first,
                    false => row["shown_in"] == *table.file && row["system"] == first,
                };
                of_cell && row["task"] == task && row["metric"] == metric
            });
            let place = format!("{} {}: {first}, {head}", table.file, table.heading);
            match found {
                Some(row) => assert_eq!(*cell, printed(row, cell), "{place}"),
                None => assert_eq!(cell, "–", "{place} was not recorded"),
            }
            checked += 1;
        }
    }
    checked
}

#[test]
fn verdicts_of_the_results_quote_their_tables() {
    for page in PAGES {
        let Some(heading) = page.verdicts else {
            continue;
        };
        let document = read(page.file);
        let (_, verdicts) = document.split_once(heading).expect("a section of verdicts");
        let verdicts = verdicts.split("\n## ").next().expect("a section");
        check_quotes(verdicts, &page);
    }
    // The paragraph of README.md that links to the results quotes them too.
    let front = read("README.md");
    let mut paragraphs = front.split("\n\n");
    let headline = paragraphs.find(|text| text.contains("(eval/RESULTS.md)"));
    let headline = headline.expect("the front page names the results");
    check_quotes(headline, &PAGES[0]);
}

fn check_quotes(text: &str, page: &Page) {
    let tables = shown(&read(page.file), page.plan);
    let rows = tables.into_iter().flat_map(|table| table.rows);
    let known: Vec<String> = rows.flatten().collect();
    let is_number = |c: char| c.is_ascii_digit() || c == '.';
    let mut quoted = 0;
    for word in text.split(|c: char| !is_number(c)) {
        let word = word.trim_matches('.');
        if !word.contains('.') {
            continue;
        }
        let is_known = known.iter().any(|cell| {
            let mut numbers = cell.split(|c: char| !is_number(c));
            numbers.any(|number| number == word)
        });
        assert!(is_known, "{word} stands in no table of {}", page.file);
        quoted += 1;
    }
    assert!(quoted > 1, "{quoted} numbers of {} are quoted", page.file);
}

#[test]
fn the_results_are_one_page() {
    let document = read(PAGES[0].file);
    let prose = document.lines().filter(|line| !line.starts_with('|'));
    let words = prose.flat_map(str::split_whitespace).count();
    assert!(words <= MOST_WORDS, "{words} words");
}
