//! One frame of a motion.

use glam::{DQuat, DVec3};

use crate::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS};

/// Numbers of `body_pose` in a frame: 21 joints times 3.
pub const BODY_POSE_WIDTH: usize = 3 * (NUM_BODY_JOINTS - 1);

/// The numbers of a frame of a [`Motion`](crate::Motion): translation in metres, root orientation and body rotations as
/// axis-angle in radians.
pub type StoredFrame = [f32; 6 + BODY_POSE_WIDTH];

/// The 28 keypoints of one frame, in metres.
pub type KeypointFrame = [DVec3; NUM_KEYPOINTS];

/// One frame of a motion in working precision, `f64`. The rotation of the pelvis is `global_orient`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Translation of the body in metres.
    pub transl: DVec3,
    /// Rotation of each body joint relative to its parent, `[22]`.
    pub rotations: [DQuat; NUM_BODY_JOINTS],
}

impl Pose {
    /// The T-pose at the model's origin.
    pub const REST: Pose = Pose {
        transl: DVec3::ZERO,
        rotations: [DQuat::IDENTITY; NUM_BODY_JOINTS],
    };
}
