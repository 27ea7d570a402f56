//! The STANCE release: base motions, body-part annotations, style transfers and fine-grained
//! adjustments, in its present layout and under the path names of its earlier revision.
//!
//! A folder is a release if it holds a pickle under `base_motion`, `style_transfer` or `adjustment`, at
//! any depth. Motions are not moved: they are y up already, and the two motions of an adjustment share
//! world coordinates.

mod annotation;
mod labels;
mod motion;
mod name;
pub mod origin;
mod release;
mod split;

use kinematics::motion::BODY_POSE_WIDTH;

use super::files::Files;
use super::format::{Format, Release, boxed};

pub use motion::read_pickle_motion;
pub use name::{FIRST_FREE_NUMBER, file_stem};
pub use origin::exported_labels;
pub use release::{ADJUSTMENT, BASE_MOTION, REGEN, SPLIT, STYLE_TRANSFER};

/// The releases among the files.
pub fn find(files: &Files) -> Vec<Box<dyn Release>> {
    let roots = release::roots(files).into_iter();
    boxed(roots.map(|root| release::StanceRelease::plan(files, root)))
}

/// A folder of the STANCE release.
// Bytes per second: the parameters of the store in f4 at 20 fps.
pub const FORMAT: Format = Format {
    extensions: &["pkl", "pickle"],
    read: |_, _, bytes, options| motion::read_pickle(bytes, &options.skeleton),
    find,
    ..Format::of_releases(
        "stance",
        "a folder of the STANCE release, in its present or older paths; a lone pickle; its own rotations, with masks \
         and pairs",
        (4 * (3 + 3 + BODY_POSE_WIDTH) * 20) as f64,
    )
};

#[cfg(test)]
mod tests;
