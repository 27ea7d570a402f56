//! The 272 features per frame of MotionStreamer, HumanML3D-272, BABEL-272 and MotionMillion, from any motion
//! and back.
//!
//! They contain the body's own rotations, so a motion is recovered without inverse kinematics. `J` = 22, y up, metres,
//! 30 fps; rotations are the first two rows of their matrix. The heading `h` of a frame is the angle about y of its
//! root's +z axis, and "seen" means rotated about y by `-h`.
//!
//! | columns | content |
//! |---|---|
//! | 0..2 | step of the root on the ground since the frame before, x and z, seen from the frame before |
//! | 2..8 | rotation about y by minus the change of heading since the frame before |
//! | 8..74 | joints seen from the frame, with the root at x = z = 0 |
//! | 74..140 | change of 8..74 since the frame before |
//! | 140..272 | local rotations; that of the root without its heading |
//!
//! The lowest joint of the clip has height 0. The first frame has no step, no turn and no change.
//!
//! # Source
//! Li-xingXiao/272-dim-Motion-Representation: `face_z_transform.py`, `representation_272.py`,
//! `recover_visualize.py`, `cal_mean_std.py`.

use datasets_spec::{Motion, Pose, Resample, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation::{from_six_d_rows, to_six_d_rows, yaw};
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::humanml3d::{FeatureError, Joints};
use super::released_fps;
use crate::floor;

/// Name and version of the recipe. Any change of its numbers is a new version.
pub const RECIPE: &str = "272@1";
/// Number of features of a frame.
pub const WIDTH: usize = 272;
/// The features of a frame.
pub type Features = [f32; WIDTH];

/// First column of the joints, of their changes, and of the rotations.
const JOINTS: usize = 8;
const CHANGES: usize = JOINTS + 3 * NUM_BODY_JOINTS;
const ROTATIONS: usize = CHANGES + 3 * NUM_BODY_JOINTS;

/// Ranges of the feature groups in a frame. The published standard deviation is averaged within each.
pub const GROUPS: [(&str, std::ops::Range<usize>); 5] = [
    ("root velocity", 0..2),
    ("heading velocity", 2..JOINTS),
    ("joint positions", JOINTS..CHANGES),
    ("joint velocities", CHANGES..ROTATIONS),
    ("joint rotations", ROTATIONS..WIDTH),
];

/// The features of a motion on a body, at 30 fps. The motion's place and heading do not matter.
///
/// # Shapes
/// `[L, 272]` for a motion of `L` frames at 30 fps; motions of other rates are interpolated.
///
/// # Errors
/// The motion cannot be resampled to 30 fps.
pub fn features_of_motion(
    motion: &Motion,
    skeleton: &Skeleton,
) -> Result<Vec<Features>, kinematics::Error> {
    let poses = faced_poses(motion)?;
    Ok(features_of_poses(&poses, &skeleton.points_of_poses(&poses)))
}

/// The poses of a motion at 30 fps, facing +z in the first frame.
pub(crate) fn faced_poses(motion: &Motion) -> Result<Vec<Pose>, kinematics::Error> {
    let mut poses = Resample::Exact.apply(motion, released_fps())?.poses();
    face_front(&mut poses);
    Ok(poses)
}

/// Turns a clip about the vertical axis through the origin, so that its first frame faces +z. As published, the
/// translation is turned but not the rest position of the pelvis, which moves the whole clip by a constant.
pub fn face_front(poses: &mut [Pose]) {
    let Some(first) = poses.first() else { return };
    let turn = DQuat::from_rotation_y(-heading(first));
    for pose in poses {
        pose.rotations[0] = turn * pose.rotations[0];
        pose.transl = turn * pose.transl;
    }
}

fn heading(pose: &Pose) -> f64 {
    yaw(DMat3::from_quat(pose.rotations[0]))
}

/// The features of consecutive poses at 30 fps and their joints.
///
/// # Shapes
/// `[L]` poses and joints give `[L, 272]`.
pub fn features_of_poses(poses: &[Pose], joints: &[Joints]) -> Vec<Features> {
    let heights = joints.iter().flatten().map(|joint| joint.y);
    let lowest = heights.fold(f64::INFINITY, f64::min);
    let mut before: Option<(f64, DVec3, Joints)> = None;
    poses
        .iter()
        .zip(joints)
        .map(|(pose, joints)| {
            let (heading, root) = (heading(pose), joints[0]);
            let unturn = DQuat::from_rotation_y(-heading);
            let below = root.with_y(lowest);
            let seen = joints.map(|joint| unturn * (joint - below));
            // The first frame has no change: it is compared with itself.
            let (heading_before, root_before, seen_before) = before
                .replace((heading, root, seen))
                .unwrap_or((heading, root, seen));
            let step = DQuat::from_rotation_y(-heading_before) * (root - root_before);
            let turn = DMat3::from_rotation_y(heading_before - heading);
            let mut frame = [0.0; WIDTH];
            frame[0] = step.x as f32;
            frame[1] = step.z as f32;
            put(&mut frame[2..JOINTS], to_six_d_rows(turn));
            for (joint, (now, then)) in seen.iter().zip(seen_before).enumerate() {
                put(&mut frame[JOINTS + 3 * joint..], now.to_array());
                put(&mut frame[CHANGES + 3 * joint..], (*now - then).to_array());
            }
            for (joint, &rotation) in pose.rotations.iter().enumerate() {
                let local = if joint == 0 {
                    unturn * rotation
                } else {
                    rotation
                };
                let rows = to_six_d_rows(DMat3::from_quat(local));
                put(&mut frame[ROTATIONS + 6 * joint..], rows);
            }
            frame
        })
        .collect()
}

fn put<const N: usize>(slot: &mut [f32], values: [f64; N]) {
    for (slot, value) in slot.iter_mut().zip(values) {
        *slot = value as f32;
    }
}

fn numbers<const N: usize>(frame: &Features, at: usize) -> [f64; N] {
    std::array::from_fn(|column| f64::from(frame[at + column]))
}

/// For every frame, the rotation that undoes "seen" and the root's position on the ground.
fn recover_root(features: &[Features]) -> Vec<(DMat3, DVec3)> {
    let (mut unturn, mut ground) = (DMat3::IDENTITY, DVec3::ZERO);
    features
        .iter()
        .map(|frame| {
            let [x, z] = numbers(frame, 0);
            // The root step is relative to the heading of the previous frame; for the first frame, to the identity.
            ground += unturn.transpose() * DVec3::new(x, 0.0, z);
            unturn = from_six_d_rows(numbers(frame, 2)) * unturn;
            (unturn.transpose(), ground.with_y(0.0))
        })
        .collect()
}

fn joint(frame: &Features, joint: usize) -> DVec3 {
    DVec3::from_array(numbers(frame, JOINTS + 3 * joint))
}

/// The joints from the positions of the features; the first frame faces +z at x = z = 0.
///
/// # Shapes
/// As many frames as there are features.
pub fn recover_joints(features: &[Features]) -> Vec<Joints> {
    let roots = recover_root(features).into_iter().zip(features);
    roots
        .map(|((turn, ground), frame)| {
            std::array::from_fn(|index| turn * joint(frame, index) + ground)
        })
        .collect()
}

/// The poses from the rotations of the features, placed and facing as in [`recover_joints`], on a body whose pelvis
/// rests at `rest_pelvis`. The published recovery returns the pelvis position as the translation, which corresponds to
/// a `rest_pelvis` of zero.
///
/// # Shapes
/// As many frames as there are features.
pub fn recover_poses(features: &[Features], rest_pelvis: DVec3) -> Vec<Pose> {
    let roots = recover_root(features).into_iter().zip(features);
    roots
        .map(|((turn, ground), frame)| {
            let pelvis = ground.with_y(joint(frame, 0).y);
            let rotations = std::array::from_fn(|index| {
                let local = from_six_d_rows(numbers(frame, ROTATIONS + 6 * index));
                let rotation = if index == 0 { turn * local } else { local };
                DQuat::from_mat3(&rotation).normalize()
            });
            Pose {
                transl: pelvis - rest_pelvis,
                rotations,
            }
        })
        .collect()
}

/// The motion that the features describe, on the body `skeleton`, at 30 fps and on the floor. The path is scaled by the
/// ratio of the two bodies' leg lengths, because the body of the features may have another shape. Also returns the mean
/// distance in metres between the scaled joints of the features and the joints of the motion, both relative to the
/// pelvis.
///
/// # Errors
/// There is no frame, the legs of the features have no length, or a number is not finite.
pub fn motion_of_features(
    features: &[Features],
    skeleton: &Skeleton,
) -> Result<(Motion, f32), FeatureError> {
    if features.is_empty() {
        return Err(FeatureError::TooShort { frames: 0 });
    }
    let scale = leg_ratio(features, skeleton)
        .ok_or_else(|| FeatureError::no_motion("the legs have no length"))?;
    let mut poses = recover_poses(features, DVec3::ZERO);
    for pose in &mut poses {
        pose.transl = pose.transl * scale - skeleton.rest(0);
    }
    let fps = released_fps();
    floor::put_on_floor(&mut poses, fps, skeleton);
    let motion = Motion::from_poses(fps, &poses).map_err(FeatureError::no_motion)?;
    let stated = recover_joints(features);
    let posed: Vec<Joints> = skeleton.points_of_poses(&poses);
    let apart: f64 = stated
        .iter()
        .zip(&posed)
        .flat_map(|(stated, posed)| {
            let relative =
                move |joint: usize| (stated[joint] - stated[0]) * scale - (posed[joint] - posed[0]);
            (0..NUM_BODY_JOINTS).map(move |joint| relative(joint).length())
        })
        .sum();
    let joints = (NUM_BODY_JOINTS * features.len()) as f64;
    Ok((motion, (apart / joints) as f32))
}

/// Ratio of the length of the body's right leg to that of the features, averaged over the frames.
fn leg_ratio(features: &[Features], skeleton: &Skeleton) -> Option<f64> {
    /// Hip, knee and ankle.
    const LEG: [usize; 3] = [2, 5, 8];
    let [_, knee, ankle] = LEG.map(|joint| skeleton.offset(joint).length());
    let legs = features.iter().map(|frame| {
        let [hip, knee, ankle] = LEG.map(|index| joint(frame, index));
        (knee - hip).length() + (ankle - knee).length()
    });
    let mean = legs.sum::<f64>() / features.len() as f64;
    /// Legs at most this long, in metres, count as degenerate.
    const SHORTEST_M: f64 = 1e-3;
    (mean > SHORTEST_M && mean.is_finite()).then(|| (knee + ankle) / mean)
}

#[cfg(test)]
mod tests {
    use datasets_spec::Fps;
    use kinematics::rotation::{angle_between, from_axis_angle};
    use kinematics::skeleton::NUM_JOINTS;
    use proptest::prelude::*;
    use testkit::walk;

    use super::*;
    use crate::golden::{Recorded, read};

    fn vectors(recorded: &Recorded, key: &str) -> Vec<DVec3> {
        let values = recorded.get(key).values.chunks_exact(3);
        values.map(DVec3::from_slice).collect()
    }

    fn frames(recorded: &Recorded, key: &str) -> Vec<Joints> {
        let vectors = vectors(recorded, key);
        let (frames, rest) = vectors.as_chunks::<NUM_BODY_JOINTS>();
        assert!(rest.is_empty(), "{key}");
        frames.to_vec()
    }

    fn poses(recorded: &Recorded, rotations: &str, transl: &str) -> Vec<Pose> {
        let transl = vectors(recorded, transl);
        let rotations = frames(recorded, rotations).into_iter();
        rotations
            .zip(transl)
            .map(|(vectors, transl)| Pose {
                transl,
                rotations: vectors.map(from_axis_angle),
            })
            .collect()
    }

    fn largest_distance(a: &[Joints], b: &[Joints]) -> f64 {
        assert_eq!(a.len(), b.len());
        let pairs = a.as_flattened().iter().zip(b.as_flattened());
        pairs.fold(0.0, |largest, (a, b)| largest.max(a.distance(*b)))
    }

    fn assert_near(a: &[Pose], b: &[Pose], metres: f64, radians: f64) {
        assert_eq!(a.len(), b.len());
        for (frame, (a, b)) in a.iter().zip(b).enumerate() {
            let apart = a.transl.distance(b.transl);
            assert!(apart < metres, "{apart} m in frame {frame}");
            for joint in 0..NUM_BODY_JOINTS {
                let apart = angle_between(a.rotations[joint], b.rotations[joint]);
                assert!(apart < radians, "{apart} rad at {joint} in frame {frame}");
            }
        }
    }

    fn recorded_features(recorded: &Recorded) -> Vec<Features> {
        let (rows, rest) = recorded.get("out.features").values.as_chunks::<WIDTH>();
        assert!(rest.is_empty() && !rows.is_empty());
        rows.iter()
            .map(|row| row.map(|value| value as f32))
            .collect()
    }

    #[test]
    fn golden_272_facing_and_features_follow_the_published_code() {
        let recorded = read("representation_272");
        let mut found = poses(&recorded, "in.axis_angle", "in.transl");
        face_front(&mut found);
        let expected = poses(&recorded, "out.facing_axis_angle", "out.facing_transl");
        // The published heading goes through f32.
        assert_near(&found, &expected, 2e-6, 2e-6);
        let mut rest = [DVec3::ZERO; NUM_JOINTS];
        let body = vectors(&recorded, "in.rest_joints");
        rest[..NUM_BODY_JOINTS].copy_from_slice(&body);
        let joints: Vec<Joints> = Skeleton::new("recorded", rest).points_of_poses(&found);
        let expected = frames(&recorded, "out.facing_joints");
        let apart = largest_distance(&joints, &expected);
        assert!(apart < 5e-6, "{apart}");
        let expected = recorded_features(&recorded);
        let found = features_of_poses(&found, &joints);
        assert_eq!(found.len(), expected.len());
        for (frame, (found, expected)) in found.iter().zip(&expected).enumerate() {
            for column in 0..WIDTH {
                let apart = (found[column] - expected[column]).abs();
                // Positions of a few metres and rotations that went through f32.
                assert!(apart < 5e-6, "column {column} of frame {frame}: {apart}");
            }
        }
    }

    #[test]
    fn golden_272_recoveries_follow_the_published_code() {
        let recorded = read("representation_272");
        let features = recorded_features(&recorded);
        let expected = frames(&recorded, "out.recovered_joints");
        let apart = largest_distance(&recover_joints(&features), &expected);
        assert!(apart < 1e-5, "{apart}");
        let (angles, transl) = ("out.recovered_axis_angle", "out.recovered_transl");
        let found = recover_poses(&features, DVec3::ZERO);
        assert_near(&found, &poses(&recorded, angles, transl), 1e-5, 1e-5);
    }

    /// A body at rest that walks on a circle of this radius in metres and turns by `turn` in each frame.
    fn circle(radius: f64, turn: f64, frames: i32) -> Vec<Pose> {
        (0..frames)
            .map(|frame| {
                // The motion starts at an arbitrary position and heading.
                let heading = 2.1 + turn * f64::from(frame);
                let mut pose = Pose::REST;
                pose.rotations[0] = DQuat::from_rotation_y(heading);
                pose.transl = DVec3::new(4.0 - radius * heading.cos(), 1.3, radius * heading.sin());
                pose
            })
            .collect()
    }

    #[test]
    fn a_circle_a_turn_on_the_spot_and_a_still_pose_have_constant_features() {
        let skeleton = Skeleton::smplx_neutral();
        for (radius, turn) in [(1.5, 0.05), (1.5, -0.05), (0.0, 0.05), (0.0, 0.0)] {
            let motion = Motion::from_poses(released_fps(), &circle(radius, turn, 150));
            let motion = motion.expect("valid");
            let features = features_of_motion(&motion, &skeleton).expect("at its rate");
            assert_eq!(features.len(), 150);
            // A chord of the circle points half of the turn to the side.
            let chord = 2.0 * radius * (turn / 2.0).sin();
            let step = [chord * (turn / 2.0).sin(), chord * (turn / 2.0).cos()];
            let turned = [turn.cos(), 0.0, -turn.sin(), 0.0, 1.0, 0.0];
            let still = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
            let lowest = (0..NUM_BODY_JOINTS).map(|joint| skeleton.rest(joint).y);
            let lowest = lowest.fold(f64::INFINITY, f64::min);
            for (frame, row) in features.iter().enumerate() {
                let near = |at: usize, expected: &[f64]| {
                    for (column, expected) in expected.iter().enumerate() {
                        let apart = f64::from(row[at + column]) - expected;
                        // Stored translations of a few metres have 24 bits.
                        let column = at + column;
                        assert!(apart.abs() < 2e-6, "{column} of frame {frame}: {apart}");
                    }
                };
                near(0, if frame == 0 { &[0.0, 0.0] } else { &step });
                near(2, if frame == 0 { &still } else { &turned });
                for joint in 0..NUM_BODY_JOINTS {
                    let pelvis = skeleton.rest(0).with_y(lowest);
                    near(8 + 3 * joint, &(skeleton.rest(joint) - pelvis).to_array());
                    near(74 + 3 * joint, &[0.0; 3]);
                    near(140 + 6 * joint, &still);
                }
            }
        }
    }

    #[test]
    fn features_do_not_depend_on_place_and_heading() {
        let skeleton = Skeleton::smplx_neutral();
        let turn = DQuat::from_rotation_y(2.4);
        let here = walk(60);
        let there: Vec<Pose> = here
            .iter()
            .map(|pose| {
                let mut pose = *pose;
                pose.rotations[0] = turn * pose.rotations[0];
                pose.transl = turn * pose.transl + DVec3::new(3.0, 0.7, -2.0);
                pose
            })
            .collect();
        let of = |poses: &[Pose]| {
            let motion = Motion::from_poses(Fps::STORE, poses).expect("valid");
            features_of_motion(&motion, &skeleton).expect("resampled")
        };
        let (here, there) = (of(&here), of(&there));
        assert_eq!(here.len(), 89, "60 frames at 20 fps end at 2.95 s");
        for (a, b) in here.as_flattened().iter().zip(there.as_flattened()) {
            assert!((a - b).abs() < 2e-6, "{a} and {b}");
        }
    }

    #[test]
    fn a_body_of_another_size_walks_a_path_of_the_size_of_this_one() {
        let skeleton = Skeleton::smplx_neutral();
        let tall = std::array::from_fn(|joint| 1.25 * skeleton.rest(joint));
        let tall = Skeleton::new("tall", tall);
        let mut steps = walk(60);
        face_front(&mut steps);
        let short = Motion::from_poses(released_fps(), &steps).expect("valid");
        for pose in &mut steps {
            pose.transl *= 1.25;
        }
        let long = Motion::from_poses(released_fps(), &steps).expect("valid");
        let features = features_of_motion(&long, &tall).expect("at its rate");
        let (found, error) = motion_of_features(&features, &skeleton).expect("a motion");
        assert!(error < 1e-6, "{error}");
        let expected = features_of_motion(&short, &skeleton).expect("at its rate");
        let found = features_of_motion(&found, &skeleton).expect("at its rate");
        for (a, b) in found.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((a - b).abs() < 5e-6, "{a} and {b}");
        }
    }

    #[test]
    fn features_without_a_body_are_refused() {
        let skeleton = Skeleton::smplx_neutral();
        assert!(motion_of_features(&[], &skeleton).is_err());
        assert!(motion_of_features(&[[0.0; WIDTH]; 3], &skeleton).is_err());
        let motion = Motion::from_poses(released_fps(), &walk(3)).expect("valid");
        let mut features = features_of_motion(&motion, &skeleton).expect("at its rate");
        features[1][0] = f32::NAN;
        assert!(motion_of_features(&features, &skeleton).is_err());
    }

    proptest! {
        /// Motion to features and back, however the body moves.
        #[test]
        fn the_motion_comes_back(
            frames in prop::collection::vec(
                prop::array::uniform23(prop::array::uniform3(-1.7..1.7f64)),
                1..40,
            ),
        ) {
            let skeleton = Skeleton::smplx_neutral();
            let poses: Vec<Pose> = frames
                .iter()
                .map(|frame| Pose {
                    transl: DVec3::from_array(frame[22]),
                    rotations: std::array::from_fn(|joint| {
                        from_axis_angle(DVec3::from_array(frame[joint]))
                    }),
                })
                .collect();
            let motion = Motion::from_poses(released_fps(), &poses).expect("finite");
            let features = features_of_motion(&motion, &skeleton).expect("at its rate");
            let mut expected = motion.poses();
            face_front(&mut expected);
            let joints: Vec<Joints> = skeleton.points_of_poses(&expected);
            let heights = joints.iter().flatten().map(|joint| joint.y);
            let lowest = heights.fold(f64::INFINITY, f64::min);
            let origin = joints[0][0].with_y(lowest);
            for pose in &mut expected {
                pose.transl -= origin;
            }
            let placed: Vec<Joints> = skeleton.points_of_poses(&expected);
            // Sums of 40 steps of metres, and products of 40 turns, in f32.
            let apart = largest_distance(&recover_joints(&features), &placed);
            prop_assert!(apart < 1e-4, "{apart}");
            assert_near(&recover_poses(&features, skeleton.rest(0)), &expected, 1e-4, 1e-4);
            let (found, error) = motion_of_features(&features, &skeleton).expect("a motion");
            prop_assert!(error < 1e-4, "{error}");
            prop_assert_eq!(found.len(), motion.len());
        }
    }
}
