//! Splits that the user states: a CSV file of names or patterns and splits (`ingest --splits`).

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use csv::StringRecord;
use datasets_spec::Split;

use formats::source::labels::{is_pattern, matches};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::annotation::pairs::{RefusedLine, parse_lines};

/// Prefix of a name that means all clips of a subject.
const SUBJECT: &str = "subject:";

/// The lines of the CSV file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SplitList {
    lines: Vec<Line>,
    /// Indices in `lines` by exact name; the first line of a name counts.
    exact: BTreeMap<String, usize>,
    refused: Vec<RefusedLine>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Line {
    number: u64,
    name: String,
    split: Split,
}

impl SplitList {
    /// Reads a list. Lines without a split are kept as refused.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(datasets_spec::Error::io("read", path))?;
        Ok(Self::parse(&bytes))
    }

    /// Parses a list in UTF-8: a name and a split on each line, with or without the header line `clip,split`. A name is
    /// an id, a source file, or a pattern (`*`: any characters, `?`: one character) that these match; after `subject:`
    /// it is a subject or a pattern of subjects.
    pub fn parse(bytes: &[u8]) -> Self {
        let mut list = Self::default();
        let is_header =
            |record: &StringRecord| record.len() == 2 && record[1].eq_ignore_ascii_case("split");
        (list.lines, list.refused) = parse_lines(bytes, is_header, parse_line);
        for (place, line) in list.lines.iter().enumerate() {
            list.exact.entry(line.name.clone()).or_insert(place);
        }
        list
    }

    /// BLAKE3 of the lines, hexadecimal.
    pub(super) fn hash(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        for line in &self.lines {
            hasher.update(format!("{:?} {}\n", line.name, line.split).as_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Index of the first line that matches one of the names of a clip.
    pub(super) fn line_of(&self, names: &BTreeSet<String>) -> Option<usize> {
        let exact = names.iter().filter_map(|name| self.exact.get(name)).min();
        let mut patterns = self
            .lines
            .iter()
            .take(exact.copied().unwrap_or(self.lines.len()));
        let pattern = patterns.position(|line| {
            is_pattern(&line.name) && names.iter().any(|name| is_match(&line.name, name))
        });
        pattern.or(exact.copied())
    }

    pub(super) fn split(&self, line: usize) -> Split {
        self.lines[line].split
    }

    /// The lines that were refused, and those that match none of these names.
    pub(super) fn refused(&self, names: &BTreeSet<String>) -> Vec<RefusedLine> {
        let mut refused = self.refused.clone();
        let unknown = self.lines.iter().filter(|line| {
            let is_named = || names.iter().any(|name| is_match(&line.name, name));
            !(names.contains(&line.name) || is_pattern(&line.name) && is_named())
        });
        refused.extend(unknown.map(|line| RefusedLine {
            line: line.number,
            reason: format!("no clip is called {:?}", line.name),
        }));
        refused.sort();
        refused
    }
}

pub(super) fn name_of_subject(subject: &str) -> String {
    format!("{SUBJECT}{subject}")
}

/// Whether a pattern matches a name. Patterns of ids do not match subjects.
fn is_match(pattern: &str, name: &str) -> bool {
    pattern.starts_with(SUBJECT) == name.starts_with(SUBJECT) && matches(pattern, name)
}

fn parse_line(number: u64, record: &StringRecord) -> Result<Line, String> {
    if record.len() != 2 {
        return Err(format!(
            "it has {} fields, expected a name and a split",
            record.len()
        ));
    }
    let [name, split] = [&record[0], &record[1]];
    if name.is_empty() {
        return Err("it names no clip".to_owned());
    }
    let split = split.to_lowercase().parse();
    Ok(Line {
        number,
        name: name.to_owned(),
        split: split.map_err(|error: datasets_spec::Error| error.to_string())?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_that_names_a_clip_decides() {
        let list = SplitList::parse(
            b"clip,split\nwalk/anna_1,val\nwalk/*,test\nrun,Train\nsubject:b*,val\nwalk/anna_2,train\n\
              jump,all\na,b,c\n,test\n",
        );
        let split = |names: &[&str]| {
            let names = names.iter().map(|name| (*name).to_owned()).collect();
            list.line_of(&names).map(|line| list.split(line))
        };
        let bert = name_of_subject("bert");
        assert_eq!(split(&["walk/anna_1"]), Some(Split::Val));
        assert_eq!(split(&["walk/anna_2"]), Some(Split::Test));
        assert_eq!(split(&["run", &bert]), Some(Split::Train));
        assert_eq!(split(&["sit", &bert]), Some(Split::Val));
        assert_eq!(split(&["sit", &name_of_subject("anna")]), None);
        let names = ["walk/anna_1", "walk/anna_2", "subject:bert"].map(str::to_owned);
        let refused = list.refused(&names.into());
        let lines: Vec<u64> = refused.iter().map(|refused| refused.line).collect();
        assert_eq!(lines, [4, 7, 8, 9], "{refused:?}");
        assert!(refused[0].reason.contains("\"run\""));
    }
}
