//! What can go wrong, and which problem of the interface it is.

use std::path::PathBuf;

use crate::wire::{Code, Problem, Revision, TaskState};

/// An error that names the item it happened to.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A request is refused; the problem is what its sender is told.
    #[error("{}", .0.detail)]
    Refused(Box<Problem>),
    /// The store cannot be opened.
    #[error("cannot open the store {path}: {reason}")]
    Open {
        /// Where it is.
        path: String,
        /// Why, and what to do.
        reason: String,
    },
    /// SQLite refuses.
    #[error("the store cannot {action}")]
    Sqlite {
        /// What was tried.
        action: &'static str,
        /// The cause.
        source: rusqlite::Error,
    },
    /// PostgreSQL refuses.
    #[cfg(feature = "postgres")]
    #[error("the store cannot {action}")]
    Postgres {
        /// What was tried.
        action: &'static str,
        /// The cause.
        source: postgres::Error,
    },
    /// The store takes no writes.
    #[error(
        "the store takes no writes: {reason}; free space on the disk, what is sent again is taken then"
    )]
    ReadOnly {
        /// Why.
        reason: String,
    },
    /// The writer has stopped.
    #[error("the store is closed")]
    Closed,
    /// A row of the store does not hold what it should.
    #[error(
        "table {table} of the store holds a row that cannot be read ({problem}); restore a backup, or rebuild the tables from the log with `stance annotate DATASET rebuild`"
    )]
    Row {
        /// Table.
        table: &'static str,
        /// What is wrong.
        problem: String,
    },
    /// The dataset cannot be read.
    #[error(transparent)]
    Dataset(#[from] datasets_spec::Error),
    /// A motion cannot be made.
    #[error(transparent)]
    Motion(#[from] kinematics::Error),
    /// Motions cannot be blended.
    #[error(transparent)]
    Compose(#[from] pipeline::compose::Error),
    /// A file cannot be read or written.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// An import is not what it should be.
    #[error("cannot import {what}: {problem}")]
    Import {
        /// What.
        what: String,
        /// What is wrong, and what would be right.
        problem: String,
    },
    /// The server cannot listen.
    #[error("cannot listen on {address}; choose another address with --listen")]
    Listen {
        /// The address.
        address: String,
        /// The cause.
        source: std::io::Error,
    },
}

impl Error {
    /// Wraps an I/O error with what was tried on which file.
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

    /// A refusal.
    pub(crate) fn refused(code: Code, detail: impl Into<String>) -> Self {
        Self::Refused(Box::new(Problem::new(code, detail)))
    }

    /// A refusal of one field.
    pub(crate) fn invalid(field: &str, detail: impl Into<String>) -> Self {
        let mut problem = Problem::new(Code::Invalid, detail);
        problem.field = Some(field.to_owned());
        Self::Refused(Box::new(problem))
    }

    /// A thing that is not there, or not to be seen.
    pub(crate) fn not_found(what: &str) -> Self {
        Self::refused(
            Code::NotFound,
            format!("there is no such {what}, or it is not yours to see"),
        )
    }

    pub(crate) fn wrong_state(state: TaskState, what: &str) -> Self {
        Self::refused(
            Code::WrongState,
            format!("a task that is {state} cannot be {what}"),
        )
    }

    /// The problem its sender is told. What is nobody's business stays in the log of the server.
    pub fn problem(&self) -> Problem {
        match self {
            Self::Refused(problem) => Problem::clone(problem),
            Self::ReadOnly { .. } => Problem::new(Code::ReadOnly, self.to_string()),
            _ => Problem::new(
                Code::Internal,
                "the server could not do this; its log says why",
            ),
        }
    }
}

impl Problem {
    /// A problem of this code.
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        Self {
            kind: format!("/problems/{code}"),
            title: code.title().to_owned(),
            status: code.status(),
            code,
            detail: detail.into(),
            field: None,
            retry_after_secs: None,
            theirs: None,
        }
    }

    /// With the revision the store has.
    pub(crate) fn with_theirs(mut self, revision: Revision) -> Self {
        self.theirs = Some(Box::new(revision));
        self
    }
}

impl Code {
    /// Its HTTP status.
    pub fn status(self) -> u16 {
        match self {
            Self::Unauthenticated => 401,
            Self::Forbidden | Self::Csrf | Self::WrongOrigin | Self::OwnWork => 403,
            Self::NotFound => 404,
            Self::MethodNotAllowed => 405,
            Self::BadRequest => 400,
            Self::TooLarge => 413,
            Self::Invalid | Self::MaskCount => 422,
            Self::StaleRevision
            | Self::LeaseLost
            | Self::TaskFull
            | Self::WrongState
            | Self::KeyReused => 409,
            Self::RateLimited => 429,
            Self::NoModel | Self::Timeout => 503,
            Self::ModelFailed => 502,
            Self::ReadOnly => 507,
            Self::Internal => 500,
        }
    }

    /// What it means, in a line.
    pub fn title(self) -> &'static str {
        match self {
            Self::Unauthenticated => "Not logged in",
            Self::Forbidden => "Not allowed",
            Self::Csrf => "The header X-Annotate is missing",
            Self::WrongOrigin => "From another site",
            Self::OwnWork => "Own work",
            Self::NotFound => "Not found",
            Self::MethodNotAllowed => "Method not allowed",
            Self::BadRequest => "Malformed request",
            Self::TooLarge => "Too large",
            Self::Invalid => "Not acceptable as it is",
            Self::MaskCount => "Too few or too many masks",
            Self::StaleRevision => "Changed elsewhere",
            Self::LeaseLost => "The task was given to somebody else",
            Self::TaskFull => "The task has all the people it wants",
            Self::WrongState => "Not in this state",
            Self::KeyReused => "Key used before",
            Self::RateLimited => "Too many requests",
            Self::NoModel => "No language model",
            Self::ModelFailed => "The language model failed",
            Self::Timeout => "Took too long",
            Self::ReadOnly => "Nothing can be saved at present",
            Self::Internal => "Defect of the server",
        }
    }
}
