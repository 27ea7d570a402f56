//! Motion quality, independent of content: acceleration at the seams of generated windows, jerk, feet
//! that slide, rotations that jump.

use std::ops::RangeInclusive;

use datasets_spec::{Fps, Pose};
use kinematics::KeypointFrame;
use kinematics::canonical::FIXED_FRAMES;
use kinematics::rotation::angle_between;
use kinematics::skeleton::NUM_KEYPOINTS;

use super::definition::{Better, Measure, Metric, Part};

/// Mean acceleration of the keypoints where one generated window ends and the next begins, in m/s²;
/// for motions that were not generated, in the same frames.
pub static SEAM_ACCELERATION: Metric = Metric {
    name: "Acceleration at seams (m/s²)",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 2,
    measure: Measure::Motion(|sample| {
        seam_acceleration(sample.keypoints, sample.motion.fps(), sample.seams).at_seams
    }),
};

/// Mean acceleration of the keypoints in all other frames, in m/s².
pub static INSIDE_ACCELERATION: Metric = Metric {
    name: "inside (m/s²)",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 2,
    measure: Measure::Motion(|sample| {
        seam_acceleration(sample.keypoints, sample.motion.fps(), sample.seams).inside
    }),
};

/// Mean jerk of the keypoints, in m/s³.
pub static JERK: Metric = Metric {
    name: "Jerk (m/s³)",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 1,
    measure: Measure::Motion(|sample| jerk(sample.keypoints, sample.motion.fps())),
};

/// Mean speed of feet that touch the floor, in m/s.
pub static CONTACT_SLIDE: Metric = Metric {
    name: "Contact slide (m/s)",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 3,
    measure: Measure::Motion(|sample| contact_slide(sample.keypoints, sample.motion.fps())),
};

/// Largest rotation of a joint from one frame to the next, in degrees.
pub static ROTATION_STEP: Metric = Metric {
    name: "Largest turn (°/frame)",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 1,
    measure: Measure::Motion(|sample| {
        let motion = sample.motion;
        let poses: Vec<Pose> = (0..motion.len()).map(|frame| motion.pose(frame)).collect();
        Some(largest_rotation_step(&poses))
    }),
};

/// The keypoints whose contact with the floor is looked at: both ankles and both feet.
const FEET: [usize; 4] = [7, 8, 10, 11];

/// Height in metres above the lowest foot of the clip below which a foot touches the floor (DIMOS).
const TOUCH_HEIGHT: f64 = 0.05;

/// Where one generated window ends and the next begins, in frames of the edited motion: the last
/// frame of the one and the first of the other, with what interpolation put between.
pub type Seam = RangeInclusive<usize>;

/// The seams of a motion that was generated window by window from its first frame on, each window
/// repeating the last [`FIXED_FRAMES`] frames before it. The last window ends with the motion, so that
/// it may begin earlier than the others.
///
/// `window` counts frames at `model_fps`; `num_frames` and the result are at `fps`.
pub fn seams(num_frames: usize, fps: Fps, window: usize, model_fps: Fps) -> Vec<Seam> {
    let per_model = fps.get() / model_fps.get();
    let Some(last) = num_frames.checked_sub(1) else {
        return Vec::new();
    };
    // A motion whose last frame lies between two frames of the model was generated up to the second.
    let model_frames = (last as f64 / per_model - 1e-6).ceil().max(0.0) as usize + 1;
    if window <= FIXED_FRAMES || model_frames <= window {
        return Vec::new();
    }
    let at = |frame: usize| frame as f64 * per_model;
    let mut starts: Vec<usize> = (0..=model_frames - window)
        .step_by(window - FIXED_FRAMES)
        .collect();
    if starts
        .last()
        .is_some_and(|start| start + window < model_frames)
    {
        starts.push(model_frames - window);
    }
    starts
        .into_iter()
        .skip(1)
        .map(|start| {
            let first_new = start + FIXED_FRAMES;
            at(first_new - 1).floor() as usize..=(at(first_new).ceil() as usize).min(last)
        })
        .collect()
}

/// The size of the acceleration of every frame that has a neighbour on both sides, averaged over the
/// keypoints, in m/s^2, `[L - 2]`; entry `i` is that of frame `i + 1`.
pub fn accelerations(points: &[KeypointFrame], fps: Fps) -> Vec<f64> {
    let rate = fps.get() * fps.get();
    points
        .windows(3)
        .map(|frames| {
            let [before, now, after] = frames else {
                unreachable!("windows of three")
            };
            let total: f64 = (0..NUM_KEYPOINTS)
                .map(|slot| (after[slot] - 2.0 * now[slot] + before[slot]).length())
                .sum();
            total * rate / NUM_KEYPOINTS as f64
        })
        .collect()
}

/// Mean acceleration in m/s^2 at the seams of a motion and away from them; none where there is no such
/// frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SeamAcceleration {
    /// Over the frames of all seams.
    pub at_seams: Option<f64>,
    /// Over all other frames.
    pub inside: Option<f64>,
}

/// Splits [`accelerations`] by whether a frame belongs to a seam.
pub fn seam_acceleration(points: &[KeypointFrame], fps: Fps, seams: &[Seam]) -> SeamAcceleration {
    let (mut at, mut inside) = (Mean::default(), Mean::default());
    for (index, value) in accelerations(points, fps).into_iter().enumerate() {
        if seams.iter().any(|seam| seam.contains(&(index + 1))) {
            at.add(value);
        } else {
            inside.add(value);
        }
    }
    SeamAcceleration {
        at_seams: at.get(),
        inside: inside.get(),
    }
}

/// Mean size of the third derivative of the keypoints in m/s^3; none for fewer than four frames.
pub fn jerk(points: &[KeypointFrame], fps: Fps) -> Option<f64> {
    let mut mean = Mean::default();
    for frames in points.windows(4) {
        let [a, b, c, d] = frames else {
            unreachable!("windows of four")
        };
        for slot in 0..NUM_KEYPOINTS {
            mean.add((d[slot] - 3.0 * (c[slot] - b[slot]) - a[slot]).length());
        }
    }
    mean.get().map(|value| value * fps.get().powi(3))
}

/// Mean horizontal speed in m/s of ankles and feet that touch the floor, which is taken to be at the
/// lowest of them in the clip; none if none touches it in two consecutive frames.
pub fn contact_slide(points: &[KeypointFrame], fps: Fps) -> Option<f64> {
    let floor = points
        .iter()
        .flat_map(|frame| FEET.map(|slot| frame[slot].y))
        .fold(f64::INFINITY, f64::min);
    let mut mean = Mean::default();
    for frames in points.windows(2) {
        for slot in FEET {
            let [before, after] = [frames[0][slot], frames[1][slot]];
            if before.y.max(after.y) - floor < TOUCH_HEIGHT {
                mean.add((after - before).with_y(0.0).length());
            }
        }
    }
    mean.get().map(|value| value * fps.get())
}

/// The largest angle in degrees by which the local rotation of a joint, the root's included, changes
/// from one frame to the next; 0 for fewer than two frames.
pub fn largest_rotation_step(poses: &[Pose]) -> f64 {
    poses
        .windows(2)
        .flat_map(|frames| {
            let pairs = frames[0].rotations.into_iter().zip(frames[1].rotations);
            pairs.map(|(before, after)| angle_between(before, after))
        })
        .fold(0.0, f64::max)
        .to_degrees()
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: usize,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    fn get(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Skeleton;
    use glam::DVec3;
    use kinematics::rotation::from_axis_angle;

    use super::*;

    const FPS: Fps = Fps::STORE;

    /// Keypoints of the rest pose, translated by `path` of the time in seconds.
    fn moving(num_frames: usize, path: impl Fn(f64) -> DVec3) -> Vec<KeypointFrame> {
        let rest = Skeleton::smplx_neutral().keypoints(&Pose::REST);
        (0..num_frames)
            .map(|frame| rest.map(|point| point + path(FPS.secs_at(frame))))
            .collect()
    }

    fn near(found: Option<f64>, expected: f64) {
        let found = found.expect("enough frames");
        assert!(
            (found - expected).abs() < 1e-6 * expected.abs().max(1.0),
            "{found} {expected}"
        );
    }

    #[test]
    fn a_falling_body_accelerates_by_gravity_and_has_no_jerk() {
        let fall = moving(12, |t| DVec3::Y * (-0.5 * 9.81 * t * t));
        assert_eq!(accelerations(&fall, FPS).len(), 10);
        for value in accelerations(&fall, FPS) {
            near(Some(value), 9.81);
        }
        near(jerk(&fall, FPS), 0.0);
        near(jerk(&moving(9, |t| DVec3::X * t * t * t), FPS), 6.0);
        assert_eq!(jerk(&fall[..3], FPS), None);
    }

    #[test]
    fn a_pop_at_a_seam_is_seen_there_and_nowhere_else() {
        // Windows of 16 frames at 10 fps: the second adds frame 16, which is frame 32 at 20 fps.
        let model = Fps::MODEL;
        assert_eq!(seams(59, FPS, 16, model), [30..=32]);
        // 30 frames are whole windows at 0 and 14; the 31st needs a window at 15.
        assert_eq!(seams(61, FPS, 16, model), [30..=32, 32..=34]);
        assert_eq!(seams(60, FPS, 16, model), [30..=32, 32..=34]);
        assert!(seams(31, FPS, 16, model).is_empty());
        assert!(seams(0, FPS, 16, model).is_empty());
        assert_eq!(seams(44, FPS, 16, FPS), [15..=16, 29..=30]);

        let mut jump = moving(59, |t| DVec3::X * t);
        for frame in &mut jump[32..] {
            for point in frame {
                point.z += 0.1;
            }
        }
        let found = seam_acceleration(&jump, FPS, &seams(59, FPS, 16, model));
        // The jump shows in frames 31 and 32 of the seam's three: 0.1 m * (20/s)^2 in each; frame 32
        // is the first that has jumped.
        near(found.at_seams, 2.0 / 3.0 * 0.1 * 400.0);
        near(found.inside, 0.0);
    }

    #[test]
    fn only_feet_on_the_floor_slide() {
        near(
            contact_slide(&moving(5, |t| DVec3::Z * (0.3 * t)), FPS),
            0.3,
        );
        // The whole body rises by more than a contact's height a frame: nothing stays on the floor.
        let rising = moving(5, |t| DVec3::new(t, 2.0 * t, 0.0));
        assert_eq!(contact_slide(&rising, FPS), None);
    }

    #[test]
    fn the_largest_step_is_found_at_any_joint() {
        let mut poses = vec![Pose::REST; 4];
        poses[2].rotations[18] = from_axis_angle(DVec3::Y * 0.5);
        poses[3].rotations[18] = from_axis_angle(DVec3::Y * 0.7);
        poses[3].rotations[0] = from_axis_angle(DVec3::X * 0.1);
        near(Some(largest_rotation_step(&poses)), 0.5f64.to_degrees());
        assert_eq!(largest_rotation_step(&poses[..1]), 0.0);
    }
}
