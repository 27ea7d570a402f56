//! The foot score: whether feet stand still on the ground when they touch it.

use datasets_spec::record::EditRow;
use datasets_spec::{Fps, Joint};
use glam::DVec3;

use super::definition::{Better, Measure, Metric, Part};
use crate::protocol::Floor;

/// DIMOS contact score.
pub static FOOT_SCORE: Metric = Metric {
    name: "FS",
    about: "DIMOS contact score: mean of exp(-slide) exp(-height) over frames; the floor is the lowest foot \
            unless --floor says otherwise",
    part: Part::Paper,
    better: |_| Better::Higher,
    decimals: 3,
    measure: Measure::Motion(|sample| {
        let feet = feet(sample.keypoints);
        foot_score(&feet, sample.motion.fps(), sample.protocol.floor)
    }),
};

/// The joints of the foot score, in the order that the functions here expect.
pub const FOOT_JOINTS: [Joint; 4] = [
    Joint::LeftAnkle,
    Joint::LeftFoot,
    Joint::RightAnkle,
    Joint::RightFoot,
];

/// Positions of [`FOOT_JOINTS`] in one frame, in metres, y up.
pub type Feet = [DVec3; FOOT_JOINTS.len()];

/// Minimum number of frames for one central difference.
pub const MIN_FRAMES: usize = EditRow::MIN_FRAMES;

/// Speed in m/s below which a foot counts as still (DIMOS).
const STILL_SPEED: f64 = 0.075;
/// Height in metres below which a foot joint counts as touching the floor (DIMOS).
const TOUCH_HEIGHT: f64 = 0.05;

/// The foot joints among the points of frames.
///
/// # Shapes
/// `frames` `[L, K]` in metres, of which the first 12 are joints of SMPL-X in its order; the result is `[L, 4]`.
///
/// # Panics
/// If a frame has fewer than 12 points.
pub fn feet<const K: usize>(frames: &[[DVec3; K]]) -> Vec<Feet> {
    frames
        .iter()
        .map(|frame| FOOT_JOINTS.map(|joint| frame[joint.index()]))
        .collect()
}

/// Penalties of all frames with a neighbour on both sides, `[L - 2]`; none for a clip of fewer than [`MIN_FRAMES`]
/// frames. They are the speed of the slowest foot joint in excess of the threshold, in m/s, and the distance of the
/// lowest one from the floor, above or below it, in excess of the threshold, in metres.
///
/// # Shapes
/// `feet` is `[L, 4]`.
fn contacts(feet: &[Feet], fps: Fps, floor: Floor) -> impl Iterator<Item = [f64; 2]> {
    let lowest = |frame: &Feet| frame.iter().fold(f64::INFINITY, |least, p| least.min(p.y));
    let floor = match floor {
        Floor::Lowest => feet.iter().map(lowest).fold(f64::INFINITY, f64::min),
        Floor::At(height) => height,
    };
    let half_rate = fps.get() / 2.0;
    feet.windows(MIN_FRAMES).map(move |frames| {
        let squared_steps = frames[2].iter().zip(&frames[0]);
        let squared_step = squared_steps
            .map(|(after, before)| after.distance_squared(*before))
            .fold(f64::INFINITY, f64::min);
        let height = lowest(&frames[1]) - floor;
        [
            (squared_step.sqrt() * half_rate - STILL_SPEED).max(0.0),
            (height.abs() - TOUCH_HEIGHT).max(0.0),
        ]
    })
}

/// The foot score of a clip in (0, 1]; higher is better. `None` for a clip of fewer than [`MIN_FRAMES`] frames.
///
/// # Shapes
/// `feet` is `[L, 4]`.
///
/// # Source
/// DIMOS "contact": the mean over interior frames of `exp(-s) exp(-h)`, with `s` and `h` the penalties of `contacts`.
/// The paper's Table 1 prints a down arrow, its Tables A1 and A3 an up arrow; the definition and the bold entries imply
/// up.
pub fn foot_score(feet: &[Feet], fps: Fps, floor: Floor) -> Option<f64> {
    let frames = feet.len().checked_sub(MIN_FRAMES - 1).filter(|&n| n > 0)?;
    let scores = contacts(feet, fps, floor).map(|[speed, height]| (-(speed + height)).exp());
    Some(scores.sum::<f64>() / frames as f64)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::golden::Golden;

    fn fps(frames_per_second: f64) -> Fps {
        Fps::new(frames_per_second).expect("valid")
    }

    /// Feet at a height above the floor, with each joint moving along x at its speed in m/s.
    fn sliding(speed: [f64; 4], height: f64, frames_per_second: f64) -> Vec<Feet> {
        (0..20)
            .map(|frame| {
                speed.map(|s| DVec3::new(s * f64::from(frame) / frames_per_second, height, 0.0))
            })
            .collect()
    }

    fn golden_feet(golden: &Golden, case: &str) -> Vec<Feet> {
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
            let terms: Vec<[f64; 2]> = contacts(&feet, fps(20.0), Floor::At(0.0)).collect();
            let speeds = golden.numbers(&format!("out.{case}.speed_term"));
            let heights = golden.numbers(&format!("out.{case}.height_term"));
            assert_eq!(terms.len(), speeds.len());
            for (frame, term) in terms.iter().enumerate() {
                golden.check_scalar("speed", term[0], speeds[frame], 0.0, 1e-9);
                // The reference lists the heights of all frames; the score uses interior frames only.
                golden.check_scalar("height", term[1], heights[frame + 1], 0.0, 1e-9);
            }
        }
    }

    #[test]
    fn a_slide_costs_its_speed_above_the_threshold_and_one_planted_joint_is_enough() {
        let feet = sliding([3.0, 0.0, 3.0, 3.0], 0.02, 20.0);
        assert_eq!(foot_score(&feet, fps(20.0), Floor::At(0.0)), Some(1.0));
        let feet = sliding([0.575, 1.0, 2.0, 0.9], 0.0, 20.0);
        // The same frames played twice as fast slide twice as fast.
        for (rate, excess) in [(20.0, 0.5f64), (40.0, 1.075)] {
            let score = foot_score(&feet, fps(rate), Floor::Lowest).expect("long enough");
            assert!((score - (-excess).exp()).abs() < 1e-12, "{score}");
        }
    }

    #[test]
    fn hovering_costs_height_only_above_a_fixed_floor() {
        for height in [0.25, -0.25] {
            let feet = sliding([0.0; 4], height, 20.0);
            let score = foot_score(&feet, fps(20.0), Floor::At(0.0)).expect("long enough");
            assert!((score - (-0.2f64).exp()).abs() < 1e-12, "{score}");
            // Clips without an interior frame have no score.
            for (frames, expected) in [(20, Some(1.0)), (3, Some(1.0)), (2, None), (0, None)] {
                let score = foot_score(&feet[..frames], fps(20.0), Floor::Lowest);
                assert_eq!(score, expected);
            }
        }
    }

    proptest! {
        #[test]
        fn the_score_is_a_share_and_blind_to_place_and_heading(
            steps in prop::collection::vec(prop::array::uniform4(prop::array::uniform3(-0.2f64..0.2)), 3..12),
            shift in prop::array::uniform3(-5.0f64..5.0),
            yaw in 0.0f64..6.0,
        ) {
            let feet: Vec<Feet> =
                steps.iter().map(|frame| frame.map(DVec3::from_array)).collect();
            let turn = glam::DQuat::from_rotation_y(yaw);
            let moved: Vec<Feet> = feet
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
