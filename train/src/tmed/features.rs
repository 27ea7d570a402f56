//! The 207 features of TMED: conversion of motions to features and back.

use datasets_spec::{Fps, Motion, Pose, Resample, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation::{from_six_d_rows, to_six_d_rows};
use kinematics::skeleton::NUM_BODY_JOINTS;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::config::ensure;
use crate::features::{Moments, rotate, upright};

/// Number of features in a frame.
pub const NUM_FEATURES: usize = 207;

/// Features of one frame.
pub type FeatureFrame = [f32; NUM_FEATURES];

/// A group of features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureGroup {
    /// Index of the group's first feature.
    pub start: usize,
    /// Number of features in the group.
    pub width: usize,
    /// Whether the group is a change since the previous frame, which the first frame lacks.
    pub is_delta: bool,
}

const fn group(start: usize, width: usize, is_delta: bool) -> FeatureGroup {
    FeatureGroup {
        start,
        width,
        is_delta,
    }
}

/// The groups: translation since the previous frame in the previous root coordinates, root rotation without heading,
/// heading change since the previous frame, 21 body rotations, and 22 joints relative to the pelvis without heading.
/// Rotations are the first two rows of their matrix.
pub const GROUPS: [FeatureGroup; 5] = [
    group(0, 3, true),
    group(3, 6, false),
    group(9, 6, true),
    group(15, 126, false),
    group(141, 66, false),
];

/// Heading about +z: the rotation about z that is applied last (Euler angles "ZYX").
fn heading(root: DQuat) -> DQuat {
    let m = DMat3::from_quat(root);
    DQuat::from_rotation_z(m.x_axis.y.atan2(m.x_axis.x))
}

fn six(rotation: DQuat) -> [f32; 6] {
    to_six_d_rows(DMat3::from_quat(rotation)).map(|value| value as f32)
}

/// The features of consecutive frames, computed from poses with +z up and the positions of their 22 joints.
///
/// # Shapes
/// `[N]` poses and joints give `[N, 207]`.
///
/// # Source
/// MotionFix, `data/features.py` (`algorithms` section 11). The first frame has zero translation and heading change.
pub fn features_of_poses(poses: &[Pose], joints: &[[DVec3; NUM_BODY_JOINTS]]) -> Vec<FeatureFrame> {
    let mut before: Option<&Pose> = None;
    poses
        .iter()
        .zip(joints)
        .map(|(pose, joints)| {
            let root = pose.rotations[0];
            let turned = heading(root);
            let (moved, turn) = match before {
                None => (DVec3::ZERO, DQuat::IDENTITY),
                Some(before) => (
                    before.rotations[0].inverse() * (pose.transl - before.transl),
                    heading(before.rotations[0]).inverse() * turned,
                ),
            };
            before = Some(pose);
            let back = turned.inverse();
            let mut frame = [0.0; NUM_FEATURES];
            frame[..3].copy_from_slice(&moved.as_vec3().to_array());
            frame[3..9].copy_from_slice(&six(back * root));
            frame[9..15].copy_from_slice(&six(turn));
            for (slot, &rotation) in frame[15..141].chunks_exact_mut(6).zip(&pose.rotations[1..]) {
                slot.copy_from_slice(&six(rotation));
            }
            for (slot, joint) in frame[141..].chunks_exact_mut(3).zip(joints) {
                let at = back * (*joint - joints[0]);
                slot.copy_from_slice(&at.as_vec3().to_array());
            }
            frame
        })
        .collect()
}

/// Converts features to poses with +z up, starting from a heading and a translation. The joint positions and
/// the first frame's changes are not used; of the heading change, only the rotation about z.
///
/// # Source
/// MotionFix, `diffout2motion`.
pub fn poses_of_features(
    features: &[FeatureFrame],
    first_heading: DQuat,
    first_transl: DVec3,
) -> Vec<Pose> {
    let rotation = |values: &[f32]| {
        let rows: [f64; 6] = std::array::from_fn(|index| f64::from(values[index]));
        DQuat::from_mat3(&from_six_d_rows(rows)).normalize()
    };
    let (mut turned, mut transl) = (first_heading, first_transl);
    let mut before: Option<DQuat> = None;
    features
        .iter()
        .map(|frame| {
            if let Some(before) = before {
                let moved: [f64; 3] = std::array::from_fn(|axis| f64::from(frame[axis]));
                transl += before * DVec3::from_array(moved);
                turned = (turned * heading(rotation(&frame[9..15]))).normalize();
            }
            let mut pose = Pose {
                transl,
                ..Pose::REST
            };
            pose.rotations[0] = turned * rotation(&frame[3..9]);
            for (slot, values) in pose.rotations[1..]
                .iter_mut()
                .zip(frame[15..141].chunks_exact(6))
            {
                *slot = rotation(values);
            }
            before = Some(pose.rotations[0]);
            pose
        })
        .collect()
}

/// The features of a motion at a frame rate, for at most its first `max_frames` frames.
///
/// # Errors
/// The motion cannot be resampled.
pub fn features_of_motion(
    motion: &Motion,
    fps: Fps,
    max_frames: usize,
    skeleton: &Skeleton,
) -> Result<Vec<FeatureFrame>, kinematics::Error> {
    let motion = Resample::Exact.apply(motion, fps)?;
    let mut poses = motion.poses_in(0..motion.len().min(max_frames));
    rotate(&mut poses, upright());
    let joints = skeleton.points_of_poses::<NUM_BODY_JOINTS>(&poses);
    Ok(features_of_poses(&poses, &joints))
}

/// Converts features to poses with +y up. The motion starts at the position and heading of `first`.
pub fn poses_from(features: &[FeatureFrame], first: &Pose) -> Vec<Pose> {
    let begin = upright() * first.transl;
    let mut poses = poses_of_features(features, heading(upright() * first.rotations[0]), begin);
    rotate(&mut poses, upright().inverse());
    poses
}

/// Added to standard deviations used as divisors.
const LEAST_SPREAD: f32 = 1e-5;

/// Mean and standard deviation of every feature over the training motions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureStatistics {
    /// Means, `[207]`.
    pub mean: Vec<f32>,
    /// Standard deviations, `[207]`.
    pub std: Vec<f32>,
}

impl FeatureStatistics {
    pub(crate) fn of(moments: &Moments) -> Self {
        Self {
            mean: moments.means(),
            std: moments.deviations().map(|std| std as f32).collect(),
        }
    }

    /// Checks statistics after reading.
    ///
    /// # Errors
    /// A number is missing or not finite, or a deviation is negative.
    pub fn check(&self) -> Result<(), Error> {
        let fits = |values: &[f32]| {
            values.len() == NUM_FEATURES && values.iter().all(|value| value.is_finite())
        };
        ensure(
            fits(&self.mean) && fits(&self.std) && self.std.iter().all(|&std| std >= 0.0),
            "statistics",
            format!("they are not {NUM_FEATURES} finite means and standard deviations"),
        )
    }

    /// `(x - mean) / (2 (std + 1e-5))`, as in the released code.
    pub fn normalize(&self, frames: &mut [FeatureFrame]) {
        for frame in frames {
            for ((value, mean), std) in frame.iter_mut().zip(&self.mean).zip(&self.std) {
                *value = (*value - mean) / (2.0 * (std + LEAST_SPREAD));
            }
        }
    }

    /// The inverse of [`FeatureStatistics::normalize`].
    pub fn restore(&self, frames: &mut [FeatureFrame]) {
        for frame in frames {
            for ((value, mean), std) in frame.iter_mut().zip(&self.mean).zip(&self.std) {
                *value = *value * 2.0 * (std + LEAST_SPREAD) + mean;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion() -> Motion {
        let poses: Vec<Pose> = (0..41)
            .map(|frame| {
                let t = f64::from(frame) / 20.0;
                let mut pose = Pose {
                    transl: DVec3::new(1.0 + 0.3 * t, 0.9 + 0.1 * t.sin(), 0.8 * t - 2.0),
                    ..Pose::REST
                };
                pose.rotations[0] =
                    DQuat::from_rotation_y(2.0 + 0.9 * t) * DQuat::from_rotation_x(0.4 * t.sin());
                pose.rotations[16] = DQuat::from_rotation_z(t.sin());
                pose.rotations[4] = DQuat::from_rotation_x(0.5 + 0.3 * t.cos());
                pose
            })
            .collect();
        Motion::from_poses(Fps::STORE, &poses).expect("finite")
    }

    fn features(motion: &Motion, fps: Fps, max_frames: usize) -> Vec<FeatureFrame> {
        let skeleton = Skeleton::smplx_neutral();
        features_of_motion(motion, fps, max_frames, &skeleton).expect("resampled")
    }

    fn check_near(found: &[FeatureFrame], expected: &[FeatureFrame], tolerance: f32) {
        assert_eq!(found.len(), expected.len());
        for (a, b) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!((a - b).abs() < tolerance, "{a} {b}");
        }
    }

    #[test]
    fn features_of_a_motion_give_it_back() {
        let motion = motion();
        let all = features(&motion, Fps::STORE, 1_000);
        assert_eq!(all.len(), motion.len());
        let back = poses_from(&all, &motion.pose(0));
        for (back, pose) in back.iter().zip(motion.poses()) {
            assert!((back.transl - pose.transl).length() < 1e-5);
            for (back, rotation) in back.rotations.iter().zip(&pose.rotations) {
                assert!(back.angle_between(*rotation) < 1e-3);
            }
        }
        assert_eq!(features(&motion, Fps::STORE, 7), all[..7]);
    }

    #[test]
    fn features_do_not_depend_on_place_and_heading() {
        let turn = DQuat::from_rotation_y(1.3);
        let here = motion();
        let there: Vec<Pose> = here
            .poses()
            .into_iter()
            .map(|mut pose| {
                pose.transl = turn * pose.transl + DVec3::new(3.0, 0.0, -1.0);
                pose.rotations[0] = turn * pose.rotations[0];
                pose
            })
            .collect();
        let there = Motion::from_poses(Fps::STORE, &there).expect("finite");
        let fps = Fps::new(30.0).expect("a rate");
        let [here, there] = [here, there].map(|motion| features(&motion, fps, 1_000));
        check_near(&here, &there, 1e-4);
    }

    #[test]
    fn moments_of_parts_merge_to_those_of_the_whole() {
        let frames = features(&motion(), Fps::STORE, 1_000);
        let moments = |frames: &[FeatureFrame]| {
            Moments::of(NUM_FEATURES, frames.iter().map(|frame| frame.as_slice()))
        };
        let whole = FeatureStatistics::of(&moments(&frames));
        let none = Moments::none(NUM_FEATURES);
        let parts = [&frames[..5], &frames[5..5], &frames[5..]]
            .into_iter()
            .fold(none, |sum, part| sum.merge(&moments(part)));
        let parts = FeatureStatistics::of(&parts);
        for (a, b) in whole.std.iter().zip(&parts.std) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
        whole.check().expect("usable");
        let mut back = frames.clone();
        whole.normalize(&mut back);
        let spread: f32 = back.iter().map(|frame| frame[0].powi(2)).sum();
        // A normalised feature has a standard deviation of one half.
        assert!((spread / frames.len() as f32 - 0.25).abs() < 0.01);
        whole.restore(&mut back);
        check_near(&back, &frames, 1e-5);
    }
}
