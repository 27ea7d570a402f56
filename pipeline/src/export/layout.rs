//! The layouts to export to.

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
