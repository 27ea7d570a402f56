//! The contract between the stages of `stance`: ids, splits, body parts, and the tables on disk.
//!
//! Everything is y up, in metres, radians and seconds; the character's left is +x at rest and it faces +z. Motions,
//! skeletons and their computations are in the crate `kinematics`. This crate knows no foreign file format, no network,
//! no HTTP and no command line.
//!
//! Read [`record::MotionRow`] and [`Dataset`] first; `README.md` describes the format, and `docs/tables.md` every column.
//!
//! ```
//! use datasets_spec::dataset::commit_rows;
//! use datasets_spec::record::QuarantineRow;
//! use datasets_spec::{Dataset, Skeleton};
//!
//! # let folder = tempfile::tempdir()?;
//! let row = QuarantineRow {
//!     path: "walk.bvh".to_owned(),
//!     source_name: String::new(),
//!     source_hash: String::new(),
//!     inputs_hash: String::new(),
//!     code: "E-BVH-FRAMES".to_owned(),
//!     reason: "found 3 rows of motion, expected 4".to_owned(),
//!     byte_offset: Some(812),
//!     stage: "read".to_owned(),
//! };
//! let rows = [row];
//! commit_rows(folder.path(), &rows, None, &Skeleton::smplx_neutral(), "plan", "example")?;
//! let dataset = Dataset::open(folder.path())?;
//! assert_eq!(dataset.read::<QuarantineRow>(None)?, rows);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod cache;
mod card;
mod croissant;
pub mod dataset;
mod digest;
mod error;
pub mod flags;
mod ids;
mod joint_set;
pub mod license;
pub mod manifest;
mod progress;
pub mod quantile;
pub mod record;
pub mod rejected;
pub mod sides;
pub mod store;
pub mod table;

pub use dataset::{Dataset, Transaction};
pub use digest::Digest;
pub use error::{Code, Error};
pub use ids::{MotionId, Rng, Seed, Split};
pub use joint_set::{BlendMask, BodyPart, JointSet, MASK_DEF_VERSION};
pub use kinematics::{Fps, Joint, Keypoints, Motion, Pose, Resample, Skeleton, named};
pub use progress::{NoProgress, Progress};
