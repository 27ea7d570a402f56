use datasets_spec::{BodyPart, Motion, Pose};
use glam::{DQuat, DVec3};
use kinematics::canonical::{WINDOW_FRAMES, canonicalise};
use kinematics::motion::BODY_POSE_WIDTH;
use proptest::prelude::*;

use super::*;
use crate::blend_pose;
use crate::fixture;

const RANGE: Normalizer = Normalizer {
    min: [-1.0, -1.5, -2.0],
    max: [1.0, 1.0, 3.0],
};

/// The window in `f64`, step by step as the contract defines it.
fn reference(mut poses: Vec<Pose>, anchor: Anchor, skeleton: &Skeleton) -> Vec<f32> {
    canonicalise(&mut poses, anchor, skeleton).expect("not empty");
    poses
        .iter()
        .flat_map(|pose| RANGE.normalize(&skeleton.keypoints(pose)))
        .collect()
}

/// Masks of each body part, of no joint, of all joints, and of two parts.
fn masks() -> impl Iterator<Item = BlendMask> {
    BodyPart::ALL.map(BodyPart::mask).into_iter().chain([
        BlendMask::EMPTY,
        BlendMask::FULL,
        BlendMask::of_parts(&[BodyPart::LowerBody, BodyPart::LeftArm]),
    ])
}

fn check_close(got: &[f32], expected: &[f32]) {
    assert_eq!(got.len(), expected.len());
    for (got, expected) in got.iter().zip(expected) {
        // Model units span about a metre; positions of up to 10 m carry 1e-6 m of rounding and
        // a chain of eight f32 rotations about as much.
        assert!((got - expected).abs() < 2e-5, "{got} is not {expected}");
    }
}

fn framed(motion: &Motion, start: usize, count: usize, stride: usize) -> Vec<Frame> {
    let stored = (0..count).map(|frame| {
        let at = start + frame * stride;
        let mut row = [0.0; 6 + BODY_POSE_WIDTH];
        row[..3].copy_from_slice(&motion.transl()[at]);
        row[3..6].copy_from_slice(&motion.global_orient()[at]);
        row[6..].copy_from_slice(&motion.body_pose()[at]);
        row
    });
    let stored: Vec<StoredFrame> = stored.collect();
    let (skeleton, mut frames) = (Skeleton::smplx_neutral(), Vec::new());
    Frame::prepare(&stored, FrameParts::ALL, &skeleton, &mut frames);
    frames
}

#[test]
fn windows_agree_with_the_contract() {
    let skeleton = Skeleton::smplx_neutral();
    let source = fixture::wandering("source", 70);
    let target = fixture::wandering("target", 64);
    // A window of 40 frames needs more than one block of lanes.
    for (mask, window) in masks().flat_map(|mask| [(mask, WINDOW_FRAMES), (mask, 40)]) {
        let stride = if window == WINDOW_FRAMES { 2 } else { 1 };
        for anchor in [Anchor::Pelvis, Anchor::Translation] {
            let (source_start, target_start, alpha) = (11, 4, 0.3f32);
            let frames = |motion: &Motion, start: usize| -> Vec<Pose> {
                (0..window)
                    .map(|i| motion.pose(start + i * stride))
                    .collect()
            };
            let sources = frames(&source, source_start);
            let blended: Vec<Pose> = sources
                .iter()
                .zip(frames(&target, target_start))
                .map(|(s, t)| blend_pose(s, &t, mask, &[alpha.into(); NUM_BODY_JOINTS]))
                .collect();
            let composer = Composer::new(&skeleton, anchor, &RANGE);
            let mut out = vec![0.0; window * FRAME_WIDTH];
            let from = framed(&source, source_start, window, stride);
            composer.original(&from, &mut out);
            check_close(&out, &reference(sources, anchor, &skeleton));
            let to = framed(&target, target_start, window, stride);
            let plan = BlendPlan::new(mask, SlerpRule::Exact);
            composer.blended(&from, &to, &plan, alpha, &mut out);
            check_close(&out, &reference(blended, anchor, &skeleton));
        }
    }
}

/// The first frames of a motion. Numbers of parts that are not requested are NaN.
fn known(motion: &Motion, parts: FrameParts) -> Vec<Frame> {
    const UNKNOWN: Frame = Frame {
        points: [f32::NAN; FRAME_WIDTH + 2 * MARGIN],
        rotations: [[f32::NAN; QUAT]; NUM_BODY_JOINTS],
    };
    let whole = framed(motion, 0, WINDOW_FRAMES, 1);
    let only = |mut frame: Frame| {
        if !parts.points {
            frame.points = UNKNOWN.points;
        }
        for joint in (0..NUM_BODY_JOINTS).filter(|joint| !parts.rotations[*joint]) {
            frame.rotations[joint] = UNKNOWN.rotations[joint];
        }
        frame
    };
    whole.into_iter().map(only).collect()
}

#[test]
fn a_window_needs_no_more_than_the_parts_it_names() {
    let composer = Composer::new(&Skeleton::smplx_neutral(), Anchor::Pelvis, &RANGE);
    let [source, target] = ["source", "target"].map(|name| fixture::wandering(name, 40));
    let [whole, parts] = &mut [(); 2].map(|()| vec![0.0; WINDOW_FRAMES * FRAME_WIDTH]);
    composer.original(&known(&source, FrameParts::ALL), whole);
    composer.original(&known(&source, PARTS_OF_ORIGINAL), parts);
    assert_eq!(whole, parts);
    for mask in masks() {
        let plan = BlendPlan::new(mask, SlerpRule::Exact);
        let named = [Origin::Source, Origin::Target].map(|of| plan.parts_of(of));
        for (out, [from, to]) in [(&mut *whole, [FrameParts::ALL; 2]), (parts, named)] {
            let (from, to) = (known(&source, from), known(&target, to));
            composer.blended(&from, &to, &plan, 0.3, out);
        }
        assert_eq!(whole, parts, "{mask:?}");
    }
}

#[test]
fn only_what_a_mask_touches_is_computed() {
    for mask in [BlendMask::EMPTY, BlendMask::FULL] {
        let plan = BlendPlan::new(mask, SlerpRule::Exact);
        assert!(plan.points.is_empty(), "{mask:?}");
    }
    // Shoulder, elbow, wrist and two knuckles, reached by way of spine and collar.
    let plan = BlendPlan::new(BodyPart::LeftArm.mask(), SlerpRule::Exact);
    assert_eq!(plan.points, [16, 18, 20, 24, 25]);
    assert_eq!(plan.joints, [0, 3, 6, 9, 13, 16, 18, 20]);
    assert_eq!(plan.anchors, [13]);
}

proptest! {
    #[test]
    fn lanes_interpolate_as_the_exact_slerp_does(
        a in prop::array::uniform3(-3.0..3.0f64),
        b in prop::array::uniform3(-3.0..3.0f64),
        near in any::<bool>(),
        alpha in 0.0..=1.0f32,
    ) {
        use kinematics::rotation::{angle_between, from_axis_angle, slerp as exact};
        let a = from_axis_angle(DVec3::from_array(a));
        let b = from_axis_angle(DVec3::from_array(b) * if near { 1e-4 } else { 1.0 });
        let b = if near { a * b } else { b };
        let lanes = |q: DQuat| q.as_quat().to_array().map(|v| [v; LANES]);
        let got = slerp(&lanes(a), &lanes(b), alpha).map(|component| component[0]);
        let got = Quat::from_array(got).as_dquat().normalize();
        // Rotations half a turn apart have no shorter arc; the two may choose differently.
        prop_assume!(a.dot(b).abs() > 1e-3);
        prop_assert!(angle_between(got, exact(a, b, alpha.into())) < 2e-6);
    }
}
