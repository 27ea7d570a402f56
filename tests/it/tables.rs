//! Result tables as `--format markdown` prints them, read back into cells.

use serde_json::Value;

/// One table.
#[derive(Debug)]
pub(crate) struct Table {
    /// The task, or the title of a table of times.
    pub(crate) heading: String,
    /// Reason why the encoder cannot rank systems.
    pub(crate) unranked: Option<String>,
    /// The conditions of measurement; empty if none are printed.
    pub(crate) conditions: String,
    /// Names of the columns.
    pub(crate) head: Vec<String>,
    /// Cells, row by row.
    pub(crate) rows: Vec<Vec<String>>,
    /// Sentences below the table.
    pub(crate) notes: Vec<String>,
}

impl Table {
    /// Names of the rows.
    pub(crate) fn names(&self) -> Vec<&str> {
        self.rows.iter().map(|row| row[0].as_str()).collect()
    }

    /// The cells of a row without its name.
    pub(crate) fn row(&self, name: &str) -> Vec<&str> {
        let row = self.rows.iter().find(|row| row[0] == name);
        let row = row.unwrap_or_else(|| panic!("{name}: {self:?}"));
        row[1..].iter().map(String::as_str).collect()
    }

    /// Checks that the measured rows are `names`, with exactly the values of `scores`: the rows of
    /// `stance eval --json` on the same edits.
    pub(crate) fn check_measured(&self, names: &[&str], scores: &Value) {
        assert_eq!(self.names()[..names.len()], *names, "{self:?}");
        for row in &self.rows[..names.len()] {
            for (cell, label) in row.iter().zip(&self.head).skip(1) {
                let (metric, _arrow) = label.rsplit_once(' ').expect("a metric and its arrow");
                let score = scores.as_array().expect("rows").iter().find(|score| {
                    score["system"] == row[0]
                        && score["task"] == self.heading
                        && score["metric"] == metric
                });
                let expected = score.map_or_else(|| "–".to_owned(), printed);
                assert_eq!(cell.trim_matches('*'), expected, "{} {label}", row[0]);
            }
        }
    }
}

/// The cell of a row of `stance eval --json`, without the mark of the best value.
pub(crate) fn printed(score: &Value) -> String {
    let name = score["metric"].as_str().expect("a name");
    let decimals = eval::metric::from_name(name).expect("a metric").decimals;
    let mean = score["mean"].as_f64().expect("a number");
    match score["ci95"].as_f64() {
        Some(ci95) => format!("{mean:.decimals$} ±{ci95:.decimals$}"),
        None => format!("{mean:.decimals$}"),
    }
}

/// Reads all tables of a text.
pub(crate) fn tables(text: &str) -> Vec<Table> {
    let parts = text.split("### ").skip(1);
    parts
        .map(|part| {
            let (heading, body) = part.split_once('\n').expect("a line");
            let (above, rest) = body.split_once('|').expect("a table");
            let above = above.trim();
            let (unranked, above) = match above.split_once("\n\n") {
                Some((reason, conditions)) => (Some(unescaped(reason)), conditions),
                None => (None, above),
            };
            let (grid, notes) = rest.split_once("\n\n").unwrap_or((rest, ""));
            let mut lines = grid.lines().map(cells);
            let head = lines.next().expect("a head");
            let _rule = lines.next().expect("a rule");
            let rows: Vec<Vec<String>> = lines.collect();
            assert!(rows.iter().all(|row| row.len() == head.len()), "{part}");
            Table {
                heading: heading.to_owned(),
                unranked,
                conditions: unescaped(above),
                head,
                rows,
                notes: notes
                    .lines()
                    .filter(|line| !line.is_empty())
                    .map(unescaped)
                    .collect(),
            }
        })
        .collect()
}

/// The cells of a line, without its first and last bar.
pub(crate) fn cells(line: &str) -> Vec<String> {
    let line = line.strip_prefix('|').unwrap_or(line);
    let line = line.strip_suffix('|').unwrap_or(line).replace("\\|", "\0");
    let cells = line.split('|');
    let cells = cells.map(|cell| unescaped(&cell.replace('\0', "|")));
    cells.collect()
}

/// A text without the escapes of Markdown.
fn unescaped(text: &str) -> String {
    text.trim()
        .replace('\\', "")
        .replace("&lt;", "<")
        .replace("&gt;", ">")
        .replace("&amp;", "&")
}
