//! Parts of the body that markers must be on.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

/// A part of the body whose pose markers decide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// Hips and sacrum.
    Pelvis,
    /// Chest, back and shoulders.
    Trunk,
    /// Head and neck.
    Head,
    /// Left arm and hand.
    LeftArm,
    /// Right arm and hand.
    RightArm,
    /// Left leg and foot.
    LeftLeg,
    /// Right leg and foot.
    RightLeg,
}

/// Every part with its joints, how many markers it needs, and joints of which one must carry a marker.
const PARTS: [(Part, &[usize], usize, &[usize]); 7] = [
    (Part::Pelvis, &[0], 2, &[0]),
    (Part::Trunk, &[3, 6, 9, 13, 14], 2, &[3, 6, 9, 13, 14]),
    (Part::Head, &[12, 15], 1, &[12, 15]),
    (Part::LeftArm, &[16, 18, 20], 2, &[20]),
    (Part::RightArm, &[17, 19, 21], 2, &[21]),
    (Part::LeftLeg, &[1, 4, 7, 10], 2, &[7, 10]),
    (Part::RightLeg, &[2, 5, 8, 11], 2, &[8, 11]),
];

impl Part {
    /// Name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pelvis => "the pelvis",
            Self::Trunk => "the trunk",
            Self::Head => "the head",
            Self::LeftArm => "the left arm",
            Self::RightArm => "the right arm",
            Self::LeftLeg => "the left leg",
            Self::RightLeg => "the right leg",
        }
    }

    /// Parts whose pose cannot be told from markers on these joints.
    pub(super) fn untold(joints: &[usize]) -> BTreeSet<Self> {
        let untold = PARTS.iter().filter(|(_, of, needed, ends)| {
            let on = |of: &[usize]| joints.iter().filter(|joint| of.contains(joint)).count();
            on(of) < *needed || on(ends) == 0
        });
        untold.map(|(part, ..)| *part).collect()
    }
}

/// Names of parts in a row.
pub(super) fn names(parts: &BTreeSet<Part>) -> String {
    let names: Vec<&str> = parts.iter().map(|part| part.name()).collect();
    names.join(", ")
}
