//! Carrying a motion from another skeleton over to the body.
//!
//! Rotations are carried joint by joint through a constant rotation per joint; the pelvis
//! follows the middle of the source's hips, scaled by the ratio of the legs, so that feet which
//! stood still keep standing. Bone lengths of the source other than the legs' do not matter.

mod align;
mod joint_map;
mod track;

pub use joint_map::{JOINT_MAPS, JointMap, Mapping};

use datasets_spec::rotation::slerp;
use datasets_spec::skeleton::{NUM_BODY_JOINTS, PARENTS};
use datasets_spec::{Motion, Pose, Skeleton};
use glam::{DQuat, DVec3};

use self::align::{Alignment, SPINE};
use self::track::{Track, leg_length};
use crate::source::bvh::{Bvh, Channel};
use crate::source::{Rejected, RotationSource, SourceClip, floor};

/// Units that BVH files are written in, in metres. The CMU unit is 1/0.45 inch, the scale of the
/// original ASF files, which their conversions kept.
const UNITS: [(&str, f64); 5] = [
    ("metres", 1.0),
    ("CMU units of 5.64 cm", 0.0254 / 0.45),
    ("inches", 0.0254),
    ("centimetres", 0.01),
    ("millimetres", 0.001),
];

/// Retargets a parsed file to the body.
///
/// # Errors
/// `E-BVH-SKELETON` if the file's skeleton is no body, `E-NOT-FINITE` if its joints leave the
/// numbers.
pub fn clip(bvh: &Bvh, skeleton: &Skeleton) -> Result<SourceClip, Rejected> {
    let mapping = Mapping::find(bvh.joints())?;
    let mut notes = vec![format!("skeleton map {}", mapping.name)];
    let absent = mapping.absent();
    if !absent.is_empty() {
        notes.push(format!("not in the source: {}", absent.join(", ")));
    }

    let first_frame = usize::from(starts_with_zero_pose(bvh));
    if first_frame > 0 {
        notes.push("frame 0 is the zero pose and was dropped".to_owned());
    }
    let mut track = Track::follow(bvh, &mapping, first_frame)?;
    let (turn, up_axis) = align::y_up_from_source(mean_up(&track));
    track.turn(turn);
    if up_axis != "y" {
        notes.push(format!("{up_axis} is up in the file"));
    }
    if feet_point_backwards(&track) {
        notes.push(
            "feet point away from where left and right put the front; the names were believed"
                .to_owned(),
        );
    }

    let alignment = match align::by_rest_pose(track.zero_points(), &track, skeleton) {
        Some(alignment) => {
            notes.push("joint frames from the zero pose".to_owned());
            alignment
        }
        None => {
            notes.push(
                "joint frames from the motion, as the zero pose is no standing one".to_owned(),
            );
            align::by_motion(&track, skeleton)
        }
    };
    let body_leg = leg_length(|joint| skeleton.rest(joint));
    let scale = body_leg / track.leg_length();
    notes.push(unit_note(&track, body_leg));

    let mut poses: Vec<Pose> = (0..track.num_frames())
        .map(|frame| body_pose(&track, frame, &alignment, scale, skeleton))
        .collect();
    let fit_error_m = direction_error(&track, &poses, skeleton);
    floor::put_on_floor(&mut poses, bvh.fps(), skeleton);
    let motion = Motion::from_poses(bvh.fps(), &poses)
        .map_err(|error| Rejected::retarget("E-NOT-FINITE", error.to_string()))?;
    Ok(SourceClip {
        motion,
        rotation_source: RotationSource::Retargeted,
        fit_error_m: Some(fit_error_m as f32),
        num_source_frames: bvh.num_frames(),
        first_frame,
        captions: Vec::new(),
        part_captions: Vec::new(),
        action: None,
        style: None,
        license: None,
        notes,
    })
}

/// Whether the first frame is the skeleton's zero pose put before the motion, as in the
/// conversions of the CMU data: nearly all of its rotations are exactly zero, and many of them are
/// not in the next frame.
fn starts_with_zero_pose(bvh: &Bvh) -> bool {
    const NEARLY_ALL: f64 = 0.8;
    const MANY: f64 = 0.25;
    if bvh.num_frames() < 3 {
        return false;
    }
    let share_of_zeros = |frame: usize| {
        let values = bvh.frame(frame);
        let (mut zeros, mut rotations) = (0usize, 0usize);
        for joint in bvh.joints() {
            for (channel, value) in joint.channels.iter().zip(&values[joint.first_channel..]) {
                if matches!(channel, Channel::Rotation(_)) {
                    rotations += 1;
                    zeros += usize::from(*value == 0.0);
                }
            }
        }
        zeros as f64 / rotations.max(1) as f64
    };
    let zeros = share_of_zeros(0);
    zeros >= NEARLY_ALL && zeros - share_of_zeros(1) >= MANY
}

/// The direction from the hips to the head or neck, averaged over the frames.
fn mean_up(track: &Track) -> DVec3 {
    let top = if track.is_located(15) { 15 } else { 12 };
    let sum: DVec3 = (0..track.num_frames())
        .map(|frame| {
            let points = track.points(frame);
            (points[top] - points[1].midpoint(points[2])).normalize_or_zero()
        })
        .sum();
    sum / track.num_frames() as f64
}

/// Whether feet point to where, by the names of the sides, the back is.
fn feet_point_backwards(track: &Track) -> bool {
    let ahead: f64 = (0..track.num_frames())
        .map(|frame| {
            let points = track.points(frame);
            let forward = (points[1] - points[2]).cross(DVec3::Y).normalize_or_zero();
            [(7, 10), (8, 11)]
                .into_iter()
                .filter(|&(_, foot)| track.is_located(foot))
                .map(|(ankle, foot)| {
                    forward.dot((points[foot] - points[ankle]).normalize_or_zero())
                })
                .sum::<f64>()
        })
        .sum();
    ahead < 0.0
}

/// Says which unit the leg's length speaks for. The unit is of no consequence: the motion is
/// scaled by the ratio of the legs.
fn unit_note(track: &Track, body_leg: f64) -> String {
    /// A leg within this factor of the body's own is a person's.
    const PLAUSIBLE: f64 = 1.45;
    let misfit = |metres: f64| (track.leg_length() * metres / body_leg).ln().abs();
    let (name, metres) = UNITS.into_iter().fold(UNITS[0], |best, unit| {
        if misfit(unit.1) < misfit(best.1) {
            unit
        } else {
            best
        }
    });
    let leg = track.leg_length();
    if misfit(metres) > PLAUSIBLE.ln() {
        return format!("unit unknown (a leg measures {leg:.3}), scaled to the body's leg");
    }
    format!(
        "unit {name} (a leg measures {leg:.3}, that is {:.2} m)",
        leg * metres
    )
}

/// The body's pose in a frame, at the height the scaled source has.
fn body_pose(
    track: &Track,
    frame: usize,
    alignment: &Alignment,
    scale: f64,
    skeleton: &Skeleton,
) -> Pose {
    let source = track.rotations(frame);
    let mut global = [DQuat::IDENTITY; NUM_BODY_JOINTS];
    for joint in 0..NUM_BODY_JOINTS {
        global[joint] = if track.is_mapped(joint) {
            source[joint] * alignment[joint]
        } else {
            unmapped(track, &global, source, alignment, joint, skeleton)
        };
    }
    let mut rotations = global;
    for joint in 1..NUM_BODY_JOINTS {
        rotations[joint] = (global[parent(joint)].inverse() * global[joint]).normalize();
    }
    // The hips are followed, not the pelvis joint, whose place in the pelvis every skeleton
    // chooses differently: with it, feet would slide whenever the pelvis tilts.
    let points = track.points(frame);
    let hips_middle = points[1].midpoint(points[2]) * scale;
    let body_hips_middle = skeleton.offset(1).midpoint(skeleton.offset(2));
    let pelvis = hips_middle - global[0] * body_hips_middle;
    Pose {
        transl: pelvis - skeleton.rest(0),
        rotations,
    }
}

/// The global rotation of a joint the source lacks: between its neighbours in spine and neck,
/// otherwise that of its parent.
fn unmapped(
    track: &Track,
    global: &[DQuat; NUM_BODY_JOINTS],
    source: &[DQuat; NUM_BODY_JOINTS],
    alignment: &Alignment,
    joint: usize,
    skeleton: &Skeleton,
) -> DQuat {
    let below = parent(joint);
    let above = match joint {
        12 => Some(15),
        _ => SPINE
            .into_iter()
            .filter(|_| SPINE.contains(&joint))
            .find(|&other| other > joint && track.is_mapped(other)),
    };
    match above.filter(|&above| track.is_mapped(above)) {
        Some(above) => {
            let height = |joint: usize| skeleton.rest(joint).y;
            let share = (height(joint) - height(below)) / (height(above) - height(below));
            slerp(global[below], source[above] * alignment[above], share)
        }
        None => global[below],
    }
}

fn parent(joint: usize) -> usize {
    usize::try_from(PARENTS[joint]).unwrap_or(0)
}

/// Mean distance in metres between the body's joints and the source's, the latter with every bone
/// in its own direction but of the body's length. Both start from the same hips, which are rigid
/// parts of the pelvis.
fn direction_error(track: &Track, poses: &[Pose], skeleton: &Skeleton) -> f64 {
    let mut sum = 0.0;
    let mut count = 0usize;
    for (frame, pose) in poses.iter().enumerate() {
        let points = track.points(frame);
        let body = skeleton.keypoints(pose);
        let mut placed: [Option<DVec3>; NUM_BODY_JOINTS] = [None; NUM_BODY_JOINTS];
        placed[..3].copy_from_slice(&[Some(body[0]), Some(body[1]), Some(body[2])]);
        for joint in 3..NUM_BODY_JOINTS {
            if !track.is_located(joint) {
                continue;
            }
            let mut ancestor = parent(joint);
            let start = loop {
                match placed[ancestor] {
                    Some(point) => break point,
                    None => ancestor = parent(ancestor),
                }
            };
            let Some(direction) = (points[joint] - points[ancestor]).try_normalize() else {
                continue;
            };
            let length = skeleton.rest(joint).distance(skeleton.rest(ancestor));
            let point = start + direction * length;
            placed[joint] = Some(point);
            sum += point.distance(body[joint]);
            count += 1;
        }
    }
    if count == 0 { 0.0 } else { sum / count as f64 }
}

#[cfg(test)]
pub(crate) mod tests {
    use datasets_spec::Fps;
    use datasets_spec::rotation::{angle_between, from_axis_angle};
    use glam::EulerRot;
    use proptest::prelude::*;

    use super::*;
    use crate::check::check;

    /// How a test file says what the body does.
    pub(crate) struct Dialect {
        /// Metres of the file's unit.
        pub(crate) metres: f64,
        /// The file's world, seen from y up.
        pub(crate) source_from_y_up: DQuat,
        /// Frame of each joint within the body's own.
        pub(crate) joint_frames: [DQuat; NUM_BODY_JOINTS],
    }

    impl Default for Dialect {
        fn default() -> Self {
            Self {
                metres: 1.0,
                source_from_y_up: DQuat::IDENTITY,
                joint_frames: [DQuat::IDENTITY; NUM_BODY_JOINTS],
            }
        }
    }

    impl Dialect {
        /// Joint frames turned every way, as rigs do that lay bones along x.
        fn scrambled() -> Self {
            Self {
                metres: 0.01,
                joint_frames: std::array::from_fn(|joint| {
                    from_axis_angle(DVec3::new(1.0, -0.7, 0.4) * (0.9 + 0.35 * joint as f64))
                }),
                ..Self::default()
            }
        }

        /// The poses of a SMPL-X body as a file.
        pub(crate) fn write(&self, poses: &[Pose], skeleton: &Skeleton) -> String {
            let names = JOINT_MAPS[0].source_names;
            let mut text = "HIERARCHY\n".to_owned();
            self.write_joint(0, skeleton, &names, &mut text);
            text += &format!("MOTION\nFrames: {}\nFrame Time: 0.0333333\n", poses.len());
            for pose in poses {
                let pelvis = self.source_from_y_up * (pose.transl + skeleton.rest(0)) / self.metres;
                text += &format!("{:.9} {:.9} {:.9}", pelvis.x, pelvis.y, pelvis.z);
                for joint in joint_order(0) {
                    let outer = match joint {
                        0 => self.source_from_y_up,
                        _ => self.joint_frames[parent(joint)].inverse(),
                    };
                    let local = outer * pose.rotations[joint] * self.joint_frames[joint];
                    let (z, x, y) = local.to_euler(EulerRot::ZXY);
                    for angle in [z, x, y] {
                        text += &format!(" {:.9}", angle.to_degrees());
                    }
                }
                text += "\n";
            }
            text
        }

        fn write_joint(
            &self,
            joint: usize,
            skeleton: &Skeleton,
            names: &[&str; NUM_BODY_JOINTS],
            text: &mut String,
        ) {
            let (keyword, offset, positions) = match joint {
                0 => ("ROOT", DVec3::ZERO, "6 Xposition Yposition Zposition"),
                _ => {
                    let in_parent = self.joint_frames[parent(joint)].inverse();
                    (
                        "JOINT",
                        in_parent * skeleton.offset(joint) / self.metres,
                        "3",
                    )
                }
            };
            *text += &format!(
                "{keyword} {}\n{{\nOFFSET {:.9} {:.9} {:.9}\n\
                 CHANNELS {positions} Zrotation Xrotation Yrotation\n",
                names[joint], offset.x, offset.y, offset.z
            );
            for child in (1..NUM_BODY_JOINTS).filter(|&child| parent(child) == joint) {
                self.write_joint(child, skeleton, names, text);
            }
            *text += "}\n";
        }
    }

    /// The joints depth first, the order a hierarchy lists them in.
    fn joint_order(joint: usize) -> Vec<usize> {
        let mut order = vec![joint];
        for child in (1..NUM_BODY_JOINTS).filter(|&child| parent(child) == joint) {
            order.extend(joint_order(child));
        }
        order
    }

    /// A body that walks on the spot of its own advance: legs and arms swing, knees and elbows
    /// bend, the trunk turns and leans a little.
    pub(crate) fn walk(num_frames: usize) -> Vec<Pose> {
        (0..num_frames)
            .map(|frame| {
                let phase = 0.25 * frame as f64;
                let (sin, cos) = phase.sin_cos();
                let mut pose = Pose {
                    transl: DVec3::new(
                        0.02 * cos,
                        1.2 + 0.02 * (2.0 * phase).sin(),
                        0.03 * frame as f64,
                    ),
                    ..Pose::REST
                };
                let mut set = |joint: usize, x: f64, y: f64, z: f64| {
                    pose.rotations[joint] = from_axis_angle(DVec3::new(x, y, z));
                };
                set(0, 0.05 * cos, 0.15 * sin, 0.03);
                set(3, 0.05, 0.05 * cos, 0.0);
                set(9, 0.02 * sin, -0.15 * sin, 0.0);
                set(15, 0.1 * cos, 0.1 * sin, 0.0);
                set(1, -0.5 * sin, 0.0, 0.02);
                set(2, 0.5 * sin, 0.0, -0.02);
                set(4, 0.6 + 0.5 * cos, 0.0, 0.0);
                set(5, 0.6 - 0.5 * cos, 0.0, 0.0);
                set(16, 0.0, -0.5 * sin, -1.1);
                set(17, 0.0, -0.5 * sin, 1.1);
                set(18, 0.0, -0.9 - 0.3 * sin, 0.0);
                set(19, 0.0, 0.9 - 0.3 * sin, 0.0);
                pose
            })
            .collect()
    }

    fn retarget(text: &str) -> SourceClip {
        let bvh = Bvh::parse(text.as_bytes()).expect("the test writes valid files");
        clip(&bvh, &Skeleton::smplx_neutral()).expect("the test writes bodies")
    }

    fn assert_same_motion(clip: &SourceClip, poses: &[Pose]) {
        assert_eq!(clip.motion.len(), poses.len());
        let lift = f64::from(clip.motion.transl()[0][1]) - poses[0].transl.y;
        for (found, expected) in clip.motion.poses().zip(poses) {
            for joint in 0..NUM_BODY_JOINTS {
                let angle = angle_between(found.rotations[joint], expected.rotations[joint]);
                assert!(angle < 1e-6, "joint {joint} differs by {angle} rad");
            }
            // f32 near 3 m resolves 2.4e-7 m.
            assert!((found.transl - expected.transl - DVec3::Y * lift).length() < 1e-6);
        }
    }

    #[test]
    fn the_bodys_own_skeleton_comes_back_unchanged() {
        let skeleton = Skeleton::smplx_neutral();
        let poses = walk(40);
        let clip = retarget(&Dialect::default().write(&poses, &skeleton));
        assert_same_motion(&clip, &poses);
        assert!(clip.fit_error_m.expect("retargeted") < 1e-6);
        assert_eq!(clip.rotation_source, RotationSource::Retargeted);
    }

    #[test]
    fn unit_and_up_axis_do_not_matter() {
        let skeleton = Skeleton::smplx_neutral();
        let poses = walk(40);
        for (metres, unit) in [
            (0.01, "centimetres"),
            (0.0254, "inches"),
            (0.0254 / 0.45, "CMU"),
        ] {
            let dialect = Dialect {
                metres,
                source_from_y_up: DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
                ..Dialect::default()
            };
            let clip = retarget(&dialect.write(&poses, &skeleton));
            assert_same_motion(&clip, &poses);
            assert!(
                clip.notes.iter().any(|note| note.contains(unit)),
                "{:?}",
                clip.notes
            );
            assert!(clip.notes.iter().any(|note| note == "z is up in the file"));
        }
    }

    #[test]
    fn joint_frames_are_found_from_the_motion_where_the_zero_pose_means_nothing() {
        let skeleton = Skeleton::smplx_neutral();
        let poses = walk(120);
        let clip = retarget(&Dialect::scrambled().write(&poses, &skeleton));
        assert!(
            clip.notes
                .iter()
                .any(|note| note.contains("from the motion")),
            "{:?}",
            clip.notes
        );
        for (found, expected) in clip.motion.poses().zip(&poses) {
            let (found_points, expected_points) =
                (skeleton.keypoints(&found), skeleton.keypoints(expected));
            // Limb bones point exactly where they point in the source.
            for (joint, child) in [(1, 4), (4, 7), (2, 5), (16, 18), (18, 20), (19, 21)] {
                let bone = |points: &[DVec3]| (points[child] - points[joint]).normalize();
                let angle = bone(&found_points).angle_between(bone(&expected_points));
                assert!(angle < 1e-5, "bone {joint}-{child} is off by {angle} rad");
            }
            // Twist and trunk are estimates: the rest pelvis leans by 5 degrees to one side and
            // the rest spine by up to 11 degrees to the back, which no position tells.
            let (found_global, expected_global) = (
                skeleton.global_rotations(&found),
                skeleton.global_rotations(expected),
            );
            for joint in 0..NUM_BODY_JOINTS {
                let angle = angle_between(found_global[joint], expected_global[joint]);
                assert!(angle < 0.3, "joint {joint} is off by {angle} rad");
            }
        }
    }

    #[test]
    fn a_leading_zero_pose_is_dropped() {
        let skeleton = Skeleton::smplx_neutral();
        let mut poses = walk(20);
        poses[0].rotations = Pose::REST.rotations;
        let clip = retarget(&Dialect::default().write(&poses, &skeleton));
        assert_eq!(
            (clip.first_frame, clip.motion.len(), clip.num_source_frames),
            (1, 19, 20)
        );
    }

    #[test]
    fn feet_that_stand_keep_standing_on_longer_legs() {
        let skeleton = Skeleton::smplx_neutral();
        // The pelvis sways over feet that stay: a body of another size does the same.
        let poses: Vec<Pose> = (0..40)
            .map(|frame| {
                let bend = 0.4 + 0.2 * (0.3 * f64::from(frame)).sin();
                let mut pose = Pose::REST;
                for (hip, knee, ankle) in [(1, 4, 7), (2, 5, 8)] {
                    pose.rotations[hip] = DQuat::from_rotation_x(-bend);
                    pose.rotations[knee] = DQuat::from_rotation_x(2.0 * bend);
                    pose.rotations[ankle] = DQuat::from_rotation_x(-bend);
                }
                let ankles = skeleton.keypoints(&pose);
                pose.transl = -ankles[7].midpoint(ankles[8]);
                pose
            })
            .collect();
        let dialect = Dialect {
            metres: 0.5,
            ..Dialect::default()
        };
        let clip = retarget(&dialect.write(&poses, &skeleton));
        let quality = check(&clip.motion, &skeleton).expect("a valid motion");
        // Both legs of the body differ in length by a centimetre, so the midpoint of the ankles
        // stays while each ankle moves a little.
        assert!(quality.foot_skate < 0.02, "{}", quality.foot_skate);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn no_edit_of_a_file_makes_it_panic(
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
            digits in prop::collection::vec(any::<prop::sample::Index>(), 0..8),
            scrambled in any::<bool>(),
        ) {
            let skeleton = Skeleton::smplx_neutral();
            let dialect = if scrambled { Dialect::scrambled() } else { Dialect::default() };
            let mut bytes = dialect.write(&walk(4), &skeleton).into_bytes();
            for (at, byte) in edits {
                let at = at.index(bytes.len());
                bytes[at] = byte;
            }
            // Exponents in the place of digits keep the file valid and its numbers absurd.
            for at in digits {
                let at = at.index(bytes.len());
                if bytes[at].is_ascii_digit() {
                    bytes[at] = b'e';
                }
            }
            if let Ok(clip) = Bvh::parse(&bytes).and_then(|bvh| clip(&bvh, &skeleton)) {
                prop_assert!(clip.motion.fps() <= Fps::new(1e4).expect("valid"));
                prop_assert!(clip.fit_error_m.is_some());
            }
        }
    }
}
