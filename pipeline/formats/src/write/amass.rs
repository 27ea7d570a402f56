//! AMASS archives: the SMPL-H layout (`*_poses.npz`) and the layout of the SMPL-X N release (`*_stageii.npz`).
//!
//! AMASS is z up. The reader's rule `p' = (x, z, -y)`, a rotation `Q` by -90 degrees about x with
//! `R' = Q R` and `t' = Q (t + J0) - J0`, is inverted here; `J0` is the rest pelvis of the skeleton.
//! The body rotations are written unchanged, for the motion's own skeleton.
//!
//! # Source
//! The key lists of the SMPL+H G and SMPL-X N releases of AMASS.

use std::io;

use datasets_spec::{Fps, Motion, Resample, Skeleton};
use kinematics::rotation::to_axis_angle;
use pickle::npz::Writer;

use crate::source::Up;
use crate::source::smpl::turn_world;

/// Joints of a row of `poses` in the SMPL-H layout.
const SMPLH_JOINTS: usize = 52;
/// Joints of a row of `poses` in the SMPL-X layout.
const SMPLX_JOINTS: usize = 55;
/// Number of `betas`.
const NUM_BETAS: usize = 16;
/// Columns of `dmpls`, the soft-tissue coefficients.
const NUM_DMPLS: usize = 8;

/// Lowest rate in 1/s of archives for other tools.
const LOWEST_FPS: f64 = 60.0;

/// Resamples a motion to the smallest multiple of its rate that is at least 60 fps, like recordings of AMASS.
///
/// Tools that convert AMASS to 20 or 30 fps take every n-th frame, with n the ratio of the rates rounded down; GMR
/// treats lower rates than 30 fps as 30 fps. A motion of 20 fps would be played too fast. The result contains every
/// frame of the motion.
///
/// # Errors
/// The motion cannot be resampled.
pub fn at_rate_of_recordings(motion: &Motion) -> Result<Motion, kinematics::Error> {
    /// Rates slightly below, such as 59.94 fps, are kept.
    const SLACK: f64 = 0.01;
    let own = motion.fps().get();
    let times = (LOWEST_FPS / own - SLACK).ceil().max(1.0);
    Resample::Exact.apply(motion, Fps::new(own * times)?)
}

/// Parameters of a motion in the axes of AMASS (z up), row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Frames, `L`.
    pub num_frames: usize,
    /// Root orientations `[L, 3]`, axis-angle.
    pub root: Vec<f64>,
    /// Body rotations `[L, 63]`, axis-angle.
    pub body: Vec<f64>,
    /// Translations `[L, 3]` in metres.
    pub trans: Vec<f64>,
}

impl Parameters {
    /// The parameters of a motion on a body, at the motion's rate.
    pub fn of(motion: &Motion, skeleton: &Skeleton) -> Self {
        let file_from_motion = Up::Z.turn().conjugate();
        let (mut root, mut trans) = (Vec::new(), Vec::new());
        for mut pose in motion.poses() {
            turn_world(&mut pose, file_from_motion, skeleton);
            root.extend(to_axis_angle(pose.rotations[0]).to_array());
            trans.extend(pose.transl.to_array());
        }
        let body = motion.body_pose().as_flattened().iter();
        Self {
            num_frames: motion.len(),
            root,
            body: body.map(|&value| f64::from(value)).collect(),
            trans,
        }
    }

    /// Rows of `poses`: root, body, and the remaining joints at rest.
    fn poses(&self, num_joints: usize) -> Vec<f64> {
        let width = 3 * num_joints;
        let mut poses = Vec::with_capacity(self.num_frames * width);
        let bodies = self.body.chunks_exact(self.body.len() / self.num_frames);
        for (frame, (root, body)) in self.root.chunks_exact(3).zip(bodies).enumerate() {
            poses.extend_from_slice(root);
            poses.extend_from_slice(body);
            poses.resize((frame + 1) * width, 0.0);
        }
        poses
    }
}

/// Encodes a motion in the SMPL-H layout: `poses` `[L, 156]` (root, 21 body joints, flat hands),
/// `trans` `[L, 3]`, `betas` and `dmpls` zero, `gender` "neutral", `mocap_framerate`.
///
/// # Errors
/// An array exceeds 4 GiB.
pub fn encode(motion: &Motion, skeleton: &Skeleton) -> io::Result<Vec<u8>> {
    let parameters = Parameters::of(motion, skeleton);
    let num_frames = motion.len();
    let mut archive = Writer::default();
    let poses = parameters.poses(SMPLH_JOINTS);
    archive.numbers("poses", &[num_frames, 3 * SMPLH_JOINTS], &poses)?;
    archive.numbers("trans", &[num_frames, 3], &parameters.trans)?;
    archive.numbers("betas", &[NUM_BETAS], &[0.0; NUM_BETAS])?;
    let dmpls = vec![0.0; num_frames * NUM_DMPLS];
    archive.numbers("dmpls", &[num_frames, NUM_DMPLS], &dmpls)?;
    archive.numbers("mocap_framerate", &[], &[motion.fps().get()])?;
    archive.text("gender", "neutral")?;
    archive.finish()
}

/// Encodes a motion in the layout of the SMPL-X N release: `poses` `[L, 165]` (root, body, jaw, eyes, hands) and the
/// same in parts, `trans` `[L, 3]`, `betas` zero, gender neutral, the rate under both names in use. Hands, jaw and eyes
/// are at rest.
///
/// # Errors
/// As [`encode`].
pub fn encode_smplx(motion: &Motion, skeleton: &Skeleton) -> io::Result<Vec<u8>> {
    smplx(motion, skeleton)?.finish()
}

/// [`encode_smplx`], with the 28 keypoints in the same axes: `keypoints` `[L, 28, 3]` in metres.
///
/// # Errors
/// As [`encode`].
pub fn encode_with_keypoints(motion: &Motion, skeleton: &Skeleton) -> io::Result<Vec<u8>> {
    let mut archive = smplx(motion, skeleton)?;
    let points = skeleton.motion_keypoints(motion).points;
    // The rotation from y up, written out so that its numbers are exact.
    let z_up: Vec<f64> = points
        .iter()
        .flatten()
        .flat_map(|point| [point.x, -point.z, point.y])
        .collect();
    let num_points = z_up.len() / 3 / points.len();
    archive.numbers("keypoints", &[points.len(), num_points, 3], &z_up)?;
    archive.finish()
}

fn smplx(motion: &Motion, skeleton: &Skeleton) -> io::Result<Writer> {
    let parameters = Parameters::of(motion, skeleton);
    let (num_frames, fps) = (motion.len(), motion.fps().get());
    let mut archive = Writer::default();
    archive.text("gender", "neutral")?;
    archive.text("surface_model_type", "smplx")?;
    archive.numbers("mocap_frame_rate", &[], &[fps])?;
    // The rate again, under the key of the SMPL+H release: Blender add-ons read that one.
    archive.numbers("mocap_framerate", &[], &[fps])?;
    archive.numbers("mocap_time_length", &[], &[num_frames as f64 / fps])?;
    archive.numbers("betas", &[NUM_BETAS], &[0.0; NUM_BETAS])?;
    archive.numbers("num_betas", &[], &[NUM_BETAS as i64])?;
    let at_rest = |num_joints: usize| vec![0.0; num_frames * 3 * num_joints];
    for (name, values) in [
        ("trans", &parameters.trans),
        ("poses", &parameters.poses(SMPLX_JOINTS)),
        ("root_orient", &parameters.root),
        ("pose_body", &parameters.body),
        ("pose_hand", &at_rest(30)),
        ("pose_jaw", &at_rest(1)),
        ("pose_eye", &at_rest(2)),
    ] {
        archive.numbers(name, &[num_frames, values.len() / num_frames], values)?;
    }
    Ok(archive)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use datasets_spec::{Fps, Pose};
    use glam::{DQuat, DVec3};
    use pickle::npz::Archive;

    use super::*;

    fn member(bytes: &[u8], name: &str) -> (Vec<usize>, Vec<f64>) {
        let mut archive = Archive::open(Cursor::new(bytes)).expect("an archive");
        let array = archive.numbers(name).expect("numbers");
        (array.shape, array.values)
    }

    fn motion() -> Motion {
        let mut pose = Pose::REST;
        pose.transl = DVec3::new(0.4, 1.3, -0.2);
        pose.rotations[0] = DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(0.2);
        pose.rotations[21] = DQuat::from_rotation_z(0.5);
        Motion::from_poses(Fps::STORE, &[Pose::REST, pose]).expect("valid")
    }

    #[test]
    fn the_archive_has_the_layout_of_amass() {
        let bytes = encode(&motion(), &Skeleton::smplx_neutral()).expect("encoded");
        for (name, shape) in [
            ("poses", vec![2, 156]),
            ("trans", vec![2, 3]),
            ("betas", vec![16]),
            ("dmpls", vec![2, 8]),
            ("mocap_framerate", vec![]),
        ] {
            assert_eq!(member(&bytes, name).0, shape, "{name}");
        }
        assert_eq!(member(&bytes, "mocap_framerate").1, [20.0]);
        let (_, poses) = member(&bytes, "poses");
        let wrist = poses[156 + 65];
        assert!((wrist - 0.5).abs() < 1e-7, "the right wrist turns about z");
        let mut hands = poses[156 + 66..].iter();
        assert!(hands.all(|&v| v == 0.0), "hands are flat");
    }

    #[test]
    fn the_readers_rule_recovers_the_motion() {
        let (motion, skeleton) = (motion(), Skeleton::smplx_neutral());
        let bytes = encode(&motion, &skeleton).expect("encoded");
        let (_, poses) = member(&bytes, "poses");
        let (_, trans) = member(&bytes, "trans");
        let upright = DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2);
        for (frame, pose) in motion.poses().into_iter().enumerate() {
            let root = DVec3::from_slice(&poses[156 * frame..]);
            let root = upright * kinematics::rotation::from_axis_angle(root);
            assert!(kinematics::rotation::angle_between(root, pose.rotations[0]) < 1e-9);
            let t = DVec3::from_slice(&trans[3 * frame..]);
            let t = upright * (t + skeleton.rest(0)) - skeleton.rest(0);
            assert!((t - pose.transl).length() < 1e-12);
        }
    }

    #[test]
    fn a_standing_body_is_z_up_in_the_file() {
        let skeleton = Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST]).expect("valid");
        let bytes = encode(&motion, &skeleton).expect("encoded");
        let (_, poses) = member(&bytes, "poses");
        let root = kinematics::rotation::from_axis_angle(DVec3::from_slice(&poses));
        // The head is up, and the body faces -y.
        assert!((root * DVec3::Y - DVec3::Z).length() < 1e-9);
        assert!((root * DVec3::Z - DVec3::NEG_Y).length() < 1e-9);
    }

    #[test]
    fn every_frame_of_a_motion_is_in_that_for_other_tools() {
        for (own, expected) in [
            (20.0, 60.0),
            (30.0, 60.0),
            (24.0, 72.0),
            (59.94, 59.94),
            (60.0, 60.0),
            (120.0, 120.0),
        ] {
            let fps = Fps::new(own).expect("a rate");
            let motion = Motion::from_poses(fps, &testkit::walk(50));
            let motion = motion.expect("valid");
            let found = at_rate_of_recordings(&motion).expect("resampled");
            assert!((found.fps().get() - expected).abs() < 1e-9, "{own}");
            let times = (expected / own).round() as usize;
            assert_eq!(found.len(), 49 * times + 1, "{own}");
            for frame in 0..50 {
                let (own, found) = (motion.pose(frame), found.pose(frame * times));
                assert!(own.transl.distance(found.transl) < 1e-6);
                for (a, b) in own.rotations.iter().zip(found.rotations) {
                    assert!(kinematics::rotation::angle_between(*a, b) < 1e-6);
                }
            }
        }
    }
}
