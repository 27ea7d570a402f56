//! The command that starts this program again.

use std::io;
use std::process::Command;

/// Makes the command that starts this program again, ready for arguments: pieces of long jobs may run in child
/// processes. In the Python package the running executable is the interpreter, so the caller provides the command.
pub type Itself<'a> = &'a dyn Fn() -> io::Result<Command>;
