//! Clips cut from a recording.

use datasets_spec::Fps;
use datasets_spec::sides::mirrored;
use datasets_spec::table::Caption;
use glam::{DMat3, DQuat, DVec3};

use crate::source::amass::Parameters;
use crate::source::files::Files;
use crate::source::humanml3d::{self, IndexRow};
use crate::source::options::ReadOptions;
use clip::check::FLAG_FPS_DOUBTFUL;
use clip::{Rejected, RotationSource, SourceClip, rejected, true_rate_note};

/// Number of frames that a crop may lack at its end without a note: rounding a rate can cost one.
const END_TOLERANCE: usize = 1;

/// A crop of a recording that is among the files.
#[derive(Clone, Debug)]
pub(super) struct Crop {
    pub(super) row: IndexRow,
    pub(super) subset: &'static str,
    pub(super) lead_in_frames: usize,
    /// Captions of the clip, and of its mirror image.
    pub texts: [Option<String>; 2],
    pub(super) note: Option<String>,
}

impl Crop {
    /// The captions of the clip or of its mirror image. A mirror image without a file of its own has the
    /// clip's captions with the sides swapped.
    pub(super) fn captions(
        &self,
        files: &Files,
        is_mirrored: bool,
    ) -> Result<(Vec<Caption>, Option<String>), Rejected> {
        let [own, image] = &self.texts;
        match (is_mirrored, own, image) {
            (false, Some(file), _) | (true, _, Some(file)) => humanml3d::read_captions(files, file),
            (true, Some(file), None) => {
                let (captions, note) = humanml3d::read_captions(files, file)?;
                let swapped = captions.into_iter().map(|caption| Caption {
                    text: mirrored(&caption.text),
                    tokens: mirrored(&caption.tokens),
                    ..caption
                });
                Ok((swapped.collect(), note))
            }
            (_, None, _) => Ok((Vec::new(), None)),
        }
    }
}

/// HumanML3D's rotation of AMASS, `(x, y, z)` to `(-x, z, y)`: z up to y up, and half a turn about the vertical.
fn humanml3d_turn() -> DQuat {
    let axes = DMat3::from_cols(DVec3::NEG_X, DVec3::Z, DVec3::Y);
    DQuat::from_mat3(&axes)
}

/// The frames of a recording that a crop selects.
///
/// Every `floor(fps / 20)`-th frame is kept, none is interpolated; lead-in and crop count the kept
/// frames. A crop that ends after the recording ends with it.
///
/// # Source
/// EricGuo5513/HumanML3D, `raw_pose_processing`.
pub(super) fn frames_of(
    num_frames: usize,
    stride: usize,
    lead_in_frames: usize,
    row: &IndexRow,
) -> Vec<usize> {
    let strided = (0..num_frames).step_by(stride).skip(lead_in_frames);
    let len = row
        .end
        .map_or(usize::MAX, |end| end.saturating_sub(row.start));
    strided.skip(row.start).take(len).collect()
}

/// Cuts a clip out of a recording.
pub(super) fn cut(
    parameters: &Parameters<'_>,
    crop: &Crop,
    options: &ReadOptions,
) -> Result<SourceClip, Rejected> {
    let skeleton = &options.skeleton;
    let fps = humanml3d::FPS;
    let stated = parameters.stated_fps;
    // The rate is not rounded first: that would shift every frame of a recording at 119.99 fps.
    let stride = (stated / fps.get()).floor() as usize;
    if stride == 0 {
        return Err(rejected!(
            "E-AMASS-FPS",
            "found {stated} fps, expected at least {fps} to cut HumanML3D's clips from"
        ));
    }
    let row = &crop.row;
    let frames = frames_of(parameters.num_frames(), stride, crop.lead_in_frames, row);
    let wanted = row.end.map(|end| end.saturating_sub(row.start));
    if frames.len() < 2 {
        return Err(rejected!(
            "E-TOO-SHORT",
            "found {} frames of the crop {}..{} in {} frames at {stated} fps, expected at \
                 least 2",
            frames.len(),
            row.start,
            row.end.map_or("end".to_owned(), |end| end.to_string()),
            parameters.num_frames()
        ));
    }
    let grid: Vec<(usize, f64)> = frames.iter().map(|&frame| (frame, 0.0)).collect();
    let motion = parameters.motion_at(&grid, humanml3d_turn(), fps, skeleton)?;
    let mut clip = SourceClip::new(motion, RotationSource::Native);
    let last = frames.last().copied().unwrap_or(0);
    clip.source_frames = frames.first().copied().unwrap_or(0)..last + 1;
    clip.source_fps = Fps::new(stated).unwrap_or(fps);
    parameters.describe(&mut clip, skeleton, options);
    clip.notes.push(format!(
        "cut from {} of subset {}: every {stride}. frame of {stated} fps, frames {}..{} after a \
         lead-in of {}",
        row.source_path,
        crop.subset,
        row.start,
        row.start + frames.len(),
        crop.lead_in_frames
    ));
    if clip.body.is_none() {
        clip.notes.push(format!(
            "the published joints and features are those of the subject's body; what is made of \
             this clip is that of {}",
            skeleton.name()
        ));
    }
    let missing = wanted.map_or(0, |wanted| wanted.saturating_sub(frames.len()));
    if missing > END_TOLERANCE {
        clip.flags |= FLAG_FPS_DOUBTFUL;
        clip.notes.push(format!(
            "the crop wants {missing} frames more than the recording has at its stated rate"
        ));
    }
    if parameters.variant.is_smplx() {
        clip.notes.push(
            "cut from SMPL-X parameters; the crop counts frames of the SMPL-H G release, whose \
             rate differs in some recordings"
                .to_owned(),
        );
    }
    clip.notes
        .extend(true_rate_note(stated / stride as f64, fps));
    Ok(clip)
}
