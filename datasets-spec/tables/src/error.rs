//! Errors of queries.

use std::path::PathBuf;

/// An error of a query.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A table cannot be read.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// A query cannot be understood or answered.
    #[error("{text:?}: {problem}")]
    Sql {
        /// The query.
        text: String,
        /// What is wrong, and which names exist.
        problem: String,
    },
    /// An answer cannot be written as Parquet.
    #[error("the answer cannot be written as Parquet: {0}")]
    Parquet(String),
    /// A condition chooses no clip.
    #[error("no clip of {} fulfils the condition; `stance stats` shows which values there are", path.display())]
    NoneChosen {
        /// The dataset.
        path: PathBuf,
    },
}
