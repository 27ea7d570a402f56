//! Motions as MotionFix stores them: parameters of SMPL-H and joints, z up, 30 fps, each motion placed and rotated
//! independently.
//!
//! The first frame has a translation of zero. As in the release, it faces 45 degrees from +x, plus the turn from the
//! first to the second frame. The body rotations are written unchanged. The joints are those of a SMPL body: SMPL's
//! bone directions at rest, with the bone lengths of the dataset's body.
//!
//! # Source
//! athn-nik/motionfix: `canonicalize_rotations` in `src/tools/transforms3d.py`, and `src/data/motionfix.py`, which
//! reads the dump.

use std::f64::consts::FRAC_PI_4;

use datasets_spec::{Motion, Pose, Resample, Skeleton};
use features::{released_fps, smpl_body};
use glam::{DQuat, DVec3};
use kinematics::rotation::to_axis_angle;
use kinematics::skeleton::NUM_BODY_JOINTS;
use pickle::Value;

use crate::source::Up;
use crate::source::smpl::turn_world;

/// Numbers per frame of `rots`: the root and 21 body joints, axis-angle.
const ROTATIONS_WIDTH: usize = 3 * NUM_BODY_JOINTS;

/// The arrays of a motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Rotations of the root and 21 body joints, `[L, 66]`, axis-angle.
    pub rots: Vec<[f32; ROTATIONS_WIDTH]>,
    /// Translations, `[L, 3]` in metres.
    pub trans: Vec<[f32; 3]>,
    /// Joints, `[L, 22, 3]` in metres.
    pub joint_positions: Vec<[[f32; 3]; NUM_BODY_JOINTS]>,
}

impl Parameters {
    /// The arrays of a motion on a body, resampled to 30 fps.
    ///
    /// # Errors
    /// The motion cannot be resampled.
    pub fn of(motion: &Motion, skeleton: &Skeleton) -> Result<Self, kinematics::Error> {
        let motion = Resample::Exact.apply(motion, released_fps())?;
        let z_up = Up::Z.turn().conjugate();
        let mut poses = motion.poses();
        for pose in &mut poses {
            turn_world(pose, z_up, skeleton);
        }
        canonicalise(&mut poses);
        let joints = smpl_body(skeleton).points_of_poses::<NUM_BODY_JOINTS>(&poses);
        let rounded = |vector: DVec3| vector.as_vec3().to_array();
        let rots = poses.iter().zip(motion.body_pose()).map(|(pose, body)| {
            let mut rots = [0.0; ROTATIONS_WIDTH];
            rots[..3].copy_from_slice(&rounded(to_axis_angle(pose.rotations[0])));
            rots[3..].copy_from_slice(body);
            rots
        });
        Ok(Self {
            rots: rots.collect(),
            trans: poses.iter().map(|pose| rounded(pose.transl)).collect(),
            joint_positions: joints.iter().map(|frame| frame.map(rounded)).collect(),
        })
    }

    /// The dictionary of one motion of a pair. `timestamp` is the time range in seconds that the motion was cut from.
    pub fn value(&self, timestamp: [f64; 2]) -> Value {
        let frames = self.trans.len();
        let joints = self.joint_positions.as_flattened().as_flattened();
        let array =
            |shape: &[usize], numbers: &[f32]| Value::floats(shape, numbers.iter().copied());
        let rots = array(&[frames, ROTATIONS_WIDTH], self.rots.as_flattened());
        Value::dict([
            ("rots", rots),
            ("trans", array(&[frames, 3], self.trans.as_flattened())),
            (
                "joint_positions",
                array(&[frames, NUM_BODY_JOINTS, 3], joints),
            ),
            (
                "timestamp",
                Value::List(timestamp.map(Value::Float).to_vec()),
            ),
        ])
    }
}

/// Places and rotates a motion with +z up like those of the release.
fn canonicalise(poses: &mut [Pose]) {
    let Some(first) = poses.first() else { return };
    let (start, origin) = (heading(first), first.transl);
    let turn = poses.get(1).map_or(0.0, |second| heading(second) - start);
    // Wraps the angle to at most half a turn in either direction.
    let turn = turn.sin().atan2(turn.cos());
    let turn = DQuat::from_rotation_z(FRAC_PI_4 + turn - start);
    for pose in poses {
        pose.rotations[0] = turn * pose.rotations[0];
        pose.transl = turn * (pose.transl - origin);
    }
}

/// The angle about z that is applied last (Euler angles "ZYX").
fn heading(pose: &Pose) -> f64 {
    let side = pose.rotations[0] * DVec3::X;
    side.y.atan2(side.x)
}

#[cfg(test)]
mod tests {
    use datasets_spec::Fps;
    use kinematics::rotation::{angle_between, from_axis_angle};
    use testkit::walk;

    use super::*;
    use crate::golden::read;

    #[test]
    fn golden_motionfix_clips_are_placed_and_turned_as_released() {
        let recorded = read("motionfix_features");
        let poses = |rots: &str, trans: &str| -> Vec<Pose> {
            let rots = recorded.get(rots).values.chunks_exact(ROTATIONS_WIDTH);
            let trans = recorded.get(trans).values.chunks_exact(3);
            rots.zip(trans)
                .map(|(rots, trans)| Pose {
                    transl: DVec3::from_slice(trans),
                    rotations: std::array::from_fn(|joint| {
                        from_axis_angle(DVec3::from_slice(&rots[3 * joint..]))
                    }),
                })
                .collect()
        };
        let mut found = poses("in.rots", "in.trans");
        canonicalise(&mut found);
        let expected = poses("out.canon_rots", "out.canon_trans");
        assert_eq!(found.len(), expected.len());
        let origin = expected[0].transl;
        for (frame, (found, expected)) in found.iter().zip(&expected).enumerate() {
            // The released code sums the turns in f32.
            let apart = angle_between(found.rotations[0], expected.rotations[0]);
            assert!(apart < 2e-5, "{apart} rad in frame {frame}");
            let apart = found.transl.distance(expected.transl - origin);
            assert!(apart < 5e-5, "{apart} m in frame {frame}");
        }
    }

    #[test]
    fn arrays_have_the_shapes_of_the_release_and_stand_upright() {
        let skeleton = Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &walk(60)).expect("valid");
        let found = Parameters::of(&motion, &skeleton).expect("resampled");
        assert_eq!((found.rots.len(), found.trans[0]), (89, [0.0; 3]));
        for joints in &found.joint_positions {
            let head = joints[15][2] - joints[0][2];
            assert!((0.4..0.8).contains(&head), "{head} m above the pelvis");
        }
        let value = found.value([0.5, 3.0]);
        for (key, shape) in [
            ("rots", &[89, 66][..]),
            ("trans", &[89, 3]),
            ("joint_positions", &[89, 22, 3]),
        ] {
            let array = value.get(key).and_then(Value::as_array).expect(key);
            assert_eq!(array.shape(), shape, "{key}");
        }
    }
}
