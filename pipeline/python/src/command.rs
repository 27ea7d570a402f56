//! The command `stance`, for the script of that name and `python -m stance`.

use std::ffi::OsString;
use std::process::Command;

use pyo3::prelude::*;

/// Runs a command line, whose first word is the name of the program, and returns its exit code. Child processes of the
/// program are started as `python script`.
#[pyfunction]
pub(crate) fn main(py: Python<'_>, words: Vec<OsString>, python: OsString, script: OsString) -> u8 {
    py.detach(|| {
        stance::run(words, &|| {
            let mut command = Command::new(&python);
            command.arg(&script);
            Ok(command)
        })
    })
}
