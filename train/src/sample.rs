//! Editing motions: windows generated one after another and merged.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use datasets_spec::canonical::{
    Anchor, FIXED_FRAMES, GroundTransform, KeypointFrame, Stitcher, WINDOW_ADVANCE, WINDOW_FRAMES,
    canonicalise, window_starts,
};
use datasets_spec::normalise::{FRAME_WIDTH, NormalizedFrame, Normalizer};
use datasets_spec::{Fps, Motion, Pose, Progress, Resample, Rng, Seed, Skeleton};
use rand::RngExt;
use rand_distr::StandardNormal;

use crate::Error;
use crate::checkpoint::{self, RunRecord, Slot, read_for_use, weights_hash};
use crate::data::WINDOW_NUMBERS;
use crate::diffusion::{Prediction, Schedule, guide, put_fixed};
use crate::fit::{DENOISER, EditorRecord, KIND, TEXT, load_weights};
use crate::model::denoiser::Denoiser;
use crate::model::motionrefit::MotionRefit;

/// A motion to edit, cut into windows at the model's rate.
#[derive(Clone, Debug, PartialEq)]
pub struct EditItem {
    /// Names the item, and with the seed decides its noise.
    pub id: String,
    /// What is asked for.
    pub instruction: String,
    /// Canonical, normalised windows of the original; each starts 14 frames after the one before.
    pub windows: Vec<[NormalizedFrame; WINDOW_FRAMES]>,
    /// Position of each window in the motion, in [0, 1].
    pub progress: Vec<f32>,
    /// Where the first window stands in the world.
    pub placement: GroundTransform,
}

impl EditItem {
    /// Cuts a motion of any rate into windows. Frames after the last whole window are left out, so
    /// that `n` windows give `16 + 14 (n - 1)` frames at 10 fps.
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
        instruction: impl Into<String>,
        skeleton: &Skeleton,
        normalizer: &Normalizer,
    ) -> Result<Self, Error> {
        let id = id.into();
        let motion = Resample::Exact
            .apply(motion, Fps::MODEL)
            .map_err(|source| Error::Motion {
                id: id.clone(),
                source,
            })?;
        let poses: Vec<Pose> = motion.poses();
        let starts = window_starts(poses.len(), WINDOW_FRAMES, WINDOW_ADVANCE);
        let mut placement = None;
        let mut windows = Vec::with_capacity(starts.len());
        for &start in &starts {
            let mut segment = poses[start..start + WINDOW_FRAMES].to_vec();
            let placed = canonicalise(&mut segment, Anchor::Pelvis, skeleton);
            placement = placement.or(placed);
            windows.push(std::array::from_fn(|frame| {
                normalizer.normalize(&skeleton.keypoints(&segment[frame]))
            }));
        }
        let Some(placement) = placement else {
            return Err(Error::Motion {
                id,
                source: datasets_spec::Error::TooShort {
                    frames: poses.len(),
                    fps: Fps::MODEL.get(),
                    needed: WINDOW_FRAMES,
                },
            });
        };
        Ok(Self {
            id,
            instruction: instruction.into(),
            windows,
            progress: starts
                .iter()
                .map(|&start| start as f32 / poses.len() as f32)
                .collect(),
            placement,
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
    /// Windows generated at a time.
    pub max_batch: usize,
}

/// A trained editor.
#[derive(Debug)]
pub struct Editor {
    model: MotionRefit,
    schedule: Schedule,
    record: RunRecord<EditorRecord>,
    hash: String,
    device: Device,
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
        let num_tokens = record.config.vocabulary.num_tokens();
        let mut model = MotionRefit::new(&config.model, num_tokens, device);
        load_weights(&mut model, &mut files, run_dir)?;
        Ok(Self {
            model,
            schedule: Schedule::new(config.diffusion.schedule, config.diffusion.num_steps)?,
            hash,
            device: device.clone(),
            record,
        })
    }

    /// The settings the editor was trained with and what was fitted to its training split.
    pub fn record(&self) -> &RunRecord<EditorRecord> {
        &self.record
    }

    /// The range of model units the model was trained in.
    pub fn normalizer(&self) -> &Normalizer {
        &self.record.config.normalizer
    }

    /// What identifies the weights: BLAKE3, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// Edits motions. Each result holds the keypoints of one item in metres at 10 fps.
    ///
    /// The noise of an item follows from the seed and its id, and a row of a batch never sees
    /// another, so a result does not depend on which other items are edited with it.
    ///
    /// # Errors
    /// An item has no window, or not one progress per window.
    ///
    /// # Source
    /// Paper App. B.2; `algorithms` section 8.
    pub fn edit_batch(
        &self,
        items: &[EditItem],
        skeleton: &Skeleton,
        settings: &EditSettings,
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<KeypointFrame>>, Error> {
        for item in items {
            let problem = if item.windows.is_empty() {
                "has no window"
            } else if item.windows.len() != item.progress.len() {
                "needs one progress value per window"
            } else {
                continue;
            };
            return Err(Error::Item {
                id: item.id.clone(),
                problem: problem.to_owned(),
            });
        }
        let normalizer = &self.record.config.normalizer;
        let mut stitchers: Vec<Stitcher> = items
            .iter()
            .map(|item| Stitcher::new(skeleton.rest_triangle(), item.placement))
            .collect();
        let num_windows = items.iter().map(|item| item.windows.len()).sum::<usize>();
        progress.begin("edit", Some(num_windows as u64));
        let longest = items.iter().map(|item| item.windows.len()).max();
        for window_index in 0..longest.unwrap_or(0) {
            // Longer motions go on while shorter ones are done.
            let active: Vec<usize> = (0..items.len())
                .filter(|&item| window_index < items[item].windows.len())
                .collect();
            for chunk in active.chunks(settings.max_batch.max(1)) {
                let mut rows: Vec<Row<'_>> = chunk
                    .iter()
                    .map(|&index| {
                        let item = &items[index];
                        let original = &item.windows[window_index];
                        let fixed = match stitchers[index].next_fixed() {
                            Some(frames) => frames.map(|frame| normalizer.normalize(&frame)),
                            None => [original[0], original[1]],
                        };
                        Row {
                            original,
                            fixed,
                            instruction: &item.instruction,
                            progress: item.progress[window_index],
                            rng: settings
                                .seed
                                .rng(&["edit", &item.id, &window_index.to_string()]),
                        }
                    })
                    .collect();
                let generated = self.generate(&mut rows, settings.guidance);
                for (&index, window) in chunk.iter().zip(generated.chunks_exact(WINDOW_NUMBERS)) {
                    let frames: Vec<KeypointFrame> = window
                        .chunks_exact(FRAME_WIDTH)
                        .map(|frame| normalizer.denormalize(frame))
                        .collect();
                    stitchers[index].push(&frames);
                }
                progress.advance(chunk.len() as u64);
            }
        }
        progress.finish(&format!("{} motions, {num_windows} windows", items.len()));
        Ok(stitchers.into_iter().map(Stitcher::into_frames).collect())
    }

    /// Generates one window per row, `[B, 16, 84]` normalised.
    fn generate(&self, rows: &mut [Row<'_>], guidance: f64) -> Vec<f32> {
        let num_rows = rows.len();
        let window = |values: Vec<f32>, frames: usize| -> Tensor<3> {
            Tensor::from_data(
                TensorData::new(values, [num_rows, frames, FRAME_WIDTH]),
                &self.device,
            )
        };
        let original: Vec<f32> = rows
            .iter()
            .flat_map(|row| row.original.as_flattened().iter().copied())
            .collect();
        let fixed: Vec<f32> = rows
            .iter()
            .flat_map(|row| row.fixed.as_flattened().iter().copied())
            .collect();
        let tokens = self
            .record
            .config
            .vocabulary
            .encode_batch(rows.iter().map(|row| row.instruction));
        let progress: Vec<f32> = rows.iter().map(|row| row.progress).collect();
        let condition = Condition {
            original: window(original, WINDOW_FRAMES),
            fixed: window(fixed, FIXED_FRAMES),
            text: self.model.text.forward(&tokens),
            progress,
        };
        let sampler = Sampler {
            denoiser: &self.model.denoiser,
            schedule: &self.schedule,
            prediction: self.record.config.train.diffusion.prediction,
            clip: self.record.config.train.diffusion.clip,
            guidance,
        };
        let x = sampler.sample(
            &condition,
            |_| {
                let noise: Vec<f32> = rows
                    .iter_mut()
                    .flat_map(|row| {
                        (0..WINDOW_NUMBERS).map(|_| row.rng.sample::<f32, _>(StandardNormal))
                    })
                    .collect();
                window(noise, WINDOW_FRAMES)
            },
            |_, _| {},
        );
        x.into_data()
            .try_into_vec_as()
            .expect("a float tensor gives floats")
    }
}

struct Row<'a> {
    original: &'a [NormalizedFrame; WINDOW_FRAMES],
    fixed: [NormalizedFrame; FIXED_FRAMES],
    instruction: &'a str,
    progress: f32,
    rng: Rng,
}

/// What a batch of windows is generated from.
#[derive(Clone, Debug)]
pub struct Condition {
    /// Normalised original windows, `[B, 16, 84]`.
    pub original: Tensor<3>,
    /// Normalised first frames, `[B, 2, 84]`.
    pub fixed: Tensor<3>,
    /// Text vectors, `[B, d]`.
    pub text: Tensor<2>,
    /// Position of each window in its motion, `[B]`.
    pub progress: Vec<f32>,
}

/// Generates windows from pure noise.
#[derive(Clone, Copy, Debug)]
pub struct Sampler<'a> {
    /// The network.
    pub denoiser: &'a Denoiser,
    /// The schedule it was trained with.
    pub schedule: &'a Schedule,
    /// What it predicts.
    pub prediction: Prediction,
    /// Whether estimates of the clean window are clipped to [-1, 1].
    pub clip: bool,
    /// Guidance weight.
    pub guidance: f64,
}

impl Sampler<'_> {
    /// Generates a batch of windows, `[B, 16, 84]`.
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
        let mut x = put_fixed(noise(None), condition.fixed.clone());
        for timestep in (0..self.schedule.len()).rev() {
            let input = if is_guided { twice(&x) } else { x.clone() };
            let timesteps = vec![timestep; progress.len()];
            let predicted =
                self.denoiser
                    .forward(input, &timesteps, text.clone(), &progress, original.clone());
            let predicted = if is_guided {
                guide(
                    predicted.clone().narrow(0, 0, batch),
                    predicted.narrow(0, batch, batch),
                    self.guidance,
                )
            } else {
                predicted
            };
            let mut x0 = match self.prediction {
                Prediction::Noise => {
                    self.schedule
                        .predict_x0(x.clone(), &timesteps[..batch], predicted)
                }
                Prediction::Clean => predicted,
                Prediction::Change => predicted + condition.original.clone(),
            };
            if self.clip {
                x0 = x0.clamp(-1.0, 1.0);
            }
            x = self
                .schedule
                .reverse_step(x, x0, timestep, noise(Some(timestep)));
            x = put_fixed(x, condition.fixed.clone());
            on_step(timestep, &x);
        }
        x
    }
}
