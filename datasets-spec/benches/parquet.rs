//! Benchmarks of writing and reading shards, with a copy and a matrix product for comparison.
//!
//! `cargo bench --bench parquet`; one thread. Compare the frames per second of the writers and readers with the rates
//! of the copy and the matrix product.

#[path = "../kinematics/benches/shared/calibration.rs"]
mod calibration;

use std::hint::black_box;
use std::path::{Path, PathBuf};

use datasets_spec::record::{FramesRow, HUMANML3D_WIDTH, HumanMl3dRow, MotionRow};
use datasets_spec::table::{ShardReader, read_rows, write_rows};
use datasets_spec::{Fps, Motion, MotionId, Pose, Seed, Split};
use divan::Bencher;
use divan::counter::ItemsCount;
use glam::{DQuat, DVec3};
use rand::RngExt;

const NUM_CLIPS: usize = 64;
const NUM_FRAMES: usize = 120;

fn main() {
    divan::main();
}

/// A smooth number with noise in its last bits, like the coordinates of captured joints.
fn wander(rng: &mut datasets_spec::Rng, time: f64, rate: f64) -> f32 {
    let noise: f64 = rng.random_range(-2e-3..2e-3);
    ((rate * time).sin() * 0.4 + noise) as f32
}

fn feature_rows() -> Vec<HumanMl3dRow> {
    let mut rng = Seed(1).rng(&["bench", "features"]);
    let rates: Vec<f64> = (0..HUMANML3D_WIDTH)
        .map(|_| rng.random_range(0.3..6.0))
        .collect();
    (0..NUM_CLIPS)
        .map(|clip| HumanMl3dRow {
            id: MotionId::parse(&format!("{clip:06}")).expect("valid"),
            split: Split::Train,
            recipe: "humanml3d@1".to_owned(),
            fps: 20.0,
            n_frames: NUM_FRAMES as i32,
            features: (0..NUM_FRAMES)
                .map(|frame| {
                    let time = frame as f64 / 20.0 + clip as f64;
                    std::array::from_fn(|column| wander(&mut rng, time, rates[column]))
                })
                .collect(),
        })
        .collect()
}

fn motion_rows() -> Vec<MotionRow> {
    let mut rng = Seed(1).rng(&["bench", "motions"]);
    (0..NUM_CLIPS)
        .map(|clip| {
            let poses: Vec<Pose> = (0..NUM_FRAMES)
                .map(|frame| {
                    let time = frame as f64 / 20.0 + clip as f64;
                    let mut angle = |rate: f64| f64::from(wander(&mut rng, time, rate));
                    Pose {
                        transl: DVec3::new(angle(0.5), angle(2.0), angle(0.7)),
                        rotations: std::array::from_fn(|joint| {
                            DQuat::from_rotation_x(angle(1.0 + joint as f64 / 4.0))
                        }),
                    }
                })
                .collect();
            let motion = Motion::from_poses(Fps::STORE, &poses).expect("finite");
            let id = MotionId::parse(&format!("{clip:06}")).expect("valid");
            MotionRow {
                source: "bench".to_owned(),
                source_path: format!("{clip:06}.npz"),
                ..MotionRow::new(id, Split::Train, &motion)
            }
        })
        .collect()
}

fn frames() -> ItemsCount {
    ItemsCount::new(NUM_CLIPS * NUM_FRAMES)
}

fn shard() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("shard.parquet");
    let bytes = write_rows(Vec::new(), &path, &motion_rows(), &[]).expect("written");
    std::fs::write(&path, bytes).expect("written");
    (dir, path)
}

#[divan::bench]
fn write_humanml3d(bencher: Bencher) {
    let rows = feature_rows();
    let bencher = bencher.counter(frames());
    bencher.bench_local(|| write_rows(Vec::new(), Path::new("memory"), black_box(&rows), &[]));
}

#[divan::bench]
fn write_motions(bencher: Bencher) {
    let rows = motion_rows();
    let bencher = bencher.counter(frames());
    bencher.bench_local(|| write_rows(Vec::new(), Path::new("memory"), black_box(&rows), &[]));
}

#[divan::bench]
fn read_motions(bencher: Bencher) {
    let (_dir, path) = shard();
    let bencher = bencher.counter(frames());
    bencher.bench_local(|| read_rows::<MotionRow>(black_box(&path)).expect("reads"));
}

#[divan::bench]
fn read_one_motion(bencher: Bencher) {
    let (_dir, path) = shard();
    bencher
        .counter(ItemsCount::new(NUM_FRAMES))
        .bench_local(|| -> Result<Vec<MotionRow>, _> {
            ShardReader::open(black_box(&path))?.rows_at(&[NUM_CLIPS / 2])
        });
}

#[divan::bench]
fn read_random_clip(bencher: Bencher) {
    let (_dir, path) = shard();
    let reader = ShardReader::open(&path).expect("a shard");
    let mut clip = 0;
    bencher
        .counter(ItemsCount::new(NUM_FRAMES))
        .bench_local(|| {
            clip = (clip + 37) % NUM_CLIPS;
            reader.rows_at::<FramesRow>(&[black_box(clip)])
        });
}
