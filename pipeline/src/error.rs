//! What can go wrong between a folder of files and a dataset.

use std::path::PathBuf;

/// An error that ends a run. What is wrong with a single source file is not an error but a row of
/// the `quarantine` table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A source folder or file does not exist.
    #[error("no such file or folder: {}; check the path", path.display())]
    MissingSource {
        /// The path given.
        path: PathBuf,
    },
    /// The sources hold no files at all.
    #[error("no files under {paths}; is the archive unpacked there?")]
    NoFiles {
        /// The paths given.
        paths: String,
    },
    /// A path cannot be listed or read.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// What was tried, as a verb.
        action: &'static str,
        /// The path.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The dataset could not be read or written.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// The built-in corpus could not be written.
    #[error(transparent)]
    Corpus(#[from] crate::corpus::Error),
    /// Composing motions failed.
    #[error(transparent)]
    Compose(#[from] crate::compose::Error),
    /// A question to a table failed.
    #[error("cannot query table {table} of {}", dataset.display())]
    Query {
        /// The table.
        table: &'static str,
        /// The dataset.
        dataset: PathBuf,
        /// The cause.
        source: polars::error::PolarsError,
    },
}

impl Error {
    /// Wraps an I/O error with what was tried on which path.
    pub(crate) fn io(
        action: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io {
            action,
            path,
            source,
        }
    }
}
