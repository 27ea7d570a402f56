//! Motion quality, independent of content: acceleration at the seams of generated windows, jerk, foot slide, and jumps
//! of rotations.

use std::ops::{Range, RangeInclusive};

use datasets_spec::{Fps, Pose};
use kinematics::KeypointFrame;
use kinematics::canonical::FIXED_FRAMES;
use kinematics::rotation::angle_between;
use kinematics::skeleton::NUM_KEYPOINTS;

use super::definition::{Better, Measure, Metric, Part, SeamAcceleration};
use super::interval::mean;

pub(crate) static SEAM_ACCELERATION: Metric = Metric {
    name: "Acceleration at seams (m/s²)",
    about: "mean acceleration of the keypoints where two of the editor's windows meet, from the frame before the first \
            new one of a window to its first that is not blended with the window before; real data, the identity \
            editor and systems without windows are measured at the same frames",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 2,
    measure: Measure::Motion(|sample| sample.acceleration.at_seams),
};

pub(crate) static INSIDE_ACCELERATION: Metric = Metric {
    name: "inside (m/s²)",
    about: "mean acceleration of the keypoints elsewhere",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 2,
    measure: Measure::Motion(|sample| sample.acceleration.inside),
};

pub(crate) static JERK: Metric = Metric {
    name: "Jerk (m/s³)",
    about: "mean third derivative of the keypoints",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 1,
    measure: Measure::Motion(|sample| jerk(sample.keypoints, sample.motion.fps())),
};

pub(crate) static FOOT_SLIDE: Metric = Metric {
    name: "Foot slide (m/s)",
    about: "mean horizontal speed of the ankle or foot that is lowest, frame by frame",
    part: Part::Main,
    better: |_| Better::NearReal,
    decimals: 3,
    measure: Measure::Motion(|sample| foot_slide(sample.keypoints, sample.motion.fps())),
};

pub(crate) static TARGET_FOOT_SLIDE: Metric = Metric {
    name: "Target's foot slide (m/s)",
    about: "the same of the item's target",
    part: Part::Main,
    better: |_| Better::NearReal,
    decimals: 3,
    measure: Measure::Motion(|sample| sample.target.foot_slide),
};

pub(crate) static ROTATION_STEP: Metric = Metric {
    name: "Largest turn (°/frame)",
    about: "largest rotation of a joint between two frames, mean over motions",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 1,
    measure: Measure::Motion(|sample| Some(largest_rotation_step(&sample.motion.poses()))),
};

/// Keypoints of the feet: both ankles and both toe joints.
const FEET: [usize; 4] = [7, 8, 10, 11];

/// A seam between two generated windows, in frames of the edited motion: from the frame before the first new one of the
/// later window to its first frame that is not blended with the earlier window.
pub type Seam = RangeInclusive<usize>;

/// Layout of the windows that generated an edited range, in order from its first frame. Each window repeats [`FIXED_FRAMES`]
/// frames of the previous one, and is blended with the previous window in further frames that they share. The last
/// window of a motion ends with it, so it may begin earlier than `advance` says; that of a range before the end is cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Windows {
    /// Number of frames in a window.
    pub frames: usize,
    /// Number of frames from the start of one window to the start of the next.
    pub advance: usize,
    /// Frame rate of the windows.
    pub fps: Fps,
}

/// The seams, in frames at `fps`, of a motion with `num_frames` frames at `fps` of which a range was edited.
pub fn seams(num_frames: usize, edited: Range<usize>, fps: Fps, windows: Windows) -> Vec<Seam> {
    let window = windows.frames;
    let per_model = fps.get() / windows.fps.get();
    let Some(last) = num_frames.checked_sub(1) else {
        return Vec::new();
    };
    // If the motion's last frame lies between two model frames, it was generated up to the second one.
    let model_frames = (last as f64 / per_model - 1e-6).ceil().max(0.0) as usize + 1;
    let longest = window.saturating_sub(FIXED_FRAMES);
    if !(1..=longest).contains(&windows.advance) {
        return Vec::new();
    }
    let blended = longest - windows.advance;
    let at = |frame: usize| frame as f64 * per_model;
    // The first model frame at or after a frame.
    let model_frame = |frame: usize| (frame as f64 / per_model - 1e-6).ceil().max(0.0) as usize;
    let end = match edited.end >= num_frames {
        true => model_frames,
        false => model_frame(edited.end),
    };
    // A range that begins at the second frame is edited from the first one on.
    let first = Some(model_frame(edited.start)).filter(|frame| *frame >= FIXED_FRAMES);
    let first = first.unwrap_or(0);
    let latest = model_frames.saturating_sub(window);
    let (mut starts, mut next, mut made) = (Vec::new(), first, first);
    while made < end {
        let natural = next.saturating_sub(FIXED_FRAMES);
        let start = match latest + FIXED_FRAMES >= first {
            true => natural.min(latest),
            false => natural,
        };
        starts.push(start);
        made = end.min(start + window);
        next = made - blended;
    }
    starts
        .into_iter()
        .skip(1)
        .map(|start| {
            let first_new = start + FIXED_FRAMES;
            let first_own = first_new + blended;
            at(first_new - 1).floor() as usize..=(at(first_own).ceil() as usize).min(last)
        })
        .collect()
}

/// Mean magnitude of the keypoints' acceleration in m/s^2, for each frame with a neighbour on both sides, `[L - 2]`;
/// entry `i` belongs to frame `i + 1`.
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

/// Averages [`accelerations`] over the frames of seams and over the other frames.
pub fn seam_acceleration(points: &[KeypointFrame], fps: Fps, seams: &[Seam]) -> SeamAcceleration {
    let is_at_seam =
        |(index, _): &(usize, f64)| seams.iter().any(|seam| seam.contains(&(index + 1)));
    let values = accelerations(points, fps).into_iter().enumerate();
    let (at, inside): (Vec<_>, Vec<_>) = values.partition(is_at_seam);
    let [at_seams, inside] =
        [at, inside].map(|part| mean(part.into_iter().map(|(_, value)| value)));
    SeamAcceleration { at_seams, inside }
}

/// Mean magnitude of the third derivative of the keypoints in m/s^3; `None` for fewer than four frames.
pub fn jerk(points: &[KeypointFrame], fps: Fps) -> Option<f64> {
    let of_window = |frames: &[KeypointFrame]| -> [f64; NUM_KEYPOINTS] {
        let [a, b, c, d] = frames else {
            unreachable!("windows of four")
        };
        std::array::from_fn(|slot| (d[slot] - 3.0 * (c[slot] - b[slot]) - a[slot]).length())
    };
    let mean = mean(points.windows(4).flat_map(of_window))?;
    Some(mean * fps.get().powi(3))
}

/// Mean horizontal speed in m/s of the lowest foot: for each two consecutive frames, the ankle or toe joint with the
/// lowest mean height in both. `None` for fewer than two frames.
///
/// A standing or walking body always has a foot at rest on the floor, so the value is near 0; for a gliding body it is
/// the body's speed. No height threshold defines contact, so a floating body is measured too.
pub fn foot_slide(points: &[KeypointFrame], fps: Fps) -> Option<f64> {
    let step_of = |frames: &[KeypointFrame]| {
        let height = |slot: &usize| frames[0][*slot].y + frames[1][*slot].y;
        let lowest = FEET
            .into_iter()
            .min_by(|a, b| height(a).total_cmp(&height(b)))
            .expect("there are feet");
        let step = frames[1][lowest] - frames[0][lowest];
        step.with_y(0.0).length()
    };
    Some(mean(points.windows(2).map(step_of))? * fps.get())
}

/// The largest change in degrees of a joint's local rotation (root included) from one frame to the next; 0 for fewer
/// than two frames.
pub fn largest_rotation_step(poses: &[Pose]) -> f64 {
    let (mut longest, mut angle) = (0.0f64, 0.0f64);
    for frames in poses.windows(2) {
        for (before, after) in frames[0].rotations.into_iter().zip(frames[1].rotations) {
            // The chord between two quaternions grows with the angle and needs no arc tangent.
            let chord = (after - before)
                .length_squared()
                .min((after + before).length_squared());
            if chord > 0.0 && chord >= NEARLY * longest {
                angle = angle.max(angle_between(before, after));
                longest = longest.max(chord);
            }
        }
    }
    angle.to_degrees()
}

/// Angles are computed for squared chords above this share of the longest, because rounding may hide which angle is
/// largest.
const NEARLY: f64 = 1.0 - 1e-9;

#[cfg(test)]
mod tests {
    use datasets_spec::Skeleton;
    use glam::DVec3;
    use kinematics::rotation::from_axis_angle;

    use super::*;

    const FPS: Fps = Fps::STORE;

    /// Keypoints of the rest pose, translated by `path`, a function of the time in seconds.
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
        let windows = |advance, fps| Windows {
            frames: 16,
            advance,
            fps,
        };
        let apart = windows(14, Fps::MODEL);
        let seams = |len, fps, windows| seams(len, 0..len, fps, windows);
        assert_eq!(seams(59, FPS, apart), [30..=32]);
        // Windows start at frames 0 and 14 for 30 frames; the 31st frame needs a window at 15.
        assert_eq!(seams(61, FPS, apart), [30..=32, 32..=34]);
        assert_eq!(seams(60, FPS, apart), [30..=32, 32..=34]);
        assert!(seams(31, FPS, apart).is_empty());
        assert!(seams(0, FPS, apart).is_empty());
        assert_eq!(seams(44, FPS, windows(14, FPS)), [15..=16, 29..=30]);
        // Windows start at frames 0, 10 and 14; the second overlaps the first in frames 12 to 15, which are blended.
        assert_eq!(seams(59, FPS, windows(10, Fps::MODEL)), [22..=32, 30..=40]);
        assert!(seams(59, FPS, windows(15, Fps::MODEL)).is_empty());

        // Windows of a range start two frames before it: at the model's frames 8 and 22 for the frames 20 to 59.
        let of_range = |range| super::seams(81, range, FPS, apart);
        assert_eq!(of_range(20..60), [46..=48]);
        // Frames 20 to 47 are the 14 new ones of one window.
        assert!(of_range(20..48).is_empty());
        assert_eq!(of_range(20..49), [46..=48]);
        // The last window ends with the motion, and starts at 25.
        assert_eq!(of_range(20..81), [46..=48, 52..=54]);
        // A range too near to the end for a window.
        assert!(of_range(70..81).is_empty());

        let mut jump = moving(59, |t| DVec3::X * t);
        for frame in &mut jump[32..] {
            for point in frame {
                point.z += 0.1;
            }
        }
        let found = seam_acceleration(&jump, FPS, &seams(59, FPS, apart));
        // The jump shows in frames 31 and 32 of the seam's three frames: 0.1 m * (20/s)^2 in each. Frame 32 is the
        // first after the jump.
        near(found.at_seams, 2.0 / 3.0 * 0.1 * 400.0);
        near(found.inside, 0.0);
    }

    #[test]
    fn the_lowest_foot_slides_at_its_own_speed() {
        // A gliding body, on the floor or rising above it.
        for rise in [0.0, 2.0] {
            let gliding = moving(5, |t| DVec3::new(0.0, rise * t, 0.3 * t));
            near(foot_slide(&gliding, FPS), 0.3);
        }
        // One foot is planted below the other, which swings.
        let mut walking = moving(5, |t| DVec3::Z * t);
        let planted = walking[0][FEET[2]] - DVec3::Y * 0.2;
        for frame in &mut walking {
            frame[FEET[2]] = planted;
        }
        near(foot_slide(&walking, FPS), 0.0);
        assert_eq!(foot_slide(&walking[..1], FPS), None);
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
