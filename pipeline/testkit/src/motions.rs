//! Synthetic motions and their rows.

use std::path::Path;

use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::Row;
use datasets_spec::{
    BodyPart, Dataset, Fps, MASK_DEF_VERSION, Motion, MotionId, Pose, Seed, Skeleton, Split,
};
use glam::DVec3;
use kinematics::canonical::WINDOW_FRAMES;
use kinematics::rotation::from_axis_angle;
use rand::RngExt;

/// Number of stored frames, at 20 fps, that a window spans.
pub const SPAN: usize = 2 * (WINDOW_FRAMES - 1) + 1;

/// A body that moves along a line and turns, while every joint swings at rates of its own.
pub fn wandering(name: &str, num_frames: usize) -> Motion {
    let mut rng = Seed(11).rng(&["fixture", name]);
    let mut vector =
        |size: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)));
    let swings: Vec<[DVec3; 2]> = (0..22).map(|_| [vector(0.8), vector(6.0)]).collect();
    let (start, speed, turn) = (vector(4.0), vector(1.0), vector(2.0).y);
    let poses: Vec<Pose> = (0..num_frames)
        .map(|frame| {
            let t = frame as f64 / 20.0;
            let mut rotations = std::array::from_fn(|joint| {
                let [size, rate] = swings[joint];
                from_axis_angle(size * DVec3::from_array((rate * t).to_array().map(f64::sin)))
            });
            rotations[0] = from_axis_angle(DVec3::Y * (turn * t)) * rotations[0];
            Pose {
                transl: start + speed.with_y(0.0) * t,
                rotations,
            }
        })
        .collect();
    Motion::from_poses(Fps::STORE, &poses).expect("finite")
}

/// Commits the rows of a table as the newest version of a dataset of the neutral body.
pub fn commit<R: Row>(root: &Path, rows: &[R], split_of: fn(&R) -> Split, plan: &str) -> Dataset {
    let skeleton = Skeleton::smplx_neutral();
    commit_rows(root, rows, Some(split_of), &skeleton, plan, "test").expect("committed")
}

/// The row of a motion.
pub fn motion_row(id: &str, split: Split, motion: &Motion) -> MotionRow {
    MotionRow {
        source: "synthetic".to_owned(),
        source_path: format!("{id}.npz"),
        ..MotionRow::new(MotionId::parse(id).expect("valid id"), split, motion)
    }
}

/// The row of a mask of one body part.
pub fn mask_row(motion: &str, split: Split, part: BodyPart) -> MaskRow {
    MaskRow {
        id: format!("{motion}#{part}"),
        motion_id: MotionId::parse(motion).expect("valid id"),
        split,
        parts: vec![part.name().to_owned()],
        hard_joints: part.mask().hard().names(),
        soft_joints: part.mask().soft().names(),
        start: None,
        end: None,
        mask_def_version: MASK_DEF_VERSION,
        text: format!("The person is waving with their {part}."),
        text_origin: "human".to_owned(),
        author: "fixture".to_owned(),
        accepted_by: None,
    }
}

/// Motions `clip0`, `clip1`, ... of different lengths, every second one annotated.
pub fn rows(split: Split, num_clips: usize) -> (Vec<MotionRow>, Vec<MaskRow>) {
    let mut motions = Vec::new();
    let mut masks = Vec::new();
    for clip in 0..num_clips {
        let id = format!("clip{clip}");
        let mut row = motion_row(&id, split, &wandering(&id, SPAN + 13 * clip));
        row.action = Some(["wave", "kick"][clip % 2].to_owned());
        motions.push(row);
        if clip % 2 == 0 {
            let part = BodyPart::ALL[clip / 2 % BodyPart::ALL.len()];
            masks.push(mask_row(&id, split, part));
        }
    }
    (motions, masks)
}

/// The row of a pair of two clips of [`rows`], given by their numbers.
pub fn pair_row(kind: &str, split: Split, source: usize, target: usize) -> PairRow {
    let id = |number: usize| MotionId::parse(&format!("clip{number}")).expect("valid id");
    PairRow {
        id: format!("{kind}-{source}-{target}"),
        split,
        source: "synthetic".to_owned(),
        kind: kind.to_owned(),
        source_id: id(source),
        target_id: id(target),
        style: Some("old".to_owned()),
        parts: Vec::new(),
        instruction: String::new(),
        edit_type: None,
        accepted_by: None,
    }
}

/// Poses of a walk along z: legs and arms swing, knees and elbows bend, the trunk turns and leans a little.
pub fn walk(num_frames: usize) -> Vec<Pose> {
    (0..num_frames)
        .map(|frame| {
            let phase = 0.25 * frame as f64;
            let (sin, cos) = phase.sin_cos();
            let mut pose = Pose::REST;
            let height = 1.2 + 0.02 * (2.0 * phase).sin();
            pose.transl = DVec3::new(0.02 * cos, height, 0.03 * frame as f64);
            let mut set = |joint: usize, x: f64, y: f64, z: f64| {
                pose.rotations[joint] = from_axis_angle(DVec3::new(x, y, z));
            };
            set(0, 0.05 * cos, 0.15 * sin, 0.03);
            set(3, 0.05, 0.05 * cos, 0.0);
            set(9, 0.02 * sin, -0.15 * sin, 0.0);
            set(15, 0.1 * cos, 0.1 * sin, 0.0);
            set(1, -0.5 * sin, 0.0, 0.02);
            set(2, 0.5 * sin, 0.0, -0.02);
            set(4, 0.6 + 0.5 * cos, 0.0, 0.0);
            set(5, 0.6 - 0.5 * cos, 0.0, 0.0);
            set(16, 0.0, -0.5 * sin, -1.1);
            set(17, 0.0, -0.5 * sin, 1.1);
            set(18, 0.0, -0.9 - 0.3 * sin, 0.0);
            set(19, 0.0, 0.9 - 0.3 * sin, 0.0);
            pose
        })
        .collect()
}
