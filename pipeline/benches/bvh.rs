//! Measures the paths from BVH text and AMASS archives to Parquet rows on one thread; the same run calibrates the machine.
//!
//! Stages are counted in source frames a second, the matrix product in floating-point operations and the copy in bytes
//! read and written.

#[path = "../../datasets-spec/kinematics/benches/shared/calibration.rs"]
mod calibration;

use std::path::Path;

use clip::Outcome;
use clip::check::check;
use corpus::CorpusOptions;
use datasets_spec::record::MotionRow;
use datasets_spec::table::{Quality, write_rows};
use datasets_spec::{Fps, Motion, MotionId, Resample, Skeleton, Split};
use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use formats::source::bvh::BvhFile;
use formats::source::{ReadOptions, amass};
use formats::{retarget, write};

/// Frames of the synthetic file: about half a minute.
const NUM_FRAMES: usize = 1000;

/// Joints of a Bandai-Namco file: name, depth in the tree, and offset along x in centimetres. Every joint has position
/// and rotation channels.
const JOINTS: [(&str, usize, f64); 22] = [
    ("joint_Root", 0, 0.0),
    ("Hips", 1, 93.0),
    ("Spine", 2, 15.0),
    ("Chest", 3, 20.0),
    ("Neck", 4, 22.0),
    ("Head", 5, 12.0),
    ("Shoulder_L", 4, 12.0),
    ("UpperArm_L", 5, 13.0),
    ("LowerArm_L", 6, 28.0),
    ("Hand_L", 7, 24.0),
    ("Shoulder_R", 4, 12.0),
    ("UpperArm_R", 5, 13.0),
    ("LowerArm_R", 6, 28.0),
    ("Hand_R", 7, 24.0),
    ("UpperLeg_L", 2, 9.0),
    ("LowerLeg_L", 3, 42.0),
    ("Foot_L", 4, 41.0),
    ("Toes_L", 5, 14.0),
    ("UpperLeg_R", 2, 9.0),
    ("LowerLeg_R", 3, 42.0),
    ("Foot_R", 4, 41.0),
    ("Toes_R", 5, 14.0),
];

fn main() {
    divan::main();
}

/// BVH text of 22 joints with six channels each, at 30 fps, with six decimals per number.
fn file() -> String {
    let mut text = "HIERARCHY\n".to_owned();
    for (index, (name, depth, offset)) in JOINTS.into_iter().enumerate() {
        let keyword = if depth == 0 { "ROOT" } else { "JOINT" };
        text += &format!(
            "{keyword} {name}\n{{\nOFFSET {offset} 0 0\nCHANNELS 6 Xposition Yposition Zposition \
             Zrotation Xrotation Yrotation\n"
        );
        let next_depth = JOINTS.get(index + 1).map_or(0, |next| next.1);
        for _ in next_depth..=depth {
            text += "}\n";
        }
    }
    text += &format!("MOTION\nFrames: {NUM_FRAMES}\nFrame Time: 0.033333\n");
    for frame in 0..NUM_FRAMES {
        let row: Vec<String> = JOINTS
            .iter()
            .enumerate()
            .flat_map(|(index, joint)| {
                let phase = 0.1 * frame as f64 + index as f64;
                let swing = |amplitude: f64, shift: f64| amplitude * (phase + shift).sin();
                let turns = [swing(40.0, 0.0), swing(25.0, 1.0), swing(100.0, 2.0)];
                [joint.2, 0.0, 0.0].into_iter().chain(turns)
            })
            .map(|value| format!("{value:.6}"))
            .collect();
        text += &row.join(" ");
        text += "\n";
    }
    text
}

fn frames() -> ItemsCount {
    ItemsCount::new(NUM_FRAMES)
}

#[divan::bench]
fn parse(bencher: Bencher) {
    let text = file();
    let bencher = bencher.counter(frames());
    bencher.bench_local(|| BvhFile::parse(black_box(text.as_bytes())).expect("valid"));
}

fn motion_of(text: &str) -> Motion {
    let bvh = BvhFile::parse(text.as_bytes()).expect("valid");
    let clip = retarget::clip(&bvh, &ReadOptions::default()).expect("a body");
    clip.motion
}

#[divan::bench]
fn parse_and_retarget(bencher: Bencher) {
    let text = file();
    let bencher = bencher.counter(frames());
    bencher.bench_local(|| motion_of(black_box(&text)));
}

fn resampled_motion_of(text: &str) -> Motion {
    let motion = motion_of(text);
    let resampled = Resample::Exact.apply(&motion, Fps::STORE);
    resampled.expect("resamples")
}

#[divan::bench]
fn parse_retarget_and_resample(bencher: Bencher) {
    let text = file();
    let bencher = bencher.counter(frames());
    bencher.bench_local(|| resampled_motion_of(black_box(&text)));
}

/// Files that go into one shard; a shard of the store holds up to 256.
const NUM_FILES: usize = 8;

#[divan::bench]
fn to_parquet(bencher: Bencher) {
    let text = file();
    bencher
        .counter(ItemsCount::new(NUM_FILES * NUM_FRAMES))
        .bench_local(|| {
            let rows: Vec<MotionRow> = (0..NUM_FILES)
                .map(|_| row(&resampled_motion_of(black_box(&text))))
                .collect();
            write_rows(Vec::new(), Path::new("bench.parquet"), &rows, &[]).expect("written")
        });
}

/// What an ingestion does with archives of AMASS, without a disk. They are those that `stance export --to amass` writes of
/// the built-in corpus, at 60 fps.
#[divan::bench]
fn amass_to_parquet(bencher: Bencher) {
    let skeleton = Skeleton::smplx_neutral();
    let fast = |index: usize| {
        let motion = corpus::clip(index, &CorpusOptions::default()).motion;
        let rate = Fps::new(60.0).expect("a rate");
        Resample::Exact.apply(&motion, rate).expect("resamples")
    };
    let motions: Vec<Motion> = (0..NUM_FILES).map(fast).collect();
    let archives: Vec<Vec<u8>> = motions
        .iter()
        .map(|motion| write::amass::encode_smplx(motion, &skeleton).expect("encodes"))
        .collect();
    let frames: usize = motions.iter().map(Motion::len).sum();
    let options = ReadOptions {
        rate: Some(Fps::STORE),
        ..ReadOptions::default()
    };
    bencher.counter(ItemsCount::new(frames)).bench_local(|| {
        let read = |bytes: &Vec<u8>| match amass::read(Path::new("clip.npz"), bytes, &options) {
            Ok(Outcome::Clip(clip)) => row(&clip.motion),
            _ => panic!("the archive is good"),
        };
        let rows: Vec<MotionRow> = archives
            .iter()
            .map(|bytes| read(black_box(bytes)))
            .collect();
        write_rows(Vec::new(), Path::new("bench.parquet"), &rows, &[]).expect("written")
    });
}

fn row(motion: &Motion) -> MotionRow {
    let skeleton = Skeleton::smplx_neutral();
    // The synthetic joints move faster than any body, so the check reports an error; its cost is the same.
    let quality = check(motion, &skeleton).unwrap_or(Quality {
        flags: 0,
        max_speed: 0.0,
        foot_skate: 0.0,
    });
    MotionRow {
        source: "bvh".to_owned(),
        source_path: "bench.bvh".to_owned(),
        rotation_source: "retargeted".to_owned(),
        quality,
        ..MotionRow::new(
            MotionId::parse("bench").expect("valid"),
            Split::Train,
            motion,
        )
    }
}
