//! Answers to queries.

use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch, RecordBatchOptions};
use arrow_schema::Schema;
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::properties::WriterProperties;
use polars::prelude as pl;
use serde::de::DeserializeOwned;
use serde_json::{Map, Number, Value};

use crate::Error;
use crate::arrays::{arrow_array, field};
use crate::scan::PLACE;

/// The rows that answer a query.
#[derive(Clone, Debug)]
pub struct Answer {
    frame: pl::DataFrame,
}

impl Answer {
    pub(crate) fn new(frame: pl::DataFrame) -> Self {
        Self { frame }
    }

    /// Names of the columns.
    pub fn columns(&self) -> Vec<String> {
        let names = self.frame.get_column_names().into_iter();
        names.map(|name| name.to_string()).collect()
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.frame.height()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether a column holds numbers.
    pub fn is_number(&self, column: usize) -> bool {
        let columns = self.frame.columns();
        columns
            .get(column)
            .is_some_and(|column| column.dtype().is_primitive_numeric())
    }

    /// The values of a row, in the order of the columns. Types that JSON lacks, such as dates, become text; numbers
    /// that are not finite become null.
    pub fn row(&self, row: usize) -> Vec<Value> {
        let columns = self.frame.columns().iter();
        columns
            .map(|column| column.get(row).map_or(Value::Null, |value| json(&value)))
            .collect()
    }

    /// The rows as objects of a type, whose fields are the columns.
    ///
    /// # Errors
    /// A row does not have the type.
    pub fn rows<T: DeserializeOwned>(&self) -> Result<Vec<T>, Error> {
        let names = self.columns();
        let object = |row: usize| {
            let fields: Map<String, Value> = names.iter().cloned().zip(self.row(row)).collect();
            serde_json::from_value(Value::Object(fields)).map_err(|error| Error::Sql {
                text: names.join(", "),
                problem: error.to_string(),
            })
        };
        (0..self.len()).map(object).collect()
    }

    /// The rows as an Arrow batch. Dates and times become texts.
    ///
    /// # Errors
    /// A column cannot be converted to Arrow.
    pub fn batch(&self) -> Result<RecordBatch, Error> {
        let mut fields = Vec::new();
        let mut arrays: Vec<ArrayRef> = Vec::new();
        for column in self.frame.columns() {
            let array = arrow_array(column.as_materialized_series()).map_err(Error::Parquet)?;
            fields.push(field(column.name().as_str(), &array));
            arrays.push(array);
        }
        let options = RecordBatchOptions::new().with_row_count(Some(self.len()));
        let schema = Arc::new(Schema::new(fields));
        RecordBatch::try_new_with_options(schema, arrays, &options)
            .map_err(|error| Error::Parquet(error.to_string()))
    }

    /// The rows as a Parquet file.
    ///
    /// # Errors
    /// As [`Answer::batch`].
    pub fn parquet(&self) -> Result<Vec<u8>, Error> {
        let fails = |error: parquet::errors::ParquetError| Error::Parquet(error.to_string());
        let batch = self.batch()?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .build();
        let mut bytes = Vec::new();
        let mut writer =
            ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties)).map_err(fails)?;
        writer.write(&batch).map_err(fails)?;
        writer.close().map_err(fails)?;
        Ok(bytes)
    }

    pub(crate) fn places(&self) -> Vec<usize> {
        let column = self.frame.column(PLACE).and_then(|column| column.u32());
        let places = column
            .into_iter()
            .flat_map(|places| places.iter().flatten());
        let mut places: Vec<usize> = places
            .filter_map(|place| usize::try_from(place).ok())
            .collect();
        places.sort_unstable();
        places
    }
}

fn json(value: &pl::AnyValue<'_>) -> Value {
    let items =
        |series: &pl::Series| Value::Array(series.iter().map(|value| json(&value)).collect());
    let object = |fields: &[pl::Field], values: &[pl::AnyValue<'_>]| {
        let named = fields.iter().zip(values);
        Value::Object(
            named
                .map(|(field, value)| (field.name().to_string(), json(value)))
                .collect(),
        )
    };
    match value {
        pl::AnyValue::Null => Value::Null,
        pl::AnyValue::Boolean(is) => Value::Bool(*is),
        pl::AnyValue::String(text) => Value::String((*text).to_owned()),
        pl::AnyValue::StringOwned(text) => Value::String(text.to_string()),
        pl::AnyValue::Float32(number) => {
            // Use the shortest digits of the single-precision number, not those of its conversion to double.
            let shortest = number.to_string().parse::<f64>().ok();
            shortest
                .and_then(Number::from_f64)
                .map_or(Value::Null, Value::Number)
        }
        pl::AnyValue::Float64(number) => {
            Number::from_f64(*number).map_or(Value::Null, Value::Number)
        }
        pl::AnyValue::List(series) | pl::AnyValue::Array(series, _) => items(series),
        pl::AnyValue::Struct(_, _, fields) => {
            object(fields, &value._iter_struct_av().collect::<Vec<_>>())
        }
        // A column with one row gives this variant, on which the iterator above panics.
        pl::AnyValue::StructOwned(owned) => object(&owned.1, &owned.0),
        other => match (other.extract::<i64>(), other.extract::<u64>()) {
            (Some(number), _) if other.is_integer() => number.into(),
            (_, Some(number)) if other.is_integer() => number.into(),
            _ => Value::String(other.to_string()),
        },
    }
}
