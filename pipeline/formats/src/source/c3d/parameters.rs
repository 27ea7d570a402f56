//! The parameter section of a C3D file: groups of named values.

use std::collections::{BTreeMap, BTreeSet};

use clip::{Rejected, rejected};

/// Size of a block in bytes.
pub(super) const BLOCK: usize = 512;
/// Groups whose labels name points that are not markers.
const MODEL_OUTPUTS: [&str; 6] = [
    "ANGLES",
    "FORCES",
    "MOMENTS",
    "POWERS",
    "SCALARS",
    "REACTIONS",
];

/// Number format of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Processor {
    /// Little-endian IEEE numbers.
    Intel,
    /// Little-endian whole numbers and VAX floating point.
    Dec,
    /// Big-endian IEEE numbers.
    Mips,
}

impl Processor {
    pub(super) fn of(code: u8) -> Option<Self> {
        match code {
            84 => Some(Self::Intel),
            85 => Some(Self::Dec),
            86 => Some(Self::Mips),
            _ => None,
        }
    }

    pub(super) fn u16(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::Intel | Self::Dec => u16::from_le_bytes(bytes),
            Self::Mips => u16::from_be_bytes(bytes),
        }
    }

    pub(super) fn i16(self, bytes: [u8; 2]) -> i16 {
        self.u16(bytes) as i16
    }

    pub(super) fn f32(self, bytes: [u8; 4]) -> f32 {
        match self {
            Self::Intel => f32::from_le_bytes(bytes),
            Self::Mips => f32::from_be_bytes(bytes),
            Self::Dec => {
                // Two little-endian words, the high one first, with an exponent larger by two.
                let [b0, b1, b2, b3] = bytes;
                f32::from_be_bytes([b1, b0, b3, b2]) / 4.0
            }
        }
    }
}

/// A value as stored: its type (-1 for text, 1 for bytes, 2 for words, 4 for real numbers), the length of a row, and
/// all bytes.
type Value<'a> = (i8, usize, &'a [u8]);

/// All parameters by group and name, in upper case.
#[derive(Clone, Debug)]
pub(super) struct Parameters<'a> {
    processor: Processor,
    values: BTreeMap<(String, String), Value<'a>>,
}

/// Reads bytes sequentially with bounds checks.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], Rejected> {
        let end = self.at.checked_add(length);
        let taken = end.and_then(|end| self.bytes.get(self.at..end));
        let taken = taken.ok_or_else(|| {
            rejected!(
                "E-C3D-PARAM",
                "expected {length} bytes more of the parameters, found {}",
                self.bytes.len().saturating_sub(self.at)
            )
            .at(self.at)
        })?;
        self.at += length;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, Rejected> {
        Ok(self.take(1)?[0])
    }
}

impl<'a> Parameters<'a> {
    /// Parses the section that begins at `start`.
    ///
    /// Some programs write a link to the next parameter that leads out of the section. Then the
    /// parameter that follows in the file is the next one; without one, the section ends.
    ///
    /// # Errors
    /// `E-C3D-PARAM` if it breaks off in the middle of a value.
    pub(super) fn parse(
        bytes: &'a [u8],
        start: usize,
        processor: Processor,
    ) -> Result<Self, Rejected> {
        // Some files state too few blocks, so read the section to its actual end.
        let end = bytes.len();
        let stated_end = start + usize::from(bytes[start + 2]) * BLOCK;
        let mut groups: BTreeMap<u8, String> = BTreeMap::new();
        let mut by_group: Vec<(u8, String, Value<'a>)> = Vec::new();
        let mut cursor = Cursor {
            bytes,
            at: start + 4,
        };
        while cursor.at < end {
            // The sign of the length of a name is the lock flag.
            let length = usize::from((cursor.byte()? as i8).unsigned_abs());
            if length == 0 {
                break;
            }
            let group = cursor.byte()? as i8;
            if group == 0 {
                break;
            }
            let name = String::from_utf8_lossy(cursor.take(length)?).to_uppercase();
            let offset_at = cursor.at;
            let offset = cursor.take(2)?;
            let offset = usize::from(processor.u16([offset[0], offset[1]]));
            let next = offset_at + offset;
            if group < 0 {
                groups.insert(group.unsigned_abs(), name);
            } else {
                let value = value(&mut cursor)?;
                by_group.push((group.unsigned_abs(), name, value));
            }
            // An offset of zero ends the section.
            if offset == 0 {
                break;
            }
            if next <= stated_end {
                cursor.at = next;
                continue;
            }
            let follows = end_of_record(bytes, cursor.at);
            match [next, follows].into_iter().find(|at| is_record(bytes, *at)) {
                Some(at) => cursor.at = at,
                None => break,
            }
        }
        let values = by_group
            .into_iter()
            .filter_map(|(group, name, value)| Some(((groups.get(&group)?.clone(), name), value)))
            .collect();
        Ok(Self { processor, values })
    }

    fn get(&self, group: &str, name: &str) -> Option<Value<'a>> {
        let key = (group.to_owned(), name.to_owned());
        self.values.get(&key).copied()
    }

    /// The real number at the start of a value.
    fn real(&self, bytes: &[u8]) -> Option<f32> {
        Some(self.processor.f32(*bytes.first_chunk()?))
    }

    /// The first number of a parameter.
    pub(super) fn number(&self, group: &str, name: &str) -> Option<f64> {
        let number = match self.get(group, name)? {
            (1, _, bytes) => f64::from(*bytes.first()? as i8),
            (2, _, bytes) => self.processor.i16(*bytes.first_chunk()?).into(),
            (4, _, bytes) => self.real(bytes)?.into(),
            _ => return None,
        };
        Some(number).filter(|number| number.is_finite())
    }

    /// A number of blocks or frames: unsigned, although words are read as signed. `None` if there are none.
    pub(super) fn count(&self, group: &str, name: &str) -> Option<usize> {
        let number = self.number(group, name)?;
        let number = if number < 0.0 {
            number + 65_536.0
        } else {
            number
        };
        (number >= 1.0).then_some(number as usize)
    }

    /// A count in two words, the low one first for every processor, or as a real number.
    pub(super) fn long(&self, group: &str, name: &str) -> Option<usize> {
        match self.get(group, name)? {
            (2, _, bytes) => {
                let words = bytes.as_chunks().0.iter();
                let mut words = words.map(|word| usize::from(self.processor.u16(*word)));
                let low = words.next()?;
                Some(low | words.next().unwrap_or(0) << 16)
            }
            (4, _, bytes) => {
                let number = self.real(bytes)?;
                (number >= 0.0 && number < u32::MAX as f32).then_some(number as usize)
            }
            _ => None,
        }
    }

    /// A parameter's text, its rows joined.
    pub(super) fn text(&self, group: &str, name: &str) -> Option<String> {
        Some(self.texts(group, name)?.join(" "))
    }

    /// A parameter's rows of text.
    pub(super) fn texts(&self, group: &str, name: &str) -> Option<Vec<String>> {
        match self.get(group, name)? {
            (-1, width, characters) => {
                let rows = characters.chunks(width.max(1)).map(String::from_utf8_lossy);
                let rows = rows.map(|row| row.trim_matches(['\0', ' ']).to_owned());
                Some(rows.collect())
            }
            _ => None,
        }
    }

    /// Names of points that are angles, forces and the like.
    pub(super) fn model_outputs(&self) -> BTreeSet<String> {
        let listed = MODEL_OUTPUTS.iter();
        let listed = listed.filter_map(|name| self.texts("POINT", name));
        let labels = listed.flatten().filter(|label| !label.is_empty());
        labels.collect()
    }
}

/// The end of a record whose value ends at `at`: its description follows, with a length of one byte.
fn end_of_record(bytes: &[u8], at: usize) -> usize {
    at + 1 + bytes.get(at).map_or(0, |length| usize::from(*length))
}

/// Whether the bytes look like the head of a group or parameter: a name of at least three letters, digits and
/// underscores, which no number of the frames resembles.
fn is_record(bytes: &[u8], at: usize) -> bool {
    const SHORTEST_NAME: usize = 3;
    let Some(&[length, group]) = bytes.get(at..at + 2) else {
        return false;
    };
    let length = usize::from((length as i8).unsigned_abs());
    let name = bytes.get(at + 2..at + 2 + length).unwrap_or_default();
    let is_named = |byte: &u8| byte.is_ascii_alphanumeric() || *byte == b'_';
    group != 0 && name.len() >= SHORTEST_NAME && name.iter().all(is_named)
}

fn value<'a>(cursor: &mut Cursor<'a>) -> Result<Value<'a>, Rejected> {
    let kind_at = cursor.at;
    let kind = cursor.byte()? as i8;
    let num_axes = cursor.byte()?;
    let axes = cursor.take(num_axes.into())?;
    let width = axes.first().map_or(1, |axis| usize::from(*axis));
    let size = match kind {
        -1 | 1 => 1,
        2 => 2,
        4 => 4,
        other => {
            return Err(rejected!(
                "E-C3D-PARAM",
                "found a value of type {other}, expected -1, 1, 2 or 4"
            )
            .at(kind_at));
        }
    };
    let mut extents = axes.iter().map(|axis| usize::from(*axis));
    let length = extents.try_fold(size, usize::checked_mul);
    Ok((kind, width, cursor.take(length.unwrap_or(usize::MAX))?))
}
