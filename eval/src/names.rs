//! Names of the table rows and tasks that no system and no dataset brings along.

/// Row of the real data: the targets scored as if a system had made them.
pub const REAL_DATA: &str = "Real Data";
/// Row of the identity editor: the originals returned unchanged.
pub const IDENTITY: &str = "Identity";
/// Row of targets composed from other captures: how far apart two renditions of one target are.
pub const NOISE_FLOOR: &str = "Noise Floor";

/// The rows of every table that are computed here, in their order.
pub(crate) const GIVEN: [&str; 3] = [REAL_DATA, IDENTITY, NOISE_FLOOR];

/// Task of a score over all kinds of edit together.
pub const ALL_TASKS: &str = "all";
/// Task of a score over the items whose target was captured more than once. Only they have a noise
/// floor.
pub const RECAPTURED: &str = "recaptured";
