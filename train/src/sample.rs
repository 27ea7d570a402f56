//! Editing motions: windows generated one after another and merged.

use std::cell::Cell;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use datasets_spec::{Fps, Motion, Pose, Resample, Rng, Seed, Skeleton};
use kinematics::KeypointFrame;
use kinematics::canonical::{
    FIXED_FRAMES, GroundTransform, Stitcher, canonicalise, motion_from_segment,
};
use kinematics::normalise::{FRAME_WIDTH, NormalizedFrame, Normalizer};
use kinematics::resample::{grid, interpolate, interpolate_all};
use kinematics::skeleton::{KEYPOINT_PARENTS, NUM_KEYPOINTS};
use rand::RngExt;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use crate::checkpoint::{self, RunRecord, Slot, read_for_use, weights_hash};
use crate::config::{GuidanceConfig, GuidanceTarget, Prediction, narrowed};
use crate::coordinator::TrainedCoordinator;
use crate::data::TextVectors;
use crate::diffusion::{Basis, Extrapolation, Schedule, guide, put_fixed};
use crate::fit::{DENOISER, EditorRecord, KIND, TEXT, load_weights};
use crate::j2s::PoseNet;
use crate::model::coordinator::Coordinator;
use crate::model::denoiser::{Denoiser, PackedWeights};
use crate::model::motionrefit::MotionRefit;
use crate::{Error, Session};

/// Frames over which a window that is kept as it was finds back from the edit before it.
const RETURN_FRAMES: usize = 6;

/// An instruction for some frames of a motion.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimedInstruction {
    /// The frames, at the motion's own rate.
    pub frames: Range<usize>,
    /// What is asked for.
    pub text: String,
}

impl std::str::FromStr for TimedInstruction {
    type Err = String;

    /// Reads `FIRST:END TEXT`.
    fn from_str(asked: &str) -> Result<Self, String> {
        let parse = || {
            let (range, text) = asked.split_once(' ')?;
            let (first, end) = range.split_once(':')?;
            let frames = first.parse().ok()?..end.parse().ok()?;
            let text = text.trim().to_owned();
            (!text.is_empty()).then_some(Self { frames, text })
        };
        parse().ok_or_else(|| {
            format!("{asked:?} is not FIRST:END TEXT, such as \"0:40 The person is waving.\"")
        })
    }
}

/// A motion to edit, cut into windows at the model's rate.
#[derive(Clone, Debug, PartialEq)]
pub struct EditItem {
    /// Names the item, and with the seed decides its noise.
    pub id: String,
    /// The windows, each of which begins no earlier than the one before.
    pub windows: Vec<EditWindow>,
    /// Where the first window stands in the world.
    pub placement: GroundTransform,
    /// The original at the rate of the edit, which becomes equally long. What an edit keeps of it are
    /// the twists that no keypoint shows.
    pub original: Vec<Pose>,
    /// Rate of the edit.
    pub fps: Fps,
}

/// A window to edit.
#[derive(Clone, Debug, PartialEq)]
pub struct EditWindow {
    /// Canonical, normalised frames of the original, `W` of them.
    pub original: Vec<NormalizedFrame>,
    /// What is asked for; nothing keeps the window as it is.
    pub instruction: Option<Arc<str>>,
    /// Position of the window in what its instruction covers, in [0, 1].
    pub progress: f32,
    /// Its first frame, at the model's rate. The window replaces what earlier ones made of the frames
    /// after its two fixed ones, but for those it is blended with.
    pub start: usize,
    /// Its first frames that are used, the fixed ones included; `W` but where its instruction, or the
    /// motion, ends within it.
    pub used: usize,
}

/// A run of frames at the model's rate that hear the same instruction, or none.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Span {
    frames: Range<usize>,
    instruction: Option<usize>,
}

impl EditItem {
    /// Cuts a motion of any rate into windows that all ask for the same. The edit has the motion's
    /// own rate and length.
    ///
    /// # Errors
    /// The motion has no frame.
    ///
    /// # Source
    /// Paper, App. B.2. The windows advance by what each adds; the released demo's 31 raw
    /// frames drift against the generated motion (`algorithms` section 8).
    pub fn new(
        id: impl Into<String>,
        motion: &Motion,
        instruction: &str,
        skeleton: &Skeleton,
        editor: &EditorRecord,
    ) -> Result<Self, Error> {
        let whole = TimedInstruction {
            frames: 0..motion.len(),
            text: instruction.to_owned(),
        };
        Self::timed(id, motion, &[whole], motion.fps(), skeleton, editor)
    }

    /// Cuts a motion into windows that ask for what is asked of their frames; a frame belongs to the
    /// first instruction that covers it, and stays as it is where none does. `fps` is the rate of the
    /// edit.
    ///
    /// The first window of an instruction adds the first frame of its range, and the last one is used
    /// up to its last. Where a window does not fit before the end of the motion, it begins earlier and
    /// replaces what was made of the frames it repeats; where the range does not reach back that far,
    /// or the motion is shorter than a window, the last pose is held to fill it, and the frames that
    /// were added are cut off again.
    ///
    /// # Errors
    /// The motion has no frame, a range is empty or ends after the motion, or an instruction has no
    /// frame of its own.
    ///
    /// # Source
    /// Paper, App. E.1 (time-variant editing); which window hears which instruction is not published.
    pub fn timed(
        id: impl Into<String>,
        motion: &Motion,
        instructions: &[TimedInstruction],
        fps: Fps,
        skeleton: &Skeleton,
        editor: &EditorRecord,
    ) -> Result<Self, Error> {
        let id = id.into();
        let (window, normalizer) = (editor.train.window, &editor.normalizer);
        let overlap = editor.train.diffusion.overlap;
        let (model_fps, anchor) = (editor.compose.config.fps, editor.compose.config.anchor);
        for asked in instructions {
            let Range { start, end } = asked.frames;
            if start >= end || end > motion.len() {
                return Err(Error::Item {
                    id,
                    problem: format!(
                        "has {} frames, which the range {start}:{end} of {:?} does not fit",
                        motion.len(),
                        asked.text
                    ),
                });
            }
        }
        let original = Resample::Exact
            .apply(motion, fps)
            .map_err(|source| Error::Motion {
                id: id.clone(),
                source: source.into(),
            })?
            .poses();
        let mut poses = covering(motion, model_fps);
        let num_frames = poses.len();
        let Some(&last_pose) = poses.last() else {
            return Err(Error::Item {
                id,
                problem: "has no frame".to_owned(),
            });
        };
        let to_model = model_fps.get() / motion.fps().get();
        let spans = spans(num_frames, motion.len(), to_model, instructions);
        for (index, asked) in instructions.iter().enumerate() {
            if spans.iter().all(|span| span.instruction != Some(index)) {
                let Range { start, end } = asked.frames;
                return Err(Error::Item {
                    id,
                    problem: format!(
                        "has no frame of its own for {start}:{end} {:?}: at {model_fps} all of them \
                         belong to instructions before it; widen the range",
                        asked.text
                    ),
                });
            }
        }
        let places: Vec<(usize, usize, Option<usize>)> = spans
            .iter()
            .flat_map(|span| {
                let instruction = span.instruction;
                // What is kept as it was meets what was there.
                let overlap = instruction.map_or(0, |_| overlap);
                places(&span.frames, num_frames, window, overlap)
                    .into_iter()
                    .map(move |(start, used)| (start, used, instruction))
            })
            .collect();
        let needed = places.iter().map(|(start, ..)| start + window).max();
        poses.resize(needed.unwrap_or(0).max(num_frames), last_pose);
        let texts: Vec<Arc<str>> = instructions
            .iter()
            .map(|asked| asked.text.as_str().into())
            .collect();
        let windows = places
            .into_iter()
            .map(|(start, used, instruction)| {
                let mut segment = poses[start..start + window].to_vec();
                canonicalise(&mut segment, anchor, skeleton);
                let progress = instruction.map_or(0.0, |index| {
                    let Range { start: begin, end } = instructions[index].frames;
                    let length = (end - begin) as f64 * to_model;
                    ((start as f64 - begin as f64 * to_model) / length).clamp(0.0, 1.0)
                });
                EditWindow {
                    original: segment
                        .iter()
                        .map(|pose| normalizer.normalize(&skeleton.keypoints(pose)))
                        .collect(),
                    instruction: instruction.map(|index| Arc::clone(&texts[index])),
                    progress: progress as f32,
                    start,
                    used,
                }
            })
            .collect();
        Ok(Self {
            id,
            windows,
            placement: motion_from_segment(&poses[0], anchor, skeleton),
            original,
            fps,
        })
    }

    /// Resamples keypoints from the model's rate to that of the edit, and to the length of the original.
    /// The published fit interpolates each coordinate linearly; the exact fit uses a Catmull-Rom spline,
    /// because straight lines put all acceleration into the frames of the model.
    ///
    /// # Panics
    /// If the frames do not cover the original.
    pub fn at_own_rate(
        &self,
        frames: &[KeypointFrame],
        model_fps: Fps,
        fit: FitMethod,
    ) -> Vec<KeypointFrame> {
        let step = model_fps.get() / self.fps.get();
        (0..self.original.len())
            .map(|frame| {
                let at = frame as f64 * step;
                // The tolerance absorbs the rounding of a quotient of rates.
                let before = (at + 1e-6).floor() as usize;
                let share = (at - before as f64).max(0.0);
                if share < 1e-6 {
                    return frames[before];
                }
                match fit {
                    FitMethod::Paper => std::array::from_fn(|slot| {
                        frames[before][slot].lerp(frames[before + 1][slot], share)
                    }),
                    FitMethod::Exact => catmull_rom(frames, before, share),
                }
            })
            .collect()
    }
}

/// A Catmull-Rom spline through frames, between `before` and the frame after it. Past either end it goes
/// on as the parabola through the last three frames.
fn catmull_rom(frames: &[KeypointFrame], before: usize, share: f64) -> KeypointFrame {
    let after = before + 1;
    let (b, c) = (&frames[before], &frames[after]);
    if frames.len() == 2 {
        return std::array::from_fn(|slot| b[slot].lerp(c[slot], share));
    }
    let beyond = |end: &KeypointFrame, next: &KeypointFrame, third: &KeypointFrame| {
        std::array::from_fn(|slot| 3.0 * (end[slot] - next[slot]) + third[slot])
    };
    let a = match before.checked_sub(1) {
        Some(first) => frames[first],
        None => beyond(b, c, &frames[after + 1]),
    };
    let d = match frames.get(after + 1) {
        Some(last) => *last,
        None => beyond(c, b, &a),
    };
    let (t, t2, t3) = (share, share * share, share * share * share);
    let weights = [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ];
    std::array::from_fn(|slot| {
        a[slot] * weights[0] + b[slot] * weights[1] + c[slot] * weights[2] + d[slot] * weights[3]
    })
}

/// Frames at the model's rate that cover a motion.
pub fn model_frames(num_frames: usize, fps: Fps, editor: &EditorRecord) -> usize {
    let to_model = editor.compose.config.fps.get() / fps.get();
    match num_frames.checked_sub(1) {
        Some(last) => (last as f64 * to_model - 1e-6).ceil() as usize + 1,
        None => 0,
    }
}

/// The poses of a motion at another rate over the whole of it: where its last frame lies between two,
/// the second of them is there too, as far beyond the end as the one before is from it.
fn covering(motion: &Motion, fps: Fps) -> Vec<Pose> {
    let poses = motion.poses();
    let Some(last) = poses.len().checked_sub(1) else {
        return poses;
    };
    let mut out = interpolate_all(&poses, &grid(poses.len(), motion.fps(), fps));
    let step = motion.fps().get() / fps.get();
    let missing = out.len() as f64 * step - last as f64;
    if missing < step * (1.0 - 1e-6) && missing > 0.0 {
        let mirrored = last as f64 - missing;
        let pose = if mirrored < 0.0 {
            poses[last]
        } else {
            let place = (mirrored.floor() as usize, mirrored.fract());
            let before = interpolate_all(&poses, &[place])[0];
            interpolate(&before, &poses[last], 2.0)
        };
        out.push(pose);
    }
    out
}

/// The spans of `num_frames` frames at the model's rate, of a motion of `length` frames of its own.
fn spans(
    num_frames: usize,
    length: usize,
    to_model: f64,
    instructions: &[TimedInstruction],
) -> Vec<Span> {
    let owner = |frame: usize| {
        // A frame past the end belongs to whom the last one belongs to.
        let at = (frame as f64 / to_model).min((length - 1) as f64) + 1e-6;
        instructions
            .iter()
            .position(|asked| (asked.frames.start as f64) <= at && at < asked.frames.end as f64)
    };
    let mut spans: Vec<Span> = Vec::new();
    for frame in 0..num_frames {
        let instruction = owner(frame);
        match spans.last_mut() {
            Some(span) if span.instruction == instruction => span.frames.end = frame + 1,
            // Nothing can be fixed before the second frame: what is asked then, is asked from the
            // first on.
            Some(span) if span.frames.end < FIXED_FRAMES => {
                span.frames.end = frame + 1;
                span.instruction = instruction;
            }
            _ => spans.push(Span {
                frames: frame..frame + 1,
                instruction,
            }),
        }
    }
    spans
}

/// Start and used frames of the windows that make the frames of a span, of a motion of `num_frames`. Each
/// window but the first makes the last `overlap` frames before it anew.
fn places(
    frames: &Range<usize>,
    num_frames: usize,
    window: usize,
    overlap: usize,
) -> Vec<(usize, usize)> {
    let mut places = Vec::new();
    let mut next = frames.start;
    while next < frames.end {
        let natural = next.saturating_sub(FIXED_FRAMES);
        let latest = num_frames.saturating_sub(window);
        let is_free = latest + FIXED_FRAMES >= frames.start;
        let start = if natural > latest && is_free {
            latest
        } else {
            natural
        };
        let used = (frames.end - start).min(window);
        places.push((start, used));
        let end = start + used;
        if end == frames.end {
            break;
        }
        next = end - overlap;
    }
    places
}

/// How SMPL-X parameters are found for generated keypoints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FitMethod {
    /// Second-order steps until no point moves, the twists that no point shows being those of the pose
    /// network or of the original.
    #[default]
    Exact,
    /// The published way: a pose network, and from its poses 120 steps of Adam (paper App. B.3).
    Paper,
}

impl std::str::FromStr for FitMethod {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "exact" => Ok(Self::Exact),
            "paper" => Ok(Self::Paper),
            _ => Err(format!("{name:?} is no fit; known are exact and paper")),
        }
    }
}

/// How motions are edited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EditSettings {
    /// Seed of the noise.
    pub seed: Seed,
    /// Guidance weight; 1 follows the text without amplifying it.
    pub guidance: f64,
    /// Factor of the noise; 1 samples what was learned, less stays nearer to its mean.
    pub temperature: f64,
    /// Guidance by the coordinator, if the editor has one.
    pub coordinator: GuidanceConfig,
    /// How SMPL-X parameters are found.
    pub fit: FitMethod,
    /// Weight in m^2/rad^2 by which the exact fit holds rotations to those of the pose network or, without
    /// one, of the original: what short bones gain by it, such as those of head and hands, long ones
    /// hardly feel.
    pub prior: f64,
    /// Windows generated at a time.
    pub max_batch: usize,
}

/// Where the time of editing went.
///
/// # Source
/// The columns of the paper's Table A4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct EditTimes {
    /// Seconds in the denoiser and the reverse steps.
    pub diffusion_secs: f64,
    /// Seconds in the coordinator.
    pub coordinator_secs: f64,
    /// Seconds in finding SMPL-X parameters.
    pub fit_secs: f64,
    /// Windows generated.
    pub num_windows: usize,
    /// Batches they were generated in.
    pub num_batches: usize,
    /// Frames of a window.
    pub window: usize,
}

impl std::ops::AddAssign for EditTimes {
    fn add_assign(&mut self, other: Self) {
        self.diffusion_secs += other.diffusion_secs;
        self.coordinator_secs += other.coordinator_secs;
        self.fit_secs += other.fit_secs;
        self.num_windows += other.num_windows;
        self.num_batches += other.num_batches;
        self.window = other.window;
    }
}

/// A trained editor.
#[derive(Debug)]
pub struct Editor {
    model: MotionRefit,
    /// Those of the model's denoiser.
    weights: PackedWeights,
    schedule: Schedule,
    record: RunRecord<EditorRecord>,
    hash: String,
    device: Device,
    vectors: Option<Box<dyn TextVectors + Send>>,
    coordinator: Option<TrainedCoordinator>,
    poses: Option<PoseNet>,
}

impl Editor {
    /// Loads an editor from its run folder.
    ///
    /// # Errors
    /// The folder is not a run of the editor, or its checkpoint is missing or damaged.
    pub fn load(run_dir: &Path, slot: Slot, device: &Device) -> Result<Self, Error> {
        let record: RunRecord<EditorRecord> = checkpoint::read_record(run_dir, KIND)?;
        let config = &record.config.train;
        record.config.check()?;
        let mut files = read_for_use(run_dir, slot, KIND)?;
        let weights: Vec<&[u8]> = [DENOISER, TEXT]
            .iter()
            .filter_map(|&name| files.get(name).map(Vec::as_slice))
            .collect();
        let hash = weights_hash(&record.config, &weights);
        let mut model = MotionRefit::of_frames(
            &config.model,
            &config.diffusion,
            record.config.text.source(),
            3 * config.keypoints,
            device,
        );
        load_weights(&mut model, &mut files, run_dir)?;
        Ok(Self {
            weights: model.denoiser.pack(),
            model,
            schedule: Schedule::new(config.diffusion.schedule, config.diffusion.num_steps)?,
            hash,
            device: device.clone(),
            record,
            vectors: None,
            coordinator: None,
            poses: None,
        })
    }

    /// Gives the editor a network that guesses poses from keypoints. The twists that no keypoint
    /// shows are then its own; without it they are those of the original.
    #[must_use]
    pub fn with_poses(mut self, net: PoseNet, hash: &str) -> Self {
        self.mix_hash(hash);
        self.poses = Some(net);
        self
    }

    /// Whether the editor has a pose network.
    pub fn has_poses(&self) -> bool {
        self.poses.is_some()
    }

    /// Scores of an editor with helpers are not those of the editor alone.
    fn mix_hash(&mut self, other: &str) {
        let both = [self.hash.as_bytes(), other.as_bytes()].concat();
        self.hash = blake3::hash(&both).to_hex().to_string();
    }

    /// The pose network.
    pub(crate) fn poses(&self) -> Option<&PoseNet> {
        self.poses.as_ref()
    }

    /// Where tensors live.
    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    /// Gives the editor the vectors of the instructions it will be asked, of the frozen encoder it
    /// listens to.
    ///
    /// # Errors
    /// They are of another encoder.
    pub fn set_vectors(&mut self, vectors: Box<dyn TextVectors + Send>) -> Result<(), Error> {
        self.record.config.text.texts(Some(&*vectors))?;
        self.vectors = Some(vectors);
        Ok(())
    }

    /// Gives the editor a coordinator, which guides its last steps from then on.
    ///
    /// # Errors
    /// The coordinator was trained for another diffusion, another length of windows, other keypoints or
    /// another range of model units.
    pub fn with_coordinator(mut self, coordinator: TrainedCoordinator) -> Result<Self, Error> {
        let theirs = &coordinator.record().config;
        let ours = &self.record.config;
        let diffusion = &ours.train.diffusion;
        let problem = if theirs.train.window != ours.train.window {
            "its windows have another length"
        } else if theirs.train.keypoints != ours.train.keypoints {
            "it sees other keypoints"
        } else if theirs.compose.config.fps != ours.compose.config.fps {
            "it was trained at another rate"
        } else if theirs.compose.config.anchor != ours.compose.config.anchor {
            "its windows stand above the origin by another point of the body"
        } else if theirs.normalizer != ours.normalizer {
            "it was trained in another range of model units"
        } else if (theirs.train.schedule, theirs.train.diffusion_steps)
            != (diffusion.schedule, diffusion.num_steps)
        {
            "it was trained for another diffusion"
        } else {
            self.mix_hash(coordinator.hash());
            self.coordinator = Some(coordinator);
            return Ok(self);
        };
        Err(Error::Misfit {
            what: "the coordinator",
            problem: problem.to_owned(),
        })
    }

    /// Whether the editor has a coordinator.
    pub fn has_coordinator(&self) -> bool {
        self.coordinator.is_some()
    }

    /// The settings the editor was trained with and what was fitted to its training split.
    pub fn record(&self) -> &RunRecord<EditorRecord> {
        &self.record
    }

    /// The range of model units the model was trained in.
    pub fn normalizer(&self) -> &Normalizer {
        &self.record.config.normalizer
    }

    /// What identifies the weights, those of a coordinator included: BLAKE3, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// Edits motions. Each result holds the keypoints of one item in metres at the model's rate, as many
    /// frames as its windows make; `times` gains what each part took. Keypoints the editor does not
    /// make lie on the joints they hang from.
    ///
    /// The noise of an item follows from the seed and its id, and a row of a batch never sees
    /// another, so a result does not depend on which other items are edited with it. The device is
    /// that of the editor.
    ///
    /// # Errors
    /// As [`edit_windows`], or a text has no vector.
    ///
    /// # Source
    /// Paper App. B.2; `algorithms` section 8.
    pub fn edit_batch(
        &self,
        items: &[EditItem],
        skeleton: &Skeleton,
        settings: &EditSettings,
        session: &Session<'_>,
        times: &mut EditTimes,
    ) -> Result<Vec<Vec<KeypointFrame>>, Error> {
        times.window = self.record.config.train.window;
        let mut generator = Generator {
            editor: self,
            settings,
            session,
            times,
        };
        edit_windows(
            &mut generator,
            &self.record.config,
            items,
            skeleton,
            settings,
            session,
        )
    }
}

/// A window to be made.
#[derive(Debug)]
pub struct WindowRequest<'a> {
    /// Place of its item among those that are edited.
    pub item: usize,
    /// The window.
    pub window: &'a EditWindow,
    /// Its normalised first frames; none if the model generates them as well.
    pub fixed: Option<[NormalizedFrame; FIXED_FRAMES]>,
    /// Generator of its noise.
    pub rng: Rng,
}

/// What makes windows.
pub trait WindowModel {
    /// Makes a window for each request, `[B, W, 84]` normalised. The first window of a motion and
    /// later ones are never asked for together.
    ///
    /// # Errors
    /// A window cannot be made.
    fn generate(&mut self, requests: &mut [WindowRequest<'_>]) -> Result<Vec<f32>, Error>;
}

/// Edits motions window by window: asks for the windows, keeps those without an instruction, and joins
/// them. Each result holds the keypoints of one item in metres at the model's rate.
///
/// # Errors
/// An item has no window or one of another length, the session is stopped, or `model` fails.
pub fn edit_windows(
    model: &mut dyn WindowModel,
    record: &EditorRecord,
    items: &[EditItem],
    skeleton: &Skeleton,
    settings: &EditSettings,
    session: &Session<'_>,
) -> Result<Vec<Vec<KeypointFrame>>, Error> {
    let window_frames = record.train.window;
    for item in items {
        let problem = if item.windows.is_empty() {
            "has no window".to_owned()
        } else if item
            .windows
            .iter()
            .any(|window| window.original.len() != window_frames)
        {
            format!("has windows of another length than the model's {window_frames} frames")
        } else {
            continue;
        };
        return Err(Error::Item {
            id: item.id.clone(),
            problem,
        });
    }
    let normalizer = &record.normalizer;
    let pelvis = record.compose.config.anchor.pelvis(skeleton);
    let mut stitchers: Vec<Stitcher> = items
        .iter()
        .map(|item| Stitcher::new(skeleton.rest_triangle(), item.placement).anchored(pelvis))
        .collect();
    let num_windows = items.iter().map(|item| item.windows.len()).sum::<usize>();
    let progress = session.progress;
    progress.begin("edit", Some(num_windows as u64));
    let longest = items.iter().map(|item| item.windows.len()).max();
    let overlap = record.train.diffusion.overlap;
    // What a window is blended with.
    let mut former: Vec<Vec<KeypointFrame>> = vec![Vec::new(); items.len()];
    for window_index in 0..longest.unwrap_or(0) {
        // Longer motions go on while shorter ones are done.
        let mut active = Vec::new();
        for (index, item) in items.iter().enumerate() {
            let Some(window) = item.windows.get(window_index) else {
                continue;
            };
            if window_index > 0 {
                former[index] = stitchers[index].rewind(window.start + FIXED_FRAMES);
                former[index].truncate(overlap);
            }
            if window.instruction.is_some() {
                active.push(index);
            } else {
                keep(&mut stitchers[index], window, normalizer);
                progress.advance(1);
            }
        }
        for chunk in active.chunks(settings.max_batch.max(1)) {
            if session.is_stopped() {
                return Err(Error::Stopped { what: "editing" });
            }
            let mut requests: Vec<WindowRequest<'_>> = chunk
                .iter()
                .map(|&index| {
                    let item = &items[index];
                    let window = &item.windows[window_index];
                    let is_generated = record.train.diffusion.generated_starts > 0.0;
                    let fixed = match stitchers[index].next_fixed() {
                        Some(frames) => Some(frames.map(|frame| normalizer.normalize(&frame))),
                        None if is_generated => None,
                        None => Some([window.original[0], window.original[1]]),
                    };
                    let place = window_index.to_string();
                    WindowRequest {
                        item: index,
                        window,
                        fixed,
                        rng: settings.seed.rng(&["edit", &item.id, &place]),
                    }
                })
                .collect();
            let generated = model.generate(&mut requests)?;
            let numbers = window_frames * FRAME_WIDTH;
            for (request, frames) in requests.iter().zip(generated.chunks_exact(numbers)) {
                let frames: Vec<KeypointFrame> = frames
                    .chunks_exact(FRAME_WIDTH)
                    .take(request.window.used)
                    .map(|frame| normalizer.denormalize(&NormalizedFrame::from_model_units(frame)))
                    .collect();
                stitchers[request.item].push_over(&frames, &former[request.item]);
            }
            progress.advance(chunk.len() as u64);
        }
    }
    progress.finish(&format!("{} motions, {num_windows} windows", items.len()));
    Ok(stitchers.into_iter().map(Stitcher::into_frames).collect())
}

/// The editor's network at work.
struct Generator<'a> {
    editor: &'a Editor,
    settings: &'a EditSettings,
    session: &'a Session<'a>,
    times: &'a mut EditTimes,
}

impl WindowModel for Generator<'_> {
    fn generate(&mut self, requests: &mut [WindowRequest<'_>]) -> Result<Vec<f32>, Error> {
        let Self {
            editor,
            settings,
            session,
            ..
        } = self;
        let config = &editor.record.config;
        let begun = session.secs();
        let num_rows = requests.len();
        let (frames, keypoints) = (config.train.window, config.train.keypoints);
        let window = |values: Vec<f32>, frames: usize| -> Tensor<3> {
            Tensor::from_data(
                TensorData::new(values, [num_rows, frames, 3 * keypoints]),
                &editor.device,
            )
        };
        let original: Vec<f32> = requests
            .iter()
            .flat_map(|request| request.window.original.iter().copied().flatten())
            .collect();
        let fixed: Option<Vec<[NormalizedFrame; FIXED_FRAMES]>> =
            requests.iter().map(|request| request.fixed).collect();
        let vectors = editor.vectors.as_deref().map(|vectors| vectors as _);
        let texts = config.text.texts(vectors)?.batch(
            requests
                .iter()
                .map(|request| request.window.instruction.as_deref().unwrap_or_default()),
        )?;
        let condition = Condition {
            original: window(narrowed(original, keypoints), frames),
            fixed: fixed.map(|fixed| {
                let numbers = fixed.into_iter().flatten().flatten().collect();
                window(narrowed(numbers, keypoints), FIXED_FRAMES)
            }),
            text: editor.model.text_vectors(&texts, num_rows, &editor.device),
            progress: requests
                .iter()
                .map(|request| request.window.progress)
                .collect(),
        };
        let diffusion = &config.train.diffusion;
        let clock = || session.secs();
        let coordinator = editor.coordinator.as_ref().map(|coordinator| Guide {
            network: &coordinator.model,
            config: settings.coordinator,
            clock: &clock,
            secs: Cell::new(0.0),
        });
        let sampler = Sampler {
            denoiser: &editor.model.denoiser,
            weights: &editor.weights,
            schedule: &editor.schedule,
            prediction: diffusion.prediction,
            extrapolation: config.extrapolation.as_ref(),
            clip: diffusion.clip,
            guidance: settings.guidance,
            coordinator: coordinator.as_ref(),
        };
        let x = sampler.sample(
            &condition,
            |_| {
                let scale = settings.temperature as f32;
                let noise: Vec<f32> = requests
                    .iter_mut()
                    .flat_map(|request| {
                        (0..frames * 3 * keypoints)
                            .map(|_| scale * request.rng.sample::<f32, _>(StandardNormal))
                    })
                    .collect();
                window(noise, frames)
            },
            |_, _| {},
        );
        let generated = x
            .into_data()
            .try_into_vec_as()
            .expect("a float tensor gives floats");
        let guided = coordinator.map_or(0.0, |guide| guide.secs.get());
        self.times.coordinator_secs += guided;
        self.times.diffusion_secs += session.secs() - begun - guided;
        self.times.num_windows += num_rows;
        self.times.num_batches += 1;
        Ok(widened(generated, keypoints))
    }
}

/// Generated windows with all keypoints: those that were not generated lie on the joints they hang from.
fn widened(generated: Vec<f32>, keypoints: usize) -> Vec<f32> {
    if keypoints == NUM_KEYPOINTS {
        return generated;
    }
    generated
        .chunks_exact(3 * keypoints)
        .flat_map(|frame| {
            (0..NUM_KEYPOINTS).flat_map(move |slot| {
                let known = if slot < keypoints {
                    slot
                } else {
                    keypoint_parent(slot)
                };
                frame[3 * known..3 * known + 3].iter().copied()
            })
        })
        .collect()
}

/// The keypoint that one of the others hangs from.
pub(crate) fn keypoint_parent(slot: usize) -> usize {
    usize::try_from(KEYPOINT_PARENTS[slot]).unwrap_or(0)
}

/// Adds a window as it was. After an edit its frames stand where the edit left the body, and the pose
/// finds back to the original within a few frames.
fn keep(stitcher: &mut Stitcher, window: &EditWindow, normalizer: &Normalizer) {
    let mut frames: Vec<KeypointFrame> = window.original[..window.used]
        .iter()
        .map(|frame| normalizer.denormalize(frame))
        .collect();
    if let Some(fixed) = stitcher.next_fixed() {
        let last = FIXED_FRAMES - 1;
        let away: Vec<_> = fixed[last]
            .iter()
            .zip(&frames[last])
            .map(|(now, was)| *now - *was)
            .collect();
        for (step, frame) in frames[FIXED_FRAMES..].iter_mut().enumerate() {
            let left = 1.0 - (step + 1) as f64 / RETURN_FRAMES as f64;
            for (point, away) in frame.iter_mut().zip(&away) {
                *point += *away * left.max(0.0);
            }
        }
    }
    stitcher.push(&frames);
}

/// What a batch of windows is generated from.
#[derive(Clone, Debug)]
pub struct Condition {
    /// Normalised original windows, `[B, W, 84]`.
    pub original: Tensor<3>,
    /// Normalised first frames, `[B, 2, 84]`; none where they are to be generated too.
    pub fixed: Option<Tensor<3>>,
    /// Text vectors, `[B, d]`.
    pub text: Tensor<2>,
    /// Position of each window in its motion, `[B]`.
    pub progress: Vec<f32>,
}

/// The coordinator as a guide of sampling.
pub struct Guide<'a> {
    /// The network.
    pub network: &'a Coordinator,
    /// What it moves, and how far.
    pub config: GuidanceConfig,
    /// Seconds since any fixed moment.
    pub clock: &'a dyn Fn() -> f64,
    /// Seconds spent in it so far.
    pub secs: Cell<f64>,
}

impl Guide<'_> {
    /// How far `x` is moved at a step, if this is what the guide moves and the step is among the
    /// guided ones.
    fn push(&self, target: GuidanceTarget, x: &Tensor<3>, timestep: usize) -> Option<Tensor<3>> {
        let is_guided = target == self.config.target && timestep < self.config.num_steps;
        if !is_guided || self.config.strength == 0.0 {
            return None;
        }
        // A device computes behind the program: what is waited for on either side is the guide's alone.
        let _ = x.to_data();
        let begun = (self.clock)();
        // A clean window is seen as one of the first step, whose noise is a hundredth.
        let seen_as = match target {
            GuidanceTarget::CleanPrediction => 0,
            GuidanceTarget::PosteriorMean => timestep,
        };
        let gradient = self
            .network
            .gradient(x.clone(), &vec![seen_as; x.dims()[0]])
            .mul_scalar(self.config.strength);
        let _ = gradient.to_data();
        self.secs.set(self.secs.get() + (self.clock)() - begun);
        Some(gradient)
    }
}

/// Generates windows from pure noise.
#[derive(Clone, Copy)]
pub struct Sampler<'a> {
    /// The network.
    pub denoiser: &'a Denoiser,
    /// Its weights.
    pub weights: &'a PackedWeights,
    /// The schedule it was trained with.
    pub schedule: &'a Schedule,
    /// What it predicts.
    pub prediction: Prediction,
    /// What a predicted residual is relative to.
    pub extrapolation: Option<&'a Extrapolation>,
    /// Whether estimates of the clean window are clipped to [-1, 1].
    pub clip: bool,
    /// Guidance weight.
    pub guidance: f64,
    /// Guidance by a coordinator.
    pub coordinator: Option<&'a Guide<'a>>,
}

impl Sampler<'_> {
    /// Generates a batch of windows, `[B, W, 84]`.
    ///
    /// `noise` is asked first for the start (`None`), then for every reverse step in the order they
    /// are made; `on_step` sees each result. The fixed frames are put back, unscaled, at the start
    /// and after every step. The predictions with and without text share one batch.
    ///
    /// # Source
    /// Released `p_sample_loop` (`algorithms` section 5).
    pub fn sample(
        &self,
        condition: &Condition,
        noise: impl FnMut(Option<usize>) -> Tensor<3>,
        on_step: impl FnMut(usize, &Tensor<3>),
    ) -> Tensor<3> {
        let batch = condition.progress.len();
        // At weight 1 the prediction without text cancels out.
        let is_guided = self.guidance != 1.0;
        let twice = |x: &Tensor<3>| Tensor::cat(vec![x.clone(), x.clone()], 0);
        let (text, original, progress) = if is_guided {
            (
                Tensor::cat(vec![condition.text.clone(), condition.text.zeros_like()], 0),
                twice(&condition.original),
                condition.progress.repeat(2),
            )
        } else {
            (
                condition.text.clone(),
                condition.original.clone(),
                condition.progress.clone(),
            )
        };
        let denoiser =
            self.denoiser
                .prepare(self.weights, self.schedule.len(), text, &progress, original);
        let is_start = vec![condition.fixed.is_none(); batch];
        let basis = Basis {
            original: &condition.original,
            is_start: &is_start,
            extrapolation: self.extrapolation,
        };
        let push = |target, x: &Tensor<3>, timestep| {
            self.coordinator
                .and_then(|guide| guide.push(target, x, timestep))
        };
        let estimate = |x: &Tensor<3>, timestep: usize| {
            let input = if is_guided { twice(x) } else { x.clone() };
            let predicted = denoiser.forward(input, timestep);
            let predicted = if is_guided {
                guide(
                    predicted.clone().narrow(0, 0, batch),
                    predicted.narrow(0, batch, batch),
                    self.guidance,
                )
            } else {
                predicted
            };
            let mut x0 = self.schedule.clean_of(
                self.prediction,
                predicted,
                x,
                basis,
                &vec![timestep; batch],
            );
            if self.clip {
                x0 = x0.clamp(-1.0, 1.0);
            }
            match push(GuidanceTarget::CleanPrediction, &x0, timestep) {
                Some(gradient) => x0 - gradient,
                None => x0,
            }
        };
        let nudge = |mean: Tensor<3>, timestep: usize| {
            // The last step adds no noise, and what is scaled by it is nothing.
            let gradient = (timestep > 0)
                .then(|| push(GuidanceTarget::PosteriorMean, &mean, timestep))
                .flatten();
            match gradient {
                Some(gradient) => {
                    let spread = self.schedule.posterior_variance[timestep].sqrt();
                    mean - gradient.mul_scalar(spread)
                }
                None => mean,
            }
        };
        reverse(
            self.schedule,
            condition.fixed.as_ref(),
            estimate,
            nudge,
            noise,
            on_step,
        )
    }
}

/// Runs the reverse process from pure noise, `[B, W, 84]`, with `estimate` telling the clean windows of
/// noisy ones and `nudge` moving the mean of a posterior. `noise` and `on_step` are those of
/// [`Sampler::sample`].
pub fn reverse(
    schedule: &Schedule,
    fixed: Option<&Tensor<3>>,
    estimate: impl Fn(&Tensor<3>, usize) -> Tensor<3>,
    nudge: impl Fn(Tensor<3>, usize) -> Tensor<3>,
    mut noise: impl FnMut(Option<usize>) -> Tensor<3>,
    mut on_step: impl FnMut(usize, &Tensor<3>),
) -> Tensor<3> {
    let put = |x: Tensor<3>| match fixed {
        Some(fixed) => put_fixed(x, fixed.clone()),
        None => x,
    };
    let mut x = put(noise(None));
    for timestep in (0..schedule.len()).rev() {
        let x0 = estimate(&x, timestep);
        let timesteps = vec![timestep; x.dims()[0]];
        let mean = nudge(schedule.posterior_mean(x0, x, &timesteps), timestep);
        x = put(schedule.add_noise(mean, timestep, noise(Some(timestep))));
        on_step(timestep, &x);
    }
    x
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;

    fn cubic(coefficients: [DVec3; 4], t: f64) -> DVec3 {
        let [a, b, c, d] = coefficients;
        a + t * (b + t * (c + t * d))
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-1.0..1.0).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn the_spline_follows_parabolas_and_passes_through_its_frames(
            coefficients in prop::array::uniform3(vector()),
            num_frames in 3usize..7,
            place in 0.0..1.0f64,
        ) {
            let [a, b, c] = coefficients;
            let parabola = |t| [cubic([a, b, c, DVec3::ZERO], t); NUM_KEYPOINTS];
            let frames: Vec<KeypointFrame> = (0..num_frames).map(|at| parabola(at as f64)).collect();
            let at = place * (num_frames - 1) as f64;
            let before = (at.floor() as usize).min(num_frames - 2);
            // A Catmull-Rom spline reproduces parabolas, and past the ends ours goes on as one. Numbers
            // reach 50 and are rounded a dozen times.
            let found = catmull_rom(&frames, before, at - before as f64);
            prop_assert!(found[3].distance(parabola(at)[3]) < 1e-12, "{at}");
            for (share, frame) in [(0.0, before), (1.0, before + 1)] {
                let found = catmull_rom(&frames, before, share);
                prop_assert!(found[0].distance(frames[frame][0]) < 1e-12, "{frame}");
            }
        }

        #[test]
        fn the_speed_of_the_spline_does_not_jump_at_a_frame(
            points in prop::collection::vec(vector(), 4..7),
            place in 0.0..1.0f64,
        ) {
            const STEP: f64 = 1e-6;
            let frames: Vec<KeypointFrame> = points.iter().map(|point| [*point; NUM_KEYPOINTS]).collect();
            let frame = 1 + (place * (frames.len() - 2) as f64) as usize;
            let middle = frames[frame][0];
            let before = middle - catmull_rom(&frames, frame - 1, 1.0 - STEP)[0];
            let after = catmull_rom(&frames, frame, STEP)[0] - middle;
            // Second derivatives are at most 40 for points in the unit cube.
            prop_assert!((after - before).length() / STEP < 40.0 * 2.0 * STEP);
        }
    }

    #[test]
    fn two_frames_are_joined_by_a_line() {
        let frames = [[DVec3::ZERO; NUM_KEYPOINTS], [DVec3::ONE; NUM_KEYPOINTS]];
        assert_eq!(catmull_rom(&frames, 0, 0.25)[27], DVec3::splat(0.25));
    }
}
