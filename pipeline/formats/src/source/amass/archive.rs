//! The arrays of an npz archive as parameters.

use std::io::{Cursor, Read, Seek};

use kinematics::motion::BODY_POSE_WIDTH;
use pickle::npy::{self, Rows};
use pickle::npz::Archive;

use super::parameters::{Parameters, Variant};
use crate::source::format::too_short;
use crate::source::robot;
use clip::{MAX_FPS, MIN_FPS, Rejected, rejected};

/// Keys of the frame rate in the SMPL-H and in the SMPL-X releases.
const FPS_KEYS: [&str; 2] = ["mocap_framerate", "mocap_frame_rate"];

/// Contents of an archive.
pub enum Parsed<'a> {
    /// A recording.
    Parameters(Box<Parameters<'a>>),
    /// A file that is not a motion.
    NoMotion {
        /// Why the file is skipped.
        reason: String,
    },
}

/// Reads the parameters of an archive. `rate`, in 1/s, replaces the rate that the archive states.
///
/// # Errors
/// As [`super::read`].
pub fn parse_at(bytes: &[u8], rate: Option<f64>) -> Result<Parsed<'_>, Rejected> {
    let mut archive = Archive::in_memory(bytes)?;
    let split_poses = archive.has("root_orient") && archive.has("pose_body");
    if !archive.has("trans") || !(archive.has("poses") || split_poses) {
        return no_poses(archive.keys());
    }
    let gender = read_gender(&mut archive);
    let known = gender.as_ref().ok().and_then(Option::as_deref);
    let (variant, root, body, body_at) = if archive.has("poses") {
        let poses = matrix(&mut archive, bytes, "poses")?;
        let variant = Variant::of_width(poses.width(), known).ok_or_else(|| {
            rejected!(
                "E-AMASS-SHAPE",
                "found poses of {} columns, expected 72 (SMPL), 156 (SMPL-H) or 165 (SMPL-X)",
                poses.width()
            )
        })?;
        check_parts(&mut archive, bytes, &poses)?;
        (variant, poses.clone(), poses, 3)
    } else {
        let root = matrix(&mut archive, bytes, "root_orient")?;
        let body = matrix(&mut archive, bytes, "pose_body")?;
        expect_columns("root_orient", &root, 3)?;
        expect_columns("pose_body", &body, BODY_POSE_WIDTH)?;
        (Variant::smplx(known), root, body, 0)
    };
    let trans = matrix(&mut archive, bytes, "trans")?;
    expect_columns("trans", &trans, 3)?;
    let num_frames = trans.num_rows();
    for (key, found) in [
        ("root orientations", root.num_rows()),
        ("body poses", body.num_rows()),
    ] {
        if found != num_frames {
            return Err(rejected!(
                "E-AMASS-SHAPE",
                "found {found} {key}, expected {num_frames} as trans has"
            ));
        }
    }
    if num_frames == 0 {
        return Err(too_short(0));
    }
    let stated_fps = match rate {
        Some(rate) => rate,
        None => read_fps(&mut archive)?,
    };
    let betas = read_betas(&mut archive);
    let parameters = Parameters {
        stated_fps,
        variant,
        gender,
        betas,
        trans,
        root,
        body,
        body_at,
    };
    parameters.check_finite()?;
    Ok(Parsed::Parameters(Box::new(parameters)))
}

/// Variant, number of frames and frame rate, read without unpacking whole arrays of poses; `None` if the archive is no
/// recording.
///
/// # Errors
/// `E-NPZ-TRUNCATED`, `E-NPZ-LIMIT`, `E-ARCHIVE-PATH`, `E-AMASS-FPS`, or those of [`npy`].
pub fn peek<R: Read + Seek>(reader: R) -> Result<Option<(Variant, usize, f64)>, Rejected> {
    let mut archive = Archive::open(reader)?;
    let key = if archive.has("poses") {
        "poses"
    } else {
        "pose_body"
    };
    if !archive.has("trans") || !archive.has(key) {
        return Ok(None);
    }
    let gender = read_gender(&mut archive).ok().flatten();
    let shape = archive.shape(key)?;
    let [num_frames, width] = shape[..] else {
        return Ok(None);
    };
    let variant = match key {
        "poses" => Variant::of_width(width, gender.as_deref()),
        _ => Some(Variant::smplx(gender.as_deref())),
    };
    let fps = read_fps(&mut archive)?;
    Ok(variant.map(|variant| (variant, num_frames, fps)))
}

/// Refuses a recording with arrays that are too large to read, from the member list and the headers alone.
pub(super) fn refuse_large<R: Read + Seek>(reader: R) -> Option<Rejected> {
    let mut archive = Archive::open(reader).ok()?;
    for key in ["poses", "pose_body", "root_orient", "trans"] {
        if !archive.has(key) {
            continue;
        }
        let Err(error) = archive.check_size(key) else {
            continue;
        };
        let mut rejected = Rejected::from(error);
        if let (Ok(shape), Ok(fps)) = (archive.shape(key), read_fps(&mut archive)) {
            let frames = shape.first().copied().unwrap_or(0);
            rejected.reason = format!(
                "{frames} frames at {fps} fps are {:.1} hours: {}; cut the recording into parts",
                frames as f64 / fps / 3600.0,
                rejected.reason
            );
        }
        return Some(rejected);
    }
    None
}

fn no_poses<'a>(keys: &[String]) -> Result<Parsed<'a>, Rejected> {
    let has = |key: &str| keys.iter().any(|found| found == key);
    let list = keys.join(", ");
    let is_still = !has("trans") && !FPS_KEYS.into_iter().any(has);
    if is_still && (has("betas") || has("markers_latent")) {
        return Ok(Parsed::NoMotion {
            reason: format!("body shape of a subject, no motion (keys: {list})"),
        });
    }
    if let Some(reason) = robot::archived(has) {
        return Ok(Parsed::NoMotion { reason });
    }
    let hint = if has("posed_joints") || has("global_rot_mats") {
        "; joint positions and global rotations of another skeleton than SMPL are not read"
    } else {
        ""
    };
    Err(rejected!(
        "E-AMASS-KEYS",
        "found keys {list}; expected trans and either poses or root_orient and pose_body{hint}"
    ))
}

/// Reads a two-dimensional array.
fn matrix<'a>(
    archive: &mut Archive<Cursor<&'a [u8]>>,
    bytes: &'a [u8],
    key: &str,
) -> Result<Rows<'a>, Rejected> {
    let member = archive.borrowed(bytes, key)?;
    Rows::new(key, member)?.map_err(|shape| {
        rejected!(
            "E-AMASS-SHAPE",
            "found {key} of shape {shape:?}, expected frames by columns"
        )
    })
}

/// Refuses an archive whose parts of the poses in arrays of their own differ from `poses`.
fn check_parts<'a>(
    archive: &mut Archive<Cursor<&'a [u8]>>,
    bytes: &'a [u8],
    poses: &Rows<'a>,
) -> Result<(), Rejected> {
    /// Larger than what rounding to single precision makes of an angle in radians.
    const TOLERANCE: f64 = 1e-4;
    for (key, from, width) in [("root_orient", 0, 3), ("pose_body", 3, BODY_POSE_WIDTH)] {
        if !archive.has(key) {
            continue;
        }
        let part = matrix(archive, bytes, key)?;
        let (found, frames) = (part.num_rows(), poses.num_rows());
        if found != frames {
            return Err(rejected!(
                "E-AMASS-KEYS",
                "found {found} frames in {key} and {frames} in poses, expected as many"
            ));
        }
        let width = width.min(part.width());
        for (frame, column) in (0..frames * width).map(|at| (at / width, at % width)) {
            let ([own], [other]) = (part.get(frame, column), poses.get(frame, from + column));
            if (own - other).abs() > TOLERANCE {
                return Err(rejected!(
                    "E-AMASS-KEYS",
                    "found {own} in frame {frame} of {key} and {other} in poses, expected the same"
                ));
            }
        }
    }
    Ok(())
}

/// Shape parameters of the subject's body; empty if the archive has none that can be read.
fn read_betas<R: Read + Seek>(archive: &mut Archive<R>) -> Vec<f64> {
    let betas = archive.numbers("betas").map(|array| array.values);
    betas
        .ok()
        .filter(|betas| betas.iter().all(|beta| beta.is_finite()))
        .unwrap_or_default()
}

/// The gender, which releases write as text, as bytes, or as an array of either. `None` if the archive states none; the
/// error says why it cannot be read.
fn read_gender<R: Read + Seek>(archive: &mut Archive<R>) -> Result<Option<String>, String> {
    if !archive.has("gender") {
        return Ok(None);
    }
    let gender = archive
        .member("gender")
        .and_then(|bytes| npy::read_text("gender", &bytes))
        .map_err(|rejected| rejected.reason)?;
    // Some files hold the text of a Python bytes object: `b'male'`.
    let gender = gender.trim_start_matches("b'").trim_end_matches('\'');
    Ok(Some(gender.to_owned()))
}

/// The frame rate an archive states, in 1/s.
///
/// # Errors
/// `E-AMASS-FPS` if the rate is missing or implausible, or if both keys state one and they differ, or those of [`npy`].
pub fn read_fps<R: Read + Seek>(archive: &mut Archive<R>) -> Result<f64, Rejected> {
    /// Relative difference that is larger than rounding to single precision.
    const TOLERANCE: f64 = 1e-6;
    let mut keys = FPS_KEYS.to_vec();
    keys.retain(|key| archive.has(key));
    match keys[..] {
        [] => Err(rejected!(
            "E-AMASS-FPS",
            "found keys {}, expected {}",
            archive.keys().join(", "),
            FPS_KEYS.join(" or ")
        )),
        [key, other, ..] => {
            let (fps, again) = (read_rate(archive, key)?, read_rate(archive, other)?);
            match (fps / again - 1.0).abs() <= TOLERANCE {
                true => Ok(fps),
                false => Err(rejected!(
                    "E-AMASS-FPS",
                    "found {key} {fps} and {other} {again}, expected the same rate"
                )),
            }
        }
        [key] => read_rate(archive, key),
    }
}

/// The rate under a key.
fn read_rate<R: Read + Seek>(archive: &mut Archive<R>, key: &str) -> Result<f64, Rejected> {
    let rate = archive.numbers(key)?;
    let value = rate.values.first().copied().unwrap_or(f64::NAN);
    if rate.values.len() == 1 && (MIN_FPS..=MAX_FPS).contains(&value) {
        return Ok(value);
    }
    Err(rejected!(
        "E-AMASS-FPS",
        "found {key} {value} ({} values), expected one of {MIN_FPS} to {MAX_FPS}",
        rate.values.len()
    ))
}

fn expect_columns(key: &str, rows: &Rows<'_>, expected: usize) -> Result<(), Rejected> {
    if rows.width() == expected {
        return Ok(());
    }
    Err(rejected!(
        "E-AMASS-SHAPE",
        "found {key} of {} columns, expected {expected}",
        rows.width()
    ))
}
