//! Blocks of [`LANES`] frames with a plane for every component, so that one instruction works on several frames; and
//! the conversion of poses to blocks and back.

use glam::{DQuat, DVec3};

use super::lanes::{self, Kernel, LANES};
use crate::pose::{BODY_POSE_WIDTH, Pose, StoredFrame};
use crate::rotation::{MAX_TURN, from_axis_angle};
use crate::skeleton::NUM_BODY_JOINTS;

/// A vector in every frame of a block.
pub type Vectors<T = f64> = [[T; LANES]; 3];
/// A quaternion in every frame of a block, by x, y, z, w.
pub type Quaternions<T = f64> = [[T; LANES]; 4];

/// The components of one lane.
#[inline(always)]
pub fn lane<T: Copy, const N: usize>(planes: &[[T; LANES]; N], lane: usize) -> [T; N] {
    std::array::from_fn(|component| planes[component][lane])
}

/// Writes the components of one lane.
#[inline(always)]
pub fn set<T, const N: usize>(planes: &mut [[T; LANES]; N], lane: usize, value: [T; N]) {
    for (plane, value) in planes.iter_mut().zip(value) {
        plane[lane] = value;
    }
}

/// The quaternions of a block of rotation vectors of any length.
#[inline(always)]
fn quaternions_of_any(vectors: &Vectors) -> Quaternions {
    let mut longest = 0.0f64;
    for at in 0..LANES {
        let [x, y, z] = lane(vectors, at);
        longest = longest.max(x.abs().max(y.abs()).max(z.abs()));
    }
    let mut out = [[0.0; LANES]; 4];
    // The length is at most sqrt(3) times the largest component.
    if longest < 0.5 * MAX_TURN {
        for at in 0..LANES {
            set(&mut out, at, lanes::quaternion(lane(vectors, at)));
        }
        return out;
    }
    for at in 0..LANES {
        let turn = from_axis_angle(DVec3::from_array(lane(vectors, at)));
        set(&mut out, at, turn.to_array());
    }
    out
}

/// The frame in lane `at` of the block that begins with frame `first`; past the end, the last frame.
#[inline(always)]
pub(crate) fn frame_of(first: usize, at: usize, num_frames: usize) -> usize {
    (first + at).min(num_frames - 1)
}

/// Frames in any storage that blocks can be gathered from.
pub(crate) trait Frames: Copy {
    fn len(self) -> usize;
    fn transl(self, frame: usize) -> [f64; 3];

    /// The translations in the block that begins with frame `first`.
    #[inline(always)]
    fn transls(self, first: usize) -> Vectors {
        let mut transl = [[0.0; LANES]; 3];
        for at in 0..LANES {
            let frame = frame_of(first, at, self.len());
            set(&mut transl, at, self.transl(frame));
        }
        transl
    }

    /// The local rotations of a joint in the block that begins with frame `first`.
    fn turns(self, first: usize, joint: usize) -> Quaternions;
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
    fn turns(self, first: usize, joint: usize) -> Quaternions {
        let mut turns = [[0.0; LANES]; 4];
        for at in 0..LANES {
            let pose = &self[frame_of(first, at, self.len())];
            set(&mut turns, at, pose.rotations[joint].to_array());
        }
        turns
    }
}

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
    fn turns(self, first: usize, joint: usize) -> Quaternions {
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

impl Frames for &[StoredFrame] {
    #[inline(always)]
    fn len(self) -> usize {
        <[StoredFrame]>::len(self)
    }

    #[inline(always)]
    fn transl(self, frame: usize) -> [f64; 3] {
        let numbers = &self[frame];
        [numbers[0], numbers[1], numbers[2]].map(f64::from)
    }

    #[inline(always)]
    fn turns(self, first: usize, joint: usize) -> Quaternions {
        let mut vectors = [[0.0; LANES]; 3];
        for at in 0..LANES {
            let numbers = &self[frame_of(first, at, self.len())][3 + 3 * joint..][..3];
            let vector = [numbers[0], numbers[1], numbers[2]];
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
    fn turns(self, first: usize, joint: usize) -> Quaternions {
        let mut vectors = [[0.0; LANES]; 3];
        for at in 0..LANES {
            let vector = &self.vectors[frame_of(first, at, self.len())][3 * joint..][..3];
            set(&mut vectors, at, [vector[0], vector[1], vector[2]]);
        }
        quaternions_of_any(&vectors)
    }
}

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
    lanes::dispatch(Gather {
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
    lanes::dispatch(Round {
        poses,
        root: &mut root,
        body: &mut body,
    });
    (root, body)
}

/// Interpolates poses: `out[i]` lies between frame `at[i].0` and the next; `at[i].1` is 0 at the frame and 1 at the next.
/// The places are those of a [`grid`](crate::resample::grid).
///
/// # Panics
/// If a place lies outside the poses.
pub fn interpolate_all(poses: &[Pose], at: &[(usize, f64)]) -> Vec<Pose> {
    struct Between<'a> {
        poses: &'a [Pose],
        at: &'a [(usize, f64)],
        /// Indices of the places between frames.
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
    lanes::dispatch(Between {
        poses,
        at,
        places: &places,
        out: &mut out,
    });
    out
}
