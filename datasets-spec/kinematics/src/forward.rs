//! Forward kinematics: positions of the joints from their rotations.

use std::ops::Range;

use glam::{DQuat, DVec3};

use crate::motion::{Keypoints, Motion, StoredFrame};
use crate::pose::Pose;
use crate::simd::blocks::{Frames, Quaternions, Vectors, lane, set};
use crate::simd::lanes::{self, Kernel, LANES};
use crate::skeleton::{KEYPOINT_JOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS, Skeleton, parent_of};

impl Skeleton {
    /// Global rotations of the 22 body joints of a pose.
    pub fn global_rotations(&self, pose: &Pose) -> [DQuat; NUM_BODY_JOINTS] {
        let mut global = pose.rotations;
        for joint in 1..NUM_BODY_JOINTS {
            let parent = parent_of(joint);
            global[joint] = global[parent] * pose.rotations[joint];
        }
        global
    }

    /// The 28 keypoints of a pose in metres.
    ///
    /// # Source
    /// SMPL-X: `p_0 = J_0 + transl`, `p_i = p_k + R_k (J_i - J_k)` with `k` the parent of `i` and `R`
    /// the global rotations. The keypoints are those of the paper's App. B.1; eyes rotate with the
    /// head and knuckles with the wrist, so the 22 body rotations determine all of them.
    pub fn keypoints(&self, pose: &Pose) -> [DVec3; NUM_KEYPOINTS] {
        let global = self.global_rotations(pose);
        let mut points = [self.rest(0) + pose.transl; NUM_KEYPOINTS];
        for slot in 1..NUM_KEYPOINTS {
            let parent = parent_of(slot);
            points[slot] = points[parent] + global[parent] * self.offset(KEYPOINT_JOINTS[slot]);
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

    /// The first `K` of the 28 keypoints, in metres, in a range of frames; the first 22 are the body joints.
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
        keypoints_of(self, motion.columns(frames))
    }

    /// The first `K` of the 28 keypoints of poses, in metres.
    ///
    /// # Shapes
    /// `[T, K]`.
    ///
    /// # Panics
    /// If `K` is 0 or more than 28.
    pub fn points_of_poses<const K: usize>(&self, poses: &[Pose]) -> Vec<[DVec3; K]> {
        keypoints_of(self, poses)
    }

    /// Computes the requested parts of stored frames, and writes them to one sink a frame.
    ///
    /// # Panics
    /// If there are not as many frames as sinks.
    pub fn place_rows<S: FrameSink>(&self, rows: &[StoredFrame], parts: FrameParts, out: &mut [S]) {
        assert_eq!(rows.len(), out.len(), "a sink for each frame");
        lanes::dispatch(Write {
            rest: Rest::of(self),
            frames: rows,
            parts,
            out,
        });
    }
}

/// Takes the local rotations and keypoints of a frame, rounded to single precision. Its methods must be
/// `#[inline(always)]`, see [`Kernel`].
pub trait FrameSink {
    /// Takes the local rotation of one of the 22 body joints, a quaternion x, y, z, w.
    fn set_rotation(&mut self, joint: usize, quaternion: [f32; 4]);
    /// Takes the position of one of the 28 keypoints, in metres.
    fn set_point(&mut self, slot: usize, point: [f32; 3]);
}

/// Which results of a frame are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameParts {
    /// Joints whose local rotations are written.
    pub rotations: [bool; NUM_BODY_JOINTS],
    /// Whether the keypoints are written.
    pub points: bool,
}

impl FrameParts {
    /// All results.
    pub const ALL: Self = Self {
        rotations: [true; NUM_BODY_JOINTS],
        points: true,
    };
}

/// Rest offsets of the keypoints from their parents, and the rest position of the pelvis.
struct Rest {
    pelvis: [f64; 3],
    offsets: [[f64; 3]; NUM_KEYPOINTS],
}

impl Rest {
    fn of(skeleton: &Skeleton) -> Self {
        let mut offsets = [[0.0; 3]; NUM_KEYPOINTS];
        for slot in 1..NUM_KEYPOINTS {
            offsets[slot] = skeleton.offset(KEYPOINT_JOINTS[slot]).to_array();
        }
        Self {
            pelvis: skeleton.rest(0).to_array(),
            offsets,
        }
    }

    /// The first `K` keypoints of a block of frames, from their translations and local rotations. Rotations of joints
    /// with children are replaced by global ones.
    #[inline(always)]
    fn place<const K: usize>(
        &self,
        transl: &Vectors,
        turns: &mut [Quaternions; NUM_BODY_JOINTS],
        points: &mut [Vectors; K],
    ) {
        for axis in 0..3 {
            for at in 0..LANES {
                points[0][axis][at] = self.pelvis[axis] + transl[axis][at];
            }
        }
        for (slot, &first_child) in FIRST_CHILD.iter().enumerate().take(K).skip(1) {
            let parent = parent_of(slot);
            let (above, below) = points.split_at_mut(slot);
            let offset = self.offsets[slot];
            for at in 0..LANES {
                let moved = lanes::rotated(lane(&turns[parent], at), offset);
                for axis in 0..3 {
                    below[0][axis][at] = above[parent][axis][at] + moved[axis];
                }
            }
            // Leaves need no global rotation.
            if first_child < K {
                let (above, below) = turns.split_at_mut(slot);
                for at in 0..LANES {
                    let turn = lanes::product(lane(&above[parent], at), lane(&below[0], at));
                    set(&mut below[0], at, turn);
                }
            }
        }
    }
}

/// First child of each keypoint; `NUM_KEYPOINTS` for a leaf.
const FIRST_CHILD: [usize; NUM_KEYPOINTS] = {
    let mut first = [NUM_KEYPOINTS; NUM_KEYPOINTS];
    let mut slot = NUM_KEYPOINTS - 1;
    while slot > 0 {
        first[parent_of(slot)] = slot;
        slot -= 1;
    }
    first
};

/// The first `K` keypoints of frames in metres.
fn keypoints_of<const K: usize>(skeleton: &Skeleton, frames: impl Frames) -> Vec<[DVec3; K]> {
    struct Place<'a, F, const K: usize> {
        rest: Rest,
        frames: F,
        out: &'a mut [[DVec3; K]],
    }

    impl<F: Frames, const K: usize> Kernel for Place<'_, F, K> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            let Self { rest, frames, out } = self;
            let mut points = [[[0.0; LANES]; 3]; K];
            let mut turns = [[[0.0; LANES]; 4]; NUM_BODY_JOINTS];
            for first in (0..frames.len()).step_by(LANES) {
                for (joint, turns) in turns.iter_mut().enumerate() {
                    if FIRST_CHILD[joint] < K {
                        *turns = frames.turns(first, joint);
                    }
                }
                rest.place(&frames.transls(first), &mut turns, &mut points);
                let block = &mut out[first..frames.len().min(first + LANES)];
                for (at, frame) in block.iter_mut().enumerate() {
                    for (slot, point) in frame.iter_mut().enumerate() {
                        *point = DVec3::from_array(lane(&points[slot], at));
                    }
                }
            }
        }
    }

    let mut out = vec![[DVec3::ZERO; K]; frames.len()];
    lanes::dispatch(Place {
        rest: Rest::of(skeleton),
        frames,
        out: &mut out,
    });
    out
}

/// Computes the requested parts of frames, and writes them to one sink a frame.
struct Write<'a, S> {
    rest: Rest,
    frames: &'a [StoredFrame],
    parts: FrameParts,
    out: &'a mut [S],
}

impl<S: FrameSink> Kernel for Write<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            rest,
            frames,
            parts,
            out,
        } = self;
        let mut points = [[[0.0; LANES]; 3]; NUM_KEYPOINTS];
        let mut turns = [[[0.0; LANES]; 4]; NUM_BODY_JOINTS];
        for first in (0..frames.len()).step_by(LANES) {
            let block = &mut out[first..frames.len().min(first + LANES)];
            for (joint, turns) in turns.iter_mut().enumerate() {
                if parts.points || parts.rotations[joint] {
                    *turns = frames.turns(first, joint);
                }
                if parts.rotations[joint] {
                    let turns = turns.map(|plane| plane.map(|number| number as f32));
                    for (at, frame) in block.iter_mut().enumerate() {
                        frame.set_rotation(joint, lane(&turns, at));
                    }
                }
            }
            if parts.points {
                rest.place(&frames.transls(first), &mut turns, &mut points);
                for (slot, point) in points.iter().enumerate() {
                    let point = point.map(|plane| plane.map(|number| number as f32));
                    for (at, frame) in block.iter_mut().enumerate() {
                        frame.set_point(slot, lane(&point, at));
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use proptest::prelude::*;

    use super::*;
    use crate::fit::tests::pose;
    use crate::rotation::from_axis_angle;
    use crate::units::Fps;

    #[derive(Clone, Debug, PartialEq)]
    struct Written {
        rotations: [Option<[f32; 4]>; NUM_BODY_JOINTS],
        points: [Option<[f32; 3]>; NUM_KEYPOINTS],
    }

    impl FrameSink for Written {
        #[inline(always)]
        fn set_rotation(&mut self, joint: usize, quaternion: [f32; 4]) {
            self.rotations[joint] = Some(quaternion);
        }

        #[inline(always)]
        fn set_point(&mut self, slot: usize, point: [f32; 3]) {
            self.points[slot] = Some(point);
        }
    }

    #[test]
    fn parts_of_frames_are_those_of_their_poses_rounded() {
        const NOTHING: Written = Written {
            rotations: [None; NUM_BODY_JOINTS],
            points: [None; NUM_KEYPOINTS],
        };
        let skeleton = Skeleton::smplx_neutral();
        // The poses fill one block of lanes and part of a second.
        let poses: Vec<Pose> = (0..21)
            .map(|frame| {
                let turn = |joint: usize| 0.3 * (frame + 2 * joint) as f64;
                let mut pose = Pose::REST;
                pose.transl = DVec3::new(turn(1), turn(2).sin(), -turn(3));
                pose.rotations = std::array::from_fn(|joint| {
                    from_axis_angle(DVec3::new(turn(joint).sin(), 0.2, turn(joint).cos()))
                });
                pose
            })
            .collect();
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("finite");
        let row = |frame: usize| {
            let mut row = [0.0; 6 + crate::motion::BODY_POSE_WIDTH];
            row[..3].copy_from_slice(&motion.transl()[frame]);
            row[3..6].copy_from_slice(&motion.global_orient()[frame]);
            row[6..].copy_from_slice(&motion.body_pose()[frame]);
            row
        };
        let rows: Vec<StoredFrame> = (0..motion.len()).map(row).collect();
        let stored = motion.poses();
        let points = skeleton.points_of_poses::<NUM_KEYPOINTS>(&stored);
        let written = |(pose, points): (&Pose, [DVec3; NUM_KEYPOINTS])| Written {
            rotations: pose.rotations.map(|turn| Some(turn.as_quat().to_array())),
            points: points.map(|point| Some(point.as_vec3().to_array())),
        };
        let expected: Vec<Written> = stored.iter().zip(points).map(written).collect();
        for (points, one) in [(true, false), (false, true), (true, true)] {
            let parts = FrameParts {
                rotations: std::array::from_fn(|joint| one && joint % 3 == 1),
                points,
            };
            let mut written = vec![NOTHING; rows.len()];
            skeleton.place_rows(&rows, parts, &mut written);
            let mut expected = expected.clone();
            for frame in &mut expected {
                for (joint, turn) in frame.rotations.iter_mut().enumerate() {
                    *turn = turn.filter(|_| parts.rotations[joint]);
                }
                frame.points = frame.points.map(|point| point.filter(|_| points));
            }
            assert_eq!(written, expected, "{parts:?}");
        }
    }

    #[test]
    fn the_rest_pose_is_the_rest_table() {
        let skeleton = Skeleton::smplx_neutral();
        for (slot, point) in skeleton.keypoints(&Pose::REST).into_iter().enumerate() {
            assert!((point - skeleton.rest(KEYPOINT_JOINTS[slot])).length() < 1e-15);
        }
    }

    #[test]
    fn a_leg_bends_by_hand() {
        let skeleton = Skeleton::smplx_neutral();
        let mut pose = Pose::REST;
        let quarter = from_axis_angle(DVec3::X * FRAC_PI_2);
        pose.rotations[1] = quarter;
        pose.rotations[4] = quarter;
        let points = skeleton.keypoints(&pose);
        let (thigh, shin) = (skeleton.offset(4), skeleton.offset(7));
        let knee = skeleton.rest(1) + DVec3::new(thigh.x, -thigh.z, thigh.y);
        let ankle = knee + DVec3::new(shin.x, -shin.y, -shin.z);
        assert!((points[4] - knee).length() < 1e-15);
        assert!((points[7] - ankle).length() < 1e-15);
    }

    #[test]
    fn blocks_agree_with_single_poses() {
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
            let blocks = skeleton.motion_keypoints(&motion);
            for (frame, points) in blocks.points.iter().enumerate() {
                let single = skeleton.keypoints(&motion.pose(frame));
                for (a, b) in points.iter().zip(&single) {
                    assert!((*a - *b).length() < 1e-12);
                }
            }
        }
    }

    proptest! {
        #[test]
        fn bones_keep_their_length(pose in pose(3.0)) {
            let skeleton = Skeleton::smplx_neutral();
            let points = skeleton.keypoints(&pose);
            for slot in 1..NUM_KEYPOINTS {
                let parent = parent_of(slot);
                let bone = (points[slot] - points[parent]).length();
                prop_assert!((bone - skeleton.offset(KEYPOINT_JOINTS[slot]).length()).abs() < 1e-12);
            }
        }
    }
}
