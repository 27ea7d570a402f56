//! Body parts that need markers.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

/// A part of the body whose pose markers must determine.
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

/// A part, its name, its joints, the number of markers that it needs, and joints of which at least one must have a
/// marker.
type Needs = (
    Part,
    &'static str,
    &'static [usize],
    usize,
    &'static [usize],
);

const PARTS: [Needs; 7] = [
    (Part::Pelvis, "the pelvis", &[0], 2, &[0]),
    (
        Part::Trunk,
        "the trunk",
        &[3, 6, 9, 13, 14],
        2,
        &[3, 6, 9, 13, 14],
    ),
    (Part::Head, "the head", &[12, 15], 1, &[12, 15]),
    (Part::LeftArm, "the left arm", &[16, 18, 20], 2, &[20]),
    (Part::RightArm, "the right arm", &[17, 19, 21], 2, &[21]),
    (Part::LeftLeg, "the left leg", &[1, 4, 7, 10], 2, &[7, 10]),
    (Part::RightLeg, "the right leg", &[2, 5, 8, 11], 2, &[8, 11]),
];

impl Part {
    /// Parts whose pose cannot be determined from markers on these joints.
    pub(super) fn untold(joints: &[usize]) -> BTreeSet<Self> {
        let untold = PARTS.iter().filter(|(_, _, of, needed, ends)| {
            let on = |of: &[usize]| joints.iter().filter(|joint| of.contains(joint)).count();
            on(of) < *needed || on(ends) == 0
        });
        untold.map(|(part, ..)| *part).collect()
    }
}

/// Joins the names of parts for a message.
pub(super) fn names(parts: &BTreeSet<Part>) -> String {
    let named = PARTS.iter().filter(|(part, ..)| parts.contains(part));
    let names: Vec<&str> = named.map(|(_, name, ..)| *name).collect();
    names.join(", ")
}
