//! The 263 features a frame of HumanML3D, from the joints of any motion and back.
//!
//! The published preparation brings a clip to a uniform skeleton, puts it on the floor and turns it
//! to face +z; then a frame becomes root motion, joint positions, joint rotations, joint velocities
//! and foot contacts, all seen from the heading of the root. Equal output needs its quirks, so they
//! are part of the recipe:
//!
//! * the heading of the features is found from a forward vector in which the hips are swapped and
//!   the shoulders are not, smoothed over 20 frames;
//! * the first frame has no heading, whatever its forward vector says;
//! * the chains of the arms start from the root's rotation, not from that of the chest;
//! * the yaw velocity is half the angle.
//!
//! A bone that points exactly against its rest direction is a division by zero there; here it is a
//! half turn about an axis at right angles.
//!
//! # Source
//! EricGuo5513/HumanML3D, notebook `motion_representation` and `common/skeleton.py`.

mod blocks;
mod headings;

use datasets_spec::record::HUMANML3D_WIDTH;
use datasets_spec::{Motion, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::skeleton::NUM_BODY_JOINTS;

use self::blocks::{Clip, Placement};
use self::headings::Headings;

/// Name and version of the recipe. Any change of its numbers is a new version.
pub const RECIPE: &str = "humanml3d@1";
/// Rate the recipe is made for, in 1/s: contacts and smoothing count frames, not seconds.
pub const FPS: f64 = 20.0;

/// Positions of the 22 body joints in metres, y up.
pub type Joints = [DVec3; NUM_BODY_JOINTS];
/// The features of a frame.
pub type Features = [f32; HUMANML3D_WIDTH];

/// Where each group of features lies in a frame, by the names used in reports.
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
const REST_AXES: [DVec3; NUM_BODY_JOINTS] = {
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

/// The joint each joint hangs from, as in SMPL.
const PARENTS: [usize; NUM_BODY_JOINTS] = [
    0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19,
];

/// The joint whose rotation each joint's is relative to: its parent, but for the joints that begin
/// a chain, whose rotations are relative to the root's.
const RELATIVE_TO: [usize; NUM_BODY_JOINTS] = {
    let mut relative_to = PARENTS;
    relative_to[13] = 0;
    relative_to[14] = 0;
    relative_to
};

const LEFT_HIP: usize = 1;
const RIGHT_HIP: usize = 2;
const RIGHT_KNEE: usize = 5;
const RIGHT_ANKLE: usize = 8;
const LEFT_SHOULDER: usize = 16;
const RIGHT_SHOULDER: usize = 17;
/// Left ankle and toe, right ankle and toe, in the order of the contacts.
const FEET: [usize; 4] = [7, 10, 8, 11];
/// Squared displacement in m² in a frame below which a foot joint is in contact.
const CONTACT_THRESHOLD: f64 = 0.002;
/// Length in metres below which a bone has no direction.
const SHORTEST_BONE_M: f64 = 1e-8;

/// Why joints have no features.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FeatureError {
    /// A velocity needs two frames.
    #[error("{frames} frames have no features; at least 2 are needed")]
    TooShort {
        /// Frames there are.
        frames: usize,
    },
    /// A joint is at no place, or a bone has no length.
    #[error(
        "joint {} has no finite position or no bone in frame {frame}",
        kinematics::skeleton::JOINT_NAMES[*joint]
    )]
    NoDirection {
        /// The joint.
        joint: usize,
        /// The frame.
        frame: usize,
    },
    /// The joints of recovered features are no motion of a body.
    #[error("the joints make no motion: {reason}")]
    NoMotion {
        /// What is wrong.
        reason: String,
    },
}

/// The 22 body joints of a motion.
pub fn joints_of_motion(motion: &Motion, skeleton: &Skeleton) -> Vec<Joints> {
    skeleton.points_of_frames(motion, 0..motion.len())
}

/// The features of world joints by the whole recipe.
///
/// # Shapes
/// `T` frames in, `T - 1` out: a frame's velocities reach into the next.
///
/// # Errors
/// There are fewer than two frames, or a bone without a direction.
pub fn features_of_joints(joints: &[Joints]) -> Result<Vec<Features>, FeatureError> {
    if joints.len() < 2 {
        return Err(FeatureError::TooShort {
            frames: joints.len(),
        });
    }
    let clip = unified(joints, &UNIFORM_BONES)?;
    Ok(features_of(&clip, start(&clip)))
}

/// Brings world joints to the skeleton of the given bone lengths, to the floor at y = 0, and to a
/// first frame at x = z = 0 that faces +z.
///
/// # Errors
/// There is no frame, or a bone without a direction.
pub fn process_joints(
    joints: &[Joints],
    bones: &[f64; NUM_BODY_JOINTS],
) -> Result<Vec<Joints>, FeatureError> {
    let clip = unified(joints, bones)?;
    Ok(clip.placed(start(&clip)))
}

/// Gives every bone the length it has in the uniform skeleton and keeps its direction; the path of
/// the root is scaled by the ratio of the leg lengths.
///
/// # Errors
/// There is no frame, or a bone without a direction.
pub fn unify(
    joints: &[Joints],
    bones: &[f64; NUM_BODY_JOINTS],
) -> Result<Vec<Joints>, FeatureError> {
    Ok(unified(joints, bones)?.placed(Placement::IDENTITY))
}

/// The features of joints that are already on the uniform skeleton, on the floor and facing +z,
/// such as those of a published `new_joints` file.
///
/// # Errors
/// As [`features_of_joints`].
pub fn features_of_processed(joints: &[Joints]) -> Result<Vec<Features>, FeatureError> {
    if joints.len() < 2 {
        return Err(FeatureError::TooShort {
            frames: joints.len(),
        });
    }
    let clip = Clip::gather(joints);
    clip.check_bones()?;
    Ok(features_of(&clip, Placement::IDENTITY))
}

/// A clip on the skeleton of the given bone lengths.
fn unified(joints: &[Joints], bones: &[f64; NUM_BODY_JOINTS]) -> Result<Clip, FeatureError> {
    let Some(first) = joints.first() else {
        return Err(FeatureError::TooShort { frames: 0 });
    };
    let leg = |joint: usize| (first[joint] - first[PARENTS[joint]]).length();
    let scale = (bones[RIGHT_KNEE] + bones[RIGHT_ANKLE]) / (leg(RIGHT_KNEE) + leg(RIGHT_ANKLE));
    let mut clip = Clip::gather(joints);
    clip.unify(bones, scale)?;
    Ok(clip)
}

/// Where a clip of at least one frame is put: on the floor, its first frame at x = z = 0 and facing
/// +z by hips and shoulders, none of them swapped.
fn start(clip: &Clip) -> Placement {
    let first = clip.frame(0);
    let across = first[RIGHT_HIP] - first[LEFT_HIP] + first[RIGHT_SHOULDER] - first[LEFT_SHOULDER];
    let origin = first[0].with_y(clip.lowest());
    Placement::new(origin, across.cross(DVec3::NEG_Y))
}

/// The features of a clip of at least two frames, each with its bones.
fn features_of(clip: &Clip, placement: Placement) -> Vec<Features> {
    let mut forwards = clip.forwards();
    for forward in &mut forwards {
        *forward = placement.turned(*forward);
    }
    clip.features(placement, &Headings::of(&forwards))
}

/// A rotation about the vertical that takes where the root faces to +z, by the half-angle's cosine
/// and sine.
#[derive(Clone, Copy, Debug)]
struct Heading {
    half_cosine: f64,
    half_sine: f64,
}

impl Heading {
    fn quaternion(self) -> DQuat {
        DQuat::from_xyzw(0.0, self.half_sine, 0.0, self.half_cosine)
    }

    /// A vector seen with this heading, in the world.
    fn unsee(self, v: DVec3) -> DVec3 {
        let cosine = self.half_cosine * self.half_cosine - self.half_sine * self.half_sine;
        let sine = 2.0 * self.half_cosine * self.half_sine;
        DVec3::new(cosine * v.x - sine * v.z, v.y, cosine * v.z + sine * v.x)
    }
}

/// Root heading and position of every frame, accumulated from the velocities.
fn recover_root(features: &[Features]) -> Vec<(Heading, DVec3)> {
    let (mut angle, mut position) = (0.0f64, DVec3::ZERO);
    let mut roots = Vec::with_capacity(features.len());
    for (frame, now) in features.iter().enumerate() {
        if let Some(before) = frame.checked_sub(1).map(|before| &features[before]) {
            angle += f64::from(before[0]);
        }
        let heading = Heading {
            half_cosine: angle.cos(),
            half_sine: angle.sin(),
        };
        if let Some(before) = frame.checked_sub(1).map(|before| &features[before]) {
            position += heading.unsee(DVec3::new(before[1].into(), 0.0, before[2].into()));
        }
        roots.push((heading, position.with_y(now[3].into())));
    }
    roots
}

/// World joints from the positions of the features.
///
/// # Shapes
/// As many frames as there are features.
pub fn recover_joints(features: &[Features]) -> Vec<Joints> {
    let roots = recover_root(features);
    features
        .iter()
        .zip(roots)
        .map(|(frame, (heading, root))| {
            let ground = root.with_y(0.0);
            let mut joints = [root; NUM_BODY_JOINTS];
            for (joint, seen) in joints[1..].iter_mut().zip(frame[4..67].chunks_exact(3)) {
                let seen = DVec3::new(seen[0].into(), seen[1].into(), seen[2].into());
                *joint = heading.unsee(seen) + ground;
            }
            joints
        })
        .collect()
}

/// World joints from the rotations of the features, on a skeleton of the given bone lengths.
pub fn recover_joints_from_rotations(
    features: &[Features],
    bones: &[f64; NUM_BODY_JOINTS],
) -> Vec<Joints> {
    let roots = recover_root(features);
    features
        .iter()
        .zip(roots)
        .map(|(frame, (heading, root))| {
            let directions = directions_of(frame, heading);
            let mut joints = [root; NUM_BODY_JOINTS];
            for joint in 1..NUM_BODY_JOINTS {
                joints[joint] = joints[PARENTS[joint]] + directions[joint] * bones[joint];
            }
            joints
        })
        .collect()
}

/// The rotations of a frame, as the features tell them.
///
/// They are not those of a posed body: each takes the unit axis that its bone lies along at rest to
/// where the bone points, by the shortest way.
#[derive(Clone, Debug, PartialEq)]
pub struct Rotations {
    /// Position of the root in metres.
    pub root: DVec3,
    /// The first is the turn that takes where the root faces to +z; the others are relative to the
    /// joint before in the chain, the arms' to the root.
    pub local: [DQuat; NUM_BODY_JOINTS],
    /// The same in the world.
    pub global: [DQuat; NUM_BODY_JOINTS],
}

/// Root and rotations of every frame, from the rotations of the features.
pub fn recover_rotations(features: &[Features]) -> Vec<Rotations> {
    recover_root(features)
        .into_iter()
        .zip(features)
        .map(|((heading, root), frame)| {
            let global = globals_of(frame, heading).map(|turn| DQuat::from_mat3(&turn));
            let local = std::array::from_fn(|joint| match joint {
                0 => global[0],
                _ => global[RELATIVE_TO[joint]].conjugate() * global[joint],
            });
            Rotations {
                root,
                local,
                global,
            }
        })
        .collect()
}

/// The rotation of each joint in the world.
fn globals_of(frame: &Features, heading: Heading) -> [DMat3; NUM_BODY_JOINTS] {
    let mut rotations = [DMat3::from_quat(heading.quaternion()); NUM_BODY_JOINTS];
    for joint in 1..NUM_BODY_JOINTS {
        let six_d: [f64; 6] = std::array::from_fn(|k| frame[67 + 6 * (joint - 1) + k].into());
        let local = kinematics::rotation::from_six_d_columns(six_d);
        rotations[joint] = rotations[RELATIVE_TO[joint]] * local;
    }
    rotations
}

/// Where each bone points in the world, by the rotations of a frame.
fn directions_of(frame: &Features, heading: Heading) -> Joints {
    let rotations = globals_of(frame, heading);
    std::array::from_fn(|joint| rotations[joint] * REST_AXES[joint])
}

/// Position of the root and directions of the bones in the world, by the rotations of the features.
pub(crate) fn recover_directions(features: &[Features]) -> Vec<(DVec3, Joints)> {
    recover_root(features)
        .into_iter()
        .zip(features)
        .map(|((heading, root), frame)| (root, directions_of(frame, heading)))
        .collect()
}

/// Position of the root and directions of the bones of world joints.
///
/// # Errors
/// A bone has no direction.
pub(crate) fn directions_of_joints(
    joints: &[Joints],
) -> Result<Vec<(DVec3, Joints)>, FeatureError> {
    joints
        .iter()
        .enumerate()
        .map(|(frame, points)| {
            let mut directions = [DVec3::ZERO; NUM_BODY_JOINTS];
            for joint in 1..NUM_BODY_JOINTS {
                let bone = points[joint] - points[PARENTS[joint]];
                let length = bone.length();
                if !(length > SHORTEST_BONE_M && length.is_finite()) {
                    return Err(FeatureError::NoDirection { joint, frame });
                }
                directions[joint] = bone / length;
            }
            Ok((points[0], directions))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use proptest::prelude::*;

    use super::*;
    use crate::golden::{Recorded, read};
    use crate::source::npy::{Array, read_numbers};

    const CASES: [&str; 4] = [
        "humanml3d_random0",
        "humanml3d_random1",
        "humanml3d_sample012314",
        "humanml3d_spin_then_still",
    ];

    fn joints(recorded: &Recorded, key: &str) -> Vec<Joints> {
        let tensor = recorded.get(key);
        assert!(tensor.shape.ends_with(&[NUM_BODY_JOINTS, 3]), "{key}");
        tensor
            .values
            .chunks_exact(3 * NUM_BODY_JOINTS)
            .map(|frame| std::array::from_fn(|joint| DVec3::from_slice(&frame[3 * joint..])))
            .collect()
    }

    fn features(recorded: &Recorded, key: &str) -> Vec<Features> {
        let values = &recorded.get(key).values;
        values
            .chunks_exact(HUMANML3D_WIDTH)
            .map(|frame| std::array::from_fn(|column| frame[column] as f32))
            .collect()
    }

    fn bones(recorded: &Recorded) -> [f64; NUM_BODY_JOINTS] {
        let offsets = &joints(recorded, "in.tgt_offsets")[0];
        offsets.map(DVec3::length)
    }

    #[test]
    fn golden_humanml3d_uniform_skeleton_is_the_published_one() {
        for case in CASES {
            let offsets = joints(&read(case), "in.tgt_offsets")[0];
            for joint in 1..NUM_BODY_JOINTS {
                // Nine digits of a number in f32.
                let uniform = REST_AXES[joint] * UNIFORM_BONES[joint];
                assert!(offsets[joint].distance(uniform) < 1e-9, "{case}: {joint}");
            }
        }
    }

    fn largest_distance(a: &[Joints], b: &[Joints]) -> f64 {
        assert_eq!(a.len(), b.len());
        let pairs = a.iter().flatten().zip(b.iter().flatten());
        pairs.fold(0.0, |largest, (a, b)| {
            largest.max((*a - *b).abs().max_element())
        })
    }

    #[test]
    fn golden_humanml3d_processing_follows_the_notebook() {
        for case in CASES {
            let recorded = read(case);
            let source = joints(&recorded, "in.joints");
            let uniform = unify(&source, &bones(&recorded)).expect("every bone has a length");
            // The published code goes through f32 quaternions.
            let difference = largest_distance(&uniform, &joints(&recorded, "out.uniform"));
            assert!(difference < 1e-5, "{case}: {difference}");
            let processed = process_joints(&source, &bones(&recorded)).expect("a clip");
            let expected = joints(&recorded, "out.global_positions");
            let difference = largest_distance(&processed, &expected);
            assert!(difference < 1e-5, "{case}: {difference}");
        }
    }

    #[test]
    fn golden_humanml3d_features_follow_the_notebook() {
        for case in CASES {
            let recorded = read(case);
            let source = joints(&recorded, "in.joints");
            let processed = process_joints(&source, &bones(&recorded)).expect("a clip");
            let found = features_of_processed(&processed).expect("a clip");
            let expected = features(&recorded, "out.features");
            assert_eq!(found.len(), expected.len(), "{case}");
            for (frame, (found, expected)) in found.iter().zip(&expected).enumerate() {
                for (name, range) in GROUPS {
                    for column in range {
                        let difference = (found[column] - expected[column]).abs();
                        let tolerance = if column < 259 { 2e-5 } else { 0.0 };
                        assert!(
                            difference <= tolerance,
                            "{case}: {name}, column {column} of frame {frame}: {difference}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn golden_humanml3d_recovery_follows_the_published_code() {
        for case in CASES {
            let recorded = read(case);
            let found = features(&recorded, "out.features");
            let expected = joints(&recorded, "out.recovered");
            let difference = largest_distance(&recover_joints(&found), &expected);
            assert!(difference < 2e-5, "{case}: {difference}");
            let expected = joints(&recorded, "out.recovered_from_rot");
            let from_rotations = recover_joints_from_rotations(&found, &bones(&recorded));
            let difference = largest_distance(&from_rotations, &expected);
            assert!(difference < 2e-5, "{case} by rotations: {difference}");
        }
    }

    #[test]
    fn golden_humanml3d_published_vector_gives_its_joints() {
        let recorded = read("humanml3d_sample012314");
        let published = features(&recorded, "in.published_features");
        let expected = joints(&recorded, "out.published_recovered");
        let difference = largest_distance(&recover_joints(&published), &expected);
        assert!(difference < 1e-5, "{difference}");
    }

    #[test]
    fn golden_humanml3d_rotations_point_the_bones() {
        for case in CASES {
            let recorded = read(case);
            let processed = joints(&recorded, "out.global_positions");
            let recovered = recover_rotations(&features(&recorded, "out.features"));
            for (rotations, points) in recovered.iter().zip(&processed) {
                for joint in 1..NUM_BODY_JOINTS {
                    let bone = (points[joint] - points[PARENTS[joint]]).normalize();
                    let pointed = rotations.global[joint] * REST_AXES[joint];
                    // Eight rotations of f32 numbers follow one another.
                    assert!(pointed.distance(bone) < 2e-5, "{case}: {joint}");
                    let before = rotations.global[RELATIVE_TO[joint]];
                    let composed = before * rotations.local[joint] * REST_AXES[joint];
                    assert!(composed.distance(pointed) < 1e-12, "{case}: {joint}");
                }
            }
        }
    }

    #[expect(
        clippy::print_stderr,
        reason = "a test that checks nothing must say so"
    )]
    fn skipped() {
        eprintln!("SKIPPED: STANCE_TEST_DATA names no folder that has humanml3d");
    }

    fn published(folder: &Path, name: &str) -> Array {
        let path = folder.join("humanml3d").join(name);
        let bytes = std::fs::read(&path).expect("a published file");
        read_numbers(name, &bytes).expect("an array")
    }

    /// The published clip: its joints and its features belong together.
    #[test]
    fn published_joints_and_features_follow_from_each_other() {
        let Some(folder) = std::env::var_os("STANCE_TEST_DATA").map(PathBuf::from) else {
            skipped();
            return;
        };
        let joints = published(&folder, "new_joints/012314.npy");
        let joints = crate::source::humanml3d::joints(&joints).expect("joints");
        let features = published(&folder, "new_joint_vecs/012314.npy");
        let features = crate::source::humanml3d::features(&features).expect("features");
        let difference = largest_distance(&recover_joints(&features), &joints);
        assert!(difference < 1e-5, "{difference}");

        // The features were made from one frame more than the joints have, so headings that the
        // end is smoothed into are not quite the same.
        let untouched = joints.len() - 80;
        for found in [
            features_of_processed(&joints).expect("a clip"),
            features_of_joints(&joints).expect("a clip"),
        ] {
            let pairs = found.iter().zip(&features).take(untouched);
            for (frame, (found, expected)) in pairs.enumerate() {
                for column in 0..HUMANML3D_WIDTH {
                    let apart = (found[column] - expected[column]).abs();
                    assert!(apart < 2e-5, "column {column} of frame {frame}: {apart}");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn any_numbers_give_features_or_an_error(
            size in prop::sample::select(vec![1e-12, 1.0, 1e9, 1e200, f64::INFINITY]),
            frames in prop::collection::vec(prop::array::uniform32(-1.0..1.0f64), 0..40),
        ) {
            let joints: Vec<Joints> = frames
                .iter()
                .map(|numbers| {
                    let number = |at: usize| size * numbers[at % numbers.len()];
                    std::array::from_fn(|joint| {
                        DVec3::new(number(joint), number(joint + 7), number(3 * joint + 1))
                    })
                })
                .collect();
            let found = [features_of_joints(&joints), features_of_processed(&joints)];
            for features in found.into_iter().flatten() {
                prop_assert_eq!(features.len() + 1, joints.len());
                prop_assert!(features.as_flattened().iter().all(|value| value.is_finite()));
            }
        }

        /// Joints come back from positions and from rotations, however the body moves.
        #[test]
        fn features_hold_the_processed_joints(
            frames in prop::collection::vec(
                prop::array::uniform22(prop::array::uniform3(-1.0..1.0f64)),
                2..40,
            ),
        ) {
            let mut joints: Vec<Joints> = frames
                .iter()
                .map(|frame| frame.map(DVec3::from_array))
                .collect();
            // A body that turns its back from one frame to the next has the published half-angle,
            // which loses the turn. These face the front: hips and shoulders are far apart.
            let wide = [(1, 20.0), (2, -20.0), (13, 20.0), (14, -20.0), (16, 60.0), (17, -60.0)];
            for frame in &mut joints {
                for (joint, x) in wide {
                    frame[joint].x += x;
                }
            }
            prop_assume!(features_of_joints(&joints).is_ok());
            let processed = process_joints(&joints, &UNIFORM_BONES).expect("bones");
            let features = features_of_joints(&joints).expect("bones");
            let count = features.len();
            let found = largest_distance(&recover_joints(&features), &processed[..count]);
            // The root's path is a sum of up to 40 steps of a metre in f32.
            prop_assert!(found < 1e-4, "{found}");
            let by_rotations = recover_joints_from_rotations(&features, &UNIFORM_BONES);
            let found = largest_distance(&by_rotations, &processed[..count]);
            prop_assert!(found < 1e-4, "{found}");
        }
    }

    /// Where the body stands and faces in the world does not matter.
    #[test]
    fn the_features_do_not_depend_on_place_or_facing() {
        let recorded = read("humanml3d_random0");
        let source = joints(&recorded, "in.joints");
        let turn = DQuat::from_rotation_y(1.1);
        let moved: Vec<Joints> = source
            .iter()
            .map(|frame| frame.map(|point| turn * point + DVec3::new(3.0, 0.4, -2.0)))
            .collect();
        let (here, there) = (
            features_of_joints(&source).expect("a clip"),
            features_of_joints(&moved).expect("a clip"),
        );
        for (a, b) in here.iter().flatten().zip(there.iter().flatten()) {
            // Coordinates of a few metres in f64 leave about 1e-15; the features are f32.
            assert!((a - b).abs() < 1e-6, "{a} and {b}");
        }
    }

    #[test]
    fn what_has_no_direction_is_an_error_that_names_it() {
        let recorded = read("humanml3d_random0");
        let mut source = joints(&recorded, "in.joints");
        assert_eq!(
            features_of_joints(&source[..1]),
            Err(FeatureError::TooShort { frames: 1 })
        );
        source[4][7] = source[4][4];
        assert_eq!(
            features_of_joints(&source),
            Err(FeatureError::NoDirection { joint: 7, frame: 4 })
        );
        source[2][9].y = f64::NAN;
        assert_eq!(
            features_of_joints(&source),
            Err(FeatureError::NoDirection { joint: 9, frame: 2 })
        );
    }

    #[test]
    fn a_bone_against_its_rest_direction_turns_by_half() {
        // Thighs straight up, hips crossed over and feet backwards: bones against all three axes.
        for joints in [&[4, 5][..], &[1, 2], &[10, 11], &[6, 18]] {
            let mut frame = standing();
            for &joint in joints {
                let bone = -REST_AXES[joint] * UNIFORM_BONES[joint];
                move_bone(&mut frame, joint, bone);
            }
            let features = features_of_processed(&[frame; 3]).expect("a clip");
            let directions = recover_directions(&features);
            for &joint in joints {
                // A direction within 1e-12 of the opposite, in f32.
                let missed = directions[0].1[joint] + REST_AXES[joint];
                assert!(missed.length() < 1e-6, "{joint}: {missed}");
            }
            assert_rotations_are_sound(&features);
        }
    }

    /// A body whose bones are at rest.
    fn standing() -> Joints {
        let mut joints = [DVec3::Y; NUM_BODY_JOINTS];
        for joint in 1..NUM_BODY_JOINTS {
            joints[joint] = joints[PARENTS[joint]] + REST_AXES[joint] * UNIFORM_BONES[joint];
        }
        joints
    }

    /// Replaces the bone that ends in a joint; what hangs from it follows.
    fn move_bone(joints: &mut Joints, moved: usize, bone: DVec3) {
        let before = *joints;
        joints[moved] = joints[PARENTS[moved]] + bone;
        for joint in moved + 1..NUM_BODY_JOINTS {
            joints[joint] = joints[PARENTS[joint]] + before[joint] - before[PARENTS[joint]];
        }
    }

    fn assert_rotations_are_sound(features: &[Features]) {
        for frame in features {
            for column in frame[67..193].chunks_exact(6) {
                let [first, second] = [0, 3].map(|at| {
                    DVec3::new(
                        column[at].into(),
                        column[at + 1].into(),
                        column[at + 2].into(),
                    )
                });
                // Products of a few numbers in f32.
                assert!((first.length() - 1.0).abs() < 1e-5, "{first}");
                assert!((second.length() - 1.0).abs() < 1e-5, "{second}");
                assert!(first.dot(second).abs() < 1e-5, "{first} and {second}");
            }
        }
    }
}
