//! The command that starts this program again.

use std::io;
use std::process::Command;

/// Makes the command that starts this program again, ready for arguments: pieces of long jobs may have processes of
/// their own. In the Python package the running executable is the interpreter, so the caller must say.
pub type Itself<'a> = &'a dyn Fn() -> io::Result<Command>;
