//! From the markers of an optical capture to a body.

mod placement;
mod solve;

pub use placement::{MARKER_SETS, MarkerSet, Placement, bare_label, is_model_output, placement};
pub use solve::{SolveError, Solved, solve};
