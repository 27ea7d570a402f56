//! Dataset folders of this program, read as a release: every clip keeps its id, split, labels, masks, pairs
//! and markers.
//!
//! If the rate stays the same, motions and features are copied bit for bit. Captures without a motion are not read.
//! `E-DATASET-HASH` rejects a file that differs from its manifest.

mod release;

use self::release::StoredDataset;
use super::format::{Format, boxed};

/// A dataset folder.
// Bytes per second: the 69 parameters of the store in f32 at 20 fps, before compression.
pub const FORMAT: Format = Format {
    find: |files| boxed(StoredDataset::find(files)),
    ..Format::of_releases(
        "dataset",
        "a dataset folder of this program (meta/manifest-*.json) on the same skeleton; a clip keeps id, split, labels \
         and masks, and the first of its pairs; rotations as stored",
        (4 * 69 * 20) as f64,
    )
};
