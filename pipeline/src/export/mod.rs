//! Datasets in the layouts that other tools read.
//!
//! An export appears whole or not at all: it is written to a temporary folder beside the destination, and
//! renamed when it is complete.

mod amass;
mod before;
mod by_clip;
mod clips;
mod edits;
mod feature_files;
mod features;
mod form;
mod humanml3d;
mod items;
mod job;
mod left_out;
mod lerobot;
mod motionfix;
mod paths;
mod stance;
mod webdataset;

use std::fs;
use std::path::Path;

use datasets_spec::Progress;
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use serde::Serialize;

use crate::Error;
use crate::clips::Clips;
use work::NewFolder;

use self::by_clip::PART_CLIPS;
use self::form::Form;
pub use before::before;
pub use edits::{Sides, export_edits};
pub use items::export_items;
pub(crate) use items::item_stem;
pub use job::plan_export;
pub(crate) use job::{JOB, open_job};
pub use left_out::{Counts, Exported, untagged_captions};
pub use motionfix::export_triplets;

/// A layout to export to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Layout {
    /// AMASS npz files with the keys of the SMPL-X releases.
    Amass,
    /// A HumanML3D folder.
    HumanMl3d,
    /// The layout of the STANCE release.
    Stance,
    /// A BVH file for each clip.
    Bvh,
    /// A GLB file for each clip: an animated skeleton in a simple body.
    Gltf,
    /// Tar shards of npy and json members.
    WebDataset,
    /// LeRobot v3: one row per frame.
    LeRobot,
    /// A folder of 272 features as HumanML3D-272.
    HumanMl3d272,
    /// A folder of 272 features as BABEL-272.
    Babel272,
    /// A folder of 272 features as MotionMillion.
    MotionMillion,
    /// A folder of the 201 features of HY-Motion.
    HyMotion,
    /// Dumps of MotionFix: the pairs of the dataset.
    MotionFix,
}

impl std::fmt::Display for Layout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

impl Layout {
    /// Every layout.
    pub const ALL: [Layout; 12] = [
        Self::Amass,
        Self::HumanMl3d,
        Self::Stance,
        Self::Bvh,
        Self::Gltf,
        Self::WebDataset,
        Self::LeRobot,
        Self::HumanMl3d272,
        Self::Babel272,
        Self::MotionMillion,
        Self::HyMotion,
        Self::MotionFix,
    ];

    /// The name used on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Amass => "amass",
            Self::HumanMl3d => "humanml3d",
            Self::Stance => "stance",
            Self::Bvh => "bvh",
            Self::Gltf => "gltf",
            Self::WebDataset => "webdataset",
            Self::LeRobot => "lerobot",
            Self::HumanMl3d272 => "humanml3d-272",
            Self::Babel272 => "babel-272",
            Self::MotionMillion => "motionmillion",
            Self::HyMotion => "hy-motion",
            Self::MotionFix => "motionfix",
        }
    }
}

/// Writes clips to a new folder in another layout.
///
/// # Errors
/// The dataset holds no motions, the folder exists and is not empty, the dataset cannot be read, or
/// writing fails; nothing is left behind then.
pub fn export(
    clips: &Clips,
    layout: Layout,
    out: &Path,
    progress: &dyn Progress,
) -> Result<Exported, Error> {
    let dataset = clips.dataset();
    if !dataset.manifest().tables.contains_key(MotionRow::TABLE) {
        return Err(Error::NoMotions {
            path: dataset.root().to_owned(),
        });
    }
    let folder = NewFolder::beside(out)?;
    let mut done = match Form::of(layout, clips)? {
        Form::Whole(write) => write(clips, folder.path(), progress)?,
        Form::ByClip(form) => {
            progress.begin("export", Some(clips.len()));
            let mut notes = Vec::new();
            for part in clips.parts(PART_CLIPS) {
                notes.extend(form.write(clips.read(&part)?, folder.path(), progress)?);
            }
            let written = form.finish(clips, &notes, folder.path())?;
            progress.finish(&format!("{written} clips"));
            Exported::of(written)
        }
    };
    done.complete(layout, clips)?;
    done.left_by_others = folder.left_by_others();
    folder.publish()?;
    Ok(done)
}

/// Writes a JSON document, indented and with a line end.
fn write_json(folder: &Path, name: &str, value: &impl Serialize) -> Result<(), Error> {
    let path = folder.join(name);
    let mut text = serde_json::to_vec_pretty(value)
        .map_err(|error| datasets_spec::Error::io("write", &path)(error.into()))?;
    text.push(b'\n');
    Ok(fs::write(&path, text).map_err(datasets_spec::Error::io("write", &path))?)
}
