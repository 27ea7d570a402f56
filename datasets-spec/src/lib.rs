//! The contract between the stages of `stance`: motion types, skeleton, body parts, kinematics,
//! canonical segments, and the tables on disk.
//!
//! Everything is y up, in metres, radians and seconds; the character's left is +x at rest and it
//! faces +z. This crate knows no foreign file format, no network, no HTTP and no command line.
//!
//! Read [`Motion`] and [`dataset::Dataset`] first; the format document is the crate's `README.md`.

mod card;
mod croissant;
pub mod dataset;
mod error;
mod ids;
mod joint_set;
pub mod manifest;
mod progress;
pub mod quantile;
pub mod record;
pub mod store;
pub mod table;

pub use dataset::{Dataset, Transaction};
pub use error::Error;
pub use ids::{MotionId, Rng, Seed, Split};
pub use joint_set::{BlendMask, BodyPart, JointSet, MASK_DEF_VERSION};
pub use kinematics::{Fps, Joint, Keypoints, Motion, Pose, Resample, Skeleton};
pub use progress::{NoProgress, Progress};
