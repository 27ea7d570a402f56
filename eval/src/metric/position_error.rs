//! How far a motion is from another, joint by joint.

use kinematics::KeypointFrame;

use super::definition::{Better, Measure, Metric, Part};

/// Centimetres in a metre.
const CM_PER_M: f64 = 100.0;

/// Mean distance to the keypoints of the target, in centimetres.
pub static POSITION_ERROR: Metric = Metric {
    name: "Position error (cm)",
    part: Part::Further,
    better: |_| Better::Lower,
    decimals: 2,
    measure: Measure::Motion(|sample| {
        let count = sample.protocol.keypoints.count();
        let metres = mean_position_error(sample.keypoints, sample.target, count);
        Some(CM_PER_M * metres)
    }),
};

/// The mean distance between the first `count` keypoints of two motions in metres, over the
/// frames both have.
///
/// Frames beyond the end of the shorter motion are left out. Positions are not aligned, so drift
/// of the root counts.
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
    use glam::DVec3;
    use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS};

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
