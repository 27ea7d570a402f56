//! The SMPL-X skeleton: joint names, parents, rest positions and the point sets used by the paper.

use std::str::FromStr;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::Error;

/// Joints of the SMPL-X kinematic tree.
pub const NUM_JOINTS: usize = 55;
/// Joints driven by `global_orient` and `body_pose`.
pub const NUM_BODY_JOINTS: usize = 22;
/// Points of the paper's keypoint set (App. B.1).
pub const NUM_KEYPOINTS: usize = 28;

/// Parent of each SMPL-X joint; the root's is -1. Every parent precedes its children.
pub const PARENTS: [i8; NUM_JOINTS] = [
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15, 20, 25,
    26, 20, 28, 29, 20, 31, 32, 20, 34, 35, 20, 37, 38, 21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49,
    50, 21, 52, 53,
];

/// The SMPL-X joints that are the 28 keypoints, in keypoint order: the 22 body joints, both eyes,
/// and the index and ring knuckles of the left, then of the right hand. The paper calls the last
/// four fingertips (App. B.1), but the listed joints are the first finger joints. All 28 depend on
/// the 22 body rotations alone.
pub const KEYPOINT_JOINTS: [usize; NUM_KEYPOINTS] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 23, 24, 25, 34,
    40, 49,
];

/// Parent of each keypoint within the keypoint set; the root's is -1. The parent joint of every
/// keypoint is one of the first 22, whose places in both lists are the same.
pub const KEYPOINT_PARENTS: [i8; NUM_KEYPOINTS] = {
    let mut parents = [0; NUM_KEYPOINTS];
    let mut slot = 0;
    while slot < NUM_KEYPOINTS {
        parents[slot] = PARENTS[KEYPOINT_JOINTS[slot]];
        slot += 1;
    }
    parents
};

/// Mirror image of each keypoint; a keypoint on the midline is its own.
pub const MIRRORED_KEYPOINTS: [usize; NUM_KEYPOINTS] = [
    0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22, 26, 27,
    24, 25,
];

/// Parent of a keypoint; the pelvis is its own parent. For the first 22 keypoints it is the parent of the body joint.
///
/// # Panics
/// If `slot` is not below [`NUM_KEYPOINTS`].
pub const fn parent_of(slot: usize) -> usize {
    if KEYPOINT_PARENTS[slot] < 0 {
        0
    } else {
        KEYPOINT_PARENTS[slot] as usize
    }
}

/// The keypoints of the 24 joints that the released code fits: the body joints and the two index knuckles.
pub const FIT_KEYPOINTS: [usize; 24] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 24, 26,
];

/// Names of the SMPL-X joints after the body joints, in order.
const OTHER_NAMES: [&str; NUM_JOINTS - NUM_BODY_JOINTS] = [
    "jaw",
    "left_eye_smplhf",
    "right_eye_smplhf",
    "left_index1",
    "left_index2",
    "left_index3",
    "left_middle1",
    "left_middle2",
    "left_middle3",
    "left_pinky1",
    "left_pinky2",
    "left_pinky3",
    "left_ring1",
    "left_ring2",
    "left_ring3",
    "left_thumb1",
    "left_thumb2",
    "left_thumb3",
    "right_index1",
    "right_index2",
    "right_index3",
    "right_middle1",
    "right_middle2",
    "right_middle3",
    "right_pinky1",
    "right_pinky2",
    "right_pinky3",
    "right_ring1",
    "right_ring2",
    "right_ring3",
    "right_thumb1",
    "right_thumb2",
    "right_thumb3",
];

/// Names of all SMPL-X joints, in order.
pub const JOINT_NAMES: [&str; NUM_JOINTS] = {
    let mut names = [""; NUM_JOINTS];
    let mut joint = 0;
    while joint < NUM_JOINTS {
        names[joint] = if joint < NUM_BODY_JOINTS {
            Joint::ALL[joint].name()
        } else {
            OTHER_NAMES[joint - NUM_BODY_JOINTS]
        };
        joint += 1;
    }
    names
};

/// Rest positions of the neutral SMPL-X body, betas zero, in metres (y up, +x the body's left, +z
/// forward). Derived from the SMPL-X model of the Max Planck Institute (non-commercial research
/// licence of its authors); a user's own model file takes precedence where one is given.
#[rustfmt::skip]
const SMPLX_NEUTRAL_REST: [[f64; 3]; NUM_JOINTS] = [
    [0.003123260569, -0.3514074683, 0.01203655079],
    [0.06131265312, -0.4441709518, -0.01396463532],
    [-0.06014421582, -0.4553154707, -0.0092138201],
    [0.0003605620586, -0.2415168583, -0.01558108069],
    [0.1160081103, -0.8229243755, -0.02336069942],
    [-0.1043541729, -0.8176955581, -0.02603770234],
    [0.009808260947, -0.1096636057, -0.02152106538],
    [0.07255466282, -1.225983858, -0.05523664504],
    [-0.08893736452, -1.228423357, -0.04622997344],
    [-0.001522152917, -0.05742844939, 0.006925832015],
    [0.119811967, -1.283981204, 0.06297968328],
    [-0.1277497709, -1.286751747, 0.07281902432],
    [-0.01368661132, 0.1077386066, -0.02468951046],
    [0.04484200478, 0.02751527354, -0.0002946509048],
    [-0.04921707883, 0.02691022307, -0.006474069785],
    [0.01109687332, 0.2681904137, -0.003952245228],
    [0.164081037, 0.0852432996, -0.01575559005],
    [-0.151794821, 0.08043467253, -0.01914259791],
    [0.4182038903, 0.01309278142, -0.05821444467],
    [-0.4229443669, 0.04394219071, -0.0456096828],
    [0.6701906323, 0.03631401062, -0.06068652496],
    [-0.6722118258, 0.0394096449, -0.06093486771],
    [-0.004667762667, 0.267670691, -0.009591402486],
    [0.03159928322, 0.310832113, 0.0621951744],
    [-0.03159987554, 0.3108319342, 0.06219434366],
    [0.7720924616, 0.02762586996, -0.04133538902],
    [0.8040408492, 0.02984413132, -0.03832494467],
    [0.8265857697, 0.02749405056, -0.0382703729],
    [0.7795881629, 0.02998634242, -0.06466733664],
    [0.8101993799, 0.03079374321, -0.06868999451],
    [0.8337147832, 0.02878499404, -0.07280422002],
    [0.754237473, 0.02177468129, -0.1044361368],
    [0.7697082162, 0.02064310014, -0.1164355725],
    [0.7852417231, 0.0189785324, -0.1276525259],
    [0.7676349282, 0.02704637684, -0.08803117275],
    [0.795681715, 0.02853183635, -0.09329714626],
    [0.818503499, 0.02707355097, -0.1003914326],
    [0.7108263969, 0.01833728515, -0.03507564589],
    [0.7278420925, 0.01931309886, -0.01009750552],
    [0.7483652234, 0.01415354386, 0.005425570998],
    [-0.772092402, 0.02762678079, -0.04133493081],
    [-0.8040405512, 0.02984467335, -0.03832409531],
    [-0.8265854716, 0.02749528736, -0.03826868534],
    [-0.7795882225, 0.02998769842, -0.06466869265],
    [-0.8101993799, 0.03079517186, -0.06869153678],
    [-0.8337149024, 0.02878585272, -0.07280556113],
    [-0.7542385459, 0.02177520655, -0.1044378057],
    [-0.7697089911, 0.02064313367, -0.1164365485],
    [-0.7852423787, 0.01897839829, -0.1276528388],
    [-0.7676352859, 0.02704770304, -0.08803359419],
    [-0.795681715, 0.02853290737, -0.09329950064],
    [-0.8185037374, 0.02707411721, -0.1003922448],
    [-0.7108249664, 0.01833522134, -0.03507352248],
    [-0.7278403044, 0.01931131817, -0.01009594277],
    [-0.7483659387, 0.01415411662, 0.005425604992],
];

crate::named! {
    /// One of the 22 SMPL-X body joints, in SMPL-X order.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    #[expect(missing_docs, reason = "the names are the documentation")]
    #[repr(u8)]
    pub enum Joint, named by name {
        Pelvis = "pelvis",
        LeftHip = "left_hip",
        RightHip = "right_hip",
        Spine1 = "spine1",
        LeftKnee = "left_knee",
        RightKnee = "right_knee",
        Spine2 = "spine2",
        LeftAnkle = "left_ankle",
        RightAnkle = "right_ankle",
        Spine3 = "spine3",
        LeftFoot = "left_foot",
        RightFoot = "right_foot",
        Neck = "neck",
        LeftCollar = "left_collar",
        RightCollar = "right_collar",
        Head = "head",
        LeftShoulder = "left_shoulder",
        RightShoulder = "right_shoulder",
        LeftElbow = "left_elbow",
        RightElbow = "right_elbow",
        LeftWrist = "left_wrist",
        RightWrist = "right_wrist",
    }
}

impl Joint {
    /// Position in the SMPL-X joint list.
    pub fn index(self) -> usize {
        self as usize
    }

    /// The parent of the joint; `None` for the pelvis.
    pub fn parent(self) -> Option<Joint> {
        usize::try_from(PARENTS[self.index()])
            .ok()
            .map(|index| Self::ALL[index])
    }

    /// The same joint on the other side of the body; a joint on the midline is returned unchanged.
    pub fn mirrored(self) -> Joint {
        let name = self.name();
        let other = if let Some(rest) = name.strip_prefix("left_") {
            format!("right_{rest}")
        } else if let Some(rest) = name.strip_prefix("right_") {
            format!("left_{rest}")
        } else {
            return self;
        };
        Self::from_str(&other).unwrap_or(self)
    }
}

impl FromStr for Joint {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        Self::of_name(text).ok_or_else(|| {
            Error(format!(
                "unknown joint {text:?}; SMPL-X body joints are named pelvis, left_hip, ... right_wrist"
            ))
        })
    }
}

/// A body at rest: where each SMPL-X joint is in the T-pose. One dataset uses one skeleton, which
/// its manifest names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Skeleton {
    name: String,
    #[serde(deserialize_with = "every_joint")]
    rest_joints: Vec<DVec3>,
}

fn every_joint<'de, D: serde::Deserializer<'de>>(source: D) -> Result<Vec<DVec3>, D::Error> {
    let joints = Vec::deserialize(source)?;
    if joints.len() == NUM_JOINTS {
        return Ok(joints);
    }
    let found = joints.len();
    Err(serde::de::Error::invalid_length(found, &"55 joints"))
}

impl Default for Skeleton {
    fn default() -> Self {
        Self::smplx_neutral()
    }
}

impl Skeleton {
    /// The built-in neutral SMPL-X body, betas zero.
    pub fn smplx_neutral() -> Self {
        Self {
            name: "smplx-neutral".to_owned(),
            rest_joints: SMPLX_NEUTRAL_REST.map(DVec3::from_array).to_vec(),
        }
    }

    /// A skeleton with the SMPL-X tree and the given rest positions in metres `[55]`.
    pub fn new(name: impl Into<String>, rest_joints: [DVec3; NUM_JOINTS]) -> Self {
        Self {
            name: name.into(),
            rest_joints: rest_joints.to_vec(),
        }
    }

    /// The name recorded with every motion.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// BLAKE3 of the rest positions, in hexadecimal. It identifies a body whatever its name.
    pub fn hash(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        for value in self.rest_joints.iter().flat_map(|joint| joint.to_array()) {
            hasher.update(&value.to_le_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Rest position of a SMPL-X joint in metres.
    ///
    /// # Panics
    /// If `joint_index` is not below [`NUM_JOINTS`].
    pub fn rest(&self, joint_index: usize) -> DVec3 {
        self.rest_joints[joint_index]
    }

    /// Rest position of a SMPL-X joint relative to its parent; for the root, its rest position.
    ///
    /// # Panics
    /// If `joint_index` is not below [`NUM_JOINTS`].
    pub fn offset(&self, joint_index: usize) -> DVec3 {
        match usize::try_from(PARENTS[joint_index]) {
            Ok(parent) => self.rest_joints[joint_index] - self.rest_joints[parent],
            Err(_) => self.rest_joints[joint_index],
        }
    }

    /// Pelvis, left hip and right hip at rest, relative to the pelvis: the triangle that aligns windows
    /// ([`crate::canonical::Stitcher`]).
    pub fn rest_triangle(&self) -> [DVec3; 3] {
        [DVec3::ZERO, self.offset(1), self.offset(2)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_parent_precedes_its_child() {
        for parents in [&PARENTS[..], &KEYPOINT_PARENTS] {
            for (child, &parent) in parents.iter().enumerate() {
                assert!(i64::from(parent) < child as i64);
            }
        }
    }

    #[test]
    fn keypoint_parents_agree_with_the_joint_tree() {
        for (slot, &joint) in KEYPOINT_JOINTS.iter().enumerate() {
            let parent = usize::try_from(KEYPOINT_PARENTS[slot]).map(|slot| KEYPOINT_JOINTS[slot]);
            assert_eq!(parent.ok(), usize::try_from(PARENTS[joint]).ok());
        }
    }

    #[test]
    fn names_are_unique_and_mirroring_is_an_involution() {
        for joint in Joint::ALL {
            assert_eq!(joint.name().parse::<Joint>().ok(), Some(joint));
            assert_eq!(joint.mirrored().mirrored(), joint);
        }
        assert_eq!(Joint::LeftKnee.mirrored(), Joint::RightKnee);
        assert_eq!(Joint::Spine2.mirrored(), Joint::Spine2);
    }

    #[test]
    fn the_neutral_body_stands_as_the_published_table_says() {
        let skeleton = Skeleton::smplx_neutral();
        // Published total: head joint to mean toe joint 1.5536 m.
        let toes = (skeleton.rest(10).y + skeleton.rest(11).y) / 2.0;
        assert!((skeleton.rest(15).y - toes - 1.5536).abs() < 5e-5);
        assert!(skeleton.rest(1).x > 0.0, "the left is at +x");
        // The toes point to +z.
        assert!(skeleton.rest(10).z > skeleton.rest(7).z);
    }
}
