//! How far a motion is from another, joint by joint.

use kinematics::KeypointFrame;
use kinematics::canonical::GroundTransform;

use super::definition::{Better, Measure, Metric, Part};

/// Centimetres in a metre.
const CM_PER_M: f64 = 100.0;

/// Mean distance to the keypoints of the target in centimetres, both motions placed by their first frames.
///
/// A target whose root is another capture's moves wherever that was captured, which no editor can know: only its way
/// from where it began is in question.
pub static POSITION_ERROR: Metric = Metric {
    name: "Position error (cm)",
    part: Part::Further,
    better: |_| Better::Lower,
    decimals: 2,
    measure: Measure::Motion(|sample| {
        let count = sample.protocol.keypoints.count();
        let [found, expected] = [sample.keypoints, sample.target].map(from_start);
        Some(CM_PER_M * mean_position_error(&found, &expected, count))
    }),
};

/// The motion as seen from its first frame: the pelvis starts over the origin, and the hips lie along x, the left one
/// at the greater x, so that the body starts facing +z. Heights stay.
///
/// # Panics
/// If there is no frame.
fn from_start(points: &[KeypointFrame]) -> Vec<KeypointFrame> {
    let [pelvis, left, right] = *points[0].first_chunk().expect("28 keypoints");
    let across = left - right;
    let start = GroundTransform {
        yaw_rad: f64::atan2(-across.z, across.x),
        x: pelvis.x,
        z: pelvis.z,
    };
    let to_start = start.inverse();
    let seen = |frame: &KeypointFrame| frame.map(|point| to_start.apply(point));
    points.iter().map(seen).collect()
}

/// The mean distance between the first `count` keypoints of two motions in metres, over the
/// frames both have.
///
/// Frames beyond the end of the shorter motion are left out, and nothing is aligned.
///
/// # Shapes
/// Both are `[L, 28]` at the same frame rate; `L` may differ.
///
/// # Panics
/// If one of them has no frame, or there are fewer keypoints.
pub fn mean_position_error(
    found: &[KeypointFrame],
    expected: &[KeypointFrame],
    count: usize,
) -> f64 {
    let num_frames = found.len().min(expected.len());
    assert!(num_frames > 0, "position error of an empty motion");
    let total: f64 = found
        .iter()
        .zip(expected)
        .flat_map(|(found, expected)| found[..count].iter().zip(expected))
        .map(|(found, expected)| found.distance(*expected))
        .sum();
    total / (num_frames * count) as f64
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};
    use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS};
    use kinematics::{Pose, Skeleton};

    use super::*;
    use crate::protocol::Keypoints;

    #[test]
    fn a_constant_offset_is_its_length_and_surplus_frames_do_not_count() {
        let here = vec![[DVec3::ONE; NUM_KEYPOINTS]; 5];
        let mut there = vec![[DVec3::new(1.0, 4.0, 5.0); NUM_KEYPOINTS]; 3];
        assert_eq!(mean_position_error(&here, &there, NUM_KEYPOINTS), 5.0);
        assert_eq!(mean_position_error(&there, &here, NUM_KEYPOINTS), 5.0);
        // One keypoint of one frame put right takes its share off.
        there[1][7] = DVec3::ONE;
        let expected = 5.0 * (1.0 - 1.0 / (3.0 * NUM_KEYPOINTS as f64));
        let found = mean_position_error(&here, &there, NUM_KEYPOINTS);
        assert!((found - expected).abs() < 1e-12);
    }

    /// A body that walks along its heading, and turns on the way.
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
        let there: Vec<KeypointFrame> = here
            .iter()
            .map(|frame| frame.map(|point| moved.apply(point)))
            .collect();
        let error = |found: &[KeypointFrame], expected: &[KeypointFrame]| {
            mean_position_error(&from_start(found), &from_start(expected), NUM_KEYPOINTS)
        };
        assert!(error(&here, &there) < 1e-12);
        // Drift from the second frame on counts, and so does height.
        let mut drifts = there.clone();
        for frame in &mut drifts[1..] {
            *frame = frame.map(|point| point + DVec3::X);
        }
        assert!((error(&drifts, &here) - 19.0 / 20.0).abs() < 1e-12);
        let raised: Vec<KeypointFrame> = there
            .iter()
            .map(|frame| frame.map(|point| point + 0.5 * DVec3::Y))
            .collect();
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
}
