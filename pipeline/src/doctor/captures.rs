//! Captures of markers that ingestion would refuse.

use std::collections::BTreeMap;

use clip::Rejected;
use datasets_spec::store::{ByPath, Store};
use formats::source::{Format, ReadCapture, ReadOptions};
use rayon::prelude::*;

use super::Looked;
use super::findings::{CaptureFindings, EXAMPLES};

/// Reads marker captures as ingestion does, without solving motions. Counts by code the motions that cannot be solved.
pub(super) fn captures(looked: &[Looked], options: &ReadOptions) -> Vec<CaptureFindings> {
    let captures: Vec<(&Looked, Format, ReadCapture)> = looked
        .iter()
        .filter(|file| !file.is_pointer)
        .filter_map(|file| {
            let format = file.format().ok()?;
            Some((file, format, format.capture?))
        })
        .collect();
    let refused: Vec<Vec<Rejected>> = captures
        .par_iter()
        .map(|&(file, format, read)| refused(file, format, read, options))
        .collect();
    let mut by_code: BTreeMap<&str, CaptureFindings> = BTreeMap::new();
    for ((file, ..), refused) in captures.iter().zip(refused) {
        for rejected in refused {
            let found = by_code
                .entry(rejected.code)
                .or_insert_with(|| CaptureFindings {
                    code: rejected.code.to_owned(),
                    motions: 0,
                    captures: captures.len() as u64,
                    examples: Vec::new(),
                });
            found.motions += 1;
            if found.examples.len() < EXAMPLES {
                found
                    .examples
                    .push((file.relative.clone(), rejected.reason));
            }
        }
    }
    by_code.into_values().collect()
}

/// The reasons why a capture gives no motion, one for each person in it.
fn refused(
    file: &Looked,
    format: Format,
    read: ReadCapture,
    options: &ReadOptions,
) -> Vec<Rejected> {
    // Ingestion reports unreadable files with the reason.
    let Ok(bytes) = ByPath.read(&file.path) else {
        return Vec::new();
    };
    let mut keys = format.keys(&bytes, options);
    if keys.is_empty() {
        keys.push(String::new());
    }
    let check = |key: String| {
        let capture = read(&bytes, options)?;
        capture.map_or(Ok(()), |capture| capture.check(&key, options))
    };
    keys.into_iter()
        .filter_map(|key| check(key).err())
        .collect()
}
