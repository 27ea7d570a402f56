//! Errors about motions in memory.

/// Why a motion, a frame rate or a joint is invalid; the text names the affected item.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Error(pub(crate) String);
