//! The body parts of the release, and the skeleton as sent to the browser.

use datasets_spec::{BodyPart, Joint};
use kinematics::skeleton::KEYPOINT_PARENTS;

use crate::wire::{PartInfo, SkeletonInfo};

/// Number of body parts of the release.
pub(crate) const NUM_RELEASE_PARTS: usize = 5;
/// The parts of the release, in the order of the actions `part_1` to `part_5` and of the rows of heat and difference.
pub(crate) const RELEASE_PARTS: [BodyPart; NUM_RELEASE_PARTS] = [
    BodyPart::UpperBody,
    BodyPart::LowerBody,
    BodyPart::BothArms,
    BodyPart::LeftArm,
    BodyPart::RightArm,
];

/// The skeleton and the parts, for the browser.
pub(crate) fn skeleton_info() -> SkeletonInfo {
    let others = "left_eye right_eye left_index1 left_ring1 right_index1 right_ring1";
    let names = Joint::ALL.into_iter().map(Joint::name);
    let names: Vec<String> = names.chain(others.split(' ')).map(str::to_owned).collect();
    let side = |name: &String| {
        let side = ["left", "right"]
            .into_iter()
            .find(|side| name.starts_with(side));
        side.unwrap_or("middle").to_owned()
    };
    let indices = |set: datasets_spec::JointSet| set.iter().map(Joint::index).collect();
    let part = |part: BodyPart| PartInfo {
        name: part.name().to_owned(),
        phrase: part.phrase(),
        release: RELEASE_PARTS.contains(&part),
        hard: indices(part.mask().hard()),
        soft: indices(part.mask().soft()),
    };
    SkeletonInfo {
        sides: names.iter().map(side).collect(),
        parents: KEYPOINT_PARENTS
            .iter()
            .map(|&parent| i32::from(parent))
            .collect(),
        parts: BodyPart::ALL.into_iter().map(part).collect(),
        joints: names,
    }
}

#[cfg(test)]
mod tests {
    use kinematics::skeleton::NUM_KEYPOINTS;

    use super::*;

    #[test]
    fn the_skeleton_of_the_browser_is_that_of_the_contract() {
        let info = skeleton_info();
        assert_eq!(info.joints.len(), NUM_KEYPOINTS);
        // Each side has eight joints of the body, an eye and two knuckles.
        for side in ["left", "right"] {
            assert_eq!(info.sides.iter().filter(|name| *name == side).count(), 11);
        }
        let names = info.parts.iter().map(|part| part.name.as_str());
        assert_eq!(
            Vec::from_iter(names.take(5)),
            RELEASE_PARTS.map(BodyPart::name)
        );
        for part in &info.parts {
            let is_apart = part.hard.iter().all(|joint| !part.soft.contains(joint));
            assert!(is_apart, "{}", part.name);
        }
    }
}
