//! The compiled half of the Python package `stance`, and the command.
//!
//! It reads datasets and computes forward kinematics, features, MotionCutMix and scores. Tables of pyarrow, batches for
//! PyTorch and the documentation are plain Python in `python/stance`.
//!
//! Every function that takes more than a moment releases Python's lock, and ends on Ctrl-C.

mod command;
mod dataset;
mod error;
mod evaluate;
mod ingest;
mod metrics;
mod mix;
mod motion;
mod viewer;
mod work;

/// The module that `python/stance` imports from.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use super::command::main;
    #[pymodule_export]
    use super::dataset::{Dataset, Item};
    #[pymodule_export]
    use super::evaluate::{Encoder, evaluate};
    #[pymodule_export]
    use super::ingest::{corpus, ingest, masks};
    #[pymodule_export]
    use super::metrics::{
        diversity, fid, foot_score, foot_slide, jerk, multimodality, position_error, retrieval,
    };
    #[pymodule_export]
    use super::mix::{Mix, Triplet};
    #[pymodule_export]
    use super::motion::{Motion, blend};
    #[pymodule_export]
    use super::viewer::viewer_page;

    /// The version of the package.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
    /// Version of the table schemas that are read.
    #[pymodule_export]
    const SCHEMA_VERSION: &str = datasets_spec::table::SCHEMA_VERSION;
    /// Names of the SMPL-X joints.
    #[pymodule_export]
    const JOINT_NAMES: &[&str] = &kinematics::skeleton::JOINT_NAMES;
    /// Index of the joint of each keypoint.
    #[pymodule_export]
    const KEYPOINT_JOINTS: &[usize] = &kinematics::skeleton::KEYPOINT_JOINTS;
    /// Parent of each keypoint; -1 for the root.
    #[pymodule_export]
    const KEYPOINT_PARENTS: &[i8] = &kinematics::skeleton::KEYPOINT_PARENTS;
}
