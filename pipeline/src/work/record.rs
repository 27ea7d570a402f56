//! Answers of workers.

use std::error::Error as StdError;

use datasets_spec::dataset::Staging;
use datasets_spec::manifest::FileEntry;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::job::Made;
use super::plan::Piece;
use crate::Error;

/// What became of a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// It was made.
    Done,
    /// It was there already and nothing was done.
    DoneBefore,
    /// It could not be made.
    Failed,
}

/// The answer of a worker for one piece.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Id of the piece.
    pub piece: String,
    /// Its number in the plan.
    pub number: u64,
    /// What it is called in the plan.
    pub name: String,
    /// What became of it.
    pub outcome: Outcome,
    /// The files it consists of; none where it failed.
    pub files: Vec<FileEntry>,
    /// Code of the failure, such as `E-IO`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<String>,
    /// What failed and what to do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Seconds of work; 0 where nothing was done.
    pub secs: f64,
}

impl Record {
    /// Whether the piece is there.
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

    /// The failure of an error with its causes; `E-FAILED` where it has no code of its own.
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

impl From<datasets_spec::Error> for Failed {
    fn from(error: datasets_spec::Error) -> Self {
        Self::of(error.code(), &error)
    }
}

/// A piece that is staged: its record, and what its job notes for the commit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Stored {
    pub(crate) record: Record,
    pub(crate) notes: Value,
}

/// Records that a piece was made in this process.
pub(crate) fn keep(staging: &Staging, piece: &Piece, made: Made) -> Result<(), Error> {
    let stored = Stored {
        record: Record::done(piece, made.files, 0.0),
        notes: made.notes,
    };
    Ok(staging.put(&piece.id, &stored)?)
}

/// A piece that is staged, if its files are whole. The files are hashed; nothing else is read.
pub(crate) fn staged(staging: &Staging, piece: &str) -> Result<Option<Stored>, Error> {
    let Some(stored) = staging.get::<Stored>(piece) else {
        return Ok(None);
    };
    let is_whole = stored.record.piece == piece && staging.holds(stored.record.files.iter())?;
    Ok(is_whole.then_some(stored))
}
