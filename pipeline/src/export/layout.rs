//! The layouts to export to, and warnings before an export.

use super::left_out::said;
use super::paths::is_shortened;
use crate::Error;
use crate::clips::Clips;

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

/// Warnings before the clips are written in a layout: its loaders would find no texts, or names are shortened. Only
/// columns of labels are read.
///
/// # Errors
/// The dataset cannot be read.
pub fn before(layout: Layout, clips: &Clips) -> Result<Vec<String>, Error> {
    let mut remarks = Vec::new();
    if layout == Layout::HumanMl3d
        && !clips
            .shards(None)
            .flat_map(said)
            .any(|(_, is_made)| !is_made)
    {
        remarks.push(format!(
            "none of the {} clips has a caption of its source, so texts/ stays empty and the loaders of this layout \
             find no clip; add captions first (captions.csv beside the sources and `stance ingest` again, or `stance \
             annotate`)",
            clips.len()
        ));
    }
    if names_are_ids(layout) {
        let mut shortened = Vec::new();
        for shard in clips.shards(None) {
            let ids = shard.column::<String>("id")?.into_iter();
            shortened.extend(ids.filter(|id| is_shortened(id)));
        }
        if let Some(first) = shortened.first() {
            remarks.push(format!(
                "{} names are too long for file systems and are shortened, with a hash behind them (such as that of \
                 {first})",
                shortened.len()
            ));
        }
    }
    Ok(remarks)
}

/// Whether files are named by the ids of clips. Other layouts number their files, or pack clips together.
fn names_are_ids(layout: Layout) -> bool {
    matches!(
        layout,
        Layout::Amass | Layout::Bvh | Layout::Gltf | Layout::MotionMillion
    )
}
