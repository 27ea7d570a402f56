//! Errors of the pipeline.

use std::fmt::Display;
use std::path::Path;

use datasets_spec::Code;
use work::Failed;

/// An error that ends a run. A faulty source file is not an error but a row of the `quarantine` table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The request cannot be carried out.
    #[error("{reason}")]
    Refused {
        /// Code that scripts may rely on, with the item it happened to.
        code: Option<Code>,
        /// What happened, and what to do next.
        reason: String,
    },
    /// A query of the tables of a dataset cannot be understood or answered.
    #[error(transparent)]
    Tables(#[from] tables::Error),
    /// The dataset could not be read or written.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// A motion is invalid.
    #[error(transparent)]
    Motion(#[from] kinematics::Error),
    /// A file or folder does not follow its format.
    #[error(transparent)]
    Formats(#[from] formats::Error),
    /// A job in pieces, or its output folder, cannot continue.
    #[error(transparent)]
    Work(#[from] work::Error),
    /// Composing motions failed.
    #[error(transparent)]
    Compose(#[from] compose::Error),
}

impl Error {
    pub(crate) fn refused(reason: impl Into<String>) -> Self {
        let (code, reason) = (None, reason.into());
        Self::Refused { code, reason }
    }

    pub(crate) fn coded(code: &'static str, item: impl Display, reason: impl Into<String>) -> Self {
        Self::Refused {
            code: Some((code, Some(item.to_string()))),
            reason: reason.into(),
        }
    }

    /// The requested source is ambiguous; the reason states the candidates and how to choose.
    pub(crate) fn asked(reason: String) -> Self {
        let code = Some(("E-SOURCE-NAME", None));
        Self::Refused { code, reason }
    }

    /// A source folder or file does not exist.
    pub(crate) fn missing_source(path: &Path) -> Self {
        let path = path.display();
        let reason = format!("no such file or folder: {path}; check the path");
        Self::coded("E-MISSING", path, reason)
    }

    /// `paths` hold no files at all; `hint` says what they hold instead, or what to check.
    pub(crate) fn no_files(paths: &str, hint: &str) -> Self {
        let reason = format!("no files under {paths}; {hint}");
        Self::coded("E-NO-FILES", paths, reason)
    }

    /// An export of a dataset without motions was requested.
    pub(crate) fn no_motions(path: &Path) -> Self {
        Self::refused(format!(
            "{} holds neither motions nor edits; name a dataset, or a folder that `stance edit` wrote",
            path.display()
        ))
    }

    /// The output folder already holds a dataset.
    pub(crate) fn dataset_exists(path: &Path) -> Self {
        Self::refused(format!(
            "{} is a dataset already; choose a folder that does not exist",
            path.display()
        ))
    }

    /// The code of the error, if it has one, and the item it happened to.
    pub fn code(&self) -> Option<Code> {
        match self {
            Self::Spec(error) => error.code(),
            Self::Compose(error) => error.code(),
            Self::Formats(error) => error.code(),
            Self::Work(error) => error.code(),
            Self::Refused { code, .. } => code.clone(),
            _ => None,
        }
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
