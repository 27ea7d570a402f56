//! The metrics at the sizes of a large test set: 10,000 latents of width 512, a million frames.
//!
//! `cargo bench --bench metrics`; `RAYON_NUM_THREADS` chooses the threads. `matrix_product` is the
//! speed of single-precision products in the same run, which bounds that of the galleries.

use std::hint::black_box;

use datasets_spec::{Fps, Seed};
use divan::Bencher;
use divan::counter::ItemsCount;
use eval::linalg::Matrix;
use eval::metric::fid::fid;
use eval::metric::foot_score::{Feet, foot_score};
use eval::metric::retrieval::{gallery_ranks, ranks, unit_rows};
use eval::protocol::{Floor, Gallery, Protocol};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use glam::DVec3;
use rand::RngExt;

const NUM_LATENTS: usize = 10_000;
const WIDTH: usize = 512;

fn main() {
    divan::main();
}

fn latents(name: &str) -> Matrix {
    let mut rng = Seed(3).rng(&["bench", name]);
    let data = (0..NUM_LATENTS * WIDTH)
        .map(|_| rng.random_range(-1.0..1.0))
        .collect();
    Matrix::new(NUM_LATENTS, WIDTH, data)
}

/// Two covariances, a decomposition and the eigenvalues of a product.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn fid_10k(bencher: Bencher) {
    let (real, generated) = (latents("real"), latents("generated"));
    bencher.bench_local(|| fid(black_box(&real), &generated).expect("valid"));
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn full_gallery_10k(bencher: Bencher) {
    let (queries, gallery) = (latents("queries"), latents("gallery"));
    let all: Vec<usize> = (0..NUM_LATENTS).collect();
    bencher.bench_local(|| ranks(black_box(&queries), &gallery, &all).expect("valid"));
}

/// Ten repeats of 312 galleries.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn galleries_of_32(bencher: Bencher) {
    let unit = |name| unit_rows(&latents(name)).expect("directions");
    let (queries, gallery) = (unit("queries"), unit("gallery"));
    let protocol = Protocol {
        gallery: Gallery::Batches(32),
        ..Protocol::default()
    };
    let repeats: Vec<Vec<Vec<usize>>> = (0..protocol.repeats)
        .map(|repeat| protocol.galleries(NUM_LATENTS, repeat))
        .collect();
    bencher.bench_local(|| {
        for galleries in &repeats {
            black_box(gallery_ranks(black_box(&queries), &gallery, galleries).expect("valid"));
        }
    });
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn foot_score_1m(bencher: Bencher) {
    let mut rng = Seed(3).rng(&["bench", "feet"]);
    let feet: Vec<Feet> = (0..1_000_000)
        .map(|_| {
            [(); 4].map(|()| {
                DVec3::new(
                    rng.random_range(0.0..0.1),
                    rng.random_range(0.0..0.2),
                    rng.random_range(0.0..0.1),
                )
            })
        })
        .collect();
    bencher
        .counter(ItemsCount::new(feet.len()))
        .bench_local(|| foot_score(black_box(&feet), Fps::STORE, Floor::At(0.0)));
}

/// Single-precision operations a second on one core.
#[divan::bench(sample_count = 20)]
fn matrix_product(bencher: Bencher) {
    let [m, k, n] = [1024, 512, 1024];
    let a = Mat::from_fn(m, k, |row, col| ((row + col) % 7) as f32);
    let b = Mat::from_fn(k, n, |row, col| ((row + col) % 5) as f32);
    let mut out = Mat::zeros(m, n);
    bencher
        .counter(ItemsCount::new(2 * m * k * n))
        .bench_local(|| {
            let (a, b) = (black_box(a.as_ref()), b.as_ref());
            matmul(out.as_mut(), Accum::Replace, a, b, 1.0f32, Par::Seq);
        });
}
