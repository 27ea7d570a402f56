//! Errors, and the problem document that a client receives for each.

use std::fmt::Display;

use crate::wire::{Code, Problem};

/// An error that names the item it happened to.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The request is refused; the problem is sent to the client.
    #[error("{}", .0.detail)]
    Refused(Box<Problem>),
    /// The store cannot be opened.
    #[error("cannot open the store {path}: {reason}")]
    Open {
        /// Path or address of the store.
        path: String,
        /// Why, and what to do.
        reason: String,
    },
    /// There is no store, and the command creates none.
    #[error(
        "there is no store {place}; name the store with --store or STANCE_STORE, or create it: stance annotate DATASET import"
    )]
    Missing {
        /// Path or address of the store.
        place: String,
    },
    /// An SQLite operation failed.
    #[error("the store cannot {action}")]
    Sqlite {
        /// The operation.
        action: &'static str,
        /// The cause.
        source: rusqlite::Error,
    },
    /// A PostgreSQL operation failed.
    #[cfg(feature = "postgres")]
    #[error("the store cannot {action}")]
    Postgres {
        /// The operation.
        action: &'static str,
        /// The cause.
        source: postgres::Error,
    },
    /// The store accepts no writes.
    #[error("the store accepts no writes: {reason}")]
    ReadOnly {
        /// Why, and what to do.
        reason: String,
    },
    /// The writer has stopped.
    #[error("the store is closed")]
    Closed,
    /// A row of the store is invalid.
    #[error(
        "table {table} of the store holds a row that cannot be read ({problem}); rebuild the tables from the log with `stance annotate DATASET rebuild`, or restore a backup, and first move the store and its files -wal and -shm to another folder"
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
    /// A motion is invalid.
    #[error(transparent)]
    Motion(#[from] kinematics::Error),
    /// Motions cannot be blended.
    #[error(transparent)]
    Compose(#[from] compose::Error),
    /// The input of an import is invalid.
    #[error("cannot import {what}: {problem}")]
    Import {
        /// Name of the input.
        what: String,
        /// What is wrong, and how to correct it.
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
    /// The error with its causes, in one line.
    pub(crate) fn full(&self) -> String {
        let first = self as &dyn std::error::Error;
        let all = std::iter::successors(Some(first), |error| error.source());
        Vec::from_iter(all.map(|error| error.to_string())).join(": ")
    }

    /// An [`Error::Import`]: an input cannot be used.
    pub(crate) fn import(what: impl Into<String>, problem: impl Into<String>) -> Self {
        let (what, problem) = (what.into(), problem.into());
        Self::Import { what, problem }
    }

    /// An error for a refused request.
    pub(crate) fn refused(code: Code, detail: impl Into<String>) -> Self {
        Self::Refused(Box::new(Problem::new(code, detail)))
    }

    /// An error for a request refused because of one field.
    pub(crate) fn invalid(field: &str, detail: impl Into<String>) -> Self {
        let mut problem = Problem::new(Code::Invalid, detail);
        problem.field = Some(field.to_owned());
        Self::Refused(Box::new(problem))
    }

    /// An error for a resource that is missing, or that the user may not see.
    pub(crate) fn not_found(what: &str) -> Self {
        let problem = format!("no such {what}, or you may not see it");
        Self::refused(Code::NotFound, problem)
    }

    /// A request that the present state of a task does not allow.
    pub(crate) fn wrong_state(state: impl Display, what: &str) -> Self {
        let problem = format!("a task that is {state} cannot be {what}");
        Self::refused(Code::WrongState, problem)
    }

    /// The problem sent to the client. Details of internal errors appear only in the server log.
    pub fn problem(&self) -> Problem {
        match self {
            Self::Refused(problem) => Problem::clone(problem),
            Self::ReadOnly { .. } => Problem::new(Code::ReadOnly, self.to_string()),
            _ => Problem::new(
                Code::Internal,
                "internal error; the server log has the details",
            ),
        }
    }
}

/// Returns the error `invalid` about a field unless a condition holds.
pub(crate) fn require(holds: bool, field: &str, problem: impl Into<String>) -> Result<(), Error> {
    if holds {
        return Ok(());
    }
    Err(Error::invalid(field, problem))
}

impl Problem {
    /// A problem with the HTTP status and title of its code.
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        let (status, title) = code.meaning();
        Self {
            kind: format!("/problems/{code}"),
            title: title.to_owned(),
            status,
            code,
            detail: detail.into(),
            field: None,
            retry_after_secs: None,
            theirs: None,
        }
    }
}

impl Code {
    /// The HTTP status, and the meaning in one line.
    fn meaning(self) -> (u16, &'static str) {
        match self {
            Self::Unauthenticated => (401, "Not logged in"),
            Self::Forbidden => (403, "Not allowed"),
            Self::Csrf => (403, "The header X-Annotate is missing"),
            Self::WrongOrigin => (403, "Request from another site"),
            Self::WrongHost => (421, "Not the name of this server"),
            Self::OwnWork => (403, "Reviewing your own work"),
            Self::NotFound => (404, "Not found"),
            Self::MethodNotAllowed => (405, "Method not allowed"),
            Self::BadRequest => (400, "Malformed request"),
            Self::TooLarge => (413, "Too large"),
            Self::Invalid => (422, "Invalid value"),
            Self::MaskCount => (422, "Too few or too many masks"),
            Self::StaleRevision => (409, "Changed elsewhere"),
            Self::LeaseLost => (409, "The task was given to somebody else"),
            Self::TaskFull => (409, "The task has enough annotators"),
            Self::WrongState => (409, "Not possible in this state"),
            Self::SettingChanged => (409, "Changed by somebody else"),
            Self::KeyReused => (409, "Key used before"),
            Self::RateLimited => (429, "Too many requests"),
            Self::NoModel => (503, "No language model"),
            Self::ModelFailed => (502, "The language model failed"),
            Self::Timeout => (503, "Timeout"),
            Self::ReadOnly => (507, "The store is read-only"),
            Self::Internal => (500, "Internal server error"),
        }
    }
}
