//! Mapping from the joints of a source skeleton to the joints of the body.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use datasets_spec::Joint;
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::rig::{Bone, Rest};
use super::topology;
use super::user_map::UserMap;

/// Joint maps of the known dialects, in the JSON format of users' maps. The map with the most names in the source is
/// used; the first of equals wins.
///
/// Spines differ in number and position of joints. Each source joint maps to the body joint with the nearest height
/// between pelvis and neck; the other body joints follow from their neighbours. `cmu` has two neck bones; the upper one
/// starts at the body's neck joint. `xsens` is also the dialect of 100STYLE, and `soma` that of BONES-SEED and Kimodo.
/// In `soma`, `LeftLeg` is the thigh, which other rigs call `LeftUpLeg`.
pub(super) static JOINT_MAPS: LazyLock<Vec<UserMap>> = LazyLock::new(|| {
    let files = [
        include_str!("maps/smplx.json"),
        include_str!("maps/smpl.json"),
        include_str!("maps/bandai-namco.json"),
        include_str!("maps/cmu.json"),
        include_str!("maps/motionbuilder.json"),
        include_str!("maps/lafan1.json"),
        include_str!("maps/mixamo.json"),
        include_str!("maps/biovision.json"),
        include_str!("maps/xsens.json"),
        include_str!("maps/soma.json"),
        include_str!("maps/snapmogen.json"),
    ];
    let maps = files.into_iter().map(UserMap::parse);
    maps.map(|map| map.expect("tests read the built-in maps"))
        .collect()
});

/// Required joints of a body. Neck or head is required too.
const REQUIRED: [Joint; 7] = [
    Joint::Pelvis,
    Joint::LeftHip,
    Joint::RightHip,
    Joint::LeftKnee,
    Joint::RightKnee,
    Joint::LeftAnkle,
    Joint::RightAnkle,
];

/// How the joints of a skeleton were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// By the map of the user.
    User,
    /// By the names of a known dialect.
    Dialect,
    /// By the words in the bones' names.
    Words,
    /// By the topology of the bones.
    Topology,
}

/// The joints of a file that map to joints of the body.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// Name of the map or dialect, or how the joints were guessed.
    pub name: String,
    /// How the joints were found.
    pub origin: Origin,
    /// Index of the bone in the file for each body joint, `[22]`.
    pub source_of: [Option<usize>; NUM_BODY_JOINTS],
}

impl Mapping {
    /// Finds the body in a skeleton: by the user's map, a known dialect, the words in its names, or its topology. The
    /// first method that finds pelvis, legs and head is used.
    ///
    /// # Errors
    /// No method finds them (the error names what is missing), or a name of the dialect occurs twice.
    pub fn find(
        bones: &[Bone<'_>],
        rests: &[Rest],
        user_map: Option<&UserMap>,
    ) -> Result<Self, String> {
        let mut by_name: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (index, bone) in bones.iter().enumerate() {
            by_name.entry(bare(bone.name)).or_default().push(index);
        }
        if let Some(mapping) = user_map.map(|map| Self::by_user(bones, map))
            && mapping.missing().is_empty()
        {
            return Ok(mapping);
        }
        let (dialect, named) = Self::by_dialect(&by_name);
        if named.missing().is_empty() {
            for name in dialect.source_names() {
                if let Some(indices) = by_name.get(name).filter(|indices| indices.len() > 1) {
                    return Err(format!(
                        "found {} joints named \"{name}\", expected one",
                        indices.len()
                    ));
                }
            }
            return Ok(named.completed(&guess_by_words(bones)));
        }
        let guessed = guess_by_words(bones);
        if guessed.missing().is_empty() {
            return Ok(guessed);
        }
        if let Some(mapping) = Self::by_topology(bones, rests) {
            return Ok(mapping);
        }
        let (missing, kind) = if guessed.missing().len() < named.missing().len() {
            (guessed.missing(), "by words in names".to_owned())
        } else {
            (named.missing(), format!("by the {} names", named.name))
        };
        Err(format!(
            "found no {} among {} joints ({kind}); expected a body with hips, legs and a head, \
             or a joint map that names them",
            missing.join(", "),
            bones.len()
        ))
    }

    fn by_user(bones: &[Bone<'_>], map: &UserMap) -> Self {
        let find = |name: &str| {
            let whole = bones.iter().position(|bone| bone.name == name);
            whole.or_else(|| bones.iter().position(|bone| bare(bone.name) == name))
        };
        Self {
            name: format!("{} of the user", map.name()),
            origin: Origin::User,
            source_of: Joint::ALL.map(|joint| map.source_name(joint).and_then(find)),
        }
    }

    /// The dialect with the most names in the file, and the joints that it finds.
    fn by_dialect(by_name: &BTreeMap<&str, Vec<usize>>) -> (&'static UserMap, Self) {
        let num_matches = |map: &UserMap| {
            let names = map.source_names();
            names.filter(|name| by_name.contains_key(name)).count()
        };
        // Of maps with equally many names, the first is taken.
        let best = JOINT_MAPS.iter().rev().max_by_key(|map| num_matches(map));
        let best = best.expect("there are built-in maps");
        let mapping = Self {
            name: best.name().to_owned(),
            origin: Origin::Dialect,
            source_of: Joint::ALL.map(|joint| {
                let indices = by_name.get(best.source_name(joint)?)?;
                indices.first().copied()
            }),
        };
        (best, mapping)
    }

    fn by_topology(bones: &[Bone<'_>], rests: &[Rest]) -> Option<Self> {
        let source_of = rests
            .iter()
            .find_map(|rest| topology::guess(bones, &rest.bones))?;
        let num_found = source_of.iter().flatten().count();
        Some(Self {
            name: format!(
                "by how the bones hang together, {num_found} of {NUM_BODY_JOINTS} joints found"
            ),
            origin: Origin::Topology,
            source_of,
        })
    }

    /// Adds limb joints that the dialect's names did not find, such as a foot with another name, from a guess.
    /// Spine joints are left out: the guess assigns them differently.
    fn completed(mut self, guessed: &Self) -> Self {
        for joint in 0..NUM_BODY_JOINTS {
            let is_limb = Joint::ALL[joint].mirrored() != Joint::ALL[joint];
            let free = guessed.source_of[joint]
                .filter(|source| is_limb && !self.source_of.contains(&Some(*source)));
            self.source_of[joint] = self.source_of[joint].or(free);
        }
        self
    }

    /// Whether the joints were guessed rather than known by name.
    pub fn is_guess(&self) -> bool {
        matches!(self.origin, Origin::Words | Origin::Topology)
    }

    /// Names of required body joints that were not found.
    fn missing(&self) -> Vec<&'static str> {
        let has = |joint: Joint| self.source_of[joint.index()].is_some();
        let mut missing: Vec<&str> = REQUIRED
            .into_iter()
            .filter(|&joint| !has(joint))
            .map(Joint::name)
            .collect();
        if !has(Joint::Neck) && !has(Joint::Head) {
            missing.push("neck or head");
        }
        missing
    }

    /// Names of body joints that were not found.
    pub fn absent(&self) -> Vec<&'static str> {
        Joint::ALL
            .into_iter()
            .filter(|joint| self.source_of[joint.index()].is_none())
            .map(Joint::name)
            .collect()
    }
}

/// A name without its namespace, as in `mixamorig:Hips`.
pub(crate) fn bare(name: &str) -> &str {
    name.rsplit(':').next().unwrap_or(name)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Side {
    Left,
    Right,
}

/// A body joint without its side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    /// The pelvis, which some rigs have twice: as root of the legs and of the spine.
    Pelvis,
    Hip,
    Knee,
    Ankle,
    Foot,
    Collar,
    /// The collar of rigs that call the next joint an arm, else the shoulder.
    ShoulderOrCollar,
    Shoulder,
    Elbow,
    Wrist,
    Neck,
    Head,
}

/// Words for each part. The longest word that a name ends with decides: a forearm is not an arm.
const WORDS: [(Part, &str); 12] = [
    (Part::Pelvis, "pelvis hips waist root body"),
    (Part::Hip, "upleg upperleg thigh femur hip"),
    (Part::Knee, "leg lowerleg calf shin tibia knee"),
    (Part::Ankle, "foot ankle"),
    (Part::Foot, "forefoot ball toe toes toebase"),
    (Part::Collar, "clavicle collar collarbone"),
    (Part::ShoulderOrCollar, "shoulder"),
    (Part::Shoulder, "arm uparm upperarm"),
    (Part::Elbow, "forearm lowerarm elbow"),
    (Part::Wrist, "hand palm wrist"),
    (Part::Neck, "neck"),
    (Part::Head, "head"),
];

/// Words of control and twist bones, which are not joints.
const STEERING: [&str; 8] = [
    "ik", "fk", "pole", "target", "ctrl", "control", "twist", "nub",
];

/// The side and the part that a name states; no part for control bones. `LeftUpLeg`, `upleg_l` and `Bip01 L UpLeg`
/// state the same.
fn side_and_part(name: &str) -> (Option<Side>, Option<Part>) {
    let mut words: Vec<String> = Vec::new();
    let mut previous_lower = false;
    let mut open = false;
    for c in bare(name).chars() {
        if !c.is_alphabetic() {
            open = false;
            continue;
        }
        if !open || (c.is_uppercase() && previous_lower) {
            words.push(String::new());
            open = true;
        }
        if let Some(word) = words.last_mut() {
            word.extend(c.to_lowercase());
        }
        previous_lower = c.is_lowercase();
    }
    if words.iter().any(|word| STEERING.contains(&word.as_str())) {
        return (None, None);
    }
    let side_of = |word: &str| match word {
        "left" | "l" => Some(Side::Left),
        "right" | "r" => Some(Side::Right),
        _ => None,
    };
    let mut side = words.iter().find_map(|word| side_of(word));
    words.retain(|word| side_of(word).is_none());
    let mut rest = words.concat();
    if side.is_none() {
        for (prefix, prefix_side) in [("left", Side::Left), ("right", Side::Right)] {
            if let Some(stripped) = rest.strip_prefix(prefix) {
                (side, rest) = (Some(prefix_side), stripped.to_owned());
                break;
            }
        }
    }
    let words = WORDS
        .iter()
        .flat_map(|&(part, words)| words.split(' ').map(move |word| (word, part)));
    let part = words
        .filter(|(word, _)| rest.ends_with(word))
        .max_by_key(|(word, _)| word.len())
        .map(|(_, part)| part);
    (side, part)
}

fn guess_by_words(bones: &[Bone<'_>]) -> Mapping {
    let mut first: BTreeMap<(Option<Side>, Part), usize> = BTreeMap::new();
    for (index, bone) in bones.iter().enumerate() {
        if let (side, Some(part)) = side_and_part(bone.name) {
            first.entry((side, part)).or_insert(index);
        }
    }
    let mut source_of = [None; NUM_BODY_JOINTS];
    for (side, joints) in [
        (Side::Left, [1, 4, 7, 10, 13, 16, 18, 20]),
        (Side::Right, [2, 5, 8, 11, 14, 17, 19, 21]),
    ] {
        let get = |part: Part| first.get(&(Some(side), part)).copied();
        let arm = get(Part::Shoulder);
        let shoulder = get(Part::ShoulderOrCollar);
        let found = [
            get(Part::Hip),
            get(Part::Knee),
            get(Part::Ankle),
            get(Part::Foot),
            get(Part::Collar).or(arm.and(shoulder)),
            arm.or(shoulder),
            get(Part::Elbow),
            get(Part::Wrist),
        ];
        for (joint, index) in joints.into_iter().zip(found) {
            source_of[joint] = index;
        }
    }
    source_of[12] = first.get(&(None, Part::Neck)).copied();
    source_of[15] = first.get(&(None, Part::Head)).copied();
    if let (Some(left), Some(right)) = (source_of[1], source_of[2]) {
        source_of[0] = common_ancestor(bones, left, right);
    }
    if let (Some(pelvis), Some(top)) = (source_of[0], source_of[12].or(source_of[15])) {
        let mut spine: Vec<usize> = ancestors(bones, top)
            .take_while(|&index| index != pelvis)
            .filter(|&index| side_and_part(bones[index].name).1 != Some(Part::Pelvis))
            .collect();
        spine.reverse();
        for (joint, bone) in topology::spine_joints(&spine) {
            source_of[joint] = Some(bone);
        }
    }
    let num_found = source_of.iter().flatten().count();
    Mapping {
        name: format!("by words in names, {num_found} of {NUM_BODY_JOINTS} joints found"),
        origin: Origin::Words,
        source_of,
    }
}

fn ancestors(bones: &[Bone<'_>], index: usize) -> impl Iterator<Item = usize> {
    std::iter::successors(bones[index].parent, |&parent| bones[parent].parent)
}

/// The lowest common ancestor of two bones.
fn common_ancestor(bones: &[Bone<'_>], a: usize, b: usize) -> Option<usize> {
    let above: Vec<usize> = ancestors(bones, a).collect();
    ancestors(bones, b).find(|candidate| above.contains(candidate))
}

/// Whether a bone is a descendant of another bone.
pub(super) fn hangs_from(bones: &[Bone<'_>], bone: usize, from: usize) -> bool {
    ancestors(bones, bone).any(|ancestor| ancestor == from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skeleton<'a>(names_and_parents: &[(&'a str, usize)]) -> Vec<Bone<'a>> {
        names_and_parents
            .iter()
            .enumerate()
            .map(|(index, &(name, parent))| Bone {
                name,
                parent: (index > 0).then_some(parent),
                tip: None,
            })
            .collect()
    }

    fn find(bones: &[Bone<'_>]) -> Result<Mapping, String> {
        Mapping::find(bones, &[], None)
    }

    #[test]
    fn dialects_are_told_apart_by_their_names() {
        for map in JOINT_MAPS.iter() {
            let names = map.source_names().map(|name| format!("rig:{name}"));
            let names: Vec<String> = names.collect();
            let joints: Vec<(&str, usize)> = names.iter().map(|name| (name.as_str(), 0)).collect();
            let mapping = find(&skeleton(&joints)).unwrap_or_else(|_| panic!("{}", map.name()));
            assert_eq!(mapping.name, map.name());
            assert_eq!(mapping.absent().len(), 22 - joints.len());
        }
    }

    #[test]
    fn unknown_rigs_are_read_by_their_words() {
        let joints = skeleton(&[
            ("Bip01", 0),
            ("Bip01 Pelvis", 0),
            ("Bip01 L Thigh", 1),
            ("Bip01 L Calf", 2),
            ("Bip01 L Foot", 3),
            ("Bip01 R Thigh", 1),
            ("Bip01 R Calf", 5),
            ("Bip01 R Foot", 6),
            ("Bip01 Spine", 1),
            ("Bip01 Spine1", 8),
            ("Bip01 Neck", 9),
            ("Bip01 Head", 10),
            ("Bip01 L Clavicle", 9),
            ("Bip01 L UpperArm", 12),
            ("Bip01 L Forearm", 13),
            ("Bip01 L Hand", 14),
        ]);
        let mapping = find(&joints).expect("a body");
        let at = |joint: Joint| mapping.source_of[joint.index()];
        assert_eq!(at(Joint::Pelvis), Some(1), "where the legs meet");
        assert_eq!(at(Joint::LeftElbow), Some(14));
        assert_eq!(at(Joint::LeftCollar), Some(12));
        assert_eq!((at(Joint::Spine1), at(Joint::Spine3)), (Some(8), Some(9)));
        assert_eq!(at(Joint::RightShoulder), None);
        assert!(mapping.name.contains("15 of 22"), "{}", mapping.name);
    }

    #[test]
    fn a_foot_of_another_name_is_still_found() {
        let mut maps = JOINT_MAPS.iter();
        let lafan1 = maps.find(|map| map.name() == "lafan1").expect("known");
        let names = Joint::ALL
            .into_iter()
            .filter_map(|joint| lafan1.source_name(joint));
        let joints: Vec<(&str, usize)> = names
            .map(|name| (if name == "LeftToe" { "LeftToes" } else { name }, 0))
            .collect();
        let mapping = find(&skeleton(&joints)).expect("a body");
        assert_eq!(mapping.source_of[Joint::LeftFoot.index()], Some(10));
    }

    #[test]
    fn what_is_no_body_is_named() {
        let rejected = find(&skeleton(&[("Base", 0), ("End", 0)])).expect_err("two bones");
        assert!(rejected.contains("left_knee"), "{rejected}");
        let mut twice: Vec<(&str, usize)> =
            JOINT_MAPS[3].source_names().map(|name| (name, 0)).collect();
        twice.push(("Extra", 0));
        twice.push(("Extra", 0));
        assert!(find(&skeleton(&twice)).is_ok(), "an unused name may repeat");
        twice.push(("LeftLeg", 0));
        let rejected = find(&skeleton(&twice)).expect_err("two left legs");
        assert!(rejected.contains("LeftLeg"), "{rejected}");
    }
}
