//! The first bytes of files, and Git LFS pointers in their place.

use std::io;
use std::path::Path;

use clip::{Rejected, rejected};
use datasets_spec::store::{ByPath, Store as _};

/// First words of a Git LFS pointer, which replaces a large file that was not downloaded.
pub(super) const LFS_POINTER: &[u8] = b"version https://git-lfs.github.com/spec/";
pub(super) const UTF8_BOM: &[u8] = b"\xEF\xBB\xBF";

/// Number of bytes read to recognise a file.
pub const HEAD_BYTES: usize = 512;

/// The first bytes of a file; empty if it cannot be read. The error is reported when the file is hashed.
pub fn read_head(path: &Path) -> Vec<u8> {
    let read = || {
        let file = ByPath.open_at(path)?;
        let length = file.size().min(HEAD_BYTES as u64);
        let mut head = vec![0; usize::try_from(length).unwrap_or(HEAD_BYTES)];
        file.read_exact_at(&mut head, 0)?;
        io::Result::Ok(head)
    };
    read().unwrap_or_default()
}

/// Whether these are the first bytes of a Git LFS pointer.
pub fn is_pointer(head: &[u8]) -> bool {
    head.starts_with(LFS_POINTER)
}

/// Refuses a Git LFS pointer.
///
/// # Errors
/// `E-LFS-POINTER`.
pub fn refuse_pointer(bytes: &[u8]) -> Result<(), Rejected> {
    if !is_pointer(bytes) {
        return Ok(());
    }
    Err(rejected!(
        "E-LFS-POINTER",
        "{} bytes of Git LFS pointer stand in for the file; run `git lfs pull`",
        bytes.len()
    )
    .at(0))
}
