//! TMED: a diffusion model of whole motions, conditioned on the source motion and an instruction.
//!
//! # Source
//! Athanasiou et al. 2024 (MotionFix). [`TmedConfig::preset`] lists the differences from the released code.

mod clips;
mod config;
mod edit;
mod exchange;
pub mod features;
mod guidance;
mod objective;
mod stage;
mod task;

pub use self::clips::{CapturedPairs, ClipBatch, ClipEdit, ClipSource};
pub use self::config::{
    ClipData, EditStart, NoSource, StatisticsSplits, TargetPlaces, TmedConfig, TmedDiffusion,
};
pub use self::exchange::{import_tmed, read_released_statistics};
pub use self::guidance::{Branch, branches, guided};
pub use self::objective::{group_loss, loss};
pub(crate) use self::stage::MODEL;
pub use self::task::{TmedCorpus, train_tmed};
