//! How far a motion is from another, joint by joint.

use glam::DVec3;

use datasets_spec::skeleton::NUM_KEYPOINTS;

/// The mean distance between keypoints of two motions in metres, over the frames both have.
///
/// Frames beyond the end of the shorter motion have no counterpart and are left out. Positions are
/// compared where they are, without alignment, so drift of the root counts.
///
/// # Shapes
/// Both are `[L, 28]` at the same frame rate; `L` may differ.
///
/// # Panics
/// If one of them has no frame.
pub fn mean_position_error(
    found: &[[DVec3; NUM_KEYPOINTS]],
    expected: &[[DVec3; NUM_KEYPOINTS]],
) -> f64 {
    let num_frames = found.len().min(expected.len());
    assert!(num_frames > 0, "position error of an empty motion");
    let total: f64 = found
        .iter()
        .zip(expected)
        .flat_map(|(found, expected)| found.iter().zip(expected))
        .map(|(found, expected)| found.distance(*expected))
        .sum();
    total / (num_frames * NUM_KEYPOINTS) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_offset_is_its_length_and_surplus_frames_do_not_count() {
        let here = vec![[DVec3::ONE; NUM_KEYPOINTS]; 5];
        let mut there = vec![[DVec3::new(1.0, 4.0, 5.0); NUM_KEYPOINTS]; 3];
        assert_eq!(mean_position_error(&here, &there), 5.0);
        assert_eq!(mean_position_error(&there, &here), 5.0);
        // One keypoint of one frame put right takes its share off.
        there[1][7] = DVec3::ONE;
        let expected = 5.0 * (1.0 - 1.0 / (3.0 * NUM_KEYPOINTS as f64));
        assert!((mean_position_error(&here, &there) - expected).abs() < 1e-12);
    }
}
