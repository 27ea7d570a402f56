//! Options of an import of answers.

use datasets_spec::{Fps, Seed};
use formats::source::Up;

/// Placement of an answer on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Unchanged, as in the file.
    File,
    /// On the floor, with the position and heading of the first frame of the item's source.
    Source,
}

/// Options of an import: the system, and facts that its files do not state.
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
    /// Up axis of all answers; `None`: that of each file's format.
    pub up: Option<Up>,
    /// Placement of all answers; `None`: that of each file's format.
    pub place: Option<Place>,
}
