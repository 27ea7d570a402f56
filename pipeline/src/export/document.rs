//! JSON documents of an export.

use std::fs;
use std::path::Path;

use serde::Serialize;

use crate::Error;

/// Writes a JSON document, indented and with a line end.
pub(super) fn write_json(folder: &Path, name: &str, value: &impl Serialize) -> Result<(), Error> {
    let path = folder.join(name);
    let mut text = serde_json::to_vec_pretty(value)
        .map_err(|error| datasets_spec::Error::io("write", &path)(error.into()))?;
    text.push(b'\n');
    Ok(fs::write(&path, text).map_err(datasets_spec::Error::io("write", &path))?)
}
