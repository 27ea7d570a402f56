//! BVH files with the joint names of the CMU motion-capture database.

use std::fmt::Write;

use datasets_spec::{Joint, Motion, Skeleton};
use glam::{DMat3, DQuat, DVec3};

/// Centimetres per metre: the unit of the file.
const CM: f64 = 100.0;

/// The joints in the order of the file: depth first, as the format requires. Name, index of the parent (unused for the
/// first joint), and body joint; `None` for the zero-length joints at the hips and below the neck that CMU's hierarchy
/// has.
const HIERARCHY: [(&str, usize, Option<Joint>); 25] = [
    ("Hips", 0, Some(Joint::Pelvis)),
    ("LHipJoint", 0, None),
    ("LeftUpLeg", 1, Some(Joint::LeftHip)),
    ("LeftLeg", 2, Some(Joint::LeftKnee)),
    ("LeftFoot", 3, Some(Joint::LeftAnkle)),
    ("LeftToeBase", 4, Some(Joint::LeftFoot)),
    ("RHipJoint", 0, None),
    ("RightUpLeg", 6, Some(Joint::RightHip)),
    ("RightLeg", 7, Some(Joint::RightKnee)),
    ("RightFoot", 8, Some(Joint::RightAnkle)),
    ("RightToeBase", 9, Some(Joint::RightFoot)),
    ("LowerBack", 0, Some(Joint::Spine1)),
    ("Spine", 11, Some(Joint::Spine2)),
    ("Spine1", 12, Some(Joint::Spine3)),
    ("Neck", 13, None),
    ("Neck1", 14, Some(Joint::Neck)),
    ("Head", 15, Some(Joint::Head)),
    ("LeftShoulder", 13, Some(Joint::LeftCollar)),
    ("LeftArm", 17, Some(Joint::LeftShoulder)),
    ("LeftForeArm", 18, Some(Joint::LeftElbow)),
    ("LeftHand", 19, Some(Joint::LeftWrist)),
    ("RightShoulder", 13, Some(Joint::RightCollar)),
    ("RightArm", 21, Some(Joint::RightShoulder)),
    ("RightForeArm", 22, Some(Joint::RightElbow)),
    ("RightHand", 23, Some(Joint::RightWrist)),
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
        for (.., joint) in HIERARCHY {
            let rotation = joint.map_or(DQuat::IDENTITY, |joint| pose.rotations[joint.index()]);
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
    let (name, _, joint) = HIERARCHY[index];
    let indent = "\t".repeat(depth);
    // The root's position is only in its channels.
    let (kind, channels, offset) = match (index, joint) {
        (0, _) => ("ROOT", "6 Xposition Yposition Zposition", DVec3::ZERO),
        (_, None) => ("JOINT", "3", DVec3::ZERO),
        (_, Some(joint)) => ("JOINT", "3", skeleton.offset(joint.index())),
    };
    *out += &format!("{indent}{kind} {name}\n{indent}{{\n");
    write_offset(out, &indent, offset);
    *out += &format!("{indent}\tCHANNELS {channels} Zrotation Yrotation Xrotation\n");
    let mut is_leaf = true;
    for (child, (_, parent, _)) in HIERARCHY.iter().enumerate().skip(1) {
        if *parent == index {
            write_joint(out, skeleton, child, depth + 1);
            is_leaf = false;
        }
    }
    if is_leaf {
        *out += &format!("{indent}\tEnd Site\n{indent}\t{{\n");
        // SMPL-X joints that the motion does not rotate: an eye, and the first joints of the middle fingers.
        let end = match joint {
            Some(Joint::Head) => skeleton.offset(23),
            Some(Joint::LeftWrist) => skeleton.offset(28),
            Some(Joint::RightWrist) => skeleton.offset(43),
            _ => DVec3::Z * TOE_LENGTH,
        };
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
            let mut slots = HIERARCHY.iter();
            let at = slots.position(|(.., found)| *found == Some(joint));
            let at = at.expect("present");
            // Skip the zero-length joints between a joint and its parent.
            let mut above = HIERARCHY[at].1;
            while HIERARCHY[above].2.is_none() {
                above = HIERARCHY[above].1;
            }
            let parent = HIERARCHY[above].2.filter(|_| at > 0);
            assert_eq!(parent, joint.parent());
            let named = HIERARCHY.iter().filter(|(.., found)| *found == Some(joint));
            assert_eq!(named.count(), 1);
        }
        for (index, (_, parent, _)) in HIERARCHY.iter().enumerate().skip(1) {
            assert!(*parent < index);
        }
    }

    #[test]
    fn the_file_has_as_many_numbers_as_it_says() {
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST; 7]).expect("valid");
        let text = encode(&motion, &Skeleton::smplx_neutral());
        let lines = text.lines().map(str::trim);
        let channels = lines.filter_map(|line| line.strip_prefix("CHANNELS "));
        let counts = channels.map(|line| line.split(' ').next().expect("a number"));
        let channels: usize = counts
            .map(|count| count.parse::<usize>().expect("a number"))
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
            let numbers = row
                .split(' ')
                .map(|number| number.parse().expect("a number"));
            let numbers: Vec<f64> = numbers.collect();
            assert_eq!(numbers.len(), channels);
            let mut angles = numbers[3..].iter();
            assert!(angles.all(|&angle| angle == 0.0), "the T-pose is zero");
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
