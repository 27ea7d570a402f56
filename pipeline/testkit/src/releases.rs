//! Files of releases.

use std::fs;
use std::path::Path;

use datasets_spec::{Fps, Motion, Pose};
use glam::{DQuat, DVec3};
use pickle::{Value, encode};

use crate::{npy, npy_f8};

/// A walk in which every frame and joint differs; another `seed` gives another walk.
pub fn swinging(seed: usize, frames: usize) -> Motion {
    let poses: Vec<Pose> = (0..frames)
        .map(|frame| {
            let time = frame as f64 * 0.05 + seed as f64;
            let mut pose = Pose::REST;
            pose.transl = DVec3::new(0.3 * time.sin(), 1.2, 0.02 * frame as f64);
            for (joint, rotation) in pose.rotations.iter_mut().enumerate() {
                *rotation = DQuat::from_rotation_x(0.1 * (time + joint as f64).sin());
            }
            pose
        })
        .collect();
    Motion::from_poses(Fps::STORE, &poses).expect("finite")
}

/// The dictionary of a motion in the STANCE release.
pub fn dictionary(motion: &Motion) -> Value {
    let column = |key: &str, numbers: &[f32]| {
        let shape = [motion.len(), numbers.len() / motion.len()];
        let array = Value::floats(&shape, numbers.iter().copied());
        (Value::text(key), array)
    };
    Value::Dict(vec![
        column("body_pose", motion.body_pose().as_flattened()),
        column("global_orient", motion.global_orient().as_flattened()),
        column("transl", motion.transl().as_flattened()),
    ])
}

/// The dictionary of a fine-grained pair of the release.
pub fn adjustment(source: &Motion, target: &Motion, part: &str, text: &str) -> Value {
    Value::dict([
        ("src", dictionary(source)),
        ("tgt", dictionary(target)),
        ("body_part", Value::text(part)),
        ("text", Value::text(text)),
    ])
}

/// Writes a file below a folder.
pub fn put(folder: &Path, file: &str, content: impl AsRef<[u8]>) {
    let path = folder.join(file);
    fs::create_dir_all(path.parent().expect("within the folder")).expect("created");
    fs::write(path, content).expect("written");
}

/// Writes a small STANCE release in its current layout.
pub fn write_release(folder: &Path) {
    for (stem, seed) in [("000009", 1), ("000010", 2), ("014625", 3), ("000012", 4)] {
        let bytes = encode(&dictionary(&swinging(seed, 30)));
        put(folder, &format!("base_motion/{stem}.pkl"), bytes);
    }
    let proud = encode(&dictionary(&swinging(5, 30)));
    put(folder, "style_transfer/000009_proud.pkl", proud);
    let (source, target) = (swinging(6, 30), swinging(7, 30));
    let pair = encode(&adjustment(&source, &target, "LEFT_ARM", "raise it higher"));
    let file = "adjustment/paired_data_seed0_15_batch0_id3.pkl";
    put(folder, file, pair);
    let masks = r#"{"000009": ["LEFT_ARM", "LOWER_BODY"], "M000009": "UPPER_BODY"}"#;
    put(folder, "regen/mask_all.json", masks);
    let texts = r#"{"9": ["waving", "kneeling"], "014625": "stretching"}"#;
    put(folder, "regen/part_annotations.json", texts);
    put(folder, "split/base_motion/val.txt", "000010\n");
    put(folder, "split/base_motion/test.txt", "");
    let styles = r#"["000009_proud.pkl"]"#;
    put(folder, "split/style_transfer/test.json", styles);
    let adjustments = r#"[["paired_data_seed0_15_batch0_id3.pkl"]]"#;
    put(folder, "split/adjustment/val.json", adjustments);
    put(folder, "README.md", "the release");
}

/// Members of an AMASS archive of `frames` frames and `width` pose columns with varied numbers.
pub fn clip_members(frames: usize, width: usize) -> Vec<(&'static str, Vec<u8>)> {
    let values = |count: usize, scale: f64| -> Vec<f64> {
        let value = |i: usize| scale * ((i * 37 % 101) as f64 / 101.0 - 0.5);
        (0..count).map(value).collect()
    };
    let poses = npy_f8(&[frames, width], &values(frames * width, 1.0));
    let gender = "{'descr': '|S4', 'fortran_order': False, 'shape': (), }";
    vec![
        ("poses", poses),
        ("trans", npy_f8(&[frames, 3], &values(frames * 3, 0.1))),
        ("mocap_framerate", npy_f8(&[], &[120.000_045_776])),
        ("gender", npy(gender, b"male")),
    ]
}
