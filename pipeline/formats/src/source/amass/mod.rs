//! The AMASS reader: SMPL, SMPL-H and SMPL-X parameters in an npz archive, z up.

mod archive;
pub mod catalogue;
mod parameters;
#[cfg(test)]
pub(crate) mod tests;

use std::path::Path;

use datasets_spec::Fps;
use kinematics::resample;

use super::format::Format;
use super::options::ReadOptions;
use super::up::Up;
use clip::check::FLAG_FPS_DOUBTFUL;
use clip::{Outcome, Rejected, RotationSource, SourceClip, check_resampled};

pub use archive::{Parsed, parse_at, peek, read_fps};
pub use parameters::{Parameters, Variant};

/// The up axis of the files.
const UP: Up = Up::Z;
/// Relative tolerance between a stated and a known frame rate: the stored 120.000046 and 59.94 count as 120 and 60.
const FPS_TOLERANCE: f64 = 0.01;

/// Reads an archive as a motion of the given body; an archive without motion is skipped. `path` names the subset, whose
/// known frame rate replaces a wrong stated one; both are noted and the clip is flagged.
///
/// The 22 body rotations are used unchanged: the joints of SMPL, SMPL-H and SMPL-X agree in order and rest orientation.
/// Body shape is ignored: the body of the options performs the motion. With a [`ReadOptions::rate`], the clip is
/// interpolated at exact times to that rate; only the frames that this needs are converted, and the floor is estimated
/// from them. All frames are checked to be finite.
///
/// # Errors
/// `E-NPZ-TRUNCATED`, `E-NPZ-LIMIT`, `E-ARCHIVE-PATH`, those of [`pickle::npy`], `E-AMASS-KEYS`,
/// `E-AMASS-SHAPE`, `E-AMASS-FPS`, `E-TOO-SHORT` or `E-NOT-FINITE`.
///
/// # Source
/// For a rotation `Q` of the world, `R' = Q R` and `t' = Q (t + J0) - J0` with `J0` the rest
/// position of the pelvis, about which SMPL turns the body.
pub fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<Outcome, Rejected> {
    let (rate, skeleton) = (options.rate, &options.skeleton);
    let parameters = match parse_at(bytes, None)? {
        Parsed::Parameters(parameters) => *parameters,
        Parsed::NoMotion { reason } => return Ok(Outcome::Skipped { reason }),
    };
    let stated = parameters.stated_fps;
    let known =
        catalogue::true_fps(path).filter(|known| (stated / known - 1.0).abs() > FPS_TOLERANCE);
    let source_fps = Fps::from_file(known.unwrap_or(stated))
        .map_err(|error| Rejected::read("E-AMASS-FPS", error.to_string()))?;
    let num_frames = parameters.num_frames();
    let target = rate.unwrap_or(source_fps);
    check_resampled(num_frames, source_fps, target)?;
    let grid = if target == source_fps {
        (0..num_frames).map(|frame| (frame, 0.0)).collect()
    } else {
        resample::grid(num_frames, source_fps, target)
    };
    let motion = parameters.motion_at(&grid, UP.turn(), target, skeleton)?;
    let mut clip = SourceClip::new(motion, RotationSource::Native);
    clip.source_frames = 0..num_frames;
    clip.source_fps = source_fps;
    clip.stated_fps = Fps::new(known.unwrap_or(stated))
        .ok()
        .filter(|_| rate.is_none());
    parameters.describe(&mut clip, skeleton, options);
    clip.notes.extend(subset_note(path));
    if let Some(known) = known {
        clip.notes.push(format!(
            "the file states {stated} fps; {known} fps were taken, as is known of this recording"
        ));
        clip.flags |= FLAG_FPS_DOUBTFUL;
    }
    Ok(Outcome::Clip(Box::new(clip)))
}

/// A note on the subset that a path belongs to, under its current name.
fn subset_note(path: &Path) -> Option<String> {
    let (subset, found) = catalogue::subset_of(path)?;
    Some(if subset.name == found {
        format!("AMASS subset {found}")
    } else {
        format!("AMASS subset {} (here under the name {found})", subset.name)
    })
}

/// AMASS: SMPL, SMPL-H or SMPL-X parameters in an npz archive.
// Bytes per second: SMPL-H at 120 fps in f8.
pub const FORMAT: Format = Format {
    extensions: &["npz"],
    assumed_up: Some(UP),
    by_name: |name, _| {
        let reason = match name {
            "shape.npz" => "body shape of a subject, no motion",
            name if name.ends_with("_stagei.npz") => {
                "body shape of a subject (MoSh stage i), no motion"
            }
            _ => return Some(Ok(())),
        };
        Some(Err(reason.to_owned()))
    },
    refuse_large: archive::refuse_large,
    read: |path, _, bytes, options| read(path, bytes, options).unwrap_or_else(Outcome::Rejected),
    ..Format::of_files(
        "amass",
        ".npz with poses and trans: SMPL, SMPL-H, SMPL-X, gendered or neutral; its own rotations",
        160_000.0,
    )
};
