//! The table with the description and performer of each motion.

use std::collections::BTreeMap;

use arrow_array::cast::AsArray;
use arrow_array::{Array, RecordBatch};
use arrow_schema::DataType;
use csv::StringRecord;

use crate::csv_lines;
use crate::foreign_table::{self, ForeignTable, text};
use crate::source::names::file_name;
use clip::{Rejected, rejected};

/// Columns that may hold the file name of a motion; the first that exists is used.
const NAME_COLUMNS: [&str; 2] = ["filename", "move_name"];
const MIRROR_COLUMN: &str = "is_mirror";
const SUBJECT_COLUMN: &str = "actor_uid";
const ACTION_COLUMN: &str = "content_type_of_movement";
const STYLE_COLUMN: &str = "content_uniform_style";
/// Columns that become captions of the whole clip, in this order.
const CAPTION_COLUMNS: [&str; 7] = [
    "content_natural_desc_1",
    "content_natural_desc_2",
    "content_natural_desc_3",
    "content_natural_desc_4",
    "content_short_description",
    "content_short_description_2",
    "content_technical_description",
];
/// Rows decoded at a time.
const BATCH_ROWS: usize = 1024;
/// Limit on the unpacked bytes of the columns that are read; for 142,220 motions they take some 100 MB.
const MAX_UNPACKED_LEN: i64 = 2 << 30;

/// Row of a motion in the table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Described {
    pub captions: Vec<String>,
    pub action: Option<String>,
    pub style: Option<String>,
    pub subject: Option<String>,
    pub(super) is_mirrored: bool,
}

/// The motions of a table by name, and the first problem of a table that can be used in part.
pub(super) type Table = (BTreeMap<String, Described>, Option<Rejected>);

/// Reads a table in Parquet. Only motions that are `wanted` are kept.
///
/// # Errors
/// `E-LFS-POINTER`, `E-TABLE-FORMAT`, `E-TABLE-LIMIT`, or `E-TABLE-COLUMNS` if no column names the motions.
pub(super) fn of_parquet(
    bytes: Vec<u8>,
    wanted: &(dyn Fn(&str) -> bool + std::panic::RefUnwindSafe),
) -> Result<Table, Rejected> {
    foreign_table::read(bytes, |table: &ForeignTable| {
        let names = table.names();
        let name_column = name_column(&names)?;
        let columns: Vec<&str> = [
            name_column,
            MIRROR_COLUMN,
            SUBJECT_COLUMN,
            ACTION_COLUMN,
            STYLE_COLUMN,
        ]
        .into_iter()
        .chain(CAPTION_COLUMNS)
        .filter(|column| names.contains(column))
        .collect();
        let mut motions = BTreeMap::new();
        table.for_each(&columns, MAX_UNPACKED_LEN, BATCH_ROWS, &mut |batch| {
            for row in 0..batch.num_rows() {
                let Some(name) = cell(batch, name_column, row)? else {
                    continue;
                };
                let name = stem(&name);
                if wanted(name) {
                    let described = Described::of(|column| cell(batch, column, row))?;
                    motions.insert(name.to_owned(), described);
                }
            }
            Ok(())
        })?;
        Ok((motions, None))
    })
}

/// The text of a cell; `true` or `false` for a Boolean. `None` if it is empty or there is no such column.
fn cell(batch: &RecordBatch, column: &str, row: usize) -> Result<Option<String>, Rejected> {
    let Some(values) = batch.column_by_name(column) else {
        return Ok(None);
    };
    if *values.data_type() == DataType::Boolean {
        let value = values.is_valid(row).then(|| values.as_boolean().value(row));
        return Ok(value.map(|value| value.to_string()));
    }
    text(values, row).map_err(|found| {
        rejected!(
            "E-TABLE-COLUMNS",
            "column {column} holds {found}, expected text"
        )
    })
}

/// Reads a table in CSV. Only motions that are `wanted` are kept.
///
/// # Errors
/// `E-LFS-POINTER`, or `E-TABLE-COLUMNS` if no column names the motions. Unusable lines are skipped; the first one is
/// returned with the table as `E-SEED-LABELS`.
pub(super) fn of_csv(bytes: &[u8], wanted: &dyn Fn(&str) -> bool) -> Result<Table, Rejected> {
    crate::source::refuse_pointer(bytes)?;
    let mut records = csv_lines::records(bytes);
    let header = match records.next() {
        Some((_, Ok(header))) => header,
        _ => StringRecord::new(),
    };
    let names: Vec<&str> = header.iter().collect();
    let name_column = name_column(&names)?;
    let place: BTreeMap<&str, usize> = names.iter().copied().zip(0..).collect();
    let mut motions = BTreeMap::new();
    let mut problem = None;
    for (line, record) in records {
        let record = record.and_then(|record| match record.len() == names.len() {
            true => Ok(record),
            false => Err(format!(
                "it has {} fields, expected {}",
                record.len(),
                names.len()
            )),
        });
        match record {
            Ok(record) => {
                let cell = |column: &str| record.get(*place.get(column)?).map(str::to_owned);
                let name = cell(name_column).unwrap_or_default();
                let name = stem(&name);
                if wanted(name) {
                    let described = Described::of(|column| Ok(cell(column)))?;
                    motions.insert(name.to_owned(), described);
                }
            }
            Err(reason) => {
                problem.get_or_insert_with(|| {
                    rejected!(
                        "E-SEED-LABELS",
                        "line {line}: {reason}; the other lines were read"
                    )
                });
            }
        }
    }
    Ok((motions, problem))
}

fn name_column(names: &[&str]) -> Result<&'static str, Rejected> {
    let mut columns = NAME_COLUMNS.into_iter();
    columns
        .find(|column| names.contains(column))
        .ok_or_else(|| {
            let found = names[..names.len().min(12)].join(", ");
            rejected!(
                "E-TABLE-COLUMNS",
                "found columns {found}, expected {}",
                NAME_COLUMNS.join(" or ")
            )
        })
}

/// The name of a motion, without the folders and the extension that some tables give it.
pub(super) fn stem(name: &str) -> &str {
    let name = file_name(name.trim());
    [".bvh", ".csv"]
        .iter()
        .find_map(|extension| name.strip_suffix(extension))
        .unwrap_or(name)
}

impl Described {
    fn of(cell: impl Fn(&str) -> Result<Option<String>, Rejected>) -> Result<Self, Rejected> {
        let stated = |column: &str| -> Result<Option<String>, Rejected> {
            let text = cell(column)?.map(|text| text.trim().to_owned());
            // Pandas writes missing text as `nan` or `None`.
            Ok(text.filter(|text| !["", "nan", "None"].contains(&text.as_str())))
        };
        let mut captions: Vec<String> = Vec::new();
        for column in CAPTION_COLUMNS {
            let caption = stated(column)?;
            captions.extend(caption.filter(|caption| !captions.contains(caption)));
        }
        let mirrored = stated(MIRROR_COLUMN)?.unwrap_or_default().to_lowercase();
        Ok(Self {
            captions,
            action: stated(ACTION_COLUMN)?,
            style: stated(STYLE_COLUMN)?,
            subject: stated(SUBJECT_COLUMN)?,
            is_mirrored: ["true", "1", "1.0"].contains(&mirrored.as_str()),
        })
    }
}
