//! Metrics, protocols, tables and reports.
//!
//! This crate measures edited motions: it reads the `edits` table, asks the caller's
//! [`score::MotionEncoder`] for latents, and returns rows of the `scores` table, which it lays out
//! as text, Markdown, LaTeX, CSV or JSON and draws into one self-contained HTML report. It never
//! sees a model, so every system is scored by the same path, and it never writes a file: what it
//! makes is returned.
//!
//! Start at [`score::score`] and [`protocol::Protocol`].

mod bootstrap;
pub mod compare;
pub mod draw;
mod error;
pub mod format;
pub mod linalg;
pub mod metric;
pub mod protocol;
pub mod published;
pub mod report;
mod scatter;
pub mod score;
pub mod similarity;
pub mod table;
pub mod times;
mod viewer;

#[cfg(test)]
mod golden;

pub use error::{EncoderError, Error};
