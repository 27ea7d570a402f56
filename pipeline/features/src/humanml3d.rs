//! The 263 features per frame of HumanML3D, from the joints of any motion and back.
//!
//! The published preparation brings a clip to a uniform skeleton, puts it on the floor and turns it to face +z; then a
//! frame becomes root motion, joint positions, joint rotations, joint velocities and foot contacts, all relative to the
//! heading of the root. Its quirks are part of the recipe, because the output must be equal:
//!
//! * the heading comes from a forward vector in which the hips are swapped and the shoulders are not, smoothed by a
//!   Gaussian with a standard deviation of 20 frames;
//! * the first frame counts as facing +z, whatever its forward vector says;
//! * the chains of the arms start from the root's rotation, not from that of the chest;
//! * the yaw velocity is half of the turn from frame to frame.
//!
//! For a bone exactly opposite to its rest direction, the published code divides by zero; here the rotation is a half
//! turn about a perpendicular axis.
//!
//! # Source
//! EricGuo5513/HumanML3D, notebook `motion_representation` and `common/skeleton.py`.

mod blocks;
mod headings;
mod recipe;

use datasets_spec::{Motion, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::skeleton::{NUM_BODY_JOINTS, parent_of};

use self::blocks::{Clip, Placement};
use self::headings::Headings;
pub use self::recipe::{FPS, FeatureError, Features, GROUPS, Joints, RECIPE, UNIFORM_BONES};
use self::recipe::{
    LEFT_HIP, LEFT_SHOULDER, RELATIVE_TO, REST_AXES, RIGHT_ANKLE, RIGHT_HIP, RIGHT_KNEE,
    RIGHT_SHOULDER, SHORTEST_BONE_M,
};

/// The 22 body joints of every frame of a motion, in metres.
pub fn joints_of_motion(motion: &Motion, skeleton: &Skeleton) -> Vec<Joints> {
    skeleton.points_of_frames(motion, 0..motion.len())
}

/// The features of world joints by the whole recipe.
///
/// # Shapes
/// `T` frames in, `T - 1` out: velocities need the next frame.
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

/// Retargets world joints to the given bone lengths, puts them on the floor at y = 0, and puts the first
/// frame at x = z = 0, facing +z.
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

/// Gives every bone its length in `bones` and keeps its direction; scales the path of the root by
/// the ratio of the right leg's lengths, the old one measured in the first frame.
fn unified(joints: &[Joints], bones: &[f64; NUM_BODY_JOINTS]) -> Result<Clip, FeatureError> {
    let Some(first) = joints.first() else {
        return Err(FeatureError::TooShort { frames: 0 });
    };
    let leg = |joint: usize| (first[joint] - first[parent_of(joint)]).length();
    let scale = (bones[RIGHT_KNEE] + bones[RIGHT_ANKLE]) / (leg(RIGHT_KNEE) + leg(RIGHT_ANKLE));
    let mut clip = Clip::gather(joints);
    clip.unify(bones, scale)?;
    Ok(clip)
}

/// Placement of a clip of at least one frame: on the floor, its first frame at x = z = 0 and facing +z. Hips and
/// shoulders give the facing, without the swap.
fn start(clip: &Clip) -> Placement {
    let first = clip.frame(0);
    let across = first[RIGHT_HIP] - first[LEFT_HIP] + first[RIGHT_SHOULDER] - first[LEFT_SHOULDER];
    let origin = first[0].with_y(clip.lowest());
    Placement::new(origin, across.cross(DVec3::NEG_Y))
}

/// The features of a clip of at least two frames.
fn features_of(clip: &Clip, placement: Placement) -> Vec<Features> {
    let mut forwards = clip.forwards();
    for forward in &mut forwards {
        *forward = placement.turned(*forward);
    }
    clip.features(placement, &Headings::of(&forwards))
}

/// The rotation about the vertical from the root's heading to +z, as cosine and sine of the half-angle.
#[derive(Clone, Copy, Debug)]
struct Heading {
    half_cosine: f64,
    half_sine: f64,
}

impl Heading {
    fn quaternion(self) -> DQuat {
        DQuat::from_xyzw(0.0, self.half_sine, 0.0, self.half_cosine)
    }

    /// Rotates a vector from the frame of this heading to the world.
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

/// World joints from the joint positions among the features.
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

/// World direction of each bone, from the rotations among the features of a frame.
fn directions_of(frame: &Features, heading: Heading) -> Joints {
    let mut rotations = [DMat3::from_quat(heading.quaternion()); NUM_BODY_JOINTS];
    for joint in 1..NUM_BODY_JOINTS {
        let six_d: [f64; 6] = std::array::from_fn(|k| frame[67 + 6 * (joint - 1) + k].into());
        let local = kinematics::rotation::from_six_d_columns(six_d);
        rotations[joint] = rotations[RELATIVE_TO[joint]] * local;
    }
    std::array::from_fn(|joint| rotations[joint] * REST_AXES[joint])
}

/// Position of the root and directions of the bones in the world, from the rotations among the features.
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
                let bone = points[joint] - points[parent_of(joint)];
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
    use std::path::Path;

    use datasets_spec::record::HUMANML3D_WIDTH;
    use proptest::prelude::*;

    use super::*;
    use crate::golden::{Recorded, read};
    use pickle::npy::{Array, read_numbers};

    const CASES: [&str; 4] = [
        "humanml3d_random0",
        "humanml3d_random1",
        "humanml3d_sample012314",
        "humanml3d_spin_then_still",
    ];

    fn joints(recorded: &Recorded, key: &str) -> Vec<Joints> {
        let tensor = recorded.get(key);
        assert!(tensor.shape.ends_with(&[NUM_BODY_JOINTS, 3]), "{key}");
        let frames = tensor.values.chunks_exact(3 * NUM_BODY_JOINTS);
        let joints =
            |frame: &[f64]| std::array::from_fn(|joint| DVec3::from_slice(&frame[3 * joint..]));
        frames.map(joints).collect()
    }

    fn features(recorded: &Recorded, key: &str) -> Vec<Features> {
        let (rows, _) = recorded.get(key).values.as_chunks::<HUMANML3D_WIDTH>();
        rows.iter()
            .map(|row| row.map(|value| value as f32))
            .collect()
    }

    /// World joints from the rotations of the features, on a skeleton of the given bone lengths.
    fn recover_joints_from_rotations(
        features: &[Features],
        bones: &[f64; NUM_BODY_JOINTS],
    ) -> Vec<Joints> {
        let recovered = recover_directions(features).into_iter();
        recovered
            .map(|(root, directions)| {
                let mut joints = [root; NUM_BODY_JOINTS];
                for joint in 1..NUM_BODY_JOINTS {
                    joints[joint] = joints[parent_of(joint)] + directions[joint] * bones[joint];
                }
                joints
            })
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
                // Both have the nine digits of an f32.
                let uniform = REST_AXES[joint] * UNIFORM_BONES[joint];
                assert!(offsets[joint].distance(uniform) < 1e-9, "{case}: {joint}");
            }
        }
    }

    fn largest_distance(a: &[Joints], b: &[Joints]) -> f64 {
        assert_eq!(a.len(), b.len());
        let pairs = a.iter().flatten().zip(b.iter().flatten());
        let apart = pairs.map(|(a, b)| (*a - *b).abs().max_element());
        apart.fold(0.0, f64::max)
    }

    #[test]
    fn golden_humanml3d_processing_and_features_follow_the_notebook() {
        for case in CASES {
            let recorded = read(case);
            let source = joints(&recorded, "in.joints");
            let uniform = unified(&source, &bones(&recorded)).expect("every bone has a length");
            let uniform = uniform.placed(Placement::new(DVec3::ZERO, DVec3::Z));
            // The published code goes through f32 quaternions.
            let difference = largest_distance(&uniform, &joints(&recorded, "out.uniform"));
            assert!(difference < 1e-5, "{case}: {difference}");
            let processed = process_joints(&source, &bones(&recorded)).expect("a clip");
            let expected = joints(&recorded, "out.global_positions");
            let difference = largest_distance(&processed, &expected);
            assert!(difference < 1e-5, "{case}: {difference}");
            let found = features_of_processed(&processed);
            let expected = features(&recorded, "out.features");
            assert_eq!(found.len(), expected.len(), "{case}");
            for (frame, (found, expected)) in found.iter().zip(&expected).enumerate() {
                for (name, range) in GROUPS {
                    for column in range {
                        let difference = (found[column] - expected[column]).abs();
                        let tolerance = if column < 259 { 2e-5 } else { 0.0 };
                        let place = format!("{case}: {name}, column {column} of frame {frame}");
                        assert!(difference <= tolerance, "{place}: {difference}");
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
            let found = features(&recorded, "out.features");
            let headings = recover_root(&found).into_iter().map(|(heading, _)| heading);
            for ((frame, heading), points) in found.iter().zip(headings).zip(&processed) {
                let directions = directions_of(frame, heading);
                for joint in 1..NUM_BODY_JOINTS {
                    let bone = (points[joint] - points[parent_of(joint)]).normalize();
                    // Rounding of eight consecutive rotations in f32.
                    assert!(directions[joint].distance(bone) < 2e-5, "{case}: {joint}");
                }
            }
        }
    }

    /// Features of joints that are on the uniform skeleton, on the floor and facing +z already.
    fn features_of_processed(joints: &[Joints]) -> Vec<Features> {
        let clip = Clip::gather(joints);
        features_of(&clip, Placement::new(DVec3::ZERO, DVec3::Z))
    }

    fn published(folder: &Path, name: &str) -> Array {
        let bytes = std::fs::read(folder.join(name)).expect("a published file");
        read_numbers(name, &bytes).expect("an array")
    }

    /// The published clip: its joints and its features belong together.
    #[test]
    fn published_joints_and_features_follow_from_each_other() {
        let Some(folder) = testkit::test_data("humanml3d") else {
            return;
        };
        let joints = published(&folder, "new_joints/012314.npy");
        let (points, _) = joints.values.as_chunks::<3>();
        let (frames, _) = points.as_chunks::<NUM_BODY_JOINTS>();
        let joints = frames.iter().map(|frame| frame.map(DVec3::from_array));
        let joints: Vec<Joints> = joints.collect();
        let features = published(&folder, "new_joint_vecs/012314.npy");
        let (rows, _) = features.values.as_chunks::<HUMANML3D_WIDTH>();
        let rows = rows.iter().map(|row| row.map(|value| value as f32));
        let features: Vec<Features> = rows.collect();
        let difference = largest_distance(&recover_joints(&features), &joints);
        assert!(difference < 1e-5, "{difference}");

        // The features were made from one frame more than the joints, so headings within the smoothing radius of the
        // end differ a little.
        let untouched = joints.len() - 80;
        for found in [
            features_of_processed(&joints),
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
            if let Ok(features) = features_of_joints(&joints) {
                prop_assert_eq!(features.len() + 1, joints.len());
                prop_assert!(features.as_flattened().iter().all(|value| value.is_finite()));
            }
        }

        /// Positions and rotations both reproduce the joints, however the body moves.
        #[test]
        fn features_hold_the_processed_joints(
            frames in prop::collection::vec(
                prop::array::uniform22(prop::array::uniform3(-1.0..1.0f64)),
                2..40,
            ),
        ) {
            let joints = frames.iter().map(|frame| frame.map(DVec3::from_array));
            let mut joints: Vec<Joints> = joints.collect();
            // If a body turns around between two frames, the published half-angle loses the turn. Wide hips and
            // shoulders keep these bodies facing the front.
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

    /// The position and heading of the body do not matter.
    #[test]
    fn the_features_do_not_depend_on_place_or_facing() {
        let recorded = read("humanml3d_random0");
        let source = joints(&recorded, "in.joints");
        let turn = DQuat::from_rotation_y(1.1);
        let moved = |point: DVec3| turn * point + DVec3::new(3.0, 0.4, -2.0);
        let moved: Vec<Joints> = source.iter().map(|frame| frame.map(moved)).collect();
        let [here, there] =
            [&source, &moved].map(|joints| features_of_joints(joints).expect("a clip"));
        for (a, b) in here.iter().flatten().zip(there.iter().flatten()) {
            // Coordinates of a few metres in f64 leave about 1e-15; the features are f32.
            assert!((a - b).abs() < 1e-6, "{a} and {b}");
        }
    }

    #[test]
    fn what_has_no_direction_is_an_error_that_names_it() {
        let recorded = read("humanml3d_random0");
        let mut source = joints(&recorded, "in.joints");
        let error = |source: &[Joints]| features_of_joints(source).expect_err("no direction");
        assert_eq!(error(&source[..1]), FeatureError::TooShort { frames: 1 });
        source[4][7] = source[4][4];
        let (joint, frame) = (7, 4);
        assert_eq!(error(&source), FeatureError::NoDirection { joint, frame });
        source[2][9].y = f64::NAN;
        let (joint, frame) = (9, 2);
        assert_eq!(error(&source), FeatureError::NoDirection { joint, frame });
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
            let features = features_of_processed(&[frame; 3]);
            let directions = recover_directions(&features);
            for &joint in joints {
                // The direction is at most 1e-12 from the opposite, and is rounded to f32.
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
            joints[joint] = joints[parent_of(joint)] + REST_AXES[joint] * UNIFORM_BONES[joint];
        }
        joints
    }

    /// Replaces the bone that ends in a joint; the joint's descendants move along.
    fn move_bone(joints: &mut Joints, moved: usize, bone: DVec3) {
        let before = *joints;
        joints[moved] = joints[parent_of(moved)] + bone;
        for joint in moved + 1..NUM_BODY_JOINTS {
            joints[joint] = joints[parent_of(joint)] + before[joint] - before[parent_of(joint)];
        }
    }

    fn assert_rotations_are_sound(features: &[Features]) {
        for frame in features {
            for column in frame[67..193].chunks_exact(6) {
                let (first, second) = column.split_at(3);
                let [first, second] =
                    [first, second].map(|part| glam::Vec3::from_slice(part).as_dvec3());
                // Products of a few numbers in f32.
                assert!((first.length() - 1.0).abs() < 1e-5, "{first}");
                assert!((second.length() - 1.0).abs() < 1e-5, "{second}");
                assert!(first.dot(second).abs() < 1e-5, "{first} and {second}");
            }
        }
    }
}
