//! Tables: how row structs become Arrow batches and back, and how batches become Parquet files.

mod cell;
mod chunks;
mod shard;
mod values;

use std::path::Path;
use std::sync::Arc;

use arrow_array::Array;
pub use arrow_array::RecordBatch;
use arrow_schema::{DataType, Field, Schema};

use crate::{Error, MotionId};

pub use cell::Cell;
pub use shard::{
    ColumnDescription, RowWriter, ShardDescription, ShardReader, describe, group_rows, read_column,
    read_rows, read_rows_on, write_rows,
};
pub(crate) use shard::{borrowed_groups, write_groups};
pub use values::{Caption, PartCaption, Quality};

/// Version of the table schemas. The major number changes when an old reader would misread a
/// column; columns may be added within a major version, and readers ignore those they do not know.
pub const SCHEMA_VERSION: &str = "1.10.0";

/// Refuses a file of another major version, which this program would misread.
pub(crate) fn check_version(path: &Path, found: &str) -> Result<(), Error> {
    let major = |version: &str| version.split('.').next().unwrap_or("").to_owned();
    match major(found) == major(SCHEMA_VERSION) {
        true => Ok(()),
        false => Err(Error::Version {
            path: path.to_owned(),
            found: found.to_owned(),
            supported: SCHEMA_VERSION,
        }),
    }
}

/// One column of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Name.
    pub name: &'static str,
    /// Unit; empty if there is none.
    pub unit: &'static str,
    /// Meaning, one line.
    pub doc: &'static str,
    /// Arrow type.
    pub data_type: DataType,
    /// Whether a value may be missing.
    pub nullable: bool,
}

impl Column {
    /// The type in the short form of the format document, such as `list<fixed_size_list<f32, 3>>`.
    pub fn type_name(&self) -> String {
        type_name(&self.data_type)
    }
}

fn type_name(data_type: &DataType) -> String {
    match data_type {
        DataType::Utf8 => "utf8".to_owned(),
        DataType::Float32 => "f32".to_owned(),
        DataType::Float64 => "f64".to_owned(),
        DataType::Int32 => "i32".to_owned(),
        DataType::UInt32 => "u32".to_owned(),
        DataType::UInt64 => "u64".to_owned(),
        DataType::List(item) => format!("list<{}>", type_name(item.data_type())),
        DataType::FixedSizeList(item, width) => {
            format!("fixed_size_list<{}, {width}>", type_name(item.data_type()))
        }
        DataType::Struct(fields) => {
            let fields: Vec<String> = fields
                .iter()
                .map(|field| format!("{}: {}", field.name(), type_name(field.data_type())))
                .collect();
            format!("struct<{}>", fields.join(", "))
        }
        other => other.to_string(),
    }
}

/// A row of a table.
pub trait Row: Sized + Clone + Send + Sync {
    /// Name of the table.
    const TABLE: &'static str;

    /// Rows per page. One, unless the rows are small and read by the thousand.
    const PAGE_ROWS: usize = 1;

    /// The clips that the row is about. A dataset of chosen clips ([`Dataset::of_clips`](crate::Dataset::of_clips))
    /// contains only rows about those clips.
    fn clips(&self) -> Vec<&MotionId> {
        Vec::new()
    }

    /// The columns, in order.
    fn columns() -> Vec<Column>;

    /// Turns rows into a batch.
    ///
    /// # Errors
    /// The lists or texts of a column are together too long, or Arrow refuses the columns, a bug in a cell type.
    fn encode(rows: &[Self]) -> Result<RecordBatch, Error>;

    /// Turns a batch into rows. Columns the table does not know are ignored.
    ///
    /// # Errors
    /// A column is missing or of another type, or a value breaks its type's rule.
    fn decode(batch: &RecordBatch) -> Result<Vec<Self>, Error>;

    /// The Arrow schema.
    fn schema() -> Arc<Schema> {
        Arc::new(Schema::new(
            Self::columns()
                .into_iter()
                .map(|column| Field::new(column.name, column.data_type, column.nullable))
                .collect::<Vec<_>>(),
        ))
    }
}

/// Declares a row struct and derives its table from it. A column marked `newer` was added after version 1.0.0: if a
/// file lacks it, it has its default value. The columns after `of clips` hold the ids of the clips that a row is about.
#[macro_export]
macro_rules! table {
    (@decode $ty:ty, $table:literal, $name:expr, $batch:ident) => {
        $crate::table::decode_column::<$ty>($table, $name, $batch)
    };
    (@decode $ty:ty, $table:literal, $name:expr, $batch:ident, newer) => {
        match $batch.column_by_name($name) {
            Some(_) => $crate::table::decode_column::<$ty>($table, $name, $batch),
            None => Ok(vec![<$ty>::default(); $batch.num_rows()]),
        }
    };
    (
        $(#[doc = $struct_doc:literal])*
        $(#[derive($($derive:ident),+)])?
        pub struct $name:ident = $table:literal $(, pages of $page_rows:literal rows)? $(, of clips $($clip:ident)and+)? {
            $( #[doc = $doc:literal] pub $field:ident : $ty:ty [$unit:literal $(, $since:ident)?], )*
        }
    ) => {
        $(#[doc = $struct_doc])*
        #[derive(Clone, Debug, PartialEq $($(, $derive)+)?)]
        pub struct $name {
            $( #[doc = $doc] pub $field: $ty, )*
        }

        impl $crate::table::Row for $name {
            const TABLE: &'static str = $table;
            const PAGE_ROWS: usize = 1 $(* $page_rows)?;

            $(fn clips(&self) -> Vec<&$crate::MotionId> {
                vec![$( &self.$clip ),+]
            })?

            fn columns() -> Vec<$crate::table::Column> {
                vec![$( $crate::table::Column {
                    name: stringify!($field),
                    unit: $unit,
                    doc: str::trim_ascii($doc),
                    data_type: <$ty as $crate::table::Cell>::data_type(),
                    nullable: <$ty as $crate::table::Cell>::NULLABLE,
                }, )*]
            }

            fn encode(rows: &[Self]) -> Result<$crate::table::RecordBatch, $crate::Error> {
                let columns = vec![$( <$ty as $crate::table::Cell>::encode(
                    &mut rows.iter().map(|row| &row.$field),
                ).map_err(|problem| $crate::Error::Column {
                    table: $table,
                    column: stringify!($field).to_owned(),
                    problem,
                })?, )*];
                $crate::table::RecordBatch::try_new(Self::schema(), columns)
                    .map_err(|source| $crate::Error::Arrow { table: $table, source })
            }

            fn decode(batch: &$crate::table::RecordBatch) -> Result<Vec<Self>, $crate::Error> {
                $( let mut $field = $crate::table!(
                    @decode $ty, $table, stringify!($field), batch $(, $since)?
                )?.into_iter(); )*
                let mut rows = Vec::with_capacity(batch.num_rows());
                while let ($( Some($field), )*) = ($( $field.next(), )*) {
                    rows.push(Self { $( $field, )* });
                }
                Ok(rows)
            }
        }
    };
}
pub(crate) use table;

/// Decodes one column of a batch, for the macro `table!`.
#[doc(hidden)]
pub fn decode_column<T: Cell>(
    table: &'static str,
    name: &'static str,
    batch: &RecordBatch,
) -> Result<Vec<T>, Error> {
    let refused = |problem: String| Error::Column {
        table,
        column: name.to_owned(),
        problem,
    };
    let array = batch
        .column_by_name(name)
        .ok_or_else(|| refused("is missing".to_owned()))?;
    if *array.data_type() != T::data_type() {
        let [found, expected] = [array.data_type(), &T::data_type()].map(type_name);
        return Err(refused(format!("has type {found}, expected {expected}")));
    }
    if !T::NULLABLE && array.null_count() > 0 {
        let problem = format!("has {} missing values", array.null_count());
        return Err(refused(problem));
    }
    T::decode(array.as_ref()).map_err(|(row, problem)| {
        Error::Refused(format!(
            "table {table}, column {name:?}, row {row}: {problem}"
        ))
    })
}
