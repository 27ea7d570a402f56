//! Archives that are open.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use datasets_spec::store::Mounted;

/// Archives that are open.
#[derive(Clone, Debug, Default)]
pub struct Archives {
    pub(super) open: Vec<Arc<Mounted>>,
    /// Those that had to be unpacked.
    pub(super) unpacked: Vec<PathBuf>,
}

impl Archives {
    /// Takes others over.
    pub fn add(&mut self, other: Self) {
        self.open.extend(other.open);
        self.unpacked.extend(other.unpacked);
    }

    /// One that had to be unpacked, so that other processes cannot read its members.
    pub fn unpacked(&self) -> Option<&Path> {
        self.unpacked.first().map(PathBuf::as_path)
    }
}
