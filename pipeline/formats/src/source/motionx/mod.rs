//! Motion-X and Motion-X++: SMPL-X parameters as arrays of 322 columns, with captions in a folder of the same
//! layout, and lists of splits.
//!
//! # Source
//! Repository IDEA-Research/Motion-X at 2a7db28: the columns and folders of its README; its conversion of
//! AMASS, which turns z up into y up; 30 fps. The second spelling of the folders is that of Motion-X++.

mod array;
mod release;
#[cfg(test)]
mod tests;

use std::path::Path;

use pickle::npy::Header;

use super::files::Files;
use super::format::{Format, Recognised, Release, SourceFormat, boxed};
use super::options::ReadOptions;
use clip::Outcome;

pub use array::read_array;

/// Motion-X: SMPL-X parameters of 322 columns.
// Bytes per second: the columns in f4.
pub const FORMAT: Format = Format::of_releases(
    "motion-x",
    "a folder smplx_322 of Motion-X, or smplx322 of Motion-X++; a lone array of 322 columns; its own rotations",
    (4 * array::WIDTH) as f64 * array::FPS,
    &MotionX,
);

struct MotionX;

impl SourceFormat for MotionX {
    fn by_name(&self, extension: &str, _name: &str, head: &[u8]) -> Option<Recognised> {
        let shape = Header::peek_shape("array", head).ok();
        let is_motion = extension == "npy" && matches!(shape.as_deref(), Some([_, array::WIDTH]));
        is_motion.then_some(Recognised::Motion(FORMAT))
    }

    fn read(&self, _path: &Path, _key: &str, bytes: &[u8], options: &ReadOptions) -> Outcome {
        read_array(bytes, &options.skeleton).into()
    }

    fn find(&self, files: &Files) -> Vec<Box<dyn Release>> {
        boxed(release::MotionXFolder::find(files))
    }
}
