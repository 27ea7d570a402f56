//! Adapters from stored files to the Parquet reader.

use std::io::{self, Read};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use parquet::errors::ParquetError;
use parquet::file::reader::{ChunkReader, Length};

use crate::store::{ReadAt, Store};

/// A file read at offsets, with ranges that were read in advance.
#[derive(Clone, Debug)]
pub(super) struct Chunks {
    file: Arc<dyn ReadAt>,
    /// Ranges in memory, each with its offset in the file.
    held: Arc<[(u64, Bytes)]>,
}

impl Chunks {
    pub(super) fn open(store: &dyn Store, path: &Path) -> io::Result<Self> {
        Ok(Self {
            file: store.open_at(path)?,
            held: Arc::new([]),
        })
    }

    /// As [`Chunks::open`], but with the whole file in memory if its storage is distant: such a storage verifies the
    /// hash only of files that are read whole.
    pub(super) fn whole(store: &dyn Store, path: &Path) -> io::Result<Self> {
        let chunks = Self::open(store, path)?;
        if !chunks.file.is_distant() {
            return Ok(chunks);
        }
        let bytes = Bytes::from(store.read(path)?);
        Ok(Self {
            held: Arc::new([(0, bytes)]),
            ..chunks
        })
    }

    /// Reads these ranges in advance, if the storage of the file is distant and the file is not in memory. Other ranges
    /// are read one by one.
    pub(super) fn ahead(&self, ranges: impl FnOnce() -> Vec<Range<u64>>) -> io::Result<Self> {
        if !self.file.is_distant() || !self.held.is_empty() {
            return Ok(self.clone());
        }
        let ranges = ranges();
        let bytes = self.file.read_ranges(&ranges)?;
        Ok(Self {
            file: Arc::clone(&self.file),
            held: std::iter::zip(ranges, bytes)
                .map(|(range, bytes)| (range.start, bytes))
                .collect(),
        })
    }

    /// Fills a buffer from an offset of the file.
    pub(super) fn read_exact_at(&self, buffer: &mut [u8], at: u64) -> io::Result<()> {
        match self.held(at, buffer.len()) {
            Some(bytes) => {
                buffer.copy_from_slice(&bytes);
                Ok(())
            }
            None => self.file.read_exact_at(buffer, at),
        }
    }

    fn held(&self, at: u64, length: usize) -> Option<Bytes> {
        self.held.iter().find_map(|(start, bytes)| {
            let from = usize::try_from(at.checked_sub(*start)?).ok()?;
            let to = from.checked_add(length)?;
            (to <= bytes.len()).then(|| bytes.slice(from..to))
        })
    }
}

impl Length for Chunks {
    fn len(&self) -> u64 {
        self.file.size()
    }
}

/// Reads a file sequentially from an offset.
pub(super) struct From {
    file: Chunks,
    at: u64,
}

impl Read for From {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = usize::try_from(self.file.len().saturating_sub(self.at)).unwrap_or(usize::MAX);
        let mut length = left.min(buffer.len());
        // Stop at the end of a range that is already in memory.
        let ends = self.file.held.iter().filter_map(|(start, bytes)| {
            let end = start + bytes.len() as u64;
            (*start..end).contains(&self.at).then(|| end - self.at)
        });
        if let Some(held) = ends.max() {
            length = length.min(usize::try_from(held).unwrap_or(usize::MAX));
        }
        self.file.read_exact_at(&mut buffer[..length], self.at)?;
        self.at += length as u64;
        Ok(length)
    }
}

impl ChunkReader for Chunks {
    type T = io::BufReader<From>;

    fn get_read(&self, start: u64) -> Result<Self::T, ParquetError> {
        Ok(io::BufReader::new(From {
            file: self.clone(),
            at: start,
        }))
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes, ParquetError> {
        if let Some(bytes) = self.held(start, length) {
            return Ok(bytes);
        }
        // The length comes from the file and may be wrong: check it before reserving memory.
        if start.saturating_add(length as u64) > self.len() {
            return Err(ParquetError::EOF(format!(
                "{length} bytes at {start} of {} are not there",
                self.len()
            )));
        }
        let mut buffer = vec![0; length];
        self.file.read_exact_at(&mut buffer, start)?;
        Ok(buffer.into())
    }
}
