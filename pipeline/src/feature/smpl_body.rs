//! The body that HumanML3D's joints are those of, for motions of another one.

use datasets_spec::Skeleton;
use glam::DVec3;
use kinematics::skeleton::{NUM_JOINTS, PARENTS};

use super::to_motion::SMPL_REST_BONES;

/// A body whose bones point at rest as those of SMPL and have the lengths of another body's.
///
/// SMPL-X has its spine, neck, collars and head elsewhere than SMPL, so that its joints, taken for
/// those of SMPL, would show a bent back and a raised chin: a published clip that went through the
/// store comes back 3.2 cm away on average by SMPL-X's joints, 1.3 cm by these. Keeping the lengths
/// keeps the height of the pelvis true to the legs, which the recipe scales the path by.
pub fn smpl_body(skeleton: &Skeleton) -> Skeleton {
    let mut joints = [DVec3::ZERO; NUM_JOINTS];
    for joint in 0..NUM_JOINTS {
        let offset = skeleton.offset(joint);
        let smpl = SMPL_REST_BONES.get(joint).copied().unwrap_or_default();
        // Zero for the root, whose rest position is kept, and for joints that SMPL lacks.
        let bone = match DVec3::from_array(smpl).try_normalize() {
            Some(direction) => direction * offset.length(),
            None => offset,
        };
        // A parent stands before its children.
        let parent = usize::try_from(PARENTS[joint]).map_or(DVec3::ZERO, |parent| joints[parent]);
        joints[joint] = parent + bone;
    }
    Skeleton::new(skeleton.name(), joints)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_kept_and_directions_are_those_of_smpl() {
        let skeleton = Skeleton::smplx_neutral();
        let body = smpl_body(&skeleton);
        assert_eq!(body.rest(0), skeleton.rest(0));
        for joint in 1..NUM_JOINTS {
            let apart = body.offset(joint).length() - skeleton.offset(joint).length();
            assert!(apart.abs() < 1e-12, "{joint}");
            if let Some(smpl) = SMPL_REST_BONES.get(joint) {
                let angle = body.offset(joint).angle_between(DVec3::from_array(*smpl));
                // The arccosine near one is good to half the digits.
                assert!(angle < 1e-7, "{joint}");
            }
        }
    }
}
