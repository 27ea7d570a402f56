//! Recorded numbers of the reference implementations, for tests.

#[path = "../../../tests/data/golden.rs"]
mod recorded;

use std::path::Path;

pub(crate) use recorded::Recorded;

/// Reads a recorded case.
pub(crate) fn read(case: &str) -> Recorded {
    Recorded::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../.."), case)
}
