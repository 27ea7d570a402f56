//! Raw files to motions to triplets.
//!
//! [`source`] reads foreign formats and [`retarget`] poses them on the SMPL-X skeleton; [`ingest`]
//! turns folders into a committed dataset; [`annotation`] marks what each clip is about; [`compose`]
//! is MotionCutMix; [`export`] writes other layouts.
//!
//! A bad file is a row of the `quarantine` table, never an error of the run. Read [`ingest::ingest`]
//! and [`compose::Stream`] first.

pub mod annotation;
pub mod answers;
pub mod catalogue;
pub mod check;
pub mod clip;
pub mod compose;
pub mod doctor;
mod error;
pub mod export;
pub mod feature;
#[cfg(test)]
mod fixture;
pub mod floor;
#[cfg(test)]
mod golden;
pub mod ingest;
pub mod markers;
pub mod open;
pub mod reference;
pub mod retarget;
pub mod sidecar;
pub mod source;
pub mod stage;
pub mod stats;
pub mod verify;
pub mod write;

pub use error::Error;
