//! The command `stance`, for the script of that name and `python -m stance`.

use std::ffi::OsString;
use std::process::Command;

use pyo3::prelude::*;

/// Runs a command line, whose first word is the name of the program, and returns its exit code. `python` is the
/// interpreter that the command is started again by.
#[pyfunction]
pub(crate) fn main(py: Python<'_>, words: Vec<OsString>, python: OsString) -> u8 {
    py.detach(|| {
        stance::run(words, &|| {
            let mut command = Command::new(&python);
            // Without the variable a file `stance.py` in the working folder would be started instead.
            command.args(["-m", "stance"]).env("PYTHONSAFEPATH", "1");
            Ok(command)
        })
    })
}
