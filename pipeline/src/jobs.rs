//! The jobs of this crate that are done in pieces.

use crate::work::Jobs;
use crate::{export, ingest, recording};

impl Default for Jobs {
    /// The jobs of this crate.
    fn default() -> Self {
        Self::none()
            .with(ingest::JOB, Box::new(ingest::open_job))
            .with(recording::JOB, Box::new(recording::open_job))
            .with(export::JOB, Box::new(export::open_job))
    }
}
