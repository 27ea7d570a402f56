//! A motion as SMPL-X parameters, and its 28 keypoints.

use std::ops::Range;

use glam::DVec3;

pub use crate::pose::{BODY_POSE_WIDTH, StoredFrame};
use crate::pose::{KeypointFrame, Pose};
use crate::rotation::from_axis_angle;
use crate::simd::blocks::{self, Columns, WideColumns};
use crate::skeleton::NUM_BODY_JOINTS;
use crate::{Error, Fps};

/// Number of values converted to bytes at a time.
const HASHED_AT_ONCE: usize = 4096;

/// A motion of `L` frames as SMPL-X parameters: `transl` `[L, 3]` in metres, `global_orient`
/// `[L, 3]` and `body_pose` `[L, 63]` as axis-angle in radians; y up, betas zero. Frame-major
/// arrays of `f32`, the layout of the store, so that writing is a copy.
///
/// All columns have the same number of frames, at least one, and only finite numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    fps: Fps,
    transl: Vec<[f32; 3]>,
    global_orient: Vec<[f32; 3]>,
    body_pose: Vec<[f32; BODY_POSE_WIDTH]>,
}

/// Builds a motion from a few poses at a time. It keeps 288 bytes a frame; a [`Pose`] takes 728.
#[derive(Clone, Debug, Default)]
pub struct MotionBuilder {
    transl: Vec<DVec3>,
    global_orient: Vec<[f32; 3]>,
    body_pose: Vec<[f32; BODY_POSE_WIDTH]>,
}

impl MotionBuilder {
    /// Reserves memory for this many frames.
    pub fn with_capacity(frames: usize) -> Self {
        Self {
            transl: Vec::with_capacity(frames),
            global_orient: Vec::with_capacity(frames),
            body_pose: Vec::with_capacity(frames),
        }
    }

    /// Appends poses.
    pub fn extend(&mut self, poses: &[Pose]) {
        let (global_orient, body_pose) = blocks::rotation_vectors(poses);
        self.transl.extend(poses.iter().map(|pose| pose.transl));
        self.global_orient.extend(global_orient);
        self.body_pose.extend(body_pose);
    }

    /// Raises every frame by a height in metres.
    pub fn raise(&mut self, height_m: f64) {
        for transl in &mut self.transl {
            transl.y += height_m;
        }
    }

    /// Rounds the motion to the stored precision.
    ///
    /// # Errors
    /// As [`Motion::new`].
    pub fn build(self, fps: Fps) -> Result<Motion, Error> {
        let transl = self.transl.iter().map(|transl| transl.as_vec3().to_array());
        Motion::new(fps, transl.collect(), self.global_orient, self.body_pose)
    }
}

impl Motion {
    /// Checks and takes the columns of a motion.
    ///
    /// # Errors
    /// The columns differ in length, are empty, or hold a NaN or an infinity.
    pub fn new(
        fps: Fps,
        transl: Vec<[f32; 3]>,
        global_orient: Vec<[f32; 3]>,
        body_pose: Vec<[f32; BODY_POSE_WIDTH]>,
    ) -> Result<Self, Error> {
        if transl.len() != global_orient.len() || transl.len() != body_pose.len() {
            return Err(Error(format!(
                "motion columns disagree on the number of frames: transl {}, global_orient {}, body_pose {}",
                transl.len(),
                global_orient.len(),
                body_pose.len()
            )));
        }
        if transl.is_empty() {
            return Err(Error("motion has no frames".to_owned()));
        }
        check_finite("transl", &transl)?;
        check_finite("global_orient", &global_orient)?;
        check_finite("body_pose", &body_pose)?;
        Ok(Self {
            fps,
            transl,
            global_orient,
            body_pose,
        })
    }

    /// Rounds poses to the stored precision.
    ///
    /// # Errors
    /// As [`Motion::new`].
    pub fn from_poses(fps: Fps, poses: &[Pose]) -> Result<Self, Error> {
        let mut builder = MotionBuilder::default();
        builder.extend(poses);
        builder.build(fps)
    }

    /// The frame rate.
    pub fn fps(&self) -> Fps {
        self.fps
    }

    /// Replaces the frame rate; the frames stay as they are.
    pub fn set_fps(&mut self, fps: Fps) {
        self.fps = fps;
    }

    /// Number of frames, at least one.
    #[expect(clippy::len_without_is_empty, reason = "a motion is never empty")]
    pub fn len(&self) -> usize {
        self.transl.len()
    }

    /// Seconds from the first to the last frame.
    pub fn duration_secs(&self) -> f64 {
        self.fps.secs_at(self.len() - 1)
    }

    /// Translations in metres, `[L, 3]`.
    pub fn transl(&self) -> &[[f32; 3]] {
        &self.transl
    }

    /// Root orientations as axis-angle, `[L, 3]`.
    pub fn global_orient(&self) -> &[[f32; 3]] {
        &self.global_orient
    }

    /// Body rotations as axis-angle, `[L, 63]`.
    pub fn body_pose(&self) -> &[[f32; BODY_POSE_WIDTH]] {
        &self.body_pose
    }

    /// The axis-angle of a body joint relative to its parent; joint 0 is the root.
    ///
    /// # Panics
    /// If the frame or the joint does not exist.
    pub fn axis_angle(&self, frame_index: usize, joint_index: usize) -> [f32; 3] {
        if joint_index == 0 {
            return self.global_orient[frame_index];
        }
        let at = 3 * (joint_index - 1);
        let frame = &self.body_pose[frame_index];
        [frame[at], frame[at + 1], frame[at + 2]]
    }

    /// Replaces the axis-angle of a body joint.
    ///
    /// # Panics
    /// If the frame or the joint does not exist, or a number is not finite.
    pub fn set_axis_angle(&mut self, frame_index: usize, joint_index: usize, value: [f32; 3]) {
        assert!(
            value.iter().all(|v| v.is_finite()),
            "rotation is not finite"
        );
        if joint_index == 0 {
            self.global_orient[frame_index] = value;
            return;
        }
        let at = 3 * (joint_index - 1);
        self.body_pose[frame_index][at..at + 3].copy_from_slice(&value);
    }

    /// Replaces the translation of a frame, in metres.
    ///
    /// # Panics
    /// If the frame does not exist or a number is not finite.
    pub fn set_transl(&mut self, frame_index: usize, value: [f32; 3]) {
        assert!(
            value.iter().all(|v| v.is_finite()),
            "translation is not finite"
        );
        self.transl[frame_index] = value;
    }

    /// A frame in working precision.
    ///
    /// # Panics
    /// If the frame does not exist.
    pub fn pose(&self, frame_index: usize) -> Pose {
        Pose {
            transl: to_dvec3(self.transl[frame_index]),
            rotations: std::array::from_fn(|joint| {
                from_axis_angle(to_dvec3(self.axis_angle(frame_index, joint)))
            }),
        }
    }

    /// All frames in working precision.
    pub fn poses(&self) -> Vec<Pose> {
        blocks::poses_of(self.columns(0..self.len()))
    }

    /// The frames of a range in working precision.
    ///
    /// # Panics
    /// If the range leaves the motion.
    pub fn poses_in(&self, frames: Range<usize>) -> Vec<Pose> {
        blocks::poses_of(self.columns(frames))
    }

    pub(crate) fn columns(&self, frames: Range<usize>) -> Columns<'_> {
        Columns {
            transl: &self.transl[frames.clone()],
            global_orient: &self.global_orient[frames.clone()],
            body_pose: &self.body_pose[frames],
        }
    }

    /// The frames of a range, at the same rate.
    ///
    /// # Errors
    /// The range is empty or leaves the motion.
    pub fn crop(&self, frames: std::ops::Range<usize>) -> Result<Self, Error> {
        if frames.is_empty() {
            return Err(Error("motion has no frames".to_owned()));
        }
        if frames.end > self.len() {
            return Err(Error(format!(
                "{} frames at {} are too short for a window of {}",
                self.len(),
                self.fps.get(),
                frames.end
            )));
        }
        Ok(Self {
            fps: self.fps,
            transl: self.transl[frames.clone()].to_vec(),
            global_orient: self.global_orient[frames.clone()].to_vec(),
            body_pose: self.body_pose[frames].to_vec(),
        })
    }

    /// BLAKE3 of the rate and the columns in canonical little-endian bytes, in hexadecimal. The rate is hashed in
    /// single precision, as tables store it, so that 29.97 fps has the same hash before and after storage.
    pub fn content_hash(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        let stored_fps = f64::from(self.fps.get() as f32);
        hasher.update(&stored_fps.to_le_bytes());
        for column in [
            self.transl.as_flattened(),
            self.global_orient.as_flattened(),
            self.body_pose.as_flattened(),
        ] {
            hasher.update(&(column.len() as u64).to_le_bytes());
            for values in column.chunks(HASHED_AT_ONCE) {
                let mut bytes = [0; 4 * HASHED_AT_ONCE];
                for (bytes, value) in bytes.chunks_exact_mut(4).zip(values) {
                    bytes.copy_from_slice(&value.to_le_bytes());
                }
                hasher.update(&bytes[..4 * values.len()]);
            }
        }
        hasher.finalize().to_hex().to_string()
    }
}

/// Poses from translations in metres and the rotation vectors of the 22 body joints in radians.
///
/// # Shapes
/// `[T]` and `[T, 66]`.
///
/// # Panics
/// If the slices differ in length.
pub fn poses_of(transl: &[DVec3], vectors: &[[f64; 3 * NUM_BODY_JOINTS]]) -> Vec<Pose> {
    assert_eq!(transl.len(), vectors.len());
    blocks::poses_of(WideColumns { transl, vectors })
}

/// `L` frames of the 28 keypoints in metres, y up.
#[derive(Clone, Debug, PartialEq)]
pub struct Keypoints {
    /// The frame rate.
    pub fps: Fps,
    /// Positions, `[L, 28]`.
    pub points: Vec<KeypointFrame>,
}

fn check_finite<const D: usize>(column: &str, frames: &[[f32; D]]) -> Result<(), Error> {
    match frames
        .iter()
        .position(|frame| frame.iter().any(|value| !value.is_finite()))
    {
        Some(frame) => Err(Error(format!("{column} of frame {frame} is not finite"))),
        None => Ok(()),
    }
}

fn to_dvec3(v: [f32; 3]) -> DVec3 {
    DVec3::new(v[0].into(), v[1].into(), v[2].into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn still(frames: usize) -> Motion {
        Motion::from_poses(Fps::STORE, &vec![Pose::REST; frames]).expect("valid")
    }

    #[test]
    fn broken_columns_are_refused_by_name() {
        let refused = |transl: usize, root: usize, pose: &[[f32; BODY_POSE_WIDTH]]| {
            let (transl, root) = (vec![[0.0; 3]; transl], vec![[0.0; 3]; root]);
            let motion = Motion::new(Fps::STORE, transl, root, pose.to_vec());
            motion.expect_err("broken").to_string()
        };
        let mut pose = [[0.0; BODY_POSE_WIDTH]; 3];
        let error = refused(2, 3, &pose);
        assert!(error.contains("transl 2, global_orient 3"), "{error}");
        pose[1][7] = f32::NAN;
        assert_eq!(refused(3, 3, &pose), "body_pose of frame 1 is not finite");
        assert_eq!(refused(0, 0, &[]), "motion has no frames");
    }

    #[test]
    fn the_hash_sees_every_column_and_the_rate() {
        let motion = still(2);
        let mut turned = motion.clone();
        turned.set_axis_angle(1, 21, [0.0, 0.0, 1e-6]);
        let mut moved = motion.clone();
        moved.set_transl(0, [1e-6, 0.0, 0.0]);
        let slower = Motion::from_poses(Fps::MODEL, &[Pose::REST; 2]).expect("valid");
        let hashes = [&motion, &turned, &moved, &slower].map(Motion::content_hash);
        for (i, a) in hashes.iter().enumerate() {
            assert!(hashes[i + 1..].iter().all(|b| a != b));
        }
        assert_eq!(motion.content_hash(), still(2).content_hash());
    }

    #[test]
    fn crops_stay_inside() {
        assert_eq!(still(5).crop(1..4).expect("inside").len(), 3);
        assert!(still(5).crop(3..6).is_err());
        assert!(still(5).crop(2..2).is_err());
    }
}
