//! Tar archives without an end-of-archive mark.

use std::cell::Cell;
use std::io::{self, Read, Seek, SeekFrom};

/// Why a tar archive that ends after a member, without a block of zeros, is reported. Its members are read.
pub(super) const UNMARKED: &str =
    "it ends without the end-of-archive mark: it may be cut; the members before its end are read";

/// Passes the bytes of a tar archive on, and notes whether the last read met the end of the file. The crate `tar` stops
/// at a block of zeros, so it meets the end only if the archive has no such block.
pub(super) struct Ending<'a, R> {
    pub(super) inner: R,
    pub(super) is_at_end: &'a Cell<bool>,
}

impl<R: Read> Read for Ending<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.is_at_end.set(read == 0 && !buffer.is_empty());
        Ok(read)
    }
}

impl<R: Seek> Seek for Ending<'_, R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner.seek(to)
    }
}
