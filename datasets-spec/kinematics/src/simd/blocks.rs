//! Poses in blocks of frames: an array over the frames for every component, so that one instruction
//! works on several frames.

use glam::{DQuat, DVec3};

use super::lanes::{self, Kernel, LANES, Real};
use crate::pose::{BODY_POSE_WIDTH, Pose};
use crate::rotation::{MAX_TURN, from_axis_angle};
use crate::skeleton::{
    KEYPOINT_JOINTS, KEYPOINT_PARENTS, NUM_BODY_JOINTS, NUM_KEYPOINTS, Skeleton,
};

/// A vector in every frame of a block.
pub(crate) type Vectors<T> = [[T; LANES]; 3];
/// A quaternion in every frame of a block, by x, y, z, w.
pub(crate) type Quaternions<T> = [[T; LANES]; 4];

/// One lane of some planes.
#[inline(always)]
pub(crate) fn lane<T: Copy, const N: usize>(planes: &[[T; LANES]; N], lane: usize) -> [T; N] {
    std::array::from_fn(|component| planes[component][lane])
}

#[inline(always)]
pub(crate) fn set<T, const N: usize>(planes: &mut [[T; LANES]; N], lane: usize, value: [T; N]) {
    for (plane, value) in planes.iter_mut().zip(value) {
        plane[lane] = value;
    }
}

/// The quaternions of a block of rotation vectors.
#[inline(always)]
pub(crate) fn quaternions<T: Real>(vectors: &Vectors<T>) -> Quaternions<T> {
    let mut out = [[T::ZERO; LANES]; 4];
    for at in 0..LANES {
        set(&mut out, at, lanes::quaternion(lane(vectors, at)));
    }
    out
}

/// The quaternions of a block, whatever the lengths of its vectors.
#[inline(always)]
fn quaternions_of_any(vectors: &Vectors<f64>) -> Quaternions<f64> {
    let mut longest = 0.0f64;
    for at in 0..LANES {
        let [x, y, z] = lane(vectors, at);
        longest = longest.max(x.abs().max(y.abs()).max(z.abs()));
    }
    // By any one component, with room for the other two.
    if longest < 0.5 * MAX_TURN {
        return quaternions(vectors);
    }
    let mut out = [[0.0; LANES]; 4];
    for at in 0..LANES {
        let turn = from_axis_angle(DVec3::from_array(lane(vectors, at)));
        set(&mut out, at, turn.to_array());
    }
    out
}

/// Frames of a block, the last of them repeated.
#[inline(always)]
fn frame_of(first: usize, at: usize, num_frames: usize) -> usize {
    (first + at).min(num_frames - 1)
}

/// The frames of a motion as a block sees them.
pub(crate) trait Frames: Copy {
    /// Number of frames.
    fn len(self) -> usize;
    /// The translation in a frame.
    fn transl(self, frame: usize) -> [f64; 3];
    /// The local rotations of a joint in the frames from `first` on.
    fn turns(self, first: usize, joint: usize) -> Quaternions<f64>;
}

impl Frames for &[Pose] {
    #[inline(always)]
    fn len(self) -> usize {
        <[Pose]>::len(self)
    }

    #[inline(always)]
    fn transl(self, frame: usize) -> [f64; 3] {
        self[frame].transl.to_array()
    }

    #[inline(always)]
    fn turns(self, first: usize, joint: usize) -> Quaternions<f64> {
        let mut turns = [[0.0; LANES]; 4];
        for at in 0..LANES {
            let pose = &self[frame_of(first, at, self.len())];
            set(&mut turns, at, pose.rotations[joint].to_array());
        }
        turns
    }
}

/// The columns of a motion.
#[derive(Clone, Copy)]
pub(crate) struct Columns<'a> {
    pub(crate) transl: &'a [[f32; 3]],
    pub(crate) global_orient: &'a [[f32; 3]],
    pub(crate) body_pose: &'a [[f32; BODY_POSE_WIDTH]],
}

impl Frames for Columns<'_> {
    #[inline(always)]
    fn len(self) -> usize {
        self.transl.len()
    }

    #[inline(always)]
    fn transl(self, frame: usize) -> [f64; 3] {
        self.transl[frame].map(f64::from)
    }

    #[inline(always)]
    fn turns(self, first: usize, joint: usize) -> Quaternions<f64> {
        let mut vectors = [[0.0; LANES]; 3];
        for at in 0..LANES {
            let frame = frame_of(first, at, self.len());
            let vector = match joint {
                0 => self.global_orient[frame],
                _ => {
                    let body = &self.body_pose[frame][3 * (joint - 1)..][..3];
                    [body[0], body[1], body[2]]
                }
            };
            set(&mut vectors, at, vector.map(f64::from));
        }
        quaternions_of_any(&vectors)
    }
}

/// Translations and rotation vectors in working precision.
#[derive(Clone, Copy)]
pub(crate) struct WideColumns<'a> {
    pub(crate) transl: &'a [DVec3],
    pub(crate) vectors: &'a [[f64; 3 * NUM_BODY_JOINTS]],
}

impl Frames for WideColumns<'_> {
    #[inline(always)]
    fn len(self) -> usize {
        self.transl.len()
    }

    #[inline(always)]
    fn transl(self, frame: usize) -> [f64; 3] {
        self.transl[frame].to_array()
    }

    #[inline(always)]
    fn turns(self, first: usize, joint: usize) -> Quaternions<f64> {
        let mut vectors = [[0.0; LANES]; 3];
        for at in 0..LANES {
            let vector = &self.vectors[frame_of(first, at, self.len())][3 * joint..][..3];
            set(&mut vectors, at, [vector[0], vector[1], vector[2]]);
        }
        quaternions_of_any(&vectors)
    }
}

/// The poses of frames.
pub(crate) fn poses_of(frames: impl Frames) -> Vec<Pose> {
    struct Gather<'a, F> {
        frames: F,
        poses: &'a mut [Pose],
    }

    impl<F: Frames> Kernel for Gather<'_, F> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            let Self { frames, poses } = self;
            for first in (0..frames.len()).step_by(LANES) {
                let block = &mut poses[first..frames.len().min(first + LANES)];
                for joint in 0..NUM_BODY_JOINTS {
                    let turns = frames.turns(first, joint);
                    for (at, pose) in block.iter_mut().enumerate() {
                        pose.rotations[joint] = DQuat::from_array(lane(&turns, at));
                    }
                }
                for (at, pose) in block.iter_mut().enumerate() {
                    pose.transl = DVec3::from_array(frames.transl(first + at));
                }
            }
        }
    }

    let mut poses = vec![Pose::REST; frames.len()];
    lanes::vectorised(Gather {
        frames,
        poses: &mut poses,
    });
    poses
}

/// Root and body rotation vectors of poses, rounded as they are stored.
pub(crate) fn rotation_vectors(poses: &[Pose]) -> (Vec<[f32; 3]>, Vec<[f32; BODY_POSE_WIDTH]>) {
    struct Round<'a> {
        poses: &'a [Pose],
        root: &'a mut [[f32; 3]],
        body: &'a mut [[f32; BODY_POSE_WIDTH]],
    }

    impl Kernel for Round<'_> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            let Self { poses, root, body } = self;
            for first in (0..poses.len()).step_by(LANES) {
                let end = poses.len().min(first + LANES);
                for joint in 0..NUM_BODY_JOINTS {
                    let turns = poses.turns(first, joint);
                    let mut vectors = [[0.0; LANES]; 3];
                    for at in 0..LANES {
                        set(&mut vectors, at, lanes::rotation_vector(lane(&turns, at)));
                    }
                    for frame in first..end {
                        let slot = match joint {
                            0 => &mut root[frame][..],
                            _ => &mut body[frame][3 * (joint - 1)..][..3],
                        };
                        slot.copy_from_slice(&lane(&vectors, frame - first).map(|v| v as f32));
                    }
                }
            }
        }
    }

    let mut root = vec![[0.0; 3]; poses.len()];
    let mut body = vec![[0.0; BODY_POSE_WIDTH]; poses.len()];
    lanes::vectorised(Round {
        poses,
        root: &mut root,
        body: &mut body,
    });
    (root, body)
}

/// Interpolates poses: `out[i]` lies between frames `at[i].0` and the next at the share `at[i].1`.
/// A share of 0 is the frame itself.
pub(crate) fn interpolate(poses: &[Pose], at: &[(usize, f64)]) -> Vec<Pose> {
    struct Between<'a> {
        poses: &'a [Pose],
        at: &'a [(usize, f64)],
        /// The places that are not frames.
        places: &'a [usize],
        out: &'a mut [Pose],
    }

    impl Kernel for Between<'_> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            for block in self.places.chunks(LANES) {
                for joint in 0..NUM_BODY_JOINTS {
                    let mut from = [[0.0; LANES]; 4];
                    let mut to = [[0.0; LANES]; 4];
                    let mut alpha = [0.0; LANES];
                    for lane in 0..LANES {
                        let (before, share) = self.at[block[lane.min(block.len() - 1)]];
                        let pair = [before, before + 1].map(|frame| &self.poses[frame]);
                        set(&mut from, lane, pair[0].rotations[joint].to_array());
                        set(&mut to, lane, pair[1].rotations[joint].to_array());
                        alpha[lane] = share;
                    }
                    let mut mixed = [[0.0; LANES]; 4];
                    for (at, &alpha) in alpha.iter().enumerate() {
                        let turn = lanes::slerp(lane(&from, at), lane(&to, at), alpha);
                        set(&mut mixed, at, turn);
                    }
                    for (at, &place) in block.iter().enumerate() {
                        self.out[place].rotations[joint] = DQuat::from_array(lane(&mixed, at));
                    }
                }
            }
        }
    }

    let mut out: Vec<Pose> = at
        .iter()
        .map(|&(before, alpha)| {
            let mut pose = poses[before];
            if alpha != 0.0 {
                pose.transl = pose.transl.lerp(poses[before + 1].transl, alpha);
            }
            pose
        })
        .collect();
    let places: Vec<usize> = (0..at.len()).filter(|&i| at[i].1 != 0.0).collect();
    lanes::vectorised(Between {
        poses,
        at,
        places: &places,
        out: &mut out,
    });
    out
}

/// Rest offsets of the keypoints from their parents, and the rest position of the pelvis.
#[derive(Clone, Debug)]
pub(crate) struct Rest<T> {
    pelvis: [T; 3],
    offsets: [[T; 3]; NUM_KEYPOINTS],
}

impl<T: Real> Rest<T> {
    pub(crate) fn of(skeleton: &Skeleton) -> Self {
        let numbers = |v: DVec3| v.to_array().map(T::of);
        let mut offsets = [[T::ZERO; 3]; NUM_KEYPOINTS];
        for slot in 1..NUM_KEYPOINTS {
            let parent = KEYPOINT_JOINTS[parent_of(slot)];
            let offset = skeleton.rest(KEYPOINT_JOINTS[slot]) - skeleton.rest(parent);
            offsets[slot] = numbers(offset);
        }
        Self {
            pelvis: numbers(skeleton.rest(0)),
            offsets,
        }
    }

    /// The first `K` keypoints of a block of frames, given their translations and local rotations,
    /// which become global.
    #[inline(always)]
    pub(crate) fn place<const K: usize>(
        &self,
        transl: &Vectors<T>,
        turns: &mut [Quaternions<T>; NUM_BODY_JOINTS],
        points: &mut [Vectors<T>; K],
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
                let moved = lanes::turned(lane(&turns[parent], at), offset);
                for axis in 0..3 {
                    below[0][axis][at] = above[parent][axis][at] + moved[axis];
                }
            }
            // Rotations of joints that nothing hangs from are of no use here.
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

/// The parent of a keypoint; the pelvis is its own.
pub(crate) const fn parent_of(slot: usize) -> usize {
    if KEYPOINT_PARENTS[slot] < 0 {
        0
    } else {
        KEYPOINT_PARENTS[slot] as usize
    }
}

/// The first keypoint that hangs from each; none comes before all of them.
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
pub(crate) fn keypoints_of<const K: usize>(
    skeleton: &Skeleton,
    frames: impl Frames,
) -> Vec<[DVec3; K]> {
    struct Place<'a, F, const K: usize> {
        rest: Rest<f64>,
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
                let mut transl = [[0.0; LANES]; 3];
                for at in 0..LANES {
                    set(
                        &mut transl,
                        at,
                        frames.transl(frame_of(first, at, frames.len())),
                    );
                }
                for (joint, turns) in turns.iter_mut().enumerate() {
                    if FIRST_CHILD[joint] < K {
                        *turns = frames.turns(first, joint);
                    }
                }
                rest.place(&transl, &mut turns, &mut points);
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
    lanes::vectorised(Place {
        rest: Rest::of(skeleton),
        frames,
        out: &mut out,
    });
    out
}

/// Numbers of a frame as planes: translation and 22 rotation vectors.
pub(crate) const PARAMETERS: usize = 3 + 3 * NUM_BODY_JOINTS;

/// The keypoints of frames whose numbers lie in planes: `parameters` is `[69, T]`, `points` becomes
/// `[84, T]`.
pub(crate) fn keypoint_planes(
    rest: &Rest<f32>,
    num_frames: usize,
    parameters: &[f32],
    points: &mut [f32],
) {
    struct Place<'a> {
        rest: &'a Rest<f32>,
        num_frames: usize,
        parameters: &'a [f32],
        points: &'a mut [f32],
    }

    impl Place<'_> {
        /// A vector of 16 frames, of which the last `first` to `num_frames` may be fewer.
        #[inline(always)]
        fn vector(&self, plane: usize, first: usize) -> Vectors<f32> {
            let mut out = [[0.0; LANES]; 3];
            for (axis, out) in out.iter_mut().enumerate() {
                let row = &self.parameters[(plane + axis) * self.num_frames..][..self.num_frames];
                match row[first..].first_chunk::<LANES>() {
                    Some(whole) => *out = *whole,
                    None => out[..row.len() - first].copy_from_slice(&row[first..]),
                }
            }
            out
        }
    }

    impl Kernel for Place<'_> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            let mut placed = [[[0.0; LANES]; 3]; NUM_KEYPOINTS];
            let mut turns = [[[0.0; LANES]; 4]; NUM_BODY_JOINTS];
            for first in (0..self.num_frames).step_by(LANES) {
                for (joint, turns) in turns.iter_mut().enumerate() {
                    if FIRST_CHILD[joint] < NUM_KEYPOINTS {
                        *turns = quaternions(&self.vector(3 + 3 * joint, first));
                    }
                }
                self.rest
                    .place(&self.vector(0, first), &mut turns, &mut placed);
                let len = LANES.min(self.num_frames - first);
                for (plane, values) in placed.as_flattened().iter().enumerate() {
                    let row = &mut self.points[plane * self.num_frames + first..];
                    match row.first_chunk_mut::<LANES>() {
                        Some(whole) if len == LANES => *whole = *values,
                        _ => row[..len].copy_from_slice(&values[..len]),
                    }
                }
            }
        }
    }

    assert_eq!(parameters.len(), PARAMETERS * num_frames);
    assert_eq!(points.len(), 3 * NUM_KEYPOINTS * num_frames);
    lanes::vectorised(Place {
        rest,
        num_frames,
        parameters,
        points,
    });
}
