//! The command that starts this program again.

use std::io;
use std::process::Command;

/// Returns a command that starts this program again, without arguments: pieces of long jobs may run in child processes.
/// The caller provides it, because in the Python package the running executable is the interpreter.
pub type Itself<'a> = &'a dyn Fn() -> io::Result<Command>;
