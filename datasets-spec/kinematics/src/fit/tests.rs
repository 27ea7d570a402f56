use glam::{DQuat, DVec3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::body::Step;
use super::tree::TREE;
use super::*;
use crate::rotation::{angle_between, from_axis_angle};
use crate::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS, parent_of};

pub(crate) fn vector(size: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-size..size).prop_map(DVec3::from_array)
}

pub(crate) fn pose(size: f64) -> impl Strategy<Value = Pose> {
    (
        vector(3.0),
        prop::collection::vec(vector(size), NUM_BODY_JOINTS),
    )
        .prop_map(|(transl, turns)| Pose {
            transl,
            rotations: std::array::from_fn(|joint| from_axis_angle(turns[joint])),
        })
}

/// Points displaced by independent Gaussian-like noise of the given standard deviation per axis.
fn noisy(points: &KeypointFrame, sigma_m: f64, seed: u64) -> KeypointFrame {
    let mut rng = Pcg64::seed_from_u64(seed);
    // Twelve uniform numbers minus six have mean 0 and variance 1.
    let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    points.map(|point| point + DVec3::new(normal(), normal(), normal()) * sigma_m)
}

fn furthest(a: &KeypointFrame, b: &KeypointFrame) -> f64 {
    let distances = a.iter().zip(b).map(|(a, b)| a.distance(*b));
    distances.fold(0.0, f64::max)
}

proptest! {
    #[test]
    fn keypoints_of_any_pose_are_recovered_from_any_start(pose in pose(3.0), start in pose(3.0)) {
        let skeleton = Skeleton::smplx_neutral();
        let target = skeleton.keypoints(&pose);
        for start in [None, Some(&start)] {
            let fit = fit_pose(&skeleton, &target, start, &FitOptions::default());
            prop_assert!(furthest(&skeleton.keypoints(&fit.pose), &target) < 1e-6);
            prop_assert!(fit.error_m < 1e-6);
        }
    }

    #[test]
    fn noise_leaves_a_residual_below_its_own_size(pose in pose(1.0), seed in any::<u64>()) {
        let skeleton = Skeleton::smplx_neutral();
        let clean = skeleton.keypoints(&pose);
        let target = noisy(&clean, 0.01, seed);
        let fit = fit_pose(&skeleton, &target, None, &FitOptions::default());
        let noise_m = clean.iter().zip(&target).map(|(a, b)| a.distance(*b)).sum::<f64>()
            / NUM_KEYPOINTS as f64;
        // The fitted body is at least as near as the true one in the mean square; in the mean distance it may be a
        // little farther.
        prop_assert!(fit.error_m < 1.1 * noise_m);
    }

    #[test]
    fn the_fit_of_noisy_points_is_a_minimum(pose in pose(1.0), seed in any::<u64>()) {
        let skeleton = Skeleton::smplx_neutral();
        let target = noisy(&skeleton.keypoints(&pose), 0.01, seed);
        // One pose in five thousand needs more than 20 steps, because a wrist is nearly free.
        let options = FitOptions { max_iterations: 200, ..FitOptions::default() };
        let fitter = Fitter::new(&skeleton, &options);
        let slope = |pose: &Pose| {
            let now = fitter.evaluate(&fitter.body_of(pose), &target, None, 0.0);
            (0..NUM_BODY_JOINTS)
                .map(|joint| {
                    let turn = |&child: &usize| now.bones[child].cross(now.pulls[child]);
                    TREE.children(joint).iter().map(turn).sum::<DVec3>().length()
                })
                .fold(now.pulls[0].length(), f64::max)
        };
        let fit = fit_pose(&skeleton, &target, None, &options);
        // The last step is below 1e-5 m. Convergence is faster than linear, so the remaining slope is a small part of
        // 28 points times 1e-5 m.
        prop_assert!(slope(&fit.pose) < 1e-4);
        prop_assert!(slope(&fitter.pose_of(&fitter.start(&target), None)) > 1e-3);
    }

    #[test]
    fn unobservable_twists_stay_where_they_start(pose in pose(1.0)) {
        let skeleton = Skeleton::smplx_neutral();
        let target = skeleton.keypoints(&pose);
        let fit = fit_pose(&skeleton, &target, Some(&pose), &FitOptions::default());
        for joint in 0..NUM_BODY_JOINTS {
            prop_assert!(angle_between(fit.pose.rotations[joint], pose.rotations[joint]) < 1e-6);
        }
    }

    #[test]
    fn missing_points_do_not_spoil_the_others(pose in pose(1.0)) {
        let skeleton = Skeleton::smplx_neutral();
        let mut target = skeleton.keypoints(&pose);
        let whole = target;
        target[NUM_BODY_JOINTS..].fill(DVec3::splat(100.0));
        let fit = fit_pose(&skeleton, &target, None, &FitOptions::body_joints());
        let points = skeleton.keypoints(&fit.pose);
        for slot in 0..NUM_BODY_JOINTS {
            prop_assert!(points[slot].distance(whole[slot]) < 1e-6);
        }
    }
}

#[test]
fn the_rest_pose_is_its_own_fit() {
    let skeleton = Skeleton::smplx_neutral();
    let target = skeleton.keypoints(&Pose::REST);
    let fit = fit_pose(&skeleton, &target, None, &FitOptions::default());
    assert!(fit.pose.transl.length() < 1e-6);
    for joint in 0..NUM_BODY_JOINTS {
        let off = angle_between(fit.pose.rotations[joint], DQuat::IDENTITY);
        assert!(off < 1e-6, "joint {joint} is off by {off} rad");
    }
}

#[test]
fn knees_and_elbows_bend_as_hinges() {
    let skeleton = Skeleton::smplx_neutral();
    let mut pose = Pose::REST;
    pose.rotations[1] = from_axis_angle(DVec3::new(-0.9, 0.4, 0.1));
    pose.rotations[4] = from_axis_angle(DVec3::X * 1.2);
    pose.rotations[16] = from_axis_angle(DVec3::new(0.3, 0.2, -0.9));
    pose.rotations[18] = from_axis_angle(DVec3::NEG_Y * 1.2);
    let target = skeleton.keypoints(&pose);
    let fit = fit_pose(&skeleton, &target, None, &FitOptions::default());
    for joint in [1, 4, 16, 18] {
        // A bend of 1.2 rad determines 96 % of a twist, and the twists here are below 0.7 rad. The forearm also takes
        // half of the hand's rotation, which is zero here.
        let off = angle_between(fit.pose.rotations[joint], pose.rotations[joint]);
        assert!(off < 0.1, "joint {joint} is off by {off} rad");
    }
}

#[test]
fn a_step_minimises_the_damped_linear_model() {
    let skeleton = Skeleton::smplx_neutral();
    let options = FitOptions::default();
    let fitter = Fitter::new(&skeleton, &options);
    let mut rng = Pcg64::seed_from_u64(3);
    let mut pose = Pose::REST;
    for rotation in &mut pose.rotations {
        let vector = [(); 3].map(|()| rng.random_range(-1.0..1.0));
        *rotation = from_axis_angle(DVec3::from_array(vector));
    }
    let target = noisy(&skeleton.keypoints(&Pose::REST), 0.05, 4);
    let body = fitter.body_of(&pose);
    let now = fitter.evaluate(&body, &target, None, 0.0);
    let damping = 0.05;
    let step = fitter.step(&now, damping, false, 0.0);
    // The solution x of (H + d I) x = g minimises the model |r - J x|^2 + d |x|^2, so at x the
    // directional derivative of that model vanishes along every coordinate.
    let moved = |step: &Step| -> f64 {
        let mut delta = [step.shift; NUM_KEYPOINTS];
        for slot in 1..NUM_KEYPOINTS {
            let parent = parent_of(slot);
            delta[slot] = delta[parent] + step.turns[parent].cross(now.bones[slot]);
        }
        let residual: f64 = (0..NUM_KEYPOINTS)
            .map(|slot| (target[slot] - now.points[slot] - delta[slot]).length_squared())
            .sum();
        let size: f64 = step.turns.iter().map(|turn| turn.length_squared()).sum();
        residual + damping * (size + step.shift.length_squared())
    };
    let best = moved(&step);
    for coordinate in 0..3 * (NUM_BODY_JOINTS + 1) {
        for sign in [-1.0, 1.0] {
            let (shift, turns) = (step.shift, step.turns);
            let mut other = Step { shift, turns };
            let target = match coordinate / 3 {
                0 => &mut other.shift,
                joint => &mut other.turns[joint - 1],
            };
            target[coordinate % 3] += sign * 1e-4;
            assert!(moved(&other) > best, "coordinate {coordinate}");
        }
    }
}

#[test]
fn points_off_the_body_do_not_flip_joints_and_points_on_it_are_met() {
    let skeleton = Skeleton::smplx_neutral();
    let exact: Vec<KeypointFrame> = (0..40)
        .map(|frame| {
            let mut pose = Pose::REST;
            pose.rotations[16] = from_axis_angle(DVec3::Z * (0.02 * f64::from(frame)));
            skeleton.keypoints(&pose)
        })
        .collect();
    // Noise of 4 cm, as in generated points; eyes and knuckles are only 3 to 8 cm apart.
    let trembling = (0..)
        .zip(&exact)
        .map(|(seed, points)| noisy(points, 0.04, seed));
    let trembling: Vec<KeypointFrame> = trembling.collect();
    let twists = vec![Pose::REST; exact.len()];
    let fitted = |frames: &[KeypointFrame], continuity| {
        let options = FitOptions {
            continuity,
            ..FitOptions::default()
        };
        fit_motion_from(&skeleton, frames, &twists, Fps::STORE, &options).expect("finite")
    };
    let largest = |fit: &FittedMotion| {
        let poses = fit.motion.poses();
        let steps = poses.windows(2).flat_map(|pair| {
            let both = pair[0].rotations.into_iter().zip(pair[1].rotations);
            both.map(|(a, b)| angle_between(a, b))
        });
        steps.fold(0.0, f64::max)
    };
    let (free, held) = (fitted(&trembling, 0.0), fitted(&trembling, 25.0));
    let (free, held) = (largest(&free), largest(&held));
    assert!(free > 1.5, "without it something flips: {free}");
    assert!(held < 0.8, "{held}");
    let error = fitted(&exact, 25.0).error_m.into_iter().fold(0.0, f64::max);
    // The tolerance of the fit.
    assert!(error < 1e-5, "{error}");
}

#[test]
fn smoothing_draws_a_motion_to_its_past() {
    let skeleton = Skeleton::smplx_neutral();
    let clean = skeleton.keypoints(&Pose::REST);
    let frames: Vec<KeypointFrame> = (0..40).map(|i| noisy(&clean, 0.01, i)).collect();
    let wobble = |smoothness| {
        let options = FitOptions {
            smoothness,
            ..FitOptions::default()
        };
        let fitted = fit_motion(&skeleton, &frames, Fps::STORE, &options).expect("finite");
        let poses: Vec<Pose> = fitted.motion.poses();
        let turn = |pair: &[Pose]| angle_between(pair[0].rotations[16], pair[1].rotations[16]);
        poses.windows(2).map(turn).sum::<f64>()
    };
    assert!(wobble(1e-2) < 0.5 * wobble(0.0));
}

#[test]
fn a_missing_frame_is_named() {
    let skeleton = Skeleton::smplx_neutral();
    let mut frames = vec![skeleton.keypoints(&Pose::REST); 3];
    frames[2][5].y = f64::NAN;
    let options = FitOptions::default();
    let refused = |frames: &[KeypointFrame]| {
        let fitted = fit_motion(&skeleton, frames, Fps::STORE, &options);
        fitted.expect_err("refused").to_string()
    };
    assert_eq!(refused(&frames), "keypoints of frame 2 is not finite");
    assert_eq!(refused(&[]), "motion has no frames");
}
