//! Spatial blending: a source motion that takes some joints of a target.

use datasets_spec::{BlendMask, Motion, Pose};
use glam::Vec3;
use kinematics::rotation::{from_axis_angle, slerp, slerp_official, to_axis_angle};
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::{Error, SlerpRule};

/// Blends two poses: hard joints follow the target, soft joints are interpolated by their `alpha`, the others follow
/// the source. If the pelvis is hard, the translation is the target's.
///
/// # Shapes
/// `alpha` is `[22]`, the weight of the target on each joint; only those of soft joints are read.
///
/// # Source
/// Paper Sec. 4.2 (BLD), with the exact slerp instead of the released one.
pub fn blend_pose(
    source: &Pose,
    target: &Pose,
    mask: BlendMask,
    alpha: &[f64; NUM_BODY_JOINTS],
) -> Pose {
    let mut blended = *source;
    for joint in mask.hard().iter().map(|joint| joint.index()) {
        blended.rotations[joint] = target.rotations[joint];
    }
    for joint in mask.soft().iter().map(|joint| joint.index()) {
        blended.rotations[joint] = slerp(
            source.rotations[joint],
            target.rotations[joint],
            alpha[joint],
        );
    }
    if mask.moves_root() {
        blended.transl = target.transl;
    }
    blended
}

/// Blends two motions of equal length and rate, all soft joints by the same `alpha`.
///
/// With [`SlerpRule::Exact`], stored numbers are copied, not recomputed: hard joints equal the target's bit for bit,
/// and joints outside the mask equal the source's. An `alpha` of exactly 0 or 1 copies as well.
///
/// # Errors
/// The motions differ in length or rate.
///
/// # Source
/// Paper Sec. 4.2 (BLD).
pub fn blend_motion(
    source: &Motion,
    target: &Motion,
    mask: BlendMask,
    alpha: f64,
    rule: SlerpRule,
) -> Result<Motion, Error> {
    if source.len() != target.len() || source.fps() != target.fps() {
        return Err(Error::Refused(format!(
            "cannot blend {} frames at {} with {} frames at {}; crop and resample them first",
            source.len(),
            source.fps(),
            target.len(),
            target.fps()
        )));
    }
    let mut blended = source.clone();
    for frame in 0..source.len() {
        for joint in mask.hard().iter().map(|joint| joint.index()) {
            blended.set_axis_angle(frame, joint, target.axis_angle(frame, joint));
        }
        for joint in mask.soft().iter().map(|joint| joint.index()) {
            let (from, to) = (
                source.axis_angle(frame, joint),
                target.axis_angle(frame, joint),
            );
            blended.set_axis_angle(frame, joint, blend_axis_angle(from, to, alpha, rule));
        }
        if mask.moves_root() {
            blended.set_transl(frame, target.transl()[frame]);
        }
    }
    Ok(blended)
}

fn blend_axis_angle(from: [f32; 3], to: [f32; 3], alpha: f64, rule: SlerpRule) -> [f32; 3] {
    let quaternion = |v: [f32; 3]| from_axis_angle(Vec3::from_array(v).as_dvec3());
    if rule == SlerpRule::Official {
        let [from, to] = [from, to].map(|v| quaternion(v).as_quat());
        let mixed = slerp_official(from, to, alpha as f32)
            .as_dquat()
            .normalize();
        return to_axis_angle(mixed).as_vec3().to_array();
    }
    if alpha == 0.0 {
        return from;
    }
    if alpha == 1.0 {
        return to;
    }
    to_axis_angle(slerp(quaternion(from), quaternion(to), alpha))
        .as_vec3()
        .to_array()
}

#[cfg(test)]
mod tests {
    use datasets_spec::{BodyPart, Fps, Joint, JointSet};
    use glam::DVec3;
    use kinematics::motion::BODY_POSE_WIDTH;
    use proptest::prelude::*;

    use super::*;

    const FRAMES: usize = 5;

    fn motion() -> impl Strategy<Value = Motion> {
        prop::collection::vec(
            prop::collection::vec(-3.0f32..3.0, 6 + BODY_POSE_WIDTH),
            FRAMES,
        )
        .prop_map(|frames| {
            let [transl, root] = [0, 3].map(|at: usize| {
                let vectors = frames.iter().map(|f| [f[at], f[at + 1], f[at + 2]]);
                vectors.collect()
            });
            let body = frames.iter().map(|f| std::array::from_fn(|i| f[6 + i]));
            Motion::new(Fps::STORE, transl, root, body.collect()).expect("valid")
        })
    }

    fn mask() -> impl Strategy<Value = BlendMask> {
        prop::collection::vec(0..3u8, NUM_BODY_JOINTS).prop_map(|codes| {
            let of = |code| -> JointSet {
                let joints = Joint::ALL.into_iter();
                joints
                    .filter(|joint| codes[joint.index()] == code)
                    .collect()
            };
            BlendMask::new(of(2), of(1)).expect("disjoint")
        })
    }

    proptest! {
        #[test]
        fn an_empty_mask_gives_the_source_and_a_full_one_the_target(
            source in motion(), target in motion(), alpha in 0.0..=1.0f64,
        ) {
            let blend = |mask| blend_motion(&source, &target, mask, alpha, SlerpRule::Exact).expect("in step");
            prop_assert_eq!(&blend(BlendMask::EMPTY), &source);
            prop_assert_eq!(&blend(BlendMask::FULL), &target);
        }

        #[test]
        fn joints_outside_the_mask_and_hard_joints_are_copied_bit_for_bit(
            source in motion(), target in motion(), mask in mask(), alpha in 0.0..=1.0f64,
        ) {
            let blended = blend_motion(&source, &target, mask, alpha, SlerpRule::Exact).expect("in step");
            for frame in 0..FRAMES {
                let root = if mask.moves_root() { &target } else { &source };
                prop_assert_eq!(blended.transl()[frame], root.transl()[frame]);
                for joint in 0..NUM_BODY_JOINTS {
                    let got = blended.axis_angle(frame, joint);
                    if mask.hard().contains(joint) {
                        prop_assert_eq!(got, target.axis_angle(frame, joint));
                    } else if !mask.soft().contains(joint) {
                        prop_assert_eq!(got, source.axis_angle(frame, joint));
                    }
                }
            }
        }

        #[test]
        fn the_ends_of_the_soft_range_are_the_two_motions(
            source in motion(), target in motion(), mask in mask(),
        ) {
            let hard_only = BlendMask::new(mask.hard(), JointSet::EMPTY).expect("disjoint");
            let blend = |mask, alpha| blend_motion(&source, &target, mask, alpha, SlerpRule::Exact).expect("in step");
            prop_assert_eq!(blend(mask, 0.0), blend(hard_only, 0.5));
            // With `alpha` 1, a soft pelvis gets the target's orientation but keeps the source's translation.
            let whole = blend(mask, 1.0);
            for joint in mask.soft().iter() {
                let joint = joint.index();
                prop_assert_eq!(whole.axis_angle(0, joint), target.axis_angle(0, joint));
            }
        }

        #[test]
        fn motions_blend_as_their_poses_do(
            source in motion(), target in motion(), mask in mask(), alpha in 0.0..=1.0f64,
        ) {
            let blended = blend_motion(&source, &target, mask, alpha, SlerpRule::Exact).expect("in step");
            for frame in 0..FRAMES {
                let pose = blend_pose(
                    &source.pose(frame), &target.pose(frame), mask, &[alpha; NUM_BODY_JOINTS],
                );
                for joint in 0..NUM_BODY_JOINTS {
                    let angle = kinematics::rotation::angle_between(
                        pose.rotations[joint], blended.pose(frame).rotations[joint],
                    );
                    // Three roundings to f32 of angles up to pi.
                    prop_assert!(angle < 1e-6);
                }
            }
        }
    }

    #[test]
    fn the_official_rule_averages_what_is_nearly_equal() {
        let pose = |angle: f64| {
            let mut pose = Pose::REST;
            pose.rotations[18] = from_axis_angle(DVec3::X * angle);
            Motion::from_poses(Fps::STORE, &[pose]).expect("finite")
        };
        let mask = BlendMask::new(JointSet::EMPTY, JointSet::of(&[18])).expect("disjoint");
        let angle = |to: f64, alpha: f64, rule: SlerpRule| {
            let blended = blend_motion(&pose(0.0), &pose(to), mask, alpha, rule).expect("in step");
            f64::from(blended.axis_angle(0, 18)[0])
        };
        // A thousandth of a radian apart: the release takes the middle for any weight.
        assert!((angle(1e-3, 0.9, SlerpRule::Official) - 5e-4).abs() < 1e-6);
        assert!((angle(1e-3, 0.9, SlerpRule::Exact) - 9e-4).abs() < 1e-6);
        for rule in [SlerpRule::Official, SlerpRule::Exact] {
            assert!((angle(1.0, 0.3, rule) - 0.3).abs() < 1e-6, "{rule:?}");
        }
    }

    #[test]
    fn motions_out_of_step_are_refused() {
        let still =
            |frames, fps| Motion::from_poses(fps, &vec![Pose::REST; frames]).expect("valid");
        let mask = BodyPart::LeftArm.mask();
        for (frames, fps) in [(4, Fps::STORE), (5, Fps::MODEL)] {
            let (source, target) = (still(5, Fps::STORE), still(frames, fps));
            let blended = blend_motion(&source, &target, mask, 0.5, SlerpRule::Exact);
            let error = blended.expect_err("out of step").to_string();
            assert!(error.starts_with("cannot blend 5 frames"), "{error}");
        }
    }
}
