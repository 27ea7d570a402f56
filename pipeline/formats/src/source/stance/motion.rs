//! The motion in a pickle.

use datasets_spec::{Fps, Skeleton};
use glam::DQuat;

use crate::source::robot;
use crate::source::smpl::{Parameters, column, rotations_note};
use clip::check::FLAG_FPS_DOUBTFUL;
use clip::{Outcome, Rejected, RotationSource, SourceClip, rejected};
use pickle::joblib;
use pickle::{Array, Value};

/// Rate of AIST++, in 1/s.
const AIST_FPS: f64 = 60.0;
/// Numbers per frame of SMPL's pose: 24 joints, the last two of them hands.
const SMPL_WIDTH: usize = 72;

/// Reads a single pickle as a motion: a dictionary as in the STANCE release (`body_pose`, `global_orient`, `transl`;
/// SMPL-X, y up, at the rate `fps`), or one of AIST++ (`smpl_poses`, `smpl_trans`, `smpl_scaling`; SMPL, y up, 60 fps).
/// Without `fps` the rate of the release is taken, 20 fps, and the clip is flagged: other programs use the same keys.
///
/// # Errors
/// `E-STANCE-KEYS` for other content, `E-SMPL-SHAPE`, `E-TOO-SHORT`, `E-NOT-FINITE`, `E-FPS`, and those of
/// [`joblib::read`].
pub fn read_pickle_motion(bytes: &[u8], skeleton: &Skeleton) -> Result<SourceClip, Rejected> {
    motion_of(&joblib::read(bytes)?, skeleton)
}

/// Reads a single pickle as a motion. A robot's motion is skipped.
pub(super) fn read_pickle(bytes: &[u8], skeleton: &Skeleton) -> Outcome {
    let value = match joblib::read(bytes) {
        Ok(value) => value,
        Err(error) => return Outcome::Rejected(error.into()),
    };
    match robot::pickled(&value) {
        Some(reason) => Outcome::Skipped { reason },
        None => motion_of(&value, skeleton).into(),
    }
}

fn motion_of(value: &Value, skeleton: &Skeleton) -> Result<SourceClip, Rejected> {
    if value.get("smpl_poses").is_some() && value.get("smpl_trans").is_some() {
        return aist(value, skeleton);
    }
    if value.get("src").is_some() && value.get("tgt").is_some() {
        let reason =
            "found a pair (src and tgt) outside a release; put it under a folder named adjustment";
        return Err(Rejected::read("E-STANCE-KEYS", reason));
    }
    let rate = |error: &dyn std::fmt::Display| Rejected::read("E-FPS", error.to_string());
    let Some(stated) = value.get("fps") else {
        let mut clip = clip_at(value, Fps::STORE)?;
        clip.flags |= FLAG_FPS_DOUBTFUL;
        clip.notes.push(
            "the pickle states no frame rate (`fps`); read at that of the STANCE release, 20 fps"
                .to_owned(),
        );
        return Ok(clip);
    };
    let of_array = || stated.as_array()?.to_f64()?.first().copied();
    let number = stated.as_float().or_else(of_array);
    let number = number.ok_or_else(|| rate(&format!("found fps as {}", stated.describe())))?;
    let fps = Fps::from_file(number).map_err(|error| rate(&error))?;
    let mut clip = clip_at(value, fps)?;
    clip.notes.push(format!(
        "SMPL-X parameters at {number} fps, kept as they are"
    ));
    Ok(clip)
}

/// A motion of the release.
pub(super) fn release_clip(value: &Value) -> Result<SourceClip, Rejected> {
    let mut clip = clip_at(value, Fps::STORE)?;
    clip.notes
        .push("SMPL-X parameters of the STANCE release, kept as they are".to_owned());
    Ok(clip)
}

fn clip_at(value: &Value, fps: Fps) -> Result<SourceClip, Rejected> {
    let keys = ["body_pose", "global_orient", "transl"];
    if keys.iter().any(|key| value.get(key).is_none()) {
        return Err(rejected!(
            "E-STANCE-KEYS",
            "found {}, expected one with {}",
            value.describe(),
            keys.join(", ")
        ));
    }
    let parameters = Parameters::new(
        column(value, "global_orient")?,
        column(value, "body_pose")?,
        column(value, "transl")?,
    )?;
    let motion = parameters.unchanged(fps)?;
    Ok(SourceClip::new(motion, RotationSource::Native))
}

/// A dance of AIST++. Its annotations scale the body about its origin before placing it in the world, so
/// translations are divided by the scale to get metres.
fn aist(value: &Value, skeleton: &Skeleton) -> Result<SourceClip, Rejected> {
    let poses: Vec<[f32; SMPL_WIDTH]> = column(value, "smpl_poses")?;
    let mut trans: Vec<[f32; 3]> = column(value, "smpl_trans")?;
    let scale = match value.get("smpl_scaling") {
        None => 1.0,
        Some(scale) => scale
            .as_array()
            .and_then(Array::to_f64)
            .and_then(|scales| scales.first().copied())
            .or(scale.as_float())
            .filter(|scale| scale.is_finite() && *scale > 0.0)
            .ok_or_else(|| {
                rejected!(
                    "E-SMPL-SHAPE",
                    "found smpl_scaling as {}, expected a positive number",
                    scale.describe()
                )
            })?,
    };
    for value in trans.as_flattened_mut() {
        *value = (f64::from(*value) / scale) as f32;
    }
    let poses = poses.iter().filter_map(|pose| pose.first_chunk()).copied();
    let parameters = Parameters::of_poses(poses, trans)?;
    let fps = Fps::new(AIST_FPS).map_err(|error| Rejected::read("E-FPS", error.to_string()))?;
    let motion = parameters.turned(DQuat::IDENTITY, fps, skeleton)?;
    let mut clip = SourceClip::new(motion, RotationSource::Native);
    clip.notes = vec![
        format!("SMPL parameters of AIST++ at {AIST_FPS} fps, translation divided by {scale}"),
        rotations_note(skeleton),
    ];
    Ok(clip)
}
