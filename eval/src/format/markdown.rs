//! Tables for a README or an issue.

use super::{ABSENT, row_name};
use crate::table::Table;

/// Writes tables one below the other, each under a heading of its task.
pub fn render(tables: &[Table]) -> String {
    let mut text = String::new();
    for (index, table) in tables.iter().enumerate() {
        if index > 0 {
            text.push('\n');
        }
        text.push_str(&format!(
            "### {}\n\n{}\n\n",
            escaped(&table.task),
            escaped(&table.conditions())
        ));
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
                let value = cell.map_or_else(
                    || ABSENT.to_owned(),
                    |cell| {
                        let value = format!(
                            "{} {}",
                            cell.mean_text(column.metric),
                            cell.ci_text(column.metric)
                        );
                        if cell.best {
                            format!("**{}**", value.trim_end())
                        } else {
                            value.trim_end().to_owned()
                        }
                    },
                );
                text.push_str(&format!(" {value} |"));
            }
            text.push('\n');
        }
        for note in &table.notes {
            text.push_str(&format!("\n{}\n", escaped(note)));
        }
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

    #[test]
    fn every_line_of_the_table_has_the_same_number_of_cells() {
        let mut table = sample_table();
        table.rows[1].cells[2] = None;
        let text = render(&[table]);
        let rows: Vec<&str> = text.lines().filter(|line| line.starts_with('|')).collect();
        // Head, rule, four systems.
        assert_eq!(rows.len(), 6);
        for row in rows {
            // Two borders and eleven separators besides the system's column; a bar in a name is
            // escaped.
            let bars = row.replace("\\|", "").matches('|').count();
            assert_eq!(bars, 13, "{row}");
        }
        assert!(text.contains("| **2.222 ±0.022** |"), "{text}");
        assert!(text.contains("ours\\_100%\\|&lt;b&gt;"), "{text}");
        assert!(text.contains("| – |"), "{text}");
        assert!(
            text.contains("\n\nBehind the identity editor, which returns"),
            "{text}"
        );
    }
}
