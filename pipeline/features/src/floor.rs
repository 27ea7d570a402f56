//! Puts motions on the floor: its height differs between files, and is y = 0 in the store.

use datasets_spec::quantile::quantile;
use datasets_spec::{Fps, Pose, Skeleton};
use glam::DVec3;
use kinematics::skeleton::NUM_BODY_JOINTS;

/// The joints that touch the floor: both ankles and both feet.
pub const FOOT_JOINTS: [usize; 4] = [7, 8, 10, 11];

/// Fraction of frames whose lowest foot joint may lie below the floor. With the minimum instead, one bad
/// frame would lift the whole clip off the floor.
const FLOOR_PERCENTILE: f64 = 0.02;

/// Height in metres above the floor, and speed in m/s, below which a foot joint touches the floor.
const CONTACT_HEIGHT_M: f64 = 0.05;
const CONTACT_SPEED: f64 = 0.5;
/// Height in metres above the file's own zero from which the floor of a clip without contact makes the clip airborne.
const AIRBORNE_HEIGHT_M: f64 = 0.3;

/// Shifts a motion vertically so that the floor is at y = 0, and returns the shift in metres.
///
/// The floor is the 2nd percentile, over the frames, of the height of the lowest ankle or foot joint. A clip of several
/// frames counts as airborne and is not moved if no such joint is slower than 0.5 m/s within 5 cm of that floor, and
/// the floor would be more than 0.3 m above the file's own zero.
pub fn put_on_floor(poses: &mut [Pose], fps: Fps, skeleton: &Skeleton) -> f64 {
    let feet: Vec<[DVec3; 4]> = skeleton
        .points_of_poses::<NUM_BODY_JOINTS>(poses)
        .iter()
        .map(|joints| FOOT_JOINTS.map(|joint| joints[joint]))
        .collect();
    let shift = shift(&feet, fps);
    for pose in poses {
        pose.transl.y += shift;
    }
    shift
}

/// The vertical shift in metres that puts the floor at y = 0, from the positions of both ankles and
/// both feet in every frame, by the rule of [`put_on_floor`].
pub fn shift(feet: &[[DVec3; FOOT_JOINTS.len()]], fps: Fps) -> f64 {
    let mut lowest: Vec<f64> = feet
        .iter()
        .map(|frame| frame.iter().fold(f64::INFINITY, |low, p| low.min(p.y)))
        .collect();
    let Some(floor) = quantile(&mut lowest, FLOOR_PERCENTILE) else {
        return 0.0;
    };
    let touches = feet.windows(2).any(|pair| {
        (0..FOOT_JOINTS.len()).any(|foot| {
            pair[0][foot].y < floor + CONTACT_HEIGHT_M
                && (pair[1][foot] - pair[0][foot]).length() * fps.get() < CONTACT_SPEED
        })
    });
    if !touches && feet.len() > 1 && floor > AIRBORNE_HEIGHT_M {
        return 0.0;
    }
    -floor
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standing(height: f64, frames: usize) -> Vec<Pose> {
        vec![
            Pose {
                transl: DVec3::Y * height,
                ..Pose::REST
            };
            frames
        ]
    }

    #[test]
    fn a_standing_body_ends_on_the_floor() {
        let skeleton = Skeleton::smplx_neutral();
        let mut poses = standing(5.0, 10);
        let shift = put_on_floor(&mut poses, Fps::STORE, &skeleton);
        // The right foot is the lowest joint.
        assert!((shift - (1.286751747 - 5.0)).abs() < 1e-9);
        assert!(skeleton.keypoints(&poses[0])[11].y.abs() < 1e-12);
    }

    #[test]
    fn one_low_frame_does_not_set_the_floor_and_flight_is_left_in_the_air() {
        let skeleton = Skeleton::smplx_neutral();
        let mut poses = standing(2.0, 100);
        poses[50].transl.y = 1.0;
        put_on_floor(&mut poses, Fps::STORE, &skeleton);
        assert!(skeleton.keypoints(&poses[0])[11].y.abs() < 1e-12);

        let mut flight: Vec<Pose> = (0..20)
            .map(|frame| Pose {
                transl: DVec3::new(0.0, 3.0, 0.2 * f64::from(frame)),
                ..Pose::REST
            })
            .collect();
        assert_eq!(put_on_floor(&mut flight, Fps::STORE, &skeleton), 0.0);
    }
}
