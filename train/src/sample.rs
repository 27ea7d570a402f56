//! Editing motions: windows generated one after another and merged.

use std::borrow::Cow;
use std::cell::Cell;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use datasets_spec::canonical::{
    Anchor, FIXED_FRAMES, GroundTransform, KeypointFrame, Stitcher, canonicalise, window_starts,
};
use datasets_spec::normalise::{FRAME_WIDTH, NormalizedFrame, Normalizer};
use datasets_spec::skeleton::{KEYPOINT_PARENTS, NUM_KEYPOINTS};
use datasets_spec::{Fps, Motion, Pose, Resample, Rng, Seed, Skeleton};
use rand::RngExt;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use crate::checkpoint::{self, RunRecord, Slot, read_for_use, weights_hash};
use crate::config::{GuidanceConfig, GuidanceTarget, narrowed};
use crate::coordinator::TrainedCoordinator;
use crate::data::TextVectors;
use crate::diffusion::{Prediction, Schedule, guide, put_fixed};
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

/// A motion to edit, cut into windows at the model's rate.
#[derive(Clone, Debug, PartialEq)]
pub struct EditItem {
    /// Names the item, and with the seed decides its noise.
    pub id: String,
    /// The windows; each starts `W - 2` frames after the one before.
    pub windows: Vec<EditWindow>,
    /// Where the first window stands in the world.
    pub placement: GroundTransform,
    /// The original at the store's rate: what an edit keeps of it are the twists that no keypoint
    /// shows.
    pub original: Vec<Pose>,
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
}

impl EditItem {
    /// Cuts a motion of any rate into windows that all ask for the same. Frames after the last whole
    /// window are left out, so that `n` windows give `W + (W - 2) (n - 1)` frames at 10 fps.
    ///
    /// # Errors
    /// The motion is shorter than a window at 10 fps.
    ///
    /// # Source
    /// Paper App. B.1 and B.2. The windows advance by what each adds; the released demo's 31 raw
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
        Self::timed(id, motion, &[whole], skeleton, editor)
    }

    /// Cuts a motion into windows that ask for what is asked of their frames. A window belongs to the
    /// instruction that covers most of the frames it adds, the first of equals; one that none
    /// touches is kept as it is.
    ///
    /// # Errors
    /// The motion is shorter than a window at 10 fps, a range is empty or ends after the motion, or
    /// an instruction has no window of its own.
    ///
    /// # Source
    /// Paper Sec. 5.4 (time-variant editing); which window hears which instruction is not published.
    pub fn timed(
        id: impl Into<String>,
        motion: &Motion,
        instructions: &[TimedInstruction],
        skeleton: &Skeleton,
        editor: &EditorRecord,
    ) -> Result<Self, Error> {
        let id = id.into();
        let (window, normalizer) = (editor.train.window, &editor.normalizer);
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
        let to_model = Fps::MODEL.get() / motion.fps().get();
        let poses_at = |fps| {
            Resample::Exact
                .apply(motion, fps)
                .map(|motion| motion.poses())
                .map_err(|source| Error::Motion {
                    id: id.clone(),
                    source,
                })
        };
        let poses: Vec<Pose> = poses_at(Fps::MODEL)?;
        let original = poses_at(Fps::STORE)?;
        let starts = window_starts(poses.len(), window, window - FIXED_FRAMES);
        if starts.is_empty() {
            return Err(Error::Motion {
                id,
                source: datasets_spec::Error::TooShort {
                    frames: poses.len(),
                    fps: Fps::MODEL.get(),
                    needed: window,
                },
            });
        }
        let texts: Vec<Arc<str>> = instructions
            .iter()
            .map(|asked| asked.text.as_str().into())
            .collect();
        let mut heard = vec![false; texts.len()];
        let mut placement = None;
        let mut windows = Vec::with_capacity(starts.len());
        for &start in &starts {
            let mut segment = poses[start..start + window].to_vec();
            let placed = canonicalise(&mut segment, Anchor::Pelvis, skeleton);
            placement = placement.or(placed);
            // The first window adds its fixed frames too.
            let added = if start == 0 { 0 } else { start + FIXED_FRAMES };
            let (from, to) = (added as f64, (start + window) as f64);
            let covered = |asked: &TimedInstruction| {
                let begin = asked.frames.start as f64 * to_model;
                let end = asked.frames.end as f64 * to_model;
                (end.min(to) - begin.max(from)).max(0.0)
            };
            let mut best: Option<(usize, f64)> = None;
            for (index, asked) in instructions.iter().enumerate() {
                let share = covered(asked);
                if share > best.map_or(0.0, |(_, share)| share) {
                    best = Some((index, share));
                }
            }
            let progress = best.map_or(0.0, |(index, _)| {
                heard[index] = true;
                let Range { start: begin, end } = instructions[index].frames;
                let length = (end - begin) as f64 * to_model;
                ((start as f64 - begin as f64 * to_model) / length).clamp(0.0, 1.0)
            });
            windows.push(EditWindow {
                original: segment
                    .iter()
                    .map(|pose| normalizer.normalize(&skeleton.keypoints(pose)))
                    .collect(),
                instruction: best.map(|(index, _)| Arc::clone(&texts[index])),
                progress: progress as f32,
            });
        }
        if let Some(unheard) = heard.iter().position(|heard| !heard) {
            let Range { start, end } = instructions[unheard].frames;
            return Err(Error::Item {
                id,
                problem: format!(
                    "has no window that belongs to {start}:{end} {:?}: a window adds {} frames at \
                     10 fps, and others cover more of each; widen the range",
                    texts[unheard],
                    window - FIXED_FRAMES
                ),
            });
        }
        Ok(Self {
            id,
            windows,
            placement: placement.expect("there is a first window"),
            original,
        })
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
    /// Weight in m^2/rad^2 by which the fit holds rotations to those of the pose network or, without
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
        config.check()?;
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

    /// Poses whose twists a fit to generated frames at the store's rate keeps, at least as many as
    /// there are frames.
    pub(crate) fn twists<'a>(
        &self,
        item: &'a EditItem,
        frames: &[KeypointFrame],
        skeleton: &Skeleton,
    ) -> Cow<'a, [Pose]> {
        match &self.poses {
            Some(net) => net.poses(frames, skeleton, &self.device).into(),
            None => item.original.as_slice().into(),
        }
    }

    /// Gives the editor the vectors of the instructions it will be asked, of the frozen encoder it
    /// listens to.
    ///
    /// # Errors
    /// They are of another encoder.
    pub fn with_vectors(mut self, vectors: Box<dyn TextVectors + Send>) -> Result<Self, Error> {
        self.record.config.text.texts(Some(&*vectors))?;
        self.vectors = Some(vectors);
        Ok(self)
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
        let problem = if theirs.normalizer != ours.normalizer {
            "it was trained in another range of model units"
        } else if theirs.train.window != ours.train.window {
            "its windows have another length"
        } else if theirs.train.keypoints != ours.train.keypoints {
            "it sees other keypoints"
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

    /// Edits motions. Each result holds the keypoints of one item in metres at 10 fps; `times` gains
    /// what each part took. Keypoints the editor does not make lie on the joints they hang from.
    ///
    /// The noise of an item follows from the seed and its id, and a row of a batch never sees
    /// another, so a result does not depend on which other items are edited with it. The device is
    /// that of the editor.
    ///
    /// # Errors
    /// An item has no window or one of another length, a text has no vector, or the session is
    /// stopped.
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
        let window_frames = self.record.config.train.window;
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
        times.window = window_frames;
        let normalizer = &self.record.config.normalizer;
        let mut stitchers: Vec<Stitcher> = items
            .iter()
            .map(|item| Stitcher::new(skeleton.rest_triangle(), item.placement))
            .collect();
        let num_windows = items.iter().map(|item| item.windows.len()).sum::<usize>();
        let progress = session.progress;
        progress.begin("edit", Some(num_windows as u64));
        let longest = items.iter().map(|item| item.windows.len()).max();
        for window_index in 0..longest.unwrap_or(0) {
            // Longer motions go on while shorter ones are done.
            let mut active = Vec::new();
            for (index, item) in items.iter().enumerate() {
                match item.windows.get(window_index) {
                    Some(window) if window.instruction.is_some() => active.push(index),
                    Some(window) => {
                        keep(&mut stitchers[index], window, normalizer);
                        progress.advance(1);
                    }
                    None => {}
                }
            }
            for chunk in active.chunks(settings.max_batch.max(1)) {
                if session.is_stopped() {
                    return Err(Error::Stopped { what: "editing" });
                }
                let mut rows: Vec<Row<'_>> = chunk
                    .iter()
                    .map(|&index| {
                        let item = &items[index];
                        let window = &item.windows[window_index];
                        let fixed = match stitchers[index].next_fixed() {
                            Some(frames) => frames.map(|frame| normalizer.normalize(&frame)),
                            None => [window.original[0], window.original[1]],
                        };
                        let place = window_index.to_string();
                        Row {
                            window,
                            fixed,
                            rng: settings.seed.rng(&["edit", &item.id, &place]),
                        }
                    })
                    .collect();
                let generated = self.generate(&mut rows, settings, session, times)?;
                let width = 3 * self.record.config.train.keypoints;
                let numbers = window_frames * width;
                for (&index, window) in chunk.iter().zip(generated.chunks_exact(numbers)) {
                    let frames: Vec<KeypointFrame> = window
                        .chunks_exact(width)
                        .map(|frame| whole_frame(frame, normalizer))
                        .collect();
                    stitchers[index].push(&frames);
                }
                times.num_windows += chunk.len();
                times.num_batches += 1;
                progress.advance(chunk.len() as u64);
            }
        }
        progress.finish(&format!("{} motions, {num_windows} windows", items.len()));
        Ok(stitchers.into_iter().map(Stitcher::into_frames).collect())
    }

    /// Generates one window per row, `[B, W, 84]` normalised, or `[B, W, 66]` of the body joints alone.
    fn generate(
        &self,
        rows: &mut [Row<'_>],
        settings: &EditSettings,
        session: &Session<'_>,
        times: &mut EditTimes,
    ) -> Result<Vec<f32>, Error> {
        let begun = session.secs();
        let num_rows = rows.len();
        let (frames, keypoints) = {
            let config = &self.record.config.train;
            (config.window, config.keypoints)
        };
        let window = |values: Vec<f32>, frames: usize| -> Tensor<3> {
            Tensor::from_data(
                TensorData::new(values, [num_rows, frames, 3 * keypoints]),
                &self.device,
            )
        };
        let original: Vec<f32> = rows
            .iter()
            .flat_map(|row| row.window.original.as_flattened().iter().copied())
            .collect();
        let fixed: Vec<f32> = rows
            .iter()
            .flat_map(|row| row.fixed.as_flattened().iter().copied())
            .collect();
        let vectors = self.vectors.as_deref().map(|vectors| vectors as _);
        let texts = self.record.config.text.texts(vectors)?.batch(
            rows.iter()
                .map(|row| row.window.instruction.as_deref().unwrap_or_default()),
        )?;
        let condition = Condition {
            original: window(narrowed(original, keypoints), frames),
            fixed: window(narrowed(fixed, keypoints), FIXED_FRAMES),
            text: self.model.text_vectors(&texts, num_rows, &self.device),
            progress: rows.iter().map(|row| row.window.progress).collect(),
        };
        let diffusion = &self.record.config.train.diffusion;
        let clock = || session.secs();
        let coordinator = self.coordinator.as_ref().map(|coordinator| Guide {
            network: &coordinator.model,
            config: settings.coordinator,
            clock: &clock,
            secs: Cell::new(0.0),
        });
        let sampler = Sampler {
            denoiser: &self.model.denoiser,
            weights: &self.weights,
            schedule: &self.schedule,
            prediction: diffusion.prediction,
            clip: diffusion.clip,
            guidance: settings.guidance,
            coordinator: coordinator.as_ref(),
        };
        let x = sampler.sample(
            &condition,
            |_| {
                let scale = settings.temperature as f32;
                let noise: Vec<f32> = rows
                    .iter_mut()
                    .flat_map(|row| {
                        (0..frames * 3 * keypoints)
                            .map(|_| scale * row.rng.sample::<f32, _>(StandardNormal))
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
        times.coordinator_secs += guided;
        times.diffusion_secs += session.secs() - begun - guided;
        Ok(generated)
    }
}

/// A generated frame in metres. Keypoints that were not generated lie on the joints they hang from.
fn whole_frame(generated: &[f32], normalizer: &Normalizer) -> KeypointFrame {
    let mut frame: NormalizedFrame = [0.0; FRAME_WIDTH];
    frame[..generated.len()].copy_from_slice(generated);
    let mut points = normalizer.denormalize(&frame);
    for slot in generated.len() / 3..NUM_KEYPOINTS {
        points[slot] = points[keypoint_parent(slot)];
    }
    points
}

/// The keypoint that one of the others hangs from.
pub(crate) fn keypoint_parent(slot: usize) -> usize {
    usize::try_from(KEYPOINT_PARENTS[slot]).unwrap_or(0)
}

/// Adds a window as it was. After an edit its frames stand where the edit left the body, and the pose
/// finds back to the original within a few frames.
fn keep(stitcher: &mut Stitcher, window: &EditWindow, normalizer: &Normalizer) {
    let mut frames: Vec<KeypointFrame> = window
        .original
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

struct Row<'a> {
    window: &'a EditWindow,
    fixed: [NormalizedFrame; FIXED_FRAMES],
    rng: Rng,
}

/// What a batch of windows is generated from.
#[derive(Clone, Debug)]
pub struct Condition {
    /// Normalised original windows, `[B, W, 84]`.
    pub original: Tensor<3>,
    /// Normalised first frames, `[B, 2, 84]`.
    pub fixed: Tensor<3>,
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
        let slope = self
            .network
            .slope(x.clone(), &vec![seen_as; x.dims()[0]])
            .mul_scalar(self.config.strength);
        let _ = slope.to_data();
        self.secs.set(self.secs.get() + (self.clock)() - begun);
        Some(slope)
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
        mut noise: impl FnMut(Option<usize>) -> Tensor<3>,
        mut on_step: impl FnMut(usize, &Tensor<3>),
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
        let mut x = put_fixed(noise(None), condition.fixed.clone());
        for timestep in (0..self.schedule.len()).rev() {
            let input = if is_guided { twice(&x) } else { x.clone() };
            let timesteps = vec![timestep; batch];
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
                &x,
                &condition.original,
                &timesteps[..batch],
            );
            if self.clip {
                x0 = x0.clamp(-1.0, 1.0);
            }
            let push = |target, x: &Tensor<3>| {
                self.coordinator
                    .and_then(|guide| guide.push(target, x, timestep))
            };
            if let Some(slope) = push(GuidanceTarget::CleanPrediction, &x0) {
                x0 = x0 - slope;
            }
            let mut mean = self.schedule.posterior_mean(x0, x, &timesteps[..batch]);
            // The last step adds no noise, and what is scaled by it is nothing.
            if timestep > 0
                && let Some(slope) = push(GuidanceTarget::PosteriorMean, &mean)
            {
                let spread = self.schedule.posterior_variance[timestep].sqrt();
                mean = mean - slope.mul_scalar(spread);
            }
            x = self
                .schedule
                .add_noise(mean, timestep, noise(Some(timestep)));
            x = put_fixed(x, condition.fixed.clone());
            on_step(timestep, &x);
        }
        x
    }
}
