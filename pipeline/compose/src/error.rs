//! Errors of composing edits and deriving masks.

use std::path::PathBuf;

use datasets_spec::{Code, MotionId, Split};
use work::Failed;

/// An error that names the row, motion or setting it happened to.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Rows, motions or settings cannot be used; the message states which and why.
    #[error("{0}")]
    Refused(String),
    /// A row is no valid mask or pair, or names something that does not exist.
    #[error("{table} {row:?} is not usable")]
    Row {
        /// What the row is: `mask` or `pair`.
        table: &'static str,
        /// Id of the row.
        row: String,
        /// What is wrong with it.
        source: Box<datasets_spec::Error>,
    },
    /// A motion row does not hold a motion.
    #[error("motion {motion} is not usable")]
    Motion {
        /// The motion.
        motion: MotionId,
        /// What is wrong with it.
        source: datasets_spec::Error,
    },
    /// A file of the dataset cannot be read.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// A recording cannot continue.
    #[error(transparent)]
    Work(#[from] work::Error),
    /// A condition on clips cannot be parsed, or selects none.
    #[error(transparent)]
    Tables(#[from] tables::Error),
    /// A file of frames changed after it was written.
    #[error("{} is damaged: {problem}; remove it, and it is made again", path.display())]
    Frames {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: &'static str,
    },
    /// The frames of motions cannot be written to the disk.
    #[error(
        "cannot write {:.1} GB of frames to {}; free as much, or name another folder in STANCE_CACHE",
        *bytes as f64 / 1e9,
        path.display()
    )]
    UnwrittenFrames {
        /// The file.
        path: PathBuf,
        /// Size of the file in bytes.
        bytes: u64,
        /// The cause.
        source: std::io::Error,
    },
    /// A setting is out of range.
    #[error("setting {key} must be {expected}, got {got}")]
    Config {
        /// Name of the setting.
        key: &'static str,
        /// The allowed values.
        expected: &'static str,
        /// The value found.
        got: f64,
    },
    /// No annotated motion is long enough.
    #[error(
        "split {split} has no annotated motion of {frames} frames or more, which a window takes; annotate longer motions"
    )]
    NoItem {
        /// The split.
        split: Split,
        /// Stored frames a window spans.
        frames: usize,
    },
}

impl Error {
    /// The code of the error, if it has one, and the item it happened to.
    pub fn code(&self) -> Option<Code> {
        let (code, path) = match self {
            Self::Spec(error) => return error.code(),
            Self::Row { source, .. } => return source.code(),
            Self::Work(error) => return error.code(),
            Self::Frames { path, .. } => ("E-CORRUPT", path),
            Self::UnwrittenFrames { path, .. } => ("E-IO", path),
            _ => return None,
        };
        Some((code, Some(path.display().to_string())))
    }
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self::of(error.code(), &error)
    }
}

impl From<Error> for work::Error {
    fn from(error: Error) -> Self {
        match error {
            Error::Work(error) => error,
            Error::Spec(error) => error.into(),
            error => Failed::from(error).into(),
        }
    }
}
