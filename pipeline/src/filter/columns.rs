//! The columns that a filter may name, and their values in a shard.

use datasets_spec::record::MotionRow;
use datasets_spec::table::{Caption, PartCaption, Quality, Row, ShardReader};

use crate::check::FLAG_NAMES;

/// Prefix of the columns that tell whether a check found something.
const FLAGS: &str = "flags.";

/// A column of the table of motions, or a part of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Column {
    /// Column of the table.
    stored: &'static str,
    pub(super) kind: Kind,
}

/// What the values of a column are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Text,
    Texts,
    Captions,
    PartCaptions,
    Whole,
    Single,
    /// Bit of `quality.flags`.
    Flag(u32),
    MaxSpeed,
    FootSkate,
    Seconds,
}

/// The values of a column in a shard, row by row.
pub(super) enum Values {
    /// A missing text has no entry, and a list one for each of its texts.
    Texts(Vec<Vec<String>>),
    Numbers(Vec<Option<f64>>),
    Truths(Vec<bool>),
}

/// The names that a filter may use, with their columns. Columns of frames are not among them.
pub(super) fn all() -> Vec<(String, Column)> {
    let mut named = Vec::new();
    for column in MotionRow::columns() {
        let kind = match (column.name, column.type_name().as_str()) {
            ("captions", _) => Kind::Captions,
            ("part_captions", _) => Kind::PartCaptions,
            (_, "utf8") => Kind::Text,
            (_, "list<utf8>") => Kind::Texts,
            (_, "i32") => Kind::Whole,
            (_, "f32") => Kind::Single,
            _ => continue,
        };
        let stored = column.name;
        named.push((stored.to_owned(), Column { stored, kind }));
    }
    let quality = |kind| Column {
        stored: "quality",
        kind,
    };
    let seconds = Column {
        stored: "n_frames",
        kind: Kind::Seconds,
    };
    named.push(("seconds".to_owned(), seconds));
    named.push(("max_speed".to_owned(), quality(Kind::MaxSpeed)));
    named.push(("foot_skate".to_owned(), quality(Kind::FootSkate)));
    for (bit, name) in FLAG_NAMES {
        let name = format!("{FLAGS}{}", name.replace('-', "_"));
        named.push((name, quality(Kind::Flag(bit))));
    }
    named
}

/// The column of a name. Flags may be written with `-` or `_`.
///
/// # Errors
/// What the names are.
pub(super) fn find(name: &str) -> Result<Column, String> {
    let asked = match name.strip_prefix(FLAGS) {
        Some(_) => name.replace('-', "_"),
        None => name.to_owned(),
    };
    let all = all();
    let names = all.iter().map(|(name, _)| name.as_str());
    let known = || names.clone().collect::<Vec<_>>().join(", ");
    let found = all.iter().find(|(name, _)| *name == asked);
    found
        .map(|(_, column)| *column)
        .ok_or_else(|| format!("there is no column {name:?}; the columns are {}", known()))
}

impl Column {
    /// Reads the column of a shard, and no other.
    pub(super) fn read(self, shard: &ShardReader) -> Result<Values, datasets_spec::Error> {
        let quality = |number: fn(&Quality) -> f32| -> Result<Values, datasets_spec::Error> {
            let cells = shard.column::<MotionRow, Quality>(self.stored)?;
            let numbers = cells.iter().map(|cell| Some(number(cell).into()));
            Ok(Values::Numbers(numbers.collect()))
        };
        Ok(match self.kind {
            Kind::Text => {
                let cells = shard.column::<MotionRow, Option<String>>(self.stored)?;
                Values::Texts(
                    cells
                        .into_iter()
                        .map(|cell| cell.into_iter().collect())
                        .collect(),
                )
            }
            Kind::Texts => Values::Texts(shard.column::<MotionRow, Vec<String>>(self.stored)?),
            Kind::Captions => {
                let cells = shard.column::<MotionRow, Vec<Caption>>(self.stored)?;
                let texts = |said: Vec<Caption>| said.into_iter().map(|said| said.text).collect();
                Values::Texts(cells.into_iter().map(texts).collect())
            }
            Kind::PartCaptions => {
                let cells = shard.column::<MotionRow, Vec<PartCaption>>(self.stored)?;
                let texts =
                    |said: Vec<PartCaption>| said.into_iter().map(|said| said.text).collect();
                Values::Texts(cells.into_iter().map(texts).collect())
            }
            Kind::Whole => {
                let cells = shard.column::<MotionRow, Option<i32>>(self.stored)?;
                Values::Numbers(cells.into_iter().map(|cell| cell.map(f64::from)).collect())
            }
            Kind::Single => {
                let cells = shard.column::<MotionRow, Option<f32>>(self.stored)?;
                Values::Numbers(cells.into_iter().map(|cell| cell.map(f64::from)).collect())
            }
            Kind::Seconds => {
                let frames = shard.column::<MotionRow, i32>(self.stored)?;
                let rates = shard.column::<MotionRow, f32>("fps")?;
                let clips = frames.into_iter().zip(rates);
                let secs = clips.map(|(frames, fps)| Some(f64::from(frames) / f64::from(fps)));
                Values::Numbers(secs.collect())
            }
            Kind::Flag(bit) => {
                let cells = shard.column::<MotionRow, Quality>(self.stored)?;
                Values::Truths(cells.iter().map(|cell| cell.flags & bit != 0).collect())
            }
            Kind::MaxSpeed => quality(|cell| cell.max_speed)?,
            Kind::FootSkate => quality(|cell| cell.foot_skate)?,
        })
    }
}
