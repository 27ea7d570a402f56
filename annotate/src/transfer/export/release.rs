//! Layout `stance`: the JSON files of the STANCE release, written value by value, and the table `annotations`, which holds
//! what they have no place for.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use serde::Serializer;
use serde::ser::{SerializeMap, SerializeSeq};
use serde_json::json;

use super::exporter::{Exporter, write_file};
use crate::Error;
use crate::transfer::import::pair_id;
use crate::transfer::release;
use crate::wire::{Answer, MaskAnswer, Verdict};

/// The table beside the files of the layout.
const TABLE: &str = "annotations.parquet";

/// Writes JSON value by value.
type JsonWriter<'a> =
    serde_json::Serializer<BufWriter<&'a mut File>, serde_json::ser::PrettyFormatter<'static>>;

/// Error while writing JSON.
enum JsonError {
    Json(serde_json::Error),
    Other(Error),
}

impl From<serde_json::Error> for JsonError {
    fn from(error: serde_json::Error) -> Self {
        Self::Json(error)
    }
}

impl From<Error> for JsonError {
    fn from(error: Error) -> Self {
        Self::Other(error)
    }
}

/// Writes a file of JSON value by value, whole or not at all.
fn write_json(
    folder: &Path,
    name: &str,
    write: impl FnOnce(&mut JsonWriter<'_>) -> Result<(), JsonError>,
) -> Result<(), Error> {
    write_file(folder, name, |file, path| {
        let mut json = serde_json::Serializer::pretty(BufWriter::new(file));
        write(&mut json).map_err(|error| match error {
            JsonError::Json(error) => datasets_spec::Error::io("write", path)(error.into()).into(),
            JsonError::Other(error) => error,
        })?;
        let mut file = json.into_inner();
        Ok(file
            .write_all(b"\n")
            .and_then(|()| file.flush())
            .map_err(datasets_spec::Error::io("write", path))?)
    })
}

impl Exporter<'_> {
    /// Writes four files in one pass: masks by motion, their texts, how they were accepted, and pairs. The table holds all
    /// of it, and what is counted as left out of them.
    pub(super) fn stance(&mut self, folder: &Path) -> Result<(), Error> {
        let names = ["mask_all", "part_annotations", "accepted_by", "pairs"]
            .map(|name| format!("{name}.json"));
        let [masks, texts, marks, pairs] = &names;
        write_json(folder, masks, |masks| {
            let mut masks = masks.serialize_map(None)?;
            write_json(folder, texts, |texts| {
                let mut texts = texts.serialize_map(None)?;
                write_json(folder, marks, |marks| {
                    let mut marks = marks.serialize_map(None)?;
                    write_json(folder, pairs, |pairs| {
                        let mut pairs = pairs.serialize_seq(None)?;
                        self.released(&mut masks, &mut texts, &mut marks, &mut pairs)?;
                        Ok(SerializeSeq::end(pairs)?)
                    })?;
                    Ok(SerializeMap::end(marks)?)
                })?;
                Ok(SerializeMap::end(texts)?)
            })?;
            Ok(SerializeMap::end(masks)?)
        })?;
        self.done.files.extend(names);
        self.annotation_table(folder)
    }

    fn released(
        &mut self,
        masks_file: &mut impl SerializeMap<Error = serde_json::Error>,
        texts_file: &mut impl SerializeMap<Error = serde_json::Error>,
        marks_file: &mut impl SerializeMap<Error = serde_json::Error>,
        pairs_file: &mut impl SerializeSeq<Error = serde_json::Error>,
    ) -> Result<(), JsonError> {
        for what in ["motions", "pairs"] {
            self.done.count(what, 0);
        }
        self.each_accepted::<JsonError>(|exporter, accepted| {
            let (motion, target) = exporter.ids(&accepted.task)?;
            let split = &accepted.task.split;
            let (id, accepted_by) = (pair_id(&accepted.task.key), &accepted.accepted_by);
            let pair = match accepted.answer {
                Answer::MaskText { masks, .. } => {
                    for (name, count) in lost_of(&masks) {
                        exporter.done.lose(name, count);
                    }
                    let (masks, texts) = release::entries(&masks, accepted.task.extra.as_ref());
                    masks_file.serialize_entry(&motion, &masks)?;
                    texts_file.serialize_entry(&motion, &texts)?;
                    marks_file.serialize_entry(&motion, accepted_by)?;
                    exporter.done.count("motions", 1);
                    return Ok(());
                }
                Answer::Pair {
                    verdict: Verdict::Keep,
                    parts,
                    edit_type,
                    text,
                    ..
                } => json!({
                    "id": id, "kind": "fine-grained", "src": motion, "tgt": target,
                    "body_part": parts.join("+"), "text": text, "edit_type": edit_type, "split": split,
                    "accepted_by": accepted_by,
                }),
                Answer::Style {
                    verdict: Verdict::Keep,
                    parts,
                    text,
                    style,
                    extent,
                    ..
                } => {
                    exporter.done.lose("extents", usize::from(extent.is_some()));
                    let style = style.unwrap_or_default();
                    json!({
                        "id": id, "kind": "style", "name": format!("{motion}_{style}"), "src": motion, "tgt": target,
                        "style": style, "body_part": parts.join("+"), "text": text, "split": split,
                        "accepted_by": accepted_by,
                    })
                }
                Answer::Pair { .. } | Answer::Style { .. } => {
                    exporter.done.lose("rejected_pairs", 1);
                    return Ok(());
                }
            };
            pairs_file.serialize_element(&pair)?;
            exporter.done.count("pairs", 1);
            Ok(())
        })?;
        for (name, what) in LOST {
            if let Some(count) = self.done.counts.get(name) {
                self.done.messages.push(format!(
                    "{count} {what}, for which the layout has no place: {TABLE} alone says so"
                ));
            }
        }
        Ok(())
    }
}

/// What the JSON files have no place for, by the names of its counts.
const LOST: [(&str, &str); 5] = [
    ("masks_without_ring", "masks have no soft ring"),
    (
        "masks_of_own_joints",
        "masks have joints that a person chose one by one",
    ),
    ("masks_of_a_range", "masks hold for a range of frames"),
    ("rejected_pairs", "pairs are judged not usable"),
    ("extents", "style pairs have an extent"),
];

/// Counts of masks of which the files have no place for something.
fn lost_of(masks: &[MaskAnswer]) -> [(&'static str, usize); 3] {
    let count =
        |is_lost: fn(&MaskAnswer) -> bool| masks.iter().filter(|mask| is_lost(mask)).count();
    [
        ("masks_without_ring", count(|mask| !mask.soft)),
        ("masks_of_own_joints", count(|mask| !mask.joints.is_empty())),
        ("masks_of_a_range", count(|mask| mask.range.is_some())),
    ]
}
