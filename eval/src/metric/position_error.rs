//! Position errors: distances between the keypoints of two motions.

use kinematics::KeypointFrame;
use kinematics::canonical::GroundTransform;
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS, parent_of};

use super::CM_PER_M;
use super::definition::{Better, Measure, Metric, MotionSample, Part};

/// Mean distance to the keypoints of the target in centimetres. Both motions are placed by their first frames.
///
/// A target may take its root from another capture, whose start position no editor can know. So only movement relative
/// to the first frame counts.
pub static POSITION_ERROR: Metric = Metric {
    name: "Position error (cm)",
    about: "mean distance to the target's 28 keypoints, with --keypoints 22 over the body joints, both motions placed \
            by their first frames (pelvis over one point of the ground, hips in one direction); an edit shorter than \
            its source is held in its last pose, and other surplus frames of the longer motion are ignored",
    part: Part::Further,
    better: |_| Better::Lower,
    decimals: 2,
    measure: Measure::Motion(|sample| error_cm(sample, |_| true)),
};

/// [`POSITION_ERROR`] of the keypoints that the item asks to change, in centimetres; no value if the item does not
/// state them.
pub static ERROR_INSIDE: Metric = Metric {
    name: "Error inside the mask (cm)",
    about: "position error of the keypoints that the item asks to change (eyes belong to the head, fingers to the \
            wrist); items that do not tell which have none",
    part: Part::Main,
    better: |_| Better::Lower,
    decimals: 2,
    measure: Measure::Motion(|sample| {
        error_cm(sample, |slot| sample.edited.contains(body_joint(slot)))
    }),
};

/// [`POSITION_ERROR`] of all other keypoints, in centimetres; no value if the item does not state the changed ones, or
/// changes all.
pub static ERROR_OUTSIDE: Metric = Metric {
    name: "Error outside the mask (cm)",
    about: "position error of all other keypoints",
    part: Part::Main,
    better: |_| Better::Lower,
    decimals: 2,
    measure: Measure::Motion(|sample| {
        let is_known = !sample.edited.is_empty();
        error_cm(sample, |slot| {
            is_known && !sample.edited.contains(body_joint(slot))
        })
    }),
};

/// Mean distance to some keypoints of the target in centimetres, with both motions placed by their first frames; `None`
/// without keypoints.
fn error_cm(sample: &MotionSample<'_>, is_counted: impl Fn(usize) -> bool) -> Option<f64> {
    let count = sample.protocol.keypoints.count();
    let slots: Vec<usize> = (0..count).filter(|&slot| is_counted(slot)).collect();
    if slots.is_empty() {
        return None;
    }
    Some(CM_PER_M * mean_of(sample.distances, &slots))
}

/// The body joint that moves a keypoint: the keypoint itself, or the parent of an eye or a finger.
fn body_joint(mut slot: usize) -> usize {
    while slot >= NUM_BODY_JOINTS {
        slot = parent_of(slot);
    }
    slot
}

/// Keypoints relative to the first frame: the pelvis starts over the origin, and the hips lie along x with the left one
/// at the greater x, so that the body starts facing +z. Heights are kept.
///
/// # Panics
/// If there is no frame.
pub(crate) fn from_start(points: &[KeypointFrame]) -> Vec<KeypointFrame> {
    let [pelvis, left, right] = *points[0].first_chunk().expect("28 keypoints");
    let across = left - right;
    let start = GroundTransform {
        yaw_rad: f64::atan2(-across.z, across.x),
        x: pelvis.x,
        z: pelvis.z,
    };
    let to_start = start.inverse().mapping();
    points.iter().map(|frame| frame.map(&to_start)).collect()
}

/// Repeats the last frame of a motion that is shorter than `len` frames. Otherwise an edit could lower its error by leaving
/// out frames.
pub(crate) fn held(mut points: Vec<KeypointFrame>, len: usize) -> Vec<KeypointFrame> {
    if let Some(&last) = points.last() {
        points.resize(len.max(points.len()), last);
    }
    points
}

/// Distances between the keypoints of two motions in metres, in the frames that both have.
pub(crate) fn distances(
    found: &[KeypointFrame],
    expected: &[KeypointFrame],
) -> Vec<[f64; NUM_KEYPOINTS]> {
    found
        .iter()
        .zip(expected)
        .map(|(found, expected)| std::array::from_fn(|slot| found[slot].distance(expected[slot])))
        .collect()
}

/// The mean distance between the first `count` keypoints of two motions in metres, over the frames that both have. The
/// motions are not aligned.
///
/// # Shapes
/// Both are `[L, 28]` at the same frame rate; `L` may differ.
///
/// # Panics
/// If a motion has no frame, or `count` exceeds the number of keypoints.
pub fn mean_position_error(
    found: &[KeypointFrame],
    expected: &[KeypointFrame],
    count: usize,
) -> f64 {
    let slots: Vec<usize> = (0..count).collect();
    mean_of(&distances(found, expected), &slots)
}

/// The mean distance over all frames and the given keypoints.
fn mean_of(distances: &[[f64; NUM_KEYPOINTS]], slots: &[usize]) -> f64 {
    assert!(!distances.is_empty(), "position error of an empty motion");
    let total: f64 = distances
        .iter()
        .flat_map(|frame| slots.iter().map(move |&slot| frame[slot]))
        .sum();
    total / (distances.len() * slots.len()) as f64
}

#[cfg(test)]
mod tests {
    use datasets_spec::{BodyPart, Fps, JointSet, Motion};
    use glam::{DQuat, DVec3};
    use kinematics::skeleton::Joint;
    use kinematics::{Pose, Skeleton};

    use super::*;
    use crate::metric::{SeamAcceleration, Target};
    use crate::protocol::{Keypoints, Protocol};

    #[test]
    fn a_constant_offset_is_its_length_and_surplus_frames_do_not_count() {
        let here = vec![[DVec3::ONE; NUM_KEYPOINTS]; 5];
        let mut there = vec![[DVec3::new(1.0, 4.0, 5.0); NUM_KEYPOINTS]; 3];
        assert_eq!(mean_position_error(&here, &there, NUM_KEYPOINTS), 5.0);
        assert_eq!(mean_position_error(&there, &here, NUM_KEYPOINTS), 5.0);
        // Correcting one keypoint of one frame lowers the error by its share.
        there[1][7] = DVec3::ONE;
        let expected = 5.0 * (1.0 - 1.0 / (3.0 * NUM_KEYPOINTS as f64));
        let found = mean_position_error(&here, &there, NUM_KEYPOINTS);
        assert!((found - expected).abs() < 1e-12);
    }

    /// A body that walks forwards and turns.
    fn wandering() -> Vec<KeypointFrame> {
        let skeleton = Skeleton::smplx_neutral();
        let poses: Vec<Pose> = (0..20)
            .map(|frame| {
                let share = f64::from(frame) / 19.0;
                let mut pose = Pose {
                    transl: DVec3::new(share * share, 0.1 * share, 2.0 * share),
                    ..Pose::REST
                };
                pose.rotations[0] = DQuat::from_rotation_y(share);
                pose
            })
            .collect();
        poses.iter().map(|pose| skeleton.keypoints(pose)).collect()
    }

    #[test]
    fn where_a_motion_was_captured_does_not_count_but_its_way_does() {
        let here = wandering();
        let moved = GroundTransform {
            yaw_rad: 2.0,
            x: 5.0,
            z: -3.0,
        };
        let each = |frames: &[KeypointFrame], to: &dyn Fn(DVec3) -> DVec3| -> Vec<KeypointFrame> {
            frames.iter().map(|frame| frame.map(to)).collect()
        };
        let there = each(&here, &|point| moved.apply(point));
        let error = |found: &[KeypointFrame], expected: &[KeypointFrame]| {
            mean_position_error(&from_start(found), &from_start(expected), NUM_KEYPOINTS)
        };
        assert!(error(&here, &there) < 1e-12);
        // Drift after the first frame counts, and so does height.
        let mut drifts = each(&there, &|point| point + DVec3::X);
        drifts[0] = there[0];
        assert!((error(&drifts, &here) - 19.0 / 20.0).abs() < 1e-12);
        let raised = each(&there, &|point| point + 0.5 * DVec3::Y);
        assert!((error(&raised, &here) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_motion_starts_over_the_origin_and_faces_forward() {
        let started = from_start(&wandering());
        let [pelvis, left, right] = *started[0].first_chunk().expect("keypoints");
        assert!(pelvis.with_y(0.0).length() < 1e-12);
        let across = (left - right).with_y(0.0).normalize();
        assert!((across - DVec3::X).length() < 1e-12);
    }

    #[test]
    fn eyes_and_fingers_count_only_where_all_points_do() {
        let here = [[DVec3::ZERO; NUM_KEYPOINTS]; 2];
        let mut there = here;
        there[0][NUM_BODY_JOINTS] = DVec3::X;
        let error = |keypoints: Keypoints| mean_position_error(&here, &there, keypoints.count());
        assert_eq!(error(Keypoints::Body), 0.0);
        assert!((error(Keypoints::All) - 1.0 / 56.0).abs() < 1e-12);
    }

    /// The three errors of a body whose left hand is 0.28 m off and whose head is 0.14 m off, in two of four frames.
    fn errors(edited: JointSet, keypoints: Keypoints) -> [Option<f64>; 3] {
        let target = [[DVec3::ZERO; NUM_KEYPOINTS]; 4].map(|mut frame| {
            (frame[1], frame[2]) = (DVec3::X, -DVec3::X);
            frame
        });
        let mut found = target;
        for frame in &mut found[2..] {
            for (slot, point) in frame.iter_mut().enumerate() {
                match body_joint(slot) {
                    joint if joint == Joint::LeftWrist.index() => point.y += 0.28,
                    joint if joint == Joint::Head.index() => point.y += 0.14,
                    _ => {}
                }
            }
        }
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST; 4]).expect("valid");
        let placed = from_start(&target);
        let distances = distances(&from_start(&found), &placed);
        let sample = MotionSample {
            motion: &motion,
            keypoints: &found,
            distances: &distances,
            target: &Target {
                from_start: placed,
                foot_slide: None,
                way_m: 0.0,
                swing_m: 0.0,
            },
            acceleration: SeamAcceleration::default(),
            edited,
            edit: None,
            composed: None,
            protocol: &Protocol {
                keypoints,
                ..Protocol::default()
            },
        };
        let value = |metric: &Metric| match metric.measure {
            Measure::Motion(value) => value(&sample),
            Measure::Set(..) | Measure::Takes(_) | Measure::Rank(..) => unreachable!("of motions"),
        };
        [&POSITION_ERROR, &ERROR_INSIDE, &ERROR_OUTSIDE].map(value)
    }

    #[test]
    fn errors_inside_and_outside_of_a_mask_make_up_the_error() {
        let near = |found: Option<f64>, expected: f64| {
            let found = found.expect("known");
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        };
        let arm = BodyPart::LeftArm.joints();
        for keypoints in [Keypoints::All, Keypoints::Body] {
            let points = (0..keypoints.count()).map(body_joint);
            let [wrist, head] =
                [Joint::LeftWrist, Joint::Head].map(|joint| JointSet::of(&[joint.index()]));
            let [wrist, head, inside, all] = [wrist, head, arm, JointSet::ALL]
                .map(|set| points.clone().filter(|&joint| set.contains(joint)).count() as f64);
            let [whole, within, without] = errors(arm, keypoints);
            near(within, 14.0 * wrist / inside);
            near(without, 7.0 * head / (all - inside));
            near(whole, (14.0 * wrist + 7.0 * head) / all);
            let [whole, within, without] = errors(JointSet::ALL, keypoints);
            assert_eq!((whole, without), (within, None));
            let [_, within, without] = errors(JointSet::EMPTY, keypoints);
            assert_eq!((within, without), (None, None));
        }
        // Fingers belong to the wrist, eyes to the head.
        assert!((22..NUM_KEYPOINTS).all(|slot| [15, 20, 21].contains(&body_joint(slot))));
    }
}
