//! Times of the metrics at the size of a large test set (10,000 latents of width 512, a million frames), and of a whole
//! evaluation of items in a folder with an encoder of negligible cost.
//!
//! `cargo bench --bench metrics`; `RAYON_NUM_THREADS` chooses the threads. `matrix_product` measures single-precision
//! matrix products, whose speed limits that of the galleries.

use std::hint::black_box;
use std::path::Path;

use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::table::Row;
use datasets_spec::{Fps, Motion, MotionId, NoProgress, Pose, Seed, Skeleton, Split};
use divan::Bencher;
use divan::counter::ItemsCount;
use eval::EncoderError;
use eval::answers::{Answered, Scores};
use eval::evaluators::{Evaluators, MotionEncoder};
use eval::linalg::Matrix;
use eval::metric::fid::fid;
use eval::metric::foot_score::{Feet, foot_score};
use eval::metric::retrieval::{gallery_ranks, ranks, unit_rows};
use eval::protocol::{Floor, Gallery, Protocol};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use glam::{DQuat, DVec3};
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

/// Two covariances, one eigendecomposition, and the eigenvalues of one product.
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

/// Ten repeats with 312 galleries each.
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
    let mut foot = || DVec3::from_array([0.1, 0.2, 0.1].map(|most| rng.random_range(0.0..most)));
    let feet: Vec<Feet> = (0..1_000_000).map(|_| [(); 4].map(|()| foot())).collect();
    bencher
        .counter(ItemsCount::new(feet.len()))
        .bench_local(|| foot_score(black_box(&feet), Fps::STORE, Floor::At(0.0)));
}

/// Counts single-precision operations per second on one core.
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

/// An encoder of negligible cost: the body rotations of the first frame.
struct FirstFrame;

impl MotionEncoder for FirstFrame {
    fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError> {
        let first = |motion: &&Motion| motion.body_pose()[0].map(f64::from).to_vec();
        Ok(motions.iter().map(first).collect())
    }

    fn hash(&self) -> String {
        "00ff".to_owned()
    }

    fn recipe(&self) -> String {
        "first frame".to_owned()
    }

    fn weakness(&self) -> Option<String> {
        None
    }
}

/// A motion of ten seconds with rotating joints and a moving root.
fn motion(name: &str, number: usize) -> Motion {
    let mut rng = Seed(3).rng(&["bench", name, &number.to_string()]);
    let turns = Pose::REST.rotations.map(|_| rng.random_range(-0.5..0.5));
    let pose = |frame: i32| {
        let share = 1.0 + 0.1 * f64::from(frame).sin();
        Pose {
            transl: DVec3::new(0.0, 0.0, 0.05 * f64::from(frame)),
            rotations: turns.map(|turn| DQuat::from_rotation_x(share * turn)),
        }
    };
    let poses: Vec<Pose> = (0..200).map(pose).collect();
    Motion::from_poses(Fps::STORE, &poses).expect("a motion")
}

fn commit<R: Row>(root: &Path, rows: &[R], split_of: fn(&R) -> Split, plan: &str) {
    let skeleton = Skeleton::smplx_neutral();
    commit_rows(root, rows, Some(split_of), &skeleton, plan, "bench").expect("writes");
}

/// Reads items and the edits of one system from a folder, and scores them with an encoder of negligible cost.
#[divan::bench(args = [128, 1024], sample_count = 3, sample_size = 1)]
fn evaluation(bencher: Bencher, num_items: usize) {
    let root = std::env::temp_dir().join(format!("stance-bench-{}", std::process::id()));
    let items: Vec<ItemRow> = (0..num_items)
        .map(|number| {
            let id = MotionId::parse(&format!("bench/{number}")).expect("an id");
            let mut item = ItemRow::blank(&id, Split::Test);
            item.task = "semantic".to_owned();
            let [source, target] = ["source", "target"].map(|name| motion(name, number));
            item.set_motions(&source, Some(&target), None);
            item.id = item.content_id();
            item
        })
        .collect();
    let edits: Vec<EditRow> = items
        .iter()
        .enumerate()
        .map(|(number, item)| EditRow {
            system: "system".to_owned(),
            ..EditRow::answering(item, &motion("edit", number))
        })
        .collect();
    commit(&root, &items, |row| row.split, "items");
    commit(&root, &edits, |row| row.split, "edits");
    drop((items, edits));
    bencher.counter(ItemsCount::new(num_items)).bench_local(|| {
        let answered = Answered::read(std::slice::from_ref(&root)).expect("a folder of edits");
        let evaluators = Evaluators {
            encoder: &FirstFrame,
            classifier: None,
            skeleton: &answered.skeleton,
        };
        Scores::of(&answered, evaluators, &Protocol::default(), &NoProgress).expect("valid")
    });
    std::fs::remove_dir_all(&root).expect("removes");
}
