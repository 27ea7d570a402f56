//! From raw motion files to a dataset of motions and triplets.
//!
//! [`ingest`] turns folders into a committed dataset, with the readers of [`formats`]; [`annotation`] marks what each
//! clip is about; [`compose`] is MotionCutMix; [`export`] writes other layouts.
//!
//! A bad file becomes a row of the `quarantine` table, never an error of the run. Read [`ingest::ingest`] and
//! [`compose::Stream`] first.
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
mod clip_table;
pub mod clips;
mod counts;
pub mod doctor;
mod error;
pub mod export;
mod facts;
pub mod ingest;
pub mod jobs;
pub mod likeness;
pub mod merge;
mod names;
pub mod open;
mod recordings;
pub mod reference;
pub mod stage;
pub mod stats;
pub mod verify;
pub mod versions;

pub use error::Error;
