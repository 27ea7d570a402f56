//! Constants and types of the recipe.

use datasets_spec::record::HUMANML3D_WIDTH;
use glam::DVec3;
use kinematics::skeleton::{NUM_BODY_JOINTS, parent_of};

/// Name and version of the recipe. Any change of its numbers is a new version.
pub const RECIPE: &str = "humanml3d@1";
/// Frame rate of the recipe in 1/s: contacts and smoothing count frames, not seconds.
pub const FPS: f64 = 20.0;

/// Positions of the 22 body joints in metres, y up.
pub type Joints = [DVec3; NUM_BODY_JOINTS];
/// The features of a frame.
pub type Features = [f32; HUMANML3D_WIDTH];

/// Ranges of the feature groups in a frame, by the names used in reports.
pub const GROUPS: [(&str, std::ops::Range<usize>); 7] = [
    ("root yaw velocity", 0..1),
    ("root velocity", 1..3),
    ("root height", 3..4),
    ("joint positions", 4..67),
    ("joint rotations", 67..193),
    ("joint velocities", 193..259),
    ("foot contacts", 259..263),
];

/// Bone lengths of the uniform skeleton in metres, by the joint at the bone's end: those of clip
/// `000021`, frame 0, in the `f32` they were published in. The root has none.
pub const UNIFORM_BONES: [f64; NUM_BODY_JOINTS] = [
    0.0,
    0.103073969,
    0.109883368,
    0.131568238,
    0.393623203,
    0.390188217,
    0.14319022,
    0.432433069,
    0.425643325,
    0.0573647358,
    0.143381819,
    0.149419069,
    0.219360054,
    0.137486771,
    0.143382832,
    0.103039227,
    0.131614044,
    0.12298438,
    0.256839991,
    0.263091743,
    0.266011715,
    0.269876391,
];

/// Rest directions of the bones that end in each joint: unit axes.
pub(super) const REST_AXES: [DVec3; NUM_BODY_JOINTS] = {
    let (left, up, front) = (DVec3::X, DVec3::Y, DVec3::Z);
    let (right, down) = (DVec3::NEG_X, DVec3::NEG_Y);
    [
        DVec3::ZERO,
        left,
        right,
        up,
        down,
        down,
        up,
        down,
        down,
        up,
        front,
        front,
        up,
        left,
        right,
        front,
        down,
        down,
        down,
        down,
        down,
        down,
    ]
};

/// For each joint, the joint that its rotation is relative to: the root if it begins a chain, otherwise its parent.
pub(super) const RELATIVE_TO: [usize; NUM_BODY_JOINTS] = {
    let mut relative_to = [0; NUM_BODY_JOINTS];
    let mut joint = 0;
    while joint < NUM_BODY_JOINTS {
        relative_to[joint] = parent_of(joint);
        joint += 1;
    }
    relative_to[13] = 0;
    relative_to[14] = 0;
    relative_to
};

pub(super) const LEFT_HIP: usize = 1;
pub(super) const RIGHT_HIP: usize = 2;
pub(super) const RIGHT_KNEE: usize = 5;
pub(super) const RIGHT_ANKLE: usize = 8;
pub(super) const LEFT_SHOULDER: usize = 16;
pub(super) const RIGHT_SHOULDER: usize = 17;
/// Left ankle and toe, right ankle and toe, in the order of the contacts.
pub(super) const FEET: [usize; 4] = [7, 10, 8, 11];
/// Squared displacement in m² per frame below which a foot joint is in contact.
pub(super) const CONTACT_THRESHOLD: f64 = 0.002;
/// Length in metres below which a bone has no direction.
pub(super) const SHORTEST_BONE_M: f64 = 1e-8;

/// Error of computing features, or of recovering a motion from them.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FeatureError {
    /// A velocity needs two frames.
    #[error("{frames} frames have no features; at least 2 are needed")]
    TooShort {
        /// Number of frames.
        frames: usize,
    },
    /// A joint has no position, or a bone has no length.
    #[error(
        "joint {} has no finite position or no bone in frame {frame}",
        kinematics::skeleton::JOINT_NAMES[*joint]
    )]
    NoDirection {
        /// Index of the joint.
        joint: usize,
        /// Index of the frame.
        frame: usize,
    },
    /// Recovered features do not give a motion of a body.
    #[error("the joints make no motion: {reason}")]
    NoMotion {
        /// What is wrong.
        reason: String,
    },
}

impl FeatureError {
    pub(crate) fn no_motion(reason: impl ToString) -> Self {
        let reason = reason.to_string();
        Self::NoMotion { reason }
    }
}
