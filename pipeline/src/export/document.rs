//! Files of an export.

use std::fs;
use std::path::Path;

use pickle::npy;
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

/// Lines of comma-separated values.
pub(super) struct Lines(csv::Writer<Vec<u8>>);

impl Lines {
    pub(super) fn new<const N: usize>(header: [&str; N]) -> Self {
        let mut lines = Self(csv::Writer::from_writer(Vec::new()));
        lines.take(header);
        lines
    }

    pub(super) fn take<const N: usize>(&mut self, fields: [&str; N]) {
        self.0
            .write_record(fields)
            .expect("every line has as many fields, and memory takes them");
    }

    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.0.into_inner().expect("memory takes the lines")
    }
}

/// Reads the features of a clip, `[frames, WIDTH]`, from its file.
pub(super) fn read_features<const WIDTH: usize>(path: &Path) -> Result<Vec<[f32; WIDTH]>, Error> {
    let bytes = fs::read(path).map_err(datasets_spec::Error::io("read", path))?;
    let name = path.display().to_string();
    let array = npy::read_numbers(&name, &bytes)
        .map_err(|error| datasets_spec::Error::io("read", path)(std::io::Error::other(error)))?;
    let (frames, _) = array.values.as_chunks::<WIDTH>();
    // The numbers were written in single precision, so nothing is lost.
    Ok(frames
        .iter()
        .map(|frame| frame.map(|value| value as f32))
        .collect())
}
