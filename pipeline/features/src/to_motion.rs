//! Rotations of a SMPL body from its joint positions.
//!
//! The 263 features and the joint files of HumanML3D hold the direction of each bone but not its twist:
//! the rotations among the features are the shortest ones from an axis to the bone. Some twists follow
//! from anatomy: pelvis and chest are aligned to the bones that leave them, and thighs and upper arms are
//! twisted so that knees and elbows bend about their hinges.

use datasets_spec::{Fps, Motion, Pose, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::KeypointFrame;
use kinematics::fit::{FitOptions, fit_motion};
use kinematics::rotation::arc;
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS, parent_of};

use super::humanml3d::{
    FeatureError, Features, Joints, UNIFORM_BONES, directions_of_joints, recover_directions,
};
use super::smpl_body::{SMPL_REST_BONES, smpl_body};
use crate::floor;

/// The limbs of two bones: first, middle and last joint, and the axis about which each bends at rest.
const LIMBS: [([usize; 3], DVec3); 4] = [
    ([1, 4, 7], DVec3::X),
    ([2, 5, 8], DVec3::X),
    ([16, 18, 20], DVec3::NEG_Y),
    ([17, 19, 21], DVec3::Y),
];
/// Sine of the bend from which a hinge sets the full twist; a straighter limb gets less.
const CLEAR_BEND: f64 = 0.5;

/// The bone of SMPL's rest pose that ends in a joint.
fn rest_bone(joint: usize) -> DVec3 {
    DVec3::from_array(SMPL_REST_BONES[joint])
}

/// Fits the body to the positions of the 22 joints: scales the bones of the source to the body's lengths, and finds the
/// least-squares pose. Also returns the mean distance in metres between the scaled joints and those of the pose.
///
/// The mean distance on a published clip is 0.9 cm, because SMPL bodies differ in shape. Aligning bone
/// directions alone, as [`motion_of_features`] does, gives 1.1 cm and less smooth rotations.
///
/// # Errors
/// There is no frame, or a bone without a direction.
pub fn motion_of_joints(
    joints: &[Joints],
    fps: Fps,
    skeleton: &Skeleton,
) -> Result<(Motion, f32), FeatureError> {
    let Some(first) = joints.first() else {
        return Err(FeatureError::TooShort { frames: 0 });
    };
    let leg = (first[5] - first[2]).length() + (first[8] - first[5]).length();
    let scale = body_leg(skeleton) / leg;
    let targets: Vec<KeypointFrame> = directions_of_joints(joints)?
        .iter()
        .map(|(root, directions)| {
            // Keypoints that SMPL lacks have no weight.
            let mut target = [*root * scale; NUM_KEYPOINTS];
            for joint in 1..NUM_BODY_JOINTS {
                let bone = directions[joint] * skeleton.offset(joint).length();
                target[joint] = target[parent_of(joint)] + bone;
            }
            target
        })
        .collect();
    let options = FitOptions::body_joints();
    let fitted = fit_motion(&smpl_body(skeleton), &targets, fps, &options)
        .map_err(FeatureError::no_motion)?;
    let error = fitted.error_m.iter().sum::<f64>() / fitted.error_m.len() as f64;
    let mut poses: Vec<Pose> = fitted.motion.poses();
    floor::put_on_floor(&mut poses, fps, skeleton);
    let motion = Motion::from_poses(fps, &poses).map_err(FeatureError::no_motion)?;
    Ok((motion, error as f32))
}

/// Poses the body with the bone directions given by the rotations of HumanML3D features. Also returns the mean distance
/// in metres between the joints of the source and those of the pose, both with the bone lengths of SMPL.
///
/// # Errors
/// There is no frame, or a number is not finite.
pub fn motion_of_features(
    features: &[Features],
    fps: Fps,
    skeleton: &Skeleton,
) -> Result<(Motion, f32), FeatureError> {
    let leg = UNIFORM_BONES[5] + UNIFORM_BONES[8];
    motion_of_directions(&recover_directions(features), leg, fps, skeleton)
}

/// Poses the body by the position of the root and the directions of the bones, frame by frame.
/// The path is scaled by the ratio of the body's leg length to the source's, `leg_m`.
fn motion_of_directions(
    frames: &[(DVec3, Joints)],
    leg_m: f64,
    fps: Fps,
    skeleton: &Skeleton,
) -> Result<(Motion, f32), FeatureError> {
    if frames.is_empty() {
        return Err(FeatureError::TooShort { frames: 0 });
    }
    let scale = body_leg(skeleton) / leg_m;
    let mut error = 0.0;
    let mut poses: Vec<Pose> = frames
        .iter()
        .map(|(root, directions)| {
            let globals = global_rotations(directions);
            error += distance(directions, &globals);
            Pose {
                transl: *root * scale - skeleton.rest(0),
                rotations: locals(&globals),
            }
        })
        .collect();
    floor::put_on_floor(&mut poses, fps, skeleton);
    let motion = Motion::from_poses(fps, &poses).map_err(FeatureError::no_motion)?;
    Ok((motion, (error / frames.len() as f64) as f32))
}

/// Length in metres of the body's right leg, which the published recipe measures.
fn body_leg(skeleton: &Skeleton) -> f64 {
    skeleton.offset(5).length() + skeleton.offset(8).length()
}

fn locals(globals: &[DQuat; NUM_BODY_JOINTS]) -> [DQuat; NUM_BODY_JOINTS] {
    std::array::from_fn(|joint| match joint {
        0 => globals[0],
        _ => (globals[parent_of(joint)].conjugate() * globals[joint]).normalize(),
    })
}

/// The rotation of each joint in the world.
fn global_rotations(directions: &Joints) -> [DQuat; NUM_BODY_JOINTS] {
    let mut globals = [DQuat::IDENTITY; NUM_BODY_JOINTS];
    globals[0] = frame_turn(directions, [1, 2, 3]);
    for (joint, bone) in [(3, 6), (6, 9)] {
        globals[joint] = swing(globals[parent_of(joint)], bone, directions);
    }
    globals[9] = frame_turn(directions, [13, 14, 12]);
    globals[12] = swing(globals[9], 15, directions);
    globals[15] = globals[12];
    for (joint, bone) in [(13, 16), (14, 17)] {
        globals[joint] = swing(globals[9], bone, directions);
    }
    for ([upper, middle, end], hinge) in LIMBS {
        let swung = swing(globals[parent_of(upper)], middle, directions);
        let bones = [directions[middle], directions[end]];
        globals[upper] = twist(bones, swung * hinge) * swung;
        globals[middle] = swing(globals[upper], end, directions);
        globals[end] = globals[middle];
    }
    for (ankle, foot) in [(7, 10), (8, 11)] {
        globals[ankle] = swing(globals[ankle], foot, directions);
        globals[foot] = globals[ankle];
    }
    globals
}

/// The smallest rotation from the parent's that aligns the bone.
fn swing(above: DQuat, bone: usize, directions: &Joints) -> DQuat {
    let carried = above * rest_bone(bone).normalize();
    (arc(carried, directions[bone]) * above).normalize()
}

/// The rotation of a joint with a left, a right and an upward bone.
fn frame_turn(directions: &Joints, [left, right, up]: [usize; 3]) -> DQuat {
    let axes = |bone: &dyn Fn(usize) -> DVec3| {
        let lengths = [left, right].map(|joint| rest_bone(joint).length());
        let x = (bone(left) * lengths[0] - bone(right) * lengths[1]).normalize_or(DVec3::X);
        let down = (bone(left) * lengths[0] + bone(right) * lengths[1]) / 2.0;
        let rough_up =
            bone(up) * rest_bone(up).length() - if left == 1 { down } else { DVec3::ZERO };
        let y = (rough_up - x * rough_up.dot(x)).normalize_or(x.any_orthonormal_vector());
        DMat3::from_cols(x, y, x.cross(y))
    };
    let seen = axes(&|joint| directions[joint]);
    let rest = axes(&|joint| rest_bone(joint).normalize());
    DQuat::from_mat3(&(seen * rest.transpose())).normalize()
}

/// The rotation about the upper of two bones that turns `hinge` onto the axis about which the limb bends. The
/// straighter the limb, the smaller the rotation: a straight limb has no such axis.
fn twist([upper, lower]: [DVec3; 2], hinge: DVec3) -> DQuat {
    let axis = upper.cross(lower);
    let weight = (axis.length() / CLEAR_BEND).min(1.0);
    let hinge = (hinge - upper * hinge.dot(upper)).normalize_or_zero();
    let bent = axis.normalize_or_zero();
    if hinge == DVec3::ZERO || bent == DVec3::ZERO {
        return DQuat::IDENTITY;
    }
    let angle = hinge.cross(bent).dot(upper).atan2(hinge.dot(bent));
    // A knee or elbow bent the wrong way is noise rather than a twist by half a turn.
    let believable = angle.abs() < std::f64::consts::FRAC_PI_2;
    let angle = if believable { angle * weight } else { 0.0 };
    DQuat::from_axis_angle(upper, angle)
}

/// Mean distance between the joints by directions and the joints by rotations.
fn distance(directions: &Joints, globals: &[DQuat; NUM_BODY_JOINTS]) -> f64 {
    let mut seen = [DVec3::ZERO; NUM_BODY_JOINTS];
    let mut posed = [DVec3::ZERO; NUM_BODY_JOINTS];
    let mut sum = 0.0;
    for joint in 1..NUM_BODY_JOINTS {
        let (above, bone) = (parent_of(joint), rest_bone(joint));
        seen[joint] = seen[above] + directions[joint] * bone.length();
        posed[joint] = posed[above] + globals[above] * bone;
        sum += (seen[joint] - posed[joint]).length();
    }
    sum / NUM_BODY_JOINTS as f64
}

#[cfg(test)]
mod tests {
    use testkit::wandering;

    use super::*;
    use crate::humanml3d::{features_of_joints, joints_of_motion, recover_joints};

    /// The joints of the SMPL rest body under the rotations of a motion.
    fn smpl_joints(motion: &Motion) -> Vec<Joints> {
        (0..motion.len())
            .map(|frame| {
                let pose = motion.pose(frame);
                let mut globals = pose.rotations;
                let mut joints = [pose.transl; NUM_BODY_JOINTS];
                for joint in 1..NUM_BODY_JOINTS {
                    let above = parent_of(joint);
                    joints[joint] = joints[above] + globals[above] * rest_bone(joint);
                    globals[joint] = globals[above] * pose.rotations[joint];
                }
                joints
            })
            .collect()
    }

    #[test]
    fn the_posed_body_has_the_bones_of_the_source() {
        let skeleton = Skeleton::smplx_neutral();
        let motion = wandering("to-motion", 40);
        let joints = smpl_joints(&motion);
        let (found, error) = motion_of_joints(&joints, Fps::STORE, &skeleton).expect("a body");
        // The three bones at pelvis and chest are rigid both in the source and here. Only the twists of hands and head
        // are free, and no joint position depends on these.
        assert!(error < 1e-6, "{error}");
        for (a, b) in smpl_joints(&found).iter().zip(&joints) {
            for joint in 1..NUM_BODY_JOINTS {
                let direction =
                    |points: &Joints| (points[joint] - points[parent_of(joint)]).normalize();
                assert!(direction(a).angle_between(direction(b)) < 1e-3, "{joint}");
            }
        }
    }

    #[test]
    fn a_bent_knee_turns_the_thigh_as_it_was_turned() {
        let skeleton = Skeleton::smplx_neutral();
        let mut pose = Pose::REST;
        let thigh = DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(-0.9);
        pose.rotations[1] = thigh;
        pose.rotations[4] = DQuat::from_rotation_x(1.2);
        let motion = Motion::from_poses(Fps::STORE, &[pose; 2]).expect("valid");
        let joints = smpl_joints(&motion);
        let (found, _) = motion_of_joints(&joints, Fps::STORE, &skeleton).expect("a body");
        let angle = found.pose(0).rotations[1].angle_between(thigh);
        // The rest bones of the leg are not quite straight, so the hinge is off by a few degrees.
        assert!(angle < 0.12, "{angle}");
    }

    #[test]
    fn rotations_and_positions_of_a_clip_pose_the_same_body() {
        let skeleton = Skeleton::smplx_neutral();
        let joints = smpl_joints(&wandering("to-motion", 40));
        let features = features_of_joints(&joints).expect("a clip");
        let (pointed, error) =
            motion_of_features(&features, Fps::STORE, &skeleton).expect("a body");
        assert!(error < 1e-5, "{error}");
        let recovered = recover_joints(&features);
        let (fitted, _) = motion_of_joints(&recovered, Fps::STORE, &skeleton).expect("a body");
        let body = smpl_body(&skeleton);
        let [pointed, fitted] = [pointed, fitted].map(|motion| joints_of_motion(&motion, &body));
        for (a, b) in pointed.iter().flatten().zip(fitted.iter().flatten()) {
            // Features store positions and rotations in f32, and the root's path is a sum of f32 steps.
            assert!(a.distance(*b) < 1e-3, "{a} and {b}");
        }
    }

    #[test]
    fn a_body_of_other_proportions_is_fitted_nearby() {
        let skeleton = Skeleton::smplx_neutral();
        // The joints of SMPL-X. The triangles at its pelvis and chest differ from SMPL's.
        let joints = joints_of_motion(&wandering("proportions", 40), &skeleton);
        let directions = directions_of_joints(&joints).expect("bones");
        let leg = body_leg(&skeleton);
        let (_, pointed) =
            motion_of_directions(&directions, leg, Fps::STORE, &skeleton).expect("a body");
        let (_, fitted) = motion_of_joints(&joints, Fps::STORE, &skeleton).expect("a body");
        // Measured 4 mm and 11 mm.
        assert!(fitted < 0.006 && fitted < pointed, "{fitted} and {pointed}");
    }

    #[test]
    fn no_frames_are_an_error() {
        let skeleton = Skeleton::smplx_neutral();
        assert!(motion_of_joints(&[], Fps::STORE, &skeleton).is_err());
        assert!(motion_of_features(&[], Fps::STORE, &skeleton).is_err());
    }
}
