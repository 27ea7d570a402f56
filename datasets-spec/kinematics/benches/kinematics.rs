//! Benchmarks from parameters to keypoints and back, with a calibration of the machine in the same run.
//!
//! `cargo bench --bench kinematics`; one thread. Rates are frames a second.

#[path = "shared/calibration.rs"]
mod calibration;

use std::hint::black_box;

use divan::Bencher;
use divan::counter::ItemsCount;
use glam::DVec3;
use kinematics::fit::{AdamFit, FitOptions, fit_motion};
use kinematics::rotation::from_axis_angle;
use kinematics::{Fps, Motion, Pose, Skeleton};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const NUM_FRAMES: usize = 4096;

fn main() {
    divan::main();
}

/// A body whose joints swing at different rates, by angles that people reach.
fn motion(num_frames: usize) -> Motion {
    let mut rng = Pcg64::seed_from_u64(1);
    let mut vector = |size: f64| DVec3::from_array([0; 3].map(|_| rng.random_range(-size..size)));
    let swings: Vec<[DVec3; 2]> = (0..22).map(|_| [vector(0.6), vector(5.0)]).collect();
    let poses: Vec<Pose> = (0..num_frames)
        .map(|frame| {
            let time = frame as f64 / 20.0;
            let swing = |[size, rate]: [DVec3; 2]| size * (rate * time).map(f64::sin);
            Pose {
                transl: DVec3::new(time.sin(), 0.9, time.cos()),
                rotations: std::array::from_fn(|joint| from_axis_angle(swing(swings[joint]))),
            }
        })
        .collect();
    Motion::from_poses(Fps::STORE, &poses).expect("finite")
}

#[divan::bench]
fn keypoints(bencher: Bencher) {
    let (motion, skeleton) = (motion(NUM_FRAMES), Skeleton::smplx_neutral());
    let bencher = bencher.counter(ItemsCount::new(NUM_FRAMES));
    bencher.bench_local(|| skeleton.motion_keypoints(black_box(&motion)));
}

/// Number of frames in the fit benchmarks: the published fit is slow.
const NUM_FITTED: usize = 64;

#[divan::bench]
fn fit_second_order(bencher: Bencher) {
    let (motion, skeleton) = (motion(NUM_FITTED), Skeleton::smplx_neutral());
    let points = skeleton.motion_keypoints(&motion).points;
    let options = FitOptions::default();
    let bencher = bencher.counter(ItemsCount::new(NUM_FITTED));
    bencher.bench_local(|| fit_motion(&skeleton, black_box(&points), Fps::STORE, &options));
}

#[divan::bench]
fn fit_adam(bencher: Bencher) {
    let (motion, skeleton) = (motion(NUM_FITTED), Skeleton::smplx_neutral());
    let points = skeleton.motion_keypoints(&motion).points;
    let start = AdamFit::parameters_of(&vec![Pose::REST; NUM_FITTED]);
    let fit = AdamFit::paper();
    let bencher = bencher.counter(ItemsCount::new(NUM_FITTED));
    bencher.bench_local(|| fit.fit(&skeleton, black_box(&points), &start));
}
