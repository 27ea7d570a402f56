//! Files of motions: readers, writers, retargeting and marker solving.
//!
//! [`source`] reads foreign formats, [`retarget`] poses them on the SMPL-X skeleton, and [`markers`] fits
//! bodies to captured markers. [`mod@write`] is the inverse of the readers.
//!
//! A file that gives no motion is a [`Rejected`](clip::Rejected) with a code and a reason, never a panic.

pub mod csv_lines;
mod error;
pub mod foreign_table;
#[cfg(test)]
mod golden;
pub mod markers;
pub mod retarget;
pub mod sidecar;
pub mod source;
pub mod write;

pub use error::Error;
