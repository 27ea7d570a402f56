//! Sets of joints, named body parts, and blend masks.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::Error;
use kinematics::skeleton::{Joint, NUM_BODY_JOINTS};

/// The version of the joints in [`BodyPart::mask`]. The STANCE release names its parts, but publishes neither their
/// hard nor their soft joints. A change of either is a new version, and every stored mask records the version it was
/// made with.
pub const MASK_DEF_VERSION: u32 = 1;

/// A set of body joints.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(try_from = "Vec<String>", into = "Vec<String>")]
pub struct JointSet(u32);

impl JointSet {
    /// No joint.
    pub const EMPTY: JointSet = JointSet(0);
    /// All 22 body joints.
    pub const ALL: JointSet = JointSet((1 << NUM_BODY_JOINTS) - 1);

    /// The set of the joints with these SMPL-X indices.
    ///
    /// # Panics
    /// If an index is not below 22.
    pub const fn of(indices: &[usize]) -> Self {
        let mut bits = 0;
        let mut i = 0;
        while i < indices.len() {
            assert!(indices[i] < NUM_BODY_JOINTS);
            bits |= 1 << indices[i];
            i += 1;
        }
        Self(bits)
    }

    /// Whether the joint with this SMPL-X index is in the set.
    pub fn contains(self, joint_index: usize) -> bool {
        joint_index < NUM_BODY_JOINTS && self.0 >> joint_index & 1 == 1
    }

    /// Number of joints.
    pub fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Whether the set is empty.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Joints in either set.
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Joints in both sets.
    pub fn intersection(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Joints in this set and not in the other.
    pub fn difference(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The joints in SMPL-X order.
    pub fn iter(self) -> impl Iterator<Item = Joint> {
        Joint::ALL
            .into_iter()
            .filter(move |joint| self.contains(joint.index()))
    }

    /// The same joints on the other side of the body.
    pub fn mirrored(self) -> Self {
        self.iter().map(Joint::mirrored).collect()
    }

    /// The SMPL-X names, in order.
    pub fn names(self) -> Vec<String> {
        self.iter().map(|joint| joint.name().to_owned()).collect()
    }
}

impl FromIterator<Joint> for JointSet {
    fn from_iter<I: IntoIterator<Item = Joint>>(joints: I) -> Self {
        Self(joints.into_iter().fold(0, |bits, j| bits | 1 << j.index()))
    }
}

impl TryFrom<Vec<String>> for JointSet {
    type Error = Error;

    fn try_from(names: Vec<String>) -> Result<Self, Error> {
        let joints = names.iter().map(|name| Joint::from_str(name));
        Ok(joints.collect::<Result<_, _>>()?)
    }
}

impl From<JointSet> for Vec<String> {
    fn from(set: JointSet) -> Vec<String> {
        set.names()
    }
}

impl fmt::Debug for JointSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(self.iter().map(Joint::name)).finish()
    }
}

impl fmt::Display for JointSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.names().join(", "))
    }
}

kinematics::named! {
    /// A named part of the body. The first five are those of the STANCE release, which spells names like this.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "SCREAMING_SNAKE_CASE")]
    pub enum BodyPart, named by name {
        /// Spine, neck, head and arms.
        UpperBody = "UPPER_BODY",
        /// Pelvis and legs; the only part that moves the root.
        LowerBody = "LOWER_BODY",
        /// Left and right arm.
        BothArms = "BOTH_ARMS",
        /// Left shoulder, elbow and wrist.
        LeftArm = "LEFT_ARM",
        /// Right shoulder, elbow and wrist.
        RightArm = "RIGHT_ARM",
        /// Both legs without the pelvis.
        BothLegs = "BOTH_LEGS",
        /// Left leg without the pelvis.
        LeftLeg = "LEFT_LEG",
        /// Right leg without the pelvis.
        RightLeg = "RIGHT_LEG",
        /// Spine and collars.
        Torso = "TORSO",
        /// Neck and head.
        Head = "HEAD",
    }
}

impl BodyPart {
    /// The part in words, as in an instruction: "upper body", "left arm".
    pub fn phrase(self) -> String {
        self.name().to_lowercase().replace('_', " ")
    }

    /// The same part on the other side of the body.
    pub fn mirrored(self) -> Self {
        match self {
            Self::LeftArm => Self::RightArm,
            Self::RightArm => Self::LeftArm,
            Self::LeftLeg => Self::RightLeg,
            Self::RightLeg => Self::LeftLeg,
            Self::UpperBody
            | Self::LowerBody
            | Self::BothArms
            | Self::BothLegs
            | Self::Torso
            | Self::Head => self,
        }
    }

    /// The part's hard joints, which follow the target exactly, and its soft joints, which are blended, in version
    /// [`MASK_DEF_VERSION`].
    pub fn mask(self) -> BlendMask {
        let (hard, soft): (&[usize], &[usize]) = match self {
            Self::UpperBody => (&[9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21], &[3, 6]),
            Self::LowerBody => (&[0, 1, 2, 4, 5, 7, 8, 10, 11], &[3, 6]),
            Self::BothArms => (&[16, 17, 18, 19, 20, 21], &[13, 14]),
            Self::LeftArm => (&[16, 18, 20], &[13]),
            Self::RightArm => (&[17, 19, 21], &[14]),
            Self::BothLegs => (&[1, 2, 4, 5, 7, 8, 10, 11], &[]),
            Self::LeftLeg => (&[1, 4, 7, 10], &[]),
            Self::RightLeg => (&[2, 5, 8, 11], &[]),
            Self::Torso => (&[3, 6, 9], &[13, 14]),
            Self::Head => (&[15], &[12]),
        };
        BlendMask {
            hard: JointSet::of(hard),
            soft: JointSet::of(soft),
        }
    }

    /// All joints of the part, hard and soft.
    pub fn joints(self) -> JointSet {
        let mask = self.mask();
        mask.hard.union(mask.soft)
    }
}

impl FromStr for BodyPart {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        Self::of_name(text).ok_or_else(|| {
            let known = Self::ALL.map(Self::name).join(", ");
            Error::Refused(format!("unknown body part {text:?}; known: {known}"))
        })
    }
}

/// Joints that a blend takes from the target: `hard` joints fully, `soft` joints by interpolation. The two
/// sets are disjoint by construction (paper Sec. 4.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "RawMask")]
pub struct BlendMask {
    hard: JointSet,
    soft: JointSet,
}

#[derive(Deserialize)]
struct RawMask {
    hard: JointSet,
    soft: JointSet,
}

impl BlendMask {
    /// A mask that takes nothing: the blend is the source.
    pub const EMPTY: BlendMask = BlendMask {
        hard: JointSet::EMPTY,
        soft: JointSet::EMPTY,
    };
    /// A mask that takes everything: the blend is the target.
    pub const FULL: BlendMask = BlendMask {
        hard: JointSet::ALL,
        soft: JointSet::EMPTY,
    };

    /// A mask of two disjoint sets.
    ///
    /// # Errors
    /// A joint is in both.
    pub fn new(hard: JointSet, soft: JointSet) -> Result<Self, Error> {
        let both = hard.intersection(soft);
        if both.is_empty() {
            return Ok(Self { hard, soft });
        }
        Err(Error::Refused(format!(
            "joints {both} are both hard and soft; a joint is one or the other (paper Sec. 4.2)"
        )))
    }

    /// A mask by the names of its joints, as in a mask row.
    ///
    /// # Errors
    /// A name is unknown, or a joint is in both lists.
    pub fn of_names(hard: &[String], soft: &[String]) -> Result<Self, Error> {
        Self::new(hard.to_vec().try_into()?, soft.to_vec().try_into()?)
    }

    /// The mask of several parts together. A joint that is hard in one part and soft in another is hard.
    pub fn of_parts(parts: &[BodyPart]) -> Self {
        let union = |of: fn(Self) -> JointSet| {
            let masks = parts.iter().map(|part| part.mask());
            masks.fold(JointSet::EMPTY, |set, mask| set.union(of(mask)))
        };
        let (hard, soft) = (union(Self::hard), union(Self::soft));
        Self {
            hard,
            soft: soft.difference(hard),
        }
    }

    /// Joints taken from the target.
    pub fn hard(self) -> JointSet {
        self.hard
    }

    /// Joints interpolated between source and target.
    pub fn soft(self) -> JointSet {
        self.soft
    }

    /// Whether the blend follows the target's root orientation and translation: when the pelvis is
    /// hard (paper Sec. 4.2).
    pub fn moves_root(self) -> bool {
        self.hard.contains(Joint::Pelvis.index())
    }

    /// Whether the mask takes nothing.
    pub fn is_empty(self) -> bool {
        self.hard.is_empty() && self.soft.is_empty()
    }

    /// The same mask for the other side of the body.
    pub fn mirrored(self) -> Self {
        Self {
            hard: self.hard.mirrored(),
            soft: self.soft.mirrored(),
        }
    }
}

impl TryFrom<RawMask> for BlendMask {
    type Error = Error;

    fn try_from(raw: RawMask) -> Result<Self, Error> {
        Self::new(raw.hard, raw.soft)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_disjoint_masks_and_only_the_lower_body_moves_the_root() {
        for part in BodyPart::ALL {
            let mask = part.mask();
            assert!(BlendMask::new(mask.hard(), mask.soft()).is_ok(), "{part}");
            assert!(!mask.hard().is_empty(), "{part}");
            assert_eq!(mask.moves_root(), part == BodyPart::LowerBody, "{part}");
            assert_eq!(part.mask().mirrored(), part.mirrored().mask(), "{part}");
            assert_eq!(part.name().parse::<BodyPart>().ok(), Some(part));
        }
    }

    #[test]
    fn upper_and_lower_body_cover_the_body_once() {
        let (upper, lower) = (BodyPart::UpperBody.mask(), BodyPart::LowerBody.mask());
        assert!(upper.hard().intersection(lower.hard()).is_empty());
        assert_eq!(upper.soft(), lower.soft());
        let all = upper.hard().union(lower.hard()).union(upper.soft());
        assert_eq!(all, JointSet::ALL);
    }

    #[test]
    fn a_joint_cannot_be_hard_and_soft() {
        let overlap = BlendMask::new(JointSet::of(&[1, 2]), JointSet::of(&[2, 3]));
        let error = overlap.expect_err("both").to_string();
        assert!(error.starts_with("joints right_hip are both"), "{error}");
    }

    #[test]
    fn merging_parts_lets_hard_win() {
        let mask = BlendMask::of_parts(&[BodyPart::UpperBody, BodyPart::LowerBody]);
        assert_eq!(mask.hard().union(mask.soft()), JointSet::ALL);
        let mask = BlendMask::of_parts(&[BodyPart::Torso, BodyPart::LeftArm]);
        assert!(mask.soft().contains(13) && !mask.hard().contains(13));
    }
}
