//! A motion of a foreign file, and its conversion to the frame of an item.

use clip::{MAX_FPS, MIN_FPS, Rejected, rejected};
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Fps, Motion, Pose, Skeleton};
use features::floor;
use glam::{DMat3, DQuat, DVec3};
use kinematics::motion::{self, BODY_POSE_WIDTH};
use kinematics::resample;
use kinematics::rotation::{self, to_axis_angle};
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::options::{AnswerOptions, Place};
use formats::source::Up;

/// Numbers of the rotation vectors of a frame: root and 21 body joints.
pub(super) const VECTORS_WIDTH: usize = 3 * NUM_BODY_JOINTS;

/// SMPL parameters of a file.
///
/// # Shapes
/// `transl` is `[T, 3]` in metres, `vectors` `[T, 66]` in radians.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Recorded {
    /// Rate the file states, in 1/s.
    pub(super) fps: Option<f64>,
    /// The up axis of its format.
    pub(super) up: Up,
    pub(super) place: Place,
    pub(super) transl: Vec<[f64; 3]>,
    pub(super) vectors: Vec<[f64; VECTORS_WIDTH]>,
    /// Mean distance in metres between the points of the file and the body posed by the parameters; `None` if the file
    /// holds parameters.
    pub(super) fit_error_m: Option<f32>,
}

impl Recorded {
    /// Makes parameters from columns.
    ///
    /// # Errors
    /// `E-SMPL-SHAPE` if they differ in length.
    pub(super) fn of_columns<T: Copy + Into<f64>>(
        transl: &[[T; 3]],
        root: &[[T; 3]],
        body: &[[T; BODY_POSE_WIDTH]],
    ) -> Result<Self, Rejected> {
        if transl.len() != root.len() || root.len() != body.len() {
            return Err(rejected!(
                "E-SMPL-SHAPE",
                "found {} translations, {} root orientations and {} body poses, expected as \
                     many of each",
                transl.len(),
                root.len(),
                body.len()
            ));
        }
        let vectors = root.iter().zip(body).map(|(root, body)| {
            let mut numbers = root.iter().chain(body);
            std::array::from_fn(|_| numbers.next().map_or(0.0, |&number| number.into()))
        });
        Ok(Self {
            fps: None,
            up: Up::Y,
            place: Place::File,
            vectors: vectors.collect(),
            transl: transl.iter().map(|frame| frame.map(T::into)).collect(),
            fit_error_m: None,
        })
    }

    /// The parameters of a motion of the store.
    pub(super) fn of_motion(motion: &Motion) -> Self {
        let (root, body) = (motion.global_orient(), motion.body_pose());
        let mut recorded = Self::of_columns(motion.transl(), root, body)
            .expect("columns of a motion are of one length");
        recorded.fps = Some(motion.fps().get());
        recorded
    }

    /// The motion at the rate of an item, y up. It is placed at the item's source on request, or if the file has
    /// no placement. Numbers that need no change keep their bits.
    ///
    /// # Errors
    /// `E-ANSWER-FPS` if no valid rate is stated, `E-NOT-FINITE`, `E-TOO-SHORT`.
    pub(super) fn motion(
        &self,
        item: &ItemRow,
        skeleton: &Skeleton,
        options: &AnswerOptions,
    ) -> Result<Motion, Rejected> {
        let fps = self.rate(options)?;
        let target = Fps::new(item.fps.into()).map_err(|error| bad(&error))?;
        let frames = resample::grid(self.transl.len(), fps, target).len();
        if frames < EditRow::MIN_FRAMES {
            return Err(rejected!(
                "E-TOO-SHORT",
                "found {} frames, {frames} at the item's rate, expected at least {} of these",
                self.transl.len(),
                EditRow::MIN_FRAMES
            ));
        }
        let narrow = |frame: &[f64; 3]| frame.map(|value| value as f32);
        let body: Vec<[f32; BODY_POSE_WIDTH]> = self
            .vectors
            .iter()
            .map(|frame| std::array::from_fn(|column| frame[3 + column] as f32))
            .collect();
        let root = self
            .vectors
            .iter()
            .map(|frame| [0, 1, 2].map(|axis| frame[axis] as f32));
        let as_it_is = Motion::new(
            fps,
            self.transl.iter().map(narrow).collect(),
            root.collect(),
            body.clone(),
        )
        .map_err(|error| bad(&error))?;
        let up = options.up.unwrap_or(self.up);
        let place = options.place.unwrap_or(self.place);
        if up == Up::Y && place == Place::File && fps == target {
            return Ok(as_it_is);
        }
        let transl: Vec<DVec3> = self.transl.iter().copied().map(DVec3::from_array).collect();
        let mut poses = motion::poses_of(&transl, &self.vectors);
        let rest_pelvis = skeleton.rest(0);
        if up != Up::Y {
            let turn = up.turn();
            for pose in &mut poses {
                pose.rotations[0] = turn * pose.rotations[0];
                pose.transl = turn * (pose.transl + rest_pelvis) - rest_pelvis;
            }
        }
        let is_resampled = fps != target;
        if is_resampled {
            poses = resample::interpolate_all(&poses, &resample::grid(poses.len(), fps, target));
        }
        if place == Place::Source {
            let source = item.source().map_err(|error| bad(&error))?;
            stand_where(&mut poses, &source.pose(0), rest_pelvis);
            floor::put_on_floor(&mut poses, target, skeleton);
        }
        if is_resampled {
            return Motion::from_poses(target, &poses).map_err(|error| bad(&error));
        }
        let rounded = |v: DVec3| v.as_vec3().to_array();
        Motion::new(
            target,
            poses.iter().map(|pose| rounded(pose.transl)).collect(),
            poses
                .iter()
                .map(|pose| rounded(to_axis_angle(pose.rotations[0])))
                .collect(),
            body,
        )
        .map_err(|error| bad(&error))
    }

    fn rate(&self, options: &AnswerOptions) -> Result<Fps, Rejected> {
        if let Some(fps) = options.fps {
            return Ok(fps);
        }
        let stated = self.fps.ok_or_else(|| {
            Rejected::read(
                "E-ANSWER-FPS",
                "found no frame rate; write one beside the motion, or pass --fps",
            )
        })?;
        let wrong = |reason: &dyn std::fmt::Display| {
            rejected!("E-ANSWER-FPS", "found a rate of {stated}: {reason}")
        };
        if !(MIN_FPS..=MAX_FPS).contains(&stated) {
            return Err(wrong(&format!("expected one of {MIN_FPS} to {MAX_FPS}")));
        }
        Fps::from_file(stated).map_err(|error| wrong(&error))
    }
}

fn bad(error: &dyn std::fmt::Display) -> Rejected {
    Rejected::read("E-NOT-FINITE", error.to_string())
}

/// Moves a motion over the ground and rotates it about the vertical, so that its first frame has the position
/// and heading of `first`.
fn stand_where(poses: &mut [Pose], first: &Pose, rest_pelvis: DVec3) {
    let heading = |pose: &Pose| rotation::yaw(DMat3::from_quat(pose.rotations[0]));
    let on_ground = |pose: &Pose| (pose.transl + rest_pelvis).with_y(0.0);
    let Some(begin) = poses.first().copied() else {
        return;
    };
    let turn = DQuat::from_rotation_y(heading(first) - heading(&begin));
    let (from, to) = (on_ground(&begin), on_ground(first));
    for pose in poses {
        pose.rotations[0] = turn * pose.rotations[0];
        let pelvis = pose.transl + rest_pelvis;
        pose.transl = turn * (pelvis - from) + to - rest_pelvis;
    }
}

#[cfg(test)]
mod tests {
    use testkit::wandering;

    use super::*;
    use crate::answers::tests::{item, options};

    #[test]
    fn a_motion_of_the_store_keeps_its_bits() {
        let motion = wandering("answer", 40);
        let recorded = Recorded::of_motion(&motion);
        let (item, skeleton) = (item(0), Skeleton::smplx_neutral());
        let same = recorded.motion(&item, &skeleton, &options());
        assert_eq!(same, Ok(motion));
    }

    #[test]
    fn a_motion_without_a_place_begins_where_the_source_does() {
        let skeleton = Skeleton::smplx_neutral();
        let item = item(0);
        let mut recorded = Recorded::of_motion(&item.source().expect("valid"));
        let as_it_was = recorded.clone();
        // Another origin and another heading.
        let turn = DQuat::from_rotation_y(1.1);
        for (transl, vectors) in recorded.transl.iter_mut().zip(&mut recorded.vectors) {
            let pelvis = DVec3::from_array(*transl) + skeleton.rest(0);
            let moved = turn * pelvis + DVec3::new(3.0, 0.4, -2.0) - skeleton.rest(0);
            *transl = moved.to_array();
            let root = rotation::from_axis_angle(DVec3::from_slice(&vectors[..3]));
            vectors[..3].copy_from_slice(&to_axis_angle(turn * root).to_array());
        }
        let in_place = AnswerOptions {
            place: Some(Place::Source),
            ..options()
        };
        let [back, plain] = [&recorded, &as_it_was].map(|recorded| {
            let motion = recorded.motion(&item, &skeleton, &in_place).expect("valid");
            skeleton.motion_keypoints(&motion).points
        });
        for (back, plain) in back.iter().flatten().zip(plain.iter().flatten()) {
            // Tolerance: single precision of numbers below ten metres.
            assert!(back.distance(*plain) < 1e-5, "{back} and {plain}");
        }
        let (first, source) = (plain[0][0], item.source().expect("valid").pose(0));
        let pelvis = source.transl + skeleton.rest(0);
        assert!((first - pelvis).with_y(0.0).length() < 1e-6);
    }

    #[test]
    fn another_rate_is_brought_to_that_of_the_item() {
        let (item, skeleton) = (item(0), Skeleton::smplx_neutral());
        let motion = wandering("answer", 41);
        let recorded = Recorded::of_motion(&motion);
        let fast = datasets_spec::Resample::Exact.apply(&motion, Fps::new(60.0).expect("a rate"));
        let fast = fast.expect("valid");
        let back = Recorded::of_motion(&fast).motion(&item, &skeleton, &options());
        let back = back.expect("valid");
        assert_eq!((back.fps(), back.len()), (Fps::STORE, 41));
        // Every third frame is one of the motion.
        let (back, motion) = (back.transl().as_flattened(), motion.transl().as_flattened());
        for (a, b) in back.iter().zip(motion) {
            assert!((a - b).abs() < 1e-5, "{a} and {b}");
        }
        let frames = |frames: usize, fps: f64| {
            let mut recorded = Recorded::of_motion(&wandering("answer", frames));
            recorded.fps = Some(fps);
            let motion = recorded.motion(&item, &skeleton, &options());
            motion
                .map(|motion| motion.len())
                .map_err(|rejected| rejected.code)
        };
        // Metrics need three frames, counted at the rate of the item.
        assert_eq!([frames(3, 20.0), frames(7, 60.0)], [Ok(3); 2]);
        assert_eq!([frames(2, 20.0), frames(6, 60.0)], [Err("E-TOO-SHORT"); 2]);
        let mut rateless = recorded;
        rateless.fps = None;
        let refused = rateless.motion(&item, &skeleton, &options());
        let code = refused.map_err(|rejected| rejected.code);
        assert_eq!(code, Err("E-ANSWER-FPS"));
    }
}
