//! Files of an export that the published layout does not have: `origin.json`, `masks.jsonl` and `pairs.jsonl`.
//!
//! `origin.json` states the dataset id of each file's motion, and metadata that the layout cannot hold. `masks.jsonl`
//! and `pairs.jsonl` hold the masks and pairs of the dataset, a row of its tables in each line, as
//! `datasets-spec/README.md` describes them. Loaders of the release ignore all three.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::Split;
use datasets_spec::record::ExportedLabels;
use datasets_spec::table::{Caption, PartCaption};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Error;

/// The file at the root of an export that states the dataset id of each motion.
pub const FILE_NAME: &str = "origin.json";
/// The file with the masks of an export.
pub const MASKS: &str = "masks.jsonl";
/// The file with the pairs of an export.
pub const PAIRS: &str = "pairs.jsonl";

/// Code of errors in the files that an export adds.
pub(super) const CODE_OF_ORIGIN: &str = "E-STANCE-ORIGIN";
/// Value of the field `format` in `origin.json`, which earlier versions did not write.
const FORMAT: &str = "stance-export";
/// Version of the three files.
const VERSION: u32 = 2;

/// The origins of an export, by the file's path without extension (`base_motion/029232`), with
/// `#src` and `#tgt` for the motions of an adjustment.
pub(crate) type Origins = BTreeMap<String, Origin>;

/// Content of `origin.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    format: String,
    version: u32,
    /// Root hash of the dataset.
    pub(crate) dataset: String,
    /// Skeleton the parameters drive.
    pub(crate) skeleton: String,
    /// BLAKE3 hashes of the lists in the release's layout, by path. `masks.jsonl` and `pairs.jsonl` contain their
    /// labels in full.
    pub lists: BTreeMap<String, String>,
    /// Origins of the motions.
    pub motions: Origins,
}

/// Where an exported motion comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Id in the dataset.
    pub id: String,
    /// Split in the dataset.
    pub split: Split,
    /// Hash of the motion in the file, as in column `content_hash`; `None` in exports of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub content_hash: Option<String>,
    /// Hash of the motion in the dataset, if it was resampled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stored_hash: Option<String>,
    /// Where its rotations come from.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub rotation_source: String,
    /// Error of the fitted rotations against the source positions, in metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit_error_m: Option<f32>,
    /// Id of the motion it mirrors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mirrored_of: Option<String>,
    /// Captions of the motion.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub captions: Vec<Caption>,
    /// Who wrote each of the captions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub caption_origins: Vec<String>,
    /// Captions of single body parts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub part_captions: Vec<PartCaption>,
    /// Name of the performer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    /// Action label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// Style label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub style: Option<String>,
    /// Licence tag.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
}

impl Record {
    /// The record of a dataset, without motions.
    pub fn new(dataset: &str, skeleton: &str) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            dataset: dataset.to_owned(),
            skeleton: skeleton.to_owned(),
            lists: BTreeMap::new(),
            motions: Origins::new(),
        }
    }
}

/// Content of `origin.json`: a record, or only the motions, as earlier versions wrote them.
pub enum Parsed {
    /// A record.
    Record(Record),
    /// Only the motions.
    Motions(Origins),
}

/// Reads `origin.json`.
///
/// # Errors
/// The bytes are not an `origin.json`, or are of another version.
pub fn parse(bytes: &[u8]) -> Result<Parsed, String> {
    let text = |error: serde_json::Error| error.to_string();
    let value: Value = serde_json::from_slice(bytes).map_err(text)?;
    if value.get("format").is_none_or(Value::is_object) {
        return serde_json::from_value(value)
            .map(Parsed::Motions)
            .map_err(text);
    }
    if value["format"] != FORMAT || value["version"] != VERSION {
        return Err(format!(
            "format {} of version {}, this program reads {FORMAT:?} of version {VERSION}",
            value["format"], value["version"]
        ));
    }
    serde_json::from_value(value)
        .map(Parsed::Record)
        .map_err(text)
}

/// Reads rows, one in each line.
///
/// # Errors
/// A line is not a row; the error names its number.
pub(crate) fn rows<R: DeserializeOwned>(bytes: &[u8]) -> Result<Vec<R>, String> {
    let text = str::from_utf8(bytes).map_err(|error| error.to_string())?;
    let lines = text.lines().enumerate();
    let lines = lines.filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(number, line)| {
            serde_json::from_str(line).map_err(|error| format!("line {}: {error}", number + 1))
        })
        .collect()
}

/// Reads the labels of a folder that `stance export --to stance` wrote; `None` if the folder has no `origin.json`.
///
/// # Errors
/// A file cannot be read or is broken, or the export is of an earlier version, which has no labels.
pub fn exported_labels(folder: &Path) -> Result<Option<ExportedLabels>, Error> {
    let path = folder.join(FILE_NAME);
    if !path.is_file() {
        return Ok(None);
    }
    let read = |name: &str| {
        let path = folder.join(name);
        std::fs::read(&path).map_err(datasets_spec::Error::io("read", &path))
    };
    let broken = |name: &str, reason: String| Error::UnusableFile {
        path: folder.join(name),
        code: "E-STANCE-ORIGIN",
        reason,
    };
    let Parsed::Record(record) =
        parse(&read(FILE_NAME)?).map_err(|reason| broken(FILE_NAME, reason))?
    else {
        let reason = "an earlier version wrote this export, whose numbers of motions are not the ids of the dataset; \
                      export the dataset again (`stance export --to stance`) and import that";
        return Err(broken(FILE_NAME, reason.to_owned()));
    };
    let mut motions: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for origin in record.motions.into_values() {
        let hashes = motions.entry(origin.id).or_default();
        hashes.extend(origin.content_hash.into_iter().chain(origin.stored_hash));
    }
    Ok(Some(ExportedLabels {
        motions,
        masks: rows(&read(MASKS)?).map_err(|reason| broken(MASKS, reason))?,
        pairs: rows(&read(PAIRS)?).map_err(|reason| broken(PAIRS, reason))?,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_of_either_version_is_read_and_others_are_refused() {
        let record = Record::new("d1", "body");
        let text = serde_json::to_vec(&record).expect("JSON");
        assert!(matches!(parse(&text), Ok(Parsed::Record(read)) if read.dataset == "d1"));
        // In an earlier version, the file of a motion may be named `format`, like one of the fields.
        let older = br#"{"base_motion/1": {"id": "a", "split": "test"}, "format": {"id": "b", "split": "val"}}"#;
        assert!(matches!(parse(older), Ok(Parsed::Motions(motions)) if motions.len() == 2));
        for (text, said) in [
            (
                r#"{"format": "stance-export", "version": 3}"#,
                "of version 3",
            ),
            (r#"{"format": "other", "version": 2}"#, "\"other\""),
            (
                r#"{"format": "stance-export", "version": 2}"#,
                "missing field",
            ),
            ("[]", "map"),
            ("{", "EOF"),
        ] {
            let refused = parse(text.as_bytes()).err().expect("refused");
            assert!(refused.contains(said), "{refused}");
        }
    }

    #[test]
    fn labels_of_an_export_of_an_earlier_version_are_refused() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        assert!(exported_labels(dir.path()).is_ok_and(|labels| labels.is_none()));
        let older = br#"{"base_motion/1": {"id": "a", "split": "test"}}"#;
        std::fs::write(dir.path().join(FILE_NAME), older).expect("written");
        let refused = exported_labels(dir.path())
            .expect_err("refused")
            .to_string();
        assert!(refused.contains("export the dataset again"), "{refused}");
    }

    #[test]
    fn a_broken_line_is_named() {
        let read = rows::<u32>(b"1\n\n2\n").expect("numbers");
        assert_eq!(read, [1, 2]);
        let refused = rows::<u32>(b"1\n2\nx\n").expect_err("refused");
        assert!(refused.starts_with("line 3: "), "{refused}");
        assert!(rows::<u32>(b"\xff").is_err());
    }
}
