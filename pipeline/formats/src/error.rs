//! Errors of reading a folder or file as a whole. A motion file that cannot be read is a row of the table `quarantine`
//! instead.

use std::path::PathBuf;

use datasets_spec::Code;

/// An error with the path of the file or folder that it concerns.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file contains no usable motion.
    #[error("{}: {reason}", path.display())]
    UnusableFile {
        /// The file.
        path: PathBuf,
        /// Stable error code for scripts: the rejection's, or `E-NO-MOTION`.
        code: &'static str,
        /// Reason.
        reason: String,
    },
    /// An archive cannot be unpacked.
    #[error(
        "cannot unpack an archive to {}: {reason}; set TMPDIR to a folder with more room, or unpack the archive and name \
         its folder",
        path.display()
    )]
    Scratch {
        /// The file or folder.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// A file is not a usable body model.
    #[error("{} cannot serve as body model ({code}): {reason}", path.display())]
    BodyModel {
        /// The file.
        path: PathBuf,
        /// Stable error code for scripts, such as `E-BODY-SHAPE`.
        code: &'static str,
        /// What is wrong, with what was found and expected.
        reason: String,
    },
    /// A list of crops cannot be used.
    #[error("{} is no HumanML3D index: {reason}", path.display())]
    Index {
        /// The file.
        path: PathBuf,
        /// What is wrong, with what was found and expected.
        reason: String,
    },
    /// A path cannot be listed or read.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
}

impl Error {
    /// The code of the error, and the path that it concerns.
    pub fn code(&self) -> Option<Code> {
        let (code, path) = match self {
            Self::Spec(error) => return error.code(),
            Self::UnusableFile { path, code, .. } | Self::BodyModel { path, code, .. } => {
                (*code, path)
            }
            Self::Scratch { path, .. } => ("E-SCRATCH", path),
            Self::Index { path, .. } => ("E-INDEX", path),
        };
        Some((code, Some(path.display().to_string())))
    }
}
