//! The `stance` command: parse, dispatch, render. The work is done by the library crates.

mod cli;
mod cmd;
mod device;
mod evaluators;
mod exit;
mod global;
mod progress;
mod report;
mod seeds;
mod session;
mod settings;
mod stages;

use std::process::ExitCode;

use clap::Parser;

use exit::Exit;

fn main() -> ExitCode {
    match cli::Cli::parse().run() {
        Ok(exit) => exit.into(),
        Err(error) => {
            report::error(&error);
            Exit::of_error(&error).into()
        }
    }
}
