//! Conversion between Arrow arrays and polars series.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int32Type, UInt32Type, UInt64Type,
};
use arrow_array::{
    Array, ArrayRef, BooleanArray, FixedSizeListArray, Float32Array, Float64Array, Int32Array,
    Int64Array, ListArray, StringArray, StructArray, UInt32Array, UInt64Array, new_empty_array,
};
use arrow_buffer::{NullBuffer, OffsetBuffer};
use arrow_schema::{DataType, Field, Fields};
use polars::prelude as pl;
use polars_arrow::array as pa;
use polars_arrow::bitmap::Bitmap;
use polars_arrow::offset::OffsetsBuffer;
use polars_arrow::types::NativeType;

use pl::ArrayFromIter as _;

/// The polars type of columns with this Arrow type.
pub(crate) fn polars_type(data_type: &DataType) -> Result<pl::DataType, String> {
    let empty = new_empty_array(data_type);
    Ok(series("", empty.as_ref())?.dtype().clone())
}

/// A polars series with the values of an Arrow array.
pub(crate) fn series(name: &str, array: &dyn Array) -> Result<pl::Series, String> {
    let array = polars_array(array)?;
    pl::Series::from_arrow(name.into(), array).map_err(|error| error.to_string())
}

fn polars_array(array: &dyn Array) -> Result<Box<dyn pa::Array>, String> {
    let fails = |error: pl::PolarsError| error.to_string();
    Ok(match array.data_type() {
        DataType::Utf8 => Box::new(pa::Utf8ViewArray::arr_from_iter(
            array.as_string::<i32>().iter(),
        )),
        DataType::Boolean => Box::new(pa::BooleanArray::from_iter(array.as_boolean().iter())),
        DataType::Float32 => primitive::<Float32Type>(array),
        DataType::Float64 => primitive::<Float64Type>(array),
        DataType::Int32 => primitive::<Int32Type>(array),
        DataType::UInt32 => primitive::<UInt32Type>(array),
        DataType::UInt64 => primitive::<UInt64Type>(array),
        DataType::List(_) => {
            let list = array.as_list::<i32>();
            let values = polars_array(list.values().as_ref())?;
            let offsets: Vec<i64> = list.offsets().iter().map(|&at| i64::from(at)).collect();
            let offsets = OffsetsBuffer::<i64>::try_from(offsets).map_err(fails)?;
            let data_type = pa::ListArray::<i64>::default_datatype(values.dtype().clone());
            let made = pa::ListArray::try_new(data_type, offsets, values, validity(array));
            Box::new(made.map_err(fails)?)
        }
        DataType::FixedSizeList(_, width) => {
            let list = array.as_fixed_size_list();
            let values = polars_array(list.values().as_ref())?;
            let width = usize::try_from(*width).unwrap_or(0);
            let data_type = pa::FixedSizeListArray::default_datatype(values.dtype().clone(), width);
            let made =
                pa::FixedSizeListArray::try_new(data_type, list.len(), values, validity(array));
            Box::new(made.map_err(fails)?)
        }
        DataType::Struct(fields) => {
            let columns: Vec<Box<dyn pa::Array>> = array
                .as_struct()
                .columns()
                .iter()
                .map(|column| polars_array(column.as_ref()))
                .collect::<Result<_, _>>()?;
            let named = fields.iter().zip(&columns);
            let fields = named.map(|(field, column)| {
                let name = field.name().as_str().into();
                polars_arrow::datatypes::Field::new(name, column.dtype().clone(), true)
            });
            let fields = fields.collect();
            let data_type = polars_arrow::datatypes::ArrowDataType::Struct(fields);
            let made = pa::StructArray::try_new(data_type, array.len(), columns, validity(array));
            Box::new(made.map_err(fails)?)
        }
        other => return Err(format!("columns of type {other} cannot be asked for")),
    })
}

fn primitive<T>(array: &dyn Array) -> Box<dyn pa::Array>
where
    T: ArrowPrimitiveType,
    T::Native: NativeType,
{
    let array = array.as_primitive::<T>();
    let values = pa::PrimitiveArray::from_vec(array.values().to_vec());
    Box::new(values.with_validity(validity(array)))
}

fn validity(array: &dyn Array) -> Option<Bitmap> {
    let nulls = array.nulls()?;
    Some(Bitmap::from_iter(nulls.iter()))
}

/// An Arrow array with the values of a polars series. Integers of other widths become 64 bits wide; types that our
/// tables do not have, such as dates, become text.
pub(crate) fn arrow_array(series: &pl::Series) -> Result<ArrayRef, String> {
    let fails = |error: pl::PolarsError| error.to_string();
    let series = series.rechunk();
    Ok(match series.dtype() {
        pl::DataType::String => {
            Arc::new(StringArray::from_iter(series.str().map_err(fails)?.iter()))
        }
        pl::DataType::Boolean => Arc::new(BooleanArray::from_iter(
            series.bool().map_err(fails)?.iter(),
        )),
        pl::DataType::Float32 => {
            Arc::new(Float32Array::from_iter(series.f32().map_err(fails)?.iter()))
        }
        pl::DataType::Float64 => {
            Arc::new(Float64Array::from_iter(series.f64().map_err(fails)?.iter()))
        }
        pl::DataType::Int32 => Arc::new(Int32Array::from_iter(series.i32().map_err(fails)?.iter())),
        pl::DataType::Int64 => Arc::new(Int64Array::from_iter(series.i64().map_err(fails)?.iter())),
        pl::DataType::UInt32 => {
            Arc::new(UInt32Array::from_iter(series.u32().map_err(fails)?.iter()))
        }
        pl::DataType::UInt64 => {
            Arc::new(UInt64Array::from_iter(series.u64().map_err(fails)?.iter()))
        }
        pl::DataType::List(_) => {
            let list = series.list().map_err(fails)?;
            let lengths = list.iter().map(|row| row.map_or(0, |row| row.len()));
            let offsets = OffsetBuffer::<i32>::from_lengths(lengths);
            let values = series.explode(EXPLODED).map_err(fails)?;
            let values = arrow_array(&values)?;
            let item = item(&values);
            let nulls = nulls(&series);
            Arc::new(ListArray::try_new(item, offsets, values, nulls).map_err(|e| e.to_string())?)
        }
        pl::DataType::Array(_, width) => {
            let values = series.explode(EXPLODED).map_err(fails)?;
            let values = arrow_array(&values)?;
            let item = item(&values);
            let width = i32::try_from(*width).unwrap_or(i32::MAX);
            let made = FixedSizeListArray::try_new(item, width, values, nulls(&series));
            Arc::new(made.map_err(|error| error.to_string())?)
        }
        pl::DataType::Struct(_) => {
            let columns: Vec<(String, ArrayRef)> = series
                .struct_()
                .map_err(fails)?
                .fields_as_series()
                .iter()
                .map(|field| Ok((field.name().to_string(), arrow_array(field)?)))
                .collect::<Result<_, String>>()?;
            let fields = columns.iter().map(|(name, column)| field(name, column));
            let fields: Fields = fields.collect();
            let columns = columns.into_iter().map(|(_, column)| column).collect();
            let made = StructArray::try_new(fields, columns, nulls(&series));
            Arc::new(made.map_err(|error| error.to_string())?)
        }
        pl::DataType::Int8 | pl::DataType::Int16 | pl::DataType::Int128 => {
            arrow_array(&series.cast(&pl::DataType::Int64).map_err(fails)?)?
        }
        pl::DataType::UInt8 | pl::DataType::UInt16 | pl::DataType::UInt128 => {
            arrow_array(&series.cast(&pl::DataType::UInt64).map_err(fails)?)?
        }
        _ => arrow_array(&series.cast(&pl::DataType::String).map_err(fails)?)?,
    })
}

/// The Arrow field of a column. It is nullable only if the column holds nulls.
pub(crate) fn field(name: &str, column: &ArrayRef) -> Field {
    Field::new(name, column.data_type().clone(), column.null_count() > 0)
}

fn item(values: &ArrayRef) -> Arc<Field> {
    Arc::new(field("item", values))
}

/// Unnests lists, without rows for empty or missing lists.
const EXPLODED: pl::ExplodeOptions = pl::ExplodeOptions {
    empty_as_null: false,
    keep_nulls: false,
};

fn nulls(series: &pl::Series) -> Option<NullBuffer> {
    (series.null_count() > 0)
        .then(|| NullBuffer::from_iter(series.is_not_null().iter().map(|is| is == Some(true))))
}
