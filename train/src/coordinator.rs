//! The body-part coordinator: its training, and its use for guidance.

use std::path::Path;

use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use compose::{CoordinatorBatch, Stream};
use datasets_spec::{Motion, Resample, Seed, Skeleton};
use kinematics::canonical::{FIXED_FRAMES, WINDOW_FRAMES, canonicalise, window_starts};
use kinematics::normalise::{FRAME_WIDTH, Normalizer};
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::checkpoint::{Run, RunRecord, Slot, Start, open_for_use};
use crate::compose::ComposeRecord;
use crate::config::{
    NetworkConfig, OptimizerConfig, Preset, RunLength, RunSettings, ScheduleName, TrainConfig,
    all_keypoints, check_keypoints, check_windows, ensure, is_all_keypoints, is_default, narrowed,
    positive, share,
};
use crate::data::{WindowSource, across_epochs};
use crate::error::motion_error;
use crate::model::coordinator::Coordinator;
use crate::model::pass::{Arithmetic, Pass};
use crate::model::weights::Networks;
use crate::schedule::Schedule;
use crate::trainer::{Task, TrainReport, train};
use crate::transfer::{read, send};
use crate::{Error, Session};

pub(crate) const KIND: &str = "coordinator";

/// Number of last diffusion steps on whose noise the coordinator is trained (paper, Sec. 5.2).
const NOISE_STEPS: usize = 20;

/// Settings of the coordinator's training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoordinatorConfig {
    /// Sizes of the network.
    pub model: NetworkConfig,
    /// Noise schedule; it must equal that of the guided editor.
    pub schedule: ScheduleName,
    /// Number of diffusion steps; it must equal that of the guided editor.
    pub diffusion_steps: usize,
    /// Number of last diffusion steps whose noise is added to the windows.
    pub noise_steps: usize,
    /// Number of frames in a window.
    pub window: usize,
    /// Number of keypoints in a frame; it must equal that of the guided editor.
    #[serde(default = "all_keypoints", skip_serializing_if = "is_all_keypoints")]
    pub keypoints: usize,
    /// Share of training windows that are mirrored if the composer's settings mirror none. Mirroring does not change
    /// whether a window is natural or composed.
    #[serde(default, skip_serializing_if = "is_default")]
    pub mirrored_ratio: f64,
    /// Number of windows in a validation.
    pub val_windows: usize,
    /// Settings that every training run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl CoordinatorConfig {
    /// The settings of a preset; network and diffusion are those of the editor's preset.
    ///
    /// # Source
    /// Paper, Sec. 5.2 and App. B.4. The released coordinators were saved after 55 k to 68 k steps; `Official` and
    /// `Paper` run 68 k. Neither publication states this network's learning rate and batch size; the editor's are
    /// used. `Tiny` has a lower rate, because at the editor's rate the coordinator is at chance after 500 steps. Its
    /// 6,000 steps bring the validation loss on real motion well below that of chance
    /// (`eval/plans/real-small/RESULTS.md`). On the few clips of the built-in corpus it overfits to the natural windows
    /// unless half of them are mirrored.
    pub fn preset(preset: Preset) -> Self {
        let editor = TrainConfig::preset(preset);
        let is_tiny = preset == Preset::Tiny;
        Self {
            model: editor.model,
            schedule: editor.diffusion.schedule,
            diffusion_steps: editor.diffusion.num_steps,
            noise_steps: if is_tiny {
                editor.coordinator.num_steps
            } else {
                NOISE_STEPS
            },
            window: WINDOW_FRAMES,
            keypoints: editor.keypoints,
            mirrored_ratio: if is_tiny { 0.5 } else { 0.0 },
            val_windows: editor.val_windows,
            run: RunSettings {
                optimizer: match preset {
                    Preset::Tiny => OptimizerConfig {
                        learning_rate: 3e-4,
                        ..editor.run.optimizer
                    },
                    Preset::Paper | Preset::Official => editor.run.optimizer,
                },
                length: RunLength::of_steps(if is_tiny { 6_000 } else { 68_000 }),
                keep_epochs: 0,
                ..editor.run
            },
        }
    }

    /// Checks that the settings allow training.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        self.model.check()?;
        self.run.check()?;
        positive("window", self.window as u64)?;
        check_keypoints(self.keypoints)?;
        positive("val_windows", self.val_windows as u64)?;
        share("mirrored_ratio", self.mirrored_ratio)?;
        positive("noise_steps", self.noise_steps as u64)?;
        let (steps, all) = (self.noise_steps, self.diffusion_steps);
        let problem = format!("it is {steps}, more than the {all} diffusion steps");
        ensure(steps <= all, "noise_steps", problem)?;
        Schedule::new(self.schedule, self.diffusion_steps).map(|_| ())
    }
}

impl WindowSource<CoordinatorBatch> for Stream {
    fn epoch_len(&self) -> u64 {
        Stream::epoch_len(self)
    }

    fn window_len(&self) -> usize {
        Stream::window_len(self)
    }

    fn check(&self) -> Result<(), Error> {
        Ok(self.check_coordinator()?)
    }

    fn fill(
        &self,
        epoch: u64,
        first_item: u64,
        num_items: usize,
        batch: &mut CoordinatorBatch,
    ) -> Result<(), Error> {
        Ok(self.fill_coordinator(epoch, first_item, num_items, batch)?)
    }
}

/// Training data of the coordinator.
#[derive(Clone, Copy)]
pub struct Segments<'a> {
    /// Training segments: natural and composed windows in equal numbers.
    pub train: &'a dyn WindowSource<CoordinatorBatch>,
    /// Validation segments.
    pub val: &'a dyn WindowSource<CoordinatorBatch>,
    /// Normaliser with which the windows were scaled.
    pub normalizer: Normalizer,
    /// The skeleton of the motions.
    pub skeleton: &'a Skeleton,
    /// Hash of the tables that the segments are composed from.
    pub dataset_hash: &'a str,
    /// Composition settings of the windows.
    pub compose: &'a ComposeRecord,
}

/// Record of a coordinator's run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoordinatorRecord {
    /// The resolved settings.
    pub train: CoordinatorConfig,
    /// Normaliser with which the windows are scaled.
    pub normalizer: Normalizer,
    /// Composition settings of the windows.
    pub compose: ComposeRecord,
}

impl CoordinatorRecord {
    /// Checks a record after reading.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.train.check()?;
        self.compose.check(self.train.window)
    }
}

/// Trains the coordinator, or continues the training of the run folder, exactly as [`crate::fit::train_motionrefit`]
/// does.
///
/// # Errors
/// The settings are unusable, the folder holds another run or a damaged checkpoint, a loss is not
/// finite, or a file cannot be written.
///
/// # Source
/// Paper, Sec. 5.2 and App. B.4: binary classification of unmodified and composed segments, with the noise of the last
/// 20 diffusion steps.
pub fn train_coordinator<'a>(
    start: impl Into<Start<'a>>,
    config: &CoordinatorConfig,
    segments: Segments<'_>,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    config.check()?;
    segments.compose.check(config.window)?;
    for source in [segments.train, segments.val] {
        source.check()?;
        check_windows(config.window, source.window_len())?;
        if source.epoch_len() == 0 {
            return Err(Error::empty("source of segments"));
        }
    }
    let record = CoordinatorRecord {
        train: config.clone(),
        normalizer: segments.normalizer,
        compose: segments.compose.clone(),
    };
    let document =
        RunRecord::new(KIND, segments.dataset_hash, segments.skeleton, record).trained_in(session);
    let run = Run::open(start, &document)?;
    let seed = Seed(config.run.seed);
    let schedule = Schedule::new(config.schedule, config.diffusion_steps)?;
    let sampler = SegmentSampler {
        source: segments.train,
        schedule: &schedule,
        noise_steps: config.noise_steps,
        keypoints: config.keypoints,
        seed: seed.derive(&["train"]),
    };
    let val_sampler = SegmentSampler {
        source: segments.val,
        seed: seed.derive(&["val"]),
        ..sampler
    };
    let training = |first, count| sampler.draw(first, count);
    let validation = |first, count| val_sampler.draw(first, count);
    let task = Task::<Coordinator, SegmentBatch> {
        kind: KIND,
        samples: "windows",
        run: config.run,
        of_thread: Some(16),
        epoch_len: segments.train.epoch_len(),
        network: &|device| Coordinator::new(&config.model, 3 * config.keypoints, device),
        draw: &config.run.batches(training),
        loss: &|model, batch, device, pass| {
            let rows = batch.timesteps.len();
            let shape = [rows, config.window, 3 * config.keypoints];
            let x = send(batch.windows.clone(), shape, device);
            let composed = send(batch.composed.clone(), [rows, 1], device);
            binary_cross_entropy(model.logits(x, &batch.timesteps, pass), composed)
        },
        validation: config.run.validation(config.val_windows, validation)?,
    };
    train(&task, &run, session)
}

/// Noisy windows, their diffusion steps, and whether they were composed.
struct SegmentBatch {
    windows: Vec<f32>,
    timesteps: Vec<usize>,
    composed: Vec<f32>,
}

#[derive(Clone, Copy)]
struct SegmentSampler<'a> {
    source: &'a dyn WindowSource<CoordinatorBatch>,
    schedule: &'a Schedule,
    noise_steps: usize,
    keypoints: usize,
    seed: Seed,
}

impl SegmentSampler<'_> {
    /// The segments `first..first + count` of the run; the numbering continues across epochs.
    fn draw(&self, first: u64, count: usize) -> Result<SegmentBatch, Error> {
        let window = self.source.window_len() / FRAME_WIDTH * 3 * self.keypoints;
        let mut whole = CoordinatorBatch::default();
        let mut part = CoordinatorBatch::default();
        let items = first..first + count as u64;
        across_epochs(self.source.epoch_len(), items, |epoch, item, num_items| {
            self.source.fill(epoch, item, num_items, &mut part)?;
            whole.windows.append(&mut part.windows);
            whole.composed.append(&mut part.composed);
            Ok(())
        })?;
        whole.windows = narrowed(whole.windows, self.keypoints);
        let timesteps: Vec<usize> = whole
            .windows
            .par_chunks_mut(window)
            .enumerate()
            .map(|(index, values)| {
                let mut rng = self.seed.rng_of(first + index as u64);
                let timestep = rng.random_range(0..self.noise_steps);
                let kept = self.schedule.alphas_cumprod[timestep];
                let (signal, noise) = (kept.sqrt() as f32, (1.0 - kept).sqrt() as f32);
                for value in values {
                    *value = signal * *value + noise * rng.sample::<f32, _>(StandardNormal);
                }
                timestep
            })
            .collect();
        Ok(SegmentBatch {
            windows: whole.windows,
            timesteps,
            composed: whole.composed,
        })
    }
}

/// The mean cross entropy of logits `z` and labels `y` in [0, 1]: `max(z, 0) - z y + ln(1 + exp(-|z|))`, which does not
/// overflow.
fn binary_cross_entropy(logits: Tensor<2>, labels: Tensor<2>) -> Tensor<1> {
    let softened = logits.clone().abs().neg().exp().log1p();
    (relu(logits.clone()) - logits * labels + softened).mean()
}

/// A trained coordinator.
#[derive(Debug)]
pub struct TrainedCoordinator {
    pub(crate) model: Coordinator,
    record: RunRecord<CoordinatorRecord>,
    hash: String,
    device: Device,
    arithmetic: Arithmetic,
}

impl TrainedCoordinator {
    /// Loads a coordinator from its run folder.
    ///
    /// # Errors
    /// The folder is not a run of the coordinator, or its checkpoint is missing or damaged.
    pub fn load(run_dir: &Path, slot: Slot, device: &Device) -> Result<Self, Error> {
        let opened = open_for_use::<CoordinatorRecord>(run_dir, slot, KIND)?;
        let (record, hash, mut files) = (opened.record, opened.hash, opened.files);
        record.config.check()?;
        let train = &record.config.train;
        let mut model = Coordinator::new(&train.model, 3 * train.keypoints, device);
        model.take_files(&mut files, run_dir)?;
        Ok(Self {
            model,
            record,
            hash,
            device: device.clone(),
            arithmetic: Arithmetic::default(),
        })
    }

    /// Returns the coordinator with other arithmetic for its own predictions.
    #[must_use]
    pub fn with_arithmetic(mut self, arithmetic: Arithmetic) -> Self {
        self.arithmetic = arithmetic;
        self
    }

    /// The record of the training run.
    pub fn record(&self) -> &RunRecord<CoordinatorRecord> {
        &self.record
    }

    /// Hash of the weights: BLAKE3, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// The share of a motion's windows classified as composed, in [0, 1]. Consecutive windows share the fixed frames,
    /// as in an edit. `None` if the motion is shorter than a window.
    ///
    /// # Errors
    /// The motion cannot be resampled.
    pub fn composed_share(
        &self,
        motion: &Motion,
        skeleton: &Skeleton,
    ) -> Result<Option<f64>, Error> {
        let no_motion = motion_error::<kinematics::Error>("a motion to judge");
        let window = self.record.config.train.window;
        let compose = &self.record.config.compose.config;
        let poses = Resample::Exact
            .apply(motion, compose.fps)
            .map_err(no_motion)?
            .poses();
        let starts = window_starts(poses.len(), window, window - FIXED_FRAMES);
        if starts.is_empty() {
            return Ok(None);
        }
        let normalizer = &self.record.config.normalizer;
        let mut values = Vec::with_capacity(starts.len() * window * FRAME_WIDTH);
        for start in &starts {
            let mut segment = poses[*start..start + window].to_vec();
            canonicalise(&mut segment, compose.anchor, skeleton);
            for pose in &segment {
                values.extend(normalizer.normalize(&skeleton.keypoints(pose)));
            }
        }
        let judged = self.probabilities(&values);
        let composed = judged
            .iter()
            .filter(|&&probability| probability > 0.5)
            .count();
        Ok(Some(composed as f64 / judged.len() as f64))
    }

    /// The probability that each clean window was composed, `[B]`.
    ///
    /// # Shapes
    /// `windows` `[B, W, 84]` in model units.
    pub fn probabilities(&self, windows: &[f32]) -> Vec<f32> {
        let config = &self.record.config.train;
        let (window, keypoints) = (config.window, config.keypoints);
        let rows = windows.len() / (window * FRAME_WIDTH);
        if rows == 0 {
            return Vec::new();
        }
        let seen = narrowed(windows.to_vec(), keypoints);
        let x = send(seen, [rows, window, 3 * keypoints], &self.device);
        let pass = Pass::new(self.arithmetic);
        read(self.model.probability(x, &vec![0; rows], &pass))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cross_entropy_is_that_of_its_definition_and_stays_finite() {
        let device = Device::flex();
        let loss = |logit: f32, label: f32| -> f64 {
            let logits = Tensor::from_data([[logit]], &device);
            let labels = Tensor::from_data([[label]], &device);
            let value: f32 = binary_cross_entropy(logits, labels).into_scalar();
            f64::from(value)
        };
        for (logit, label) in [(0.3, 1.0), (-1.7, 0.0), (2.0, 0.25)] {
            let p = 1.0 / (1.0 + (-f64::from(logit)).exp());
            let y = f64::from(label);
            let expected = -(y * p.ln() + (1.0 - y) * (1.0 - p).ln());
            assert!((loss(logit, label) - expected).abs() < 1e-6);
        }
        assert_eq!(loss(200.0, 0.0), 200.0);
        assert_eq!(loss(-200.0, 0.0), 0.0);
    }

    #[test]
    fn presets_are_usable() {
        for preset in Preset::ALL {
            CoordinatorConfig::preset(preset).check().expect("usable");
        }
    }
}
