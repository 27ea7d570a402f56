//! Small tables of text: a header row, and named rows.

use serde::Serialize;

use super::csv::line;
use super::latex::escaped;

/// A table of text cells.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Grid {
    /// Title of the table.
    pub title: String,
    /// Names of the columns; the first heads the row names.
    pub head: Vec<String>,
    /// Rows, each as long as the head.
    pub rows: Vec<Vec<String>>,
}

/// Spaces between columns.
const GAP: &str = "  ";

impl Grid {
    /// The table for a terminal: names left-aligned, values right-aligned.
    pub fn text(&self) -> String {
        let width = |text: &str| text.chars().count();
        let widths: Vec<usize> = (0..self.head.len())
            .map(|column| {
                let cells = self.rows.iter().map(|row| width(&row[column]));
                cells.chain([width(&self.head[column])]).max().unwrap_or(0)
            })
            .collect();
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells
                .iter()
                .zip(&widths)
                .enumerate()
                .map(|(column, (cell, &width))| match column {
                    0 => format!("{cell:<width$}"),
                    _ => format!("{cell:>width$}"),
                })
                .collect();
            format!("{}\n", cells.join(GAP).trim_end())
        };
        let total = widths.iter().sum::<usize>() + GAP.len() * (widths.len().max(1) - 1);
        let rule = format!("{}\n", "─".repeat(total));
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        format!(
            "{}\n{rule}{}{rule}{rows}{rule}",
            self.title,
            line(&self.head)
        )
    }

    /// The table in Markdown.
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let mut text = format!("### {}\n\n{}", self.title, line(&self.head));
        text.push_str("| :-- |");
        text.push_str(&" --: |".repeat(self.head.len().saturating_sub(1)));
        text.push('\n');
        text.extend(self.rows.iter().map(|row| line(row)));
        text
    }

    /// The table in LaTeX, with the rules of the package `booktabs`.
    pub fn latex(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| escaped(cell)).collect();
            format!("{} \\\\\n", cells.join(" & "))
        };
        let columns = "r".repeat(self.head.len().saturating_sub(1));
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        format!(
            "% {}\n\\begin{{tabular}}{{l{columns}}}\n\\toprule\n{}\\midrule\n{rows}\\bottomrule\n\\end{{tabular}}\n",
            super::on_one_line(&self.title),
            line(&self.head),
        )
    }

    /// The table as CSV.
    pub fn csv(&self) -> String {
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        line(&self.head) + &rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        let texts = |texts: [&str; 2]| texts.map(str::to_owned).to_vec();
        Grid {
            title: "Times".to_owned(),
            head: texts(["window", "FPS"]),
            rows: vec![
                texts(["16-frame", "24.76"]),
                texts(["a|b, \"c\" & 5%", "9"]),
            ],
        }
    }

    #[test]
    fn columns_of_a_terminal_are_straight() {
        let rule = "─".repeat(20);
        let expected = format!(
            "Times\n{rule}\nwindow           FPS\n{rule}\n16-frame       24.76\n\
             a|b, \"c\" & 5%      9\n{rule}\n"
        );
        assert_eq!(grid().text(), expected);
    }

    #[test]
    fn marks_of_each_format_are_escaped() {
        let grid = grid();
        assert_eq!(
            grid.markdown(),
            "### Times\n\n| window | FPS |\n| :-- | --: |\n| 16-frame | 24.76 |\n\
             | a\\|b, \"c\" & 5% | 9 |\n"
        );
        assert_eq!(
            grid.latex(),
            "% Times\n\\begin{tabular}{lr}\n\\toprule\nwindow & FPS \\\\\n\\midrule\n\
             16-frame & 24.76 \\\\\na\\textbar{}b, \"c\" \\& 5\\% & 9 \\\\\n\
             \\bottomrule\n\\end{tabular}\n"
        );
        let csv = "window,FPS\n16-frame,24.76\n\"a|b, \"\"c\"\" & 5%\",9\n";
        assert_eq!(grid.csv(), csv);
    }
}
