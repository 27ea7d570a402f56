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

/// A type that can be a column. Encoding fails if a list column is too long for its offsets; decoding
/// reports the row and what is wrong.
pub trait Cell: Sized {
    /// Whether values may be missing.
    const NULLABLE: bool = false;

    /// The Arrow type.
    fn data_type() -> DataType;

    /// Builds a column.
    ///
    /// # Errors
    /// What is wrong, if the lists of the rows together are too long for a column.
    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String>
    where
        Self: 'static;

    /// Reads a column whose type is known to be [`Cell::data_type`].
    ///
    /// # Errors
    /// The row whose value breaks the type's rule, and which rule.
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
        Ok(Arc::new(texts(values)?))
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

impl Cell for MotionId {
    fn data_type() -> DataType {
        DataType::Utf8
    }

    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
        Ok(Arc::new(StringArray::from_iter_values(
            values.map(MotionId::as_str),
        )))
    }

    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
        parse_each(array, MotionId::parse)
    }
}

impl Cell for Split {
    fn data_type() -> DataType {
        DataType::Utf8
    }

    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
        Ok(Arc::new(StringArray::from_iter_values(
            values.map(|split| split.as_str()),
        )))
    }

    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
        parse_each(array, str::parse)
    }
}

fn parse_each<T>(
    array: &dyn Array,
    parse: impl Fn(&str) -> Result<T, crate::Error>,
) -> Result<Vec<T>, (usize, String)> {
    let array = array.as_string::<i32>();
    (0..array.len())
        .map(|row| parse(array.value(row)).map_err(|error| (row, error.to_string())))
        .collect()
}

fn item(data_type: DataType) -> Arc<Field> {
    Arc::new(Field::new("item", data_type, false))
}

/// A column of texts.
fn texts<T: AsRef<str>>(values: impl IntoIterator<Item = T>) -> Result<StringArray, String> {
    let values: Vec<T> = values.into_iter().collect();
    check_text_length(&values)?;
    Ok(StringArray::from_iter_values(values))
}

/// Arrow's offsets of texts are 32 bits wide too.
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

/// Offsets of a list column from the lengths of its rows. Arrow's are 32 bits wide: frames of motions
/// always fit, the markers of a few very long captures may not.
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

/// Calls `decode_row(row, start, end)` with the range each list covers in the values array.
fn decode_lists<T>(
    list: &ListArray,
    mut decode_row: impl FnMut(usize, usize) -> Result<T, String>,
) -> Result<Vec<T>, (usize, String)> {
    let bounds: &ScalarBuffer<i32> = list.offsets().inner();
    bounds
        .windows(2)
        .enumerate()
        .map(|(row, pair)| {
            // Arrow guarantees that offsets are non-negative and ascending.
            decode_row(pair[0] as usize, pair[1] as usize).map_err(|problem| (row, problem))
        })
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
        // A sliced child array starts at its own offset, which the values accessor has applied.
        decode_lists(list, |start, end| {
            let (frames, _rest) = numbers[start * D..end * D].as_chunks::<D>();
            Ok(frames.to_vec())
        })
    }
}

impl Cell for Vec<String> {
    fn data_type() -> DataType {
        DataType::List(item(DataType::Utf8))
    }

    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
        let mut lengths = Vec::new();
        let mut flat: Vec<&str> = Vec::new();
        for row in values {
            lengths.push(row.len());
            flat.extend(row.iter().map(String::as_str));
        }
        Ok(Arc::new(ListArray::new(
            item(DataType::Utf8),
            offsets(&lengths)?,
            Arc::new(texts(flat)?),
            None,
        )))
    }

    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
        let list = array.as_list::<i32>();
        let texts = list.values().as_string::<i32>();
        decode_lists(list, |start, end| {
            Ok((start..end).map(|i| texts.value(i).to_owned()).collect())
        })
    }
}

/// Builds a list-of-struct column from the lengths of its rows and its fields.
fn struct_lists(
    lengths: &[usize],
    fields: Fields,
    columns: Vec<ArrayRef>,
) -> Result<ArrayRef, String> {
    let items = StructArray::new(fields, columns, None);
    Ok(Arc::new(ListArray::new(
        item(items.data_type().clone()),
        offsets(lengths)?,
        Arc::new(items),
        None,
    )))
}

fn caption_fields() -> Fields {
    Fields::from(vec![
        Field::new("text", DataType::Utf8, false),
        Field::new("tokens", DataType::Utf8, false),
        Field::new("from_s", DataType::Float32, false),
        Field::new("to_s", DataType::Float32, false),
    ])
}

impl Cell for Vec<Caption> {
    fn data_type() -> DataType {
        DataType::List(item(DataType::Struct(caption_fields())))
    }

    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
        let rows: Vec<&Self> = values.collect();
        let lengths: Vec<usize> = rows.iter().map(|row| row.len()).collect();
        let all: Vec<&Caption> = rows.into_iter().flatten().collect();
        let columns: Vec<ArrayRef> = vec![
            Arc::new(texts(all.iter().map(|c| &c.text))?),
            Arc::new(texts(all.iter().map(|c| &c.tokens))?),
            Arc::new(Float32Array::from_iter_values(all.iter().map(|c| c.from_s))),
            Arc::new(Float32Array::from_iter_values(all.iter().map(|c| c.to_s))),
        ];
        struct_lists(&lengths, caption_fields(), columns)
    }

    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
        let list = array.as_list::<i32>();
        let items = list.values().as_struct();
        let text = items.column(0).as_string::<i32>();
        let tokens = items.column(1).as_string::<i32>();
        let from_s = items.column(2).as_primitive::<Float32Type>();
        let to_s = items.column(3).as_primitive::<Float32Type>();
        decode_lists(list, |start, end| {
            Ok((start..end)
                .map(|i| Caption {
                    text: text.value(i).to_owned(),
                    tokens: tokens.value(i).to_owned(),
                    from_s: from_s.value(i),
                    to_s: to_s.value(i),
                })
                .collect())
        })
    }
}

fn part_caption_fields() -> Fields {
    Fields::from(vec![
        Field::new("part", DataType::Utf8, false),
        Field::new("text", DataType::Utf8, false),
    ])
}

impl Cell for Vec<PartCaption> {
    fn data_type() -> DataType {
        DataType::List(item(DataType::Struct(part_caption_fields())))
    }

    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
        let rows: Vec<&Self> = values.collect();
        let lengths: Vec<usize> = rows.iter().map(|row| row.len()).collect();
        let all: Vec<&PartCaption> = rows.into_iter().flatten().collect();
        let columns: Vec<ArrayRef> = vec![
            Arc::new(texts(all.iter().map(|c| &c.part))?),
            Arc::new(texts(all.iter().map(|c| &c.text))?),
        ];
        struct_lists(&lengths, part_caption_fields(), columns)
    }

    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
        let list = array.as_list::<i32>();
        let items = list.values().as_struct();
        let part = items.column(0).as_string::<i32>();
        let text = items.column(1).as_string::<i32>();
        decode_lists(list, |start, end| {
            Ok((start..end)
                .map(|i| PartCaption {
                    part: part.value(i).to_owned(),
                    text: text.value(i).to_owned(),
                })
                .collect())
        })
    }
}

fn quality_fields() -> Fields {
    Fields::from(vec![
        Field::new("flags", DataType::UInt32, false),
        Field::new("max_speed", DataType::Float32, false),
        Field::new("foot_skate", DataType::Float32, false),
    ])
}

impl Cell for Quality {
    fn data_type() -> DataType {
        DataType::Struct(quality_fields())
    }

    fn encode(values: &mut dyn Iterator<Item = &Self>) -> Result<ArrayRef, String> {
        let all: Vec<&Self> = values.collect();
        let columns: Vec<ArrayRef> = vec![
            Arc::new(PrimitiveArray::<UInt32Type>::from_iter_values(
                all.iter().map(|q| q.flags),
            )),
            Arc::new(Float32Array::from_iter_values(
                all.iter().map(|q| q.max_speed),
            )),
            Arc::new(Float32Array::from_iter_values(
                all.iter().map(|q| q.foot_skate),
            )),
        ];
        Ok(Arc::new(StructArray::new(quality_fields(), columns, None)))
    }

    fn decode(array: &dyn Array) -> Result<Vec<Self>, (usize, String)> {
        let items = array.as_struct();
        let flags = items.column(0).as_primitive::<UInt32Type>();
        let max_speed = items.column(1).as_primitive::<Float32Type>();
        let foot_skate = items.column(2).as_primitive::<Float32Type>();
        Ok((0..items.len())
            .map(|i| Self {
                flags: flags.value(i),
                max_speed: max_speed.value(i),
                foot_skate: foot_skate.value(i),
            })
            .collect())
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
