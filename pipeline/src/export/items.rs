//! Test items for external systems.

use std::fs;
use std::path::Path;

use datasets_spec::record::ItemRow;
use datasets_spec::{Motion, Progress, Skeleton};
use rayon::prelude::*;
use serde::Serialize;

use super::document::{file, write_json};
use super::paths::safe_name;
use crate::Error;
use work::NewFolder;

const LIST: &str = "items.json";
const SOURCES: &str = "sources";
const TARGETS: &str = "targets";

/// Content of `items.json`.
#[derive(Serialize)]
struct List<'a> {
    format: &'static str,
    version: u32,
    skeleton: &'a str,
    up: &'static str,
    items: Vec<Item<'a>>,
}

/// A test question. It tells only the length of the target, unless targets are exported.
#[derive(Serialize)]
struct Item<'a> {
    id: &'a str,
    task: &'a str,
    split: &'a str,
    instruction: &'a str,
    parts: &'a [String],
    /// The frames of the source that the question is about; absent where it is about all.
    #[serde(skip_serializing_if = "Option::is_none")]
    edit_start: Option<i32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    edit_end: Option<i32>,
    fps: f32,
    source: File,
    /// Frames of the target: published protocols give systems the length of the answer.
    target_frames: i32,
    #[serde(skip_serializing_if = "Option::is_none")]
    target: Option<File>,
}

#[derive(Serialize)]
struct File {
    file: String,
    frames: usize,
}

/// Writes items to a new folder: `sources/ID.npz` with SMPL-X parameters in AMASS's layout (z up) and
/// `keypoints` `[T, 28, 3]` in the same frame, and the questions to `items.json`. Targets go to
/// `targets/ID.npz`, but only on request. Equal items give equal bytes. Returns the number of motions
/// written.
///
/// # Errors
/// The folder exists and is not empty, an item does not match its id, or writing fails; nothing is left
/// behind then.
pub fn export_items(
    items: &[ItemRow],
    skeleton: &Skeleton,
    out: &Path,
    with_targets: bool,
    progress: &dyn Progress,
) -> Result<u64, Error> {
    items.iter().try_for_each(ItemRow::check)?;
    let folder = NewFolder::beside(out)?;
    for side in std::iter::once(SOURCES).chain(with_targets.then_some(TARGETS)) {
        let path = folder.path().join(side);
        fs::create_dir_all(&path).map_err(datasets_spec::Error::io("create folder", &path))?;
    }
    progress.begin("export items", Some(items.len() as u64));
    let written: Vec<Item<'_>> = items
        .par_iter()
        .map(|item| {
            let put = |side: &str, motion: &Motion| -> Result<File, Error> {
                let name = format!("{side}/{}.npz", safe_name(&item.id));
                let bytes =
                    formats::write::amass::encode_with_keypoints(motion, skeleton).map_err(
                        datasets_spec::Error::io("encode", folder.path().join(&name)),
                    )?;
                file(folder.path(), &name, &bytes)?;
                let frames = motion.len();
                Ok(File { file: name, frames })
            };
            let source = put(SOURCES, &item.source()?)?;
            let target = match with_targets && item.target_frames > 0 {
                true => Some(put(TARGETS, &item.target()?)?),
                false => None,
            };
            progress.advance(1);
            Ok(Item {
                id: &item.id,
                task: &item.task,
                split: item.split.as_str(),
                instruction: &item.instruction,
                parts: &item.parts,
                edit_start: item.edit_start,
                edit_end: item.edit_end,
                fps: item.fps,
                source,
                target_frames: item.target_frames,
                target,
            })
        })
        .collect::<Result<_, Error>>()?;
    let motions = written
        .iter()
        .map(|item| 1 + u64::from(item.target.is_some()))
        .sum();
    let list = List {
        format: "stance-items",
        version: 1,
        skeleton: skeleton.name(),
        up: "z",
        items: written,
    };
    write_json(folder.path(), LIST, &list)?;
    folder.publish()?;
    progress.finish(&format!("{} items", items.len()));
    Ok(motions)
}
