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
    #[error("in {}", path.display())]
    TableOf {
        /// The table.
        path: PathBuf,
        /// The cause.
        source: Box<Error>,
    },
    /// The points of a figure cannot be made.
    #[error("figure {figure:?}: {problem}")]
    Figure {
        /// Name of the figure.
        figure: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The editing times beside a table of edits cannot be read.
    #[error(
        "cannot read {}; it is written when `stance edit` edits a split",
        path.display()
    )]
    Times {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// An item cannot be used.
    #[error("item {id:?} cannot be used")]
    Item {
        /// The item.
        id: String,
        /// The cause, boxed because it is larger than any other variant.
        source: Box<datasets_spec::Error>,
    },
    /// The columns of a row do not form a motion.
    #[error("system {system:?}, item {id:?}: not a motion")]
    Motion {
        /// The system.
        system: String,
        /// The item.
        id: String,
        /// The cause, boxed because it is larger than any other variant.
        source: Box<datasets_spec::Error>,
    },
    /// The encoder failed.
    #[error("cannot encode the motions of system {system:?}")]
    Encoder {
        /// The system.
        system: String,
        /// The cause.
        source: EncoderError,
    },
    /// The report of an encoder cannot be read.
    #[error(
        "cannot read {path}, the report of an encoder; remove it and run the same `stance train tmr` again"
    )]
    Report {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
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
