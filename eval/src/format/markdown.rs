//! Tables for a README or an issue.

use super::{ABSENT, row_name};
use crate::table::Table;

/// Writes tables one below the other, each under a heading with its task.
pub fn render(tables: &[Table]) -> String {
    let texts: Vec<String> = tables.iter().map(table_text).collect();
    texts.join("\n")
}

fn table_text(table: &Table) -> String {
    let mut text = format!("### {}\n\n", escaped(&table.task));
    if let Some(reason) = &table.unranked {
        text.push_str(&format!("{}\n\n", escaped(reason)));
    }
    text.push_str(&format!("{}\n\n", escaped(&table.conditions())));
    text.push_str("| System |");
    for column in &table.columns {
        text.push_str(&format!(" {} |", column.label()));
    }
    text.push_str("\n| :-- |");
    text.push_str(&" --: |".repeat(table.columns.len()));
    text.push('\n');
    for row in &table.rows {
        text.push_str(&format!("| {} |", escaped(&row_name(row))));
        for (cell, column) in row.cells.iter().zip(&table.columns) {
            let Some(cell) = cell else {
                text.push_str(&format!(" {ABSENT} |"));
                continue;
            };
            let metric = column.metric;
            let value = format!("{} {}", cell.mean_text(metric), cell.ci_text(metric));
            let bold = if cell.best { "**" } else { "" };
            text.push_str(&format!(" {bold}{}{bold} |", value.trim_end()));
        }
        text.push('\n');
    }
    for note in &table.notes {
        text.push_str(&format!("\n{}\n", escaped(note)));
    }
    text
}

/// Escapes the characters that are special in Markdown and in the HTML within it.
fn escaped(text: &str) -> String {
    let mut result = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '<' => result.push_str("&lt;"),
            '>' => result.push_str("&gt;"),
            '&' => result.push_str("&amp;"),
            '\\' | '|' | '*' | '_' | '`' | '[' | ']' | '#' => {
                result.push('\\');
                result.push(c);
            }
            c if c.is_control() => result.push(' '),
            c => result.push(c),
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::tests::sample_table;

    /// The cells of a line, split at bars that are not escaped.
    fn cells(line: &str) -> Vec<String> {
        let line = line.replace("\\|", "\u{0}");
        let cells = line.trim_matches('|').split('|');
        cells
            .map(|cell| cell.trim().replace('\u{0}', "\\|"))
            .collect()
    }

    #[test]
    fn cells_stand_in_their_columns() {
        let mut table = sample_table();
        table.rows[1].cells[2] = None;
        let labels: Vec<String> = table.columns.iter().map(|column| column.label()).collect();
        let text = render(&[table]);
        let rows = text.lines().filter(|line| line.starts_with('|'));
        let rows: Vec<Vec<String>> = rows.map(cells).collect();
        // Header, rule and four systems.
        assert_eq!(rows.len(), 6);
        assert_eq!(rows[0], [vec!["System".to_owned()], labels].concat());
        assert_eq!(rows[1][..2], [":--", "--:"]);
        assert_eq!([&rows[3][0], &rows[3][3]], ["Identity", "–"]);
        let (recall, rank) = ("**90.00 ±0.90**", "**2.22 ±0.02**");
        let best = [
            "ours\\_100%\\|&lt;b&gt;",
            "**2.222 ±0.022**",
            "**32.45 ±0.32**",
            "**0.900 ±0.009**",
        ];
        let ranks = [recall, recall, recall, rank, recall, recall, recall, rank];
        assert_eq!(rows[5], [&best[..], &ranks].concat());
        let note = text.lines().last().expect("a note");
        assert!(note.starts_with("Behind the identity editor, which returns"));
    }
}
