//! Error of reading a container.

/// Error in a container file, with its offset.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{code}: {reason}")]
pub struct Error {
    /// Stable error code for scripts, such as `E-PICKLE-REFUSED`.
    pub code: &'static str,
    /// What is wrong, with the numbers found and expected.
    pub reason: String,
    /// Byte offset of the error in the file, if known; in a packed file, in the unpacked stream.
    pub byte_offset: Option<u64>,
}

/// An [`Error`] from a code and a reason in the syntax of `format!`.
macro_rules! error {
    ($code:expr, $($reason:tt)+) => {
        $crate::error::Error::new($code, format!($($reason)+))
    };
}
pub(crate) use error;

impl Error {
    pub(crate) fn new(code: &'static str, reason: impl Into<String>) -> Self {
        Self {
            code,
            reason: reason.into(),
            byte_offset: None,
        }
    }

    pub(crate) fn at(self, byte_offset: usize) -> Self {
        Self {
            byte_offset: Some(byte_offset as u64),
            ..self
        }
    }
}
