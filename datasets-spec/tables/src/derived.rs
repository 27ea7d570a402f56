//! Columns of the table of motions that are not stored but computed, from its own columns or from masks and pairs.

use std::collections::BTreeSet;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Int32Type, UInt32Type};
use arrow_array::{
    Array, ArrayRef, BooleanArray, Float64Array, ListArray, RecordBatch, StructArray, UInt32Array,
};
use arrow_schema::{DataType, Field, Fields};
use datasets_spec::flags::FLAG_NAMES;
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::table::{Row as _, ShardReader};
use datasets_spec::{Dataset, MotionId};

datasets_spec::named! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub(crate) enum Derived, named by name {
        Seconds = "seconds",
        MaxSpeed = "max_speed",
        FootSkate = "foot_skate",
        Flags = "flags",
        Texts = "texts",
        PartTexts = "part_texts",
        NumCaptions = "n_captions",
        HasMask = "has_mask",
        HasPair = "has_pair",
    }
}

impl Derived {
    pub(crate) fn data_type(self) -> DataType {
        match self {
            Self::Seconds => DataType::Float64,
            Self::MaxSpeed | Self::FootSkate => DataType::Float32,
            Self::Flags => DataType::Struct(flag_fields()),
            Self::Texts | Self::PartTexts => {
                DataType::List(Arc::new(Field::new("item", DataType::Utf8, false)))
            }
            Self::NumCaptions => DataType::UInt32,
            Self::HasMask | Self::HasPair => DataType::Boolean,
        }
    }

    pub(crate) fn needs(self) -> &'static [&'static str] {
        match self {
            Self::Seconds => &["n_frames", "fps"],
            Self::MaxSpeed | Self::FootSkate | Self::Flags => &["quality"],
            Self::Texts | Self::NumCaptions => &["captions"],
            Self::PartTexts => &["part_captions"],
            Self::HasMask | Self::HasPair => &["id"],
        }
    }

    /// Ids of the clips that have a mask or a pair, for the column that tells so; empty for other columns.
    pub(crate) fn beside(
        self,
        dataset: &Dataset,
    ) -> Result<BTreeSet<MotionId>, datasets_spec::Error> {
        let mut ids = BTreeSet::new();
        match self {
            Self::HasMask => {
                for (path, _) in dataset.files(MaskRow::TABLE, None) {
                    let shard = ShardReader::open(&path)?;
                    ids.extend(shard.column::<MaskRow, MotionId>("motion_id")?);
                }
            }
            Self::HasPair => {
                for (path, _) in dataset.files(PairRow::TABLE, None) {
                    let shard = ShardReader::open(&path)?;
                    ids.extend(shard.column::<PairRow, MotionId>("source_id")?);
                    ids.extend(shard.column::<PairRow, MotionId>("target_id")?);
                }
            }
            _ => {}
        }
        Ok(ids)
    }

    /// Computes the column for a batch of rows. `None` if the batch lacks a column of [`Derived::needs`].
    pub(crate) fn of(self, batch: &RecordBatch, beside: &BTreeSet<MotionId>) -> Option<ArrayRef> {
        let column = |name: &str| batch.column_by_name(name);
        let quality = |place: usize| Some(Arc::clone(column("quality")?.as_struct().column(place)));
        Some(match self {
            Self::Seconds => {
                let frames = column("n_frames")?.as_primitive::<Int32Type>().values();
                let rates = column("fps")?.as_primitive::<Float32Type>().values();
                let rows = frames.iter().zip(rates);
                let seconds = rows.map(|(&frames, &fps)| f64::from(frames) / f64::from(fps));
                Arc::new(Float64Array::from_iter_values(seconds))
            }
            Self::MaxSpeed => quality(1)?,
            Self::FootSkate => quality(2)?,
            Self::Flags => {
                let flags = quality(0)?;
                let flags = flags.as_primitive::<UInt32Type>();
                let has = |(bit, _): &(u32, &str)| -> ArrayRef {
                    let values = flags.values().iter();
                    Arc::new(
                        values
                            .map(|flags| Some(flags & bit != 0))
                            .collect::<BooleanArray>(),
                    )
                };
                let columns = FLAG_NAMES.iter().map(has).collect();
                Arc::new(StructArray::new(flag_fields(), columns, None))
            }
            Self::Texts => texts(column("captions")?, 0)?,
            Self::PartTexts => texts(column("part_captions")?, 1)?,
            Self::NumCaptions => {
                let offsets = column("captions")?.as_list::<i32>().offsets();
                let lengths = offsets
                    .lengths()
                    .map(|len| u32::try_from(len).unwrap_or(u32::MAX));
                Arc::new(UInt32Array::from_iter_values(lengths))
            }
            Self::HasMask | Self::HasPair => {
                let ids = column("id")?.as_string::<i32>().iter();
                let has = |id: Option<&str>| {
                    let id = MotionId::parse(id?).ok()?;
                    Some(beside.contains(&id))
                };
                Arc::new(ids.map(has).collect::<BooleanArray>())
            }
        })
    }
}

fn texts(captions: &ArrayRef, place: usize) -> Option<ArrayRef> {
    let list = captions.as_list::<i32>();
    let texts = Arc::clone(list.values().as_struct().columns().get(place)?);
    let item = Arc::new(Field::new("item", DataType::Utf8, false));
    let nulls = list.nulls().cloned();
    let made = ListArray::try_new(item, list.offsets().clone(), texts, nulls);
    Some(Arc::new(made.ok()?))
}

/// A field for each flag. Its name has underscores, because SQL reads a hyphen as minus.
fn flag_fields() -> Fields {
    let field =
        |(_, name): &(u32, &str)| Field::new(name.replace('-', "_"), DataType::Boolean, true);
    FLAG_NAMES.iter().map(field).collect()
}
