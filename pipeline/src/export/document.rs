//! Files of an export.

use std::fs;
use std::path::Path;

use serde::Serialize;

use crate::Error;

/// Writes a file of the folder `root`, and the folders above it.
pub(super) fn file(root: &Path, name: &str, bytes: &[u8]) -> Result<(), Error> {
    let path = root.join(name);
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).map_err(datasets_spec::Error::io("create folder", parent))?;
    }
    Ok(fs::write(&path, bytes).map_err(datasets_spec::Error::io("write", &path))?)
}

/// Writes a JSON document, indented and with a line end.
pub(super) fn write_json(folder: &Path, name: &str, value: &impl Serialize) -> Result<(), Error> {
    let mut text = serde_json::to_vec_pretty(value)
        .map_err(|error| datasets_spec::Error::io("write", folder.join(name))(error.into()))?;
    text.push(b'\n');
    file(folder, name, &text)
}
