//! Motion features of the evaluation encoders.

use std::borrow::Cow;
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

use datasets_spec::record::HUMANML3D_WIDTH;
use datasets_spec::{Fps, Motion, Pose, Resample, Skeleton};
use features::humanml3d::{features_of_joints, joints_of_motion};
use features::smpl_body;
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::error::motion_error;

/// Number of values in a frame: 3 of translation, and 6 for each of 21 joints and the root.
pub const FEATURE_WIDTH: usize = 135;

/// Features of one frame.
pub type FeatureFrame = [f32; FEATURE_WIDTH];

/// The features of consecutive frames: `[translation since the previous frame, in the previous frame's root coordinates
/// | 21 body rotations | root rotation]`. Rotations are the first two rows of their matrix. The first frame's
/// translation is zero.
///
/// # Source
/// The 135 features of the MotionFix evaluator (`algorithms` section 15), which uses z up and 30 fps.
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

datasets_spec::named! {
    /// Motion features of an encoder. The name is recorded with normalised data.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum FeatureRecipe, named by name {
        /// [`smpl135`] of segments rotated to face +z, y up, at 20 fps.
        Smpl135 = "smpl135",
        /// The 263 HumanML3D features at 20 fps, of the whole clip: the input of the released TMR. They use HumanML3D's
        /// own skeleton, so they do not depend on the body of a motion.
        HumanMl3d = "humanml3d",
        /// As [`FeatureRecipe::Smpl135`], but z up and at 30 fps: the input of MotionFix's released evaluator.
        MotionFix = "motionfix",
    }
}

impl FeatureRecipe {
    /// Number of values in a frame.
    pub const fn width(self) -> usize {
        match self {
            Self::Smpl135 | Self::MotionFix => FEATURE_WIDTH,
            Self::HumanMl3d => HUMANML3D_WIDTH,
        }
    }

    /// The frame rate of the features.
    pub fn fps(self) -> Fps {
        match self {
            Self::Smpl135 | Self::HumanMl3d => Fps::STORE,
            Self::MotionFix => Fps::new(30.0).expect("a rate"),
        }
    }

    /// Lower bound of a column's standard deviation. Without it, a small difference in joints that hardly rotate in the
    /// training split (toes, collars) would become tens of standard deviations. So would bone twists, which keypoints
    /// do not show: fitted bodies have conventional twists, captured ones natural twists.
    fn min_std(self, column: usize) -> f64 {
        /// In metres, or metres per frame.
        const LENGTH: f64 = 0.01;
        /// For an entry of a rotation matrix; 0.1 is a rotation by about 6 degrees.
        const ROTATION: f64 = 0.1;
        /// For a contact flag, 0 or 1.
        const CONTACT: f64 = 0.1;
        match self {
            Self::Smpl135 | Self::MotionFix if column < 3 => LENGTH,
            Self::Smpl135 | Self::MotionFix => ROTATION,
            Self::HumanMl3d if (67..193).contains(&column) => ROTATION,
            Self::HumanMl3d if column >= 259 => CONTACT,
            Self::HumanMl3d => LENGTH,
        }
    }
}

/// A clip prepared for computing the features of segments.
pub(crate) enum Prepared {
    /// Poses at the encoder's rate, because features depend on where a segment begins.
    Poses(FeatureRecipe, Vec<Pose>),
    /// Features of the whole clip.
    Rows(FeatureRecipe, Vec<f32>),
}

impl Prepared {
    /// Resamples a motion to the recipe's rate and keeps every `stride`-th frame.
    pub(crate) fn new(
        motion: &Motion,
        recipe: FeatureRecipe,
        stride: usize,
        id: &str,
    ) -> Result<Self, Error> {
        let motion = Resample::Exact
            .apply(motion, recipe.fps())
            .map_err(motion_error(id))?;
        if recipe == FeatureRecipe::HumanMl3d {
            let joints = joints_of_motion(&motion, &smpl_body(&Skeleton::smplx_neutral()));
            let rows = features_of_joints(&joints)
                .map_err(|error| Error::item(id, format!("has no HumanML3D features: {error}")))?;
            let rows = rows.into_iter().step_by(stride).flatten().collect();
            return Ok(Self::Rows(recipe, rows));
        }
        let poses = motion.poses().into_iter().step_by(stride).collect();
        Ok(Self::Poses(recipe, poses))
    }

    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Poses(_, poses) => poses.len(),
            Self::Rows(recipe, rows) => rows.len() / recipe.width(),
        }
    }

    /// Features of a segment, row after row.
    pub(crate) fn features(&self, segment: Range<usize>) -> Cow<'_, [f32]> {
        match self {
            Self::Poses(recipe, poses) => {
                let mut poses = poses[segment].to_vec();
                face_forward(&mut poses);
                if *recipe == FeatureRecipe::MotionFix {
                    rotate(&mut poses, upright());
                }
                Cow::Owned(smpl135(&poses).into_flattened())
            }
            Self::Rows(recipe, rows) => {
                let width = recipe.width();
                Cow::Borrowed(&rows[width * segment.start..width * segment.end])
            }
        }
    }
}

/// The rotation from y up to z up. A body that faced +z then faces -y, which is heading 0.
pub(crate) fn upright() -> DQuat {
    DQuat::from_rotation_x(FRAC_PI_2)
}

/// Rotates poses about the origin.
pub(crate) fn rotate(poses: &mut [Pose], turn: DQuat) {
    for pose in poses {
        pose.transl = turn * pose.transl;
        pose.rotations[0] = turn * pose.rotations[0];
    }
}

/// Rotates a segment about the vertical so that its first frame faces +z.
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

/// Running sums for the mean and the standard deviation of columns. Those of several motions can be merged.
#[derive(Clone, Debug)]
pub(crate) struct Moments {
    count: f64,
    mean: Vec<f64>,
    /// Sums of squared deviations from the mean.
    squares: Vec<f64>,
}

impl Moments {
    pub(crate) fn none(width: usize) -> Self {
        Self {
            count: 0.0,
            mean: vec![0.0; width],
            squares: vec![0.0; width],
        }
    }

    pub(crate) fn of<'a>(width: usize, rows: impl IntoIterator<Item = &'a [f32]>) -> Self {
        let mut moments = Self::none(width);
        for row in rows {
            moments.count += 1.0;
            let columns = moments.mean.iter_mut().zip(&mut moments.squares);
            for ((mean, squares), &value) in columns.zip(row) {
                // Welford's update stays precise if the mean is large compared with the deviation.
                let away = f64::from(value) - *mean;
                *mean += away / moments.count;
                *squares += away * (f64::from(value) - *mean);
            }
        }
        moments
    }

    /// Merges the moments of two sets of rows.
    ///
    /// # Source
    /// Chan, Golub and LeVeque 1983.
    pub(crate) fn merge(mut self, other: &Self) -> Self {
        let count = self.count + other.count;
        if other.is_empty() {
            return self;
        }
        let columns = self.mean.iter_mut().zip(&mut self.squares);
        for ((mean, squares), (theirs, more)) in columns.zip(other.mean.iter().zip(&other.squares))
        {
            let apart = theirs - *mean;
            *mean += apart * other.count / count;
            *squares += more + apart * apart * self.count * other.count / count;
        }
        self.count = count;
        self
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.count == 0.0
    }

    pub(crate) fn means(&self) -> Vec<f32> {
        self.mean.iter().map(|&mean| mean as f32).collect()
    }

    pub(crate) fn deviations(&self) -> impl Iterator<Item = f64> {
        let squares = self.squares.iter();
        squares.map(|squares| (squares / self.count).sqrt())
    }
}

/// Mean and standard deviation of each feature over the training split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureStats {
    /// Recipe of the features.
    pub recipe: FeatureRecipe,
    /// Mean of each column.
    pub mean: Vec<f32>,
    /// Standard deviation of each column, bounded from below.
    pub std: Vec<f32>,
}

impl FeatureStats {
    /// Fits mean and standard deviation to rows of features.
    ///
    /// # Errors
    /// There is no row.
    pub fn fit<'a>(
        recipe: FeatureRecipe,
        rows: impl IntoIterator<Item = &'a [f32]>,
    ) -> Result<Self, Error> {
        let moments = Moments::of(recipe.width(), rows);
        if moments.is_empty() {
            return Err(Error::empty("training split of the encoder"));
        }
        let deviations = moments.deviations().enumerate();
        Ok(Self {
            recipe,
            mean: moments.means(),
            std: deviations
                .map(|(column, std)| std.max(recipe.min_std(column)) as f32)
                .collect(),
        })
    }

    /// The inverse of [`FeatureStats::push_normalized`].
    pub(crate) fn restored(&self, values: &[f32]) -> Vec<f32> {
        let columns = self.mean.iter().zip(&self.std).cycle();
        let values = values.iter().zip(columns);
        values
            .map(|(value, (mean, std))| value * std + mean)
            .collect()
    }

    /// Appends rows, normalised to zero mean and unit standard deviation.
    pub(crate) fn push_normalized(&self, rows: &[f32], out: &mut Vec<f32>) {
        for row in rows.chunks_exact(self.recipe.width()) {
            let columns = row.iter().zip(&self.mean).zip(&self.std);
            out.extend(columns.map(|((value, mean), std)| (value - mean) / std));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check_near(found: &[f32], expected: &[f32]) {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }

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
            // The first two rows of the identity matrix.
            check_near(&features[2][129..], &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        }
    }

    #[test]
    fn statistics_of_two_frames_are_half_sum_and_half_difference() {
        let mut frames = [[1.0f32; FEATURE_WIDTH]; 2];
        frames[1][5] = 4.0;
        let recipe = FeatureRecipe::Smpl135;
        let fit = |frames: &[FeatureFrame]| {
            FeatureStats::fit(recipe, frames.iter().map(|frame| &frame[..]))
        };
        let stats = fit(&frames).expect("frames");
        assert_eq!((stats.mean[5], stats.std[5]), (2.5, 1.5));
        // Columns that never change get the lower bound of their kind.
        assert_eq!((stats.mean[6], stats.std[6]), (1.0, 0.1));
        assert_eq!((stats.mean[2], stats.std[2]), (1.0, 0.01));
        let mut out = Vec::new();
        stats.push_normalized(&frames[1], &mut out);
        assert_eq!(out[5], 1.0);
        assert!(fit(&[]).is_err());
    }

    #[test]
    fn segments_of_any_recipe_have_its_width_and_rate() {
        let poses: Vec<Pose> = (0..41)
            .map(|frame| {
                let t = f64::from(frame) / 20.0;
                let mut pose = Pose {
                    transl: DVec3::new(0.3 * t, 1.0, 0.8 * t),
                    ..Pose::REST
                };
                pose.rotations[0] = DQuat::from_rotation_y(0.4 * t);
                pose.rotations[16] = DQuat::from_rotation_z(t.sin());
                pose
            })
            .collect();
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("finite");
        for (recipe, frames) in [
            (FeatureRecipe::Smpl135, 41),
            (FeatureRecipe::HumanMl3d, 40),
            (FeatureRecipe::MotionFix, 61),
        ] {
            let clip = Prepared::new(&motion, recipe, 1, "clip").expect("long enough");
            assert_eq!(clip.len(), frames, "{recipe:?}");
            let segment = clip.features(3..13);
            assert_eq!(segment.len(), 10 * recipe.width());
            assert!(segment.iter().all(|value| value.is_finite()));
        }
        let [ours, theirs] = [FeatureRecipe::Smpl135, FeatureRecipe::MotionFix].map(|recipe| {
            let clip = Prepared::new(&motion, recipe, 1, "clip").expect("long enough");
            clip.features(0..2).into_owned()
        });
        // At 30 fps, the second frame has moved two thirds as far as at 20 fps, and z is up.
        for axis in FEATURE_WIDTH..FEATURE_WIDTH + 3 {
            let [ours, theirs] = [ours[axis], theirs[axis]].map(f64::from);
            // The heading changes by a hundredth of a radian between two frames.
            assert!((ours * 2.0 / 3.0 - theirs).abs() < 2e-4, "{ours} {theirs}");
        }
        // The rows of a 90-degree rotation about x: the root of a body that faces -y with z up.
        check_near(&theirs[129..135], &[1.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
    }
}
