//! The T-pose of the SOMA rig, in which BONES-SEED and Kimodo write BVH.
//!
//! A bone of the rig lies along x in the frame of its joint, so a file's zero pose is not a person's. This module
//! states the orientation of every body joint of a person standing with the arms out. Bone lengths come from the file,
//! because they differ between actors (`soma_proportional`).
//!
//! # Source
//! Repository nv-tlabs/kimodo at 7330e7e: joint names of `SOMASkeleton77`, and the global rotations in
//! `standard_t_pose_global_offsets_rots.p`, here as angles in degrees that agree with them to 0.1 degrees.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DQuat, DVec3};

use super::hierarchy::BvhJoint;
use crate::retarget::{Placed, bare};

/// Joints of the trunk and of the legs, with the angle of their x axis from up to the front. Their z axis
/// points to the left.
const UPRIGHT: [(&str, f64); 15] = [
    ("Hips", -0.19),
    ("Spine1", -0.24),
    ("Spine2", -6.17),
    ("Chest", -0.2),
    ("Neck1", 16.63),
    ("Neck2", 17.68),
    ("Head", -6.75),
    ("LeftLeg", -178.94),
    ("LeftShin", -175.28),
    ("LeftFoot", 110.93),
    ("LeftToeBase", 106.2),
    ("RightLeg", 1.06),
    ("RightShin", 4.72),
    ("RightFoot", -69.07),
    ("RightToeBase", -73.8),
];

/// Joints of an arm without their side, with the angle of their x axis from left to the front, and the turn
/// about it. Their y axis points to the front on the left side, and back on the right side.
const ARM: [(&str, f64, f64); 4] = [
    ("Shoulder", -20.24, 0.0),
    ("Arm", 0.0, 0.0),
    ("ForeArm", 0.0, 0.0),
    ("Hand", 0.0, 9.71),
];

/// Orientation of a joint in the T-pose, with y up and the person facing +z; `None` for joints that the pose does not
/// state.
pub(super) fn orientation(name: &str) -> Option<DQuat> {
    let name = bare(name);
    let upright = UPRIGHT.iter().find(|(joint, _)| *joint == name);
    if let Some((_, pitch)) = upright {
        let frame = DQuat::from_mat3(&DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X));
        return Some(frame * DQuat::from_rotation_z(pitch.to_radians()));
    }
    let (front, part) = match (name.strip_prefix("Left"), name.strip_prefix("Right")) {
        (Some(part), _) => (FRAC_PI_2, part),
        (_, Some(part)) => (-FRAC_PI_2, part),
        _ => return None,
    };
    let (_, yaw, roll) = ARM.iter().find(|(joint, ..)| *joint == part)?;
    let turn = DQuat::from_rotation_z(yaw.to_radians()) * DQuat::from_rotation_x(roll.to_radians());
    Some(DQuat::from_rotation_x(front) * turn)
}

/// Whether the joints include all those that the T-pose states.
pub(super) fn is_soma(joints: &[BvhJoint]) -> bool {
    let has = |name: &str| joints.iter().any(|joint| bare(&joint.name) == name);
    let arms = ["Left", "Right"]
        .into_iter()
        .flat_map(|side| ARM.map(|(part, ..)| format!("{side}{part}")));
    UPRIGHT.iter().all(|(name, _)| has(name)) && arms.into_iter().all(|name| has(&name))
}

/// Every joint in the T-pose; `None` for another rig. Joints that the pose does not state, such as fingers, follow
/// their parents.
pub(super) fn t_pose(joints: &[BvhJoint]) -> Option<Vec<Placed>> {
    if !is_soma(joints) {
        return None;
    }
    let mut placed: Vec<Placed> = Vec::with_capacity(joints.len());
    for joint in joints {
        let above = joint.parent.map_or(Placed::ORIGIN, |parent| placed[parent]);
        placed.push(Placed {
            position: above.position + above.rotation * joint.offset,
            rotation: orientation(&joint.name).unwrap_or(above.rotation),
        });
    }
    Some(placed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// First and second column of published rotations.
    const PUBLISHED: [(&str, [f64; 3], [f64; 3]); 12] = [
        ("Hips", [0.0, 1.0, -0.0033], [0.0, 0.0033, 1.0]),
        ("Spine2", [0.0, 0.9942, -0.1074], [0.0, 0.1074, 0.9942]),
        ("Neck1", [0.0, 0.9582, 0.2862], [0.0, -0.2862, 0.9582]),
        ("Head", [0.0, 0.9931, -0.1175], [0.0, 0.1175, 0.9931]),
        ("LeftShoulder", [0.9382, 0.0, -0.346], [0.346, 0.0, 0.9382]),
        ("RightShoulder", [0.9382, 0.0, 0.346], [0.346, 0.0, -0.9382]),
        ("LeftArm", [1.0, 0.0, -0.0001], [0.0001, 0.0, 1.0]),
        ("LeftHand", [1.0, 0.0, 0.0001], [-0.0001, -0.1687, 0.9857]),
        ("RightHand", [1.0, 0.0, -0.0001], [-0.0001, 0.1687, -0.9857]),
        ("LeftLeg", [0.0, -0.9998, -0.0186], [0.0, 0.0186, -0.9998]),
        ("RightFoot", [0.0, 0.3572, -0.934], [0.0, 0.934, 0.3572]),
        (
            "LeftToeBase",
            [-0.0014, -0.2789, 0.9603],
            [0.0004, -0.9603, -0.2789],
        ),
    ];

    #[test]
    fn the_t_pose_is_the_published_one() {
        for (name, x, y) in PUBLISHED {
            let found = orientation(name).expect(name);
            for (axis, expected) in [(DVec3::X, x), (DVec3::Y, y)] {
                let apart = (found * axis).distance(DVec3::from_array(expected));
                assert!(apart < 2e-3, "{name}: {apart}");
            }
        }
        for unstated in ["Root", "LeftHandIndex1", "Jaw", "LeftToeEnd"] {
            assert_eq!(orientation(unstated), None, "{unstated}");
        }
    }
}
