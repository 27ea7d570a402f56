//! Errors of the hub.

use std::fmt::Display;
use std::path::PathBuf;

use datasets_spec::Code;

/// An error that names the item it happened to. Errors never show a token.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file on this machine cannot be read or written.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// A request is refused, fails, or cannot be made.
    #[error("{problem}")]
    Hub {
        /// Address, name or path that the error is about.
        item: String,
        /// What happened, and what to do next.
        problem: String,
    },
    /// A downloaded file does not match its checksum.
    #[error(
        "{} is damaged ({name} expected {expected}, found {found}); delete it and download it again",
        path.display()
    )]
    Checksum {
        /// The file.
        path: PathBuf,
        /// Kind of checksum.
        name: &'static str,
        /// Expected checksum.
        expected: String,
        /// Checksum of the file.
        found: String,
    },
}

impl Error {
    /// Returns a function that adds to an I/O error what was tried on which file.
    pub(super) fn io(
        action: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(std::io::Error) -> Self {
        let wrap = datasets_spec::Error::io(action, path);
        move |error| wrap(error).into()
    }

    pub(super) fn hub(item: impl Display, problem: impl Into<String>) -> Self {
        Self::Hub {
            item: item.to_string(),
            problem: problem.into(),
        }
    }

    /// The server does not have a repo, revision or address, or does not show it.
    pub(super) fn not_found(what: impl Display) -> Self {
        let problem = format!("the hub has no {what}, or does not show it to this token");
        Self::hub(what, problem)
    }

    pub(super) fn upload(path: &str, problem: &str) -> Self {
        let next = "run the same command again to go on where it stopped";
        Self::hub(path, format!("cannot upload {path} ({problem}); {next}"))
    }

    pub(super) fn download(address: &str, problem: &str) -> Self {
        let next =
            "run again to go on where it stopped, or download it by hand and name its folder";
        Self::hub(
            address,
            format!("cannot download {address} ({problem}); {next}"),
        )
    }

    /// The code of the error, and what it happened to.
    pub fn code(&self) -> Option<Code> {
        let item = match self {
            Self::Spec(error) => return error.code(),
            Self::Hub { item, .. } => item.clone(),
            Self::Checksum { path, .. } => path.display().to_string(),
        };
        Some(("E-HUB", Some(item)))
    }
}
