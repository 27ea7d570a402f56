//! A list of pairs by the user: a CSV file with the columns styled clip, original clip, style and
//! instruction.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use csv::StringRecord;
use datasets_spec::record::PairRow;
use datasets_spec::{MotionId, Split};
use serde::{Deserialize, Serialize};

use super::LISTED;
use crate::Error;
use crate::compose::{EditKind, style_instruction};
use crate::csv_lines;

/// The pairs of a file, by its names of clips.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PairList {
    lines: Vec<Line>,
    refused: Vec<RefusedLine>,
    hash: String,
}

/// A line of a list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Line {
    number: u64,
    styled: String,
    original: String,
    style: String,
    instruction: String,
}

/// A line that gave no pair.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct RefusedLine {
    /// Number of the line, from 1.
    pub line: u64,
    /// What is wrong with it.
    pub reason: String,
}

impl std::fmt::Display for RefusedLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "line {}: {}", self.line, self.reason)
    }
}

/// Result of reading a list.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ListedPairs {
    /// The pairs, by id.
    pub rows: Vec<PairRow>,
    /// The lines that gave none, by number.
    pub refused: Vec<RefusedLine>,
}

impl PairList {
    /// Reads a list. Lines without a valid pair are kept as refused.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(Error::io("read", path))?;
        Ok(Self::parse(&bytes))
    }

    /// Parses a list in UTF-8, with or without a header line (`styled,original,style,text`). Fields
    /// may be quoted; the instruction may be left out.
    pub fn parse(bytes: &[u8]) -> Self {
        let mut list = Self {
            hash: blake3::hash(bytes).to_hex().to_string(),
            ..Self::default()
        };
        let is_header = |record: &StringRecord| {
            let begins = record.iter().take(2);
            begins.map(str::to_lowercase).eq(["styled", "original"])
        };
        for (place, (number, record)) in csv_lines::records(bytes).enumerate() {
            if place == 0 && record.as_ref().is_ok_and(is_header) {
                continue;
            }
            match record.and_then(|record| Line::parse(number, &record)) {
                Ok(line) => list.lines.push(line),
                Err(reason) => list.refused.push(RefusedLine {
                    line: number,
                    reason,
                }),
            }
        }
        list
    }

    /// BLAKE3 of the file, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// Styled clip and original clip of each line, in order.
    pub(crate) fn clips(&self) -> impl Iterator<Item = (&str, &str)> {
        let lines = self.lines.iter();
        lines.map(|line| (line.styled.as_str(), line.original.as_str()))
    }

    /// Makes the pairs whose motions are in the dataset, named by id or source file. `known` holds the pairs of
    /// the dataset that do not come from a list.
    pub fn pairs(&self, motions: &BTreeMap<MotionId, Split>, known: &[PairRow]) -> ListedPairs {
        let known: BTreeMap<(&MotionId, &MotionId), &str> = known
            .iter()
            .map(|row| ((&row.source_id, &row.target_id), row.id.as_str()))
            .collect();
        let mut made = ListedPairs {
            refused: self.refused.clone(),
            ..ListedPairs::default()
        };
        let mut seen: BTreeMap<String, u64> = BTreeMap::new();
        for line in &self.lines {
            let row = line.pair(motions, &known).and_then(|row| {
                match seen.insert(row.id.clone(), line.number) {
                    None => Ok(row),
                    Some(first) => {
                        seen.insert(row.id, first);
                        Err(format!("it repeats the pair of line {first}"))
                    }
                }
            });
            match row {
                Ok(row) => made.rows.push(row),
                Err(reason) => made.refused.push(RefusedLine {
                    line: line.number,
                    reason,
                }),
            }
        }
        made.rows.sort_by(|a, b| a.id.cmp(&b.id));
        made.refused.sort();
        made
    }
}

impl Line {
    fn parse(number: u64, record: &StringRecord) -> Result<Self, String> {
        let fields: Vec<&str> = record.iter().collect();
        if fields.iter().any(|field| field.contains('\n')) {
            return Err(
                "a field goes on over the end of the line; close its quotation mark".into(),
            );
        }
        let (styled, original, style, instruction) = match *fields.as_slice() {
            [styled, original, style] => (styled, original, style, ""),
            [styled, original, style, text] => (styled, original, style, text),
            _ => {
                return Err(format!(
                    "it has {} fields, expected styled clip, original clip, style and text (quote a \
                     text with commas)",
                    fields.len()
                ));
            }
        };
        for (name, field) in [
            ("styled clip", styled),
            ("original clip", original),
            ("style", style),
        ] {
            if field.is_empty() {
                return Err(format!("it names no {name}"));
            }
        }
        Ok(Self {
            number,
            styled: styled.to_owned(),
            original: original.to_owned(),
            style: style.to_owned(),
            instruction: match instruction {
                "" => style_instruction(style),
                text => text.to_owned(),
            },
        })
    }

    fn pair(
        &self,
        motions: &BTreeMap<MotionId, Split>,
        known: &BTreeMap<(&MotionId, &MotionId), &str>,
    ) -> Result<PairRow, String> {
        let find = |name: &str| {
            names_of(name)
                .find_map(|name| motions.get_key_value(&MotionId::parse(name).ok()?))
                .ok_or_else(|| format!("no motion of the dataset has the id {name:?}"))
        };
        let (target, split) = find(&self.styled)?;
        let (source, source_split) = find(&self.original)?;
        if source == target {
            return Err(format!("{source} cannot be its own original"));
        }
        if split != source_split {
            return Err(format!(
                "{target} is in {split} and {source} in {source_split}; `stance ingest --pairs` gives \
                 both one split, where no published list says otherwise"
            ));
        }
        if let Some(pair) = known.get(&(source, target)) {
            return Err(format!(
                "{source} and {target} are the pair {pair:?} already"
            ));
        }
        Ok(PairRow {
            id: format!("{LISTED}/{source}+{target}"),
            split: *split,
            source: LISTED.to_owned(),
            kind: EditKind::Style.as_str().to_owned(),
            source_id: source.clone(),
            target_id: target.clone(),
            style: Some(self.style.clone()),
            parts: Vec::new(),
            instruction: self.instruction.clone(),
            edit_type: None,
            accepted_by: None,
        })
    }
}

/// Possible ids of a name: itself, and without a file extension.
pub(crate) fn names_of(name: &str) -> impl Iterator<Item = &str> {
    let stem = match name.rsplit_once('.') {
        Some((stem, extension)) if !extension.contains('/') && !stem.is_empty() => Some(stem),
        _ => None,
    };
    std::iter::once(name).chain(stem)
}

/// The source clip whose split each styled clip of a list takes: its original, or the original's original.
/// Cycles are left out.
pub(crate) fn originals<'a>(
    pairs: impl Iterator<Item = (&'a str, &'a str)>,
) -> BTreeMap<&'a str, &'a str> {
    let mut direct: BTreeMap<&str, &str> = BTreeMap::new();
    for (styled, original) in pairs {
        direct.entry(styled).or_insert(original);
    }
    let last_of = |styled: &'a str| {
        let mut seen = BTreeSet::from([styled]);
        let mut clip = styled;
        while let Some(&original) = direct.get(clip) {
            if !seen.insert(original) {
                return None;
            }
            clip = original;
        }
        Some((styled, clip))
    };
    direct.keys().filter_map(|styled| last_of(styled)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motions() -> BTreeMap<MotionId, Split> {
        [
            ("000009", Split::Test),
            ("mine/000009_old", Split::Test),
            ("mine/walk, slowly", Split::Train),
            ("000011", Split::Train),
        ]
        .map(|(id, split)| (MotionId::parse(id).expect("valid"), split))
        .into()
    }

    #[test]
    fn every_line_is_a_pair_or_is_refused_with_its_number() {
        let text = "\u{feff}styled,original,style,text\r\n\
            mine/000009_old.bvh,000009,old,\"Walk, as if old\"\n\
            \n\
            \"mine/walk, slowly\",000011,slow\n\
            mine/000009_old,000011,old,x\n\
            nobody,000009,old,x\n\
            mine/000009_old,000009,older,again\n\
            mine/000009_old,000009,\n\
            one,two\n\
            000011,000011,same,x\n";
        let made = PairList::parse(text.as_bytes()).pairs(&motions(), &[]);
        let said: Vec<(&str, &str, &str)> = made
            .rows
            .iter()
            .map(|row| {
                (
                    row.source_id.as_str(),
                    row.target_id.as_str(),
                    row.instruction.as_str(),
                )
            })
            .collect();
        assert_eq!(
            said,
            [
                ("000009", "mine/000009_old", "Walk, as if old"),
                (
                    "000011",
                    "mine/walk, slowly",
                    "Replace a person with a slow look"
                ),
            ]
        );
        let refused: Vec<(u64, &str)> = made
            .refused
            .iter()
            .map(|refused| (refused.line, refused.reason.as_str()))
            .collect();
        let expected = [
            (5, "is in test and 000011 in train"),
            (6, "no motion of the dataset has the id \"nobody\""),
            (7, "repeats the pair of line 2"),
            (8, "names no style"),
            (9, "it has 2 fields"),
            (10, "its own original"),
        ];
        assert_eq!(refused.len(), expected.len(), "{refused:?}");
        for ((line, reason), (number, part)) in refused.into_iter().zip(expected) {
            assert_eq!(line, number);
            assert!(reason.contains(part), "{line}: {reason}");
        }
    }

    #[test]
    fn an_open_quotation_mark_and_foreign_bytes_are_refused() {
        let list = PairList::parse(b"a,b,\"old\nc,d,new,x\n");
        assert_eq!((list.lines.len(), list.refused.len()), (0, 1));
        assert!(list.refused[0].reason.contains("quotation mark"));
        let list = PairList::parse(b"a,b,old,x\na,\xff,old,x\nc,d,old,x\n");
        assert_eq!(list.lines.len(), 2);
        assert_eq!(list.refused[0].line, 2);
    }

    #[test]
    fn a_pair_that_is_there_already_is_not_made_twice() {
        let list = PairList::parse(b"mine/000009_old,000009,old,x");
        let mut known = list.pairs(&motions(), &[]).rows;
        known[0].id = "release".to_owned();
        let made = list.pairs(&motions(), &known);
        assert!(made.rows.is_empty());
        assert!(made.refused[0].reason.contains("\"release\""), "{made:?}");
    }

    #[test]
    fn originals_are_followed_to_the_last_and_circles_are_left_out() {
        let pairs = [("c", "b"), ("b", "a"), ("x", "y"), ("y", "x"), ("c", "z")];
        let found = originals(pairs.into_iter());
        assert_eq!(found, BTreeMap::from([("b", "a"), ("c", "a")]));
    }
}
