//! Features of motions, each by a named and versioned recipe.

pub mod humanml3d;
mod smpl_body;
mod statistics;
mod to_motion;

pub use smpl_body::smpl_body;
pub use statistics::Statistics;
pub use to_motion::{motion_of_directions, motion_of_features, motion_of_joints};
