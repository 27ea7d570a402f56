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

use pickle::npy::Header;

use super::format::{Format, boxed};

pub use array::read_array;

/// Motion-X: SMPL-X parameters of 322 columns.
// Bytes per second: the columns in f4.
pub const FORMAT: Format = Format {
    extensions: &["npy"],
    by_name: |_, head| {
        let shape = Header::peek_shape("array", head).ok()?;
        matches!(shape[..], [_, array::WIDTH]).then_some(Ok(()))
    },
    read: |_, _, bytes, options| read_array(bytes, &options.skeleton).into(),
    find: |files| boxed(release::MotionXFolder::find(files)),
    ..Format::of_releases(
        "motion-x",
        "a folder smplx_322 of Motion-X, or smplx322 of Motion-X++; a lone array of 322 columns; its own rotations",
        (4 * array::WIDTH) as f64 * array::FPS,
    )
};
