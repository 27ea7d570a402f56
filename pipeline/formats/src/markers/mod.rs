//! Solves a body from the markers of an optical capture.

mod capture;
mod error;
mod label;
mod part;
mod set;
mod solve;
mod worn;

pub use capture::{Capture, CaptureUnit};
pub(crate) use capture::{MAX_DISTANCE_M, Positions, UNIT_CODE, unique_labels};
pub(crate) use error::some_of;
pub(crate) use label::{keys, model_outputs, subject_of};
pub use part::Part;
pub use set::{MarkerSet, MarkerSetError, Placement, bare_label, marker_sets};
