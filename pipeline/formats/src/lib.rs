//! Files of motions: readers, writers, retargeting and marker solving.
//!
//! [`source`] reads foreign formats, [`retarget`] poses them on the SMPL-X skeleton, and [`markers`] fits bodies to
//! captured markers. [`mod@write`] writes motions to some of these formats.
//!
//! Reading a file without a usable motion returns a [`Rejected`](clip::Rejected) with a code and a reason, and never
//! panics.

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
