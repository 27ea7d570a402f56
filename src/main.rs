//! The `stance` command: parse, dispatch, render. The work is done by the library crates.

mod chosen;
mod cli;
mod cmd;
mod device;
mod evaluators;
mod exit;
mod failure;
mod global;
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

use std::process::ExitCode;

use exit::Exit;
use failure::Failure;

/// Exit code of usage errors.
const USAGE: u8 = 2;

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args_os()
        .map(|word| word.to_string_lossy().into_owned())
        .collect();
    if device::is_list_asked(&words) {
        return match device::print_list(words.iter().any(|word| word == "--json")) {
            Ok(exit) => exit.into(),
            Err(error) => {
                report::error(&error);
                Exit::of_error(&error).into()
            }
        };
    }
    let cli = match cli::Cli::of_process() {
        Ok(cli) => cli,
        Err(error) => {
            // The command line did not parse, so --json is looked for among its words.
            let json = std::env::args_os().any(|word| word == "--json");
            if json && error.use_stderr() {
                report::failure(&Failure::of_usage(&error));
            }
            // A closed pipe is not an error.
            let _printed = error.print();
            return ExitCode::from(if error.use_stderr() { USAGE } else { 0 });
        }
    };
    let registered = remote_store::register().map_err(anyhow::Error::from);
    match registered.and_then(|()| cli.run()) {
        Ok(exit) => exit.into(),
        Err(error) => {
            report::error(&error);
            if cli.json() {
                report::failure(&Failure::of_error(&error));
            }
            Exit::of_error(&error).into()
        }
    }
}
