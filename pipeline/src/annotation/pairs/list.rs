//! A user's list of pairs: a CSV file with the columns styled clip, original clip, style, instruction, kind, body parts
//! and edit type.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use compose::{EditKind, style_instruction};
use csv::StringRecord;
use datasets_spec::record::{EDIT_TYPES, PairRow};
use datasets_spec::{BodyPart, MotionId, Split};
use formats::csv_lines;
use serde::{Deserialize, Serialize};

use crate::Error;

/// Column `source` of pairs from a [`PairList`].
pub const LISTED: &str = "csv";

/// The lines of a CSV file; clips are named as the file names them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PairList {
    lines: Vec<Line>,
    refused: Vec<RefusedLine>,
    hash: String,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Line {
    number: u64,
    styled: String,
    original: String,
    /// Empty if a fine-grained pair has no style.
    style: String,
    instruction: String,
    #[serde(default = "default_kind", skip_serializing_if = "is_default_kind")]
    kind: EditKind,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    parts: Vec<String>,
    /// One of [`EDIT_TYPES`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    edit_type: Option<String>,
}

fn default_kind() -> EditKind {
    EditKind::Style
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_default_kind(kind: &EditKind) -> bool {
    *kind == default_kind()
}

/// A line that gave no pair.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct RefusedLine {
    /// Number of the line, from 1.
    pub line: u64,
    /// What is wrong with the line.
    pub reason: String,
}

impl std::fmt::Display for RefusedLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "line {}: {}", self.line, self.reason)
    }
}

/// Parses the lines of a CSV file, except a header. Returns the parsed lines and the refused ones.
pub(crate) fn parse_lines<T>(
    bytes: &[u8],
    is_header: impl Fn(&StringRecord) -> bool,
    parse: impl Fn(u64, &StringRecord) -> Result<T, String>,
) -> (Vec<T>, Vec<RefusedLine>) {
    let (mut lines, mut refused) = (Vec::new(), Vec::new());
    for (place, (line, record)) in csv_lines::records(bytes).enumerate() {
        if place == 0 && record.as_ref().is_ok_and(&is_header) {
            continue;
        }
        match record.and_then(|record| parse(line, &record)) {
            Ok(line) => lines.push(line),
            Err(reason) => refused.push(RefusedLine { line, reason }),
        }
    }
    (lines, refused)
}

/// Pairs made from a list, and lines without a pair.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ListedPairs {
    /// The pairs, sorted by id.
    pub rows: Vec<PairRow>,
    /// The lines that gave no pair, sorted by number.
    pub refused: Vec<RefusedLine>,
}

impl PairList {
    /// Reads a list. Lines without a valid pair are kept as refused.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(datasets_spec::Error::io("read", path))?;
        Ok(Self::parse(&bytes))
    }

    /// Parses a list in UTF-8, with or without a header line (`styled,original,style,text,kind,parts,edit_type`).
    /// Fields may be quoted; the text and the fields after it may be left out. The kind is `style` (the default) or
    /// `fine-grained`, whose lines need a text and no style; the parts are names of body parts with `;` between them;
    /// the edit type of a fine-grained pair is one of [`EDIT_TYPES`].
    pub fn parse(bytes: &[u8]) -> Self {
        let mut list = Self {
            hash: blake3::hash(bytes).to_hex().to_string(),
            ..Self::default()
        };
        let is_header = |record: &StringRecord| {
            let begins = record.iter().take(2);
            begins.map(str::to_lowercase).eq(["styled", "original"])
        };
        (list.lines, list.refused) = parse_lines(bytes, is_header, Line::parse);
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

    /// Makes the pairs whose motions are in the dataset. A motion is named by its id, with or without a file extension.
    /// `known` holds the pairs of the dataset. A line makes its own pair again, unless people have judged that pair and the
    /// line says something else; a line that repeats another pair is refused, and so is one whose source and target people
    /// `rejected`.
    pub fn pairs(
        &self,
        motions: &BTreeMap<MotionId, Split>,
        known: &[PairRow],
        rejected: &BTreeSet<[MotionId; 2]>,
    ) -> ListedPairs {
        let mut by_sides: BTreeMap<[&MotionId; 2], Vec<&PairRow>> = BTreeMap::new();
        for row in known {
            let sides = [&row.source_id, &row.target_id];
            by_sides.entry(sides).or_default().push(row);
        }
        let mut made = ListedPairs {
            refused: self.refused.clone(),
            ..ListedPairs::default()
        };
        let mut seen: BTreeMap<String, u64> = BTreeMap::new();
        for line in &self.lines {
            let row = line.pair(motions, &by_sides).and_then(|row| {
                let (source, target) = (&row.source_id, &row.target_id);
                if rejected.contains(&[source.clone(), target.clone()]) {
                    return Err(format!(
                        "people rejected the pair of {source} and {target}; take the rejection back in the annotation \
                         project to use it"
                    ));
                }
                match *seen.entry(row.id.clone()).or_insert(line.number) {
                    first if first == line.number => Ok(row),
                    first => Err(format!("it repeats the pair of line {first}")),
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
        if !(3..=7).contains(&fields.len()) {
            return Err(format!(
                "it has {} fields, expected styled clip, original clip, style, text, kind, parts and edit type, \
                 the last four of which may be left out (quote a text with commas)",
                fields.len()
            ));
        }
        let field = |place: usize| fields.get(place).copied().unwrap_or_default();
        let (styled, original, style, text) = (field(0), field(1), field(2), field(3));
        let kind = parse_kind(field(4))?;
        let needed = match kind {
            EditKind::FineGrained => ("text", text),
            _ => ("style", style),
        };
        for (name, field) in [("styled clip", styled), ("original clip", original), needed] {
            if field.is_empty() {
                return Err(format!("it names no {name}"));
            }
        }
        Ok(Self {
            number,
            styled: styled.to_owned(),
            original: original.to_owned(),
            style: style.to_owned(),
            instruction: match text {
                "" => style_instruction(style),
                text => text.to_owned(),
            },
            kind,
            parts: parse_parts(field(5))?,
            edit_type: parse_edit_type(field(6), kind)?,
        })
    }

    fn pair(
        &self,
        motions: &BTreeMap<MotionId, Split>,
        known: &BTreeMap<[&MotionId; 2], Vec<&PairRow>>,
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
        let row = PairRow {
            id: format!("{LISTED}/{source}+{target}"),
            split: *split,
            source: LISTED.to_owned(),
            kind: self.kind.as_str().to_owned(),
            source_id: source.clone(),
            target_id: target.clone(),
            style: (!self.style.is_empty()).then(|| self.style.clone()),
            parts: self.parts.clone(),
            instruction: self.instruction.clone(),
            edit_type: self.edit_type.clone(),
            accepted_by: None,
        };
        let known = known.get(&[source, target]).map_or(&[][..], Vec::as_slice);
        let own = known.iter().find(|pair| pair.id == row.id);
        let Some(pair) = own.or(known.first()) else {
            return Ok(row);
        };
        let is_own = pair.id == row.id;
        if is_own && pair.source == LISTED && pair.accepted_by.is_none() {
            return Ok(row);
        }
        let again = PairRow {
            source: pair.source.clone(),
            accepted_by: pair.accepted_by.clone(),
            ..row
        };
        if again == **pair {
            return Ok(again);
        }
        let judged = if is_own { ", and people judged it" } else { "" };
        let (source, target, id) = (&again.source_id, &again.target_id, &pair.id);
        Err(format!(
            "{source} and {target} are the pair {id:?} already{judged}"
        ))
    }
}

/// Parses the kind of a line; [`default_kind`] for an empty word.
fn parse_kind(word: &str) -> Result<EditKind, String> {
    const ALLOWED: [EditKind; 2] = [EditKind::Style, EditKind::FineGrained];
    if word.is_empty() {
        return Ok(default_kind());
    }
    let known = ALLOWED.into_iter().find(|kind| kind.as_str() == word);
    known.ok_or_else(|| {
        format!(
            "its kind is {word:?}, expected {} (quote a text with commas)",
            ALLOWED.map(EditKind::as_str).join(" or ")
        )
    })
}

fn parse_edit_type(word: &str, kind: EditKind) -> Result<Option<String>, String> {
    if word.is_empty() {
        return Ok(None);
    }
    if kind != EditKind::FineGrained {
        return Err(format!(
            "its edit type is {word:?}, which only a fine-grained pair has"
        ));
    }
    let known = EDIT_TYPES.into_iter().find(|known| *known == word);
    known.map(|known| Some(known.to_owned())).ok_or_else(|| {
        format!(
            "its edit type is {word:?}, expected one of {}",
            EDIT_TYPES.join(", ")
        )
    })
}

/// Parses names of body parts, separated by semicolons; an empty text has none.
fn parse_parts(text: &str) -> Result<Vec<String>, String> {
    let names = text.split(';').map(str::trim);
    names
        .filter(|name| !name.is_empty())
        .map(|name| match name.parse::<BodyPart>() {
            Ok(part) => Ok(part.name().to_owned()),
            Err(error) => Err(error.to_string()),
        })
        .collect()
}

/// Ids that a name may stand for: the name itself, and the name without its file extension.
pub(crate) fn names_of(name: &str) -> impl Iterator<Item = &str> {
    let stem = match name.rsplit_once('.') {
        Some((stem, extension)) if !extension.contains('/') && !stem.is_empty() => Some(stem),
        _ => None,
    };
    std::iter::once(name).chain(stem)
}

/// Maps each styled clip of a list to the clip whose split it takes: its original, or the last one in a chain of
/// originals. Clips whose chain is a cycle are left out.
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
        let made = PairList::parse(text.as_bytes()).pairs(&motions(), &[], &BTreeSet::new());
        let rows = made.rows.iter();
        let said: Vec<[&str; 3]> = rows
            .map(|row| {
                [
                    row.source_id.as_str(),
                    row.target_id.as_str(),
                    &row.instruction,
                ]
            })
            .collect();
        let slow = "Replace a person with a slow look";
        let expected = [
            ["000009", "mine/000009_old", "Walk, as if old"],
            ["000011", "mine/walk, slowly", slow],
        ];
        assert_eq!(said, expected);
        let expected = [
            (5, "is in test and 000011 in train"),
            (6, "no motion of the dataset has the id \"nobody\""),
            (7, "repeats the pair of line 2"),
            (8, "names no style"),
            (9, "it has 2 fields"),
            (10, "its own original"),
        ];
        assert_eq!(made.refused.len(), expected.len(), "{:?}", made.refused);
        for (refused, (line, part)) in made.refused.iter().zip(expected) {
            assert_eq!(refused.line, line);
            assert!(refused.reason.contains(part), "{line}: {}", refused.reason);
        }
    }

    #[test]
    fn a_line_may_state_a_kind_and_parts_and_an_edit_type() {
        let text = "styled,original,style,text,kind,parts,edit_type\n\
            mine/000009_old,000009,,Lean forward more.,fine-grained,TORSO; HEAD,amplitude\n\
            \"mine/walk, slowly\",000011,slow,,style\n";
        let made = PairList::parse(text.as_bytes()).pairs(&motions(), &[], &BTreeSet::new());
        assert_eq!(made.refused, []);
        let [adjusted, slow] = &made.rows[..] else {
            panic!("{:?}", made.rows)
        };
        assert_eq!(adjusted.id, "csv/000009+mine/000009_old");
        assert_eq!(adjusted.kind, "fine-grained");
        assert_eq!(adjusted.style, None);
        assert_eq!(adjusted.parts, ["TORSO", "HEAD"]);
        assert_eq!(adjusted.instruction, "Lean forward more.");
        let types = [adjusted, slow].map(|row| row.edit_type.as_deref());
        assert_eq!(types, [Some("amplitude"), None]);
        assert_eq!(slow.kind, "style");
        assert_eq!(slow.style.as_deref(), Some("slow"));
        assert!(slow.parts.is_empty());
        for row in &made.rows {
            compose::check_pair(row).expect("the composer takes it");
        }
    }

    #[test]
    fn unknown_kinds_and_parts_and_missing_texts_are_refused() {
        for (line, part) in [
            (
                "a,b,,Lean.,semantic",
                "its kind is \"semantic\", expected style or fine-grained",
            ),
            ("a,b,old,Walk, slowly", "quote a text with commas"),
            ("a,b,,,fine-grained", "names no text"),
            ("a,b,,Lean.", "names no style"),
            ("a,b,,Lean.,fine-grained,TAIL", "\"TAIL\""),
            (
                "a,b,,Lean.,fine-grained,HEAD,x",
                "expected one of amplitude",
            ),
            ("a,b,old,x,style,,speed", "only a fine-grained pair"),
            ("a,b,,Lean.,fine-grained,HEAD,speed,x", "it has 8 fields"),
        ] {
            let list = PairList::parse(line.as_bytes());
            assert_eq!((list.lines.len(), list.refused.len()), (0, 1), "{line}");
            let reason = &list.refused[0].reason;
            assert!(reason.contains(part), "{line}: {reason}");
        }
    }

    #[test]
    fn a_list_of_style_pairs_is_stored_as_before_it_had_kinds() {
        let list = PairList::parse(b"a,b,old,x");
        let stored = serde_json::to_string(&list).expect("plain text");
        for name in ["kind", "parts", "edit_type"] {
            assert!(!stored.contains(name), "{stored}");
        }
        let read: PairList = serde_json::from_str(&stored).expect("its own form");
        assert_eq!(read, list);
    }

    #[test]
    fn an_open_quotation_mark_and_foreign_bytes_are_refused() {
        let list = PairList::parse(b"a,b,\"old\nc,d,new,x\n");
        assert_eq!((list.lines.len(), list.refused.len()), (0, 1));
        assert!(list.refused[0].reason.contains("quote"));
        let list = PairList::parse(b"a,b,old,x\na,\xff,old,x\nc,d,old,x\n");
        assert_eq!(list.lines.len(), 2);
        assert_eq!(list.refused[0].line, 2);
    }

    #[test]
    fn a_pair_that_is_there_already_is_not_made_twice() {
        let list = PairList::parse(b"mine/000009_old,000009,old,x");
        let mut known = list.pairs(&motions(), &[], &BTreeSet::new()).rows;
        known[0].id = "release".to_owned();
        let made = list.pairs(&motions(), &known, &BTreeSet::new());
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
