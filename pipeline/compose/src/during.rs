//! Edits of some frames of a motion: all other frames equal the original's.

use std::ops::Range;

use datasets_spec::{Motion, Pose};
use glam::DQuat;
use kinematics::resample::interpolate;
use kinematics::rotation::slerp;

/// Seconds at each end of an edited range over which the edit is blended with the original.
const BLEND_SECS: f64 = 0.4;

/// Whether edits of some ranges leave any frame of a motion unchanged.
pub fn leaves_frames(num_frames: usize, edited: &[Range<usize>]) -> bool {
    edited_runs(edited) != std::slice::from_ref(&(0..num_frames))
}

/// Runs of edited frames. Ranges that touch or overlap form one run.
fn edited_runs(edited: &[Range<usize>]) -> Vec<Range<usize>> {
    let mut ranges = edited.to_vec();
    ranges.sort_by_key(|range| range.start);
    let mut runs: Vec<Range<usize>> = Vec::new();
    for range in ranges {
        match runs.last_mut() {
            Some(run) if range.start <= run.end => run.end = run.end.max(range.end),
            _ => runs.push(range),
        }
    }
    runs
}

/// The original with the edited runs of frames in it. Frames outside the runs are copied, bit for bit.
///
/// A run continues the original: it is moved over the ground and turned about the vertical such that the edited frame
/// before it would match the original's. If frames follow the run, its last frame gets the original's position and
/// heading; the difference is spread evenly over the frames of the run. At each end that meets frames of the original,
/// the poses are blended with the original's over 0.4 s inside the run, but at most over a third of it.
///
/// # Errors
/// An edited frame is not finite.
///
/// # Panics
/// If the motions differ in length, or a range ends after them.
pub fn keep_outside(
    original: &Motion,
    edited: &Motion,
    ranges: &[Range<usize>],
) -> Result<Motion, datasets_spec::Error> {
    assert_eq!(original.len(), edited.len(), "an edit of the same rate");
    let mut transl = original.transl().to_vec();
    let mut global_orient = original.global_orient().to_vec();
    let mut body_pose = original.body_pose().to_vec();
    for run in edited_runs(ranges) {
        let poses = joined(original, edited, run.clone());
        let part = Motion::from_poses(original.fps(), &poses)?;
        transl[run.clone()].copy_from_slice(part.transl());
        global_orient[run.clone()].copy_from_slice(part.global_orient());
        body_pose[run].copy_from_slice(part.body_pose());
    }
    Ok(Motion::new(
        original.fps(),
        transl,
        global_orient,
        body_pose,
    )?)
}

/// The poses of a run, joined to the original on both sides.
fn joined(original: &Motion, edited: &Motion, run: Range<usize>) -> Vec<Pose> {
    let sources = original.poses_in(run.clone());
    let mut poses = edited.poses_in(run.clone());
    if let Some(before) = run.start.checked_sub(1) {
        // The pelvis is `transl` plus a constant, so moving the translation moves the pelvis.
        let (from, to) = (edited.pose(before), original.pose(before));
        let turn = heading_between(&from, &to);
        for pose in &mut poses {
            let height_m = pose.transl.y;
            pose.transl = turn * (pose.transl - from.transl) + to.transl;
            pose.transl.y = height_m;
            pose.rotations[0] = turn * pose.rotations[0];
        }
    }
    let num_frames = poses.len();
    let is_followed = run.end < original.len();
    if is_followed && let (Some(last), Some(wanted)) = (poses.last(), sources.last()) {
        let turn = heading_between(last, wanted);
        let way = (wanted.transl - last.transl).with_y(0.0);
        for (index, pose) in poses.iter_mut().enumerate() {
            let share = (index + 1) as f64 / num_frames as f64;
            pose.transl += share * way;
            pose.rotations[0] = slerp(DQuat::IDENTITY, turn, share) * pose.rotations[0];
        }
    }
    let longest = (BLEND_SECS * original.fps().get()).round() as usize;
    let blended = longest.min(num_frames / 3);
    // Weight of the edit, by distance from an end of the run. An end of the motion is not blended.
    let share = |place: usize, is_seam: bool| {
        let share = (place + 1) as f64 / (blended + 1) as f64;
        if is_seam && share < 1.0 {
            share * share * (3.0 - 2.0 * share)
        } else {
            1.0
        }
    };
    poses
        .iter()
        .zip(&sources)
        .enumerate()
        .map(|(index, (pose, source))| {
            let after_start = share(index, run.start > 0);
            let before_end = share(num_frames - 1 - index, is_followed);
            match after_start.min(before_end) {
                1.0 => *pose,
                share => interpolate(source, pose, share),
            }
        })
        .collect()
}

/// The turn about the vertical that is nearest to the rotation between two roots. It is defined for lying
/// bodies too, whose pelvis has no heading.
fn heading_between(from: &Pose, to: &Pose) -> DQuat {
    let between = to.rotations[0] * from.rotations[0].conjugate();
    DQuat::from_rotation_y(2.0 * between.y.atan2(between.w))
}

#[cfg(test)]
mod tests {
    use datasets_spec::Fps;
    use glam::DVec3;
    use kinematics::rotation::{angle_between, from_axis_angle};

    use super::*;

    const FRAMES: usize = 60;

    fn motion(pose: impl Fn(f64) -> Pose) -> Motion {
        let poses: Vec<Pose> = (0..FRAMES).map(|frame| pose(frame as f64)).collect();
        Motion::from_poses(Fps::STORE, &poses).expect("finite")
    }

    /// A person who walks towards +z.
    fn walk(frame: f64) -> Pose {
        Pose {
            transl: DVec3::new(0.0, 0.9, 0.05 * frame),
            ..Pose::REST
        }
    }

    /// The same person, who also raises an arm and turns left.
    fn turning_walk(frame: f64) -> Pose {
        let mut pose = walk(frame);
        let turn = DQuat::from_rotation_y(0.02 * frame);
        pose.transl = turn * pose.transl + DVec3::new(2.0, 0.0, 1.0);
        pose.rotations[0] = turn;
        pose.rotations[16] = from_axis_angle(DVec3::Z);
        pose
    }

    #[test]
    fn touching_ranges_are_one_run_and_a_whole_motion_leaves_nothing() {
        let ranges = [20..30, 40..60, 30..35, 0..10];
        assert_eq!(edited_runs(&ranges), [0..10, 20..35, 40..60]);
        assert!(leaves_frames(60, &ranges));
        assert!(!leaves_frames(60, &[0..20, 20..60]));
    }

    #[test]
    fn frames_outside_are_copied_and_a_run_meets_them() {
        let (original, edited) = (motion(walk), motion(turning_walk));
        let ranges = [10..40, 50..55];
        let found = keep_outside(&original, &edited, &ranges).expect("finite");
        for frame in 0..FRAMES {
            let outside = ranges.iter().all(|range| !range.contains(&frame));
            let same = found.transl()[frame] == original.transl()[frame]
                && found.global_orient()[frame] == original.global_orient()[frame]
                && found.body_pose()[frame] == original.body_pose()[frame];
            assert_eq!(same, outside, "frame {frame}");
        }
        // The walk goes 5 cm a frame. Over 30 frames the turn of 0.6 rad displaces it by 0.45 m, which is spread evenly
        // over the frames, so that no step is longer than two steps of the walk.
        for frame in 1..FRAMES {
            let (before, after) = (found.pose(frame - 1), found.pose(frame));
            let step = after.transl.distance(before.transl);
            assert!(step < 0.1, "frame {frame}: {step}");
            // The arm turns by a radian within 8 frames in a smooth step, by at most 1.5 / 8 rad per frame. A run of
            // five frames is blended over a third, one frame: half a radian per frame.
            let most = if frame < 45 { 0.2 } else { 0.55 };
            let turn = angle_between(before.rotations[16], after.rotations[16]);
            assert!(turn < most, "frame {frame}: {turn}");
        }
        // The middle frames follow the edit: the arm is up, and the heading follows the edit except for the correction
        // to the end.
        let middle = found.pose(25);
        let up = from_axis_angle(DVec3::Z);
        assert!(angle_between(middle.rotations[16], up) < 1e-6);
        // Frame 25 is the 16th of 30, which turn by 0.02 rad each from frame 9 on; the total of 0.6 rad is corrected
        // evenly.
        let expected = 0.02 * 16.0 - 0.6 * 16.0 / 30.0;
        let turn = DQuat::from_rotation_y(expected);
        assert!(angle_between(middle.rotations[0], turn) < 1e-6);
    }

    #[test]
    fn at_an_end_of_the_motion_an_edit_is_free() {
        let (original, edited) = (motion(walk), motion(turning_walk));
        let found = keep_outside(&original, &edited, &[30..45, 45..FRAMES]).expect("finite");
        // Nothing follows: the last frame has turned for 30 frames since frame 29.
        let last = found.pose(FRAMES - 1);
        assert!(angle_between(last.rotations[0], DQuat::from_rotation_y(0.6)) < 1e-6);
        let found = keep_outside(&original, &edited, &[0..15, 15..30]).expect("finite");
        let first = found.pose(0);
        let up = from_axis_angle(DVec3::Z);
        assert!(angle_between(first.rotations[16], up) < 1e-6);
        // The run ends at the original's position in that frame.
        let end = found.pose(29);
        assert!(end.transl.distance(walk(29.0).transl) < 1e-6);
    }
}
