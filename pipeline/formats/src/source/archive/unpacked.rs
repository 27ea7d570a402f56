//! Readers of packed archive members.

use std::cell::Cell;
use std::io::{self, Read};
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use datasets_spec::Progress;
use datasets_spec::store::{ReadAt, Reader};
use flate2::read::DeflateDecoder;

/// A part of a file.
#[derive(Clone, Debug)]
pub(super) struct Slice {
    pub(super) file: Arc<dyn ReadAt>,
    pub(super) start: u64,
    pub(super) size: u64,
}

impl ReadAt for Slice {
    fn size(&self) -> u64 {
        self.size
    }

    fn read_exact_at(&self, buffer: &mut [u8], at: u64) -> io::Result<()> {
        if at.saturating_add(buffer.len() as u64) > self.size {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        self.file.read_exact_at(buffer, self.start + at)
    }

    fn read_ranges(&self, ranges: &[Range<u64>]) -> io::Result<Vec<Bytes>> {
        if ranges.iter().any(|range| range.end > self.size) {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let moved = ranges
            .iter()
            .map(|range| self.start + range.start..self.start + range.end);
        self.file.read_ranges(&moved.collect::<Vec<_>>())
    }

    fn is_distant(&self) -> bool {
        self.file.is_distant()
    }
}

/// Number of bytes at the beginning of a packed member that are read without unpacking all of it.
const HEAD: u64 = 4096;

/// Random access to a packed member: it is unpacked into memory, unless only its first bytes are read.
#[derive(Debug)]
pub(super) struct Packed {
    member: Zipped,
    whole: Mutex<Option<Arc<Vec<u8>>>>,
}

impl Packed {
    pub(super) fn new(member: Zipped) -> Self {
        Self {
            member,
            whole: Mutex::default(),
        }
    }

    fn whole(&self) -> io::Result<Arc<Vec<u8>>> {
        let mut whole = self.whole.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(whole) = whole.as_ref() {
            return Ok(Arc::clone(whole));
        }
        let mut bytes = Vec::new();
        self.member.open().read_to_end(&mut bytes)?;
        Ok(Arc::clone(whole.insert(Arc::new(bytes))))
    }
}

impl ReadAt for Packed {
    fn size(&self) -> u64 {
        self.member.size
    }

    fn read_exact_at(&self, buffer: &mut [u8], at: u64) -> io::Result<()> {
        let start = usize::try_from(at).map_err(io::Error::other)?;
        let end = at.saturating_add(buffer.len() as u64);
        let bytes = if end <= HEAD && end <= self.member.size {
            let mut head = Vec::new();
            self.member.open().take(end).read_to_end(&mut head)?;
            Arc::new(head)
        } else {
            self.whole()?
        };
        let bytes = bytes.get(start..).and_then(|rest| rest.get(..buffer.len()));
        buffer.copy_from_slice(bytes.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }
}

/// Error of reading a damaged archive member.
#[derive(Debug, thiserror::Error)]
#[error("{reason}")]
pub(super) struct DamagedMember {
    reason: String,
    /// Offset of the member in the archive.
    pub(super) at: u64,
}

/// Position of a zip member, and its entry in the directory.
#[derive(Clone, Debug)]
pub(super) struct Zipped {
    pub(super) packed: Slice,
    pub(super) is_stored: bool,
    /// Size of the unpacked member in bytes.
    pub(super) size: u64,
    pub(super) crc: u32,
    /// Offset of the member's header in the archive.
    pub(super) at: u64,
}

impl Zipped {
    /// Starts unpacking the member from its beginning.
    pub(super) fn open(&self) -> Box<dyn Read> {
        let packed = Reader::new(Arc::new(self.packed.clone()));
        match self.is_stored {
            true => Box::new(Checked::new(packed, self)),
            false => Box::new(Checked::new(DeflateDecoder::new(packed), self)),
        }
    }
}

/// Reads a zip member: returns at most its stated size, and checks size and CRC at the end.
struct Checked<R> {
    inner: R,
    left: u64,
    crc: u32,
    hasher: crc32fast::Hasher,
    /// Offset of the member in the archive.
    at: u64,
}

impl<R: Read> Checked<R> {
    fn new(inner: R, member: &Zipped) -> Self {
        Self {
            inner,
            left: member.size,
            crc: member.crc,
            hasher: crc32fast::Hasher::new(),
            at: member.at,
        }
    }
}

impl<R: Read> Read for Checked<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let at = self.at;
        let damaged = |reason: String| {
            io::Error::new(io::ErrorKind::InvalidData, DamagedMember { reason, at })
        };
        if buffer.is_empty() {
            return Ok(0);
        }
        if self.left == 0 {
            if self.inner.read(&mut [0])? > 0 {
                return Err(damaged(
                    "it unpacks to more than its stated size".to_owned(),
                ));
            }
            let found = self.hasher.clone().finalize();
            return match found == self.crc {
                true => Ok(0),
                false => Err(damaged(format!(
                    "it has the checksum {found:08x}, expected {:08x}; it is damaged",
                    self.crc
                ))),
            };
        }
        let length = usize::try_from(self.left).map_or(buffer.len(), |left| left.min(buffer.len()));
        let read = self.inner.read(&mut buffer[..length]);
        let read = read.map_err(|error| match error.kind() {
            // Errors that the decoder returns for damaged data.
            io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => damaged(error.to_string()),
            _ => error,
        })?;
        if read == 0 {
            return Err(damaged(format!(
                "it ends {} bytes before its stated size",
                self.left
            )));
        }
        self.hasher.update(&buffer[..read]);
        self.left -= read as u64;
        Ok(read)
    }
}

/// Bytes per step of the progress.
const SHOWN: u64 = 1_000_000;

/// Counts the bytes read, and reports progress for every million.
pub(super) struct Counting<'a, R> {
    pub(super) inner: R,
    pub(super) count: &'a Cell<u64>,
    pub(super) progress: &'a dyn Progress,
}

impl<R: Read> Read for Counting<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        let before = self.count.get();
        self.count.set(before + read as u64);
        let shown = self.count.get() / SHOWN - before / SHOWN;
        if shown > 0 {
            self.progress.advance(shown);
        }
        Ok(read)
    }
}

/// Number of progress steps of [`Counting`] readers for these bytes.
pub(super) fn shown(bytes: u64) -> u64 {
    bytes / SHOWN
}

/// Reads at most `left` bytes, and sets `is_exceeded` if there are more.
pub(super) struct Capped<'a, R> {
    pub(super) inner: R,
    pub(super) left: u64,
    pub(super) is_exceeded: &'a Cell<bool>,
}

impl<R: Read> Read for Capped<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        match self.left.checked_sub(read as u64) {
            Some(left) => {
                self.left = left;
                Ok(read)
            }
            None => {
                self.is_exceeded.set(true);
                Err(io::ErrorKind::FileTooLarge.into())
            }
        }
    }
}
