//! How far a motion is from another, joint by joint.

use datasets_spec::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Which points of a body are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Keypoints {
    /// All 28 of the model: joints of the body, eyes and fingers.
    All,
    /// The 22 joints of the body.
    ///
    /// # Source
    /// Paper, App. C.6: MotionFix is compared on 22 joints.
    Body,
}

impl Keypoints {
    /// How many there are; they come first among the keypoints.
    pub fn count(self) -> usize {
        match self {
            Self::All => NUM_KEYPOINTS,
            Self::Body => NUM_BODY_JOINTS,
        }
    }
}

/// The mean distance between the first `count` keypoints of two motions in metres, over the frames both have.
///
/// Frames beyond the end of the shorter motion have no counterpart and are left out. Positions are
/// compared where they are, without alignment, so drift of the root counts.
///
/// # Shapes
/// Both are `[L, 28]` at the same frame rate; `L` may differ.
///
/// # Panics
/// If one of them has no frame, or there are fewer keypoints.
pub fn mean_position_error(
    found: &[[DVec3; NUM_KEYPOINTS]],
    expected: &[[DVec3; NUM_KEYPOINTS]],
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
    use super::*;

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
