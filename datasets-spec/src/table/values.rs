//! Values of several fields.

use serde::{Deserialize, Serialize};

/// A caption and the part of the clip that it describes. `from_s` and `to_s` are both 0 if it describes the whole clip
/// (HumanML3D's convention).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Caption {
    /// The text.
    pub text: String,
    /// Its tokens as `lemma/POS`, separated by spaces; empty if the source has none.
    pub tokens: String,
    /// Start in seconds.
    pub from_s: f32,
    /// End in seconds.
    pub to_s: f32,
}

/// Description of what one body part does.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PartCaption {
    /// Name of the part in the release's spelling, such as `LEFT_ARM`.
    pub part: String,
    /// The description, completing "The person is ...".
    pub text: String,
}

/// Findings of the quality checks on a clip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// Bit set of the findings; see [`crate::flags`].
    pub flags: u32,
    /// Highest joint speed in m/s.
    pub max_speed: f32,
    /// Mean speed of a planted foot over the ground in m/s.
    pub foot_skate: f32,
}
