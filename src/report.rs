//! The only module that prints: results and JSON documents to stdout, everything else to stderr.

use std::borrow::Cow;
use std::io::{self, ErrorKind, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};

use datasets_spec::manifest::Accounting;
use serde::Serialize;
use serde_json::Value;

use crate::failure::Failure;

/// Why a result could not be written. [`flush`] returns it at the end of the command, so that work goes on until then.
static UNWRITTEN: Mutex<Option<io::Error>> = Mutex::new(None);

/// Prints a result for people.
pub(crate) fn text(text: &str) {
    if let Err(error) = writeln!(io::stdout().lock(), "{}", printable(text.trim_end())) {
        unwritten().get_or_insert(error);
    }
}

/// Prints a help text or the version to stdout, or an error of the command line to stderr.
pub(crate) fn usage(error: &clap::Error) {
    if let (Err(unprinted), false) = (error.print(), error.use_stderr()) {
        unwritten().get_or_insert(unprinted);
    }
}

fn unwritten() -> MutexGuard<'static, Option<io::Error>> {
    UNWRITTEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Prints a result for programs: one JSON document.
pub(crate) fn json<T: Serialize>(value: &T) -> anyhow::Result<()> {
    text(&serde_json::to_string_pretty(value)?);
    Ok(())
}

/// A JSON document with the fields of two values.
#[derive(Serialize)]
pub(crate) struct Joined<'a, T> {
    #[serde(flatten)]
    pub(crate) own: Value,
    #[serde(flatten)]
    pub(crate) all_of: &'a T,
}

pub(crate) fn failure(failure: &Failure) {
    json(failure).expect("texts serialise");
}

/// Appends a list under a title, unless the list is empty.
pub(crate) fn append_list(text: &mut String, title: &str, lines: &[String]) {
    if !lines.is_empty() {
        *text += &format!("{title}\n{}", listing(lines));
    }
}

/// Lines indented by two spaces. Only the first lines of a long list are shown.
pub(crate) fn listing(lines: &[String]) -> String {
    /// Number of printed lines; `--json` prints all.
    const SHOWN: usize = 10;
    let shown = lines.iter().take(SHOWN);
    let mut text: String = shown.map(|line| format!("  {line}\n")).collect();
    if lines.len() > SHOWN {
        text += &format!("  and {} more; --json lists all\n", lines.len() - SHOWN);
    }
    text
}

/// Where the sources of a dataset went, in one line.
pub(crate) fn accounted(accounting: &Accounting) -> String {
    format!(
        "{} sources = {} ingested + {} quarantined + {} skipped",
        accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
    )
}

/// Lines up rows of cells in columns. Columns for which `is_right` holds are aligned to the right, others to the left.
pub(crate) fn columns(rows: &[Vec<String>], is_right: impl Fn(usize) -> bool) -> String {
    let count = rows.first().map_or(0, Vec::len);
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max();
    let widths: Vec<usize> = (0..count).filter_map(width).collect();
    let mut text = String::new();
    for row in rows {
        let cells = row.iter().zip(&widths).enumerate();
        let cells = cells.map(|(column, (cell, &width))| match is_right(column) {
            true => format!("{cell:>width$}  "),
            false => format!("{cell:<width$}  "),
        });
        text += cells.collect::<String>().trim_end();
        text.push('\n');
    }
    text
}

/// Flushes the buffer of stdout.
///
/// # Errors
/// Something that was printed could not be written. A closed pipe, as behind `| head`, is no error.
pub(crate) fn flush() -> anyhow::Result<()> {
    let flushed = io::stdout().flush();
    match unwritten().take().or(flushed.err()) {
        Some(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(anyhow::Error::new(error).context("cannot write the result to standard output"))
        }
        _ => Ok(()),
    }
}

/// Prints a line to stderr. Where nobody reads it any more, as behind `2>&1 | head`, the work goes on.
pub(crate) fn note(text: &str) {
    let _unread = writeln!(io::stderr(), "{}", printable(text));
}

/// Prints an error with all its causes in one line.
pub(crate) fn error(error: &anyhow::Error) {
    note(&format!("error: {error:#}"));
}

/// Escapes control characters other than line feeds and tabs, because names of files and joints may contain codes that
/// a terminal would execute. The escapes are those of JSON, so that a JSON document keeps its meaning.
pub(crate) fn printable(text: &str) -> Cow<'_, str> {
    let obeyed = |c: char| c.is_control() && c != '\n' && c != '\t';
    if !text.contains(obeyed) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        match obeyed(c) {
            true => shown += &format!("\\u{:04x}", u32::from(c)),
            false => shown.push(c),
        }
    }
    Cow::Owned(shown)
}

#[cfg(test)]
mod tests {
    use super::printable;

    #[test]
    fn escape_codes_are_shown_and_not_obeyed() {
        for (text, shown) in [
            ("walk\tto\nthe door", "walk\tto\nthe door"),
            ("a\u{1b}[31mred", "a\\u001b[31mred"),
            ("title\u{9d}0;x\u{7}\r", "title\\u009d0;x\\u0007\\u000d"),
            ("\u{7f}", "\\u007f"),
        ] {
            assert_eq!(printable(text), shown);
        }
    }
}
