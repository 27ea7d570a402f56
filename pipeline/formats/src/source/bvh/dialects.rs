//! Writes BVH files for tests: poses of the body in the hierarchies, channels and rest poses of known rigs.

use std::fmt::Write;

use datasets_spec::{Joint, Pose, Skeleton};
use glam::{DQuat, DVec3, EulerRot};
use kinematics::rotation::{angle_between, from_axis_angle};
use kinematics::skeleton::{NUM_BODY_JOINTS, parent_of};

use super::soma::orientation;
use super::*;
use crate::retarget::tests::assert_same_motion;
use crate::source::release_tests::{assert_notes, assert_refused, assert_says};
use testkit::walk;

/// A joint of a rig.
#[derive(Clone)]
pub(crate) struct RigJoint {
    name: String,
    parent: Option<usize>,
    /// Body joint whose position and rotation the joint follows.
    body: usize,
    /// Offset from that joint in metres.
    beyond: DVec3,
    /// Frame of the joint while the body stands in its rest pose.
    frame: DQuat,
    has_positions: bool,
}

/// How to write poses of the body as a BVH file.
pub(crate) struct RigText {
    pub(crate) joints: Vec<RigJoint>,
    /// Length of the file's unit in metres.
    pub(crate) metres: f64,
    /// Rotation from y-up axes to the file's axes.
    pub(crate) source_from_y_up: DQuat,
    pub(crate) order: (EulerRot, [&'static str; 3]),
    /// Whether leaves have an end site.
    pub(crate) ends: bool,
    pub(crate) frame_time: f64,
    /// Whether offsets state a rest rotation too.
    pub(crate) six_numbers: bool,
    /// Pose of the body when all channels of the file are zero. All joint frames are then aligned to the world.
    pub(crate) zero: Option<Pose>,
}

impl RigText {
    /// A rig of joints `NAME:BODY_JOINT` or `NAME:BODY_JOINT:PARENT`, parents first, with all joint frames aligned to
    /// the world. The default parent is the last joint before it with the same body joint, or with the parent of its
    /// body joint.
    fn new(joints: &str) -> Self {
        let mut found: Vec<RigJoint> = Vec::new();
        for joint in joints.split_whitespace() {
            let mut parts = joint.split(':');
            let mut next = || parts.next().unwrap_or_default();
            let (name, body, parent) = (next(), next().parse::<usize>().expect("a joint"), next());
            let is_above = |other: &RigJoint| match parent {
                "" => other.body == body || (body > 0 && other.body == parent_of(body)),
                parent => other.name == parent,
            };
            let parent = found.iter().rposition(is_above);
            found.push(RigJoint {
                name: name.to_owned(),
                parent,
                body,
                beyond: DVec3::ZERO,
                frame: DQuat::IDENTITY,
                has_positions: parent.is_none(),
            });
        }
        Self {
            joints: found,
            metres: 0.01,
            source_from_y_up: DQuat::IDENTITY,
            order: (EulerRot::ZYX, ["Zrotation", "Yrotation", "Xrotation"]),
            ends: true,
            frame_time: 1.0 / 60.0,
            six_numbers: false,
            zero: None,
        }
    }

    /// The body's own skeleton in metres, without end sites.
    pub(crate) fn smplx() -> Self {
        let joints = Joint::ALL.map(|joint| format!("{}:{}", joint.name(), joint.index()));
        Self {
            metres: 1.0,
            order: (EulerRot::ZXY, ["Zrotation", "Xrotation", "Yrotation"]),
            ends: false,
            frame_time: 0.033_333,
            ..Self::new(&joints.join(" "))
        }
    }

    /// The body's own skeleton in centimetres, with arbitrary joint frames, like rigs with bones along x.
    pub(crate) fn scrambled() -> Self {
        let mut rig = Self::smplx();
        rig.metres = 0.01;
        for joint in &mut rig.joints {
            let turn = DVec3::new(1.0, -0.7, 0.4) * (0.9 + 0.35 * joint.body as f64);
            joint.frame = from_axis_angle(turn);
        }
        rig
    }

    /// The rig of BONES-SEED: 77 joints below a static root, no end sites, bones along x.
    pub(crate) fn soma() -> Self {
        let mut rig = Self::new(&soma_joints());
        rig.ends = false;
        rig.frame_time = 1.0 / 120.0;
        rig.joints[1].has_positions = true;
        for index in 1..rig.joints.len() {
            let joint = &rig.joints[index];
            let above = joint.parent.map(|parent| rig.joints[parent].frame);
            let stated = orientation(&joint.name);
            rig.joints[index].frame = stated.or(above).unwrap_or(DQuat::IDENTITY);
            // Joints that the body lacks are placed a little beyond their parent.
            if let Some(parent) = rig.joints[index].parent.filter(|_| index > 1)
                && rig.joints[parent].body == rig.joints[index].body
            {
                rig.joints[index].beyond = rig.joints[parent].beyond + DVec3::new(0.01, 0.02, 0.0);
            }
        }
        rig
    }

    /// The rig of SnapMoGen: pelvis and spine are both children of the root, which has the pelvis's rotation here.
    fn snapmogen() -> Self {
        let mut rig = Self::new(
            "ROOT:0 C_spine0001_bind_JNT:3 C_spine0002_bind_JNT:6 C_spine0003_bind_JNT:9 \
             C_neck0001_bind_JNT:12 C_neck0002_bind_JNT:12 C_head_bind_JNT:15 L_clavicle_bind_JNT:13 \
             L_armUpper0001_bind_JNT:16 L_armLower0001_bind_JNT:18 L_hand0001_bind_JNT:20 \
             R_clavicle_bind_JNT:14 R_armUpper0001_bind_JNT:17 R_armLower0001_bind_JNT:19 \
             R_hand0001_bind_JNT:21 C_pelvis0001_bind_JNT:0 L_legUpper0001_bind_JNT:1 \
             L_legLower0001_bind_JNT:4 L_foot0001_bind_JNT:7 L_foot0002_bind_JNT:10 \
             R_legUpper0001_bind_JNT:2 R_legLower0001_bind_JNT:5 R_foot0001_bind_JNT:8 \
             R_foot0002_bind_JNT:11",
        );
        rig.order = (EulerRot::XYZ, ["Xrotation", "Yrotation", "Zrotation"]);
        rig.frame_time = 0.033_333;
        // The rig is small: a leg of 37 units.
        rig.metres = 0.02;
        rig
    }

    /// The hierarchy of Xsens MVN.
    fn xsens() -> Self {
        let mut rig = Self::new(
            "Hips:0 Chest:3 Chest2:3 Chest3:6 Chest4:9 Neck:12 Head:15 RightCollar:14 RightShoulder:17 \
             RightElbow:19 RightWrist:21 LeftCollar:13 LeftShoulder:16 LeftElbow:18 LeftWrist:20 \
             RightHip:2 RightKnee:5 RightAnkle:8 RightToe:11 LeftHip:1 LeftKnee:4 LeftAnkle:7 LeftToe:10",
        );
        rig.order = (EulerRot::YXZ, ["Yrotation", "Xrotation", "Zrotation"]);
        rig
    }

    /// The joints that Nokov exports, as far as published retargeting configurations name them.
    fn nokov() -> Self {
        Self::new(
            "Hips:0 Spine:3 Spine1:6 Spine2:9 Neck:12 Head:15 LeftShoulder:13 LeftArm:16 LeftForeArm:18 \
             LeftHand:20 RightShoulder:14 RightArm:17 RightForeArm:19 RightHand:21 LeftUpLeg:1 LeftLeg:4 \
             LeftFoot:7 LeftToeBase:10 RightUpLeg:2 RightLeg:5 RightFoot:8 RightToeBase:11",
        )
    }

    /// Writes poses of the neutral body as a file.
    pub(crate) fn write(&self, poses: &[Pose]) -> String {
        let skeleton = Skeleton::smplx_neutral();
        let zero = self.zero.unwrap_or(Pose::REST);
        let zero_rotations = skeleton.global_rotations(&zero);
        // World positions and rotations of the joints for a pose of the body.
        let placed = |pose: &Pose| -> Vec<(DVec3, DQuat)> {
            let points = skeleton.keypoints(pose);
            let rotations = skeleton.global_rotations(pose);
            self.joints
                .iter()
                .enumerate()
                .map(|(index, joint)| {
                    let is_still = joint.parent.is_none()
                        && self
                            .joints
                            .iter()
                            .any(|other| other.parent == Some(index) && other.has_positions);
                    if is_still {
                        return (DVec3::ZERO, DQuat::IDENTITY);
                    }
                    let turned = rotations[joint.body];
                    let frame = match self.zero {
                        Some(_) => turned * zero_rotations[joint.body].inverse(),
                        None => turned * joint.frame,
                    };
                    let point = points[joint.body] + turned * joint.beyond;
                    (self.source_from_y_up * point, self.source_from_y_up * frame)
                })
                .collect()
        };
        let rest = placed(&zero);
        let mut text = "HIERARCHY\n".to_owned();
        self.write_joint(0, &rest, &mut text);
        let _ = writeln!(
            text,
            "MOTION\nFrames: {}\nFrame Time: {:.6}",
            poses.len(),
            self.frame_time
        );
        for pose in poses {
            let world = placed(pose);
            for index in self.depth_first(0) {
                let joint = &self.joints[index];
                let (above, outer) = joint
                    .parent
                    .map_or((DVec3::ZERO, DQuat::IDENTITY), |parent| world[parent]);
                let (point, frame) = world[index];
                if joint.has_positions {
                    let local = outer.inverse() * (point - above) / self.metres;
                    let _ = write!(text, "{:.9} {:.9} {:.9} ", local.x, local.y, local.z);
                }
                let (a, b, c) = (outer.inverse() * frame).to_euler(self.order.0);
                for angle in [a, b, c] {
                    let _ = write!(text, "{:.9} ", angle.to_degrees());
                }
            }
            text.push('\n');
        }
        text
    }

    fn depth_first(&self, joint: usize) -> Vec<usize> {
        let children = (0..self.joints.len()).filter(|&at| self.joints[at].parent == Some(joint));
        std::iter::once(joint)
            .chain(children.flat_map(|child| self.depth_first(child)))
            .collect()
    }

    fn write_joint(&self, index: usize, rest: &[(DVec3, DQuat)], text: &mut String) {
        let joint = &self.joints[index];
        let keyword = if joint.parent.is_none() {
            "ROOT"
        } else {
            "JOINT"
        };
        let offset = joint.parent.map_or(DVec3::ZERO, |parent| {
            let (above, outer) = rest[parent];
            outer.inverse() * (rest[index].0 - above) / self.metres
        });
        let _ = write!(
            text,
            "{keyword} {}\n{{\nOFFSET {:.9} {:.9} {:.9}",
            joint.name, offset.x, offset.y, offset.z
        );
        if self.six_numbers {
            text.push_str(" 0.0 -76.1 25.3");
        }
        let rotations = self.order.1.join(" ");
        let _ = match joint.has_positions {
            true => writeln!(
                text,
                "\nCHANNELS 6 Xposition Yposition Zposition {rotations}"
            ),
            false => writeln!(text, "\nCHANNELS 3 {rotations}"),
        };
        let children: Vec<usize> = (0..self.joints.len())
            .filter(|&at| self.joints[at].parent == Some(index))
            .collect();
        for &child in &children {
            self.write_joint(child, rest, text);
        }
        if children.is_empty() && self.ends {
            text.push_str("End Site\n{\nOFFSET 0 0 0\n}\n");
        }
        text.push_str("}\n");
    }
}

/// The joints of SOMA.
fn soma_joints() -> String {
    let mut joints =
        "Root:0 Hips:0 Spine1:3 Spine2:6 Chest:9 Neck1:12 Neck2:12 Head:15 HeadEnd:15 \
                      Jaw:15:Head LeftEye:15:Head RightEye:15:Head"
            .to_owned();
    let sides = [("Left", 0), ("Right", 1)];
    for (side, right) in sides {
        for (part, body) in [("Shoulder", 13), ("Arm", 16), ("ForeArm", 18), ("Hand", 20)] {
            joints += &format!(" {side}{part}:{}", body + right);
        }
        let hand = 20 + right;
        for finger in ["Thumb", "Index", "Middle", "Ring", "Pinky"] {
            joints += &format!(" {side}Hand{finger}1:{hand}:{side}Hand");
            let bones = if finger == "Thumb" { 3 } else { 4 };
            for bone in 2..=bones {
                joints += &format!(" {side}Hand{finger}{bone}:{hand}");
            }
            joints += &format!(" {side}Hand{finger}End:{hand}");
        }
    }
    let leg = [
        ("Leg", 1),
        ("Shin", 4),
        ("Foot", 7),
        ("ToeBase", 10),
        ("ToeEnd", 10),
    ];
    for (side, right) in sides {
        for (part, body) in leg {
            joints += &format!(" {side}{part}:{}", body + right);
        }
    }
    joints
}

/// Reads the text of a file.
pub(crate) fn read_text(text: &str) -> Result<SourceClip, Rejected> {
    super::read(&mut text.as_bytes(), text.len(), &ReadOptions::default())
}

/// Writes poses as a file of a rig, and reads the file.
pub(crate) fn carried(rig: &RigText, poses: &[Pose]) -> SourceClip {
    read_text(&rig.write(poses)).expect("a body")
}

/// Asserts that the limb bones have the directions of the poses, to within an angle in radians.
fn assert_same_limbs(clip: &SourceClip, poses: &[Pose], radians: f64) {
    let skeleton = Skeleton::smplx_neutral();
    for (found, expected) in clip.motion.poses().iter().zip(poses) {
        let (found, expected) = (skeleton.keypoints(found), skeleton.keypoints(expected));
        for (joint, child) in [(1, 4), (4, 7), (16, 18), (18, 20), (17, 19), (19, 21)] {
            let bone = |points: &[DVec3]| (points[child] - points[joint]).normalize();
            let angle = bone(&found).angle_between(bone(&expected));
            assert!(angle < radians, "bone {joint}-{child}: {angle} rad");
        }
    }
}

#[test]
fn a_soma_file_gives_the_motion_it_was_made_of() {
    let poses = walk(60);
    let rig = RigText::soma();
    assert_eq!(rig.joints.len(), 1 + 77);
    let clip = carried(&rig, &poses);
    assert_same_motion(&clip, &poses);
    assert_notes(&clip, "skeleton map soma");
    assert_notes(&clip, "joint frames from the T-pose of SOMA");
    assert_says(&clip, "unit centimetres");
    assert!((clip.source_fps.get() - 120.0).abs() < 0.01);
}

/// The left arm hangs down and the right forearm is bent upward, so the joint positions are known.
#[test]
fn the_joints_of_a_known_soma_pose_lie_where_they_should() {
    let skeleton = Skeleton::smplx_neutral();
    let mut pose = Pose::REST;
    pose.transl = DVec3::Y;
    pose.rotations[16] = DQuat::from_rotation_z(-std::f64::consts::FRAC_PI_2);
    pose.rotations[19] = DQuat::from_rotation_z(-std::f64::consts::FRAC_PI_2);
    let poses = vec![pose; 3];
    let clip = carried(&RigText::soma(), &poses);
    let points = skeleton.motion_keypoints(&clip.motion).points;
    let along = |from: usize, to: usize| (points[1][to] - points[1][from]).normalize();
    let bone = |from: usize, to: usize| (skeleton.rest(to) - skeleton.rest(from)).normalize();
    let down = DQuat::from_rotation_z(-std::f64::consts::FRAC_PI_2);
    for (from, to, expected) in [
        (16, 18, down * bone(16, 18)),
        (18, 20, down * bone(18, 20)),
        (17, 19, bone(17, 19)),
        (19, 21, down * bone(19, 21)),
    ] {
        let found = along(from, to);
        assert!(found.distance(expected) < 1e-3, "{from}: {found}");
    }
    // The arms of the body at rest deviate from x by 18 degrees.
    assert!(along(16, 18).dot(DVec3::NEG_Y) > 0.9);
    assert!(along(19, 21).dot(DVec3::Y) > 0.9);
    let leg = (points[1][7] - points[1][1]).length();
    let own = (skeleton.rest(4) - skeleton.rest(1)).length()
        + (skeleton.rest(7) - skeleton.rest(4)).length();
    assert!((leg - own).abs() < 0.01, "straight legs: {leg} and {own}");
}

/// The body joints of the first frame of a motion of BONES-SEED (`wave_R_001__A428`, 525 frames): a person stands with
/// hanging arms. The rotations are from the published file.
#[test]
fn a_published_frame_is_a_person_who_stands_with_hanging_arms() {
    let rotations = [
        ("Hips", [89.851_651, 1.141_003, 88.543_564]),
        ("Spine1", [-0.141_876, 0.168_530, -0.103_694]),
        ("Spine2", [-11.037_975, -0.900_962, -0.767_345]),
        ("Chest", [17.457_313, 0.044_661, -2.825_496]),
        ("Neck1", [16.979_912, -0.017_898, 2.683_261]),
        ("Neck2", [-2.527_007, -0.719_679, -0.591_322]),
        ("Head", [-35.779_440, -0.344_489, -1.139_709]),
        ("LeftShoulder", [52.315_137, -102.535_581, -39.264_428]),
        ("LeftArm", [27.356_191, -60.606_509, 17.742_591]),
        ("LeftForeArm", [41.395_422, -0.000_070, -0.000_554]),
        ("LeftHand", [-3.778_348, -0.993_976, 10.699_476]),
        ("RightShoulder", [-156.942_366, -106.606_335, -6.049_941]),
        ("RightArm", [35.968_212, -58.469_296, -2.961_910]),
        ("RightForeArm", [35.169_449, -0.000_116, -0.000_192]),
        ("RightHand", [3.838_318, 0.924_474, 10.391_931]),
        ("LeftLeg", [-175.974_299, -3.457_987, -9.694_062]),
        ("LeftShin", [7.620_133, 0.000_231, 0.000_217]),
        ("LeftFoot", [-78.604_665, 2.736_269, -3.594_857]),
        ("LeftToeBase", [-4.323_744, 1.524_079, 2.148_205]),
        ("RightLeg", [3.448_344, -3.590_051, -10.421_264]),
        ("RightShin", [9.988_567, -0.000_106, 0.000_386]),
        ("RightFoot", [-82.414_228, -7.053_511, -9.643_662]),
        ("RightToeBase", [-3.699_796, 0.600_726, 1.665_398]),
    ];
    let skeleton = Skeleton::smplx_neutral();
    let rig = RigText::soma();
    let text = rig.write(&vec![Pose::REST; 3]);
    let (head, _) = text.split_once("Frame Time: 0.008333\n").expect("a head");
    let mut row = String::new();
    for index in rig.depth_first(0) {
        let joint = &rig.joints[index];
        if joint.has_positions {
            let height = if index == 0 { 0.0 } else { 98.747 };
            let _ = write!(row, "0 {height} 0 ");
        }
        let stated = rotations.iter().find(|(name, _)| *name == joint.name);
        let [z, y, x] = stated.map_or([0.0; 3], |(_, angles)| *angles);
        let _ = write!(row, "{z} {y} {x} ");
    }
    let text = format!("{head}Frame Time: 0.008333\n{row}\n{row}\n{row}\n");
    let clip = read_text(&text).expect("a body");
    let points = &skeleton.motion_keypoints(&clip.motion).points[0];
    let along = |from: usize, to: usize| (points[to] - points[from]).normalize();
    // The head is over the pelvis, the legs stand, and the arms hang.
    assert!(along(0, 15).dot(DVec3::Y) > 0.97);
    for (hip, ankle) in [(1, 7), (2, 8)] {
        assert!(along(hip, ankle).dot(DVec3::NEG_Y) > 0.98);
    }
    for (shoulder, wrist) in [(16, 20), (17, 21)] {
        assert!(along(shoulder, wrist).dot(DVec3::NEG_Y) > 0.8);
    }
    let front = along(2, 1).cross(DVec3::Y);
    assert!(front.dot(DVec3::Z) > 0.95, "faces +z: {front}");
    for (ankle, foot) in [(7, 10), (8, 11)] {
        assert!(along(ankle, foot).dot(front) > 0.7, "the feet point ahead");
    }
    // A relaxed neck: the face looks ahead.
    let head = skeleton.global_rotations(&clip.motion.pose(0))[15];
    assert!((head * DVec3::Z).dot(front) > 0.95, "{}", head * DVec3::Z);
}

#[test]
fn soma_rigs_with_a_standing_zero_pose_are_read_by_it() {
    let skeleton = Skeleton::smplx_neutral();
    let poses = walk(60);
    let mut rig = RigText::soma();
    // An A-pose: arms 45 degrees down.
    let mut zero = Pose::REST;
    zero.transl = DVec3::Y;
    zero.rotations[16] = DQuat::from_rotation_z(-0.785);
    zero.rotations[17] = DQuat::from_rotation_z(0.785);
    rig.zero = Some(zero);
    let clip = carried(&rig, &poses);
    assert_notes(&clip, "skeleton map soma");
    assert_notes(&clip, "joint frames from the zero pose");
    for (found, expected) in clip.motion.poses().iter().zip(&poses) {
        let (found, expected) = (
            skeleton.global_rotations(found),
            skeleton.global_rotations(expected),
        );
        for joint in 0..NUM_BODY_JOINTS {
            // The minimal rotation from rest to the A-pose twists the arms differently.
            let angle = angle_between(found[joint], expected[joint]);
            assert!(angle < 0.15, "joint {joint} is off by {angle} rad");
        }
    }
}

#[test]
fn rest_rotations_beside_offsets_are_soma_s_alone() {
    let poses = walk(20);
    let mut rig = RigText::soma();
    rig.six_numbers = true;
    let clip = carried(&rig, &poses);
    assert_same_motion(&clip, &poses);
    let mut other = RigText::nokov();
    other.six_numbers = true;
    let text = other.write(&poses);
    let rejected = read_text(&text).expect_err("ambiguous");
    assert_refused(&rejected, "E-BVH-SYNTAX", "six numbers");
    let at = rejected.byte_offset.expect("a place") as usize;
    let place = &text[at..at + 20];
    assert!(place.starts_with("0.0 -76.1"), "{place}");
}

#[test]
fn snapmogen_xsens_and_nokov_files_give_the_motion_they_were_made_of() {
    let poses = walk(40);
    for (rig, map) in [
        (RigText::snapmogen(), "snapmogen"),
        (RigText::xsens(), "xsens"),
        (RigText::nokov(), "mixamo"),
    ] {
        let clip = carried(&rig, &poses);
        assert_same_motion(&clip, &poses);
        assert_notes(&clip, &format!("skeleton map {map}"));
        assert_notes(&clip, "joint frames from the zero pose");
    }
}

/// The 3ds Max preset of MVN: arms parallel to the body in the zero pose.
#[test]
fn xsens_files_may_rest_with_hanging_arms() {
    let poses = walk(40);
    let mut rig = RigText::xsens();
    let mut zero = Pose::REST;
    zero.transl = DVec3::Y;
    zero.rotations[16] = DQuat::from_rotation_z(-std::f64::consts::FRAC_PI_2);
    zero.rotations[17] = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
    rig.zero = Some(zero);
    let clip = carried(&rig, &poses);
    assert_notes(&clip, "joint frames from the zero pose");
    assert_same_limbs(&clip, &poses, 0.06);
}

/// Nokov's skeletons have bones along x, as published rotation offsets to robots show, so the zero pose is not a
/// person's.
#[test]
fn nokov_files_with_bones_along_x_are_aligned_by_their_motion() {
    let poses = walk(120);
    let mut rig = RigText::nokov();
    for joint in &mut rig.joints {
        joint.frame = DQuat::from_rotation_z(0.5 * joint.body as f64) * DQuat::from_rotation_y(1.3);
    }
    let clip = carried(&rig, &poses);
    assert_says(&clip, "from the motion");
    assert_same_limbs(&clip, &poses, 1e-5);
}

#[test]
fn a_soma_file_with_wrong_names_or_too_few_rows_is_refused() {
    let text = RigText::soma().write(&walk(4));
    let twice = text.replace("JOINT LeftHandThumb1\n", "JOINT LeftShin\n");
    let rejected = read_text(&twice).expect_err("two left shins");
    assert_refused(&rejected, "E-BVH-SKELETON", "2 joints named \"LeftShin\"");
    let cut = &text[..text.len() * 9 / 10];
    let rejected = read_text(cut).expect_err("truncated");
    assert_eq!(rejected.code, "E-BVH-FRAMES");
    assert!(rejected.byte_offset.is_some());
    let nan = text.replacen("0.008333\n0.0", "0.008333\nnan", 1);
    let rejected = read_text(&nan).expect_err("not a number");
    assert_eq!(rejected.code, "E-BVH-NUMBER");
    assert!(rejected.byte_offset.is_some());
}
