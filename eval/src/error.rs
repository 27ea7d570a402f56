//! Errors of the evaluation.

use std::path::PathBuf;

use datasets_spec::Code;

/// Error of a caller's encoder.
pub type EncoderError = Box<dyn std::error::Error + Send + Sync>;

/// An evaluation error; it names the system and the item concerned.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A table of edits cannot be opened, read or written.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// Items, edits, latents or a protocol with which nothing can be measured. The text states the reason, and what to
    /// do if something can be done.
    #[error("{0}")]
    Invalid(String),
    /// A table of edits cannot be used.
    #[error("in {}", .0.display())]
    TableOf(PathBuf, #[source] Box<Error>),
    /// The file of editing times beside a table of edits cannot be read.
    #[error("cannot read {}; it is written when `stance edit` edits a split", .0.display())]
    Times(PathBuf, #[source] std::io::Error),
    /// The item of this id cannot be used. The cause is boxed because it is larger than any other variant.
    #[error("item {0:?} cannot be used")]
    Item(String, #[source] Box<datasets_spec::Error>),
    /// The columns of a row, of this system and this item, do not form a motion. The cause is boxed as that of an item.
    #[error("system {0:?}, item {1:?}: not a motion")]
    Motion(String, String, #[source] Box<datasets_spec::Error>),
    /// The encoder failed on motions of this system.
    #[error("cannot encode the motions of system {0:?}")]
    Encoder(String, #[source] EncoderError),
    /// The file with the report of an encoder cannot be read.
    #[error(
        "cannot read {0}, the report of an encoder; remove it and run the same `stance train tmr` again"
    )]
    Report(PathBuf, #[source] std::io::Error),
    /// A score table cannot be written as JSON.
    #[error("cannot write the scores as JSON")]
    Json(#[from] serde_json::Error),
}

impl Error {
    /// The code of the error, if it has one, and the item concerned.
    pub fn code(&self) -> Option<Code> {
        match self {
            Self::Spec(error) => error.code(),
            _ => None,
        }
    }
}
