//! The result of reading a motion file: a motion, or the reason why there is none.

pub mod check;

use std::fmt;
use std::ops::Range;

use datasets_spec::record::{HUMANML3D_WIDTH, MaskRow, PairRow};
use datasets_spec::table::{Caption, PartCaption};
use datasets_spec::{BodyPart, Fps, Motion, Skeleton};
use serde::{Deserialize, Serialize};

datasets_spec::named! {
    /// Origin of the rotations of a clip.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum RotationSource, named by as_str {
        /// Stored in the file for this body.
        #[default]
        Native = "native",
        /// Stored in the file for another skeleton.
        Retargeted = "retargeted",
        /// Fitted to positions of joints or markers.
        Fitted = "fitted",
    }
}

/// A clip as read from one file.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceClip {
    /// The motion: SMPL-X parameters, y up, metres, floor at y = 0. Its rate is the file's, or `ReadOptions::rate`.
    pub motion: Motion,
    /// The rate of the file.
    pub source_fps: Fps,
    /// The rate of the motion as its file states it, if that was rounded and HumanML3D's rule for dropping frames counts
    /// by it.
    pub stated_fps: Option<Fps>,
    /// Origin of its rotations.
    pub rotation_source: RotationSource,
    /// Mean distance in metres between the joints of the motion and those of the file, scaled to this body's bone
    /// lengths. If the motion is solved from markers, the mean of [`Markers::fit_residuals`]. `None` for native
    /// rotations of a file without joints.
    pub fit_error_m: Option<f32>,
    /// Frames of the file that the motion was made from.
    pub source_frames: Range<usize>,
    /// Captions that the source states.
    pub captions: Vec<Caption>,
    /// Captions made by rule from the file's name.
    pub made_captions: Vec<Caption>,
    /// Captions of single body parts.
    pub part_captions: Vec<PartCaption>,
    /// Name of the performer.
    pub subject: Option<String>,
    /// Action label.
    pub action: Option<String>,
    /// Style label.
    pub style: Option<String>,
    /// Licence tag.
    pub license: Option<String>,
    /// Labels from files beside the motion that could not be used.
    pub label_problems: Vec<LabelProblem>,
    /// Decisions that a user may want to check, such as the unit that was assumed.
    pub notes: Vec<String>,
    /// Quality flags that only the reader can see, such as [`crate::check::FLAG_CAPTION_OUTSIDE`].
    pub flags: u32,
    /// The captured markers the motion was solved from.
    pub markers: Option<Markers>,
    /// Edits whose target is this clip.
    pub edits: Vec<EditOf>,
    /// Body-part masks from the source.
    pub masks: Vec<SourceMask>,
    /// The HumanML3D features that the motion was made from, a row per frame.
    pub features: Option<Vec<[f32; HUMANML3D_WIDTH]>>,
    /// The body for computing features; `None` if it is that of the dataset.
    pub body: Option<Skeleton>,
}

impl SourceClip {
    /// A clip of a whole file, without captions and labels.
    pub fn new(motion: Motion, rotation_source: RotationSource) -> Self {
        let (num_frames, source_fps) = (motion.len(), motion.fps());
        Self {
            motion,
            rotation_source,
            fit_error_m: None,
            source_fps,
            stated_fps: None,
            source_frames: 0..num_frames,
            captions: Vec::new(),
            made_captions: Vec::new(),
            label_problems: Vec::new(),
            subject: None,
            part_captions: Vec::new(),
            action: None,
            style: None,
            license: None,
            notes: Vec::new(),
            flags: 0,
            markers: None,
            edits: Vec::new(),
            masks: Vec::new(),
            features: None,
            body: None,
        }
    }

    /// Source frames per frame of the motion.
    fn stride(&self) -> f64 {
        let by_rate = self.source_fps.get() / self.motion.fps().get();
        stride(by_rate, self.source_frames.len(), self.motion.len())
    }

    /// The frame of the file that a frame of the motion shows; a fraction lies between two frames.
    pub fn source_frame(&self, frame: f64) -> usize {
        let frames = &self.source_frames;
        let last = frames.end.saturating_sub(1);
        (frames.start + (frame * self.stride()).round() as usize).min(last)
    }

    /// Narrows source frames, captions, masks and features to a part of the motion, and leaves the motion as it is.
    /// `kept` counts in steps of `step` frames of [`SourceClip::motion`].
    ///
    /// Captions with a time and masks with a range are shifted. A caption without a kept frame becomes a note, and
    /// a mask with too few a problem of `file` ([`SourceClip::move_masks`]). Features are dropped unless `step` is 1.
    pub fn narrow(&mut self, kept: &Range<usize>, step: f64, file: &str) {
        let Some(last) = kept.clone().next_back() else {
            return;
        };
        let secs = |frames: usize| (frames as f64 * step / self.motion.fps().get()) as f32;
        let (from, length) = (secs(kept.start), secs(kept.len()));
        let mut cut_off = Vec::new();
        self.captions.retain_mut(|caption| {
            let is_whole = caption.from_s == 0.0 && caption.to_s == 0.0;
            if is_whole {
                return true;
            }
            if caption.to_s <= from || caption.from_s >= from + length {
                cut_off.push(format!(
                    "a caption speaks of frames cut off: {}",
                    caption.text
                ));
                return false;
            }
            caption.from_s = (caption.from_s - from).max(0.0);
            caption.to_s = (caption.to_s - from).min(length);
            true
        });
        self.notes.extend(cut_off);
        let first = kept.start as f64 * step;
        let len = (kept.len() as f64 * step).round() as usize;
        self.move_masks(len, self.motion.fps(), file, |frame| frame - first);
        let stride = step * self.stride();
        let frames = self.source_frames.clone();
        let end = frames.start + (last as f64 * stride).ceil() as usize + 1;
        let start = frames.start + (kept.start as f64 * stride).floor() as usize;
        self.source_frames = start.min(frames.end)..end.min(frames.end);
        let carried = self.features.take().filter(|_| step == 1.0);
        self.features = carried.and_then(|features| Some(features.get(kept.clone())?.to_vec()));
    }

    /// Drops masks whose range of frames is invalid or leaves the motion. Each becomes a [`LabelProblem`] of `file`.
    pub fn check_masks(&mut self, file: &str) {
        let (frames, fps) = (self.motion.len(), self.motion.fps());
        let problems = &mut self.label_problems;
        self.masks.retain(|mask| {
            let Some(row) = &mask.made else { return true };
            let problem = row.frames_at(frames, fps).err();
            problems.extend(problem.as_ref().map(|error| LabelProblem {
                file: file.to_owned(),
                reason: format!("mask {:?}: {error}", row.id),
            }));
            problem.is_none()
        });
    }

    /// Shifts the ranges of masks when the motion is cut or resampled. `place` maps a frame of the old motion to one of
    /// the new motion, which has `len` frames of rate `fps`. A mask whose new range is shorter than
    /// [`MaskRow::shortest`] is dropped, and becomes a [`LabelProblem`] of `file`.
    pub fn move_masks(&mut self, len: usize, fps: Fps, file: &str, place: impl Fn(f64) -> f64) {
        let problems = &mut self.label_problems;
        self.masks.retain_mut(|mask| {
            let Some(row) = &mut mask.made else { return true };
            let is_left = row.move_range(len, fps, &place);
            if !is_left {
                problems.push(LabelProblem {
                    file: file.to_owned(),
                    reason: format!(
                        "mask {:?} is left with too few frames at {fps} and was dropped; a range needs \
                         {} at least",
                        row.id,
                        MaskRow::shortest(fps)
                    ),
                });
            }
            is_left
        });
    }
}

/// Frames of the file per frame of a motion of `frames` frames that covers `covered` frames of its file. `by_rate` is the
/// quotient of their rates.
pub fn stride(by_rate: f64, covered: usize, frames: usize) -> f64 {
    const TOLERANCE: f64 = 1e-3;
    let steps = frames.saturating_sub(1).max(1);
    let taken = covered.saturating_sub(1) as f64 / steps as f64;
    // Interpolated frames cover at least what the rates say. HumanML3D's rule takes every n-th frame, and may cover less.
    // Datasets of earlier versions state the rate after that rule as the rate of the file.
    match by_rate == 1.0 || taken < by_rate - TOLERANCE {
        true => taken.round().max(1.0),
        false => by_rate,
    }
}

/// The note on a motion whose rate is not the stored one; `None` if they differ by no more than rounding.
pub fn true_rate_note(true_fps: f64, stored: Fps) -> Option<String> {
    const TOLERANCE: f64 = 1e-3;
    let differs = (true_fps / stored.get() - 1.0).abs() > TOLERANCE;
    let stored = stored.get();
    differs.then(|| {
        let rounded = (true_fps * 1e3).round() / 1e3;
        format!("its true rate is {rounded} fps, stored as {stored} by the rule of HumanML3D")
    })
}

/// A file of labels, or a part of one, that could not be used. The motions it describes are ingested without it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct LabelProblem {
    /// Path of the file relative to the ingested root.
    pub file: String,
    /// What is wrong with it.
    pub reason: String,
}

impl std::fmt::Display for LabelProblem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.file, self.reason)
    }
}

/// Markers of an optical capture, y up and in metres.
///
/// # Shapes
/// `T` frames of `M = labels.len()` markers, frame by frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Markers {
    /// Frame rate of the capture.
    pub fps: Fps,
    /// Names, `[M]`.
    pub labels: Vec<String>,
    /// Positions in metres, `[T * M]`; zero where the residual is negative.
    pub positions: Vec<[f32; 3]>,
    /// Reconstruction residuals in metres, `[T * M]`; negative where a marker was not seen.
    pub residuals: Vec<f32>,
    /// Name of the marker set that the labels belong to.
    pub set: Option<String>,
    /// Root-mean-square distance in metres between the markers seen in a frame and those of the solved body, `[T]`;
    /// negative for an interpolated frame. Empty until a body is solved.
    pub fit_residuals: Vec<f32>,
}

/// An edit from another clip to this one.
#[derive(Clone, Debug, PartialEq)]
pub struct EditOf {
    /// Id of the motion before the edit.
    pub source_id: String,
    /// `semantic`, `style` or `fine-grained`; empty if a dataset has another kind.
    pub kind: &'static str,
    /// Style of the edit.
    pub style: Option<String>,
    /// Body parts that the edit changes, as the source states them.
    pub parts: Vec<BodyPart>,
    /// Instruction of the edit; empty if the source has none.
    pub instruction: String,
    /// The recorded pair, if the source is a dataset of this program; other pairs are made from the fields above.
    pub made: Option<PairRow>,
}

/// A body-part mask from a source.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceMask {
    /// Parts of the mask.
    pub parts: Vec<BodyPart>,
    /// Text of the masked parts; empty if the source states none.
    pub text: String,
    /// The recorded mask, if the source is a dataset of this program; other masks are made from their parts.
    pub made: Option<MaskRow>,
}

impl EditOf {
    /// The edit that a row of a dataset's table `pairs` describes.
    pub fn of_row(row: PairRow) -> Self {
        let kinds = ["style", "fine-grained", "semantic"];
        Self {
            source_id: row.source_id.to_string(),
            kind: kinds
                .into_iter()
                .find(|kind| *kind == row.kind)
                .unwrap_or_default(),
            style: row.style.clone(),
            parts: parts_of(&row.parts),
            instruction: row.instruction.clone(),
            made: Some(row),
        }
    }
}

impl SourceMask {
    /// The mask that a row of a dataset's table `masks` describes.
    pub fn of_row(row: MaskRow) -> Self {
        Self {
            parts: parts_of(&row.parts),
            text: row.text.clone(),
            made: Some(row),
        }
    }
}

fn parts_of(names: &[String]) -> Vec<BodyPart> {
    names.iter().filter_map(|name| name.parse().ok()).collect()
}

/// Result of reading a motion: a clip, or the reason for rejecting it.
pub type ReadClip = Result<SourceClip, Rejected>;

/// Outcome of reading a source item.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// A clip.
    Clip(Box<SourceClip>),
    /// Not a motion, although it looked like one.
    Skipped {
        /// Why the item is skipped.
        reason: String,
    },
    /// A motion that cannot be used.
    Rejected(Rejected),
}

impl From<ReadClip> for Outcome {
    fn from(read: ReadClip) -> Self {
        match read {
            Ok(clip) => Self::Clip(Box::new(clip)),
            Err(rejected) => Self::Rejected(rejected),
        }
    }
}

/// Why a file was put into quarantine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rejected {
    /// Stable error code for scripts, such as `E-BVH-FRAMES`.
    pub code: &'static str,
    /// What is wrong, with the numbers found and expected.
    pub reason: String,
    /// Byte offset of the problem in the file, if known.
    pub byte_offset: Option<u64>,
    /// Processing stage: [`Rejected::READ`], [`Rejected::RETARGET`] or [`Rejected::CHECK`].
    pub stage: &'static str,
}

/// A [`Rejected`] of the reading stage, from a code and a reason in the syntax of `format!`.
#[macro_export]
macro_rules! rejected {
    ($code:expr, $($reason:tt)+) => {
        $crate::Rejected::read($code, format!($($reason)+))
    };
}

impl Rejected {
    /// Stage of parsing the file.
    pub const READ: &'static str = "read";
    /// Stage of retargeting the motion to the body.
    pub const RETARGET: &'static str = "retarget";
    /// Stage of checking the finished motion.
    pub const CHECK: &'static str = "check";

    /// Rejects a file for something found while reading it.
    pub fn read(code: &'static str, reason: impl Into<String>) -> Self {
        Self {
            code,
            reason: reason.into(),
            byte_offset: None,
            stage: Self::READ,
        }
    }

    /// Rejects a file for something found while retargeting it.
    pub fn retarget(code: &'static str, reason: impl Into<String>) -> Self {
        Self {
            stage: Self::RETARGET,
            ..Self::read(code, reason)
        }
    }

    /// Rejects a motion for something the checks found.
    pub fn check(code: &'static str, reason: impl Into<String>) -> Self {
        Self {
            stage: Self::CHECK,
            ..Self::read(code, reason)
        }
    }

    /// Adds the byte offset of the problem.
    #[must_use]
    pub fn at(self, byte_offset: usize) -> Self {
        Self {
            byte_offset: Some(byte_offset as u64),
            ..self
        }
    }
}

/// Writes code, reason and, if known, byte offset.
impl fmt::Display for Rejected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.code, self.reason)?;
        match self.byte_offset {
            Some(offset) => write!(f, " at byte {offset}"),
            None => Ok(()),
        }
    }
}

impl From<pickle::Error> for Rejected {
    fn from(error: pickle::Error) -> Self {
        Self {
            byte_offset: error.byte_offset,
            ..Self::read(error.code, error.reason)
        }
    }
}

/// Maximum number of frames that resampling may make of a clip: 55 hours at 20 fps, 3 GB while it is processed.
const MAX_RESAMPLED_FRAMES: f64 = 4e6;

/// Refuses to resample a clip to more frames than fit into memory.
///
/// # Errors
/// `E-TOO-LARGE` if resampling would make more than 4 million frames.
pub fn check_resampled(num_frames: usize, from: Fps, to: Fps) -> Result<(), Rejected> {
    let resampled = num_frames as f64 / from.get() * to.get();
    if to <= from || resampled <= MAX_RESAMPLED_FRAMES {
        return Ok(());
    }
    Err(Rejected::check(
        "E-TOO-LARGE",
        format!(
            "{num_frames} frames at {from} become {resampled:.0} at {to}, expected at most \
             {MAX_RESAMPLED_FRAMES:.0}; choose a lower rate"
        ),
    ))
}

/// Lowest accepted frame rate in 1/s. Resampling from a wrong rate of one frame a day would turn a few
/// frames into millions.
pub const MIN_FPS: f64 = 1.0;
/// Highest accepted frame rate in 1/s; optical capture reaches about 2000.
pub const MAX_FPS: f64 = 10_000.0;
