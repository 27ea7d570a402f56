//! Names of rows and tasks that do not come from a system or dataset.

/// Row of the real data: the targets scored as if a system had made them.
pub const REAL_DATA: &str = "Real Data";
/// Row of the identity editor: the originals returned unchanged.
pub const IDENTITY: &str = "Identity";
/// Row of targets composed from other captures; it shows how much two renditions of one target differ.
pub const NOISE_FLOOR: &str = "Noise Floor";

/// The rows that this crate adds to every table, in order.
pub const GIVEN: [&str; 3] = [REAL_DATA, IDENTITY, NOISE_FLOOR];

/// Task of a score over all kinds of edit together.
pub const ALL_TASKS: &str = "all";
/// Task of a score over the items whose target was captured more than once. Only these items have a noise floor.
pub const RECAPTURED: &str = "recaptured";

/// Tasks of a score over the items of one novelty, from items whose parts are all in the training split to items whose
/// edit is not.
pub const NOVELTIES: [&str; 4] = ["retake", "combination", "action", "unshown"];

/// Whether items of several tasks are scored together under this name.
pub fn is_pooled(task: &str) -> bool {
    [ALL_TASKS, RECAPTURED].contains(&task) || NOVELTIES.contains(&task)
}

/// Sort position of a task's table: all items, single tasks, novelties, and items with a noise floor.
pub(crate) fn place_of_task(task: &str) -> usize {
    let novelty = NOVELTIES.iter().position(|novelty| *novelty == task);
    match (task, novelty) {
        (ALL_TASKS, _) => 0,
        (RECAPTURED, _) => 2 + NOVELTIES.len(),
        (_, Some(place)) => 2 + place,
        (_, None) => 1,
    }
}
