//! Ids of HumanML3D: six digits, with `M` before them for mirrored copies.

use crate::source::names::is_number;

/// The id of the original of a mirrored copy: `012314` for `M012314`. `None` for other ids.
pub fn mirrored_of(id: &str) -> Option<&str> {
    id.strip_prefix('M').filter(|id| is_original(id))
}

/// Whether this is an id of HumanML3D: six digits, or `M` and six digits.
pub fn is_id(id: &str) -> bool {
    is_original(id) || mirrored_of(id).is_some()
}

fn is_original(id: &str) -> bool {
    const DIGITS: usize = 6;
    id.len() == DIGITS && is_number(id)
}

/// The id that a clip and its mirror image share.
pub(crate) fn clip_of(id: &str) -> &str {
    mirrored_of(id).unwrap_or(id)
}
