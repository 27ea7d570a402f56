//! The `stance` command: parse, dispatch, render. The work is done by the library crates.
//!
//! It is a library for two programs: `main.rs`, and the Python package, which has the same command.

mod chosen;
mod cli;
mod cmd;
mod device;
mod evaluators;
mod exit;
mod failure;
mod global;
mod itself;
mod judge;
mod local;
mod progress;
mod report;
mod seeds;
mod session;
mod settings;
mod stages;
mod test_set;
mod trainings;

use std::ffi::OsString;

use cli::Cli;
use exit::{Exit, Stopped};
use failure::Failure;
pub use itself::Itself;

/// Runs a command line, whose first word is the name of the program, and returns its exit code.
pub fn run(words: impl IntoIterator<Item = OsString>, itself: Itself<'_>) -> u8 {
    let words: Vec<OsString> = words.into_iter().collect();
    let code = run_words(&words, itself);
    // A Rust program flushes stdout at exit; Python does not flush this buffer.
    let Err(error) = report::flush() else {
        return code;
    };
    report::error(&error);
    match code {
        0 => Exit::of_error(&error).code(),
        code => code,
    }
}

fn run_words(words: &[OsString], itself: Itself<'_>) -> u8 {
    let texts: Vec<String> = words
        .iter()
        .map(|word| word.to_string_lossy().into_owned())
        .collect();
    let has_json = texts.iter().any(|word| word == "--json");
    if device::is_list_asked(&texts) {
        return ended(device::print_list(has_json), has_json);
    }
    let cli = match Cli::of_words(words) {
        Ok(cli) => cli,
        Err(error) => {
            // There are no parsed options, so search the words for --json.
            if has_json && error.use_stderr() {
                report::failure(&Failure::of_usage(&error));
            }
            report::usage(&error);
            return match error.use_stderr() {
                true => Exit::Usage.code(),
                false => Exit::Done.code(),
            };
        }
    };
    let registered = remote_store::register().map_err(anyhow::Error::from);
    ended(registered.and_then(|()| cli.run(itself)), cli.global.json)
}

/// Reports the error of a command, if there is one, and returns the exit code.
fn ended(result: anyhow::Result<Exit>, is_json: bool) -> u8 {
    let error = match result {
        Ok(exit) => return exit.code(),
        Err(error) => error,
    };
    if error.is::<Stopped>() {
        report::note(&Stopped.to_string());
        return Exit::Interrupted.code();
    }
    report::error(&error);
    if is_json {
        report::failure(&Failure::of_error(&error));
    }
    Exit::of_error(&error).code()
}
