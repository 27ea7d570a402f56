//! Options of an import of answers.

use datasets_spec::{Fps, Seed};

/// The vertical axis of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Up {
    /// y up, as in the store.
    Y,
    /// z up, as in AMASS and MotionFix.
    Z,
}

/// Placement of an answer on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Unchanged, as in the file.
    File,
    /// On the floor, with the position and heading of the first frame of the item's source.
    Source,
}

/// Options of an import: the name of the system, and what its files leave out.
#[derive(Clone, Debug)]
pub struct AnswerOptions {
    /// Name of the system in tables.
    pub system: String,
    /// Settings of the system, a JSON object.
    pub settings: String,
    /// Seed of answers that state none; it distinguishes takes of one item.
    pub seed: Seed,
    /// Rate of all answers; it replaces the rates in the files.
    pub fps: Option<Fps>,
    /// Vertical axis of all answers, in place of that of their formats.
    pub up: Option<Up>,
    /// Placement of all answers, in place of that of their formats.
    pub place: Option<Place>,
}
