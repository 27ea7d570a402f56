//! Layouts whose clips have files of their own, which can be written apart from each other.

use std::path::Path;

use datasets_spec::Progress;
use datasets_spec::record::MotionRow;

use crate::Error;
use crate::clips::Clips;

/// Clips that are read and written together.
pub(super) const PART_CLIPS: usize = 256;

/// Why a clip was left out, if it was.
pub(super) type Note = Option<String>;

/// A layout whose clips have files of their own.
pub(super) trait ByClip: Send + Sync {
    /// Writes the files of some clips, and returns a note for each.
    ///
    /// # Errors
    /// A motion is invalid, or a file cannot be written.
    fn write(
        &self,
        rows: Vec<MotionRow>,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<Vec<Note>, Error>;

    /// Writes what depends on all clips, whose files are in the folder. The notes are in the order of the clips.
    /// Returns the number of clips that were not left out.
    ///
    /// # Errors
    /// The dataset or a file of a clip cannot be read, or a file cannot be written.
    fn finish(&self, clips: &Clips, notes: &[Note], folder: &Path) -> Result<u64, Error>;
}
