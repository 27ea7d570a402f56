//! Aligning two captures of one action in time.

use datasets_spec::{Motion, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::resample;
use kinematics::rotation::yaw;
use kinematics::skeleton::NUM_BODY_JOINTS;

/// Half width of the warping band as a fraction of the longer motion: captures of one action differ in tempo,
/// not in order.
const BAND: f64 = 0.2;
/// Minimum half width of the band in frames.
const MIN_BAND: usize = 10;
/// Radius in frames of the smoothing of the warp: a path through a grid has steps, which would make the
/// motion jerk.
const SMOOTHING: usize = 3;

/// Joints relative to the point on the ground below the pelvis, and to the heading of the body.
type Posture = [DVec3; NUM_BODY_JOINTS];

/// Warps a motion in time to align its poses with those of `onto`. The result has the length of `onto`; the motion's
/// first and last pose and the order of its poses stay.
///
/// # Source
/// Dynamic time warping (Sakoe and Chiba 1978) on joint positions relative to pelvis and heading,
/// within a band of a fifth of the length.
pub(super) fn warped(motion: &Motion, onto: &Motion, skeleton: &Skeleton) -> Motion {
    let (from, to) = (postures(motion, skeleton), postures(onto, skeleton));
    let places = smoothed(&path(&from, &to));
    let last = motion.len() - 1;
    let grid: Vec<(usize, f64)> = places
        .into_iter()
        .map(|place| {
            let place = place.clamp(0.0, last as f64);
            let before = (place.floor() as usize).min(last.saturating_sub(1));
            (before, place - before as f64)
        })
        .collect();
    let poses = resample::interpolate_all(&motion.poses(), &grid);
    Motion::from_poses(onto.fps(), &poses).expect("poses between finite poses are finite")
}

fn postures(motion: &Motion, skeleton: &Skeleton) -> Vec<Posture> {
    let joints = skeleton.points_of_frames::<NUM_BODY_JOINTS>(motion, 0..motion.len());
    motion
        .poses()
        .iter()
        .zip(joints)
        .map(|(pose, joints)| {
            let heading = yaw(DMat3::from_quat(pose.rotations[0]));
            let back = DQuat::from_rotation_y(-heading);
            joints.map(|joint| back * (joint - joints[0].with_y(0.0)))
        })
        .collect()
}

fn apart(a: &Posture, b: &Posture) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance_squared(*b)).sum()
}

/// For every frame of `to`, the mean index of the frames of `from` that the optimal path matches with it.
fn path(from: &[Posture], to: &[Posture]) -> Vec<f64> {
    /// Whether a step of the path advances by a frame of `to`, and whether by one of `from`.
    type Step = [bool; 2];
    const BOTH: Step = [true, true];
    let (rows, columns) = (to.len(), from.len());
    let longer = rows.max(columns);
    let band = ((BAND * longer as f64) as usize).max(MIN_BAND) as f64;
    let slope = columns.saturating_sub(1) as f64 / rows.saturating_sub(1).max(1) as f64;
    // Half width of the band in frames of `from`, wide enough that neighbouring rows overlap.
    let reach = band.max(2.0 * slope);
    let bounds = |row: usize| {
        let centre = slope * row as f64;
        let first = (centre - reach).max(0.0) as usize;
        let end = ((centre + reach) as usize + 1).min(columns);
        (first, end)
    };
    let mut steps: Vec<Vec<Step>> = Vec::with_capacity(rows);
    let mut before: (usize, Vec<f64>) = (0, Vec::new());
    for (row, target) in to.iter().enumerate() {
        let (first, end) = bounds(row);
        let mut costs = Vec::with_capacity(end - first);
        let mut row_steps = Vec::with_capacity(end - first);
        let above = |column: usize| {
            let place = column.checked_sub(before.0)?;
            before.1.get(place).copied()
        };
        for (column, frame) in from.iter().enumerate().take(end).skip(first) {
            let candidates = [
                (BOTH, column.checked_sub(1).and_then(above)),
                ([true, false], above(column)),
                ([false, true], costs.last().copied()),
            ];
            let (step, cost) = candidates
                .into_iter()
                .filter_map(|(step, cost)| Some((step, cost?)))
                .fold((BOTH, f64::INFINITY), |best, next| {
                    if next.1 < best.1 { next } else { best }
                });
            let cost = if row == 0 && column == 0 { 0.0 } else { cost };
            costs.push(cost + apart(frame, target));
            row_steps.push(step);
        }
        steps.push(row_steps);
        before = (first, costs);
    }
    let mut sums = vec![(0.0, 0.0); rows];
    let (mut row, mut column) = (rows - 1, columns - 1);
    loop {
        sums[row].0 += column as f64;
        sums[row].1 += 1.0;
        if row == 0 && column == 0 {
            break;
        }
        let [in_to, in_from] = match (row, column) {
            (0, _) => [false, true],
            (_, 0) => [true, false],
            _ => steps[row][column - bounds(row).0],
        };
        row -= usize::from(in_to);
        column -= usize::from(in_from);
    }
    sums.into_iter().map(|(sum, count)| sum / count).collect()
}

/// Smooths a rising sequence with fixed ends.
fn smoothed(places: &[f64]) -> Vec<f64> {
    let last = places.len() - 1;
    (0..places.len())
        .map(|at| {
            let reach = SMOOTHING.min(at).min(last - at);
            let window = &places[at - reach..=at + reach];
            window.iter().sum::<f64>() / window.len() as f64
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use datasets_spec::Fps;

    use super::*;
    use crate::fixture;

    /// A motion whose tempo changes over time.
    fn hurried(motion: &Motion, num_frames: usize) -> Motion {
        let last = (motion.len() - 1) as f64;
        let grid: Vec<(usize, f64)> = (0..num_frames)
            .map(|frame| {
                let share = frame as f64 / (num_frames - 1) as f64;
                let place = last * (share + 0.05 * (std::f64::consts::TAU * share).sin());
                let place = place.clamp(0.0, last);
                let before = (place.floor() as usize).min(motion.len() - 2);
                (before, place - before as f64)
            })
            .collect();
        let poses = resample::interpolate_all(&motion.poses(), &grid);
        Motion::from_poses(Fps::STORE, &poses).expect("finite")
    }

    #[test]
    fn a_warped_motion_meets_the_other_one() {
        let skeleton = Skeleton::smplx_neutral();
        let slow = fixture::wandering("warped", 120);
        let fast = hurried(&slow, 90);
        let found = warped(&slow, &fast, &skeleton);
        assert_eq!((found.len(), found.fps()), (90, Fps::STORE));
        let mean_apart = |motion: &Motion| {
            let (a, b) = (postures(motion, &skeleton), postures(&fast, &skeleton));
            let distances = a.iter().zip(&b).map(|(a, b)| (apart(a, b) / 22.0).sqrt());
            distances.sum::<f64>() / a.len() as f64
        };
        let cropped = slow.crop(0..90).expect("longer");
        // The joints of the fixture move at about 1 m/s, so 5 cm in a frame.
        assert!(mean_apart(&found) < 0.03, "{}", mean_apart(&found));
        assert!(mean_apart(&cropped) > 5.0 * mean_apart(&found));
        let ends = |motion: &Motion| [motion.pose(0), motion.pose(motion.len() - 1)];
        for (found, own) in ends(&found).into_iter().zip(ends(&slow)) {
            assert!((found.transl - own.transl).length() < 1e-5);
        }
    }

    #[test]
    fn equal_motions_and_short_ones_are_left_alone() {
        let skeleton = Skeleton::smplx_neutral();
        for frames in [1, 2, 3, 40] {
            let motion = fixture::wandering("still", frames);
            let found = warped(&motion, &motion, &skeleton);
            for frame in 0..frames {
                let apart = found.pose(frame).transl - motion.pose(frame).transl;
                assert!(apart.length() < 1e-6, "{frames} frames");
            }
        }
    }
}
