//! SMPL parameters of files, rotated to y up.

use datasets_spec::{Fps, Motion, Pose, Skeleton};
use features::floor;
use glam::{DQuat, DVec3};
use kinematics::motion::BODY_POSE_WIDTH;
use kinematics::rotation::to_axis_angle;

use super::format::too_short;
use clip::{Rejected, rejected};
use pickle::{Array, Value};

/// Parameters of a motion as stored in a file, in single precision.
///
/// # Shapes
/// `root` and `trans` are `[T, 3]`, `body` is `[T, 63]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    root: Vec<[f32; 3]>,
    body: Vec<[f32; BODY_POSE_WIDTH]>,
    trans: Vec<[f32; 3]>,
}

impl Parameters {
    /// Makes parameters from the columns of a motion.
    ///
    /// # Errors
    /// `E-SMPL-SHAPE` if they differ in length.
    pub fn new(
        root: Vec<[f32; 3]>,
        body: Vec<[f32; BODY_POSE_WIDTH]>,
        trans: Vec<[f32; 3]>,
    ) -> Result<Self, Rejected> {
        if root.len() == body.len() && body.len() == trans.len() {
            return Ok(Self { root, body, trans });
        }
        Err(rejected!(
            "E-SMPL-SHAPE",
            "found {} root orientations, {} body poses and {} translations, expected as many \
                 of each",
            root.len(),
            body.len(),
            trans.len()
        ))
    }

    /// Makes parameters from the rotation vectors of root and body together, `[T, 66]`.
    ///
    /// # Errors
    /// As [`Parameters::new`].
    pub(super) fn of_poses(
        poses: impl Iterator<Item = [f32; 3 + BODY_POSE_WIDTH]>,
        trans: Vec<[f32; 3]>,
    ) -> Result<Self, Rejected> {
        let part = |pose: [f32; 3 + BODY_POSE_WIDTH]| {
            let body: [f32; BODY_POSE_WIDTH] = std::array::from_fn(|column| pose[3 + column]);
            ([pose[0], pose[1], pose[2]], body)
        };
        let (root, body): (Vec<_>, Vec<_>) = poses.map(part).unzip();
        Self::new(root, body, trans)
    }

    /// The motion with the world rotated by `turn` to y up, and put on the floor. Body rotations are copied bit for
    /// bit.
    ///
    /// # Errors
    /// `E-NOT-FINITE` if a number is not finite, `E-TOO-SHORT` if there is no frame.
    pub(super) fn turned(
        &self,
        turn: DQuat,
        fps: Fps,
        skeleton: &Skeleton,
    ) -> Result<Motion, Rejected> {
        let mut poses = self.unchanged(fps)?.poses();
        for pose in &mut poses {
            turn_world(pose, turn, skeleton);
        }
        floor::put_on_floor(&mut poses, fps, skeleton);
        let rounded = |v: DVec3| v.as_vec3().to_array();
        Self {
            root: poses
                .iter()
                .map(|pose| rounded(to_axis_angle(pose.rotations[0])))
                .collect(),
            trans: poses.iter().map(|pose| rounded(pose.transl)).collect(),
            body: self.body.clone(),
        }
        .unchanged(fps)
    }

    /// The motion with unchanged numbers.
    ///
    /// # Errors
    /// As [`Parameters::turned`].
    pub(super) fn unchanged(&self, fps: Fps) -> Result<Motion, Rejected> {
        if self.trans.is_empty() {
            return Err(too_short(0));
        }
        Motion::new(
            fps,
            self.trans.clone(),
            self.root.clone(),
            self.body.clone(),
        )
        .map_err(|error| Rejected::read("E-NOT-FINITE", error.to_string()))
    }
}

/// Numbers per frame of an array whose first dimension counts frames; `None` if it has no other dimension, or too many
/// numbers.
pub fn frame_width(shape: &[usize]) -> Option<usize> {
    let mut extents = shape.get(1..).filter(|extents| !extents.is_empty())?.iter();
    extents.try_fold(1usize, |product, &extent| product.checked_mul(extent))
}

/// The array `key` of a dictionary, whose first dimension counts frames; the others hold `D` numbers per frame.
pub fn column<const D: usize>(value: &Value, key: &str) -> Result<Vec<[f32; D]>, Rejected> {
    let found = value.get(key).unwrap_or(&Value::None);
    let array = found.as_array();
    let array = array.filter(|array| frame_width(array.shape()) == Some(D));
    let numbers = array.and_then(Array::to_f32).ok_or_else(|| {
        rejected!(
            "E-SMPL-SHAPE",
            "found {key} as {}, expected an array of frames by {D} numbers",
            found.describe()
        )
    })?;
    Ok(numbers.as_chunks::<D>().0.to_vec())
}

/// Rotates the world of a pose.
///
/// SMPL rotates the body by `R` about the rest position `J0` of the pelvis, and then moves it by `t`. Rotating the world
/// by `Q` therefore gives `R' = Q R` and `t' = Q (t + J0) - J0`.
pub(crate) fn turn_world(pose: &mut Pose, turn: DQuat, skeleton: &Skeleton) {
    let rest_pelvis = skeleton.rest(0);
    pose.rotations[0] = turn * pose.rotations[0];
    pose.transl = turn * (pose.transl + rest_pelvis) - rest_pelvis;
}

/// The note that rotations of one body are used on another.
pub(super) fn rotations_note(skeleton: &Skeleton) -> String {
    format!("rotations drive the body {} as they are", skeleton.name())
}

#[cfg(test)]
mod tests {
    use kinematics::rotation::from_axis_angle;

    use super::*;
    use crate::source::up::Up;

    #[test]
    fn a_world_that_is_turned_keeps_the_body_and_finds_the_floor() {
        let skeleton = Skeleton::smplx_neutral();
        let quarter = std::f32::consts::FRAC_PI_2;
        let parameters = Parameters {
            root: vec![[quarter, 0.0, 0.0]; 2],
            body: vec![[0.25; BODY_POSE_WIDTH]; 2],
            trans: vec![[1.0, 2.0, 3.0], [1.01, 2.0, 3.0]],
        };
        let motion = parameters.turned(Up::Z.turn(), Fps::STORE, &skeleton);
        let motion = motion.expect("finite");
        assert_eq!(motion.body_pose(), parameters.body);
        let upright = from_axis_angle(DVec3::from_array(motion.global_orient()[0].map(f64::from)));
        assert!(upright.angle_between(DQuat::IDENTITY) < 1e-6, "faces +z");
        let keypoints = [0, 1].map(|frame| skeleton.keypoints(&motion.pose(frame)));
        let moved = keypoints[1][0] - keypoints[0][0];
        assert!((moved - DVec3::X * 0.01).length() < 1e-6);
        let heights = [7, 8, 10, 11].map(|joint: usize| keypoints[0][joint].y);
        let lowest = heights.into_iter().fold(f64::INFINITY, f64::min);
        // The floor is rounded with the translation to single precision.
        assert!(lowest.abs() < 1e-6, "{lowest}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let mut parameters = Parameters {
            root: vec![[0.0; 3]; 2],
            body: vec![[0.0; BODY_POSE_WIDTH]; 2],
            trans: vec![[0.0; 3]; 2],
        };
        parameters.root[1][2] = f32::NAN;
        let turned = parameters.turned(DQuat::IDENTITY, Fps::STORE, &Skeleton::smplx_neutral());
        assert_eq!(turned.expect_err("not finite").code, "E-NOT-FINITE");
    }
}
