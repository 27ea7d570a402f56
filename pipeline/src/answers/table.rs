//! Answers in a foreign Parquet file.
//!
//! The columns are found by name and read with any compatible type. Our own tables go through the strict reader
//! of `datasets-spec`.

use arrow_array::cast::AsArray;
use arrow_array::types::{Int64Type, UInt64Type};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::DataType;
use clip::{Rejected, rejected};
use formats::foreign_table::{self, ForeignTable, MAX_DEPTH, is_list, list, numbers, text};
use kinematics::motion::BODY_POSE_WIDTH;

use super::recorded::Recorded;

/// Columns that may hold the id of the item; the first that exists is used.
const ID_COLUMNS: [&str; 2] = ["id", "item"];
const MOTION_COLUMNS: [&str; 3] = ["transl", "global_orient", "body_pose"];
const FPS_COLUMN: &str = "fps";
const SEED_COLUMN: &str = "seed";
const BATCH_ROWS: usize = 64;
/// Limit on the unpacked bytes of the columns: ten thousand answers of ten seconds in double precision take 1.1 GB at
/// 20 fps.
const MAX_UNPACKED_LEN: i64 = 8 << 30;

pub(super) struct TableAnswer {
    /// Name of the item, as the row states it.
    pub(super) id: String,
    pub(super) seed: Option<u64>,
    pub(super) recorded: Result<Recorded, Rejected>,
}

/// Reads the answers of a table.
///
/// # Errors
/// `E-TABLE-FORMAT` if the bytes are no Parquet file that can be read, `E-TABLE-LIMIT` if the columns exceed the limit
/// when unpacked, `E-TABLE-COLUMNS` if a column is missing or of an incompatible type. Errors of single rows are kept
/// with the row.
pub(super) fn read(bytes: Vec<u8>) -> Result<Vec<TableAnswer>, Rejected> {
    foreign_table::read(bytes, decode)
}

fn decode(table: &ForeignTable) -> Result<Vec<TableAnswer>, Rejected> {
    let names = table.names();
    let id_column = ID_COLUMNS.into_iter().find(|name| names.contains(name));
    let missing = MOTION_COLUMNS.iter().any(|name| !names.contains(name));
    let (Some(id_column), false) = (id_column, missing) else {
        return Err(rejected!(
            "E-TABLE-COLUMNS",
            "found columns {}, expected {} and {}",
            names.join(", "),
            ID_COLUMNS.join(" or "),
            MOTION_COLUMNS.join(", ")
        ));
    };
    let wanted = MOTION_COLUMNS
        .into_iter()
        .chain([id_column, FPS_COLUMN, SEED_COLUMN]);
    let wanted: Vec<&str> = wanted.filter(|name| names.contains(name)).collect();
    let mut answers = Vec::new();
    table.for_each(&wanted, MAX_UNPACKED_LEN, BATCH_ROWS, &mut |batch| {
        for row in 0..batch.num_rows() {
            answers.push(answer(batch, row, id_column)?);
        }
        Ok(())
    })?;
    Ok(answers)
}

fn answer(batch: &RecordBatch, row: usize, id_column: &str) -> Result<TableAnswer, Rejected> {
    let column = |name: &str| batch.column_by_name(name);
    let id = column(id_column).map(|values| text(values, row));
    let id = id.unwrap_or(Ok(None)).map_err(|found| {
        rejected!(
            "E-TABLE-COLUMNS",
            "column {id_column} holds {found}, expected text"
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
            &frames::<3>(batch, MOTION_COLUMNS[0], row)?,
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

fn whole(values: &ArrayRef, row: usize) -> Option<u64> {
    match values.data_type() {
        DataType::UInt64 => Some(values.as_primitive::<UInt64Type>().value(row)),
        DataType::Int64 => u64::try_from(values.as_primitive::<Int64Type>().value(row)).ok(),
        _ => {
            let mut found = Vec::new();
            numbers(values, row, MAX_DEPTH, &mut found).ok()?;
            let [value] = found[..] else { return None };
            // Above 2^53, a double cannot represent every integer.
            let is_exact = value.fract() == 0.0 && (0.0..=2f64.powi(53)).contains(&value);
            is_exact.then_some(value as u64)
        }
    }
}

fn bad_column(name: &str, row: usize, problem: &str) -> Rejected {
    rejected!("E-TABLE-VALUE", "row {row}, {name}: {problem}")
}

/// Reads the frames `[L, D]` of a row, from nested lists or from one list of all numbers.
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
        return Err(rejected!(
            "E-TABLE-COLUMNS",
            "column {name} holds {found}, expected a list of frames"
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
