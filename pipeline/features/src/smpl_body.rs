//! The SMPL body, to which HumanML3D's joints belong, for motions of another body.

use datasets_spec::Skeleton;
use glam::DVec3;
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_JOINTS, PARENTS};

/// Bones of the neutral SMPL body at rest, by the joint at the bone's end, in metres. HumanML3D uses this body, whose
/// spine and shoulders differ from SMPL-X's. Rotations relative to these bones drive either body.
///
/// # Source
/// Stanford-TML/EDGE, the offset table of its visualisation.
pub(crate) const SMPL_REST_BONES: [[f64; 3]; NUM_BODY_JOINTS] = [
    [0.0, 0.0, 0.0],
    [0.05858135, -0.08228004, -0.01766408],
    [-0.06030973, -0.09051332, -0.01354254],
    [0.00443945, 0.12440352, -0.03838522],
    [0.04345142, -0.38646945, 0.008037],
    [-0.04325663, -0.38368791, -0.00484304],
    [0.00448844, 0.1379564, 0.02682033],
    [-0.01479032, -0.42687458, -0.037428],
    [0.01905555, -0.4200455, -0.03456167],
    [-0.00226458, 0.05603239, 0.00285505],
    [0.04105436, -0.06028581, 0.12204243],
    [-0.03483987, -0.06210566, 0.13032329],
    [-0.0133902, 0.21163553, -0.03346758],
    [0.07170245, 0.11399969, -0.01889817],
    [-0.08295366, 0.11247234, -0.02370739],
    [0.01011321, 0.08893734, 0.05040987],
    [0.12292141, 0.04520509, -0.019046],
    [-0.11322832, 0.04685326, -0.00847207],
    [0.2553319, -0.01564902, -0.02294649],
    [-0.26012748, -0.01436928, -0.03126873],
    [0.26570925, 0.01269811, -0.00737473],
    [-0.26910836, 0.00679372, -0.00602676],
];

/// A body with SMPL's bone directions at rest and another body's bone lengths.
///
/// Spine, neck, collars and head of SMPL-X differ from SMPL's: if its joints were used as SMPL's, the back would look
/// bent and the chin raised. A published clip that is ingested and exported again differs by 3.2 cm on average with
/// SMPL-X's joints, and by 1.3 cm with these. The lengths are kept because the recipe scales the path by the leg
/// length.
pub fn smpl_body(skeleton: &Skeleton) -> Skeleton {
    let mut joints = [DVec3::ZERO; NUM_JOINTS];
    for joint in 0..NUM_JOINTS {
        let offset = skeleton.offset(joint);
        let smpl = SMPL_REST_BONES.get(joint).copied().unwrap_or_default();
        // The SMPL bone is zero for the root, whose rest position is kept, and for joints that SMPL lacks.
        let bone = match DVec3::from_array(smpl).try_normalize() {
            Some(direction) => direction * offset.length(),
            None => offset,
        };
        // A parent precedes its children.
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
