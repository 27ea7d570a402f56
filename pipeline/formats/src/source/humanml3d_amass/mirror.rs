//! Mirror images of motions and bodies.

use datasets_spec::{Joint, Motion, Skeleton};
use glam::DVec3;
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_JOINTS};

use features::floor;

/// The mirror image of a motion in the sagittal plane: each joint gets the rotation `(rx, -ry, -rz)`
/// of its counterpart, and x changes its sign.
///
/// The rest skeleton is not symmetric, so joints differ from mirrored joints by up to 3.5 cm.
pub(crate) fn mirror(motion: &Motion) -> Motion {
    let mut mirrored = motion.clone();
    for frame in 0..motion.len() {
        let [x, y, z] = motion.transl()[frame];
        mirrored.set_transl(frame, [-x, y, z]);
        for joint in Joint::ALL {
            let [rx, ry, rz] = motion.axis_angle(frame, joint.mirrored().index());
            mirrored.set_axis_angle(frame, joint.index(), [rx, -ry, -rz]);
        }
    }
    debug_assert_eq!(Joint::ALL.len(), NUM_BODY_JOINTS);
    mirrored
}

/// The mirror image of a rest skeleton, for motions mirrored by [`mirror`].
pub(super) fn mirrored_body(body: &Skeleton) -> Skeleton {
    let mut joints: [DVec3; NUM_JOINTS] = std::array::from_fn(|joint| body.rest(joint));
    for joint in Joint::ALL {
        let [x, y, z] = body.rest(joint.mirrored().index()).to_array();
        joints[joint.index()] = DVec3::new(-x, y, z);
    }
    Skeleton::new(body.name(), joints)
}

pub(super) fn on_floor(mut motion: Motion, skeleton: &Skeleton) -> Motion {
    let mut poses: Vec<_> = motion.poses();
    let rise = floor::put_on_floor(&mut poses, motion.fps(), skeleton);
    for frame in 0..motion.len() {
        let [x, y, z] = motion.transl()[frame];
        motion.set_transl(frame, [x, (f64::from(y) + rise) as f32, z]);
    }
    motion
}
