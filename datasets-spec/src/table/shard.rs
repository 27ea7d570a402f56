//! Parquet files of rows.

use std::borrow::Cow;
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};

use arrow_schema::{DataType, Schema};
use bytes::Bytes;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader,
    ParquetRecordBatchReaderBuilder, RowSelection, RowSelectionPolicy,
};
use parquet::arrow::{ArrowWriter, ProjectionMask};
use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::{KeyValue, PageIndexPolicy, ParquetMetaData};
use parquet::file::page_index::offset_index::PageLocation;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::reader::ChunkReader;
use parquet::schema::types::ColumnPath;

use super::chunks::Chunks;
use super::{Cell, RecordBatch, Row, SCHEMA_VERSION, decode_column};
use crate::Error;
use crate::store::{ByPath, Store};

/// Pages per row group. In table `motions`, where a page is a clip, these are about 30 MB; table viewers allow more.
const ROW_GROUP_PAGES: usize = 256;
/// Zstandard level. On byte-split motion, level 3 takes 1.5 times as long and saves less than 1 %.
const ZSTD_LEVEL: i32 = 1;
/// Size limit of a page, large enough for the longest clip to be one page.
const PAGE_BYTES: usize = 64 << 20;
/// Footer entry with the version of the table schemas.
const SCHEMA_VERSION_NOTE: &str = "schema_version";
const READ_BATCH_ROWS: usize = 64;
const COLUMN_BATCH_ROWS: usize = 4096;

/// Paths of the leaf columns of frames, which are written with byte-stream split and read clip by clip.
fn frame_leaves(schema: &Schema) -> Vec<ColumnPath> {
    schema
        .fields()
        .iter()
        .filter(|field| {
            matches!(field.data_type(), DataType::List(item)
                if matches!(item.data_type(), DataType::FixedSizeList(..)))
        })
        .map(|field| {
            ColumnPath::new(vec![
                field.name().clone(),
                "list".to_owned(),
                "item".to_owned(),
                "list".to_owned(),
                "item".to_owned(),
            ])
        })
        .collect()
}

fn properties(
    schema: &Schema,
    page_rows: usize,
    facts: &[(&str, String)],
) -> Result<WriterProperties, ParquetError> {
    let version = (SCHEMA_VERSION_NOTE, SCHEMA_VERSION.to_owned());
    let notes = std::iter::once(&version).chain(facts);
    let notes = notes.map(|(key, value)| KeyValue::new(format!("motion.{key}"), value.clone()));
    let mut builder = WriterProperties::builder()
        .set_created_by(concat!("stance ", env!("CARGO_PKG_VERSION")).to_owned())
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(ZSTD_LEVEL)?))
        .set_max_row_group_row_count(Some(ROW_GROUP_PAGES * page_rows))
        .set_key_value_metadata(Some(notes.collect()));
    let leaves = frame_leaves(schema);
    if !leaves.is_empty() {
        // One clip (or `page_rows` small rows) per page, so that a reader decodes only the pages that it needs.
        builder = builder
            .set_data_page_row_count_limit(page_rows)
            .set_write_batch_size(page_rows)
            .set_data_page_size_limit(PAGE_BYTES);
    }
    for leaf in leaves {
        builder = builder
            .set_column_encoding(leaf.clone(), Encoding::BYTE_STREAM_SPLIT)
            .set_column_dictionary_enabled(leaf.clone(), false)
            .set_column_statistics_enabled(leaf, EnabledStatistics::None);
    }
    Ok(builder.build())
}

fn writer<R: Row, W: Write + Send>(
    sink: W,
    facts: &[(&str, String)],
) -> Result<ArrowWriter<W>, ParquetError> {
    let schema = R::schema();
    let properties = properties(&schema, R::PAGE_ROWS, facts)?;
    ArrowWriter::try_new(sink, schema, Some(properties))
}

/// Number of rows in a row group of a table. A writer holds one group in memory.
pub const fn group_rows<R: Row>() -> usize {
    ROW_GROUP_PAGES * R::PAGE_ROWS
}

/// Writes rows as one Parquet file. `facts` become footer entries under the prefix `motion.`. The bytes depend only on
/// the rows and facts, not on the clock or the host name.
///
/// # Errors
/// The rows cannot be encoded or the file cannot be written; `path` is only named in the error.
pub fn write_rows<R: Row, W: Write + Send>(
    sink: W,
    path: &Path,
    rows: &[R],
    facts: &[(&str, String)],
) -> Result<W, Error> {
    write_groups(sink, path, borrowed_groups(rows), facts)
}

/// Splits rows into the groups that [`write_groups`] writes.
pub(crate) fn borrowed_groups<'a, R: Row, E>(
    rows: &'a [R],
) -> impl Iterator<Item = Result<Cow<'a, [R]>, E>> {
    rows.chunks(group_rows::<R>())
        .map(|group| Ok(Cow::Borrowed(group)))
}

/// [`write_rows`], with one group of rows in memory at a time. All groups but the last have [`group_rows`] rows.
///
/// # Errors
/// As [`write_rows`], or the next group cannot be made.
pub(crate) fn write_groups<'a, R: Row + 'a, W: Write + Send, E: From<Error>>(
    sink: W,
    path: &Path,
    groups: impl Iterator<Item = Result<Cow<'a, [R]>, E>>,
    facts: &[(&str, String)],
) -> Result<W, E> {
    let wrap = || Error::parquet("write", path);
    let mut writer = writer::<R, W>(sink, facts).map_err(wrap())?;
    for group in groups {
        writer.write(&R::encode(&group?)?).map_err(wrap())?;
    }
    Ok(writer.into_inner().map_err(wrap())?)
}

/// Writes rows incrementally, with the same bytes as [`write_rows`] and at most one row group in memory. Only for
/// tables with one row per page.
pub struct RowWriter<R, W: Write + Send> {
    writer: ArrowWriter<W>,
    path: PathBuf,
    waiting: Vec<R>,
}

impl<R: Row, W: Write + Send> RowWriter<R, W> {
    /// Begins a file. `path` is only named in errors.
    ///
    /// # Errors
    /// The file cannot be written.
    ///
    /// # Panics
    /// If the table has several rows per page ([`Row::PAGE_ROWS`]).
    pub fn new(sink: W, path: &Path, facts: &[(&str, String)]) -> Result<Self, Error> {
        assert_eq!(R::PAGE_ROWS, 1, "{} has several rows in a page", R::TABLE);
        Ok(Self {
            writer: writer::<R, W>(sink, facts).map_err(Error::parquet("write", path))?,
            path: path.to_owned(),
            waiting: Vec::new(),
        })
    }

    /// Adds a row.
    ///
    /// # Errors
    /// The rows cannot be encoded or the file cannot be written.
    pub fn push(&mut self, row: R) -> Result<(), Error> {
        self.waiting.push(row);
        if self.waiting.len() == ROW_GROUP_PAGES {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Error> {
        let batch = R::encode(&self.waiting)?;
        self.waiting.clear();
        self.writer
            .write(&batch)
            .map_err(Error::parquet("write", &self.path))
    }

    /// Ends the file.
    ///
    /// # Errors
    /// As [`RowWriter::push`].
    pub fn finish(mut self) -> Result<W, Error> {
        if !self.waiting.is_empty() {
            self.flush()?;
        }
        self.writer
            .into_inner()
            .map_err(Error::parquet("write", &self.path))
    }
}

fn options() -> ArrowReaderOptions {
    ArrowReaderOptions::new().with_page_index_policy(PageIndexPolicy::Optional)
}

/// Entries of the footer with the prefix `motion.`, without the prefix.
fn notes(metadata: &ArrowReaderMetadata) -> impl Iterator<Item = (&str, Option<&str>)> {
    let entries = metadata.metadata().file_metadata().key_value_metadata();
    entries.into_iter().flatten().filter_map(|entry| {
        let key = entry.key.strip_prefix("motion.")?;
        Some((key, entry.value.as_deref()))
    })
}

/// Refuses files of another major version, which this program would misread.
fn check_version(path: &Path, metadata: &ArrowReaderMetadata) -> Result<(), Error> {
    let version = notes(metadata).find(|(key, _)| *key == SCHEMA_VERSION_NOTE);
    let found = version.and_then(|(_, value)| value).unwrap_or("none");
    super::check_version(path, found)
}

/// Reads all rows of a file.
///
/// # Errors
/// The file cannot be read, is not Parquet, is of another major version, or holds another table.
pub fn read_rows<R: Row>(path: &Path) -> Result<Vec<R>, Error> {
    read_rows_on(&ByPath, path)
}

/// [`read_rows`], from the given store.
///
/// # Errors
/// As [`read_rows`].
pub fn read_rows_on<R: Row>(store: &dyn Store, path: &Path) -> Result<Vec<R>, Error> {
    let bytes = Bytes::from(store.read(path).map_err(Error::io("read", path))?);
    let metadata =
        ArrowReaderMetadata::load(&bytes, options()).map_err(Error::parquet("read", path))?;
    check_version(path, &metadata)?;
    read_selected(path, bytes, metadata, None, ProjectionMask::all())
}

/// An open file, for reading rows at any place.
#[derive(Debug)]
pub struct ShardReader {
    path: PathBuf,
    file: Chunks,
    metadata: ArrowReaderMetadata,
}

impl ShardReader {
    /// Opens a file and reads its footer and page index.
    ///
    /// # Errors
    /// The file cannot be read, is not Parquet, or is of another major version.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let file = Chunks::open(&ByPath, path).map_err(Error::io("open", path))?;
        Self::of(path, file)
    }

    /// As [`ShardReader::open`], for a reader of all rows: at a URL, the file is read whole and its hash is verified.
    ///
    /// # Errors
    /// As [`ShardReader::open`], or the file differs from its hash.
    pub fn open_whole(path: &Path) -> Result<Self, Error> {
        let file = Chunks::whole(&ByPath, path).map_err(Error::io("read", path))?;
        Self::of(path, file)
    }

    fn of(path: &Path, file: Chunks) -> Result<Self, Error> {
        let metadata =
            ArrowReaderMetadata::load(&file, options()).map_err(Error::parquet("read", path))?;
        check_version(path, &metadata)?;
        Ok(Self {
            path: path.to_owned(),
            file,
            metadata,
        })
    }

    /// Number of rows in the file.
    pub fn num_rows(&self) -> usize {
        usize::try_from(self.metadata.metadata().file_metadata().num_rows()).unwrap_or(0)
    }

    /// Reads all rows. Only the columns of table `R` are read from the disk.
    ///
    /// # Errors
    /// The file cannot be read or holds another table.
    pub fn rows<R: Row>(&self) -> Result<Vec<R>, Error> {
        let mask = self.columns_of::<R>();
        let file = self.ahead(&mask, None)?;
        read_selected(&self.path, file, self.metadata.clone(), None, mask)
    }

    /// Reads the rows at the given places, in file order; places after the end are ignored. Only the pages of these
    /// rows in the columns of table `R` are read and decoded, all in one read if the file is distant.
    ///
    /// # Errors
    /// The file cannot be read or holds another table.
    pub fn rows_at<R: Row>(&self, rows: &[usize]) -> Result<Vec<R>, Error> {
        let total = self.num_rows();
        let mut wanted: Vec<usize> = rows.iter().copied().filter(|&row| row < total).collect();
        wanted.sort_unstable();
        wanted.dedup();
        let mask = self.columns_of::<R>();
        let file = self.ahead(&mask, Some(&wanted))?;
        let rows = SelectedRows::of(self.metadata.metadata(), &wanted);
        read_selected(&self.path, file, self.metadata.clone(), Some(rows), mask)
    }

    /// Reads one column of all rows. No other column is read from the disk.
    ///
    /// # Errors
    /// The file cannot be read, or the column is missing or of another type.
    pub fn column<R: Row, T: Cell>(&self, name: &'static str) -> Result<Vec<T>, Error> {
        let reader = self.reader_of(&[name])?.build();
        let reader = reader.map_err(Error::parquet("read", &self.path))?;
        decoded(&self.path, reader, |batch| {
            decode_column(R::TABLE, name, batch)
        })
    }

    /// Reads the named columns of all rows, batch by batch; names that the file lacks are left out. No other column is read
    /// from the disk.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn batches(&self, names: &[&str]) -> Result<Vec<RecordBatch>, Error> {
        let reader = self.reader_of(names)?.with_batch_size(COLUMN_BATCH_ROWS);
        let reader = reader.build().map_err(Error::parquet("read", &self.path))?;
        reader
            .map(|batch| batch.map_err(|error| Error::parquet("read", &self.path)(error.into())))
            .collect()
    }

    /// A reader of the named columns of all rows.
    fn reader_of(&self, names: &[&str]) -> Result<ParquetRecordBatchReaderBuilder<Chunks>, Error> {
        let mask = ProjectionMask::columns(self.metadata.parquet_schema(), names.iter().copied());
        let (file, metadata) = (self.ahead(&mask, None)?, self.metadata.clone());
        let reader = ParquetRecordBatchReaderBuilder::new_with_metadata(file, metadata);
        Ok(reader.with_projection(mask))
    }

    /// Facts in the file's footer: those passed to [`write_rows`].
    pub fn facts(&self) -> Vec<(String, String)> {
        notes(&self.metadata)
            .filter(|(key, _)| *key != SCHEMA_VERSION_NOTE)
            .filter_map(|(key, value)| Some((key.to_owned(), value?.to_owned())))
            .collect()
    }

    fn columns_of<R: Row>(&self) -> ProjectionMask {
        let columns = R::columns();
        let names = columns.iter().map(|column| column.name);
        ProjectionMask::columns(self.metadata.parquet_schema(), names)
    }

    /// Reads the pages of these columns and sorted rows in advance, if the file is distant.
    fn ahead(&self, columns: &ProjectionMask, rows: Option<&[usize]>) -> Result<Chunks, Error> {
        let ranges = || ranges_of(self.metadata.metadata(), columns, rows);
        let file = self.file.ahead(ranges);
        file.map_err(Error::io("read", &self.path))
    }
}

/// Some rows of a file: the row groups that hold them, and their places in the rows of these groups.
struct SelectedRows {
    groups: Vec<usize>,
    selection: RowSelection,
}

impl SelectedRows {
    /// `wanted` is sorted and has no duplicates.
    fn of(metadata: &ParquetMetaData, wanted: &[usize]) -> Self {
        let (mut groups, mut ranges) = (Vec::new(), Vec::new());
        let (mut first_row, mut selectable) = (0, 0);
        for (index, group) in metadata.row_groups().iter().enumerate() {
            let num_rows = usize::try_from(group.num_rows()).unwrap_or(0);
            let rows = within(wanted, first_row..first_row + num_rows);
            if !rows.is_empty() {
                groups.push(index);
                let places = rows.iter().map(|row| row - first_row + selectable);
                ranges.extend(places.map(|place| place..place + 1));
                selectable += num_rows;
            }
            first_row += num_rows;
        }
        Self {
            groups,
            selection: RowSelection::from_consecutive_ranges(ranges.into_iter(), selectable),
        }
    }
}

/// The part of some sorted rows that lies in a range.
fn within(rows: &[usize], range: Range<usize>) -> &[usize] {
    &rows[rows.partition_point(|row| *row < range.start)
        ..rows.partition_point(|row| *row < range.end)]
}

/// The byte ranges of a file that hold these columns, for all rows or for the given ones.
fn ranges_of(
    metadata: &ParquetMetaData,
    columns: &ProjectionMask,
    rows: Option<&[usize]>,
) -> Vec<Range<u64>> {
    let mut ranges = Vec::new();
    let mut first_row = 0;
    for (index, group) in metadata.row_groups().iter().enumerate() {
        let num_rows = usize::try_from(group.num_rows()).unwrap_or(0);
        let rows = rows.map(|rows| {
            let rows = within(rows, first_row..first_row + num_rows).iter();
            rows.map(|row| row - first_row).collect::<Vec<_>>()
        });
        first_row += num_rows;
        if rows.as_ref().is_some_and(Vec::is_empty) {
            continue;
        }
        for (leaf, column) in group.columns().iter().enumerate() {
            if !columns.leaf_included(leaf) {
                continue;
            }
            let (start, length) = column.byte_range();
            let locations = || metadata.offset_index()?.get(index)?.get(leaf);
            match rows
                .as_ref()
                .zip(locations().map(|index| index.page_locations()))
            {
                Some((rows, pages)) => ranges.extend(pages_of(start, pages, rows, num_rows)),
                None => ranges.push(start..start + length),
            }
        }
    }
    ranges
}

/// The byte ranges of a column's pages with the wanted rows, and of its dictionary, which lies before the first page.
fn pages_of(
    start: u64,
    pages: &[PageLocation],
    rows: &[usize],
    num_rows: usize,
) -> Vec<Range<u64>> {
    let at = |page: &PageLocation| u64::try_from(page.offset).unwrap_or(0);
    let mut ranges = Vec::new();
    if let Some(first) = pages.first().map(at).filter(|first| *first > start) {
        ranges.push(start..first);
    }
    for (index, page) in pages.iter().enumerate() {
        let row_of = |page: &PageLocation| usize::try_from(page.first_row_index).unwrap_or(0);
        let end = pages.get(index + 1).map_or(num_rows, row_of);
        let wanted = rows.partition_point(|row| *row < row_of(page))
            < rows.partition_point(|row| *row < end);
        if wanted {
            let length = u64::try_from(page.compressed_page_size).unwrap_or(0);
            ranges.push(at(page)..at(page) + length);
        }
    }
    ranges
}

/// Reads one column of a file and no other column.
///
/// # Errors
/// As [`read_rows`].
pub fn read_column<R: Row, T: Cell>(path: &Path, name: &'static str) -> Result<Vec<T>, Error> {
    ShardReader::open(path)?.column::<R, T>(name)
}

fn read_selected<R: Row>(
    path: &Path,
    bytes: impl ChunkReader + 'static,
    metadata: ArrowReaderMetadata,
    rows: Option<SelectedRows>,
    columns: ProjectionMask,
) -> Result<Vec<R>, Error> {
    let mut builder = ParquetRecordBatchReaderBuilder::new_with_metadata(bytes, metadata)
        .with_projection(columns)
        .with_batch_size(READ_BATCH_ROWS);
    if let Some(SelectedRows { groups, selection }) = rows {
        // By default the reader decodes all pages and drops rows afterwards, if the selected rows are close together.
        builder = builder
            .with_row_groups(groups)
            .with_row_selection(selection)
            .with_row_selection_policy(RowSelectionPolicy::Selectors);
    }
    let reader = builder.build().map_err(Error::parquet("read", path))?;
    decoded(path, reader, R::decode)
}

/// Decodes the batches of a file.
fn decoded<T>(
    path: &Path,
    batches: ParquetRecordBatchReader,
    decode: impl Fn(&RecordBatch) -> Result<Vec<T>, Error>,
) -> Result<Vec<T>, Error> {
    let mut values = Vec::new();
    for batch in batches {
        let batch = batch.map_err(|error| Error::parquet("read", path)(error.into()))?;
        values.extend(decode(&batch)?);
    }
    Ok(values)
}

/// Footer of a Parquet file.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ShardDescription {
    /// Number of rows.
    pub rows: u64,
    /// Number of rows of each row group.
    pub row_groups: Vec<u64>,
    /// Columns in order.
    pub columns: Vec<ColumnDescription>,
    /// Footer entries with the prefix `motion.`; the prefix is removed.
    pub facts: Vec<(String, String)>,
    /// Program that wrote the file.
    pub created_by: Option<String>,
}

/// A leaf column of a Parquet file.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ColumnDescription {
    /// Path of the leaf, such as `transl.list.item.list.item`.
    pub path: String,
    /// Encodings in use.
    pub encodings: Vec<String>,
    /// Bytes in the file.
    pub compressed: u64,
    /// Bytes after decompression.
    pub uncompressed: u64,
}

/// Reads the footer of a file.
///
/// # Errors
/// The file cannot be read, is not Parquet, or is of another major version.
pub fn describe(path: &Path) -> Result<ShardDescription, Error> {
    let shard = ShardReader::open(path)?;
    let metadata = shard.metadata.metadata();
    let file = metadata.file_metadata();
    let size = |bytes: i64| u64::try_from(bytes).unwrap_or(0);
    let mut columns: Vec<ColumnDescription> = Vec::new();
    for group in metadata.row_groups() {
        for (index, column) in group.columns().iter().enumerate() {
            if index == columns.len() {
                columns.push(ColumnDescription {
                    path: column.column_path().string(),
                    encodings: column.encodings().map(|e| e.to_string()).collect(),
                    compressed: 0,
                    uncompressed: 0,
                });
            }
            columns[index].compressed += size(column.compressed_size());
            columns[index].uncompressed += size(column.uncompressed_size());
        }
    }
    let mut facts: Vec<(String, String)> = notes(&shard.metadata)
        .map(|(key, value)| (key.to_owned(), value.unwrap_or_default().to_owned()))
        .collect();
    facts.sort();
    Ok(ShardDescription {
        rows: size(file.num_rows()),
        row_groups: metadata
            .row_groups()
            .iter()
            .map(|group| size(group.num_rows()))
            .collect(),
        columns,
        facts,
        created_by: file.created_by().map(str::to_owned),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::PairRow;
    use crate::{MotionId, Split};

    fn pairs(count: usize) -> Vec<PairRow> {
        let id = |name: String| MotionId::parse(&name).expect("an id");
        let row = |number: usize| PairRow {
            id: format!("pair{number}"),
            split: Split::Train,
            source: "test".to_owned(),
            kind: "style".to_owned(),
            source_id: id(format!("a{number}")),
            target_id: id(format!("b{number}")),
            style: number.is_multiple_of(2).then(|| "proud".to_owned()),
            parts: vec!["LEFT_ARM".to_owned(); number % 3],
            instruction: format!("be proud {number}"),
            edit_type: None,
            accepted_by: None,
        };
        (0..count).map(row).collect()
    }

    #[test]
    fn rows_one_by_one_make_the_same_file() {
        for count in [0, 1, ROW_GROUP_PAGES, 2 * ROW_GROUP_PAGES + 3] {
            let rows = pairs(count);
            let (path, facts) = (Path::new("pairs.parquet"), [("fact", "value".to_owned())]);
            let whole = write_rows(Vec::new(), path, &rows, &facts).expect("writes");
            let mut writer = RowWriter::new(Vec::new(), path, &facts).expect("begins");
            for row in rows {
                writer.push(row).expect("writes");
            }
            assert!(writer.finish().expect("ends") == whole, "{count}");
        }
    }

    #[test]
    fn a_damaged_page_is_told_like_a_damaged_footer() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("pairs.parquet");
        let mut bytes = write_rows(Vec::new(), &path, &pairs(9), &[]).expect("writes");
        let zstd: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
        let page = bytes.windows(4).position(|four| four == zstd);
        bytes[page.expect("a compressed page")] = 0;
        std::fs::write(&path, bytes).expect("written");
        let shard = ShardReader::open(&path).expect("a whole footer");
        for error in [
            read_rows::<PairRow>(&path).expect_err("damaged"),
            shard.rows_at::<PairRow>(&[0]).expect_err("damaged"),
            shard.column::<PairRow, String>("id").expect_err("damaged"),
        ] {
            let expected = Some(("E-CORRUPT", Some(path.display().to_string())));
            assert_eq!(error.code(), expected, "{error}");
        }
    }

    #[test]
    fn rows_are_found_at_their_places_in_any_group() {
        let rows = pairs(3 * ROW_GROUP_PAGES + 9);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("pairs.parquet");
        let bytes = write_rows(Vec::new(), &path, &rows, &[]).expect("writes");
        std::fs::write(&path, bytes).expect("written");
        let shard = ShardReader::open(&path).expect("opens");
        let (group, end) = (ROW_GROUP_PAGES, rows.len());
        for places in [
            vec![],
            vec![group - 1, group],
            vec![2 * group + 1, 5, 2 * group + 1, end, end + group],
            (0..end).rev().step_by(3).collect(),
            vec![end - 1],
        ] {
            let mut expected: Vec<usize> =
                places.iter().copied().filter(|row| *row < end).collect();
            expected.sort_unstable();
            expected.dedup();
            let read: Vec<PairRow> = shard.rows_at(&places).expect("reads");
            let expected: Vec<PairRow> =
                expected.into_iter().map(|row| rows[row].clone()).collect();
            assert_eq!(read, expected, "{places:?}");
        }
    }
}
