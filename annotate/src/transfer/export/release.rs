//! Layout `stance`: the JSON files of the STANCE release, written value by value, and the table `annotations`, which holds
//! what they have no place for.

use std::path::Path;

use serde_json::{Value, json};

use super::exporter::{Exporter, TextFile};
use crate::Error;
use crate::transfer::import::pair_id;
use crate::transfer::release;
use crate::wire::{MaskAnswer, TaskKind};

/// The table beside the files of the layout.
const TABLE: &str = "annotations.parquet";
/// The files: masks by motion, their texts, how they were accepted, and pairs.
const FILES: [&str; 4] = [
    "mask_all.json",
    "part_annotations.json",
    "accepted_by.json",
    "pairs.json",
];

/// A file of a JSON object or list, written entry by entry.
struct JsonFile {
    file: TextFile,
    is_empty: bool,
}

impl JsonFile {
    fn begin(folder: &Path, name: &str, bracket: &str) -> Result<Self, Error> {
        let mut file = TextFile::begin(folder, name)?;
        file.put(bracket)?;
        let is_empty = true;
        Ok(Self { file, is_empty })
    }

    /// Adds a value, with its key in an object.
    fn put(&mut self, key: Option<&str>, value: &Value) -> Result<(), Error> {
        let comma = if self.is_empty { "" } else { "," };
        self.is_empty = false;
        let key = key.map(|key| format!("{}: ", Value::from(key)));
        // Line breaks inside texts are escaped in JSON, so all that are left belong to the layout.
        let value = format!("{value:#}").replace('\n', "\n  ");
        let key = key.unwrap_or_default();
        self.file.put(&format!("{comma}\n  {key}{value}"))
    }

    fn finish(mut self, bracket: &str) -> Result<(), Error> {
        let line = if self.is_empty { "" } else { "\n" };
        self.file.put(&format!("{line}{bracket}\n"))?;
        self.file.finish()
    }
}

impl Exporter<'_> {
    /// Writes [`FILES`] in one pass. The table holds all of it, and what is counted as left out of them.
    pub(super) fn stance(&mut self, folder: &Path) -> Result<(), Error> {
        let [mut masks, mut texts, mut marks] = [
            JsonFile::begin(folder, FILES[0], "{")?,
            JsonFile::begin(folder, FILES[1], "{")?,
            JsonFile::begin(folder, FILES[2], "{")?,
        ];
        let mut pairs = JsonFile::begin(folder, FILES[3], "[")?;
        for what in ["motions", "pairs"] {
            self.done.count(what, 0);
        }
        self.each_accepted(|exporter, accepted| {
            let (motion, target) = exporter.ids(&accepted.task)?;
            let (task, accepted_by) = (&accepted.task, &accepted.accepted_by);
            let said = accepted.answer.fields();
            if task.kind == TaskKind::MaskText {
                for (name, count) in lost_of(said.masks) {
                    exporter.done.lose(name, count);
                }
                let (parts, said) = release::entries(said.masks, task.extra.as_ref());
                masks.put(Some(&motion), &parts)?;
                texts.put(Some(&motion), &said)?;
                marks.put(Some(&motion), &json!(accepted_by))?;
                exporter.done.count("motions", 1);
                return Ok(());
            }
            if accepted.answer.is_reject() {
                exporter.done.lose("rejected_pairs", 1);
                return Ok(());
            }
            let has_extent = said.extent.is_some();
            exporter.done.lose("extents", usize::from(has_extent));
            let mut pair = json!({
                "id": pair_id(&task.key), "kind": "fine-grained", "src": motion, "tgt": target,
                "body_part": said.parts.join("+"), "text": said.text, "split": task.split,
                "accepted_by": accepted_by,
            });
            if task.kind == TaskKind::Style {
                let style = said.style.unwrap_or_default();
                pair["kind"] = json!("style");
                pair["name"] = json!(format!("{motion}_{style}"));
                pair["style"] = json!(style);
            } else {
                pair["edit_type"] = json!(said.edit_type);
            }
            pairs.put(None, &pair)?;
            exporter.done.count("pairs", 1);
            Ok(())
        })?;
        for file in [masks, texts, marks] {
            file.finish("}")?;
        }
        pairs.finish("]")?;
        self.done.files.extend(FILES.map(str::to_owned));
        for (name, what) in LOST {
            if let Some(count) = self.done.counts.get(name) {
                self.done.messages.push(format!(
                    "{count} {what}, for which the layout has no place: {TABLE} alone says so"
                ));
            }
        }
        self.table(folder, Self::annotations)
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
