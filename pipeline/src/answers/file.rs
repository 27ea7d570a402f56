//! Files with one answer each.

use std::path::Path;

use clip::{Rejected, rejected};
use datasets_spec::{Fps, Skeleton};
use formats::source::smpl::{column, frame_width};
use formats::source::{amass, humanml3d};
use glam::DQuat;
use kinematics::motion::BODY_POSE_WIDTH;
use kinematics::rotation::{from_six_d_rows, to_axis_angle};
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::options::{AnswerOptions, Place};
use super::recorded::{Recorded, VECTORS_WIDTH};
use formats::source::Up;
use pickle::joblib;
use pickle::npy;
use pickle::npz::Archive;
use pickle::{self, Value};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// SMPL parameters of AMASS's layouts, z up, or of the store's, y up.
    Npz,
    /// A dictionary of MotionFix's evaluation, or an array of HumanML3D features.
    Npy,
    Pickle,
    Parquet,
}

impl Kind {
    /// The kind of a file, or why it holds no answer.
    pub(super) fn of(path: &Path) -> Result<Self, String> {
        let extension = path
            .extension()
            .map(|extension| extension.to_string_lossy());
        match extension.unwrap_or_default().to_lowercase().as_str() {
            "npz" => Ok(Self::Npz),
            "npy" => Ok(Self::Npy),
            "pkl" | "pickle" => Ok(Self::Pickle),
            "parquet" => Ok(Self::Parquet),
            "" => Err("no known format of answers".to_owned()),
            other => Err(format!("{other} is no known format of answers")),
        }
    }
}

/// Rate of MotionFix, in 1/s.
const MOTIONFIX_FPS: f64 = 30.0;
/// Rate of the STANCE release and of HumanML3D, in 1/s.
const RELEASE_FPS: f64 = 20.0;
/// Numbers of a frame of MotionFix's `pose`: the translation, then 6 for the root and for each of 21 body joints.
const POSE_WIDTH: usize = 3 + 6 * NUM_BODY_JOINTS;
/// Keys of the store's layout, in the names of SMPL-X.
const STORE_KEYS: [&str; 3] = ["transl", "global_orient", "body_pose"];

/// Reads a file with one answer.
///
/// # Errors
/// Those of the readers in [`formats::source`]; `E-ANSWER-KEYS` if arrays of a motion are missing.
pub(super) fn read(
    kind: Kind,
    bytes: &[u8],
    skeleton: &Skeleton,
    options: &AnswerOptions,
) -> Result<Recorded, Rejected> {
    formats::source::refuse_pointer(bytes)?;
    match kind {
        Kind::Npz => npz(bytes, options),
        Kind::Npy => npy(bytes, skeleton),
        Kind::Pickle => of_value(&joblib::read(bytes)?),
        Kind::Parquet => unreachable!("tables are read by their own reader"),
    }
}

fn npz(bytes: &[u8], options: &AnswerOptions) -> Result<Recorded, Rejected> {
    let mut archive = Archive::in_memory(bytes)?;
    let of_store = STORE_KEYS.iter().all(|key| archive.has(key));
    if !of_store {
        return of_amass(bytes, options);
    }
    if archive.has("trans") {
        return Err(Rejected::read(
            "E-ANSWER-KEYS",
            "found trans, which is z up, beside transl, global_orient and body_pose, which are y \
             up; keep one of the two layouts",
        ));
    }
    let fps = match archive.has("fps") {
        true => archive.numbers("fps")?.values.first().copied(),
        // `Recorded::motion` reports a missing rate.
        false => amass::read_fps(&mut archive).ok(),
    };
    let mut frames = |key: &str, width: usize| -> Result<Vec<f64>, Rejected> {
        let array = archive.numbers(key)?;
        if frame_width(&array.shape) != Some(width) {
            return Err(rejected!(
                "E-SMPL-SHAPE",
                "found {key} of shape {:?}, expected frames by {width} numbers",
                array.shape
            ));
        }
        Ok(array.values)
    };
    let (transl, root) = (frames(STORE_KEYS[0], 3)?, frames(STORE_KEYS[1], 3)?);
    let body = frames(STORE_KEYS[2], BODY_POSE_WIDTH)?;
    let recorded = Recorded::of_columns(
        transl.as_chunks::<3>().0,
        root.as_chunks::<3>().0,
        body.as_chunks::<BODY_POSE_WIDTH>().0,
    )?;
    Ok(Recorded { fps, ..recorded })
}

fn of_amass(bytes: &[u8], options: &AnswerOptions) -> Result<Recorded, Rejected> {
    let parameters = match amass::parse_at(bytes, options.fps.map(Fps::get))? {
        amass::Parsed::Parameters(parameters) => *parameters,
        amass::Parsed::NoMotion { reason } => {
            return Err(Rejected::read("E-ANSWER-KEYS", reason));
        }
    };
    let frames = 0..parameters.num_frames();
    Ok(Recorded {
        fps: Some(parameters.stated_fps),
        up: Up::Z,
        place: Place::File,
        transl: frames
            .clone()
            .map(|at| parameters.translation(at))
            .collect(),
        vectors: frames.map(|at| parameters.vectors(at)).collect(),
        fit_error_m: None,
    })
}

fn npy(bytes: &[u8], skeleton: &Skeleton) -> Result<Recorded, Rejected> {
    if let Some((dump, start)) = npy::pickled("array", bytes)? {
        let at = |error: pickle::Error| pickle::Error {
            byte_offset: error.byte_offset.map(|at| at + start as u64),
            ..error
        };
        let value = pickle::read(dump).map_err(at)?;
        // NumPy pickles the dictionary as an array of one item.
        return match value.as_sequence() {
            Some([inner]) => of_value(inner),
            _ => of_value(&value),
        };
    }
    let clip = humanml3d::read_array(bytes, skeleton)?;
    Ok(Recorded {
        // Features have no origin and no heading, so the motion is placed at the item's source.
        place: Place::Source,
        fit_error_m: clip.fit_error_m,
        ..Recorded::of_motion(&clip.motion)
    })
}

/// Reads the motion of a dictionary: `pose`, or `rots` and `trans`, of MotionFix (SMPL-H, z up, 30 fps), or
/// `body_pose`, `global_orient` and `transl` (SMPL-X, y up, 20 fps) as the STANCE release has them. A number `fps`
/// beside them takes precedence.
///
/// # Source
/// Repository athn-nik/motionfix: the output of its evaluation for each item.
fn of_value(value: &Value) -> Result<Recorded, Rejected> {
    let fps = value.get("fps").and_then(number);
    let has = |key: &str| value.get(key).is_some();
    let recorded = if has("pose") {
        let frames: Vec<[f32; POSE_WIDTH]> = column(value, "pose")?;
        let transl = frames.iter().map(|frame| wide(&frame[..3]));
        Recorded {
            transl: transl.collect(),
            vectors: frames.iter().map(|frame| from_rows(&frame[3..])).collect(),
            ..Recorded::of_columns::<f32>(&[], &[], &[])?
        }
    } else if has("rots") && has("trans") {
        let rotations: Vec<[f32; VECTORS_WIDTH]> = column(value, "rots")?;
        let transl: Vec<[f32; 3]> = column(value, "trans")?;
        let root: Vec<[f64; 3]> = rotations.iter().map(|frame| wide(&frame[..3])).collect();
        let body: Vec<[f64; BODY_POSE_WIDTH]> =
            rotations.iter().map(|frame| wide(&frame[3..])).collect();
        let transl: Vec<[f64; 3]> = transl.iter().map(|frame| wide(frame)).collect();
        Recorded::of_columns(&transl, &root, &body)?
    } else if STORE_KEYS.iter().all(|key| has(key)) {
        let transl: Vec<[f32; 3]> = column(value, STORE_KEYS[0])?;
        let root: Vec<[f32; 3]> = column(value, STORE_KEYS[1])?;
        let body: Vec<[f32; BODY_POSE_WIDTH]> = column(value, STORE_KEYS[2])?;
        let recorded = Recorded::of_columns(&transl, &root, &body)?;
        return Ok(Recorded {
            fps: fps.or(Some(RELEASE_FPS)),
            ..recorded
        });
    } else {
        return Err(rejected!(
            "E-ANSWER-KEYS",
            "found {}, expected one with pose, with rots and trans, or with transl, \
                 global_orient and body_pose",
            value.describe()
        ));
    };
    Ok(Recorded {
        fps: fps.or(Some(MOTIONFIX_FPS)),
        up: Up::Z,
        // MotionFix's evaluation integrates features from its own origin and heading, so the motion is placed at the
        // item's source.
        place: Place::Source,
        ..recorded
    })
}

fn number(value: &Value) -> Option<f64> {
    let of_array = || value.as_array()?.to_f64()?.first().copied();
    value.as_float().or_else(of_array)
}

/// Converts a frame to double precision. Panics if there are fewer than `N` numbers.
fn wide<const N: usize>(frame: &[f32]) -> [f64; N] {
    std::array::from_fn(|column| f64::from(frame[column]))
}

/// Rotation vectors from the first two rows of each joint's matrix. A joint with numbers that are not finite becomes
/// NaN, which `Recorded::motion` refuses.
fn from_rows(frame: &[f32]) -> [f64; VECTORS_WIDTH] {
    let mut vectors = [0.0; VECTORS_WIDTH];
    for (rows, vector) in frame.chunks_exact(6).zip(vectors.chunks_exact_mut(3)) {
        let rows: [f64; 6] = wide(rows);
        let found = match rows.iter().all(|value| value.is_finite()) {
            true => to_axis_angle(DQuat::from_mat3(&from_six_d_rows(rows))).to_array(),
            false => [f64::NAN; 3],
        };
        vector.copy_from_slice(&found);
    }
    vectors
}
