//! Metrics, protocols, tables and reports.
//!
//! This crate measures edited motions: it reads the `edits` table, asks the caller's
//! [`evaluators::MotionEncoder`] for latents, and returns rows of the `scores` table, which it lays out
//! as text, Markdown, LaTeX, CSV or JSON and draws into one self-contained HTML report. It never
//! sees a model, so every system is scored by the same path. [`answers`] reads tables of edits and
//! commits scores; [`sweep`] plans ablations.
//!
//! Start at [`score::score`] and [`protocol::Protocol`].

pub mod answers;
pub mod compare;
pub mod draw;
mod error;
pub mod evaluators;
pub mod format;
pub mod linalg;
pub mod metric;
pub mod names;
pub mod protocol;
pub mod published;
pub mod report;
pub mod score;
pub mod sweep;
pub mod table;
pub mod times;

#[cfg(test)]
mod golden;

pub use error::{EncoderError, Error};
