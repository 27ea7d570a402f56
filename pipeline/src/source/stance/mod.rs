//! The STANCE release: base motions, body-part annotations, style transfers and fine-grained
//! adjustments, in its present layout and under the path names of its earlier revision.
//!
//! A folder is a release if a pickle lies under `base_motion`, `style_transfer` or `adjustment` in
//! it, at any depth. Motions keep their numbers: they are y up already, and the two motions of an
//! adjustment share a world, so that neither is moved to a floor of its own.

mod annotation;
mod motion;
mod name;
pub(crate) mod origin;
mod release;
mod split;

use super::{Files, Release};
use crate::clip::Rejected;

pub use motion::read_pickle_motion;
pub(crate) use name::{FIRST_FREE_NUMBER, file_stem};
pub(crate) use release::{ADJUSTMENT, BASE_MOTION, REGEN, SPLIT, STYLE_TRANSFER};

/// The releases among the files.
pub fn find(files: &Files) -> Vec<Box<dyn Release>> {
    release::roots(files)
        .into_iter()
        .map(|root| Box::new(release::StanceRelease::plan(files, root)) as Box<dyn Release>)
        .collect()
}

fn rejected_json(file: &str, error: &serde_json::Error) -> Rejected {
    Rejected::read("E-STANCE-JSON", format!("{file} is no such list ({error})"))
}

#[cfg(test)]
pub(crate) mod tests;
