//! Checks on a finished motion: what must be rejected, and what is worth a flag.

use datasets_spec::skeleton::NUM_BODY_JOINTS;
use datasets_spec::table::Quality;
use datasets_spec::{Motion, Skeleton};
use glam::DVec3;

use crate::source::Rejected;

/// A joint is more than 5 cm below the floor.
pub const FLAG_FLOOR_PENETRATION: u32 = 1 << 0;
/// Planted feet slide faster than 0.3 m/s on average.
pub const FLAG_FOOT_SKATE: u32 = 1 << 1;
/// No joint moves by more than a millimetre.
pub const FLAG_CONSTANT_POSE: u32 = 1 << 2;
/// The clip lasts less than a second.
pub const FLAG_VERY_SHORT: u32 = 1 << 3;
/// No foot is ever near the floor.
pub const FLAG_NO_CONTACT: u32 = 1 << 4;
/// A joint moves faster than 12 m/s: possible for the hand of a boxer, more often a jump of the
/// capture.
pub const FLAG_FAST: u32 = 1 << 5;

/// The names of all flags, in the order of their bits.
pub const FLAG_NAMES: [(u32, &str); 6] = [
    (FLAG_FLOOR_PENETRATION, "floor-penetration"),
    (FLAG_FOOT_SKATE, "foot-skate"),
    (FLAG_CONSTANT_POSE, "constant-pose"),
    (FLAG_VERY_SHORT, "very-short"),
    (FLAG_NO_CONTACT, "no-contact"),
    (FLAG_FAST, "fast"),
];

/// Fewest frames of a motion: one frame does not move.
const MIN_FRAMES: usize = 2;
/// Speed of a joint in m/s above which the motion is broken. The fastest human movements, of a
/// pitcher's hand, come near it.
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

/// Judges a motion.
///
/// `max_speed` is the highest speed of any of the 22 body joints. `foot_skate` is the mean
/// horizontal speed of the foot joints, weighted by `2 - 2^(h / 2.5 cm)` with `h` their height, so
/// that a swinging foot that clears the floor closely counts little and one above 2.5 cm not at
/// all. Both are in m/s.
///
/// # Errors
/// `E-TOO-SHORT` for fewer than 2 frames, `E-TELEPORT` for speeds above 20 m/s.
///
/// # Source
/// The weight of foot skate is that of Zhang et al., "Mode-Adaptive Neural Networks for Quadruped
/// Motion Control" (2018).
pub fn check(motion: &Motion, skeleton: &Skeleton) -> Result<Quality, Rejected> {
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
    let joints_of = |frame: usize| -> [DVec3; NUM_BODY_JOINTS] {
        let keypoints = skeleton.keypoints(&motion.pose(frame));
        std::array::from_fn(|joint| keypoints[joint])
    };
    let first = joints_of(0);
    let mut before = first;
    let mut max_speed = 0.0f64;
    let mut fastest = (0, 0);
    let mut max_shift = 0.0f64;
    let mut lowest = first
        .iter()
        .fold(f64::INFINITY, |low, joint| low.min(joint.y));
    let (mut skate_sum, mut weight_sum, mut touches) = (0.0, 0.0, false);
    for frame in 1..motion.len() {
        let joints = joints_of(frame);
        for joint in 0..NUM_BODY_JOINTS {
            let speed = (joints[joint] - before[joint]).length() * fps;
            if speed > max_speed {
                max_speed = speed;
                fastest = (frame, joint);
            }
            max_shift = max_shift.max((joints[joint] - first[joint]).length());
            lowest = lowest.min(joints[joint].y);
        }
        for foot in FEET {
            let height = joints[foot].y.max(before[foot].y).max(0.0);
            let weight = (2.0 - (height / PLANTED_M).exp2()).max(0.0);
            skate_sum += weight * (joints[foot] - before[foot]).with_y(0.0).length() * fps;
            weight_sum += weight;
            touches |= height < CONTACT_M;
        }
        before = joints;
    }
    if max_speed > TELEPORT_SPEED {
        return Err(Rejected::check(
            "E-TELEPORT",
            format!(
                "found {} moving at {max_speed:.1} m/s into frame {}, expected at most \
                 {TELEPORT_SPEED} m/s",
                datasets_spec::skeleton::JOINT_NAMES[fastest.1],
                fastest.0
            ),
        ));
    }
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
    Ok(Quality {
        flags: findings
            .iter()
            .filter(|(_, found)| *found)
            .fold(0, |flags, (flag, _)| flags | flag),
        max_speed: max_speed as f32,
        foot_skate: foot_skate as f32,
    })
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
        check(motion, &Skeleton::smplx_neutral())
            .expect("passes")
            .flags
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
            for frame in 0..motion.len() {
                let [x, y, z] = motion.transl()[frame];
                motion.set_transl(frame, [x, y + height, z]);
            }
            motion
        };
        assert_eq!(flags(&lifted(0.3)), FLAG_NO_CONTACT);
        assert_eq!(flags(&lifted(-0.06)), FLAG_FLOOR_PENETRATION);
        assert_eq!(
            flags(&sliding(Fps::STORE, 15.0, 41)),
            FLAG_FOOT_SKATE | FLAG_FAST
        );
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
    fn every_flag_has_a_name_and_a_bit_of_its_own() {
        let all = FLAG_NAMES.iter().fold(0u32, |all, (flag, name)| {
            assert_eq!(flag.count_ones(), 1, "{name}");
            assert_eq!(all & flag, 0, "{name}");
            all | flag
        });
        assert_eq!(all.count_ones() as usize, FLAG_NAMES.len());
    }
}
