//! Real files, which are not in the repository.

use std::path::{Path, PathBuf};

/// A folder or file of the real test data; `None` if `STANCE_TEST_DATA` is not set.
///
/// # Panics
/// If the variable is set and there is no such folder or file: a requested test must not pass without running.
#[track_caller]
pub fn test_data(path: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("STANCE_TEST_DATA") else {
        skipped(path);
        return None;
    };
    let found = Path::new(&root).join(path);
    assert!(found.exists(), "found no {}", found.display());
    Some(found)
}

#[expect(
    clippy::print_stderr,
    reason = "a test that checks nothing must say so"
)]
fn skipped(path: &str) {
    eprintln!("SKIPPED: STANCE_TEST_DATA names no folder that has {path}");
}
