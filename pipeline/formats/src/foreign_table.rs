//! Foreign Parquet files: columns by name, with any compatible type.
//!
//! Text may be of any width, numbers of any type, lists of any kind and item name.

use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type,
    UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, OffsetSizeTrait, RecordBatch};
use arrow_schema::DataType;
use bytes::Bytes;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder,
};

use clip::{Rejected, rejected};

/// Limit on the nesting of lists. A list of frames, each a list of joints, each a list of coordinates, nests three
/// deep.
pub const MAX_DEPTH: usize = 4;

/// An opened foreign Parquet file.
pub struct ForeignTable {
    bytes: Bytes,
    metadata: ArrowReaderMetadata,
}

/// Opens a file and decodes it with `decode`.
///
/// # Errors
/// `E-LFS-POINTER` for a Git LFS pointer, `E-TABLE-FORMAT` if the bytes are no readable Parquet file, and errors of
/// `decode`.
pub fn read<T>(
    bytes: Vec<u8>,
    decode: impl FnOnce(&ForeignTable) -> Result<T, Rejected> + std::panic::UnwindSafe,
) -> Result<T, Rejected> {
    crate::source::refuse_pointer(&bytes)?;
    // The Parquet library panics on some damaged pages.
    std::panic::catch_unwind(|| decode(&ForeignTable::open(bytes)?)).unwrap_or_else(|_| {
        let reason = "the Parquet library failed on a page; the file is damaged";
        Err(Rejected::read("E-TABLE-FORMAT", reason))
    })
}

fn broken(len: usize, error: &dyn std::fmt::Display) -> Rejected {
    rejected!(
        "E-TABLE-FORMAT",
        "found no Parquet file that can be read in {len} bytes ({error})"
    )
}

impl ForeignTable {
    fn open(bytes: Vec<u8>) -> Result<Self, Rejected> {
        let len = bytes.len();
        let bytes = Bytes::from(bytes);
        let metadata = ArrowReaderMetadata::load(&bytes, ArrowReaderOptions::new())
            .map_err(|error| broken(len, &error))?;
        Ok(Self { bytes, metadata })
    }

    /// Names of the columns.
    pub fn names(&self) -> Vec<&str> {
        let fields = self.metadata.schema().fields().iter();
        fields.map(|field| field.name().as_str()).collect()
    }

    /// Reads the `wanted` columns and calls `visit` with batches of at most `rows_at_once` rows.
    ///
    /// # Errors
    /// `E-TABLE-FORMAT`, `E-TABLE-LIMIT` if the columns unpack to more than `max_unpacked` bytes, and errors of
    /// `visit`.
    pub fn for_each(
        &self,
        wanted: &[&str],
        max_unpacked: i64,
        rows_at_once: usize,
        visit: &mut dyn FnMut(&RecordBatch) -> Result<(), Rejected>,
    ) -> Result<(), Rejected> {
        let len = self.bytes.len();
        let mut unpacked = 0i64;
        for group in self.metadata.metadata().row_groups() {
            for column in group.columns() {
                let root = column.column_path().parts().first();
                if root.is_some_and(|root| wanted.contains(&root.as_str())) {
                    unpacked = unpacked.saturating_add(column.uncompressed_size().max(0));
                }
            }
        }
        if unpacked > max_unpacked {
            return Err(rejected!(
                "E-TABLE-LIMIT",
                "its columns unpack from {len} to {unpacked} bytes, expected at most \
                     {max_unpacked}; write several files"
            ));
        }
        let schema = self.metadata.parquet_schema();
        let mask = ProjectionMask::columns(schema, wanted.iter().copied());
        let metadata = self.metadata.clone();
        let reader =
            ParquetRecordBatchReaderBuilder::new_with_metadata(self.bytes.clone(), metadata)
                .with_projection(mask)
                .with_batch_size(rows_at_once)
                .build()
                .map_err(|error| broken(len, &error))?;
        for batch in reader {
            visit(&batch.map_err(|error| broken(len, &error))?)?;
        }
        Ok(())
    }
}

/// The text of a row in a string column, dictionary-encoded or not; `None` if the row is null.
///
/// # Errors
/// The column is not text; the error is its type.
pub fn text(values: &ArrayRef, row: usize) -> Result<Option<String>, String> {
    if values.is_null(row) {
        return Ok(None);
    }
    Ok(Some(match values.data_type() {
        DataType::Utf8 => values.as_string::<i32>().value(row).to_owned(),
        DataType::LargeUtf8 => values.as_string::<i64>().value(row).to_owned(),
        DataType::Utf8View => values.as_string_view().value(row).to_owned(),
        DataType::Dictionary(..) => {
            let dictionary = values.as_any_dictionary();
            let key = dictionary.normalized_keys()[row];
            return text(dictionary.values(), key);
        }
        other => return Err(other.to_string()),
    }))
}

/// Whether a type is a list.
pub fn is_list(data_type: &DataType) -> bool {
    matches!(
        data_type,
        DataType::List(_) | DataType::LargeList(_) | DataType::FixedSizeList(..)
    )
}

/// The items of all rows of a list column, and the range of the given row; `None` for other columns.
pub fn list(values: &ArrayRef, row: usize) -> Option<(ArrayRef, std::ops::Range<usize>)> {
    Some(match values.data_type() {
        DataType::List(_) => list_by_offsets::<i32>(values, row),
        DataType::LargeList(_) => list_by_offsets::<i64>(values, row),
        DataType::FixedSizeList(_, width) => {
            let list = values.as_fixed_size_list();
            let start = list.value_offset(row) as usize;
            let range = start..start + usize::try_from(*width).unwrap_or(0);
            (list.values().clone(), range)
        }
        _ => return None,
    })
}

/// The values of a list and the range of a row in them. `O` is the type of the offsets, 32 or 64 bits.
fn list_by_offsets<O: OffsetSizeTrait>(
    values: &ArrayRef,
    row: usize,
) -> (ArrayRef, std::ops::Range<usize>) {
    let list = values.as_list::<O>();
    let bounds = list.value_offsets();
    // Arrow guarantees that offsets are not negative and ascend.
    let range = bounds[row].as_usize()..bounds[row + 1].as_usize();
    (list.values().clone(), range)
}

/// Appends the numbers of a value, which may be a list of up to [`MAX_DEPTH`] levels. `depth` is the number of lists
/// that contain the value: 0 for a row of a column.
///
/// # Errors
/// A value is missing or not a number, or the lists nest too deep.
pub fn numbers(
    values: &ArrayRef,
    row: usize,
    depth: usize,
    out: &mut Vec<f64>,
) -> Result<(), String> {
    if values.is_null(row) {
        return Err("a number is missing".to_owned());
    }
    if let Some((inner, range)) = list(values, row) {
        if depth == MAX_DEPTH {
            return Err(format!("lists nest deeper than {MAX_DEPTH}"));
        }
        return range
            .into_iter()
            .try_for_each(|at| numbers(&inner, at, depth + 1, out));
    }
    out.push(match values.data_type() {
        DataType::Float32 => values.as_primitive::<Float32Type>().value(row).into(),
        DataType::Float64 => values.as_primitive::<Float64Type>().value(row),
        DataType::Int8 => values.as_primitive::<Int8Type>().value(row).into(),
        DataType::Int16 => values.as_primitive::<Int16Type>().value(row).into(),
        DataType::Int32 => values.as_primitive::<Int32Type>().value(row).into(),
        DataType::Int64 => values.as_primitive::<Int64Type>().value(row) as f64,
        DataType::UInt8 => values.as_primitive::<UInt8Type>().value(row).into(),
        DataType::UInt16 => values.as_primitive::<UInt16Type>().value(row).into(),
        DataType::UInt32 => values.as_primitive::<UInt32Type>().value(row).into(),
        DataType::UInt64 => values.as_primitive::<UInt64Type>().value(row) as f64,
        other => return Err(format!("holds {other}, expected numbers")),
    });
    Ok(())
}
