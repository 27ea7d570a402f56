//! Files that were listed, with what their first bytes say.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use datasets_spec::store::{ByPath, Store};
use formats::source::{Format, Recognised, is_pointer, recognise};
use rayon::prelude::*;

use formats::source::read_head;

/// Seconds of motion in files of a format, estimated from their size.
pub(super) fn seconds_in(format: Format, bytes: u64) -> f64 {
    bytes as f64 / format.bytes_per_second()
}

/// A listed file and what its first bytes say.
pub(super) struct Looked {
    pub(super) relative: String,
    pub(super) path: PathBuf,
    pub(super) bytes: u64,
    pub(super) is_pointer: bool,
    pub(super) kind: Recognised,
}

pub(super) fn look(files: &BTreeMap<String, PathBuf>) -> Vec<Looked> {
    let listed: Vec<(&String, &PathBuf)> = files.iter().collect();
    listed
        .into_par_iter()
        .map(|(relative, path)| {
            let head = read_head(path);
            Looked {
                relative: relative.clone(),
                path: path.clone(),
                bytes: ByPath.size(path).unwrap_or(0),
                is_pointer: is_pointer(&head),
                kind: recognise(Path::new(relative), &head),
            }
        })
        .collect()
}
