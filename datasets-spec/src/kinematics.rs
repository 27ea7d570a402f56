//! Forward kinematics: where the joints are, given the rotations.

use std::ops::Range;

use glam::{DQuat, DVec3};

use crate::blocks;
use crate::motion::{Keypoints, Motion, Pose};
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
