//! The layouts to export to.

datasets_spec::named! {
    /// A layout to export to.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Layout, named by as_str {
        /// AMASS npz files with the keys of the SMPL-X releases.
        Amass = "amass",
        /// A HumanML3D folder.
        HumanMl3d = "humanml3d",
        /// The layout of the STANCE release.
        Stance = "stance",
        /// A BVH file for each clip.
        Bvh = "bvh",
        /// A GLB file for each clip: an animated skeleton in a simple body.
        Gltf = "gltf",
        /// Tar shards of npy and json members.
        WebDataset = "webdataset",
        /// LeRobot v3: one row per frame.
        LeRobot = "lerobot",
        /// A folder of 272 features as HumanML3D-272.
        HumanMl3d272 = "humanml3d-272",
        /// A folder of 272 features as BABEL-272.
        Babel272 = "babel-272",
        /// A folder of 272 features as MotionMillion.
        MotionMillion = "motionmillion",
        /// A folder of the 201 features of HY-Motion.
        HyMotion = "hy-motion",
        /// Dumps of MotionFix: the pairs of the dataset.
        MotionFix = "motionfix",
    }
}
