//! Whether feet stand still on the ground when they should.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use datasets_spec::lanes::{Kernel, exp, vectorised};
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
    pub fn height(self, feet: &[[DVec3; 4]]) -> f64 {
        match self {
            Self::Lowest => feet
                .iter()
                .flatten()
                .map(|point| point.y)
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
pub fn contacts(feet: &[[DVec3; 4]], fps: Fps, floor: Floor) -> Vec<Contact> {
    let floor_height = floor.height(feet);
    feet.windows(MIN_FRAMES)
        .map(|frames| {
            let speed = frames[2]
                .iter()
                .zip(&frames[0])
                .map(|(after, before)| after.distance(*before) * fps.get() / 2.0)
                .fold(f64::INFINITY, f64::min);
            let height = frames[1]
                .iter()
                .map(|point| point.y - floor_height)
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
pub fn foot_score(feet: &[[DVec3; 4]], fps: Fps, floor: Floor) -> Option<f64> {
    let frames = feet.len().checked_sub(MIN_FRAMES - 1).filter(|&n| n > 0)?;
    let total = vectorised(Sum {
        feet,
        floor: floor.height(feet),
        half_rate: fps.get() / 2.0,
    });
    Some(total / frames as f64)
}

/// Frames of a block: two vectors of AVX2 of them. In larger ones the arithmetic of a block does not
/// overlap with the fetching of the next.
const BLOCK: usize = 8;

/// Coordinates of a frame.
const NUMBERS: usize = 3 * FOOT_JOINTS.len();

/// The sum of [`foot_score`] in blocks of frames, so that its loops become vector instructions. A
/// joint is compared by the square of its speed, and one exponential serves both penalties.
struct Sum<'a> {
    feet: &'a [[DVec3; 4]],
    floor: f64,
    half_rate: f64,
}

impl Kernel for Sum<'_> {
    type Output = f64;

    #[inline(always)]
    fn run(self) -> f64 {
        let numbers: &[f64] = pulp::bytemuck::cast_slice(self.feet);
        let mut totals = [0.0; BLOCK];
        let interior = self.feet.len() - 2;
        // Steps squared, and sums of three neighbours of them: numbers are taken as they lie side by
        // side, and of what comes out only one in three is a joint.
        let mut squares = [0.0; NUMBERS * BLOCK + 2];
        let mut sums = [0.0; NUMBERS * BLOCK];
        for start in (0..interior).step_by(BLOCK) {
            let count = BLOCK.min(interior - start);
            let frames = |first: usize| &numbers[NUMBERS * first..][..NUMBERS * count];
            let (before, now, after) = (frames(start), frames(start + 1), frames(start + 2));
            for ((square, after), before) in squares.iter_mut().zip(after).zip(before) {
                let step = after - before;
                *square = step * step;
            }
            for (at, sum) in sums.iter_mut().enumerate() {
                *sum = squares[at] + squares[at + 1] + squares[at + 2];
            }
            let (mut slowest_squares, mut heights) = ([0.0; BLOCK], [0.0; BLOCK]);
            let least = |a: f64, b: f64| if a < b { a } else { b };
            let lowest = |of: &[f64; NUMBERS], first: usize| {
                least(
                    least(of[first], of[first + 3]),
                    least(of[first + 6], of[first + 9]),
                )
            };
            for (slowest, sums) in slowest_squares.iter_mut().zip(sums.as_chunks().0) {
                *slowest = lowest(sums, 0);
            }
            for (height, now) in heights.iter_mut().zip(now.as_chunks().0) {
                *height = lowest(now, 1);
            }
            let mut scores = [0.0; BLOCK];
            for lane in 0..BLOCK {
                let speed = slowest_squares[lane].sqrt() * self.half_rate - STILL_SPEED;
                let height = (heights[lane] - self.floor).abs() - TOUCH_HEIGHT;
                let positive = |value: f64| if value > 0.0 { value } else { 0.0 };
                scores[lane] = exp(-(positive(speed) + positive(height)));
            }
            for (total, score) in totals.iter_mut().zip(&scores[..count]) {
                *total += score;
            }
        }
        totals.iter().sum()
    }
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
        assert_eq!(foot_score(&[], fps(20.0), Floor::Lowest), None);
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
        }
    }
}
