//! Planned jobs, and their lookup by name.

use std::collections::BTreeMap;

use datasets_spec::Progress;
use datasets_spec::dataset::Staging;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::piece::Piece;
use super::plan::Plan;
use super::record::{CommitOptions, Committed, Failed, Finished, Made};
use crate::Error;

/// A planned job, with the data that all its pieces share.
pub trait Job: Send + Sync {
    /// Makes a piece: stages its files. Equal pieces give equal files.
    ///
    /// # Errors
    /// The piece cannot be made.
    fn make(&self, piece: &Piece, staging: &Staging) -> Result<Made, Failed>;

    /// Makes up to `count` items of a piece without writing anything, and returns how many it made.
    ///
    /// # Errors
    /// The items cannot be made.
    fn sample(&self, piece: &Piece, count: u64) -> Result<u64, Failed>;

    /// Makes the pieces a part of the destination. Pieces that failed are given only with
    /// [`CommitOptions::quarantine_failed`].
    ///
    /// # Errors
    /// The destination is locked, changed meanwhile, or cannot be written. It then stays unchanged.
    fn commit(
        &self,
        plan: &Plan,
        pieces: Vec<Finished>,
        options: &CommitOptions,
        progress: &dyn Progress,
    ) -> Result<Committed, Error>;
}

/// Parses the notes that a job left with a piece for its commit.
///
/// # Errors
/// The notes are those of another job.
pub fn notes<T: DeserializeOwned>(plan: &Plan, piece: &Piece, notes: Value) -> Result<T, Error> {
    serde_json::from_value(notes).map_err(|error| Error::BadPlan {
        path: plan.path().to_owned(),
        reason: format!("piece {} has unknown notes: {error}", piece.name),
    })
}

/// Opens the job of a plan.
pub type Open = Box<dyn Fn(&Plan) -> Result<Box<dyn Job>, Failed> + Send + Sync>;

/// The jobs that a program knows.
pub struct Jobs(BTreeMap<&'static str, Open>);

impl Jobs {
    /// Knows no job.
    pub fn none() -> Self {
        Self(BTreeMap::new())
    }

    /// Adds a job.
    #[must_use]
    pub fn with(mut self, name: &'static str, open: Open) -> Self {
        self.0.insert(name, open);
        self
    }

    /// Whether the job of a plan is known here.
    pub fn know(&self, plan: &Plan) -> bool {
        self.0.contains_key(plan.job())
    }

    /// Opens the job of a plan.
    ///
    /// # Errors
    /// The job is not known here, or cannot be opened.
    pub fn open(&self, plan: &Plan) -> Result<Box<dyn Job>, Failed> {
        match self.0.get(plan.job()) {
            Some(open) => open(plan),
            None => Err(Failed::new(
                "E-PLAN",
                format!(
                    "this program knows no job {:?}; make the piece with `stance stage work`",
                    plan.job()
                ),
            )),
        }
    }
}
