//! Synthetic motions and masks for the tests of the composer.

use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::{
    BodyPart, Fps, MASK_DEF_VERSION, Motion, MotionId, Pose, Seed, Skeleton, Split,
};
use glam::DVec3;
use kinematics::canonical::WINDOW_FRAMES;
use kinematics::rotation::from_axis_angle;
use rand::RngExt;

use super::Library;

/// Stored frames a window spans at 20 fps.
pub(crate) const SPAN: usize = 2 * (WINDOW_FRAMES - 1) + 1;

/// A body that walks a curve while every joint swings at a rate and phase of its own.
pub(crate) fn wandering(name: &str, num_frames: usize) -> Motion {
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

/// The row of a motion.
pub(crate) fn motion_row(id: &str, split: Split, motion: &Motion) -> MotionRow {
    MotionRow {
        source: "synthetic".to_owned(),
        source_path: format!("{id}.npz"),
        ..MotionRow::new(MotionId::parse(id).expect("valid id"), split, motion)
    }
}

/// The row of a mask of one body part.
pub(crate) fn mask_row(motion: &str, split: Split, part: BodyPart) -> MaskRow {
    MaskRow {
        id: format!("{motion}#{part}"),
        motion_id: MotionId::parse(motion).expect("valid id"),
        split,
        parts: vec![part.name().to_owned()],
        hard_joints: part.mask().hard().names(),
        soft_joints: part.mask().soft().names(),
        mask_def_version: MASK_DEF_VERSION,
        text: super::instruction("waving", part),
        text_origin: "human".to_owned(),
        author: "fixture".to_owned(),
        accepted_by: None,
    }
}

/// Motions `clip0`, `clip1`, ... of different lengths, every second one annotated.
pub(crate) fn rows(split: Split, num_clips: usize) -> (Vec<MotionRow>, Vec<MaskRow>) {
    let mut motions = Vec::new();
    let mut masks = Vec::new();
    for clip in 0..num_clips {
        let id = format!("clip{clip}");
        let mut row = motion_row(&id, split, &wandering(&id, SPAN + 13 * clip));
        row.action = Some(["wave", "kick"][clip % 2].to_owned());
        motions.push(row);
        if clip % 2 == 0 {
            masks.push(mask_row(
                &id,
                split,
                BodyPart::ALL[clip / 2 % BodyPart::ALL.len()],
            ));
        }
    }
    (motions, masks)
}

/// A library of those motions.
pub(crate) fn library(split: Split, num_clips: usize) -> Library {
    let (motions, masks) = rows(split, num_clips);
    Library::new(split, &motions, &masks, &[], &Skeleton::smplx_neutral()).expect("valid rows")
}

/// The row of a pair of the clips of [`rows`] that are numbered so.
pub(crate) fn pair_row(kind: &str, split: Split, source: usize, target: usize) -> PairRow {
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
