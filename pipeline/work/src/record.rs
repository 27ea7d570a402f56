//! Records of workers, and their use by the commit.

use std::collections::BTreeMap;
use std::error::Error as StdError;
use std::path::PathBuf;

use datasets_spec::dataset::Staging;
use datasets_spec::manifest::{Accounting, FileEntry};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::piece::Piece;
use crate::Error;

/// Outcome of a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// The piece was made.
    Done,
    /// The piece already existed, and nothing was done.
    DoneBefore,
    /// The piece could not be made.
    Failed,
}

/// The answer of a worker for one piece.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Id of the piece.
    pub piece: String,
    /// Number of the piece in the plan.
    pub number: u64,
    /// Name of the piece in the plan.
    pub name: String,
    /// Outcome of the piece.
    pub outcome: Outcome,
    /// Files of the piece; empty if it failed.
    pub files: Vec<FileEntry>,
    /// Code of the failure, such as `E-IO`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<String>,
    /// What failed and what to do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Seconds of work; 0 if nothing was done.
    pub secs: f64,
}

impl Record {
    /// Whether the piece exists.
    pub fn is_done(&self) -> bool {
        self.outcome != Outcome::Failed
    }

    pub(crate) fn done(piece: &Piece, files: Vec<FileEntry>, secs: f64) -> Self {
        Self {
            piece: piece.id.clone(),
            number: piece.number,
            name: piece.name.clone(),
            outcome: Outcome::Done,
            files,
            code: None,
            reason: None,
            secs,
        }
    }

    pub(crate) fn failed(piece: &Piece, failed: Failed, secs: f64) -> Self {
        Self {
            outcome: Outcome::Failed,
            code: Some(failed.code),
            reason: Some(failed.reason),
            ..Self::done(piece, Vec::new(), secs)
        }
    }
}

/// Why a piece could not be made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failed {
    /// Code that scripts may rely on.
    pub code: String,
    /// What failed, and what to do.
    pub reason: String,
}

impl Failed {
    /// A failure with a code.
    pub fn new(code: &str, reason: impl Into<String>) -> Self {
        Self {
            code: code.to_owned(),
            reason: reason.into(),
        }
    }

    /// Describes an error with its causes; the code is `E-FAILED` if the error has none.
    pub fn of(code: Option<datasets_spec::Code>, error: &dyn StdError) -> Self {
        let mut reason = error.to_string();
        let mut cause = error.source();
        while let Some(error) = cause {
            reason += &format!(": {error}");
            cause = error.source();
        }
        Self {
            code: code.map_or("E-FAILED", |(code, _)| code).to_owned(),
            reason,
        }
    }
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self::of(error.code(), &error)
    }
}

impl From<Failed> for Error {
    fn from(failed: Failed) -> Self {
        let Failed { code, reason } = failed;
        Self::Job { code, reason }
    }
}

impl From<datasets_spec::Error> for Failed {
    fn from(error: datasets_spec::Error) -> Self {
        Self::of(error.code(), &error)
    }
}

/// A staged piece: its record, and the job's notes for the commit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Stored {
    pub record: Record,
    pub notes: Value,
}

/// Records that a piece was made in this process.
pub fn keep(staging: &Staging, piece: &Piece, made: Made) -> Result<(), Error> {
    let stored = Stored {
        record: Record::done(piece, made.files, 0.0),
        notes: made.notes,
    };
    Ok(staging.put(&piece.id, &stored)?)
}

/// A staged piece; `None` if a file of it is missing or differs from its size or hash.
pub fn staged(staging: &Staging, piece: &str) -> Result<Option<Stored>, Error> {
    let Some(stored) = staging.get::<Stored>(piece) else {
        return Ok(None);
    };
    let is_whole = stored.record.piece == piece && staging.holds(stored.record.files.iter())?;
    Ok(is_whole.then_some(stored))
}

/// Result of a job for a piece.
#[derive(Clone, Debug, PartialEq)]
pub struct Made {
    /// The files.
    pub files: Vec<FileEntry>,
    /// Notes of the piece for the job's commit.
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
    /// The result, or the failure.
    pub made: Result<Made, Failed>,
}

/// Options of a commit.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CommitOptions {
    /// Quarantine the items of failed pieces; otherwise failed pieces stop the commit.
    pub quarantine_failed: bool,
    /// Names this run to another one that finds the destination locked.
    pub holder: String,
}

/// Result of a commit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Committed {
    /// The destination.
    pub destination: PathBuf,
    /// Whether the plan was committed before, so that this commit changed nothing.
    pub already_committed: bool,
    /// Pieces of the plan.
    pub pieces: u64,
    /// Pieces that failed and were put into quarantine.
    pub failed: u64,
    /// Rows of each table.
    pub tables: BTreeMap<String, u64>,
    /// Counts of the sources, if the job has any.
    pub accounting: Option<Accounting>,
    /// Hash over all files.
    pub root_hash: String,
    /// Notes of the job on the result.
    #[serde(default, skip_serializing_if = "Value::is_null")]
    pub notes: Value,
}

/// Name of the record of a failure.
pub(super) fn failed_name(piece: &str) -> String {
    format!("{piece}.failed")
}
