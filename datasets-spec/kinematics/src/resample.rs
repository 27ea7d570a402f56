//! Changing the frame rate of a motion.

use serde::{Deserialize, Serialize};

use crate::motion::{Motion, MotionBuilder};
use crate::pose::Pose;
use crate::rotation::slerp;
pub use crate::simd::blocks::interpolate_all;
use crate::{Error, Fps};

/// Tolerance of the time of the last frame, in output frames. Files round their rates, so a frame that is due a
/// millionth of a frame after the end of the clip still counts.
const END_SLACK_FRAMES: f64 = 1e-6;

/// How a motion is brought to another rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Resample {
    /// Interpolation at exact times: spherical for rotations, linear for translations.
    #[default]
    Exact,
    /// The published HumanML3D rule: every `floor(fps / target)`-th frame, no interpolation. The
    /// true rate then differs from the target unless the target divides the rate.
    HumanMl3d,
}

impl Resample {
    /// Brings a motion to the target rate. The result states the target rate, even with [`Resample::HumanMl3d`], whose
    /// true rate may differ.
    ///
    /// # Errors
    /// The source rate is below the target with [`Resample::HumanMl3d`], which can only drop frames.
    pub fn apply(self, motion: &Motion, target: Fps) -> Result<Motion, Error> {
        match self {
            Self::Exact => exact(motion, target),
            Self::HumanMl3d => floor_stride(motion, target),
        }
    }
}

fn exact(motion: &Motion, target: Fps) -> Result<Motion, Error> {
    if motion.fps() == target {
        return Ok(motion.clone());
    }
    /// Frames interpolated at a time, to limit the memory for working precision.
    const AT_ONCE: usize = 1024;
    let grid = grid(motion.len(), motion.fps(), target);
    let mut builder = MotionBuilder::with_capacity(grid.len());
    for places in grid.chunks(AT_ONCE) {
        // The sample positions ascend, and the last one may lie between two frames.
        let (first, last) = (places[0].0, places[places.len() - 1].0);
        let poses = motion.poses_in(first..motion.len().min(last + 2));
        let places: Vec<(usize, f64)> = places
            .iter()
            .map(|&(frame, share)| (frame - first, share))
            .collect();
        builder.extend(&interpolate_all(&poses, &places));
    }
    builder.build(target)
}

/// Sample positions for bringing a clip of `num_frames` to another rate with [`Resample::Exact`]: for each output
/// frame, the source frame at or before it, and the fraction of the interval to the next one, in [0, 1). Empty for a
/// clip without frames.
pub fn grid(num_frames: usize, source: Fps, target: Fps) -> Vec<(usize, f64)> {
    let Some(last) = num_frames.checked_sub(1) else {
        return Vec::new();
    };
    let source_per_target = source.get() / target.get();
    let last = last as f64;
    let num_frames = (last / source_per_target + END_SLACK_FRAMES).floor() as usize + 1;
    (0..num_frames)
        .map(|frame| {
            let at = (frame as f64 * source_per_target).min(last);
            (at.floor() as usize, at.fract())
        })
        .collect()
}

/// Interpolates between two poses: translation linearly, rotations by slerp.
pub fn interpolate(from: &Pose, to: &Pose, alpha: f64) -> Pose {
    Pose {
        transl: from.transl.lerp(to.transl, alpha),
        rotations: std::array::from_fn(|joint| {
            slerp(from.rotations[joint], to.rotations[joint], alpha)
        }),
    }
}

fn floor_stride(motion: &Motion, target: Fps) -> Result<Motion, Error> {
    let stride = (motion.fps().get() / target.get()).floor() as usize;
    if stride == 0 {
        return Err(Error(format!(
            "{} is below {target}, and this rule only drops frames",
            motion.fps()
        )));
    }
    Motion::new(
        target,
        every(stride, motion.transl()),
        every(stride, motion.global_orient()),
        every(stride, motion.body_pose()),
    )
}

/// Every frame whose number is a multiple of the stride.
fn every<T: Copy>(stride: usize, frames: &[T]) -> Vec<T> {
    frames.iter().step_by(stride).copied().collect()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::rotation::{angle_between, from_axis_angle};

    /// A body moving along x at 1 m/s while turning its left elbow at 1 rad/s.
    fn steady(fps: f64, num_frames: usize) -> Motion {
        let fps = Fps::new(fps).expect("valid");
        let poses: Vec<Pose> = (0..num_frames)
            .map(|frame| {
                let secs = fps.secs_at(frame);
                let mut pose = Pose::REST;
                pose.transl = DVec3::X * secs;
                pose.rotations[18] = from_axis_angle(DVec3::Y * secs);
                pose
            })
            .collect();
        Motion::from_poses(fps, &poses).expect("valid")
    }

    #[test]
    fn exact_resampling_keeps_time() {
        for (fps, frames, expected) in [
            (30.0, 61, 41),
            (120.0, 241, 41),
            (60.0, 122, 41),
            (65.0533, 200, 62),
            (10.0, 21, 41),
        ] {
            let out = Resample::Exact.apply(&steady(fps, frames), Fps::STORE);
            let out = out.expect("resamples");
            assert_eq!(out.len(), expected, "{fps} fps");
            for (frame, pose) in out.poses().into_iter().enumerate() {
                let secs = Fps::STORE.secs_at(frame);
                assert!((pose.transl.x - secs).abs() < 1e-6);
                assert!(angle_between(pose.rotations[18], from_axis_angle(DVec3::Y * secs)) < 1e-6);
            }
        }
    }

    #[test]
    fn the_published_rule_drops_frames_and_nothing_else() {
        let source = steady(250.0, 100);
        let dropped = |motion: &Motion| Resample::HumanMl3d.apply(motion, Fps::STORE);
        let out = dropped(&source).expect("drops");
        assert_eq!(out.len(), 9, "stride floor(250 / 20) = 12");
        assert_eq!(out.transl()[3], source.transl()[36]);
        let refused = dropped(&steady(10.0, 5))
            .expect_err("a lower rate")
            .to_string();
        assert_eq!(
            refused,
            "10 fps is below 20 fps, and this rule only drops frames"
        );
    }
}
