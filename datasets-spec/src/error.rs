//! Errors of the contract.

use std::path::{Path, PathBuf};

/// An error that names the affected item.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A motion, a frame rate or a joint is invalid.
    #[error(transparent)]
    Motion(#[from] kinematics::Error),
    /// A name or a row cannot be used; the message states why.
    #[error("{0}")]
    Refused(String),
    /// A test question of a folder cannot be used.
    #[error("in {}", path.display())]
    ItemOf {
        /// The folder.
        path: PathBuf,
        /// The cause.
        source: Box<Error>,
    },
    /// A column of a table is missing or of another type.
    #[error("table {table}: column {column:?} {problem}")]
    Column {
        /// Table name.
        table: &'static str,
        /// Column name.
        column: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A folder is not a dataset.
    #[error("{} is not a dataset: {reason}", path.display())]
    NotADataset {
        /// The folder.
        path: PathBuf,
        /// The missing file or field.
        reason: String,
    },
    /// A dataset or shard has a format of another major version.
    #[error("{} has format {found}, this program reads {supported}; use a newer stance or ingest again", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// Version found.
        found: String,
        /// Version read by this program.
        supported: &'static str,
    },
    /// A file differs from what the manifest records.
    #[error("{} does not match its manifest ({detail}); put back a copy of the file, go back to a version without it (`stance dataset restore`), or ingest the sources, or what is left of this dataset, into a new folder", path.display())]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// Expected and found.
        detail: String,
    },
    /// A folder holds a file or table that a dataset or table there would replace or stand beside.
    #[error("{} {problem}", path.display())]
    Occupied {
        /// The folder.
        path: PathBuf,
        /// What it holds, and what to do.
        problem: String,
    },
    /// Another run writes to the same folder.
    #[error("{} is locked by another run ({holder}); wait for it or choose another folder", path.display())]
    Locked {
        /// The folder.
        path: PathBuf,
        /// Description of the holder, from the lock file.
        holder: String,
    },
    /// Another run committed the version that this run was about to commit.
    #[error("another run committed version {version} of {} while this one worked; run the command again, now on top of that version", path.display())]
    Overtaken {
        /// The dataset.
        path: PathBuf,
        /// The version that both made.
        version: u64,
    },
    /// Reading or writing a file failed.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// What was tried, as a verb.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A Parquet file cannot be read or written.
    #[error("cannot {action} Parquet file {}", path.display())]
    Parquet {
        /// What was tried, as a verb.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The cause.
        source: parquet::errors::ParquetError,
    },
    /// Arrow refused a batch.
    #[error("table {table}: cannot build a batch")]
    Arrow {
        /// Table name.
        table: &'static str,
        /// The cause.
        source: arrow_schema::ArrowError,
    },
    /// A JSON document of the dataset is malformed.
    #[error("cannot read {} as JSON", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: serde_json::Error,
    },
}

/// A code that scripts may rely on, such as `E-IO`, and the file, folder or clip that an error happened to.
pub type Code = (&'static str, Option<String>);

impl Error {
    /// The code of the error, if it has one, and the item it happened to.
    pub fn code(&self) -> Option<Code> {
        let (code, path) = match self {
            Self::Io { path, .. } => ("E-IO", path),
            Self::Locked { path, .. } => ("E-LOCKED", path),
            Self::Overtaken { path, .. } => ("E-OVERTAKEN", path),
            Self::Occupied { path, .. } => ("E-OCCUPIED", path),
            Self::NotADataset { path, .. } => ("E-DATASET", path),
            Self::Version { path, .. } => ("E-VERSION", path),
            Self::Corrupt { path, .. } | Self::Parquet { path, .. } | Self::Json { path, .. } => {
                ("E-CORRUPT", path)
            }
            _ => return None,
        };
        Some((code, Some(path.display().to_string())))
    }

    /// A folder holds no test questions.
    pub fn no_items(folder: &Path) -> Self {
        let folder = folder.display();
        Self::Refused(format!(
            "{folder} holds no items; draw them: stance items DATASET --out ITEMS"
        ))
    }

    /// Wraps a JSON error with the file.
    pub fn json(path: impl Into<PathBuf>) -> impl FnOnce(serde_json::Error) -> Self {
        let path = path.into();
        move |source| Self::Json { path, source }
    }

    /// Wraps an I/O error with what was tried on which file.
    pub fn io(
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

    /// Wraps a Parquet error with what was tried on which file. An I/O error inside it becomes [`Error::Io`], so that a
    /// full disk is reported as one.
    pub fn parquet(
        action: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(parquet::errors::ParquetError) -> Self {
        let path = path.into();
        let failed = move |path, source| Self::Parquet {
            action,
            path,
            source,
        };
        move |source| match source {
            parquet::errors::ParquetError::External(cause) => match cause.downcast() {
                Ok(cause) => Self::io(action, path)(*cause),
                Err(cause) => failed(path, parquet::errors::ParquetError::External(cause)),
            },
            source => failed(path, source),
        }
    }
}
