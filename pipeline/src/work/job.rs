//! Jobs that are planned, and how they are found by name.

use std::collections::BTreeMap;

use datasets_spec::Progress;
use datasets_spec::dataset::Staging;
use datasets_spec::manifest::FileEntry;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::commit::{CommitOptions, Committed};
use super::plan::{Piece, Plan};
use super::record::Failed;
use crate::{Error, ingest, recording};

/// A job whose plan was made: what all its pieces share.
pub trait Job: Send + Sync {
    /// Makes a piece: stages its files. Equal pieces give equal files.
    ///
    /// # Errors
    /// The piece cannot be made.
    fn make(&self, piece: &Piece, staging: &Staging) -> Result<Made, Failed>;

    /// Makes up to `count` items of a piece without writing anything, and returns how many it made.
    ///
    /// # Errors
    /// They cannot be made.
    fn sample(&self, piece: &Piece, count: u64) -> Result<u64, Failed>;

    /// Makes the pieces a part of the destination. Pieces that failed are given only with
    /// [`CommitOptions::quarantine_failed`].
    ///
    /// # Errors
    /// The destination is locked, changed meanwhile, or cannot be written. It is as it was then.
    fn commit(
        &self,
        plan: &Plan,
        pieces: Vec<Finished>,
        options: &CommitOptions,
        progress: &dyn Progress,
    ) -> Result<Committed, Error>;
}

/// What [`Job::make`] made.
#[derive(Clone, Debug, PartialEq)]
pub struct Made {
    /// The files.
    pub files: Vec<FileEntry>,
    /// What the job needs to know of the piece when it commits.
    pub notes: Value,
}

impl Made {
    /// Files and notes.
    ///
    /// # Panics
    /// If the notes cannot be written as JSON, which is a bug in the job.
    pub fn new(files: Vec<FileEntry>, notes: &impl Serialize) -> Self {
        Self {
            files,
            notes: serde_json::to_value(notes).expect("notes are numbers and texts"),
        }
    }
}

/// A piece at the time of the commit.
#[derive(Clone, Debug, PartialEq)]
pub struct Finished {
    /// The piece.
    pub piece: Piece,
    /// What was made, or why it failed.
    pub made: Result<Made, Failed>,
}

/// What a piece notes for the commit.
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

impl Default for Jobs {
    /// The jobs of this crate.
    fn default() -> Self {
        Self(BTreeMap::new())
            .with(ingest::JOB, Box::new(ingest::open_job))
            .with(recording::JOB, Box::new(recording::open_job))
    }
}

impl Jobs {
    /// Adds a job.
    #[must_use]
    pub fn with(mut self, name: &'static str, open: Open) -> Self {
        self.0.insert(name, open);
        self
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
