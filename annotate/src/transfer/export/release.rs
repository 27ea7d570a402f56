//! Layout `stance`: the JSON files of the STANCE release, and the table `annotations` with the data that they cannot
//! hold.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::exporter::Exporter;
use crate::Error;
use crate::transfer::keys::pair_id;
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

impl Exporter<'_> {
    /// Writes [`FILES`], and beside them [`TABLE`], which also holds everything that the files leave out.
    pub(super) fn stance(&mut self, folder: &Path) -> Result<(), Error> {
        let (mut masks, mut texts, mut marks) = (Map::new(), Map::new(), Map::new());
        let mut pairs = Vec::new();
        for what in ["motions", "pairs"] {
            self.done.count(what, 0);
        }
        self.each_accepted(|exporter, accepted| {
            let (motion, target) = exporter.ids(&accepted.task)?;
            let (task, accepted_by) = (&accepted.task, accepted.accepted_by());
            let said = accepted.answer.fields();
            if task.kind == TaskKind::MaskText {
                for (name, count) in lost_of(said.masks) {
                    exporter.done.lose(name, count);
                }
                // Texts of a release that fit no mask belong to the imported answer, not to a later one.
                let is_imported = accepted.basis.starts_with("import");
                let extra = task.extra.as_ref().filter(|_| is_imported);
                let (parts, said) = release::entries(said.masks, extra);
                masks.insert(motion.clone(), parts);
                texts.insert(motion.clone(), said);
                marks.insert(motion, json!(accepted_by));
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
            pairs.push(pair);
            exporter.done.count("pairs", 1);
            Ok(())
        })?;
        let contents: [Value; 4] = [masks.into(), texts.into(), marks.into(), pairs.into()];
        for (name, content) in FILES.into_iter().zip(contents) {
            self.write(folder, name, &format!("{content:#}\n"))?;
        }
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

/// Names of the counts of data that the release's JSON files cannot hold, each with words for the message.
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

/// Counts of mask properties that the files cannot hold.
fn lost_of(masks: &[MaskAnswer]) -> [(&'static str, usize); 3] {
    let count =
        |is_lost: fn(&MaskAnswer) -> bool| masks.iter().filter(|mask| is_lost(mask)).count();
    [
        ("masks_without_ring", count(|mask| !mask.soft)),
        ("masks_of_own_joints", count(|mask| !mask.joints.is_empty())),
        ("masks_of_a_range", count(|mask| mask.range.is_some())),
    ]
}
