//! How each layout is written.

use std::path::Path;

use datasets_spec::record::MotionRow;
use datasets_spec::{Progress, Split};
use rayon::prelude::*;

use super::clips::Files;
use super::features::{self, FeatureFolder};
use super::humanml3d::HumanMl3dFolder;
use super::{Exported, Layout, lerobot, motionfix, stance, webdataset};
use crate::Error;
use crate::clips::Clips;

/// Clips that are read and written together.
pub(super) const PART_CLIPS: usize = 256;

/// Why a clip was left out, if it was.
pub(super) type Note = Option<String>;

/// A layout whose clips have files of their own, which can be written apart from each other.
pub(super) trait ByClip: Send + Sync {
    /// Writes the files of a clip, and returns why it was left out, if it was.
    fn write_clip(&self, row: MotionRow, folder: &Path) -> Result<Note, Error>;

    /// Writes what depends on all clips, whose files are in the folder. The notes are in the order of the clips.
    /// Returns the number of clips that were not left out.
    fn finish(&self, clips: &Clips, notes: &[Note], folder: &Path) -> Result<u64, Error>;
}

impl dyn ByClip {
    /// Writes the files of some clips, and returns a note for each.
    pub(super) fn write(
        &self,
        rows: Vec<MotionRow>,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<Vec<Note>, Error> {
        let written = rows.into_par_iter().map(|row| {
            let note = self.write_clip(row, folder)?;
            progress.advance(1);
            Ok(note)
        });
        written.collect()
    }
}

pub(super) enum Form {
    ByClip(Box<dyn ByClip>),
    /// In one go, because they depend on each other.
    Whole(fn(&Clips, &Path, &dyn Progress) -> Result<Exported, Error>),
}

impl Form {
    pub(super) fn of(layout: Layout, clips: &Clips) -> Result<Self, Error> {
        let dim_272 =
            |form: &'static features::Form| FeatureFolder::new(clips, form, &features::DIM_272);
        let by_clip: Box<dyn ByClip> = match layout {
            Layout::Amass => Box::new(Files::amass(clips)?),
            Layout::Bvh => Box::new(Files::bvh(clips)?),
            Layout::Gltf => Box::new(Files::gltf(clips)?),
            Layout::HumanMl3d => Box::new(HumanMl3dFolder::new(clips)?),
            Layout::HumanMl3d272 => Box::new(dim_272(&features::HUMANML3D_272)?),
            Layout::Babel272 => Box::new(dim_272(&features::BABEL_272)?),
            Layout::MotionMillion => Box::new(dim_272(&features::MOTIONMILLION)?),
            Layout::HyMotion => {
                let (form, recipe) = (&features::HY_MOTION, &features::DIM_201);
                Box::new(FeatureFolder::new(clips, form, recipe)?)
            }
            Layout::WebDataset => return Ok(Self::Whole(webdataset::write)),
            Layout::LeRobot => return Ok(Self::Whole(lerobot::write)),
            Layout::Stance => return Ok(Self::Whole(stance::write)),
            Layout::MotionFix => return Ok(Self::Whole(motionfix::write)),
        };
        Ok(Self::ByClip(by_clip))
    }
}

/// Id, split and licence of the clips, whose licence is empty where none is known.
pub(super) fn labels(clips: &Clips) -> Result<Vec<(String, Split, String)>, Error> {
    let mut labels = Vec::new();
    for shard in clips.shards(None) {
        let ids = shard.column::<String>("id")?.into_iter();
        let splits = shard.column::<Split>("split")?;
        let licenses = shard.column::<Option<String>>("license")?;
        let of_shard = ids.zip(splits).zip(licenses);
        labels.extend(
            of_shard.map(|((id, split), license)| (id, split, license.unwrap_or_default())),
        );
    }
    Ok(labels)
}

/// Names in order, one a line.
pub(super) fn sorted_lines(mut names: Vec<&str>) -> String {
    names.sort_unstable();
    names.iter().flat_map(|name| [*name, "\n"]).collect()
}
