//! npy arrays: 263-d feature vectors and joint positions.

use datasets_spec::record::HUMANML3D_WIDTH;
use datasets_spec::{Fps, Skeleton};
use features::{motion_of_features, motion_of_joints};
use glam::DVec3;
use kinematics::skeleton::NUM_BODY_JOINTS;
use pickle::npy::{self, Array};

use crate::source::format::too_short;
use crate::source::head::refuse_pointer;
use clip::{Rejected, RotationSource, SourceClip, rejected};

/// Rate of the published clips.
pub(crate) const FPS: Fps = Fps::STORE;

/// Widths of KIT-ML, which has the same layout: number of features, and number of joints.
pub(super) const KIT_WIDTH: usize = 251;
pub(super) const KIT_JOINTS: usize = 21;

/// Reads HumanML3D's feature vectors or joint positions as a motion of the given body.
///
/// # Shapes
/// `[T, 263]`, or `[T, 22, 3]` in metres, y up.
///
/// # Errors
/// Those of [`npy`], `E-LFS-POINTER`, `E-HML-SHAPE`, `E-HML-FINITE`, `E-HML-FIT` or `E-TOO-SHORT`.
pub fn read_array(bytes: &[u8], skeleton: &Skeleton) -> Result<SourceClip, Rejected> {
    refuse_pointer(bytes)?;
    let array = npy::read_numbers("array", bytes)?;
    let unfit = |error: &dyn std::fmt::Display| {
        Rejected::retarget("E-HML-FIT", format!("no body has these joints: {error}"))
    };
    let mut carried = None;
    let (motion, fit_error_m, source, note) = if array.shape.last() == Some(&HUMANML3D_WIDTH) {
        let features = features(&array)?;
        let (motion, error) =
            motion_of_features(&features, FPS, skeleton).map_err(|error| unfit(&error))?;
        let note = "rotations from the HumanML3D vector, 20 fps";
        carried = Some(features);
        (motion, error, RotationSource::Retargeted, note)
    } else {
        let joints = joints(&array)?;
        let (motion, error) =
            motion_of_joints(&joints, FPS, skeleton).map_err(|error| unfit(&error))?;
        let note = "rotations fitted to HumanML3D joints, 20 fps";
        (motion, error, RotationSource::Fitted, note)
    };
    let mut clip = SourceClip::new(motion, source);
    clip.fit_error_m = Some(fit_error_m);
    clip.features = carried;
    clip.notes.push(note.to_owned());
    Ok(clip)
}

/// The features of an array `[T, 263]`.
///
/// # Errors
/// `E-HML-SHAPE` for another shape, `E-TOO-SHORT` for fewer than 2 frames, `E-HML-FINITE`.
pub fn features(array: &Array) -> Result<Vec<[f32; HUMANML3D_WIDTH]>, Rejected> {
    let [num_frames, HUMANML3D_WIDTH] = array.shape[..] else {
        return Err(bad_shape(array));
    };
    check_frames(array, num_frames)?;
    Ok(in_single_precision(array))
}

/// The rows of an array `[T, WIDTH]` in `f32`.
pub(crate) fn in_single_precision<const WIDTH: usize>(array: &Array) -> Vec<[f32; WIDTH]> {
    let (rows, _) = array.values.as_chunks::<WIDTH>();
    rows.iter()
        .map(|row| row.map(|value| value as f32))
        .collect()
}

/// Refuses an array of fewer than two frames.
pub(crate) fn check_length(num_frames: usize) -> Result<(), Rejected> {
    match num_frames {
        0 | 1 => Err(too_short(num_frames)),
        _ => Ok(()),
    }
}

/// The joints of an array `[T, 22, 3]`, or of a single frame `[22, 3]`, in metres.
///
/// # Errors
/// As [`features()`].
pub fn joints(array: &Array) -> Result<Vec<[DVec3; NUM_BODY_JOINTS]>, Rejected> {
    let num_frames = match array.shape[..] {
        [num_frames, NUM_BODY_JOINTS, 3] => num_frames,
        // The published code drops the axis of a single frame.
        [NUM_BODY_JOINTS, 3] => 1,
        _ => return Err(bad_shape(array)),
    };
    check_frames(array, num_frames)?;
    let (points, _) = array.values.as_chunks::<3>();
    let (frames, _) = points.as_chunks::<NUM_BODY_JOINTS>();
    Ok(frames
        .iter()
        .map(|frame| frame.map(DVec3::from_array))
        .collect())
}

fn bad_shape(array: &Array) -> Rejected {
    let kit = matches!(array.shape[..], [_, KIT_WIDTH] | [_, KIT_JOINTS, 3]);
    let hint = if kit {
        "; this is the shape of KIT-ML, whose body has 21 joints and is not read"
    } else {
        ""
    };
    rejected!(
        "E-HML-SHAPE",
        "found an array of shape {:?}, expected [frames, {HUMANML3D_WIDTH}] or [frames, \
             {NUM_BODY_JOINTS}, 3]{hint}",
        array.shape
    )
}

fn check_frames(array: &Array, num_frames: usize) -> Result<(), Rejected> {
    check_length(num_frames)?;
    let broken = |value: &f64| !(*value as f32).is_finite();
    match array.values.iter().position(broken) {
        Some(at) => Err(rejected!(
            "E-HML-FINITE",
            "found {} in frame {}, expected finite numbers",
            array.values[at],
            at / (array.values.len() / num_frames)
        )),
        None => Ok(()),
    }
}
