//! Measures HumanML3D features: computed alone, and on the way from AMASS archives to a Parquet shard.
//!
//! `cargo bench --bench features`; one thread. Rates are frames a second, to be compared with the matrix product and
//! the copy of the same run.

#[path = "../../datasets-spec/kinematics/benches/shared/calibration.rs"]
mod calibration;

use std::hint::black_box;
use std::path::Path;

use clip::Outcome;
use corpus::{CorpusOptions, clip};
use datasets_spec::record::HumanMl3dRow;
use datasets_spec::table::write_rows;
use datasets_spec::{Fps, Motion, MotionId, Resample, Skeleton, Split};
use divan::Bencher;
use divan::counter::ItemsCount;
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
