//! Measures HumanML3D features: computed alone, and on the way from AMASS archives to a Parquet shard.
//!
//! `cargo bench --bench features`; one thread. Rates are frames a second, to be compared with the matrix product and
//! the copy of the same run.

use std::hint::black_box;
use std::path::Path;

use clip::Outcome;
use corpus::{CorpusOptions, clip};
use datasets_spec::record::HumanMl3dRow;
use datasets_spec::table::write_rows;
use datasets_spec::{Fps, Motion, MotionId, Resample, Skeleton, Split};
use divan::Bencher;
use divan::counter::{BytesCount, ItemsCount};
use features::humanml3d;
use formats::source::{ReadOptions, amass};
use formats::write;

fn main() {
    divan::main();
}

fn skeleton() -> Skeleton {
    Skeleton::smplx_neutral()
}

/// A clip of the built-in corpus.
fn motion() -> Motion {
    clip(3, &CorpusOptions::default()).motion
}

#[divan::bench]
fn features_of_joints(bencher: Bencher) {
    let joints = humanml3d::joints_of_motion(&motion(), &skeleton());
    let bencher = bencher.counter(ItemsCount::new(joints.len()));
    bencher.bench_local(|| humanml3d::features_of_joints(black_box(&joints)));
}

#[divan::bench]
fn joints_of_motion(bencher: Bencher) {
    let (motion, skeleton) = (motion(), skeleton());
    let bencher = bencher.counter(ItemsCount::new(motion.len()));
    bencher.bench_local(|| humanml3d::joints_of_motion(black_box(&motion), &skeleton));
}

#[divan::bench]
fn recover_joints(bencher: Bencher) {
    let joints = humanml3d::joints_of_motion(&motion(), &skeleton());
    let rows = humanml3d::features_of_joints(&joints).expect("a clip");
    let bencher = bencher.counter(ItemsCount::new(rows.len()));
    bencher.bench_local(|| humanml3d::recover_joints(black_box(&rows)));
}

#[divan::bench]
fn motion_of_features(bencher: Bencher) {
    let skeleton = skeleton();
    let joints = humanml3d::joints_of_motion(&motion(), &skeleton);
    let rows = humanml3d::features_of_joints(&joints).expect("a clip");
    let bencher = bencher.counter(ItemsCount::new(rows.len()));
    bencher.bench_local(|| features::motion_of_features(black_box(&rows), Fps::STORE, &skeleton));
}

#[divan::bench]
fn motion_of_joints(bencher: Bencher) {
    let skeleton = skeleton();
    let joints = humanml3d::joints_of_motion(&motion(), &skeleton);
    let bencher = bencher.counter(ItemsCount::new(joints.len()));
    bencher.bench_local(|| features::motion_of_joints(black_box(&joints), Fps::STORE, &skeleton));
}

/// Counts input frames, which are at 120 fps.
#[divan::bench]
fn amass_to_parquet(bencher: Bencher) {
    const CLIPS: usize = 16;
    let skeleton = skeleton();
    let archives: Vec<Vec<u8>> = (0..CLIPS)
        .map(|index| {
            let motion = clip(index, &CorpusOptions::default()).motion;
            let fast = Resample::Exact
                .apply(&motion, Fps::new(120.0).expect("a rate"))
                .expect("resampled");
            write::amass::encode(&fast, &skeleton).expect("encodes")
        })
        .collect();
    let read = |bytes: &Vec<u8>, rate| {
        let options = ReadOptions {
            rate,
            ..ReadOptions::default()
        };
        match amass::read(Path::new("clip.npz"), bytes, &options) {
            Ok(Outcome::Clip(clip)) => clip.motion,
            _ => panic!("the archive is good"),
        }
    };
    let frames: usize = archives.iter().map(|bytes| read(bytes, None).len()).sum();
    bencher.counter(ItemsCount::new(frames)).bench_local(|| {
        let rows: Vec<HumanMl3dRow> = archives
            .iter()
            .enumerate()
            .map(|(index, bytes)| {
                let motion = read(black_box(bytes), Some(Fps::STORE));
                let joints = humanml3d::joints_of_motion(&motion, &skeleton);
                let rows = humanml3d::features_of_joints(&joints).expect("a clip");
                HumanMl3dRow {
                    id: MotionId::parse(&index.to_string()).expect("valid"),
                    split: Split::Train,
                    recipe: humanml3d::RECIPE.to_owned(),
                    fps: 20.0,
                    n_frames: rows.len() as i32,
                    features: rows,
                }
            })
            .collect();
        write_rows(Vec::new(), Path::new("memory"), &rows, &[])
    });
}

/// Throughput of the machine, measured in the same run.
mod calibration {
    use super::*;

    /// Numbers that are copied: 64 MiB, more than most caches hold.
    const COPIED: usize = 16 << 20;
    const SIDE: usize = 512;
    /// Rows and columns of the result that are summed at a time, so that they stay in registers.
    const ROWS: usize = 4;
    const COLUMNS: usize = 8;

    /// Bandwidth of a copy, counting bytes read and written.
    #[divan::bench]
    fn copy(bencher: Bencher) {
        let from = vec![1.0f32; COPIED];
        let mut to = vec![0.0f32; COPIED];
        let bencher = bencher.counter(BytesCount::new(2 * size_of_val(from.as_slice())));
        bencher.bench_local(|| black_box(&mut to).copy_from_slice(black_box(&from)));
    }

    /// A product of two square matrices, in floating-point operations a second.
    #[divan::bench]
    fn matrix_product(bencher: Bencher) {
        let (a, b) = (vec![1.0f32; SIDE * SIDE], vec![0.5f32; SIDE * SIDE]);
        let mut product = vec![0.0f32; SIDE * SIDE];
        bencher
            .counter(ItemsCount::new(2 * SIDE * SIDE * SIDE))
            .bench_local(|| {
                multiply(black_box(&a), black_box(&b), &mut product);
                black_box(&product);
            });
    }

    fn multiply(a: &[f32], b: &[f32], product: &mut [f32]) {
        let mut panel = vec![[0.0f32; COLUMNS]; SIDE];
        for column in (0..SIDE).step_by(COLUMNS) {
            for (line, row) in panel.iter_mut().zip(b.chunks_exact(SIDE)) {
                line.copy_from_slice(&row[column..column + COLUMNS]);
            }
            let rows = a.chunks_exact(ROWS * SIDE);
            for (rows, out) in rows.zip(product.chunks_exact_mut(ROWS * SIDE)) {
                let mut sums = [[0.0f32; COLUMNS]; ROWS];
                for (k, line) in panel.iter().enumerate() {
                    for (row, sums) in sums.iter_mut().enumerate() {
                        let factor = rows[row * SIDE + k];
                        for (sum, value) in sums.iter_mut().zip(line) {
                            *sum += factor * value;
                        }
                    }
                }
                for (row, sums) in sums.iter().enumerate() {
                    out[row * SIDE + column..][..COLUMNS].copy_from_slice(sums);
                }
            }
        }
    }
}
