//! The composition rule of SINC, for training on fixed pairs.

use datasets_spec::{BlendMask, JointSet};

/// The six parts motions are composed of; the first is the root.
const PARTS: [JointSet; 6] = [
    JointSet::of(&[0]),
    JointSet::of(&[3, 6, 9, 12, 15]),
    JointSet::of(&[13, 16, 18, 20]),
    JointSet::of(&[14, 17, 19, 21]),
    JointSet::of(&[1, 4, 7, 10]),
    JointSet::of(&[2, 5, 8, 11]),
];
/// Root and both legs. They are taken together, because feet would slide with another motion's root.
const GROUNDED: [usize; 3] = [0, 4, 5];

/// The mask by SINC's rule: every part that the mask touches is taken whole, root and legs together, without soft
/// joints.
///
/// # Source
/// Athanasiou et al., "SINC: Spatial Composition of 3D Human Motions" (2023), and its code.
pub(super) fn whole_parts(mask: BlendMask) -> BlendMask {
    let touched = |part: usize| !PARTS[part].intersection(mask.hard()).is_empty();
    let grounded = GROUNDED.into_iter().any(touched);
    let taken = (0..PARTS.len())
        .filter(|part| touched(*part) || (grounded && GROUNDED.contains(part)))
        .fold(JointSet::EMPTY, |all, part| all.union(PARTS[part]));
    BlendMask::new(taken, JointSet::EMPTY).expect("nothing is soft")
}

#[cfg(test)]
mod tests {
    use datasets_spec::BodyPart;

    use super::*;

    #[test]
    fn parts_are_taken_whole_and_legs_with_the_root() {
        let hard = |part: BodyPart| whole_parts(part.mask()).hard();
        assert_eq!(hard(BodyPart::LeftArm), JointSet::of(&[13, 16, 18, 20]));
        let legs = JointSet::of(&[0, 1, 2, 4, 5, 7, 8, 10, 11]);
        assert_eq!(hard(BodyPart::LowerBody), legs);
        assert_eq!(hard(BodyPart::RightLeg), legs);
        assert_eq!(hard(BodyPart::Head), JointSet::of(&[3, 6, 9, 12, 15]));
        for part in BodyPart::ALL {
            let mask = whole_parts(part.mask());
            assert!(mask.soft().is_empty());
            assert_eq!(whole_parts(mask), mask, "{part} twice");
        }
    }
}
