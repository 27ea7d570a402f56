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
mod lerobot;
mod motionfix;
mod paths;
mod stance;
mod webdataset;

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::Progress;
use datasets_spec::record::{CAPTION_BY_RULE, MotionRow};
use datasets_spec::table::Row;
use serde::Serialize;

use crate::Error;
use crate::filter::Clips;
use crate::write::{self, is_occupied};

use self::by_clip::PART_CLIPS;
use self::form::Form;
pub use before::before;
pub use edits::{Sides, export_edits};
pub use items::export_items;
pub(crate) use items::item_stem;
pub use job::plan_export;
pub(crate) use job::{JOB, open_job};
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

/// Result of an export.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Exported {
    /// Clips in it.
    pub clips: u64,
    /// Captions made from file names that were left out, because the layout cannot mark them.
    pub made_captions_left_out: u64,
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
    let folder = Staging::beside(out)?;
    let num_clips = match Form::of(layout, clips)? {
        Form::Whole(write) => write(clips, &folder.path, progress)?,
        Form::ByClip(form) => {
            progress.begin("export", Some(clips.len()));
            let mut notes = Vec::new();
            for part in clips.parts(PART_CLIPS) {
                notes.extend(form.write(clips.read(&part)?, &folder.path, progress)?);
            }
            let written = form.finish(clips, &notes, &folder.path)?;
            progress.finish(&format!("{written} clips"));
            written
        }
    };
    folder.publish(out)?;
    Ok(Exported {
        clips: num_clips,
        made_captions_left_out: made_captions_left_out(layout, clips)?,
    })
}

/// Captions made from file names that a layout leaves out.
fn made_captions_left_out(layout: Layout, clips: &Clips) -> Result<u64, Error> {
    let marks_captions = match layout {
        Layout::Amass | Layout::Bvh | Layout::Gltf | Layout::WebDataset | Layout::Stance => true,
        // Its texts are instructions.
        Layout::MotionFix => true,
        Layout::HumanMl3d
        | Layout::LeRobot
        | Layout::HumanMl3d272
        | Layout::Babel272
        | Layout::MotionMillion
        | Layout::HyMotion => false,
    };
    match marks_captions {
        true => Ok(0),
        false => made_captions(clips),
    }
}

/// Captions made from file names. Only the column of their origins is read.
fn made_captions(clips: &Clips) -> Result<u64, Error> {
    let mut count = 0;
    for shard in clips.shards(None) {
        // Tables older than 1.5.0 have no such column.
        let origins = shard.column::<Vec<String>>("caption_origins");
        let origins = origins.unwrap_or_default().into_iter().flatten();
        count += origins.filter(|origin| origin == CAPTION_BY_RULE).count() as u64;
    }
    Ok(count)
}

/// A temporary folder that is removed unless it is published.
struct Staging {
    path: PathBuf,
    published: bool,
}

impl Staging {
    fn beside(out: &Path) -> Result<Self, Error> {
        if is_occupied(out) {
            return Err(Error::Occupied {
                path: out.to_owned(),
            });
        }
        let mut name = OsString::from(".");
        name.push(out.file_name().unwrap_or("export".as_ref()));
        name.push(format!(".{}.partial", std::process::id()));
        let path = out.with_file_name(name);
        fs::create_dir_all(&path).map_err(Error::io("create folder", &path))?;
        Ok(Self {
            path,
            published: false,
        })
    }

    /// Writes a JSON document, indented and with a line end.
    fn write_json(&self, name: &str, value: &impl Serialize) -> Result<(), Error> {
        let path = self.path.join(name);
        let mut text = serde_json::to_vec_pretty(value).map_err(|source| {
            Error::from(datasets_spec::Error::Json {
                path: path.clone(),
                source,
            })
        })?;
        text.push(b'\n');
        fs::write(&path, text).map_err(Error::io("write", &path))
    }

    fn publish(mut self, out: &Path) -> Result<(), Error> {
        write::publish(&self.path, out)?;
        self.published = true;
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.published {
            // A failure to remove the folder cannot be reported from here; the error that led here
            // is reported.
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}
