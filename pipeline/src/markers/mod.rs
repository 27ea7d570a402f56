//! From the markers of an optical capture to a body.

mod outcome;
mod placement;
mod solve;

pub(crate) use outcome::{metres_of_unit, outcome, unique_labels};
pub use placement::{MARKER_SETS, MarkerSet, Placement, bare_label, is_model_output, placement};
pub use solve::{SolveError, Solved, solve};
