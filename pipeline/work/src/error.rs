//! Errors of jobs that are done in pieces.

use std::path::PathBuf;

use datasets_spec::Code;

/// An error that ends a job or a part of it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A folder that a run would make already exists and is not empty.
    #[error("{} exists and is not empty; name a new folder", path.display())]
    Occupied {
        /// The folder.
        path: PathBuf,
    },
    /// A folder holds items or edits that others would replace, or other tables.
    #[error(
        "{} holds {held}, which {made} must not replace; name another folder, or delete this one",
        path.display()
    )]
    Held {
        /// The folder.
        path: PathBuf,
        /// What it holds.
        held: String,
        /// What would be written.
        made: String,
    },
    /// A folder is not a plan that this program can use.
    #[error("{} is no usable plan: {reason}", path.display())]
    BadPlan {
        /// The folder.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// The destination of a plan changed since it was made.
    #[error(
        "{} has version {now} now and the plan {} starts from version {base}; plan again",
        destination.display(),
        path.display()
    )]
    StalePlan {
        /// The plan.
        path: PathBuf,
        /// The destination.
        destination: PathBuf,
        /// Version that the plan starts from; 0 for none.
        base: u64,
        /// Present version of the destination; 0 for none.
        now: u64,
    },
    /// A file changed since a plan was made.
    #[error("{} changed since it was planned; plan again", path.display())]
    SourceChanged {
        /// The file or folder.
        path: PathBuf,
    },
    /// Pieces of a plan are missing.
    #[error(
        "{missing} of {of} pieces are missing; make them: stance stage work {} (`stance stage status` lists them)",
        path.display()
    )]
    PiecesMissing {
        /// The plan.
        path: PathBuf,
        /// Pieces that are missing.
        missing: usize,
        /// Pieces of the plan.
        of: usize,
    },
    /// Pieces of a plan failed.
    #[error(
        "{failed} of {of} pieces failed: {shown}. Try them again: stance stage work {}; or commit without them: \
         stance stage commit {} --quarantine-failed",
        path.display(),
        path.display()
    )]
    PiecesFailed {
        /// The plan.
        path: PathBuf,
        /// Pieces that failed.
        failed: usize,
        /// Pieces of the plan.
        of: usize,
        /// The first failed pieces, with code and reason.
        shown: String,
    },
    /// The job of a plan cannot continue.
    #[error("{reason} ({code})")]
    Job {
        /// Code of the failure.
        code: String,
        /// What failed, and what to do.
        reason: String,
    },
    /// The dataset, or another file or folder, could not be read or written.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
}

impl Error {
    /// The code of the error, if it has one, and the item it happened to. [`Error::Job`] has its code only in the text.
    pub fn code(&self) -> Option<Code> {
        let (code, path) = match self {
            Self::Spec(error) => return error.code(),
            Self::Occupied { path } | Self::Held { path, .. } => ("E-OCCUPIED", path),
            Self::BadPlan { path, .. } => ("E-PLAN", path),
            Self::SourceChanged { path } => ("E-SOURCE-CHANGED", path),
            Self::StalePlan { path, .. } => ("E-PLAN-STALE", path),
            Self::PiecesMissing { path, .. } => ("E-PIECES-MISSING", path),
            Self::PiecesFailed { path, .. } => ("E-PIECES-FAILED", path),
            Self::Job { .. } => return None,
        };
        Some((code, Some(path.display().to_string())))
    }

    /// Wraps an I/O error with what was tried on which path.
    pub(crate) fn io(
        action: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(std::io::Error) -> Self {
        let failed = datasets_spec::Error::io(action, path);
        move |source| Self::Spec(failed(source))
    }
}
