//! Tables for a terminal.

use std::collections::BTreeSet;

use super::{ABSENT, PUBLISHED_HEADING, on_one_line};
use crate::metric::Column;
use crate::table::{Cell, RowGroup, Table};

/// Assumed width of a terminal in characters.
pub const MAX_WIDTH: usize = 160;
/// Spaces between columns.
const GAP: usize = 2;
/// System names are not cut to fewer characters than this.
const MIN_NAME_WIDTH: usize = 8;
/// Mark of the best measured value.
const BEST: char = '*';

/// Writes tables one below the other. Lines stay within [`MAX_WIDTH`]: the head is wrapped, and long system names are
/// shortened as long as they stay distinct.
pub fn render(tables: &[Table]) -> String {
    let texts: Vec<String> = tables.iter().map(table_text).collect();
    let mut text = texts.join("\n");
    let rows = tables.iter().flat_map(|table| &table.rows);
    let mut cells = rows.flat_map(|row| row.cells.iter().flatten());
    if cells.any(|cell| cell.best) {
        text.push_str(&format!(
            "\n{BEST} best measured system of its column, where the identity editor is worse\n"
        ));
    }
    text
}

fn table_text(table: &Table) -> String {
    let mut text = String::new();
    let reason = table.unranked.iter().flat_map(|reason| wrapped(reason));
    for line in wrapped(&table.head()).into_iter().chain(reason) {
        push_line(&mut text, &line);
    }
    // Columns of one family, such as the four of E2S, share a heading.
    let (families, labels): (Vec<&str>, Vec<String>) =
        table.columns.iter().map(Column::heading).unzip();
    let columns: Vec<Vec<String>> = (0..table.columns.len())
        .map(|index| column_texts(table, index))
        .collect();
    let widths: Vec<usize> = columns
        .iter()
        .zip(&labels)
        .map(|(cells, label)| {
            let cells = cells.iter().map(|cell| width(cell));
            cells.chain([width(label)]).max().unwrap_or(0)
        })
        .collect();
    let values_width: usize = widths.iter().map(|width| width + GAP).sum();
    let name_width = name_width(table, MAX_WIDTH.saturating_sub(values_width));
    let rule = "─".repeat(name_width + values_width);

    push_line(&mut text, &rule);
    if families.iter().any(|family| !family.is_empty()) {
        push_line(&mut text, &families_line(name_width, &families, &widths));
    }
    push_line(&mut text, &line("System", name_width, &labels, &widths));
    push_line(&mut text, &rule);
    let mut previous = None;
    for (index, row) in table.rows.iter().enumerate() {
        let cells: Vec<String> = columns.iter().map(|cells| cells[index].clone()).collect();
        if previous.is_some_and(|previous| previous != row.group) {
            text.push('\n');
        }
        if row.group == RowGroup::Published && previous != Some(row.group) {
            push_line(&mut text, PUBLISHED_HEADING);
        }
        previous = Some(row.group);
        push_line(&mut text, &line(&row.system, name_width, &cells, &widths));
    }
    push_line(&mut text, &rule);
    for note in &table.notes {
        for line in wrapped(note) {
            push_line(&mut text, &line);
        }
    }
    text
}

/// Width of the column of names: at most `free`, but at least [`MIN_NAME_WIDTH`] and enough to keep names distinct.
fn name_width(table: &Table, free: usize) -> usize {
    let names: BTreeSet<&str> = table.rows.iter().map(|row| row.system.as_str()).collect();
    let whole = names.iter().map(|name| width(name)).max();
    let whole = whole.unwrap_or(0).max(width("System"));
    let are_apart = |width: &usize| {
        let cut: BTreeSet<String> = names.iter().map(|name| cut(name, *width)).collect();
        cut.len() == names.len()
    };
    let least = whole.min(free.max(MIN_NAME_WIDTH));
    (least..whole).find(are_apart).unwrap_or(whole)
}

fn families_line(name_width: usize, families: &[&str], widths: &[usize]) -> String {
    let mut line = " ".repeat(name_width);
    let mut widths = widths.iter();
    for columns in families.chunk_by(|a, b| a == b) {
        let of_family = widths.by_ref().take(columns.len());
        let span = of_family.map(|width| width + GAP).sum::<usize>() - GAP;
        let (filling, title) = match columns[0] {
            "" => (" ", String::new()),
            family => ("─", format!(" {family} ")),
        };
        let free = span.saturating_sub(width(&title));
        line.push_str(&" ".repeat(GAP));
        line.push_str(&filling.repeat(free / 2));
        line.push_str(&title);
        line.push_str(&filling.repeat(free - free / 2));
    }
    line
}

fn line(name: &str, name_width: usize, cells: &[String], widths: &[usize]) -> String {
    let mut line = cut(name, name_width);
    line.push_str(&" ".repeat(name_width.saturating_sub(width(&line))));
    for (cell, &column_width) in cells.iter().zip(widths) {
        line.push_str(&" ".repeat(GAP + column_width.saturating_sub(width(cell))));
        line.push_str(cell);
    }
    line
}

fn push_line(text: &mut String, line: &str) {
    text.push_str(line.trim_end());
    text.push('\n');
}

/// The cells of a column, aligned at the end of the means.
fn column_texts(table: &Table, index: usize) -> Vec<String> {
    let column = &table.columns[index];
    let parts: Vec<(String, String)> = table
        .rows
        .iter()
        .map(|row| cell_parts(row.cells[index].as_ref(), column))
        .collect();
    let mean_width = parts.iter().map(|part| width(&part.0)).max().unwrap_or(0);
    let ci_width = parts.iter().map(|part| width(&part.1)).max().unwrap_or(0);
    parts
        .into_iter()
        .map(|(mean, ci)| format!("{mean:>mean_width$}{ci:<ci_width$}"))
        .collect()
}

/// The mean and the half width of a cell.
fn cell_parts(cell: Option<&Cell>, column: &Column) -> (String, String) {
    let Some(cell) = cell else {
        return (ABSENT.to_owned(), String::new());
    };
    let mut mean = cell.mean_text(column.metric);
    if cell.best {
        mean.insert(0, BEST);
    }
    // As in the paper, a half width below one has no leading zero, which saves width.
    let half_width = cell.ci_text(column.metric).replacen("±0.", "±.", 1);
    (mean, half_width)
}

/// Width of a text; every character is assumed to be one column wide.
fn width(text: &str) -> usize {
    text.chars().count()
}

/// Shortens a text to at most `max_width` columns by cutting out its middle.
fn cut(text: &str, max_width: usize) -> String {
    // Control characters of a system's name must not move the cursor.
    let text = on_one_line(text);
    let length = width(&text);
    if length <= max_width {
        return text;
    }
    // Names of variants differ at their ends, so the middle is cut out.
    let tail = (max_width - 1) / 2;
    text.chars()
        .take(max_width - 1 - tail)
        .chain(['…'])
        .chain(text.chars().skip(length - tail))
        .collect()
}

/// Wraps a line at spaces; a word longer than a line gets its own line.
fn wrapped(text: &str) -> Vec<String> {
    lines_of(text.split_whitespace(), MAX_WIDTH)
}

/// Joins words by spaces into lines of at most `max_width` columns; a longer word gets its own line.
pub(crate) fn lines_of(
    words: impl Iterator<Item = impl AsRef<str>>,
    max_width: usize,
) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in words {
        let word = word.as_ref();
        let last = lines.len() - 1;
        if lines[last].is_empty() {
            lines[last].push_str(word);
        } else if width(&lines[last]) + 1 + width(word) > max_width {
            lines.push(word.to_owned());
        } else {
            lines[last] += &format!(" {word}");
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::published::PaperTable;
    use crate::table::tests::sample_table;

    /// The parts of a text between runs of two or more spaces.
    fn parts(line: &str) -> Vec<&str> {
        let parts = line.split("  ").map(str::trim);
        parts.filter(|part| !part.is_empty()).collect()
    }

    /// Splits the text of one table into head, rows and notes; empty lines separate groups of rows.
    fn read(text: &str) -> (String, Vec<Vec<&str>>, Vec<&str>) {
        let lines: Vec<&str> = text.lines().collect();
        let rules: Vec<usize> = (0..lines.len())
            .filter(|&index| !lines[index].is_empty() && lines[index].chars().all(|c| c == '─'))
            .collect();
        let [_, above, below] = rules[..] else {
            panic!("three rules: {text}");
        };
        let rows = lines[above + 1..below].iter().map(|line| parts(line));
        let head = parts(lines[above - 1]).join("|");
        (head, rows.collect(), lines[below + 1..].to_vec())
    }

    /// The columns of a table as the terminal shows them, below the names of their families.
    const HEAD: &str =
        "System|FID ↓|Diversity →|FS ↑|R@1 →|R@2 →|R@3 →|AvgR →|R@1 ↑|R@2 ↑|R@3 ↑|AvgR ↓";

    #[test]
    fn names_are_not_cut_until_they_are_the_same_and_cannot_move_the_cursor() {
        let mut table = sample_table();
        let names = ["body parts", "style"]
            .map(|task| format!("MotionReFit, trained on {task} alone, with poses"));
        for (row, name) in table.rows[2..].iter_mut().zip(&names) {
            row.system.clone_from(name);
        }
        let text = render(std::slice::from_ref(&table));
        let (_, rows, _) = read(&text);
        assert_ne!(rows[3][0], rows[4][0], "{text}");
        table.rows[2].system = "a\u{1b}[2Jb\nc".to_owned();
        assert!(!render(&[table]).contains('\u{1b}'));
    }

    #[test]
    fn a_table_is_aligned_and_fits_the_terminal() {
        let mut table = sample_table();
        table.rows[3].system = "a system whose name says everything about its training".to_owned();
        table.rows[3].cells[1] = None;
        let text = render(&[table]);
        assert!(text.lines().all(|line| width(line) <= MAX_WIDTH), "{text}");
        let (head, rows, _) = read(&text);
        assert_eq!(head, HEAD);
        assert_eq!(rows[4][0], "a system w…s training");
        assert_eq!((rows[4].len(), rows[4][2]), (12, "–"));
        // The ± signs of a column are aligned.
        let signs = |line: &str| -> Vec<usize> {
            let signs = line.chars().enumerate().filter(|(_, c)| *c == '±');
            signs.map(|(at, _)| at).collect()
        };
        let measured = text.lines().map(signs).filter(|at| !at.is_empty());
        let measured: Vec<Vec<usize>> = measured.collect();
        assert_eq!((measured.len(), measured[0].len()), (4, 11), "{text}");
        for line in &measured {
            assert!(line.iter().all(|at| measured[0].contains(at)), "{text}");
        }
    }

    #[test]
    fn numbers_and_marks_are_where_they_belong() {
        let text = render(&[sample_table()]);
        let (head, rows, notes) = read(&text);
        assert_eq!(head, HEAD);
        let row = |first: &str, recall: &str, rank: &str| {
            let ranks = [recall, recall, recall, rank].join("|");
            format!("{first}|{ranks}|{ranks}")
        };
        let rows: Vec<String> = rows.iter().map(|row| row.join("|")).collect();
        assert_eq!(
            rows,
            [
                row(
                    "Real Data|2.000±.020|36.06±.36|1.000±.010",
                    "100.00±1.00",
                    "2.00±.02"
                ),
                row(
                    "Identity|2.500±.025|28.85±.29|0.800±.008",
                    "80.00±.80",
                    "2.50±.03"
                ),
                String::new(),
                row(
                    "MotionReFit tiny|2.857±.029|25.24±.25|0.700±.007",
                    "70.00±.70",
                    "2.86±.03"
                ),
                row(
                    "ours_100%|<b>|*2.222±.022|*32.45±.32|*0.900±.009",
                    "*90.00±.90",
                    "*2.22±.02"
                ),
            ]
        );
        let families = text.lines().find(|line| line.starts_with(' '));
        let families = families.expect("names of families").split_whitespace();
        let families: Vec<&str> = families.filter(|part| !part.starts_with('─')).collect();
        assert_eq!(families, ["E2S", "E2T"]);
        assert_eq!(
            notes,
            [
                "Behind the identity editor, which returns the original unchanged: MotionReFit tiny in every column.",
                "",
                "* best measured system of its column, where the identity editor is worse",
            ]
        );
        assert_eq!(render(&[]), "");
    }

    #[test]
    fn published_rows_stand_apart_under_a_heading_of_their_own() {
        let mut table = sample_table();
        assert!(table.append_published(PaperTable::One));
        let text = render(&[table]);
        let (_, rows, _) = read(&text);
        assert_eq!((rows[5].len(), &rows[6][..]), (0, &[PUBLISHED_HEADING][..]));
        let names: Vec<&str> = rows[7..].iter().map(|row| row[0]).collect();
        assert_eq!(
            names.join(", "),
            "Real Data, MDM-BP, TMED, TMED w/ MCM, MotionReFit w/o MCM, MotionReFit w/o BC, MotionReFit"
        );
        // Table 1 of the paper.
        assert_eq!(
            rows[10].join(" "),
            "TMED w/ MCM 0.540±.028 35.67±.48 0.900±.006 41.29±.63 46.13±.88 49.80±.94 9.38±.10 \
             50.62±1.61 61.95±1.42 68.52±1.48 4.48±.12"
        );
        assert!(text.lines().all(|line| width(line) <= MAX_WIDTH), "{text}");
    }
}
