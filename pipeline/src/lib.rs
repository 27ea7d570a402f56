//! Raw files to motions to triplets.
//!
//! [`source`] reads foreign formats and [`retarget`] poses them on the SMPL-X skeleton; [`ingest`]
//! turns folders into a committed dataset; [`annotation`] marks what each clip is about; [`compose`]
//! is MotionCutMix; [`export`] writes other layouts.
//!
//! A bad file is a row of the `quarantine` table, never an error of the run. Read [`ingest::ingest`]
//! and [`compose::Stream`] first.
//!
//! ```
//! use corpus::{CorpusOptions, write_corpus};
//! use datasets_spec::NoProgress;
//! use pipeline::ingest::{IngestOptions, ingest};
//!
//! # let folder = tempfile::tempdir()?;
//! let (sources, out) = (folder.path().join("sources"), folder.path().join("dataset"));
//! let options = CorpusOptions { clips: 4, ..CorpusOptions::default() };
//! write_corpus(&sources, &options, &NoProgress)?;
//! let report = ingest(&[sources], &out, &IngestOptions::default(), "example", &NoProgress)?;
//! assert_eq!(report.accounting.ingested, 4);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod annotation;
pub mod answers;
pub mod catalogue;
pub mod check;
pub mod clip;
mod clip_table;
pub mod clips;
pub mod compose;
mod counts;
mod csv_lines;
pub mod doctor;
mod error;
pub mod export;
pub mod feature;

#[cfg(test)]
mod fixture;
pub mod floor;
mod foreign_table;
#[cfg(test)]
mod golden;
pub mod ingest;
mod jobs;
pub mod likeness;
pub mod markers;
pub mod merge;
pub mod open;
pub mod recording;
mod recordings;
pub mod reference;
pub mod retarget;
pub mod sidecar;
pub mod source;
pub mod stage;
pub mod stats;
pub mod verify;
pub mod versions;
pub mod work;
pub mod write;

pub use error::Error;
