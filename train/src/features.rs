//! What the evaluation encoder sees of a motion.

use datasets_spec::{Fps, Motion, Pose, Resample, rotation};
use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::Error;

/// Numbers of a frame: 3 of translation, 21 joints and the root with 6 each.
pub const FEATURE_WIDTH: usize = 135;

/// Numbers of a frame that are translation; the others are rotations.
const TRANSLATION_WIDTH: usize = 3;

/// Name of the recipe of [`smpl135`], recorded with everything normalised by it.
pub const RECIPE: &str = "smpl135";

/// Features of one frame.
pub type FeatureFrame = [f32; FEATURE_WIDTH];

/// Smallest spread a translation feature is divided by, in metres a frame.
const MIN_TRANSLATION_STD: f64 = 0.01;
/// Smallest spread a rotation feature is divided by; 0.1 is a turn of about 6 degrees. Joints that
/// hardly turn in the training split (ankles' toes, collars) would otherwise turn a small difference
/// into tens of standard deviations, and twists that no keypoint shows, which a fitted body has by
/// convention and a captured one by nature, would decide every distance.
const MIN_ROTATION_STD: f64 = 0.1;

/// The features of consecutive frames: `[translation since the frame before, in the root frame of
/// that frame | 21 body rotations | root rotation]`, rotations as the first two rows of their
/// matrix. The first frame has no translation.
///
/// # Source
/// The 135 numbers of the MotionFix evaluator (`algorithms` section 15), there z up at 30 fps.
pub fn smpl135(poses: &[Pose]) -> Vec<FeatureFrame> {
    let mut before: Option<&Pose> = None;
    poses
        .iter()
        .map(|pose| {
            let mut frame = [0.0; FEATURE_WIDTH];
            if let Some(before) = before {
                let delta = before.rotations[0].inverse() * (pose.transl - before.transl);
                frame[..3].copy_from_slice(&delta.as_vec3().to_array());
            }
            before = Some(pose);
            let joints = pose.rotations[1..].iter().chain(&pose.rotations[..1]);
            for (slot, &joint) in frame[3..].chunks_exact_mut(6).zip(joints) {
                let rows = rotation::to_six_d_rows(DMat3::from_quat(joint));
                for (slot, value) in slot.iter_mut().zip(rows) {
                    *slot = value as f32;
                }
            }
            frame
        })
        .collect()
}

/// Brings a motion to the rate of the store and keeps every `stride`-th frame.
pub(crate) fn encoder_poses(
    motion: &Motion,
    stride: usize,
) -> Result<Vec<Pose>, datasets_spec::Error> {
    let motion = Resample::Exact.apply(motion, Fps::STORE)?;
    Ok(motion.poses().into_iter().step_by(stride).collect())
}

/// Turns a segment about the vertical so that its first frame faces +z.
pub(crate) fn face_forward(segment: &mut [Pose]) {
    let Some(first) = segment.first() else {
        return;
    };
    let turn = DQuat::from_rotation_y(-rotation::yaw(DMat3::from_quat(first.rotations[0])));
    let pivot: DVec3 = first.transl;
    for pose in segment {
        pose.transl = turn * (pose.transl - pivot) + pivot;
        pose.rotations[0] = turn * pose.rotations[0];
    }
}

/// Mean and standard deviation of each feature over the training split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureStats {
    /// Recipe of the features.
    pub recipe: String,
    /// Mean, `[135]`.
    pub mean: Vec<f32>,
    /// Standard deviation, at least 0.01, `[135]`.
    pub std: Vec<f32>,
}

impl FeatureStats {
    /// Fits mean and standard deviation.
    ///
    /// # Errors
    /// There is no frame.
    pub fn fit<'a>(frames: impl IntoIterator<Item = &'a FeatureFrame>) -> Result<Self, Error> {
        let mut count = 0u64;
        let mut mean = vec![0.0f64; FEATURE_WIDTH];
        let mut squares = vec![0.0f64; FEATURE_WIDTH];
        for frame in frames {
            count += 1;
            for ((mean, squares), &value) in mean.iter_mut().zip(&mut squares).zip(frame) {
                // Welford's update keeps its digits where the mean is large against the spread.
                let delta = f64::from(value) - *mean;
                *mean += delta / count as f64;
                *squares += delta * (f64::from(value) - *mean);
            }
        }
        if count == 0 {
            return Err(Error::Empty {
                what: "training split of the encoder",
            });
        }
        Ok(Self {
            recipe: RECIPE.to_owned(),
            mean: mean.iter().map(|&mean| mean as f32).collect(),
            std: squares
                .iter()
                .enumerate()
                .map(|(column, squares)| {
                    let least = if column < TRANSLATION_WIDTH {
                        MIN_TRANSLATION_STD
                    } else {
                        MIN_ROTATION_STD
                    };
                    (squares / count as f64).sqrt().max(least) as f32
                })
                .collect(),
        })
    }

    /// Appends a frame in units of standard deviations from the mean.
    pub(crate) fn push_normalized(&self, frame: &FeatureFrame, out: &mut Vec<f32>) {
        out.extend(
            frame
                .iter()
                .zip(&self.mean)
                .zip(&self.std)
                .map(|((value, mean), std)| (value - mean) / std),
        );
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    #[test]
    fn walking_ahead_is_forward_whichever_way_the_body_faces() {
        for yaw in [0.0, 1.0, -2.5] {
            let turn = DQuat::from_rotation_y(yaw);
            let mut poses: Vec<Pose> = (0..3)
                .map(|frame| {
                    let mut pose = Pose {
                        transl: turn * DVec3::new(0.0, 0.0, 0.1 * f64::from(frame)),
                        ..Pose::REST
                    };
                    pose.rotations[0] = turn;
                    pose
                })
                .collect();
            face_forward(&mut poses);
            let features = smpl135(&poses);
            assert_eq!(features[0][..3], [0.0; 3]);
            for frame in &features[1..] {
                assert!((frame[2] - 0.1).abs() < 1e-6 && frame[0].abs() < 1e-6);
            }
            // The first two rows of the identity.
            for (value, expected) in features[2][129..]
                .iter()
                .zip([1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
            {
                assert!((value - expected).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn the_root_comes_last_and_joints_in_order() {
        let mut pose = Pose::REST;
        pose.rotations[0] = DQuat::from_rotation_z(FRAC_PI_2);
        pose.rotations[21] = DQuat::from_rotation_x(FRAC_PI_2);
        let frame = smpl135(&[pose])[0];
        // Rows of a quarter turn about z: (0, -1, 0), (1, 0, 0).
        for (value, expected) in frame[129..].iter().zip([0.0, -1.0, 0.0, 1.0, 0.0, 0.0]) {
            assert!((value - expected).abs() < 1e-6);
        }
        // Rows of a quarter turn about x: (1, 0, 0), (0, 0, -1).
        for (value, expected) in frame[123..129].iter().zip([1.0, 0.0, 0.0, 0.0, 0.0, -1.0]) {
            assert!((value - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn statistics_of_two_frames_are_half_sum_and_half_difference() {
        let mut frames = [[1.0f32; FEATURE_WIDTH]; 2];
        frames[1][5] = 4.0;
        let stats = FeatureStats::fit(&frames).expect("frames");
        assert_eq!((stats.mean[5], stats.std[5]), (2.5, 1.5));
        // Columns that never change get the least spread of their kind.
        assert_eq!((stats.mean[6], stats.std[6]), (1.0, 0.1));
        assert_eq!((stats.mean[2], stats.std[2]), (1.0, 0.01));
        let mut out = Vec::new();
        stats.push_normalized(&frames[1], &mut out);
        assert_eq!(out[5], 1.0);
        assert!(FeatureStats::fit(&[]).is_err());
    }
}
