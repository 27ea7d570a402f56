//! Datasets in the layouts that other tools read.
//!
//! An export appears whole or not at all: it is written to a temporary folder beside the destination, and
//! renamed when it is complete.

mod by_clip;
mod clips;
mod document;
mod edits;
mod features;
mod form;
mod humanml3d;
mod items;
mod job;
mod layout;
mod left_out;
mod lerobot;
mod motionfix;
mod paths;
mod stance;
#[cfg(test)]
mod tests;
mod webdataset;

use std::path::Path;

use datasets_spec::Progress;
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;

use crate::Error;
use crate::clips::Clips;
use work::NewFolder;

use self::by_clip::PART_CLIPS;
use self::form::Form;
pub use edits::{Sides, export_edits};
pub use items::export_items;
pub use job::plan_export;
pub(crate) use job::{JOB, open_job};
pub use layout::Layout;
pub use left_out::{Counts, Exported, before, untagged_captions};
pub use motionfix::export_triplets;
pub(crate) use paths::safe_name;

/// Writes clips to a new folder in another layout.
///
/// # Errors
/// The dataset holds no motions, the folder exists and is not empty, the dataset cannot be read, or
/// writing fails; nothing is left behind then.
pub fn export(
    clips: &Clips,
    layout: Layout,
    out: &Path,
    progress: &dyn Progress,
) -> Result<Exported, Error> {
    let dataset = clips.dataset();
    if !dataset.manifest().tables.contains_key(MotionRow::TABLE) {
        return Err(Error::no_motions(dataset.root()));
    }
    let folder = NewFolder::beside(out)?;
    let mut done = match Form::of(layout, clips)? {
        Form::Whole(write) => write(clips, folder.path(), progress)?,
        Form::ByClip(form) => {
            progress.begin("export", Some(clips.len()));
            let mut notes = Vec::new();
            for part in clips.parts(PART_CLIPS) {
                notes.extend(form.write(clips.read(&part)?, folder.path(), progress)?);
            }
            let written = form.finish(clips, &notes, folder.path())?;
            progress.finish(&format!("{written} clips"));
            Exported::of(written)
        }
    };
    done.complete(layout, clips)?;
    done.left_by_others = folder.left_by_others();
    folder.publish()?;
    Ok(done)
}
