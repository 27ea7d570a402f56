//! Retargeting a motion from another skeleton to the body.
//!
//! Rotations are mapped by a constant rotation per joint. The pelvis follows the midpoint of the source's hips, scaled
//! by the ratio of leg lengths, so that planted feet stay planted. Other bone lengths of the source have no effect.

mod align;
mod confidence;
mod joint_map;
mod rig;
mod topology;
mod track;
mod unit;
mod user_map;

pub(crate) use joint_map::bare;
pub use joint_map::{Mapping, Origin};
pub(crate) use rig::with_ancestors;
pub use rig::{Bone, Placed, Rest, Rig};
pub(crate) use unit::body_height;
pub use user_map::{UserMap, UserMapError};

use datasets_spec::{Motion, Pose, Skeleton};
use glam::{DQuat, DVec3};
use kinematics::MotionBuilder;
use kinematics::rotation::slerp;
use kinematics::skeleton::{NUM_BODY_JOINTS, parent_of};

pub(crate) use self::align::up_of_source;
use self::align::{Alignment, SPINE};
use self::confidence::Evidence;
use self::track::{Track, TrackRest, leg_length};
use self::user_map::RestPose;
use crate::source::ReadOptions;
use crate::source::Up;
use clip::check::{
    FLAG_REFERENCE_DROPPED, FLAG_SIDES_DOUBTFUL, FLAG_SKELETON_GUESSED, FLAG_UP_DOUBTFUL,
};
use clip::{Rejected, RotationSource, SourceClip};
use features::floor;

/// Retargets a parsed file to the body of the options. The user's joint map takes precedence over
/// known ones if the file has its joints.
///
/// # Errors
/// [`Rig::skeleton_code`] if the skeleton is not a body, `E-NOT-FINITE` if joint positions are not finite, `E-UNIT` if
/// the skeleton's size is not a person's in the user's unit.
pub fn clip(rig: &impl Rig, options: &ReadOptions) -> Result<SourceClip, Rejected> {
    let (skeleton, joint_map) = (&options.skeleton, options.user_map.as_ref());
    let bones = rig.bones();
    let rests = rig.rests();
    let reject = |reason: String| Rejected::retarget(rig.skeleton_code(), reason);
    let mapping = Mapping::find(&bones, &rests, joint_map).map_err(reject)?;
    // The user's unit, axes and rest pose apply to files that the map fits.
    let user_map = joint_map.filter(|_| mapping.origin == Origin::User);
    let mut track = Track::follow(rig, &bones, &rests, &mapping)?;
    let from_rest = by_rest(&track, user_map.and_then(|map| map.rest), skeleton);
    let mut notes = vec![if mapping.is_guess() {
        let evidence = Evidence::gather(&mapping, &bones, &track, from_rest.is_some());
        trust(&evidence, &mapping).map_err(reject)?
    } else {
        format!("skeleton map {}", mapping.name)
    }];
    let absent = mapping.absent();
    if !absent.is_empty() {
        notes.push(format!("not in the source: {}", absent.join(", ")));
    }
    if let Some(map) = joint_map.filter(|_| user_map.is_none()) {
        notes.push(format!(
            "the joint map {} does not fit the file",
            map.name()
        ));
    }
    if rig.frames().start > 0 {
        notes.push("frame 0 is the zero pose and was dropped".to_owned());
    }
    let named = options.up.filter(|_| rig.up().is_none());
    let stated_up = named
        .or(user_map.and_then(|map| map.up))
        .or_else(|| rig.up());
    let is_up_doubtful = set_upright(&mut track, stated_up, &mut notes);
    let facing_note = facing_note(&track, mapping.origin);
    let are_sides_doubtful = facing_note.is_some();
    notes.extend(facing_note);
    let (alignment, origin) = from_rest.unwrap_or_else(|| {
        let alignment = align::by_motion(&track, skeleton);
        (alignment, "motion, as the zero pose is no standing one")
    });
    notes.push(format!("joint frames from the {origin}"));
    let body_leg = leg_length(|joint| skeleton.rest(joint));
    notes.push(unit::note(rig, &track, body_leg, user_map, options)?);

    let carrier = Carrier {
        track: &track,
        alignment,
        scale: body_leg / track.leg_length,
        skeleton,
    };
    let (motion, error_m) = carrier.carry(rig, &bones)?;
    let mut clip = SourceClip::new(motion, RotationSource::Retargeted);
    clip.fit_error_m = Some(error_m as f32);
    clip.source_frames = rig.frames();
    if clip.source_frames.start > 0 {
        clip.flags |= FLAG_REFERENCE_DROPPED;
    }
    let doubts = [
        (FLAG_UP_DOUBTFUL, is_up_doubtful),
        (FLAG_SIDES_DOUBTFUL, are_sides_doubtful),
        (FLAG_SKELETON_GUESSED, mapping.origin == Origin::Topology),
    ];
    for (flag, _) in doubts.iter().filter(|(_, doubtful)| *doubtful) {
        clip.flags |= flag;
    }
    clip.notes = notes;
    Ok(clip)
}

/// The alignment by the first pose that shows a standing person, and the pose's name; `None` if there is no such pose.
fn by_rest(
    track: &Track,
    stated: Option<RestPose>,
    skeleton: &Skeleton,
) -> Option<(Alignment, &'static str)> {
    let align = |rest: &TrackRest| {
        align::by_rest_pose(rest, track, skeleton).map(|alignment| (alignment, rest.name))
    };
    match stated {
        Some(RestPose::FirstFrame) => align(&track.first_frame()),
        Some(RestPose::ZeroPose) | None => track.rests.iter().find_map(align),
    }
}

/// The note on a guessed map, or the reason why the map is rejected.
fn trust(evidence: &Evidence, mapping: &Mapping) -> Result<String, String> {
    let confidence = evidence.confidence();
    if confidence < confidence::LEAST {
        return Err(format!(
            "guessed the skeleton {} with confidence {confidence:.2}, expected at least {:.2}: {}; \
             a joint map says which joint is which",
            mapping.name,
            confidence::LEAST,
            evidence.doubts(mapping)
        ));
    }
    Ok(format!(
        "skeleton map guessed with confidence {confidence:.2}: {}",
        mapping.name
    ))
}

/// Rotates a track to y up, with a note if another axis was up. Returns whether the axis is doubtful: nobody stated it, and
/// either the person rarely stands upright, or the axis is not y and a standing zero pose has another.
fn set_upright(track: &mut Track, stated_up: Option<Up>, notes: &mut Vec<String>) -> bool {
    let (up, is_clear) = match stated_up {
        Some(up) => (up, true),
        None => {
            let (up, is_clear) = align::up_of_source(mean_up(track));
            let of_rest = align::up_of_rests(track);
            (
                up,
                is_clear && (up == Up::Y || of_rest.is_none_or(|rest| rest == up)),
            )
        }
    };
    if up != Up::Y {
        track.turn(up.turn());
        notes.push(format!("{up} is up in the file"));
    } else if !is_clear {
        notes.push(
            "y was taken for the up axis, although the person does not stand along it".to_owned(),
        );
    }
    !is_clear
}

/// A note if the feet point backwards, given which side is left and which is right.
fn facing_note(track: &Track, origin: Origin) -> Option<String> {
    let believed = match origin {
        Origin::Topology => "build",
        Origin::User | Origin::Dialect | Origin::Words => "names",
    };
    feet_point_backwards(track).then(|| {
        format!(
            "feet point away from where left and right put the front; the {believed} of the \
             skeleton decided"
        )
    })
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

/// Whether the feet point backwards, given which side is left and which is right.
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

/// Retargets the frames of a track to the body.
struct Carrier<'a> {
    track: &'a Track,
    alignment: Alignment,
    scale: f64,
    skeleton: &'a Skeleton,
}

/// A bone of the source that is compared with the body's.
struct Compared {
    joint: usize,
    /// The nearest ancestor that the source has a position for.
    from: usize,
    /// The bone's length in the body in metres.
    length: f64,
}

impl Carrier<'_> {
    /// Returns the motion, and the mean distance in metres between the joints of the body and those of the source after
    /// its bones are rescaled to the body's lengths. Both start from the same hips, which are rigid parts of the
    /// pelvis.
    fn carry(&self, rig: &impl Rig, bones: &[Bone<'_>]) -> Result<(Motion, f64), Rejected> {
        /// Number of poses held in double precision at a time.
        const AT_ONCE: usize = 1024;
        let num_frames = rig.frames().len();
        let offsets: [DVec3; NUM_BODY_JOINTS] =
            std::array::from_fn(|joint| self.skeleton.offset(joint));
        let compared = self.compared();
        let mut builder = MotionBuilder::with_capacity(num_frames);
        let mut poses = Vec::with_capacity(AT_ONCE);
        let mut feet = Vec::with_capacity(num_frames);
        let mut error = 0.0;
        self.track
            .every_frame(rig, bones, &mut |rotations, points| {
                let global = self.global_rotations(rotations);
                let body = self.joints(points, &global, &offsets);
                error += self.direction_error(points, &body, &compared);
                feet.push(floor::FOOT_JOINTS.map(|joint| body[joint]));
                poses.push(Pose {
                    transl: body[0] - self.skeleton.rest(0),
                    rotations: std::array::from_fn(|joint| match joint {
                        0 => global[0],
                        _ => global[parent_of(joint)].conjugate() * global[joint],
                    }),
                });
                if poses.len() == AT_ONCE {
                    builder.extend(&poses);
                    poses.clear();
                }
            });
        builder.extend(&poses);
        builder.raise(floor::shift(&feet, rig.fps()));
        let motion = builder
            .build(rig.fps())
            .map_err(|error| Rejected::retarget("E-NOT-FINITE", error.to_string()))?;
        let count = (num_frames * compared.len()).max(1);
        Ok((motion, error / count as f64))
    }

    /// Global rotations of the body in a frame.
    fn global_rotations(&self, source: &[DQuat; NUM_BODY_JOINTS]) -> [DQuat; NUM_BODY_JOINTS] {
        let mut global = [DQuat::IDENTITY; NUM_BODY_JOINTS];
        for joint in 0..NUM_BODY_JOINTS {
            global[joint] = if self.track.is_mapped(joint) {
                source[joint] * self.alignment[joint]
            } else {
                self.unmapped(&global, source, joint)
            };
        }
        global
    }

    /// The global rotation of a joint that the source lacks: interpolated between its neighbours in spine and neck,
    /// otherwise its parent's.
    fn unmapped(
        &self,
        global: &[DQuat; NUM_BODY_JOINTS],
        source: &[DQuat; NUM_BODY_JOINTS],
        joint: usize,
    ) -> DQuat {
        let below = parent_of(joint);
        let above = match joint {
            12 => Some(15),
            _ => SPINE
                .into_iter()
                .filter(|_| SPINE.contains(&joint))
                .find(|&other| other > joint && self.track.is_mapped(other)),
        };
        match above.filter(|&above| self.track.is_mapped(above)) {
            Some(above) => {
                let height = |joint: usize| self.skeleton.rest(joint).y;
                let share = (height(joint) - height(below)) / (height(above) - height(below));
                slerp(global[below], source[above] * self.alignment[above], share)
            }
            None => global[below],
        }
    }

    /// Positions of the body's joints in a frame in metres, at the height of the scaled source.
    ///
    /// The body follows the hips, not the pelvis joint: skeletons place that joint differently, and feet would slide
    /// whenever the pelvis tilts.
    fn joints(
        &self,
        points: &[DVec3; NUM_BODY_JOINTS],
        global: &[DQuat; NUM_BODY_JOINTS],
        offsets: &[DVec3; NUM_BODY_JOINTS],
    ) -> [DVec3; NUM_BODY_JOINTS] {
        let hips_middle = points[1].midpoint(points[2]) * self.scale;
        let pelvis = hips_middle - global[0] * offsets[1].midpoint(offsets[2]);
        let mut body = [pelvis; NUM_BODY_JOINTS];
        for joint in 1..NUM_BODY_JOINTS {
            let above = parent_of(joint);
            body[joint] = body[above] + global[above] * offsets[joint];
        }
        body
    }

    fn compared(&self) -> Vec<Compared> {
        let is_placed = |joint: usize| joint < 3 || self.track.is_located(joint);
        (3..NUM_BODY_JOINTS)
            .filter(|&joint| self.track.is_located(joint))
            .map(|joint| {
                let mut from = parent_of(joint);
                while !is_placed(from) {
                    from = parent_of(from);
                }
                let length = self.skeleton.rest(joint).distance(self.skeleton.rest(from));
                Compared {
                    joint,
                    from,
                    length,
                }
            })
            .collect()
    }

    /// Sum of the distances in one frame for [`Carrier::carry`]. A bone without a direction in the source counts as
    /// equal to the body's.
    fn direction_error(
        &self,
        points: &[DVec3; NUM_BODY_JOINTS],
        body: &[DVec3; NUM_BODY_JOINTS],
        compared: &[Compared],
    ) -> f64 {
        let mut placed = *body;
        let mut sum = 0.0;
        for bone in compared {
            if let Some(direction) = (points[bone.joint] - points[bone.from]).try_normalize() {
                placed[bone.joint] = placed[bone.from] + direction * bone.length;
            }
            sum += placed[bone.joint].distance(body[bone.joint]);
        }
        sum
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use datasets_spec::{Fps, Joint, Pose};
    use kinematics::rotation::angle_between;
    use proptest::prelude::*;

    use testkit::walk;

    use super::joint_map::JOINT_MAPS;
    use super::*;
    use crate::source::bvh::BvhFile;
    use crate::source::bvh::dialects::{RigText, carried, read_text};
    use crate::source::release_tests::{assert_notes, assert_refused, assert_says, edited};
    use clip::check::check;

    fn with_map(map: &UserMap) -> ReadOptions {
        ReadOptions {
            user_map: Some(map.clone()),
            ..ReadOptions::default()
        }
    }

    /// A joint map of all joints, with further JSON fields.
    fn map_of(name: impl Fn(Joint) -> String, fields: &str) -> UserMap {
        let joints = Joint::ALL.map(|joint| format!("{:?}: {:?}", joint.name(), name(joint)));
        let joints = joints.join(", ");
        let map = format!(r#"{{"name": "mine", "joints": {{{joints}}}, {fields}}}"#);
        UserMap::parse(&map).expect("a map")
    }

    fn z_up() -> RigText {
        RigText {
            source_from_y_up: DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
            ..RigText::smplx()
        }
    }

    pub(crate) fn assert_same_motion(clip: &SourceClip, poses: &[Pose]) {
        assert_eq!(clip.motion.len(), poses.len());
        let lift = f64::from(clip.motion.transl()[0][1]) - poses[0].transl.y;
        for (found, expected) in clip.motion.poses().into_iter().zip(poses) {
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
        // The second motion has more frames than a track holds, and z up. It repeats a short walk: far from the origin,
        // f32 is too coarse for the comparison.
        let long = walk(60).into_iter().cycle().take(9_000).collect();
        for (rig, poses) in [(RigText::smplx(), walk(40)), (z_up(), long)] {
            let clip = carried(&rig, &poses);
            assert_same_motion(&clip, &poses);
            assert!(clip.fit_error_m.expect("retargeted") < 1e-6);
            assert_eq!(clip.rotation_source, RotationSource::Retargeted);
        }
    }

    #[test]
    fn unit_and_up_axis_do_not_matter() {
        let poses = walk(40);
        for (metres, unit) in [
            (0.01, "centimetres"),
            (0.0254, "inches"),
            (0.0254 / 0.45, "CMU"),
        ] {
            let clip = carried(&RigText { metres, ..z_up() }, &poses);
            assert_same_motion(&clip, &poses);
            assert_says(&clip, unit);
            assert_notes(&clip, "z is up in the file");
        }
    }

    #[test]
    fn joint_frames_are_found_from_the_motion_where_the_zero_pose_means_nothing() {
        let skeleton = Skeleton::smplx_neutral();
        let poses = walk(120);
        let clip = carried(&RigText::scrambled(), &poses);
        assert_says(&clip, "from the motion");
        for (found, expected) in clip.motion.poses().into_iter().zip(&poses) {
            let (found_points, expected_points) =
                (skeleton.keypoints(&found), skeleton.keypoints(expected));
            // Limb bones have exactly the source's directions.
            for (joint, child) in [(1, 4), (4, 7), (2, 5), (16, 18), (18, 20), (19, 21)] {
                let bone = |points: &[DVec3]| (points[child] - points[joint]).normalize();
                let angle = bone(&found_points).angle_between(bone(&expected_points));
                assert!(angle < 1e-5, "bone {joint}-{child} is off by {angle} rad");
            }
            // Twist and trunk are estimates: the rest pelvis leans by 5 degrees to one side and the rest spine by up to
            // 11 degrees to the back, which positions cannot show.
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

    /// The file with other names for its joints.
    fn renamed(text: &str, name: impl Fn(usize) -> String) -> String {
        let mut text = text.to_owned();
        for (joint, old) in JOINT_MAPS[0].source_names().enumerate() {
            text = text.replace(&format!(" {old}\n"), &format!(" {}\n", name(joint)));
        }
        text
    }

    /// Joint names of no known dialect, whose words identify the joints.
    fn wordy(joint: usize) -> String {
        let names = "rig_pelvis thigh.L thigh.R low shin.L shin.R mid foot.L foot.R top toe.L toe.R neck clavicle.L \
                     clavicle.R head upper_arm.L upper_arm.R forearm.L forearm.R hand.L hand.R";
        let mut names = names.split(' ');
        names.nth(joint).expect("22 names").to_owned()
    }

    fn rejected(text: &str) -> Rejected {
        read_text(text).expect_err("no body")
    }

    #[test]
    fn guessed_names_give_the_same_motion_and_say_how_sure_they_are() {
        let poses = walk(40);
        let text = RigText::smplx().write(&poses);
        let clip = read_text(&renamed(&text, wordy)).expect("a body");
        assert_same_motion(&clip, &poses);
        assert_eq!(
            clip.notes[0],
            "skeleton map guessed with confidence 1.00: by words in names, 22 of 22 joints found"
        );
        let nameless = renamed(&text, |joint| format!("b{joint}"));
        let nameless = read_text(&nameless).expect("a body");
        assert_same_motion(&nameless, &poses);
        let said = &nameless.notes[0];
        assert!(said.contains("confidence 0.80"), "{said}");
    }

    #[test]
    fn a_beast_with_human_names_is_refused() {
        // The hips stay bent, so the trunk is horizontal over the legs. The zero pose is arbitrary.
        let poses: Vec<Pose> = walk(40)
            .into_iter()
            .map(|mut pose| {
                pose.rotations[0] = DQuat::from_rotation_x(1.6);
                for hip in [1, 2] {
                    pose.rotations[hip] = DQuat::from_rotation_x(-1.6);
                }
                for joint in [3, 4, 5, 6, 9] {
                    pose.rotations[joint] = DQuat::IDENTITY;
                }
                pose
            })
            .collect();
        let text = RigText::scrambled().write(&poses);
        let rejected = rejected(&renamed(&text, wordy));
        assert_eq!(rejected.stage, "retarget");
        assert_refused(&rejected, "E-BVH-SKELETON", "not upright");
    }

    #[test]
    fn the_users_map_comes_first() {
        let poses = walk(40);
        let text = z_up().write(&poses);
        let text = renamed(&text, |joint| format!("b{joint}"));
        let name = |joint: Joint| format!("b{}", joint.index());
        let map = map_of(name, r#""unit": 1.0, "up": "z""#);
        let read = |text: &str| {
            let bvh = BvhFile::parse(text.as_bytes()).expect("valid");
            clip(&bvh, &with_map(&map)).expect("a body")
        };
        let found = read(&text);
        assert_same_motion(&found, &poses);
        assert_eq!(found.notes[0], "skeleton map mine of the user");
        assert_notes(&found, "z is up in the file");
        assert_says(&found, "unit m, as the joint map says");
        // A file without the map's joints is read as if there were no map.
        let other = read(&RigText::smplx().write(&poses));
        assert_eq!(other.notes[0], "skeleton map smplx");
        assert_notes(&other, "the joint map mine does not fit the file");
    }

    #[test]
    fn a_first_frame_that_stands_can_be_the_rest() {
        let mut poses = walk(40);
        poses[0].rotations = Pose::REST.rotations;
        let text = RigText::scrambled().write(&poses);
        let map = map_of(|joint| joint.name().to_owned(), r#""rest": "first-frame""#);
        let bvh = BvhFile::parse(text.as_bytes()).expect("valid");
        let clip = clip(&bvh, &with_map(&map)).expect("a body");
        assert_notes(&clip, "joint frames from the first frame");
        // Without a rest, the twist of scrambled frames is an estimate; with one it is exact.
        assert_same_motion(&clip, &poses);
    }

    #[test]
    fn skeletons_that_are_no_body_are_refused_by_what_is_missing() {
        let text = RigText::smplx().write(&walk(3));
        let twice = rejected(&text.replace("JOINT spine2\n", "JOINT left_knee\n"));
        let words = "found 2 joints named \"left_knee\"";
        assert_refused(&twice, "E-BVH-SKELETON", words);
        let toy = "HIERARCHY ROOT Base { OFFSET 0 0 0 CHANNELS 3 Zrotation Xrotation Yrotation \
                   JOINT End { OFFSET 0 0 15 CHANNELS 3 Zrotation Xrotation Yrotation } } \
                   MOTION Frames: 2 Frame Time: 0.1\n0 0 0 0 0 0\n1 1 1 1 1 1\n";
        let rejected = rejected(toy);
        assert_refused(&rejected, "E-BVH-SKELETON", "left_knee");
    }

    #[test]
    fn bodies_without_size_or_of_absurd_size_are_refused() {
        for (metres, code) in [(1e12, "E-BVH-SKELETON"), (1e-12, "E-NOT-FINITE")] {
            let rig = RigText {
                metres,
                ..RigText::smplx()
            };
            let text = rig.write(&walk(3));
            assert_eq!(rejected(&text).code, code, "{metres}");
        }
    }

    #[test]
    fn a_leading_zero_pose_is_dropped() {
        let mut poses = walk(20);
        poses[0].rotations = Pose::REST.rotations;
        let clip = carried(&RigText::smplx(), &poses);
        assert_eq!((clip.source_frames, clip.motion.len()), (1..20, 19));
        assert_eq!(clip.flags, FLAG_REFERENCE_DROPPED);
    }

    #[test]
    fn feet_that_stand_keep_standing_on_longer_legs() {
        let skeleton = Skeleton::smplx_neutral();
        // The pelvis sways over standing feet; they must also stand on a body of another size.
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
        let rig = RigText {
            metres: 0.5,
            ..RigText::smplx()
        };
        let clip = carried(&rig, &poses);
        let quality = check(&clip.motion, &skeleton).expect("a valid motion");
        // The two legs differ in length by a centimetre, so the midpoint of the ankles is fixed while each ankle moves
        // a little.
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
            let dialect = if scrambled { RigText::scrambled() } else { RigText::smplx() };
            let mut bytes = edited(dialect.write(&walk(4)).as_bytes(), edits);
            // Replacing digits by exponents keeps the file valid but makes its numbers absurd.
            for at in digits {
                let at = at.index(bytes.len());
                if bytes[at].is_ascii_digit() {
                    bytes[at] = b'e';
                }
            }
            if let Ok(clip) = BvhFile::parse(&bytes).and_then(|bvh| clip(&bvh, &ReadOptions::default())) {
                prop_assert!(clip.motion.fps() <= Fps::new(1e4).expect("valid"));
                prop_assert!(clip.fit_error_m.is_some());
            }
        }
    }
}
