//! Whether feet stand still on the ground when they should.

mod kernel;

use glam::{DVec3, Vec3};
use pulp::bytemuck::Pod;
use serde::{Deserialize, Serialize};

use datasets_spec::{Fps, Joint};

/// The joints whose motion is looked at, in the order the functions here expect them.
pub const FOOT_JOINTS: [Joint; 4] = [
    Joint::LeftAnkle,
    Joint::LeftFoot,
    Joint::RightAnkle,
    Joint::RightFoot,
];

/// Frames a clip needs for one central difference.
pub const MIN_FRAMES: usize = 3;

/// Speed in m/s below which a foot counts as still (DIMOS).
const STILL_SPEED: f64 = 0.075;
/// Height in metres below which a foot joint counts as touching the floor (DIMOS).
const TOUCH_HEIGHT: f64 = 0.05;

/// The position of a joint in metres, y up, in single or double precision.
///
/// Single precision tells a tenth of a micrometre at one metre, and is half as much to read, which
/// is what the score of many frames waits for.
pub trait Position: Pod {
    /// A coordinate, of which a position is three.
    type Coordinate: Pod + Into<f64>;

    /// The position in double precision, in which everything is computed.
    fn exact(self) -> DVec3;
}

impl Position for DVec3 {
    type Coordinate = f64;

    fn exact(self) -> DVec3 {
        self
    }
}

impl Position for Vec3 {
    type Coordinate = f32;

    fn exact(self) -> DVec3 {
        self.as_dvec3()
    }
}

/// Where the floor is taken to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Floor {
    /// At the lowest foot joint of the clip. SMPL-X clips need not stand at height 0, while the
    /// score punishes any distance from it.
    #[default]
    Lowest,
    /// At the given height in metres for every clip, as DIMOS has it at 0.
    At(f64),
}

impl Floor {
    /// The height of the floor in metres under the four foot joints of a clip.
    pub fn height<P: Position>(self, feet: &[[P; 4]]) -> f64 {
        match self {
            Self::Lowest => feet
                .iter()
                .flatten()
                .map(|point| point.exact().y)
                .fold(f64::INFINITY, f64::min),
            Self::At(height) => height,
        }
    }
}

/// The penalties of one frame: how much too fast the slowest foot joint is, and how much too far
/// from the floor the lowest one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Speed above the threshold in m/s.
    pub excess_speed: f64,
    /// Distance from the floor above the threshold in metres; below the floor counts as well.
    pub excess_height: f64,
}

/// The penalties of all frames that have a neighbour on both sides, `[L - 2]`; none for a clip of
/// fewer than [`MIN_FRAMES`] frames.
///
/// # Shapes
/// `feet` is `[L, 4]`: the positions of [`FOOT_JOINTS`] in metres, y up.
pub fn contacts<P: Position>(feet: &[[P; 4]], fps: Fps, floor: Floor) -> Vec<Contact> {
    let floor_height = floor.height(feet);
    feet.windows(MIN_FRAMES)
        .map(|frames| {
            let speed = frames[2]
                .iter()
                .zip(&frames[0])
                .map(|(after, before)| after.exact().distance(before.exact()) * fps.get() / 2.0)
                .fold(f64::INFINITY, f64::min);
            let height = frames[1]
                .iter()
                .map(|point| point.exact().y - floor_height)
                .fold(f64::INFINITY, f64::min);
            Contact {
                excess_speed: (speed - STILL_SPEED).max(0.0),
                excess_height: (height.abs() - TOUCH_HEIGHT).max(0.0),
            }
        })
        .collect()
}

/// The foot score of a clip in (0, 1], higher being better; none for a clip of fewer than
/// [`MIN_FRAMES`] frames.
///
/// # Shapes
/// `feet` is `[L, 4]`: the positions of [`FOOT_JOINTS`] in metres, y up.
///
/// # Source
/// DIMOS "contact": the mean over interior frames of `exp(-s) exp(-h)`, with `s` and `h` the
/// penalties of [`contacts`]. The paper's Table 1 prints an arrow down, its Tables A1 and A3 one
/// up; the definition and the bold entries say up.
pub fn foot_score<P: Position>(feet: &[[P; 4]], fps: Fps, floor: Floor) -> Option<f64> {
    let frames = feet.len().checked_sub(MIN_FRAMES - 1).filter(|&n| n > 0)?;
    let total = kernel::sum(feet, floor.height(feet), fps.get() / 2.0);
    Some(total / frames as f64)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::golden::Golden;

    fn fps(frames_per_second: f64) -> Fps {
        Fps::new(frames_per_second).expect("valid")
    }

    /// Feet at rest on the floor, one joint of which moves along x at a speed in m/s.
    fn sliding(speed: [f64; 4], height: f64, frames_per_second: f64) -> Vec<[DVec3; 4]> {
        (0..20)
            .map(|frame| {
                speed.map(|s| DVec3::new(s * f64::from(frame) / frames_per_second, height, 0.0))
            })
            .collect()
    }

    fn golden_feet(golden: &Golden, case: &str) -> Vec<[DVec3; 4]> {
        let (shape, numbers) = golden.tensor(&format!("in.{case}.joints_yup"));
        numbers
            .chunks_exact(shape[1] * shape[2])
            .map(|frame| FOOT_JOINTS.map(|joint| DVec3::from_slice(&frame[3 * joint.index()..])))
            .collect()
    }

    #[test]
    fn golden_foot_score_agrees_with_the_reference() {
        let golden = Golden::read("metrics_foot");
        for case in ["real", "sliding"] {
            let feet = golden_feet(&golden, case);
            for rate in [20.0, 30.0, 40.0] {
                let score = foot_score(&feet, fps(rate), Floor::At(0.0)).expect("long enough");
                let expected = golden.scalar(&format!("out.{case}.dimos_fps{rate}"));
                golden.check_scalar(case, score, expected, 0.0, 1e-9);
            }
            let terms = contacts(&feet, fps(20.0), Floor::At(0.0));
            let speeds = golden.numbers(&format!("out.{case}.speed_term"));
            let heights = golden.numbers(&format!("out.{case}.height_term"));
            assert_eq!(terms.len(), speeds.len());
            for (frame, term) in terms.iter().enumerate() {
                golden.check_scalar("speed", term.excess_speed, speeds[frame], 0.0, 1e-9);
                // The reference lists the heights of all frames, the score those of the interior.
                golden.check_scalar("height", term.excess_height, heights[frame + 1], 0.0, 1e-9);
            }
        }
    }

    #[test]
    fn one_planted_joint_is_enough_for_a_full_score() {
        let feet = sliding([3.0, 0.0, 3.0, 3.0], 0.02, 20.0);
        assert_eq!(foot_score(&feet, fps(20.0), Floor::At(0.0)), Some(1.0));
    }

    #[test]
    fn a_slide_costs_its_speed_above_the_threshold() {
        let feet = sliding([0.575, 1.0, 2.0, 0.9], 0.0, 20.0);
        let score = foot_score(&feet, fps(20.0), Floor::Lowest).expect("long enough");
        assert!((score - (-0.5f64).exp()).abs() < 1e-12, "{score}");
        // The same frames played twice as fast slide twice as fast.
        let score = foot_score(&feet, fps(40.0), Floor::Lowest).expect("long enough");
        assert!((score - (-1.075f64).exp()).abs() < 1e-12, "{score}");
    }

    #[test]
    fn hovering_costs_height_only_above_a_fixed_floor() {
        for height in [0.25, -0.25] {
            let feet = sliding([0.0; 4], height, 20.0);
            let score = foot_score(&feet, fps(20.0), Floor::At(0.0)).expect("long enough");
            assert!((score - (-0.2f64).exp()).abs() < 1e-12, "{score}");
            assert_eq!(foot_score(&feet, fps(20.0), Floor::Lowest), Some(1.0));
        }
    }

    #[test]
    fn clips_without_an_interior_frame_have_no_score() {
        let feet = sliding([0.0; 4], 0.0, 20.0);
        assert_eq!(foot_score(&feet[..2], fps(20.0), Floor::Lowest), None);
        assert_eq!(foot_score::<DVec3>(&[], fps(20.0), Floor::Lowest), None);
        assert!(foot_score(&feet[..3], fps(20.0), Floor::Lowest).is_some());
    }

    proptest! {
        #[test]
        fn the_score_is_a_share_and_blind_to_place_and_heading(
            steps in prop::collection::vec(prop::array::uniform4(prop::array::uniform3(-0.2f64..0.2)), 3..12),
            shift in prop::array::uniform3(-5.0f64..5.0),
            yaw in 0.0f64..6.0,
        ) {
            let feet: Vec<[DVec3; 4]> =
                steps.iter().map(|frame| frame.map(DVec3::from_array)).collect();
            let turn = glam::DQuat::from_rotation_y(yaw);
            let moved: Vec<[DVec3; 4]> = feet
                .iter()
                .map(|frame| frame.map(|point| turn * point + DVec3::from_array(shift)))
                .collect();
            let score = foot_score(&feet, fps(20.0), Floor::Lowest).expect("long enough");
            let other = foot_score(&moved, fps(20.0), Floor::Lowest).expect("long enough");
            prop_assert!(score > 0.0 && score <= 1.0);
            prop_assert!((score - other).abs() < 1e-12);

            // A rounded coordinate is at most 3e-7 m off within 8 m, and a speed ten times its
            // difference of two.
            let rounded: Vec<[Vec3; 4]> =
                moved.iter().map(|frame| frame.map(|point| point.as_vec3())).collect();
            let single = foot_score(&rounded, fps(20.0), Floor::Lowest).expect("long enough");
            prop_assert!((single - other).abs() < 2e-5, "{} {}", single, other);
        }
    }
}
