//! LaTeX tables with the rules of the package `booktabs`.

use super::{on_one_line, row_name};
use crate::metric::Better;
use crate::table::Table;

/// Writes tables as `tabular` environments. They need `\usepackage{booktabs}`.
pub fn render(tables: &[Table]) -> String {
    let texts: Vec<String> = tables.iter().map(table_text).collect();
    texts.join("\n")
}

fn table_text(table: &Table) -> String {
    let mut text = String::new();
    if let Some(reason) = &table.unranked {
        // A comment ends with its line.
        text.push_str(&format!(
            "% {}\n{{\\footnotesize {}\\par}}\\smallskip\n",
            on_one_line(reason),
            escaped(reason)
        ));
    }
    text.push_str(&format!("% {}\n", on_one_line(&table.head())));
    text.push_str(&format!(
        "\\begin{{tabular}}{{l{}}}\n\\toprule\nMethod",
        "r".repeat(table.columns.len())
    ));
    for column in &table.columns {
        let arrow = match column.better {
            Better::Lower => "\\downarrow",
            Better::Higher => "\\uparrow",
            Better::NearReal => "\\rightarrow",
        };
        text.push_str(&format!(" & {} ${arrow}$", escaped(column.metric.name)));
    }
    text.push_str(" \\\\\n\\midrule\n");
    let mut previous = None;
    for row in &table.rows {
        if previous.is_some_and(|previous| previous != row.group) {
            text.push_str("\\midrule\n");
        }
        previous = Some(row.group);
        text.push_str(&escaped(&row_name(row)));
        for (cell, column) in row.cells.iter().zip(&table.columns) {
            text.push_str(" & ");
            let Some(cell) = cell else {
                text.push_str("--");
                continue;
            };
            let mean = cell.mean_text(column.metric);
            if cell.best {
                text.push_str(&format!("\\textbf{{{mean}}}"));
            } else {
                text.push_str(&mean);
            }
            let ci = cell.ci_text(column.metric);
            if let Some(half_width) = ci.strip_prefix('±') {
                text.push_str(&format!("{{\\tiny$\\pm${half_width}}}"));
            }
        }
        text.push_str(" \\\\\n");
    }
    text.push_str("\\bottomrule\n\\end{tabular}\n");
    for note in &table.notes {
        text.push_str(&format!(
            "\\par\\smallskip{{\\footnotesize {}\\par}}\n",
            escaped(note)
        ));
    }
    text
}

/// Escapes the characters that are special in TeX.
pub(super) fn escaped(text: &str) -> String {
    let mut result = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\\' => result.push_str("\\textbackslash{}"),
            '~' => result.push_str("\\textasciitilde{}"),
            '^' => result.push_str("\\textasciicircum{}"),
            '<' => result.push_str("\\textless{}"),
            '>' => result.push_str("\\textgreater{}"),
            '|' => result.push_str("\\textbar{}"),
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => {
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
    fn cells_stand_in_their_columns_and_names_are_escaped() {
        let mut table = sample_table();
        table.rows[2].system = "a & b \\input{x}".to_owned();
        table.rows[1].cells[2] = None;
        let text = render(&[table]);
        let rows = text.lines().filter_map(|line| line.strip_suffix(" \\\\"));
        let rows: Vec<Vec<&str>> = rows.map(|line| line.split(" & ").collect()).collect();
        assert_eq!(rows[0][..2], ["Method", "FID $\\downarrow$"]);
        assert_eq!((rows[2][0], rows[2][3]), ("Identity", "--"));
        // TeX does not treat the escaped ampersand of the name as a cell separator.
        assert_eq!(
            rows[3][..2].join(" & "),
            "a \\& b \\textbackslash{}input\\{x\\} & 2.857{\\tiny$\\pm$0.029}"
        );
        let recall = "\\textbf{90.00}{\\tiny$\\pm$0.90}";
        let rank = "\\textbf{2.22}{\\tiny$\\pm$0.02}";
        let best = [
            "ours\\_100\\%\\textbar{}\\textless{}b\\textgreater{}",
            "\\textbf{2.222}{\\tiny$\\pm$0.022}",
            "\\textbf{32.45}{\\tiny$\\pm$0.32}",
            "\\textbf{0.900}{\\tiny$\\pm$0.009}",
        ];
        let ranks = [recall, recall, recall, rank, recall, recall, recall, rank];
        assert_eq!(rows[4], [&best[..], &ranks].concat());
        assert_eq!(text.matches("\\midrule").count(), 2);
        let note = text.lines().last().expect("a note");
        assert!(note.starts_with("\\par\\smallskip{\\footnotesize Behind the identity editor"));
    }
}
