//! Writers of the layouts.

use std::path::Path;

use datasets_spec::Progress;

use super::by_clip::ByClip;
use super::clips::{FileKind, Files};
use super::features::{self, FeatureFolder};
use super::humanml3d::HumanMl3dFolder;
use super::{Exported, Layout, lerobot, motionfix, stance, webdataset};
use crate::Error;
use crate::clips::Clips;

pub(super) enum Form {
    ByClip(Box<dyn ByClip>),
    /// Writes all clips together, because they depend on each other.
    Whole(fn(&Clips, &Path, &dyn Progress) -> Result<Exported, Error>),
}

impl Form {
    pub(super) fn of(layout: Layout, clips: &Clips) -> Result<Self, Error> {
        let dim_272 =
            |form: &'static features::Form| FeatureFolder::new(clips, form, &features::DIM_272);
        let by_clip: Box<dyn ByClip> = match layout {
            Layout::Amass => Box::new(Files::new(clips, FileKind::AMASS)?),
            Layout::Bvh => Box::new(Files::new(clips, FileKind::BVH)?),
            Layout::Gltf => Box::new(Files::new(clips, FileKind::GLTF)?),
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
