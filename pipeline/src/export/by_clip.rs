//! Layouts that write separate files for each clip, independently of other clips.

use std::path::Path;

use datasets_spec::record::MotionRow;
use datasets_spec::{Progress, Split};
use rayon::prelude::*;

use crate::Error;
use crate::clips::Clips;

/// Clips that are read and written together.
pub(super) const PART_CLIPS: usize = 256;

/// Why a clip was left out, if it was.
pub(super) type Note = Option<String>;

/// A layout that writes separate files for each clip.
pub(super) trait ByClip: Send + Sync {
    /// Writes the files of a clip; returns the reason if it was left out.
    fn write_clip(&self, row: MotionRow, folder: &Path) -> Result<Note, Error>;

    /// Writes the files that depend on all clips, after the files of each clip are in `folder`. `notes` are in the
    /// order of the clips. Returns the number of clips that were not left out.
    fn finish(&self, clips: &Clips, notes: &[Note], folder: &Path) -> Result<u64, Error>;
}

impl dyn ByClip {
    /// Writes the files of some clips, and returns a note for each.
    pub(super) fn write(
        &self,
        rows: Vec<MotionRow>,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<Vec<Note>, Error> {
        let written = rows.into_par_iter().map(|row| {
            let note = self.write_clip(row, folder)?;
            progress.advance(1);
            Ok(note)
        });
        written.collect()
    }
}

/// Id, split and licence of the clips; the licence is empty if unknown.
pub(super) fn labels(clips: &Clips) -> Result<Vec<(String, Split, String)>, Error> {
    let mut labels = Vec::new();
    for shard in clips.shards(None) {
        let ids = shard.column::<String>("id")?.into_iter();
        let splits = shard.column::<Split>("split")?;
        let licenses = shard.column::<Option<String>>("license")?;
        let of_shard = ids.zip(splits).zip(licenses);
        labels.extend(
            of_shard.map(|((id, split), license)| (id, split, license.unwrap_or_default())),
        );
    }
    Ok(labels)
}

pub(super) fn sorted_lines(mut names: Vec<&str>) -> String {
    names.sort_unstable();
    names.iter().flat_map(|name| [*name, "\n"]).collect()
}
