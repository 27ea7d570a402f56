//! How the Rust type of a column maps to Arrow.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int32Type, UInt32Type, UInt64Type};
use arrow_array::{
    Array, ArrayRef, FixedSizeListArray, Float32Array, ListArray, PrimitiveArray, StringArray,
    StructArray,
};
use arrow_buffer::{OffsetBuffer, ScalarBuffer};
use arrow_schema::{DataType, Field, Fields};

use super::values::{Caption, PartCaption, Quality};
use crate::{MotionId, Split};

/// A type that can be a column.
pub trait Cell: Sized {
    /// Whether values may be missing.
    const NULLABLE: bool = false;

    /// The Arrow type.
    fn data_type() -> DataType;

    /// Builds a column.
    ///
    /// # Errors
    /// The lists or texts of all rows together are too long for a column.
    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String>
    where
        Self: 'static;

    /// Reads a column whose type is known to be [`Cell::data_type`].
    ///
    /// # Errors
    /// A value breaks the rule of its type. The error names the row and the rule.
    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)>;
}

macro_rules! primitive_cell {
    ($ty:ty, $arrow:ty) => {
        impl Cell for $ty {
            fn data_type() -> DataType {
                <$arrow as arrow_array::types::ArrowPrimitiveType>::DATA_TYPE
            }

            fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
                Ok(Arc::new(PrimitiveArray::<$arrow>::from_iter_values(
                    values.copied(),
                )))
            }

            fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
                Ok(array.as_primitive::<$arrow>().values().to_vec())
            }
        }

        impl Cell for Option<$ty> {
            const NULLABLE: bool = true;

            fn data_type() -> DataType {
                <$ty as Cell>::data_type()
            }

            fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
                Ok(Arc::new(PrimitiveArray::<$arrow>::from_iter(
                    values.copied(),
                )))
            }

            fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
                Ok(array.as_primitive::<$arrow>().iter().collect())
            }
        }
    };
}

primitive_cell!(f32, Float32Type);
primitive_cell!(f64, Float64Type);
primitive_cell!(i32, Int32Type);
primitive_cell!(u32, UInt32Type);
primitive_cell!(u64, UInt64Type);

impl Cell for String {
    fn data_type() -> DataType {
        DataType::Utf8
    }

    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
        let values: Vec<&Self> = values.collect();
        check_text_length(&values)?;
        Ok(Arc::new(StringArray::from_iter_values(values)))
    }

    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
        let array = array.as_string::<i32>();
        Ok((0..array.len())
            .map(|i| array.value(i).to_owned())
            .collect())
    }
}

impl Cell for Option<String> {
    const NULLABLE: bool = true;

    fn data_type() -> DataType {
        DataType::Utf8
    }

    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
        let values: Vec<Option<&str>> = values.map(Option::as_deref).collect();
        check_text_length(values.iter().flatten())?;
        Ok(Arc::new(StringArray::from(values)))
    }

    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
        let array = array.as_string::<i32>();
        Ok(array.iter().map(|text| text.map(str::to_owned)).collect())
    }
}

/// Implements [`Cell`] for a type that is stored as its name.
macro_rules! name_cell {
    ($ty:ty, $parse:expr) => {
        impl Cell for $ty {
            fn data_type() -> DataType {
                DataType::Utf8
            }

            fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
                Ok(Arc::new(StringArray::from_iter_values(
                    values.map(|value| value.as_str()),
                )))
            }

            fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
                let array = array.as_string::<i32>();
                (0..array.len())
                    .map(|row| $parse(array.value(row)).map_err(|error| (row, error.to_string())))
                    .collect()
            }
        }
    };
}

name_cell!(MotionId, MotionId::parse);
name_cell!(Split, str::parse::<Split>);

fn item(data_type: DataType) -> Arc<Field> {
    Arc::new(Field::new("item", data_type, false))
}

/// Fails if the texts of a column are together longer than Arrow's 32-bit offsets allow.
fn check_text_length<T: AsRef<str>>(values: impl IntoIterator<Item = T>) -> Result<(), String> {
    let lengths = values.into_iter().map(|text| text.as_ref().len());
    let total: usize = lengths.sum();
    match i32::try_from(total) {
        Ok(_) => Ok(()),
        Err(_) => Err(format!(
            "has {total} bytes of text in one shard, at most {} fit; shorten captions and notes",
            i32::MAX
        )),
    }
}

/// Offsets of a list column from the lengths of its rows. Arrow's offsets are 32 bits wide: frames of motions always
/// fit, but the markers of a few very long captures may not.
fn offsets(lengths: &[usize]) -> Result<OffsetBuffer<i32>, String> {
    let total = lengths
        .iter()
        .try_fold(0, |sum: usize, length| sum.checked_add(*length));
    match total.map(i32::try_from) {
        Some(Ok(_)) => Ok(OffsetBuffer::from_lengths(lengths.iter().copied())),
        _ => Err(format!(
            "has {} rows whose lists are longer than {} items together; split the longest source",
            lengths.len(),
            i32::MAX
        )),
    }
}

/// The results of `decode_row(start, end)` for each list, with the range that it covers in the values array.
fn decode_lists<T>(list: &ListArray, mut decode_row: impl FnMut(usize, usize) -> T) -> Vec<T> {
    let bounds: &ScalarBuffer<i32> = list.offsets().inner();
    // Arrow guarantees that offsets are non-negative and ascending.
    let rows = bounds.windows(2);
    rows.map(|pair| decode_row(pair[0] as usize, pair[1] as usize))
        .collect()
}

impl<const D: usize> Cell for Vec<[f32; D]> {
    fn data_type() -> DataType {
        let width = i32::try_from(D).unwrap_or(i32::MAX);
        DataType::List(item(DataType::FixedSizeList(
            item(DataType::Float32),
            width,
        )))
    }

    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
        let rows: Vec<&Self> = values.collect();
        let lengths: Vec<usize> = rows.iter().map(|frames| frames.len()).collect();
        let offsets = offsets(&lengths)?;
        let mut numbers: Vec<f32> = Vec::with_capacity(D * lengths.iter().sum::<usize>());
        for frames in rows {
            numbers.extend_from_slice(frames.as_flattened());
        }
        let width = i32::try_from(D).unwrap_or(i32::MAX);
        let frames = FixedSizeListArray::new(
            item(DataType::Float32),
            width,
            Arc::new(Float32Array::from(numbers)),
            None,
        );
        let frame_field = item(frames.data_type().clone());
        Ok(Arc::new(ListArray::new(
            frame_field,
            offsets,
            Arc::new(frames),
            None,
        )))
    }

    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
        let list = array.as_list::<i32>();
        let frames = list.values().as_fixed_size_list();
        let numbers = frames.values().as_primitive::<Float32Type>();
        if frames.null_count() + numbers.null_count() > 0 {
            return Err((0, "a frame or a number is missing".to_owned()));
        }
        let numbers = numbers.values();
        // `values()` has applied the offset of a sliced array, so list offsets index it directly.
        Ok(decode_lists(list, |start, end| {
            let (frames, _rest) = numbers[start * D..end * D].as_chunks::<D>();
            frames.to_vec()
        }))
    }
}

/// Implements [`Cell`] for lists of a type.
macro_rules! list_cell {
    ($ty:ty) => {
        impl Cell for Vec<$ty> {
            fn data_type() -> DataType {
                DataType::List(item(<$ty as Cell>::data_type()))
            }

            fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
                let rows: Vec<&Self> = values.collect();
                let lengths: Vec<usize> = rows.iter().map(|row| row.len()).collect();
                Ok(Arc::new(ListArray::new(
                    item(<$ty as Cell>::data_type()),
                    offsets(&lengths)?,
                    <$ty as Cell>::encode(&mut rows.into_iter().flatten())?,
                    None,
                )))
            }

            fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
                let list = array.as_list::<i32>();
                // A sliced list still refers to the values of the whole list.
                let (first, end) = (list.offsets()[0], list.offsets()[list.len()]);
                let items = list.values().slice(first as usize, (end - first) as usize);
                let mut items = <$ty as Cell>::decode(items.as_ref())?.into_iter();
                Ok(decode_lists(list, |start, end| {
                    items.by_ref().take(end - start).collect()
                }))
            }
        }
    };
}

list_cell!(String);
list_cell!(Caption);
list_cell!(PartCaption);

/// Implements [`Cell`] for a struct whose fields are cells of the same names.
macro_rules! struct_cell {
    ($ty:ty { $($field:ident: $cell:ty),+ }) => {
        impl Cell for $ty {
            fn data_type() -> DataType {
                let fields = vec![$(field::<$cell>(stringify!($field))),+];
                DataType::Struct(Fields::from(fields))
            }

            fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
                let all: Vec<&Self> = values.collect();
                Ok(Arc::new(StructArray::from(vec![$((
                    field::<$cell>(stringify!($field)),
                    <$cell as Cell>::encode(&mut all.iter().map(|value| &value.$field))?,
                )),+])))
            }

            fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
                let items = array.as_struct();
                $(let mut $field = decode_field::<$cell>(items, stringify!($field))?;)+
                Ok((0..items.len())
                    .map_while(|_| Some(Self { $($field: $field.next()?),+ }))
                    .collect())
            }
        }
    };
}

struct_cell!(Caption {
    text: String,
    tokens: String,
    from_s: f32,
    to_s: f32
});
struct_cell!(PartCaption {
    part: String,
    text: String
});
struct_cell!(Quality {
    flags: u32,
    max_speed: f32,
    foot_skate: f32
});

fn field<T: Cell>(name: &str) -> Arc<Field> {
    Arc::new(Field::new(name, T::data_type(), T::NULLABLE))
}

fn decode_field<T: Cell>(
    items: &StructArray,
    name: &str,
) -> Result<std::vec::IntoIter<T>, (usize, String)> {
    match items.column_by_name(name) {
        Some(column) => Ok(T::decode(column.as_ref())?.into_iter()),
        None => Err((0, format!("has no field `{name}`"))),
    }
}

#[cfg(test)]
mod tests {
    use std::iter::repeat_n;

    use super::*;

    #[test]
    fn lists_beyond_the_offsets_are_an_error() {
        // Frames without numbers take no memory.
        let longest = i32::MAX as usize;
        let rows = [vec![[0.0f32; 0]; longest], vec![[0.0; 0]]];
        assert!(offsets(&[longest]).is_ok());
        let problem = Vec::<[f32; 0]>::encode(&mut rows.iter()).expect_err("one frame too many");
        assert!(problem.contains("2147483647 items"), "{problem}");
    }

    #[test]
    fn texts_beyond_the_offsets_are_an_error() {
        let text = "a".repeat(1 << 20);
        assert!(String::encode(&mut repeat_n(&text, 8)).is_ok());
        let problem = String::encode(&mut repeat_n(&text, 1 << 11)).expect_err("a byte too many");
        assert!(problem.contains("2147483648 bytes"), "{problem}");
        let (text, none) = (Some(text), None);
        let mut rows = repeat_n(&text, 1 << 11).chain([&none]);
        assert!(Option::<String>::encode(&mut rows).is_err());
    }
}
