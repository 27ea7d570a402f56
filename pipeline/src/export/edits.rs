//! Edits of systems and their items, with one file each.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Dataset, Motion, Progress};
use rayon::prelude::*;
use serde::Serialize;

use super::Layout;
use super::clips::FileKind;
use super::document::{file, write_json};
use super::paths::safe_name;
use crate::Error;
use work::NewFolder;

const LIST: &str = "edits.json";

/// Motions of the items that are exported beside the edits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sides {
    /// The sources.
    pub sources: bool,
    /// The targets.
    pub targets: bool,
}

struct Clip<'a> {
    stem: String,
    motion: Motion,
    /// Its entry in `edits.json`, in which name, length and rate are not set yet.
    said: Said<'a>,
}

/// An entry of `edits.json`.
#[derive(Clone, Default, Serialize)]
struct Said<'a> {
    file: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    system: Option<&'a str>,
    item: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    seed: Option<u64>,
    task: &'a str,
    instruction: &'a str,
    fps: f32,
    frames: usize,
}

/// Writes the edits of a dataset to a new folder, each as `SYSTEM/ITEM`, with the seed as a suffix if a system has
/// several takes of the item. On request, sources and targets of the items are written as `sources/ITEM` and
/// `targets/ITEM`. `edits.json` lists the files with their questions. Returns the number of motions.
///
/// # Errors
/// The layout is not one with a file for each motion, the folder exists and is not empty, the tables
/// cannot be read, or writing fails; nothing is left behind then.
pub fn export_edits(
    dataset: &Dataset,
    layout: Layout,
    sides: Sides,
    out: &Path,
    progress: &dyn Progress,
) -> Result<u64, Error> {
    let kind = match layout {
        Layout::Amass => FileKind::AMASS,
        Layout::Bvh => FileKind::BVH,
        Layout::Gltf => FileKind::GLTF,
        other => {
            return Err(Error::refused(format!(
                "{other} is a layout of whole datasets; edits are exported as bvh, amass or gltf"
            )));
        }
    };
    let skeleton = dataset.skeleton()?;
    let edits = dataset.read::<EditRow>(None)?;
    let items = dataset.read::<ItemRow>(None)?;
    let folder = NewFolder::beside(out)?;
    let mut taken = BTreeSet::new();
    let clips = clips(&edits, &items, sides)?;
    let named: Vec<(String, Clip<'_>)> = clips
        .into_iter()
        .map(|clip| {
            let stem = kind.stem(&clip.stem, &mut taken);
            let name = kind.name(&stem);
            (name, clip)
        })
        .collect();
    progress.begin("export", Some(named.len() as u64));
    let said: Vec<Said<'_>> = named
        .into_par_iter()
        .map(|(name, clip)| {
            let motion = kind.motion(clip.motion)?;
            let encoded = (kind.encode)(&motion, &skeleton);
            let path = folder.path().join(&name);
            let bytes = encoded.map_err(datasets_spec::Error::io("encode", path))?;
            file(folder.path(), &name, &bytes)?;
            progress.advance(1);
            Ok(Said {
                file: name,
                fps: motion.fps().get() as f32,
                frames: motion.len(),
                ..clip.said
            })
        })
        .collect::<Result<_, Error>>()?;
    write_json(folder.path(), LIST, &said)?;
    folder.publish()?;
    progress.finish(&format!("{} motions", said.len()));
    Ok(said.len() as u64)
}

fn clips<'a>(
    edits: &'a [EditRow],
    items: &'a [ItemRow],
    sides: Sides,
) -> Result<Vec<Clip<'a>>, Error> {
    let mut takes: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    for row in edits {
        *takes.entry((&row.system, &row.id)).or_default() += 1;
    }
    let mut clips = Vec::new();
    for row in edits {
        let item = safe_name(&row.id);
        let take = match takes[&(row.system.as_str(), row.id.as_str())] {
            1 => String::new(),
            _ => format!("-{}", row.seed),
        };
        clips.push(Clip {
            stem: format!("{}/{item}{take}", safe_name(&row.system)),
            said: Said {
                system: Some(&row.system),
                item: &row.id,
                seed: Some(row.seed),
                task: &row.kind,
                instruction: &row.instruction,
                ..Said::default()
            },
            motion: row.motion()?,
        });
    }
    for item in items {
        let mut add = |side: &str, motion: Motion| {
            clips.push(Clip {
                stem: format!("{side}/{}", safe_name(&item.id)),
                said: Said {
                    item: &item.id,
                    task: &item.task,
                    instruction: &item.instruction,
                    ..Said::default()
                },
                motion,
            });
        };
        if sides.sources {
            add("sources", item.source()?);
        }
        if sides.targets && item.target_frames > 0 {
            add("targets", item.target()?);
        }
    }
    Ok(clips)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_system_is_one_folder() {
        for (system, folder) in [
            ("TMED", "TMED"),
            ("MotionReFit tiny, w/o MCM", "MotionReFit tiny, w_o MCM"),
            ("..", "_"),
            ("../x", ".._x"),
        ] {
            assert_eq!(safe_name(system), folder);
        }
    }
}
