//! Gliding: bodies that move over the ground without walking, and bodies that should move and stay.

use kinematics::KeypointFrame;

use super::definition::{Better, Measure, Metric, Part};

/// Share of the items with locomotion whose edit glides ([`glides`]), in percent. An item has locomotion if the root of
/// its target moves more than [`LEAST_WAY_M`] over the ground.
pub static GLIDING: Metric = Metric {
    name: "Gliding (%)",
    about: "share of the items with locomotion whose root moves while the legs do not: the pelvis gets more than 0.5 m \
            away from where it began, and the ankle that swings more stays within half of the target's swing (diagonal \
            of the box, along and across the hips, in which it stays relative to the pelvis). An item has locomotion \
            if the pelvis of its target gets as far. Real data has 0",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 1,
    measure: Measure::Motion(|sample| {
        let is_locomotion = sample.target.way_m > LEAST_WAY_M;
        is_locomotion.then(|| match glides(sample.keypoints, sample.target.swing_m) {
            true => 100.0,
            false => 0.0,
        })
    }),
};

/// Share of the items with locomotion whose edit stays where it is, in percent. A body that never moves does not glide, so
/// [`GLIDING`] alone would call it perfect.
pub static STAYING: Metric = Metric {
    name: "Staying (%)",
    about: "share of the items with locomotion whose edit has none: its pelvis stays within 0.5 m of where it began. Real \
            data has 0, and so has a body that glides",
    part: Part::Quality,
    better: |_| Better::NearReal,
    decimals: 1,
    measure: Measure::Motion(|sample| {
        let is_locomotion = sample.target.way_m > LEAST_WAY_M;
        is_locomotion.then(|| match way(sample.keypoints) > LEAST_WAY_M {
            true => 0.0,
            false => 100.0,
        })
    }),
};

/// Minimum horizontal distance in metres for a root to count as moving.
pub const LEAST_WAY_M: f64 = 0.5;

/// Share of the target's swing. Ankles that swing less do not count as walking.
const LEAST_SWING: f64 = 0.5;

const PELVIS: usize = 0;
const LEFT_HIP: usize = 1;
const RIGHT_HIP: usize = 2;
/// Keypoints of the left and the right ankle.
const ANKLES: [usize; 2] = [7, 8];

/// Whether the root of a motion moves more than [`LEAST_WAY_M`] while the ankles swing less than half as far as the
/// target's, whose [`swing`] is given.
pub fn glides(motion: &[KeypointFrame], target_swing_m: f64) -> bool {
    way(motion) > LEAST_WAY_M && swing(motion) < LEAST_SWING * target_swing_m
}

/// The largest horizontal distance of the pelvis from its start, in metres.
pub fn way(points: &[KeypointFrame]) -> f64 {
    let Some(first) = points.first() else {
        return 0.0;
    };
    points
        .iter()
        .map(|frame| (frame[PELVIS] - first[PELVIS]).with_y(0.0).length())
        .fold(0.0, f64::max)
}

/// The extent of the ankle's movement over the ground relative to the pelvis, in metres; the larger of the two ankles'.
/// It is the diagonal of the box, aligned with the line of the hips, that contains the movement.
pub fn swing(points: &[KeypointFrame]) -> f64 {
    let swing_of = |ankle: usize| {
        let (mut least, mut most) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for frame in points {
            let across = (frame[LEFT_HIP] - frame[RIGHT_HIP]).with_y(0.0);
            let Some(across) = across.try_normalize() else {
                continue;
            };
            let along = across.cross(glam::DVec3::Y);
            let offset = frame[ankle] - frame[PELVIS];
            for (axis, place) in [offset.dot(along), offset.dot(across)]
                .into_iter()
                .enumerate()
            {
                least[axis] = least[axis].min(place);
                most[axis] = most[axis].max(place);
            }
        }
        let ranges = [0, 1].map(|axis| (most[axis] - least[axis]).max(0.0));
        ranges[0].hypot(ranges[1])
    };
    ANKLES.map(swing_of).into_iter().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Pose, Skeleton};
    use glam::{DQuat, DVec3};

    use super::*;

    /// A body that moves forwards by `speed` metres per frame, facing `turn` radians from +z. Its left ankle swings
    /// forwards and backwards by `reach` metres.
    fn walking(speed: f64, reach: f64, turn: f64) -> Vec<KeypointFrame> {
        let rest = Skeleton::smplx_neutral().keypoints(&Pose::REST);
        let turn = DQuat::from_rotation_y(turn);
        (0..40)
            .map(|frame| {
                let mut points = rest;
                let phase = f64::from(frame) * std::f64::consts::FRAC_PI_2;
                points[ANKLES[0]].z += reach * phase.sin();
                let way = DVec3::new(0.0, 0.0, speed * f64::from(frame));
                points.map(|point| turn * (point + way))
            })
            .collect()
    }

    #[test]
    fn way_and_swing_have_their_lengths_wherever_the_body_faces() {
        for turn in [0.0, 0.7, 3.0] {
            let points = walking(0.05, 0.2, turn);
            assert!((way(&points) - 39.0 * 0.05).abs() < 1e-12);
            assert!((swing(&points) - 0.4).abs() < 1e-12);
        }
        assert_eq!((way(&[]), swing(&[])), (0.0, 0.0));
    }

    #[test]
    fn a_body_glides_if_it_moves_with_less_than_half_the_swing() {
        let target = walking(0.05, 0.2, 0.0);
        for (speed, reach, expected) in [
            (0.05, 0.2, false),
            (0.05, 0.101, false),
            (0.05, 0.099, true),
            (0.05, 0.0, true),
            // At the lower speed the body stays within half a metre.
            (0.0128, 0.0, false),
            (0.0129, 0.0, true),
        ] {
            let found = glides(&walking(speed, reach, 1.0), swing(&target));
            assert_eq!(found, expected, "{speed} {reach}");
        }
    }
}
