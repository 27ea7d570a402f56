//! The one place that prints: results to stdout, everything else to stderr.
#![expect(
    clippy::print_stderr,
    reason = "printing is this module's job; every other module hands it values"
)]

use std::io::Write;

use serde::Serialize;

/// Prints a result for people.
pub(crate) fn text(text: &str) {
    let mut stdout = std::io::stdout().lock();
    // A closed pipe, as behind `| head`, is not an error.
    let _written = writeln!(stdout, "{}", text.trim_end());
}

/// Prints a result for programs: one JSON document.
pub(crate) fn json<T: Serialize>(value: &T) -> anyhow::Result<()> {
    text(&serde_json::to_string_pretty(value)?);
    Ok(())
}

/// Prints a note to stderr.
pub(crate) fn note(text: &str) {
    eprintln!("{text}");
}

/// Prints an error with all its causes in one line.
pub(crate) fn error(error: &anyhow::Error) {
    eprintln!("error: {error:#}");
}
