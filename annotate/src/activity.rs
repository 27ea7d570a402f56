//! Activity of body parts, and the distance of two motions by part.

use datasets_spec::{BodyPart, Joint, Motion, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation::yaw;
use kinematics::skeleton::NUM_BODY_JOINTS;

use crate::body::{NUM_RELEASE_PARTS, RELEASE_PARTS};

/// A part is suggested if it is active in more than this share of the frames.
const SUGGESTED_SHARE: f64 = 0.2;
/// Speed, as a multiple of the reference speed, above which a part is active.
const ACTIVE: f32 = 0.4;
/// The chest (SMPL-X spine3), in whose frame the arms are measured.
const CHEST: usize = 9;

/// Joints whose speed counts as movement of the part. Pelvis, spine1, spine3 and collars are excluded: they move
/// with other parts or barely.
fn moving_joints(part: BodyPart) -> Vec<usize> {
    let without = [0, 3, 9, 13, 14];
    part.mask()
        .hard()
        .iter()
        .map(Joint::index)
        .filter(|joint| !without.contains(joint))
        .collect()
}

/// Positions of the joints of the body.
type Joints = [DVec3; NUM_BODY_JOINTS];

/// Positions in each frame: of arm joints relative to the chest, and of other joints relative to the pelvis and its
/// heading. Movement of the root or the spine therefore does not count as movement of the arms.
fn carried(motion: &Motion, skeleton: &Skeleton) -> Vec<Joints> {
    motion
        .poses()
        .iter()
        .map(|pose| {
            let points = skeleton.keypoints(pose);
            let global = skeleton.global_rotations(pose);
            let heading = DQuat::from_rotation_y(-yaw(DMat3::from_quat(pose.rotations[0])));
            let chest = global[CHEST].inverse();
            std::array::from_fn(|joint| {
                if (16..22).contains(&joint) {
                    chest * (points[joint] - points[CHEST])
                } else {
                    heading * (points[joint] - points[0])
                }
            })
        })
        .collect()
}

/// Mean distance of the given joints between two poses.
fn apart(a: &Joints, b: &Joints, joints: &[usize]) -> f64 {
    let sum: f64 = joints
        .iter()
        .map(|&joint| a[joint].distance(b[joint]))
        .sum();
    sum / joints.len() as f64
}

/// Mean speed of the joints of each part in m/s, frame by frame; the first frame has the speed of the second.
pub(crate) fn part_speeds(motion: &Motion, skeleton: &Skeleton) -> [Vec<f64>; NUM_RELEASE_PARTS] {
    let carried = carried(motion, skeleton);
    let fps = motion.fps().get();
    RELEASE_PARTS.map(|part| {
        let joints = moving_joints(part);
        let steps = carried.windows(2);
        let mut speeds: Vec<f64> = steps
            .map(|pair| apart(&pair[0], &pair[1], &joints) * fps)
            .collect();
        speeds.insert(0, speeds.first().copied().unwrap_or(0.0));
        speeds
    })
}

/// Speed of each release part divided by its reference speed, `[5][T]`.
pub(crate) fn heat(
    motion: &Motion,
    skeleton: &Skeleton,
    reference: &[f64; NUM_RELEASE_PARTS],
) -> [Vec<f32>; NUM_RELEASE_PARTS] {
    let speeds = part_speeds(motion, skeleton);
    std::array::from_fn(|part| {
        let speeds = speeds[part].iter();
        speeds
            .map(|speed| (speed / reference[part]) as f32)
            .collect()
    })
}

/// The arms and the lower body, if active in more than [`SUGGESTED_SHARE`] of the frames. Two active arms are one part.
pub(crate) fn active_parts(heat: &[Vec<f32>; NUM_RELEASE_PARTS]) -> Vec<BodyPart> {
    let active = |part: usize| {
        let busy = heat[part].iter().filter(|&&value| value > ACTIVE).count();
        busy as f64 > SUGGESTED_SHARE * heat[part].len() as f64
    };
    let [_, lower, _, left, right] = std::array::from_fn(active);
    let arms = match (left, right) {
        (true, true) => Some(BodyPart::BothArms),
        (true, false) => Some(BodyPart::LeftArm),
        (false, true) => Some(BodyPart::RightArm),
        (false, false) => None,
    };
    let legs = lower.then_some(BodyPart::LowerBody);
    arms.into_iter().chain(legs).collect()
}

/// Distance of two motions in metres: of the root, then of each release part. `[6][T]`, over the frames of the shorter
/// motion.
pub(crate) fn difference(source: &Motion, target: &Motion, skeleton: &Skeleton) -> Vec<Vec<f32>> {
    let frames = source.len().min(target.len());
    let relative = |motion: &Motion| -> Vec<(DVec3, Joints)> {
        (0..frames)
            .map(|frame| {
                let pose = motion.pose(frame);
                let points = skeleton.keypoints(&pose);
                let heading = DQuat::from_rotation_y(-yaw(DMat3::from_quat(pose.rotations[0])));
                (
                    points[0],
                    std::array::from_fn(|joint| heading * (points[joint] - points[0])),
                )
            })
            .collect()
    };
    let (a, b) = (relative(source), relative(target));
    // Takes may start at different places, so the first roots are moved together horizontally.
    let offset = DVec3::new(a[0].0.x - b[0].0.x, 0.0, a[0].0.z - b[0].0.z);
    let root = (0..frames)
        .map(|frame| a[frame].0.distance(b[frame].0 + offset) as f32)
        .collect();
    let mut rows = vec![root];
    for part in RELEASE_PARTS {
        let joints: Vec<usize> = part.mask().hard().iter().map(Joint::index).collect();
        let of_part = (0..frames).map(|frame| apart(&a[frame].1, &b[frame].1, &joints) as f32);
        rows.push(of_part.collect());
    }
    rows
}

#[cfg(test)]
pub(crate) mod tests {
    use datasets_spec::{Fps, Pose};
    use kinematics::rotation::from_axis_angle;

    use super::*;

    /// A motion of 60 frames: `joints` swing while the body walks and turns by `turn` radians per second.
    pub(crate) fn moving(joints: &[usize], turn: f64) -> Motion {
        let poses: Vec<Pose> = (0..60)
            .map(|frame| {
                let time = f64::from(frame) / 20.0;
                let angle = 0.8 * (time * std::f64::consts::TAU).sin();
                let mut pose = Pose::REST;
                pose.transl = DVec3::new(time, 0.0, 1.3 * time);
                pose.rotations[0] = DQuat::from_rotation_y(turn * time);
                for &joint in joints {
                    pose.rotations[joint] = from_axis_angle(DVec3::new(angle, 0.0, angle));
                }
                pose
            })
            .collect();
        Motion::from_poses(Fps::STORE, &poses).expect("finite")
    }

    fn highest(row: &[f32]) -> f32 {
        row.iter().copied().fold(0.0, f32::max)
    }

    fn lit(motion: &Motion) -> Vec<&'static str> {
        let skeleton = Skeleton::smplx_neutral();
        let rows = heat(motion, &skeleton, &[0.5; NUM_RELEASE_PARTS]);
        let parts = RELEASE_PARTS.iter().zip(&rows);
        let lit = parts.filter(|(_, row)| highest(row) > 0.9);
        lit.map(|(part, _)| part.name()).collect()
    }

    #[test]
    fn one_arm_lights_its_rows_and_a_turning_walk_none() {
        assert_eq!(lit(&moving(&[], 2.0)), Vec::<&str>::new());
        assert_eq!(lit(&moving(&[1, 2], 2.0)), ["LOWER_BODY"]);
        for (joint, turn, bright, dark) in [
            (16, 2.0, &["LEFT_ARM"][..], ["RIGHT_ARM", "LOWER_BODY"]),
            // Arms that are only carried by the spine are not active.
            (3, 0.0, &[], ["LEFT_ARM", "RIGHT_ARM"]),
        ] {
            let found = lit(&moving(&[joint], turn));
            assert!(bright.iter().all(|part| found.contains(part)), "{found:?}");
            assert!(!dark.iter().any(|part| found.contains(part)), "{found:?}");
        }
    }

    #[test]
    fn active_parts_name_what_moves() {
        let skeleton = Skeleton::smplx_neutral();
        for (joints, expected) in [
            (&[][..], &[][..]),
            (&[17], &["RIGHT_ARM"]),
            (&[16, 17, 1, 2], &["BOTH_ARMS", "LOWER_BODY"]),
        ] {
            let motion = moving(joints, 1.0);
            let rows = heat(&motion, &skeleton, &[1.0; NUM_RELEASE_PARTS]);
            let parts = active_parts(&rows).into_iter().map(BodyPart::name);
            assert_eq!(Vec::from_iter(parts), expected);
        }
    }

    #[test]
    fn motions_differ_in_the_rows_of_what_moves_and_not_by_their_place_in_the_room() {
        let (still, waving) = (moving(&[], 1.0), moving(&[18], 1.0));
        let skeleton = Skeleton::smplx_neutral();
        let none = difference(&still, &still, &skeleton);
        assert_eq!((none.len(), none[0].len()), (6, 60));
        assert!(none.iter().flatten().all(|apart| *apart < 1e-6));
        let rows = difference(&still, &waving, &skeleton);
        let most: Vec<f32> = rows.iter().map(|row| highest(row)).collect();
        assert!(most[4] > 0.05, "{most:?}");
        assert!([0, 2, 5].iter().all(|&row| most[row] < 1e-6), "{most:?}");
        let here = moving(&[16], 1.0);
        let mut there = here.clone();
        for frame in 0..there.len() {
            let [x, y, z] = there.transl()[frame];
            there.set_transl(frame, [x + 3.0, y, z - 2.0]);
        }
        let rows = difference(&here, &there, &skeleton);
        assert!(rows.iter().flatten().all(|apart| *apart < 1e-5));
    }
}
