//! The `stance` command.

use std::process::{Command, ExitCode};

fn main() -> ExitCode {
    let itself = || std::env::current_exe().map(Command::new);
    stance::run(std::env::args_os(), &itself).into()
}
