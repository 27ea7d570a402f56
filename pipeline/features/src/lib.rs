//! Features of motions, each by a named and versioned recipe.

pub mod floor;
#[cfg(test)]
mod golden;
pub mod humanml3d;
pub mod hy_motion;
pub mod representation_272;
mod smpl_body;
mod statistics;
mod to_motion;

use datasets_spec::Fps;

pub use smpl_body::smpl_body;
pub use statistics::Statistics;
pub use to_motion::{motion_of_features, motion_of_joints};

/// The rate of the 272-d and 201-d features, of MotionFix and of Motion-X: 30 fps.
pub fn released_fps() -> Fps {
    Fps::new(30.0).expect("a positive number is a rate")
}
