//! A body in motion: the skeleton, motions as SMPL-X parameters, rotations, forward kinematics,
//! resampling, canonical segments, fitting a body to keypoints, and the normaliser.
//!
//! Everything is y up, in metres, radians and seconds; the character's left is +x at rest and it
//! faces +z. This crate reads and writes no file.
//!
//! Read [`Motion`] and [`Skeleton`] first.
//!
//! ```
//! use kinematics::{Fps, Motion, Pose, Resample, Skeleton};
//!
//! let motion = Motion::from_poses(Fps::new(60.0)?, &[Pose::REST; 61])?;
//! let stored = Resample::Exact.apply(&motion, Fps::STORE)?;
//! let keypoints = Skeleton::smplx_neutral().motion_keypoints(&stored);
//! assert_eq!(keypoints.points.len(), 21);
//! # Ok::<(), kinematics::Error>(())
//! ```

pub mod canonical;
mod error;
pub mod fit;
mod forward;
pub mod motion;
mod names;
pub mod normalise;
mod pose;
pub mod resample;
pub mod rotation;
pub mod simd;
pub mod skeleton;
mod units;

pub use error::Error;
pub use forward::{FrameParts, FrameSink};
pub use motion::{Keypoints, Motion, MotionBuilder};
pub use pose::{KeypointFrame, Pose};
pub use resample::Resample;
pub use skeleton::{Joint, Skeleton};
pub use units::Fps;
