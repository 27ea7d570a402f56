//! Remote files read by ranges.

use std::collections::BTreeMap;
use std::io;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use bytes::{Bytes, BytesMut};
use datasets_spec::store::ReadAt;
use object_store::path::Path as Key;

use crate::cache::{BLOCK, Cache};
use crate::client::{Client, MAX_REQUEST};

/// Maximum gap in bytes between two ranges that are read in one request: a second request takes about as long as
/// reading these bytes. In most shards the pages of a clip are closer than this.
const MAX_GAP: u64 = 8 << 20;
/// Bytes at the end of a file that are read at once: a shard's footer and page index.
const TAIL: u64 = 512 << 10;

/// A remote object, read by ranges.
#[derive(Debug)]
pub(crate) struct RemoteFile {
    pub(crate) client: Client,
    pub(crate) key: Key,
    /// Key to which a commit moves the object once the newest version of its dataset does not name it.
    pub(crate) aside: Option<Key>,
    pub(crate) size: u64,
    /// BLAKE3 of the content, if known: its key in the cache.
    pub(crate) hash: Option<String>,
    /// Version tag of the object, if known.
    pub(crate) tag: Option<String>,
    pub(crate) cache: Option<Arc<Cache>>,
    pub(crate) tail: OnceLock<Bytes>,
    /// The whole file, if its server sends no ranges.
    pub(crate) whole: OnceLock<Bytes>,
}

impl ReadAt for RemoteFile {
    fn size(&self) -> u64 {
        self.size
    }

    fn read_exact_at(&self, buffer: &mut [u8], at: u64) -> io::Result<()> {
        let range = at..at.saturating_add(buffer.len() as u64);
        for bytes in self.read_ranges(&[range])? {
            buffer.copy_from_slice(&bytes);
        }
        Ok(())
    }

    fn read_ranges(&self, ranges: &[Range<u64>]) -> io::Result<Vec<Bytes>> {
        let fits = |range: &Range<u64>| range.start <= range.end && range.end <= self.size;
        if !ranges.iter().all(fits) {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        if let Some(whole) = self.whole.get() {
            return Ok(ranges.iter().map(|range| cut(whole, 0, range)).collect());
        }
        let tail = self.size.saturating_sub(TAIL);
        if ranges.iter().all(|range| range.start >= tail) {
            let bytes = self.tail(tail)?;
            return Ok(ranges
                .iter()
                .map(|range| cut(&bytes, tail, range))
                .collect());
        }
        self.fetch(ranges)
    }

    fn is_distant(&self) -> bool {
        true
    }
}

/// Cuts a range out of bytes that start at offset `start` of the file.
fn cut(bytes: &Bytes, start: u64, range: &Range<u64>) -> Bytes {
    let at = |place: u64| usize::try_from(place - start).unwrap_or(usize::MAX);
    bytes.slice(at(range.start)..at(range.end))
}

/// The bytes of the only range of a request.
fn first(bytes: Vec<Bytes>) -> Bytes {
    bytes.into_iter().next().unwrap_or_default()
}

impl RemoteFile {
    /// An object of known size, read without the cache.
    pub(crate) fn new(client: Client, key: Key, size: u64, tag: Option<String>) -> Self {
        Self {
            client,
            key,
            aside: None,
            size,
            hash: None,
            tag,
            cache: None,
            tail: OnceLock::new(),
            whole: OnceLock::new(),
        }
    }

    pub(crate) fn read_whole(&self) -> io::Result<Bytes> {
        self.read_ranges(std::slice::from_ref(&(0..self.size)))
            .map(first)
    }

    fn tail(&self, start: u64) -> io::Result<Bytes> {
        if let Some(bytes) = self.tail.get() {
            return Ok(bytes.clone());
        }
        let bytes = first(self.fetch(std::slice::from_ref(&(start..self.size)))?);
        Ok(self.tail.get_or_init(|| bytes).clone())
    }

    /// Reads ranges. From a server that cannot send ranges, the whole file is read instead.
    fn fetch(&self, ranges: &[Range<u64>]) -> io::Result<Vec<Bytes>> {
        let fetched = match self.cache.as_deref().zip(self.hash.as_deref()) {
            Some((cache, hash)) => self.by_blocks(cache, hash, ranges),
            None => self.directly(ranges),
        };
        match fetched {
            Err(error) if error.kind() == io::ErrorKind::Unsupported => {
                let whole = self.client.get(&self.key)?.bytes;
                if whole.len() as u64 != self.size {
                    return Err(error);
                }
                let whole = self.whole.get_or_init(|| whole);
                Ok(ranges.iter().map(|range| cut(whole, 0, range)).collect())
            }
            done => done,
        }
    }

    /// Reads ranges; ranges with a small gap share a request.
    fn directly(&self, ranges: &[Range<u64>]) -> io::Result<Vec<Bytes>> {
        let requests = joined(ranges, MAX_GAP);
        let got = self.requests(&requests)?;
        let of_range = |range: &Range<u64>| {
            let at = requests.partition_point(|request| request.end < range.end);
            match requests.get(at).zip(got.get(at)) {
                Some((request, bytes)) => cut(bytes, request.start, range),
                None => Bytes::new(),
            }
        };
        Ok(ranges.iter().map(of_range).collect())
    }

    /// Reads ranges, each cut into pieces that one request can carry.
    fn requests(&self, ranges: &[Range<u64>]) -> io::Result<Vec<Bytes>> {
        let mut pieces = Vec::new();
        for range in ranges {
            let mut at = range.start;
            while at < range.end {
                let end = range.end.min(at + MAX_REQUEST);
                pieces.push(at..end);
                at = end;
            }
        }
        let read = |key: &Key| self.client.ranges(key, self.tag.as_deref(), &pieces);
        let got = match (read(&self.key), &self.aside) {
            (Err(error), Some(aside)) if error.kind() == io::ErrorKind::NotFound => read(aside)?,
            (got, _) => got?,
        };
        let mut got = got.into_iter();
        let bytes = ranges.iter().map(|range| {
            let length = range.end - range.start;
            if length <= MAX_REQUEST {
                return got.next().unwrap_or_default();
            }
            let mut bytes = BytesMut::new();
            for piece in got.by_ref().take(length.div_ceil(MAX_REQUEST) as usize) {
                bytes.extend_from_slice(&piece);
            }
            bytes.freeze()
        });
        Ok(bytes.collect())
    }

    /// Reads ranges from the cache. Missing blocks are read whole and added to the cache.
    fn by_blocks(
        &self,
        cache: &Cache,
        hash: &str,
        ranges: &[Range<u64>],
    ) -> io::Result<Vec<Bytes>> {
        let extent = |block: u64| block * BLOCK..self.size.min((block + 1) * BLOCK);
        let mut blocks: BTreeMap<u64, Option<Bytes>> = BTreeMap::new();
        for range in ranges.iter().filter(|range| !range.is_empty()) {
            for block in range.start / BLOCK..=(range.end - 1) / BLOCK {
                blocks.entry(block).or_insert_with(|| {
                    let extent = extent(block);
                    cache.get(hash, block, extent.end - extent.start)
                });
            }
        }
        let missing = blocks.iter().filter(|(_, bytes)| bytes.is_none());
        let missing: Vec<Range<u64>> = missing.map(|(block, _)| extent(*block)).collect();
        let requests = joined(&missing, MAX_GAP);
        for (request, bytes) in std::iter::zip(&requests, self.requests(&requests)?) {
            for block in request.start / BLOCK..=(request.end - 1) / BLOCK {
                let bytes = cut(&bytes, request.start, &extent(block));
                let known = blocks.get(&block).is_some_and(Option::is_some);
                if !known {
                    cache.put(hash, block, &bytes);
                    blocks.insert(block, Some(bytes));
                }
            }
        }
        let of_range = |range: &Range<u64>| {
            let mut bytes = BytesMut::new();
            for (block, kept) in blocks.range(range.start / BLOCK..) {
                let extent = extent(*block);
                if extent.start >= range.end {
                    break;
                }
                let wanted = range.start.max(extent.start)..range.end.min(extent.end);
                if let Some(kept) = kept {
                    bytes.extend_from_slice(&cut(kept, extent.start, &wanted));
                }
            }
            bytes.freeze()
        };
        Ok(ranges.iter().map(of_range).collect())
    }
}

/// Sorts ranges, drops empty ones, and merges those whose gap is at most `max_gap`.
fn joined(ranges: &[Range<u64>], max_gap: u64) -> Vec<Range<u64>> {
    let mut sorted: Vec<Range<u64>> = ranges.to_vec();
    sorted.retain(|range| !range.is_empty());
    sorted.sort_by_key(|range| (range.start, range.end));
    let mut joined: Vec<Range<u64>> = Vec::new();
    for range in sorted {
        match joined.last_mut() {
            Some(last) if range.start <= last.end.saturating_add(max_gap) => {
                last.end = last.end.max(range.end);
            }
            _ => joined.push(range),
        }
    }
    joined
}
