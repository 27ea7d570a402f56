//! HumanML3D's clips cut from AMASS recordings by the published `index.csv`.
//!
//! The stored motion keeps the recording's own rotations. [`features::humanml3d`] computes joints and features from it.
//! The published ones were made with each subject's own body, so they differ by as much as the bodies do.

mod crop;
mod mirror;
mod plan;
#[cfg(test)]
mod tests;

use super::format::Format;

pub use plan::find;
pub use plan::{is_humanact12, recordings};

/// HumanML3D's clips, cut from AMASS by its `index.csv`.
pub const FORMAT: Format = Format::of_releases(
    "humanml3d-amass",
    "AMASS files and --humanml3d-index index.csv; its own rotations, with mirrored copies",
    super::humanml3d::FORMAT.bytes_per_second,
);
