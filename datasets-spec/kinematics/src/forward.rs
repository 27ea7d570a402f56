//! Forward kinematics: where the joints are, given the rotations.

use std::ops::Range;

use glam::{DQuat, DVec3};

use crate::motion::{Keypoints, Motion};
use crate::pose::Pose;
use crate::simd::blocks::{self, Rest};
use crate::skeleton::{
    KEYPOINT_JOINTS, KEYPOINT_PARENTS, NUM_BODY_JOINTS, NUM_KEYPOINTS, Skeleton,
};

/// Global positions of a chain of joints.
///
/// # Shapes
/// `rest_joints`, `parents` and `rotations` are `[J]`; the result is `[J]`. A root has parent -1,
/// and every parent precedes its children.
///
/// # Panics
/// If the slices differ in length or a parent follows its child.
///
/// # Source
/// SMPL-X: `p_0 = J_0 + transl`, `p_i = p_k + R_k (J_i - J_k)` with `k` the parent of `i` and `R`
/// the global rotations; the root turns about its own rest position.
pub fn forward(
    rest_joints: &[DVec3],
    parents: &[i8],
    rotations: &[DQuat],
    transl: DVec3,
) -> Vec<DVec3> {
    assert_eq!(rest_joints.len(), parents.len());
    assert_eq!(rest_joints.len(), rotations.len());
    let mut global: Vec<DQuat> = Vec::with_capacity(parents.len());
    let mut points: Vec<DVec3> = Vec::with_capacity(parents.len());
    for (joint, &parent) in parents.iter().enumerate() {
        match usize::try_from(parent) {
            Ok(parent) => {
                let offset = rest_joints[joint] - rest_joints[parent];
                points.push(points[parent] + global[parent] * offset);
                global.push(global[parent] * rotations[joint]);
            }
            Err(_) => {
                points.push(rest_joints[joint] + transl);
                global.push(rotations[joint]);
            }
        }
    }
    points
}

impl Skeleton {
    /// Global rotations of the 22 body joints of a pose.
    pub fn global_rotations(&self, pose: &Pose) -> [DQuat; NUM_BODY_JOINTS] {
        let mut global = pose.rotations;
        for joint in 1..NUM_BODY_JOINTS {
            let parent = usize::try_from(KEYPOINT_PARENTS[joint]).unwrap_or(0);
            global[joint] = global[parent] * pose.rotations[joint];
        }
        global
    }

    /// The 28 keypoints of a pose in metres.
    ///
    /// # Source
    /// Paper App. B.1. The eyes turn with the head and the knuckles with the wrist, so the 22 body
    /// rotations determine all of them.
    pub fn keypoints(&self, pose: &Pose) -> [DVec3; NUM_KEYPOINTS] {
        let global = self.global_rotations(pose);
        let mut points = [self.rest(0) + pose.transl; NUM_KEYPOINTS];
        for slot in 1..NUM_KEYPOINTS {
            let parent = usize::try_from(KEYPOINT_PARENTS[slot]).unwrap_or(0);
            let offset = self.rest(KEYPOINT_JOINTS[slot]) - self.rest(KEYPOINT_JOINTS[parent]);
            points[slot] = points[parent] + global[parent] * offset;
        }
        points
    }

    /// The keypoints of every frame of a motion.
    pub fn motion_keypoints(&self, motion: &Motion) -> Keypoints {
        Keypoints {
            fps: motion.fps(),
            points: self.points_of_frames(motion, 0..motion.len()),
        }
    }

    /// The first `K` of the 28 keypoints, in metres, of some frames of a motion; the first 22 are
    /// the body joints.
    ///
    /// # Shapes
    /// `[T, K]`.
    ///
    /// # Panics
    /// If `K` is 0 or more than 28, or a frame does not exist.
    pub fn points_of_frames<const K: usize>(
        &self,
        motion: &Motion,
        frames: Range<usize>,
    ) -> Vec<[DVec3; K]> {
        blocks::keypoints_of(self, motion.columns(frames))
    }

    /// The first `K` of the 28 keypoints of poses, in metres.
    ///
    /// # Shapes
    /// `[T, K]`.
    ///
    /// # Panics
    /// If `K` is 0 or more than 28.
    pub fn points_of_poses<const K: usize>(&self, poses: &[Pose]) -> Vec<[DVec3; K]> {
        blocks::keypoints_of(self, poses)
    }
}

/// Forward kinematics of many frames in single precision, with a plane for every number: the form
/// networks are trained in.
///
/// Over a chain of eight joints the error is about a micrometre.
#[derive(Clone, Debug)]
pub struct PlaneKinematics {
    rest: Rest<f32>,
}

impl PlaneKinematics {
    /// Numbers of a frame of parameters: translation, root and 21 body rotations.
    pub const PARAMETERS: usize = blocks::PARAMETERS;
    /// Numbers of a frame of keypoints.
    pub const POINTS: usize = 3 * NUM_KEYPOINTS;

    /// Kinematics of a body.
    pub fn new(skeleton: &Skeleton) -> Self {
        Self {
            rest: Rest::of(skeleton),
        }
    }

    /// The keypoints in metres of parameters in metres and radians.
    ///
    /// # Shapes
    /// `parameters` is `[69, T]`: x, y and z of the translation, then of the rotation vector of each
    /// of the 22 body joints. `points` becomes `[84, T]`.
    ///
    /// # Panics
    /// If the slices do not have these lengths.
    pub fn keypoints(&self, num_frames: usize, parameters: &[f32], points: &mut [f32]) {
        blocks::keypoint_planes(&self.rest, num_frames, parameters, points);
    }
}

/// The frames of a motion as planes, `[69, T]`, for [`PlaneKinematics::keypoints`].
pub fn parameter_planes(motion: &Motion) -> Vec<f32> {
    let num_frames = motion.len();
    let mut planes = vec![0.0; PlaneKinematics::PARAMETERS * num_frames];
    for frame in 0..num_frames {
        let columns = motion.transl()[frame]
            .iter()
            .chain(&motion.global_orient()[frame])
            .chain(&motion.body_pose()[frame]);
        for (plane, value) in columns.enumerate() {
            planes[plane * num_frames + frame] = *value;
        }
    }
    planes
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use proptest::prelude::*;

    use super::*;
    use crate::rotation::from_axis_angle;
    use crate::skeleton::PARENTS;

    #[test]
    fn the_rest_pose_is_the_rest_table() {
        let skeleton = Skeleton::smplx_neutral();
        for (slot, point) in skeleton.keypoints(&Pose::REST).into_iter().enumerate() {
            assert!((point - skeleton.rest(KEYPOINT_JOINTS[slot])).length() < 1e-15);
        }
    }

    #[test]
    fn a_two_bone_chain_bends_by_hand() {
        let rest = [DVec3::ZERO, DVec3::X, DVec3::X * 2.0];
        let quarter = from_axis_angle(DVec3::Z * FRAC_PI_2);
        let rotations = [quarter, quarter, DQuat::IDENTITY];
        let points = forward(&rest, &[-1, 0, 1], &rotations, DVec3::Z);
        assert!((points[1] - DVec3::new(0.0, 1.0, 1.0)).length() < 1e-15);
        assert!((points[2] - DVec3::new(-1.0, 1.0, 1.0)).length() < 1e-15);
    }

    fn pose() -> impl Strategy<Value = Pose> {
        prop::collection::vec(prop::array::uniform3(-3.0..3.0), NUM_BODY_JOINTS + 1).prop_map(|v| {
            Pose {
                transl: DVec3::from_array(v[NUM_BODY_JOINTS]),
                rotations: std::array::from_fn(|joint| {
                    from_axis_angle(DVec3::from_array(v[joint]))
                }),
            }
        })
    }

    #[test]
    fn planes_agree_with_frames() {
        let skeleton = Skeleton::smplx_neutral();
        for num_frames in [1, 15, 16, 17, 50] {
            let poses: Vec<Pose> = (0..num_frames)
                .map(|frame| Pose {
                    transl: DVec3::new(0.1, 0.9, 0.02) * f64::from(frame),
                    rotations: std::array::from_fn(|joint| {
                        let angle = 0.3 * f64::from(frame) + joint as f64;
                        from_axis_angle(DVec3::new(angle.sin(), angle.cos(), 0.7))
                    }),
                })
                .collect();
            let motion = Motion::from_poses(crate::Fps::STORE, &poses).expect("finite");
            let num_frames = motion.len();
            let mut points = vec![0.0; PlaneKinematics::POINTS * num_frames];
            let planes = parameter_planes(&motion);
            PlaneKinematics::new(&skeleton).keypoints(num_frames, &planes, &mut points);
            let expected = skeleton.motion_keypoints(&motion);
            for (frame, expected) in expected.points.iter().enumerate() {
                let single = skeleton.keypoints(&motion.pose(frame));
                for (a, b) in expected.iter().zip(&single) {
                    assert!((*a - *b).length() < 1e-12);
                }
                for (slot, expected) in expected.iter().enumerate() {
                    for axis in 0..3 {
                        let found = points[(3 * slot + axis) * num_frames + frame];
                        // A chain of eight rotations in f32, up to 50 m from the origin.
                        assert!((f64::from(found) - expected[axis]).abs() < 2e-5);
                    }
                }
            }
        }
    }

    proptest! {
        #[test]
        fn bones_keep_their_length(pose in pose()) {
            let skeleton = Skeleton::smplx_neutral();
            let points = skeleton.keypoints(&pose);
            for slot in 1..NUM_KEYPOINTS {
                let parent = KEYPOINT_PARENTS[slot] as usize;
                let bone = (points[slot] - points[parent]).length();
                prop_assert!((bone - skeleton.offset(KEYPOINT_JOINTS[slot]).length()).abs() < 1e-12);
            }
        }

        #[test]
        fn keypoints_agree_with_the_whole_tree(pose in pose()) {
            let skeleton = Skeleton::smplx_neutral();
            let rest: Vec<DVec3> = (0..PARENTS.len()).map(|joint| skeleton.rest(joint)).collect();
            let mut rotations = vec![DQuat::IDENTITY; PARENTS.len()];
            rotations[..NUM_BODY_JOINTS].copy_from_slice(&pose.rotations);
            let whole = forward(&rest, &PARENTS, &rotations, pose.transl);
            for (slot, point) in skeleton.keypoints(&pose).into_iter().enumerate() {
                prop_assert!((point - whole[KEYPOINT_JOINTS[slot]]).length() < 1e-12);
            }
        }
    }
}
