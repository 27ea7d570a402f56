//! Clips that the user chooses: a file of ids and patterns (`ingest --ids`).

use std::collections::BTreeSet;
use std::path::Path;

use formats::source::labels::{is_pattern, matches};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::names::some_of;

/// Ids and patterns that choose clips.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IdList {
    /// Number and name or pattern of each line.
    lines: Vec<(u64, String)>,
    names: BTreeSet<String>,
}

impl IdList {
    /// Reads a list.
    ///
    /// # Errors
    /// The file cannot be read, is no text, or names nothing.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(datasets_spec::Error::io("read", path))?;
        let refused = |reason: &str| {
            let reason = format!("cannot choose clips by {}: {reason}", path.display());
            Error::coded("E-ID-LIST", path.display(), reason)
        };
        let text = std::str::from_utf8(&bytes);
        let list =
            Self::parse(text.map_err(|_| refused("it is not UTF-8 text; save it as UTF-8"))?);
        match list.lines.is_empty() {
            true => Err(refused("it names no clip; write one id or pattern a line")),
            false => Ok(list),
        }
    }

    /// Parses a list with an id, a source file or a pattern (`*`: any characters, `?`: one character) on each line. A
    /// `#` at the beginning of a line or after white space begins a comment.
    pub fn parse(text: &str) -> Self {
        let lines = text.trim_start_matches('\u{feff}').lines().zip(1..);
        let lines = lines.filter_map(|(line, number)| {
            let comment = line.match_indices('#').map(|(at, _)| at);
            let mut comment = comment.filter(|at| line[..*at].trim_end().len() < *at || *at == 0);
            let name = line[..comment.next().unwrap_or(line.len())].trim();
            (!name.is_empty()).then(|| (number, name.to_owned()))
        });
        let lines: Vec<(u64, String)> = lines.collect();
        let names = lines.iter().map(|(_, name)| name.clone()).collect();
        Self { lines, names }
    }

    /// The listed names and patterns.
    pub(crate) fn into_names(self) -> BTreeSet<String> {
        self.names
    }

    /// BLAKE3 of the listed names and patterns, hexadecimal.
    pub(super) fn hash(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        for name in &self.names {
            hasher.update(name.as_bytes()).update(b"\n");
        }
        hasher.finalize().to_hex().to_string()
    }

    /// The first three names, and how many more there are.
    pub(super) fn shown(&self) -> String {
        some_of(self.names.iter().map(String::as_str))
    }

    pub(super) fn chooses(&self, names: &BTreeSet<String>) -> bool {
        let mut patterns = self.lines.iter().filter(|(_, line)| is_pattern(line));
        names.iter().any(|name| self.names.contains(name))
            || patterns.any(|(_, line)| names.iter().any(|name| matches(line, name)))
    }

    /// The lines that match none of these names, with their numbers.
    pub(super) fn unmatched(&self, names: &BTreeSet<String>) -> Vec<(u64, &str)> {
        let lines = self.lines.iter().filter(|(_, line)| {
            let is_named = || names.iter().any(|name| matches(line, name));
            !(names.contains(line) || is_pattern(line) && is_named())
        });
        lines
            .map(|(number, line)| (*number, line.as_str()))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_names_patterns_and_comments() {
        let list = IdList::parse(
            "\u{feff}# my clips\nwalk/anna_1\n\n  run/*  # all runs\nrobot.glb#Dance\ngone\n",
        );
        let of = |names: &[&str]| -> BTreeSet<String> {
            names.iter().map(|name| (*name).to_owned()).collect()
        };
        assert!(list.chooses(&of(&["walk/anna_1"])) && list.chooses(&of(&["x", "run/bert"])));
        assert!(list.chooses(&of(&["robot.glb#Dance"])));
        assert!(!list.chooses(&of(&["walk/anna_10", "walk"])));
        let names = of(&["walk/anna_1", "run/bert", "robot.glb#Dance"]);
        assert_eq!(list.unmatched(&names), [(6, "gone")]);
        assert_eq!(list.shown(), "gone, robot.glb#Dance, run/* and 1 more");
        assert_ne!(list.hash(), IdList::parse("gone").hash());
    }
}
