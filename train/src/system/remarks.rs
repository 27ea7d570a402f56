//! Warnings about edits, stored beside their table.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;

use datasets_spec::store::{ByPath, Store, if_exists};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::error::json_error;
use crate::fit::TextRecord;

/// File of warnings beside a table of edits.
const REMARKS: &str = "remarks.json";

/// Number of unknown words that a warning names.
const NAMED_WORDS: usize = 12;

/// Warnings about edits: short clips and unknown words.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remarks {
    /// Number of motions shorter than a window. They are edited with copies of their last pose, which are cut off
    /// again.
    pub num_short: usize,
    /// Number of instructions with more words than the system reads.
    #[serde(default)]
    pub num_cut: usize,
    /// Words of the instructions that did not occur in the system's training.
    pub unknown_words: BTreeSet<String>,
}

impl Remarks {
    /// Warnings about texts for a learned encoder; none for a frozen one.
    pub(crate) fn of_texts(encoder: &TextRecord, texts: &[&str]) -> Self {
        let TextRecord::Learned(vocabulary) = encoder else {
            return Self::default();
        };
        let unknown = texts.iter().flat_map(|text| vocabulary.unknown_words(text));
        Self {
            num_short: 0,
            num_cut: texts.iter().filter(|text| vocabulary.cuts(text)).count(),
            unknown_words: unknown.collect(),
        }
    }

    /// Reads the warnings beside a table of edits. Without the file, as for tables made by other programs, there are no
    /// warnings.
    ///
    /// # Errors
    /// The file is malformed or cannot be read.
    pub fn read(edits: &Path) -> Result<Self, Error> {
        let path = edits.join(REMARKS);
        match if_exists(ByPath.read(&path)).map_err(Error::io("read", &path))? {
            Some(bytes) => serde_json::from_slice(&bytes).map_err(json_error(&path)),
            None => Ok(Self::default()),
        }
    }

    /// Writes the warnings beside a table of edits.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, edits: &Path) -> Result<(), Error> {
        let path = edits.join(REMARKS);
        let text = serde_json::to_vec_pretty(self).expect("words and a number serialise");
        let write = || {
            let mut file = ByPath.create(&path)?;
            file.write_all(&text)?;
            file.publish()
        };
        write().map_err(Error::io("write", &path))
    }

    /// The warnings as sentences, one per line.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if self.num_short > 0 {
            lines.push(format!(
                "{} shorter than a window of the model: the last pose is held while editing, and the \
                 frames added are cut off again",
                match self.num_short {
                    1 => "1 motion is".to_owned(),
                    many => format!("{many} motions are"),
                }
            ));
        }
        if self.num_cut > 0 {
            lines.push(format!(
                "{} more words than the editor reads: the last ones change nothing",
                match self.num_cut {
                    1 => "1 instruction has".to_owned(),
                    many => format!("{many} instructions have"),
                }
            ));
        }
        if !self.unknown_words.is_empty() {
            let words = self.unknown_words.iter().map(String::as_str);
            let named: Vec<&str> = words.take(NAMED_WORDS).collect();
            let others = match self.unknown_words.len() - named.len() {
                0 => String::new(),
                count => format!(" and {count} more words"),
            };
            lines.push(format!(
                "the editor has never seen {}{others}: it cannot follow these words",
                named.join(", ")
            ));
        }
        lines
    }
}
