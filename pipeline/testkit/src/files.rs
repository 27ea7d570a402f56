//! Small files for tests.

use std::io::{Cursor, Write};

use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// An npy file with this dictionary and data, valid or not.
pub fn npy(dictionary: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((dictionary.len() as u16).to_le_bytes());
    bytes.extend(dictionary.as_bytes());
    bytes.extend(data);
    bytes
}

/// An npy file with a row-major array of f8.
pub fn npy_f8(shape: &[usize], values: &[f64]) -> Vec<u8> {
    pickle::npy::encode(shape, values)
}

/// An npz archive of these members; `.npy` is added to their names.
pub fn npz(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (key, bytes) in members {
        writer
            .start_file(format!("{key}.npy"), SimpleFileOptions::default())
            .expect("in memory");
        writer.write_all(bytes).expect("in memory");
    }
    writer.finish().expect("in memory").into_inner()
}
