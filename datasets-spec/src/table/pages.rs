//! Frames read page by page, for readers that take rows in an order of their own.
//!
//! The general reader spends several times as long on nesting levels and row objects as on the values.
//! Rows of one known length need no levels: this reader reads the pages it needs, decompresses them and
//! joins their byte streams.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use parquet::arrow::arrow_reader::{ArrowReaderMetadata, ArrowReaderOptions};
use parquet::basic::{Compression, Encoding};
use parquet::column::page::{Page, PageReader};
use parquet::file::metadata::{PageIndexPolicy, ParquetMetaData};
use parquet::file::page_index::offset_index::PageLocation;
use parquet::file::serialized_reader::SerializedPageReader;

use super::chunks::Chunks;
use super::shard::{ShardReader, check_version};
use crate::record::MotionRow;
use crate::store::ByPath;
use crate::{Error, Fps, Motion, MotionId};
use kinematics::simd::lanes::{self, Kernel};

/// The pages of some frame columns of a file, all of which must break at the same rows.
#[derive(Debug)]
pub struct FramePages {
    path: PathBuf,
    file: Chunks,
    metadata: Arc<ParquetMetaData>,
    /// Leaf column of each column asked for.
    leaves: Vec<usize>,
    pages: Vec<PagePlace>,
}

/// Rows that are read together.
#[derive(Clone, Debug)]
struct PagePlace {
    row_group: usize,
    /// Which of the row group's pages it is.
    index: usize,
    num_rows: usize,
}

impl FramePages {
    /// Opens a file for the frame columns of these names.
    ///
    /// # Errors
    /// The file cannot be read, is not Parquet, is of a newer version, lacks a column, or has no
    /// page index.
    pub fn open(path: &Path, columns: &[&str]) -> Result<Self, Error> {
        let file = Chunks::open(&ByPath, path).map_err(Error::io("open", path))?;
        let options = ArrowReaderOptions::new().with_page_index_policy(PageIndexPolicy::Required);
        let loaded =
            ArrowReaderMetadata::load(&file, options).map_err(Error::parquet("read", path))?;
        check_version(path, &loaded)?;
        Self::of_file(path, file, Arc::clone(loaded.metadata()), columns)
    }

    /// [`FramePages::open`], of a shard whose footer is read.
    fn of_shard(shard: &ShardReader, columns: &[&str]) -> Result<Self, Error> {
        let (file, metadata) = (shard.file().clone(), Arc::clone(shard.metadata()));
        Self::of_file(shard.path(), file, metadata, columns)
    }

    fn of_file(
        path: &Path,
        file: Chunks,
        metadata: Arc<ParquetMetaData>,
        columns: &[&str],
    ) -> Result<Self, Error> {
        let bad = |problem: String| Error::Pages {
            path: path.to_owned(),
            problem,
        };
        let schema = metadata.file_metadata().schema_descr();
        let leaves: Vec<usize> = columns
            .iter()
            .map(|name| {
                (0..schema.num_columns())
                    .find(|&leaf| {
                        schema
                            .column(leaf)
                            .path()
                            .parts()
                            .first()
                            .is_some_and(|p| p == name)
                    })
                    .ok_or_else(|| bad(format!("there is no column {name}")))
            })
            .collect::<Result<_, _>>()?;
        let mut pages = Vec::new();
        for row_group in 0..metadata.num_row_groups() {
            let total = metadata.row_group(row_group).num_rows();
            let locations = leaves
                .iter()
                .map(|&leaf| locations(&metadata, row_group, leaf))
                .collect::<Option<Vec<_>>>()
                .ok_or_else(|| bad("there is no page index".to_owned()))?;
            let first_rows = |column: &[PageLocation]| -> Vec<i64> {
                column.iter().map(|page| page.first_row_index).collect()
            };
            let mut starts = locations.first().map_or(Vec::new(), |l| first_rows(l));
            if locations.iter().any(|column| first_rows(column) != starts) {
                return Err(bad(
                    "the columns break into pages at different rows".to_owned()
                ));
            }
            starts.push(total);
            pages.extend(
                starts
                    .windows(2)
                    .enumerate()
                    .map(|(index, ends)| PagePlace {
                        row_group,
                        index,
                        num_rows: usize::try_from(ends[1] - ends[0]).unwrap_or(0),
                    }),
            );
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            metadata,
            leaves,
            pages,
        })
    }

    /// Rows of each page, in file order.
    pub fn rows_of_pages(&self) -> impl ExactSizeIterator<Item = usize> + '_ {
        self.pages.iter().map(|page| page.num_rows)
    }

    /// Values per row of a column, taken from its first page; 0 if there is no page.
    ///
    /// # Errors
    /// The page cannot be read.
    pub fn row_len(&self, column: usize) -> Result<usize, Error> {
        let Some(first) = self.pages.first() else {
            return Ok(0);
        };
        let rows = first.num_rows.max(1);
        self.with_page(&self.file, 0, column, |values| values.len() / 4 / rows)
    }

    /// Reads rows of a column of a page: those there is room for. `rows` has an entry for each row
    /// of the page.
    ///
    /// # Errors
    /// The page cannot be read, or its rows are of other lengths than the room.
    ///
    /// # Panics
    /// If page or column do not exist, or `rows` is of another length than the page.
    pub fn read(
        &self,
        page: usize,
        column: usize,
        rows: &mut [Option<&mut [f32]>],
    ) -> Result<(), Error> {
        assert_eq!(rows.len(), self.pages[page].num_rows);
        let fits = self.with_page(&self.file, page, column, |values| {
            let count = values.len() / 4;
            let row_len = count / rows.len().max(1);
            let has_room =
                |row: &Option<&mut [f32]>| row.as_ref().is_none_or(|room| room.len() == row_len);
            if values.len() != 4 * row_len * rows.len() || !rows.iter().all(has_room) {
                return false;
            }
            for (row, room) in rows.iter_mut().enumerate() {
                if let Some(room) = room {
                    let at = |stream: usize| &values[stream * count + row * row_len..][..row_len];
                    lanes::dispatch(PutTogether {
                        bytes: [0, 1, 2, 3].map(at),
                        out: room,
                    });
                }
            }
            true
        })?;
        if fits {
            Ok(())
        } else {
            Err(Error::Pages {
                path: self.path.clone(),
                problem: "the rows of a page are not of the length asked for".to_owned(),
            })
        }
    }

    /// The numbers of a column of a page, row after row.
    ///
    /// # Errors
    /// The page cannot be read.
    ///
    /// # Panics
    /// If page or column do not exist.
    pub fn numbers(&self, page: usize, column: usize) -> Result<Vec<f32>, Error> {
        self.numbers_in(&self.file, page, column)
    }

    /// [`FramePages::numbers`] of a file that holds pages read ahead.
    fn numbers_in(&self, file: &Chunks, page: usize, column: usize) -> Result<Vec<f32>, Error> {
        self.with_page(file, page, column, |values| {
            let count = values.len() / 4;
            let mut numbers = vec![0.0; count];
            lanes::dispatch(PutTogether {
                bytes: [0, 1, 2, 3].map(|stream| &values[stream * count..][..count]),
                out: &mut numbers,
            });
            numbers
        })
    }

    /// The file, with all columns of a page read ahead if it is distant.
    fn ahead(&self, page: usize) -> Result<Chunks, Error> {
        let place = &self.pages[page];
        let ranges = || {
            let range_of = |leaf: &usize| {
                let page = locations(&self.metadata, place.row_group, *leaf)?.get(place.index)?;
                let start = u64::try_from(page.offset).ok()?;
                Some(start..start + u64::try_from(page.compressed_page_size).ok()?)
            };
            self.leaves.iter().filter_map(range_of).collect()
        };
        let file = self.file.ahead(ranges);
        file.map_err(Error::io("read", &self.path))
    }

    /// Calls `take` with the values of a page: four streams of bytes, the lowest first.
    fn with_page<T>(
        &self,
        file: &Chunks,
        page: usize,
        column: usize,
        take: impl FnOnce(&[u8]) -> T,
    ) -> Result<T, Error> {
        let place = &self.pages[page];
        let leaf = self.leaves[column];
        let chunk = self.metadata.row_group(place.row_group).column(leaf);
        let places = locations(&self.metadata, place.row_group, leaf).unwrap_or_default();
        let location = &places[place.index];
        let is_zstd = matches!(chunk.compression(), Compression::ZSTD(_));
        let len = usize::try_from(location.compressed_page_size).unwrap_or(0);
        UNPACKER.with_borrow_mut(|unpacker| {
            if is_zstd && len <= MAX_PAGE_LEN {
                let at = u64::try_from(location.offset).unwrap_or(u64::MAX);
                unpacker.packed.resize(len, 0);
                file.read_exact_at(&mut unpacker.packed, at)
                    .map_err(Error::io("read", &self.path))?;
                if let Some(values) = unpacker.values() {
                    return Ok(take(values));
                }
            }
            // The general reader handles other encodings and reports bad pages.
            let (bytes, levels_len) = self.unpack(file, page, column)?;
            Ok(take(&bytes[levels_len..]))
        })
    }

    /// The bytes of a page, and how many of them are levels.
    fn unpack(&self, file: &Chunks, page: usize, column: usize) -> Result<(Bytes, usize), Error> {
        let bad = |problem: &str| Error::Pages {
            path: self.path.clone(),
            problem: problem.to_owned(),
        };
        let wrap = || Error::parquet("read", &self.path);
        let place = &self.pages[page];
        let leaf = self.leaves[column];
        let group = self.metadata.row_group(place.row_group);
        let places = locations(&self.metadata, place.row_group, leaf).unwrap_or_default();
        // Pass all page locations; the reader skips the earlier ones without reading them. Given only
        // some, it would take the bytes before the first for a dictionary page.
        let mut reader = SerializedPageReader::new(
            Arc::new(file.clone()),
            group.column(leaf),
            usize::try_from(group.num_rows()).unwrap_or(0),
            Some(places.to_vec()),
        )
        .map_err(wrap())?;
        for _ in 0..place.index {
            reader.skip_next_page().map_err(wrap())?;
        }
        let (bytes, levels_len, encoding) = loop {
            let page = reader.get_next_page().map_err(wrap())?;
            match page.ok_or_else(|| bad("a page is missing"))? {
                Page::DictionaryPage { .. } => {}
                Page::DataPage { buf, encoding, .. } => {
                    // Repetition levels and definition levels, each after its length.
                    let mut at = 0;
                    for _ in 0..2 {
                        let len = buf.get(at..).and_then(|rest| rest.first_chunk::<4>());
                        let len = len.ok_or_else(|| bad("a page is cut off"))?;
                        at += 4 + u32::from_le_bytes(*len) as usize;
                    }
                    break (buf, at, encoding);
                }
                Page::DataPageV2 {
                    buf,
                    encoding,
                    def_levels_byte_len,
                    rep_levels_byte_len,
                    ..
                } => {
                    let levels = def_levels_byte_len as usize + rep_levels_byte_len as usize;
                    break (buf, levels, encoding);
                }
            }
        };
        if encoding != Encoding::BYTE_STREAM_SPLIT || levels_len > bytes.len() {
            return Err(bad("a page is not split into streams of bytes"));
        }
        Ok((bytes, levels_len))
    }
}

/// The clips of a shard of motions, read one at a time in any order.
#[derive(Debug)]
pub struct ClipReader {
    pages: FramePages,
    path: PathBuf,
    ids: Vec<MotionId>,
    fps: Vec<f32>,
}

impl ClipReader {
    /// Opens a shard and reads the names of its clips.
    ///
    /// # Errors
    /// As [`FramePages::open`], or the names cannot be read.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let shard = ShardReader::open(path)?;
        Ok(Self {
            pages: FramePages::of_shard(&shard, &["transl", "global_orient", "body_pose"])?,
            ids: shard.column::<MotionRow, MotionId>("id")?,
            fps: shard.column::<MotionRow, f32>("fps")?,
            path: path.to_owned(),
        })
    }

    /// The ids of the clips, in file order.
    pub fn ids(&self) -> &[MotionId] {
        &self.ids
    }

    /// The motion at a place of the file. Nothing but its own pages is read, from a distant file by one
    /// request.
    ///
    /// # Errors
    /// The file cannot be read, or holds no motion there.
    ///
    /// # Panics
    /// If there is no such place.
    pub fn motion(&self, row: usize) -> Result<Motion, Error> {
        let rows: Vec<usize> = self.pages.rows_of_pages().collect();
        if rows.len() != self.ids.len() || rows.iter().any(|rows| *rows != 1) {
            return Err(Error::Pages {
                path: self.path.clone(),
                problem: "its clips are not one to a page".to_owned(),
            });
        }
        let file = self.pages.ahead(row)?;
        let column = |column| self.pages.numbers_in(&file, row, column);
        let [transl, orient, body] = [0, 1, 2].map(column);
        let (transl, orient, body) = (transl?, orient?, body?);
        Ok(Motion::new(
            Fps::new(f64::from(self.fps[row]))?,
            transl.as_chunks().0.to_vec(),
            orient.as_chunks().0.to_vec(),
            body.as_chunks().0.to_vec(),
        )?)
    }
}

/// Page locations of a column.
fn locations(metadata: &ParquetMetaData, row_group: usize, leaf: usize) -> Option<&[PageLocation]> {
    let index = metadata.offset_index()?.get(row_group)?.get(leaf)?;
    Some(index.page_locations())
}

/// Maximum size in bytes of a page decompressed here; this crate writes far smaller ones.
const MAX_PAGE_LEN: usize = 256 << 20;

thread_local! {
    static UNPACKER: RefCell<Unpacker> = RefCell::default();
}

/// Decompressor of a thread. The general reader creates one for every page, which takes as long as
/// decompressing the page.
#[derive(Default)]
struct Unpacker {
    zstd: Option<zstd::bulk::Decompressor<'static>>,
    packed: Vec<u8>,
    plain: Vec<u8>,
}

impl Unpacker {
    /// The values of a data page of version 1 in the form this crate writes; none for any other.
    fn values(&mut self) -> Option<&[u8]> {
        let header = PageHeader::parse(&self.packed)?;
        if header.plain_len > MAX_PAGE_LEN {
            return None;
        }
        if self.zstd.is_none() {
            self.zstd = zstd::bulk::Decompressor::new().ok();
        }
        self.plain.resize(header.plain_len, 0);
        let unpacked = self
            .zstd
            .as_mut()?
            .decompress_to_buffer(self.packed.get(header.start..)?, &mut self.plain[..])
            .ok()?;
        let mut values = self.plain.get(..unpacked)?;
        // Repetition levels and definition levels, each after its length.
        for _ in 0..2 {
            let (len, rest) = values.split_first_chunk::<4>()?;
            values = rest.get(u32::from_le_bytes(*len) as usize..)?;
        }
        Some(values)
    }
}

/// The fields of a page header that are used.
struct PageHeader {
    start: usize,
    plain_len: usize,
}

impl PageHeader {
    /// Reads the header of a byte-split data page of version 1; none for another one.
    ///
    /// # Source
    /// `PageHeader` of parquet.thrift in the compact protocol: the fields type, uncompressed and
    /// compressed length are numbers and come first, then the header of the data page, whose first
    /// fields are the number of values and the encoding.
    fn parse(page: &[u8]) -> Option<Self> {
        const NUMBER: u8 = 0x15;
        const DATA_PAGE_HEADER: u8 = 0x2c;
        const BYTE_STREAM_SPLIT: u64 = 9;
        let mut at = 0;
        let mut byte = || {
            let byte = page.get(at).copied();
            at += 1;
            byte
        };
        let number = |byte: &mut dyn FnMut() -> Option<u8>| -> Option<u64> {
            if byte()? != NUMBER {
                return None;
            }
            let mut value = 0u64;
            for shift in (0..35).step_by(7) {
                let part = byte()?;
                value |= u64::from(part & 0x7f) << shift;
                if part & 0x80 == 0 {
                    // Zigzag: even for what is not negative.
                    return value.is_multiple_of(2).then_some(value / 2);
                }
            }
            None
        };
        let kind = number(&mut byte)?;
        let plain_len = number(&mut byte)?;
        let packed_len = number(&mut byte)?;
        let is_data = kind == 0 && byte()? == DATA_PAGE_HEADER;
        let _num_values = number(&mut byte)?;
        let encoding = number(&mut byte)?;
        if !is_data || encoding != BYTE_STREAM_SPLIT {
            return None;
        }
        Some(Self {
            start: page.len().checked_sub(usize::try_from(packed_len).ok()?)?,
            plain_len: usize::try_from(plain_len).ok()?,
        })
    }
}

/// Numbers from streams of their bytes, the lowest first.
struct PutTogether<'a> {
    bytes: [&'a [u8]; 4],
    out: &'a mut [f32],
}

impl Kernel for PutTogether<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [low, second, third, high] = self.bytes;
        let streams = low.iter().zip(second).zip(third.iter().zip(high));
        for (out, ((low, second), (third, high))) in self.out.iter_mut().zip(streams) {
            let bits = u32::from(*low)
                | u32::from(*second) << 8
                | u32::from(*third) << 16
                | u32::from(*high) << 24;
            *out = f32::from_bits(bits);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;

    use super::FramePages;
    use crate::Split;
    use crate::record::{Frames, WindowRow};
    use crate::table::{read_rows, write_rows};
    use kinematics::normalise::FRAME_WIDTH;

    /// Rows of windows of some frames, smooth enough that exponents repeat and mantissas do not.
    fn rows(count: usize, frames: usize) -> Vec<WindowRow> {
        let frames_from = |first: usize| -> Frames<FRAME_WIDTH> {
            let number =
                |frame: usize, place: usize| ((first + 7 * frame) as f32 + place as f32).sin();
            (0..frames)
                .map(|frame| std::array::from_fn(|place| number(frame, place)))
                .collect()
        };
        (0..count)
            .map(|row| WindowRow {
                split: Split::Train,
                epoch: 0,
                item: row as u64,
                progress: row as f32,
                instruction: format!("number {row}"),
                original: frames_from(31 * row),
                edited: frames_from(17 * row + 3),
            })
            .collect()
    }

    fn written(rows: &[WindowRow]) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().expect("a file");
        write_rows(file.reopen().expect("opens"), file.path(), rows, &[]).expect("written");
        file
    }

    fn numbers(path: &Path, column: usize) -> Vec<f32> {
        let pages = FramePages::open(path, &["original", "edited"]).expect("pages");
        (0..pages.rows_of_pages().len())
            .flat_map(|page| pages.numbers(page, column).expect("a page"))
            .collect()
    }

    #[test]
    fn both_readers_find_what_was_written() {
        // Pages that are not full, full, and of more than one row group.
        for (count, frames) in [(1, 16), (64, 16), (150, 1), (16_385, 1)] {
            let rows = rows(count, frames);
            let file = written(&rows);
            assert_eq!(read_rows::<WindowRow>(file.path()).expect("reads"), rows);
            let original = rows.iter().flat_map(|row| row.original.concat());
            let edited = rows.iter().flat_map(|row| row.edited.concat());
            assert_eq!(numbers(file.path(), 0), original.collect::<Vec<_>>());
            assert_eq!(numbers(file.path(), 1), edited.collect::<Vec<_>>());
        }
    }

    proptest! {
        #[test]
        fn any_numbers_come_back(bits in prop::collection::vec(any::<u32>(), 2 * FRAME_WIDTH)) {
            let mut row = rows(1, 2).remove(0);
            let (frames, _) = bits.as_chunks::<FRAME_WIDTH>();
            row.edited = frames.iter().map(|frame| frame.map(f32::from_bits)).collect();
            let file = written(&[row]);
            let found: Vec<u32> = numbers(file.path(), 1).into_iter().map(f32::to_bits).collect();
            prop_assert_eq!(&found, &bits);
        }
    }
}
