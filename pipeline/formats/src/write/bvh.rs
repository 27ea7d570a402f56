//! BVH files with the joint names of the CMU motion-capture database.

use std::fmt::Write;

use datasets_spec::{Joint, Motion, Skeleton};
use glam::{DMat3, DQuat, DVec3};

/// Centimetres per metre: the unit of the file.
const CM: f64 = 100.0;

/// A joint of the file.
struct FileJoint {
    name: &'static str,
    /// Index of the parent in [`HIERARCHY`]; the root has none.
    parent: Option<usize>,
    /// The body joint; none for the zero-length joints of the CMU hierarchy at the hips and below the neck.
    joint: Option<Joint>,
    /// The SMPL-X joint at which a chain ends, for the `End Site`.
    end: Option<usize>,
}

const fn joint(
    name: &'static str,
    parent: usize,
    joint: Option<Joint>,
    end: Option<usize>,
) -> FileJoint {
    FileJoint {
        name,
        parent: Some(parent),
        joint,
        end,
    }
}

const fn body(name: &'static str, parent: usize, body: Joint) -> FileJoint {
    joint(name, parent, Some(body), None)
}

const fn fixed(name: &'static str, parent: usize) -> FileJoint {
    joint(name, parent, None, None)
}

const fn tip(name: &'static str, parent: usize, body: Joint, end: usize) -> FileJoint {
    joint(name, parent, Some(body), Some(end))
}

/// SMPL-X joints without a rotation, at the end of a chain.
const LEFT_EYE: usize = 23;
const LEFT_MIDDLE: usize = 28;
const RIGHT_MIDDLE: usize = 43;

/// The joints in the order of the file: depth first, as the format requires.
const HIERARCHY: [FileJoint; 25] = [
    FileJoint {
        name: "Hips",
        parent: None,
        joint: Some(Joint::Pelvis),
        end: None,
    },
    fixed("LHipJoint", 0),
    body("LeftUpLeg", 1, Joint::LeftHip),
    body("LeftLeg", 2, Joint::LeftKnee),
    body("LeftFoot", 3, Joint::LeftAnkle),
    body("LeftToeBase", 4, Joint::LeftFoot),
    fixed("RHipJoint", 0),
    body("RightUpLeg", 6, Joint::RightHip),
    body("RightLeg", 7, Joint::RightKnee),
    body("RightFoot", 8, Joint::RightAnkle),
    body("RightToeBase", 9, Joint::RightFoot),
    body("LowerBack", 0, Joint::Spine1),
    body("Spine", 11, Joint::Spine2),
    body("Spine1", 12, Joint::Spine3),
    fixed("Neck", 13),
    body("Neck1", 14, Joint::Neck),
    tip("Head", 15, Joint::Head, LEFT_EYE),
    body("LeftShoulder", 13, Joint::LeftCollar),
    body("LeftArm", 17, Joint::LeftShoulder),
    body("LeftForeArm", 18, Joint::LeftElbow),
    tip("LeftHand", 19, Joint::LeftWrist, LEFT_MIDDLE),
    body("RightShoulder", 13, Joint::RightCollar),
    body("RightArm", 21, Joint::RightShoulder),
    body("RightForeArm", 22, Joint::RightElbow),
    tip("RightHand", 23, Joint::RightWrist, RIGHT_MIDDLE),
];

/// Distance in metres from the toe joint to the tip of the toes, for which the skeleton has no joint.
const TOE_LENGTH: f64 = 0.06;

/// Encodes a motion as BVH: centimetres, y up, the T-pose of the skeleton as zero pose, rotation channels in the order
/// Z, Y, X of the CMU conversions. Every body joint has a joint in the file, so the only loss is rounding.
pub fn encode(motion: &Motion, skeleton: &Skeleton) -> String {
    // About 8 characters for each of the 3 positions and 75 rotations of a frame.
    let mut out = String::with_capacity(8192 + motion.len() * 8 * 80);
    out.push_str("HIERARCHY\n");
    write_joint(&mut out, skeleton, 0, 0);
    out += &format!(
        "MOTION\nFrames: {}\nFrame Time: {:.9}\n",
        motion.len(),
        1.0 / motion.fps().get()
    );
    for pose in motion.poses() {
        let pelvis = (pose.transl + skeleton.rest(0)) * CM;
        put(
            &mut out,
            format_args!("{:.4} {:.4} {:.4}", pelvis.x, pelvis.y, pelvis.z),
        );
        for file_joint in &HIERARCHY {
            let rotation = file_joint
                .joint
                .map_or(DQuat::IDENTITY, |joint| pose.rotations[joint.index()]);
            let [z, y, x] = euler_zyx(rotation).map(f64::to_degrees);
            put(&mut out, format_args!(" {z:.5} {y:.5} {x:.5}"));
        }
        out.push('\n');
    }
    out
}

fn put(out: &mut String, text: std::fmt::Arguments<'_>) {
    out.write_fmt(text)
        .expect("writing to a string cannot fail");
}

/// Writes a joint and, nested in it, all its children.
fn write_joint(out: &mut String, skeleton: &Skeleton, index: usize, depth: usize) {
    let file_joint = &HIERARCHY[index];
    let indent = "\t".repeat(depth);
    let (kind, channels) = match file_joint.parent {
        None => ("ROOT", "6 Xposition Yposition Zposition"),
        Some(_) => ("JOINT", "3"),
    };
    // The root's position is only in its channels.
    let offset = match (file_joint.parent, file_joint.joint) {
        (Some(_), Some(joint)) => skeleton.offset(joint.index()),
        _ => DVec3::ZERO,
    };
    *out += &format!("{indent}{kind} {}\n{indent}{{\n", file_joint.name);
    write_offset(out, &indent, offset);
    *out += &format!("{indent}\tCHANNELS {channels} Zrotation Yrotation Xrotation\n");
    let mut is_leaf = true;
    for (child, candidate) in HIERARCHY.iter().enumerate() {
        if candidate.parent == Some(index) {
            write_joint(out, skeleton, child, depth + 1);
            is_leaf = false;
        }
    }
    if is_leaf {
        *out += &format!("{indent}\tEnd Site\n{indent}\t{{\n");
        let end = file_joint
            .end
            .map_or(DVec3::Z * TOE_LENGTH, |end| skeleton.offset(end));
        write_offset(out, &format!("{indent}\t"), end);
        *out += &format!("{indent}\t}}\n");
    }
    *out += &format!("{indent}}}\n");
}

fn write_offset(out: &mut String, indent: &str, offset: DVec3) {
    let cm = offset * CM;
    *out += &format!("{indent}\tOFFSET {:.6} {:.6} {:.6}\n", cm.x, cm.y, cm.z);
}

/// Angles `[z, y, x]` in radians with `R = Rz Ry Rx`. If y is a quarter turn, z and x rotate about the same axis, and x
/// is set to zero.
fn euler_zyx(rotation: DQuat) -> [f64; 3] {
    let m = DMat3::from_quat(rotation);
    let cos_y = m.x_axis.x.hypot(m.x_axis.y);
    let y = (-m.x_axis.z).atan2(cos_y);
    // Below this cosine the entries that hold z and x are rounding errors.
    if cos_y < 1e-9 {
        return [(-m.y_axis.x).atan2(m.y_axis.y), y, 0.0];
    }
    [
        m.x_axis.y.atan2(m.x_axis.x),
        y,
        m.y_axis.z.atan2(m.z_axis.z),
    ]
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Pose};
    use kinematics::rotation::{angle_between, from_axis_angle};
    use proptest::prelude::*;

    use super::*;
    use crate::source::release_tests::assert_same_places;

    fn compose([z, y, x]: [f64; 3]) -> DQuat {
        DQuat::from_rotation_z(z) * DQuat::from_rotation_y(y) * DQuat::from_rotation_x(x)
    }

    #[test]
    fn every_body_joint_is_written_once_below_its_parent() {
        for joint in Joint::ALL {
            let at = HIERARCHY
                .iter()
                .position(|file_joint| file_joint.joint == Some(joint))
                .expect("present");
            // Skip the zero-length joints between a joint and its parent.
            let mut above = HIERARCHY[at].parent;
            while let Some(index) = above
                && HIERARCHY[index].joint.is_none()
            {
                above = HIERARCHY[index].parent;
            }
            assert_eq!(
                above.and_then(|index| HIERARCHY[index].joint),
                joint.parent()
            );
            assert_eq!(
                HIERARCHY.iter().filter(|j| j.joint == Some(joint)).count(),
                1
            );
        }
        for (index, file_joint) in HIERARCHY.iter().enumerate() {
            assert!(file_joint.parent.is_none_or(|parent| parent < index));
        }
    }

    #[test]
    fn the_file_has_as_many_numbers_as_it_says() {
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST; 7]).expect("valid");
        let text = encode(&motion, &Skeleton::smplx_neutral());
        let channels: usize = text
            .lines()
            .filter_map(|line| line.trim().strip_prefix("CHANNELS "))
            .map(|line| {
                line.split(' ')
                    .next()
                    .and_then(|n| n.parse::<usize>().ok())
                    .expect("a number")
            })
            .sum();
        assert_eq!(channels, 3 + 3 * HIERARCHY.len());
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        assert_eq!(text.matches("End Site").count(), 5);
        let (_, rows) = text
            .split_once("Frame Time: 0.050000000\n")
            .expect("the rate");
        assert!(text.contains("Frames: 7\n"));
        assert_eq!(rows.lines().count(), 7);
        for row in rows.lines() {
            let numbers: Vec<f64> = row
                .split(' ')
                .map(|number| number.parse().expect("a number"))
                .collect();
            assert_eq!(numbers.len(), channels);
            assert!(
                numbers[3..].iter().all(|&angle| angle == 0.0),
                "the T-pose is zero"
            );
        }
    }

    #[test]
    fn reading_a_written_file_returns_the_motion() {
        let skeleton = Skeleton::smplx_neutral();
        let mut poses = testkit::walk(50);
        features::floor::put_on_floor(&mut poses, Fps::STORE, &skeleton);
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        let bvh = crate::source::bvh::BvhFile::parse(encode(&motion, &skeleton).as_bytes());
        let clip =
            crate::retarget::clip(&bvh.expect("valid"), &crate::source::ReadOptions::default())
                .expect("a body");
        assert_eq!((clip.motion.fps(), clip.motion.len()), (Fps::STORE, 50));
        // The file resolves a micrometre for positions and 1e-7 rad for angles.
        assert_same_places(&clip.motion, &motion, 1e-5);
    }

    #[test]
    fn a_quarter_turn_about_y_is_no_singularity() {
        for angle in [std::f64::consts::FRAC_PI_2, -std::f64::consts::FRAC_PI_2] {
            let rotation = DQuat::from_rotation_y(angle) * DQuat::from_rotation_x(0.3);
            assert!(angle_between(compose(euler_zyx(rotation)), rotation) < 1e-7);
        }
    }

    proptest! {
        #[test]
        fn euler_angles_compose_to_the_rotation(v in prop::array::uniform3(-3.0..3.0f64)) {
            let rotation = from_axis_angle(DVec3::from_array(v));
            prop_assert!(angle_between(compose(euler_zyx(rotation)), rotation) < 1e-7);
        }
    }
}
