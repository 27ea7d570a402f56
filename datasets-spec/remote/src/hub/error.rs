//! Errors of the hub.

use std::path::PathBuf;

use datasets_spec::Code;

/// An error that names the item it happened to. Errors never show a token.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file on this machine cannot be read or written.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// A variable of the environment names no proxy.
    #[error("{variable} names no proxy ({problem})")]
    Proxy {
        /// The variable.
        variable: &'static str,
        /// What is wrong with the variable.
        problem: String,
    },
    /// A name is not a valid repo name.
    #[error("{name:?} is no name of a repo: {problem}; expected OWNER/NAME")]
    Name {
        /// The name.
        name: String,
        /// What is wrong with the name.
        problem: &'static str,
    },
    /// No token is known for the server at this address.
    #[error(
        "no token of the hub is known; make one with the right to write at {0}/settings/tokens, and set HF_TOKEN \
         or run `hf auth login`"
    )]
    NoToken(String),
    /// The server does not allow a request.
    #[error("the hub refuses {address} ({problem}); {remedy}")]
    Refused {
        /// Address of the request.
        address: String,
        /// Reason given by the server.
        problem: String,
        /// What to do next.
        remedy: &'static str,
    },
    /// The server does not have this repo, revision or address, or does not show it.
    #[error("the hub has no {0}, or does not show it to this token")]
    NotFound(String),
    /// This name belongs to a dataset and to a model.
    #[error("{0} is a dataset and a model; say which: --type dataset or --type model")]
    Ambiguous(String),
    /// A request failed.
    #[error("{address} failed ({problem}); run the same command again to go on where it stopped")]
    Call {
        /// Address of the request.
        address: String,
        /// Cause of the failure.
        problem: String,
    },
    /// A file cannot be uploaded.
    #[error(
        "cannot upload {path} ({problem}); run the same command again to go on where it stopped"
    )]
    Upload {
        /// Path of the file in the repo.
        path: String,
        /// Cause of the failure.
        problem: String,
    },
    /// A file cannot be deleted.
    #[error("cannot delete {path}: {problem}")]
    Delete {
        /// Path of the file or folder in the repo.
        path: String,
        /// Why not.
        problem: &'static str,
    },
    /// A repo holds no contents made by this program.
    #[error("{repo} holds no {kind} of this program: it has no {missing}")]
    Foreign {
        /// The repo.
        repo: String,
        /// Expected kind of contents.
        kind: &'static str,
        /// The missing file.
        missing: &'static str,
    },
    /// A repo has a file whose name leads out of its folder.
    #[error("{repo} has a file {path:?}, which cannot be written here")]
    Path {
        /// The repo.
        repo: String,
        /// The name.
        path: String,
    },
    /// The output folder already exists.
    #[error("{} is there already; choose another folder", .0.display())]
    Exists(PathBuf),
    /// A download failed.
    #[error(
        "cannot download {address} ({problem}); run again to go on where it stopped, or download \
         it by hand and name its folder"
    )]
    Download {
        /// Address of the download.
        address: String,
        /// Cause of the failure.
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
    /// The code of the error, and what it happened to.
    pub fn code(&self) -> Option<Code> {
        let item = match self {
            Self::Spec(error) => return error.code(),
            Self::Proxy { variable, .. } => (*variable).to_owned(),
            Self::Name { name, .. } | Self::Ambiguous(name) => name.clone(),
            Self::NoToken(endpoint) => endpoint.clone(),
            Self::NotFound(what) => what.clone(),
            Self::Refused { address, .. }
            | Self::Call { address, .. }
            | Self::Download { address, .. } => address.clone(),
            Self::Upload { path, .. } | Self::Delete { path, .. } | Self::Path { path, .. } => {
                path.clone()
            }
            Self::Foreign { repo, .. } => repo.clone(),
            Self::Exists(path) | Self::Checksum { path, .. } => path.display().to_string(),
        };
        Some(("E-HUB", Some(item)))
    }
}
