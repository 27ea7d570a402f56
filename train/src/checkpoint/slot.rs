//! Names of the checkpoints of a run.

use std::str::FromStr;

/// A checkpoint of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// The newest checkpoint.
    Last,
    /// The checkpoint with the lowest validation loss.
    Best,
    /// The checkpoint kept after this epoch.
    Epoch(u64),
}

impl Slot {
    /// Name of the checkpoint's folder.
    pub fn name(self) -> String {
        match self {
            Self::Last => "last".to_owned(),
            Self::Best => "best".to_owned(),
            Self::Epoch(epoch) => format!("epoch-{epoch}"),
        }
    }
}

impl FromStr for Slot {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "last" => Ok(Self::Last),
            "best" => Ok(Self::Best),
            _ => name
                .strip_prefix("epoch-")
                .and_then(|epoch| epoch.parse().ok())
                .map(Self::Epoch)
                .ok_or_else(|| {
                    format!("{name:?} is no checkpoint; known are best, last and epoch-N")
                }),
        }
    }
}
