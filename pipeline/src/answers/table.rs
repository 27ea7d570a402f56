//! Answers in a foreign Parquet file.
//!
//! The columns are found by name and read with any compatible type: text of any width, numbers of any type,
//! lists of any kind and item name. Our own tables go through the strict reader of `datasets-spec`.

use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type,
    UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::DataType;
use bytes::Bytes;
use kinematics::motion::BODY_POSE_WIDTH;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder,
};

use super::recorded::Recorded;
use crate::clip::Rejected;

/// Columns that may hold the id of the item; the first that exists is used.
const ID_COLUMNS: [&str; 2] = ["id", "item"];
const MOTION_COLUMNS: [&str; 3] = ["transl", "global_orient", "body_pose"];
const FPS_COLUMN: &str = "fps";
const SEED_COLUMN: &str = "seed";
/// Rows decoded at a time.
const BATCH_ROWS: usize = 64;
/// Limit on the unpacked bytes of the columns: ten thousand answers of ten seconds in double precision take
/// 2.2 GB.
const MAX_UNPACKED_LEN: i64 = 8 << 30;
/// Limit on the nesting of lists: frames of joints of axes nest three deep.
const MAX_DEPTH: usize = 4;

/// An answer of a table.
pub(super) struct TableAnswer {
    /// The row's name of its item.
    pub(super) id: String,
    pub(super) seed: Option<u64>,
    pub(super) recorded: Result<Recorded, Rejected>,
}

/// Reads the answers of a table.
///
/// # Errors
/// `E-TABLE-FORMAT` if the bytes are no Parquet file that can be read, `E-TABLE-LIMIT` if it unpacks
/// too far, `E-TABLE-COLUMNS` if a column is missing or of an incompatible type. Errors of single rows are
/// kept with the row.
pub(super) fn read(bytes: Vec<u8>) -> Result<Vec<TableAnswer>, Rejected> {
    crate::source::refuse_pointer(&bytes)?;
    // The Parquet library panics on some damaged pages.
    std::panic::catch_unwind(|| decode(bytes)).unwrap_or_else(|_| {
        Err(Rejected::read(
            "E-TABLE-FORMAT",
            "the Parquet library failed on a page; the file is damaged",
        ))
    })
}

fn decode(bytes: Vec<u8>) -> Result<Vec<TableAnswer>, Rejected> {
    let len = bytes.len();
    let broken = |error: &dyn std::fmt::Display| {
        Rejected::read(
            "E-TABLE-FORMAT",
            format!("found no Parquet file that can be read in {len} bytes ({error})"),
        )
    };
    let bytes = Bytes::from(bytes);
    let options = ArrowReaderOptions::new();
    let metadata = ArrowReaderMetadata::load(&bytes, options).map_err(|error| broken(&error))?;
    let names: Vec<&str> = metadata
        .schema()
        .fields()
        .iter()
        .map(|field| field.name().as_str())
        .collect();
    let id_column = ID_COLUMNS.into_iter().find(|name| names.contains(name));
    let missing = MOTION_COLUMNS.iter().any(|name| !names.contains(name));
    let (Some(id_column), false) = (id_column, missing) else {
        return Err(Rejected::read(
            "E-TABLE-COLUMNS",
            format!(
                "found columns {}, expected {} and {}",
                names.join(", "),
                ID_COLUMNS.join(" or "),
                MOTION_COLUMNS.join(", ")
            ),
        ));
    };
    let wanted: Vec<&str> = MOTION_COLUMNS
        .into_iter()
        .chain([id_column, FPS_COLUMN, SEED_COLUMN])
        .filter(|name| names.contains(name))
        .collect();
    let mut unpacked = 0i64;
    for group in metadata.metadata().row_groups() {
        for column in group.columns() {
            let root = column.column_path().parts().first();
            if root.is_some_and(|root| wanted.contains(&root.as_str())) {
                unpacked = unpacked.saturating_add(column.uncompressed_size().max(0));
            }
        }
    }
    if unpacked > MAX_UNPACKED_LEN {
        return Err(Rejected::read(
            "E-TABLE-LIMIT",
            format!(
                "its columns unpack from {len} to {unpacked} bytes, expected at most \
                 {MAX_UNPACKED_LEN}; write several files"
            ),
        ));
    }
    let mask = ProjectionMask::columns(metadata.parquet_schema(), wanted.iter().copied());
    let reader = ParquetRecordBatchReaderBuilder::new_with_metadata(bytes, metadata)
        .with_projection(mask)
        .with_batch_size(BATCH_ROWS)
        .build()
        .map_err(|error| broken(&error))?;
    let mut answers = Vec::new();
    for batch in reader {
        let batch = batch.map_err(|error| broken(&error))?;
        for row in 0..batch.num_rows() {
            answers.push(answer(&batch, row, id_column)?);
        }
    }
    Ok(answers)
}

fn answer(batch: &RecordBatch, row: usize, id_column: &str) -> Result<TableAnswer, Rejected> {
    let column = |name: &str| batch.column_by_name(name);
    let id = column(id_column).map(|values| text(values, row));
    let id = id.unwrap_or(Ok(None)).map_err(|found| {
        Rejected::read(
            "E-TABLE-COLUMNS",
            format!("column {id_column} holds {found}, expected text"),
        )
    })?;
    let one = |name: &str| -> Result<Option<f64>, Rejected> {
        let Some(values) = column(name).filter(|values| values.is_valid(row)) else {
            return Ok(None);
        };
        let mut found = Vec::new();
        numbers(values, row, 0, &mut found).map_err(|problem| bad_column(name, row, &problem))?;
        Ok(found.first().copied())
    };
    let recorded = || -> Result<Recorded, Rejected> {
        let recorded = Recorded::of_columns(
            frames::<3>(batch, MOTION_COLUMNS[0], row)?,
            &frames::<3>(batch, MOTION_COLUMNS[1], row)?,
            &frames::<BODY_POSE_WIDTH>(batch, MOTION_COLUMNS[2], row)?,
        )?;
        let fps = one(FPS_COLUMN)?;
        Ok(Recorded { fps, ..recorded })
    };
    let seed = match column(SEED_COLUMN).filter(|values| values.is_valid(row)) {
        None => Ok(None),
        Some(values) => whole(values, row).map(Some).ok_or_else(|| {
            bad_column(
                SEED_COLUMN,
                row,
                "expected a whole number that is not negative",
            )
        }),
    };
    Ok(TableAnswer {
        id: id.unwrap_or_default(),
        seed: seed.as_ref().ok().copied().flatten(),
        recorded: seed.and_then(|_| recorded()),
    })
}

/// A whole number, with all its digits.
fn whole(values: &ArrayRef, row: usize) -> Option<u64> {
    match values.data_type() {
        DataType::UInt64 => Some(values.as_primitive::<UInt64Type>().value(row)),
        DataType::Int64 => u64::try_from(values.as_primitive::<Int64Type>().value(row)).ok(),
        _ => {
            let mut found = Vec::new();
            numbers(values, row, MAX_DEPTH, &mut found).ok()?;
            let [value] = found[..] else { return None };
            // Beyond this a double cannot hold odd numbers.
            let is_exact = value.fract() == 0.0 && (0.0..=2f64.powi(53)).contains(&value);
            is_exact.then_some(value as u64)
        }
    }
}

fn bad_column(name: &str, row: usize, problem: &str) -> Rejected {
    Rejected::read("E-TABLE-VALUE", format!("row {row}, {name}: {problem}"))
}

/// The text of a row of any width, or the type that the column has instead.
fn text(values: &ArrayRef, row: usize) -> Result<Option<String>, String> {
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

/// The frames of `D` numbers that a row has: nested lists of them, or all numbers in one list.
fn frames<const D: usize>(
    batch: &RecordBatch,
    name: &str,
    row: usize,
) -> Result<Vec<[f64; D]>, Rejected> {
    let bad = |problem: String| bad_column(name, row, &problem);
    let values = batch
        .column_by_name(name)
        .ok_or_else(|| bad("is missing".to_owned()))?;
    if values.is_null(row) {
        return Err(bad("has no value".to_owned()));
    }
    let Some((list, range)) = list(values, row) else {
        let found = values.data_type();
        return Err(Rejected::read(
            "E-TABLE-COLUMNS",
            format!("column {name} holds {found}, expected a list of frames"),
        ));
    };
    let mut found = Vec::new();
    if is_list(list.data_type()) {
        for (frame, at) in range.enumerate() {
            let before = found.len();
            numbers(&list, at, 1, &mut found).map_err(bad)?;
            let width = found.len() - before;
            if width != D {
                return Err(bad(format!(
                    "found {width} numbers in frame {frame}, expected {D}"
                )));
            }
        }
    } else {
        for at in range {
            numbers(&list, at, 1, &mut found).map_err(bad)?;
        }
        if found.len() % D != 0 {
            return Err(bad(format!(
                "found {} numbers in one list, expected a multiple of {D}",
                found.len()
            )));
        }
    }
    Ok(found.as_chunks::<D>().0.to_vec())
}

fn is_list(data_type: &DataType) -> bool {
    matches!(
        data_type,
        DataType::List(_) | DataType::LargeList(_) | DataType::FixedSizeList(..)
    )
}

/// The values of a list column and the range of a row; none for other columns.
fn list(values: &ArrayRef, row: usize) -> Option<(ArrayRef, std::ops::Range<usize>)> {
    Some(match values.data_type() {
        DataType::List(_) => {
            let list = values.as_list::<i32>();
            let bounds = list.value_offsets();
            // Arrow guarantees that offsets are non-negative and ascending.
            let range = bounds[row] as usize..bounds[row + 1] as usize;
            (list.values().clone(), range)
        }
        DataType::LargeList(_) => {
            let list = values.as_list::<i64>();
            let bounds = list.value_offsets();
            let range = bounds[row] as usize..bounds[row + 1] as usize;
            (list.values().clone(), range)
        }
        DataType::FixedSizeList(_, width) => {
            let list = values.as_fixed_size_list();
            let start = list.value_offset(row) as usize;
            let range = start..start + usize::try_from(*width).unwrap_or(0);
            (list.values().clone(), range)
        }
        _ => return None,
    })
}

/// Appends the numbers of a value, however deep they are nested.
fn numbers(values: &ArrayRef, row: usize, depth: usize, out: &mut Vec<f64>) -> Result<(), String> {
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
