//! Checks of a finished motion: rejections and flags.

use std::ops::Range;

pub use datasets_spec::flags::*;
use datasets_spec::table::Quality;
use datasets_spec::{Motion, Skeleton};
use glam::DVec3;
use kinematics::skeleton::NUM_BODY_JOINTS;
use serde::{Deserialize, Serialize};

use crate::Rejected;

/// Handling of a motion with a jump that no person can make.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Teleports {
    /// Put the motion into quarantine.
    #[default]
    Quarantine,
    /// Keep the longest stretch without a jump, and flag the clip.
    Trim,
    /// Keep the motion, and flag the clip.
    Keep,
}

type Joints = [DVec3; NUM_BODY_JOINTS];

/// Minimum number of frames of a motion.
const MIN_FRAMES: usize = 2;
/// Speed of a joint in m/s above which the motion is broken. The fastest human movement, a pitcher's
/// hand, comes close to it.
const TELEPORT_SPEED: f64 = 20.0;
const FAST_SPEED: f64 = 12.0;
const PENETRATION_M: f64 = 0.05;
const CONSTANT_M: f64 = 1e-3;
const SHORT_SECS: f64 = 1.0;
/// Height in metres below which a foot joint is near the floor.
const CONTACT_M: f64 = 0.05;
/// Height in metres at which a foot joint no longer counts as planted, and the mean speed in m/s of
/// planted feet that counts as sliding; captured walks measure 0.02 to 0.2.
const PLANTED_M: f64 = 0.025;
const SKATE_SPEED: f64 = 0.3;
/// The joints at the balls of both feet.
const FEET: [usize; 2] = [10, 11];

/// Checks a motion.
///
/// `max_speed` is the highest speed of any of the 22 body joints. `foot_skate` is the mean horizontal speed of the foot
/// joints, weighted by `2 - 2^(h / 2.5 cm)`, with `h` the greater of a foot's heights in the two frames of a step: a
/// foot that swings close to the floor counts little, a foot above 2.5 cm does not count. Both are in m/s.
///
/// # Errors
/// `E-TOO-SHORT` for fewer than 2 frames, `E-TELEPORT` for speeds above 20 m/s.
///
/// # Source
/// The weight of foot skate is that of Zhang et al., "Mode-Adaptive Neural Networks for Quadruped
/// Motion Control" (2018).
pub fn check(motion: &Motion, skeleton: &Skeleton) -> Result<Quality, Rejected> {
    let (quality, jump) = judge(motion, skeleton)?;
    match jump {
        None => Ok(quality),
        Some(jump) => Err(jump.rejected(jump.frame)),
    }
}

/// Like [`check`], with the given handling of jumps. Returns the kept motion, and its frame range if it was trimmed.
/// `source_frame` gives the frame of the file, which a rejection names, for one of the motion.
///
/// # Errors
/// As [`check`]; `E-TELEPORT` also if a trimmed motion has fewer than 2 frames.
pub fn check_with(
    motion: Motion,
    skeleton: &Skeleton,
    teleports: Teleports,
    source_frame: impl Fn(usize) -> usize,
) -> Result<(Motion, Quality, Option<Range<usize>>), Rejected> {
    let (mut quality, jump) = judge(&motion, skeleton)?;
    let Some(jump) = jump else {
        return Ok((motion, quality, None));
    };
    let rejected = || jump.rejected(source_frame(jump.frame));
    match teleports {
        Teleports::Quarantine => Err(rejected()),
        Teleports::Keep => {
            quality.flags |= FLAG_TELEPORT;
            Ok((motion, quality, None))
        }
        Teleports::Trim => {
            let kept = longest_calm_stretch(&motion, skeleton);
            let trimmed = motion.crop(kept.clone()).map_err(|_| rejected())?;
            if trimmed.len() < MIN_FRAMES {
                return Err(rejected());
            }
            let (mut quality, _) = judge(&trimmed, skeleton)?;
            quality.flags |= FLAG_TELEPORT;
            Ok((trimmed, quality, Some(kept)))
        }
    }
}

/// Whether the first frame is a pose apart from the motion: the step to the second frame is a teleport, and the next
/// step is not. Captures may begin with a T-pose.
pub fn starts_apart(motion: &Motion, skeleton: &Skeleton) -> bool {
    /// Number of frames examined: the first one, and the two that a motion needs.
    const LOOKED_AT: usize = 1 + MIN_FRAMES;
    if motion.len() < LOOKED_AT {
        return false;
    }
    let joints: Vec<Joints> = skeleton.points_of_frames(motion, 0..LOOKED_AT);
    let jumps = |frame: usize| is_teleport(&joints[frame - 1], &joints[frame], motion.fps().get());
    jumps(1) && !jumps(2)
}

/// Whether a joint moves faster than [`TELEPORT_SPEED`] from one frame to the next.
fn is_teleport(before: &Joints, joints: &Joints, fps: f64) -> bool {
    (0..NUM_BODY_JOINTS)
        .any(|joint| (joints[joint] - before[joint]).length() * fps > TELEPORT_SPEED)
}

/// The longest run of frames without a teleport; the first of equally long ones.
fn longest_calm_stretch(motion: &Motion, skeleton: &Skeleton) -> Range<usize> {
    let fps = motion.fps().get();
    let mut longest = 0..0;
    let mut start = 0;
    let mut before = None;
    let mut ends_at = |frame: usize, start: &mut usize| {
        if frame - *start > longest.len() {
            longest = *start..frame;
        }
        *start = frame;
    };
    for_each_frame(motion, skeleton, |frame, joints| {
        let before = before.replace(*joints);
        let jumps = before.is_some_and(|before| is_teleport(&before, joints, fps));
        if jumps {
            ends_at(frame, &mut start);
        }
    });
    ends_at(motion.len(), &mut start);
    longest
}

/// Calls `take` with the joints of every frame, in order. Few frames are held at a time.
fn for_each_frame(motion: &Motion, skeleton: &Skeleton, mut take: impl FnMut(usize, &Joints)) {
    const FRAMES_AT_ONCE: usize = 256;
    for first in (0..motion.len()).step_by(FRAMES_AT_ONCE) {
        let frames = first..motion.len().min(first + FRAMES_AT_ONCE);
        let joints: Vec<Joints> = skeleton.points_of_frames(motion, frames);
        for (at, joints) in joints.iter().enumerate() {
            take(first + at, joints);
        }
    }
}

/// The fastest movement in a motion with a teleport.
struct Jump {
    joint: usize,
    frame: usize,
    speed: f64,
}

impl Jump {
    fn rejected(&self, frame: usize) -> Rejected {
        Rejected::check(
            "E-TELEPORT",
            format!(
                "found {} moving at {:.1} m/s into frame {frame}, expected at most {TELEPORT_SPEED} m/s",
                kinematics::skeleton::JOINT_NAMES[self.joint],
                self.speed
            ),
        )
    }
}

fn judge(motion: &Motion, skeleton: &Skeleton) -> Result<(Quality, Option<Jump>), Rejected> {
    if motion.len() < MIN_FRAMES {
        return Err(Rejected::check(
            "E-TOO-SHORT",
            format!(
                "found {} frame at {}, expected at least {MIN_FRAMES}",
                motion.len(),
                motion.fps()
            ),
        ));
    }
    let fps = motion.fps().get();
    let mut first: Option<Joints> = None;
    let mut before: Joints = [DVec3::ZERO; NUM_BODY_JOINTS];
    // Compare squared distances: a square root per joint and frame would cost as much as the kinematics.
    let mut longest_step = 0.0f64;
    let mut fastest = (0, 0);
    let mut longest_shift = 0.0f64;
    let mut lowest = f64::INFINITY;
    let (mut skate_sum, mut weight_sum, mut touches) = (0.0, 0.0, false);
    for_each_frame(motion, skeleton, |frame, joints| {
        lowest = joints.iter().fold(lowest, |low, joint| low.min(joint.y));
        let Some(first) = &first else {
            first = Some(*joints);
            before = *joints;
            return;
        };
        for joint in 0..NUM_BODY_JOINTS {
            let step = (joints[joint] - before[joint]).length_squared();
            if step > longest_step {
                longest_step = step;
                fastest = (frame, joint);
            }
            longest_shift = longest_shift.max((joints[joint] - first[joint]).length_squared());
        }
        for foot in FEET {
            let height = joints[foot].y.max(before[foot].y).max(0.0);
            touches |= height < CONTACT_M;
            if height < PLANTED_M {
                let weight = 2.0 - (height / PLANTED_M).exp2();
                skate_sum += weight * (joints[foot] - before[foot]).with_y(0.0).length() * fps;
                weight_sum += weight;
            }
        }
        before = *joints;
    });
    let (max_speed, max_shift) = (longest_step.sqrt() * fps, longest_shift.sqrt());
    let jump = (max_speed > TELEPORT_SPEED).then_some(Jump {
        joint: fastest.1,
        frame: fastest.0,
        speed: max_speed,
    });
    let foot_skate = if weight_sum > 0.0 {
        skate_sum / weight_sum
    } else {
        0.0
    };
    let findings = [
        (FLAG_FLOOR_PENETRATION, lowest < -PENETRATION_M),
        (FLAG_FOOT_SKATE, foot_skate > SKATE_SPEED),
        (FLAG_CONSTANT_POSE, max_shift <= CONSTANT_M),
        (FLAG_VERY_SHORT, motion.duration_secs() < SHORT_SECS),
        (FLAG_NO_CONTACT, !touches),
        (FLAG_FAST, max_speed > FAST_SPEED),
    ];
    let quality = Quality {
        flags: findings
            .iter()
            .filter(|(_, found)| *found)
            .fold(0, |flags, (flag, _)| flags | flag),
        max_speed: max_speed as f32,
        foot_skate: foot_skate as f32,
    };
    Ok((quality, jump))
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Pose};

    use super::*;

    /// A body in the T-pose on the floor that slides along x.
    fn sliding(fps: Fps, speed: f64, frames: usize) -> Motion {
        let skeleton = Skeleton::smplx_neutral();
        let poses: Vec<Pose> = (0..frames)
            .map(|frame| Pose {
                transl: DVec3::new(speed * fps.secs_at(frame), -skeleton.rest(11).y, 0.0),
                ..Pose::REST
            })
            .collect();
        Motion::from_poses(fps, &poses).expect("valid")
    }

    fn flags(motion: &Motion) -> u32 {
        let quality = check(motion, &Skeleton::smplx_neutral());
        quality.expect("passes").flags
    }

    fn shift(motion: &mut Motion, frames: Range<usize>, by: [f32; 3]) {
        for frame in frames {
            let [x, y, z] = motion.transl()[frame];
            motion.set_transl(frame, [x + by[0], y + by[1], z + by[2]]);
        }
    }

    #[test]
    fn a_sliding_body_skates_at_its_own_speed() {
        let quality = check(&sliding(Fps::STORE, 0.5, 41), &Skeleton::smplx_neutral())
            .expect("0.5 m/s is no teleport");
        assert_eq!(quality.flags, FLAG_FOOT_SKATE);
        // Positions are stored in f32: at 1 m, 20 fps, that is an error of 2.4e-6 m/s.
        assert!((quality.foot_skate - 0.5).abs() < 1e-5);
        assert!((quality.max_speed - 0.5).abs() < 1e-4);
    }

    #[test]
    fn stillness_shortness_and_heights_are_flagged() {
        assert_eq!(flags(&sliding(Fps::STORE, 0.0, 41)), FLAG_CONSTANT_POSE);
        assert_eq!(flags(&sliding(Fps::STORE, 0.1, 19)), FLAG_VERY_SHORT);
        let lifted = |height: f32| {
            let mut motion = sliding(Fps::STORE, 0.1, 41);
            shift(&mut motion, 0..41, [0.0, height, 0.0]);
            motion
        };
        assert_eq!(flags(&lifted(0.3)), FLAG_NO_CONTACT);
        assert_eq!(flags(&lifted(-0.06)), FLAG_FLOOR_PENETRATION);
        let fast = flags(&sliding(Fps::STORE, 15.0, 41));
        assert_eq!(fast, FLAG_FOOT_SKATE | FLAG_FAST);
    }

    #[test]
    fn single_frames_and_teleports_are_rejected_with_numbers() {
        let skeleton = Skeleton::smplx_neutral();
        let rejected = check(&sliding(Fps::STORE, 0.0, 1), &skeleton).expect_err("one frame");
        assert_eq!((rejected.code, rejected.stage), ("E-TOO-SHORT", "check"));
        let rejected = check(&sliding(Fps::STORE, 25.0, 3), &skeleton).expect_err("25 m/s");
        assert_eq!(rejected.code, "E-TELEPORT");
        assert!(rejected.reason.contains("25.0 m/s"), "{}", rejected.reason);
    }

    #[test]
    fn what_jumps_is_kept_or_trimmed_where_that_is_asked_for() {
        let skeleton = Skeleton::smplx_neutral();
        let mut motion = sliding(Fps::STORE, 0.1, 50);
        shift(&mut motion, 20..50, [5.0, 0.0, 0.0]);
        let judge = |teleports| check_with(motion.clone(), &skeleton, teleports, |frame| frame);
        let rejected = judge(Teleports::Quarantine)
            .map(|_| ())
            .expect_err("100 m/s");
        assert_eq!(rejected, check(&motion, &skeleton).expect_err("100 m/s"));
        let (kept, quality, range) = judge(Teleports::Keep).expect("kept");
        assert_eq!((kept.len(), range), (50, None));
        assert!(quality.flags & FLAG_TELEPORT != 0 && quality.max_speed > 99.0);
        let (trimmed, quality, range) = judge(Teleports::Trim).expect("30 frames are left");
        assert_eq!((trimmed.len(), range), (30, Some(20..50)));
        assert!(quality.flags & FLAG_TELEPORT != 0 && quality.max_speed < 0.2);
        assert_eq!(trimmed, motion.crop(20..50).expect("inside"));
    }

    #[test]
    fn a_first_frame_apart_is_found() {
        let skeleton = Skeleton::smplx_neutral();
        let apart = |jumps: &[usize], frames: usize| {
            let mut motion = sliding(Fps::STORE, 0.1, frames);
            for &jump in jumps {
                shift(&mut motion, jump..frames, [5.0, 0.0, 0.0]);
            }
            starts_apart(&motion, &skeleton)
        };
        assert!(apart(&[1], 3) && apart(&[1], 50));
        assert!(!apart(&[1], 2) && !apart(&[], 50));
        assert!(!apart(&[2], 50) && !apart(&[1, 2], 50));
    }

    #[test]
    fn every_flag_has_a_name_and_a_bit_of_its_own() {
        let all = FLAG_NAMES.iter().fold(0u32, |all, (flag, name)| {
            assert_eq!(flag.count_ones(), 1, "{name}");
            assert_eq!(all & flag, 0, "{name}");
            all | flag
        });
        assert_eq!(all.count_ones() as usize, FLAG_NAMES.len());
    }
}
