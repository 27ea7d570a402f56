//! MDM: settings and training.

use burn::tensor::{Device, Tensor};
use datasets_spec::Seed;
use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::captioned::{CaptionedCorpus, CropSampler, Crops, captioned_rows, grouped_stats};
use crate::checkpoint::{Run, RunRecord, Start};
use crate::config::{
    NetworkConfig, OptimizerConfig, Preset, RunLength, RunSettings, TextConfig, TrainConfig,
    check_lengths, finite, positive, share,
};
use crate::data::{TextBatch, Texts};
use crate::features::FeatureStats;
use crate::fit::TextRecord;
use crate::model::conditioned::Conditioned;
use crate::model::mdm::Mdm;
use crate::model::pass::Pass;
use crate::sample::noise::normal;
use crate::schedule::Schedule;
use crate::text::clip::ClipModel;
use crate::text::source::keep_vectors;
use crate::trainer::{self, Task, TrainReport};
use crate::transfer::send;
use crate::{Error, Session};

pub(crate) use crate::checkpoint::MDM_KIND as KIND;

pub(crate) const CLIP: ClipModel = ClipModel::VitB32;

/// Settings of MDM.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MdmConfig {
    /// Sizes of the transformer.
    pub model: NetworkConfig,
    /// Text encoder.
    pub text: TextConfig,
    /// Number of diffusion steps; the schedule is the squared cosine.
    pub diffusion_steps: usize,
    /// Whether frames after the end of a motion are masked in attention. If not, motions are always padded to
    /// `max_frames`, because the network was trained to see the padding.
    pub mask_frames: bool,
    /// Probability that a training motion is shown without its caption.
    pub text_dropout: f64,
    /// Guidance weight of the text.
    pub guidance: f64,
    /// Minimum length of training motions, in frames at 20 fps.
    pub min_frames: usize,
    /// Maximum length of training crops, in frames at 20 fps.
    pub max_frames: usize,
    /// Settings that every training run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl MdmConfig {
    /// The settings of a preset.
    ///
    /// # Source
    /// `Official`: the released defaults (`algorithms` section 12). `Paper`: the same network,
    /// trained as the MotionReFit paper trains every system: 1,500 epochs in batches of 1,024. `Tiny`: our choice for two
    /// processor cores and a few minutes.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Paper => {
                let official = Self::preset(Preset::Official);
                let editor = TrainConfig::preset(Preset::Paper).run;
                Self {
                    run: RunSettings {
                        batch_size: editor.batch_size,
                        micro_batch_size: editor.micro_batch_size,
                        length: editor.length,
                        ..official.run
                    },
                    ..official
                }
            }
            Preset::Official => Self {
                model: NetworkConfig {
                    width: 512,
                    num_layers: 8,
                    num_heads: 4,
                    feed_forward: 1024,
                    dropout: 0.1,
                },
                text: TextConfig::clip(),
                diffusion_steps: 1_000,
                mask_frames: false,
                text_dropout: 0.1,
                guidance: 2.5,
                min_frames: 40,
                max_frames: 196,
                run: RunSettings {
                    optimizer: OptimizerConfig {
                        weight_decay: 0.0,
                        ..OptimizerConfig::of_rate(1e-4)
                    },
                    batch_size: 64,
                    micro_batch_size: None,
                    length: RunLength::of_steps(600_000),
                    log_every: 100,
                    val_every: 10_000,
                    keep_epochs: 0,
                    seed: 0,
                },
            },
            Preset::Tiny => {
                let editor = TrainConfig::preset(Preset::Tiny);
                Self {
                    model: editor.model,
                    text: editor.text,
                    diffusion_steps: 50,
                    mask_frames: true,
                    min_frames: 16,
                    run: RunSettings {
                        batch_size: 16,
                        micro_batch_size: None,
                        ..editor.run
                    },
                    ..Self::preset(Preset::Official)
                }
            }
        }
    }

    /// Checks that the settings allow training.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        self.model.check()?;
        self.run.check()?;
        self.text.check_pooled()?;
        self.text.check_words()?;
        finite("guidance", self.guidance)?;
        share("text_dropout", self.text_dropout)?;
        positive("diffusion_steps", self.diffusion_steps as u64)?;
        check_lengths(self.min_frames, self.max_frames)
    }
}

/// Record of a run of MDM.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MdmRecord {
    pub(crate) train: MdmConfig,
    pub(crate) features: FeatureStats,
    pub(crate) text: TextRecord,
}

impl MdmRecord {
    pub(crate) fn network(&self, device: &Device) -> Conditioned<Mdm> {
        let (config, num_features) = (&self.train.model, self.features.recipe.width());
        Conditioned::new(self.text.source(), config.width, device, |text_width| {
            Mdm::new(config, num_features, text_width, device)
        })
    }
}

/// Trains MDM, or continues the training of the run folder, exactly as [`crate::fit::train_motionrefit`] does. Clips
/// shorter than `min_frames` are left out. A run that starts from another run's weights keeps that run's vocabulary and
/// feature statistics.
///
/// # Errors
/// - The settings are unusable, or the text encoder is missing.
/// - A split has no clip that is long enough, or a clip has no caption.
/// - The folder holds another run or a damaged checkpoint, or a file cannot be written.
/// - A loss is not finite.
pub fn train_mdm<'a>(
    start: impl Into<Start<'a>>,
    config: &MdmConfig,
    corpus: CaptionedCorpus<'_>,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    config.check()?;
    let start = start.into();
    let fitted: Option<MdmRecord> = start.fitted(KIND)?;
    let (known_text, known_features) = fitted.map(|known| (known.text, known.features)).unzip();
    let (captions, vectors) = (corpus.captions(), corpus.vectors);
    let text = TextRecord::chosen(&config.text, start, known_text, captions, vectors)?;
    let rows = |clips, what| captioned_rows(clips, corpus.skeleton, config.min_frames, what);
    let train = rows(corpus.train, "training split of MDM")?;
    let val = rows(corpus.val, "validation split of MDM")?;
    let record = MdmRecord {
        train: config.clone(),
        features: known_features.unwrap_or_else(|| grouped_stats(&train)),
        text,
    };
    let document = RunRecord::new(KIND, corpus.dataset_hash, corpus.skeleton, record.clone())
        .trained_in(session);
    let run = Run::open(start, &document)?;
    keep_vectors(corpus.vectors, run.dir())?;
    let seed = Seed(config.run.seed);
    let sampler = |clips, name| CropSampler {
        clips,
        stats: &record.features,
        max_frames: config.max_frames,
        pads_to_max: !config.mask_frames,
        seed: seed.derive(&[name]),
    };
    let (sampler, held_out) = (sampler(&train, "train"), sampler(&val, "val"));
    let noising = Noising {
        record: &record,
        schedule: Schedule::cosine(config.diffusion_steps)?,
        texts: record.text.texts(corpus.vectors)?,
    };
    let size = config.run.micro_batch();
    let val_batches = held_out.validation(size, config.diffusion_steps);
    let val_batches = val_batches.map(|(first, timesteps, crops)| {
        let batch = noising.noisy(crops, held_out.seed, first, 0.0)?;
        Ok((timesteps.len(), MdmBatch { timesteps, ..batch }))
    });
    let task = Task::<Conditioned<Mdm>, MdmBatch<'_>> {
        kind: KIND,
        samples: "motions",
        run: config.run,
        of_thread: Some(4),
        epoch_len: train.len() as u64,
        network: &|device| record.network(device),
        draw: &config.run.batches(|first, count| {
            let crops = sampler.draw(first, count);
            noising.noisy(crops, sampler.seed, first, config.text_dropout)
        }),
        loss: &|model, batch, device, pass| noising.loss(model, batch, device, pass),
        validation: val_batches.collect::<Result<_, Error>>()?,
    };
    let report = trainer::train(&task, &run, session)?;
    Ok(report.without((corpus.train.len() - train.len()) as u64))
}

/// Motions with their captions, and all random draws of a training step.
struct MdmBatch<'a> {
    crops: Crops<'a>,
    /// Standard normal noise, `[B, T, 263]`.
    noise: Vec<f32>,
    /// Diffusion steps, `[B]`.
    timesteps: Vec<usize>,
    texts: TextBatch,
    /// 1 if the caption is shown, 0 if it is dropped, `[B]`.
    text_kept: Vec<f32>,
}

/// Adds diffusion noise to motions and computes the loss.
struct Noising<'a> {
    record: &'a MdmRecord,
    schedule: Schedule,
    texts: Texts<'a>,
}

impl Noising<'_> {
    /// Draws the noise, the diffusion steps and the dropped captions of crops. The first crop is sample `first` of the
    /// run.
    fn noisy<'c>(
        &self,
        crops: Crops<'c>,
        seed: Seed,
        first: u64,
        text_dropout: f64,
    ) -> Result<MdmBatch<'c>, Error> {
        let row = crops.frames * self.record.features.recipe.width();
        let mut noise = Vec::with_capacity(crops.features.len());
        let (mut timesteps, mut text_kept) = (Vec::new(), Vec::new());
        for index in 0..crops.lengths.len() as u64 {
            let mut rng = seed.rng(&["noise", &(first + index).to_string()]);
            timesteps.push(rng.random_range(0..self.schedule.len()));
            let is_dropped = rng.random_bool(text_dropout);
            text_kept.push(if is_dropped { 0.0 } else { 1.0 });
            noise.extend(normal(&mut rng, row));
        }
        Ok(MdmBatch {
            texts: self.texts.batch(crops.captions.iter().copied())?,
            crops,
            noise,
            timesteps,
            text_kept,
        })
    }

    /// The loss: the error of the predicted clean motions.
    ///
    /// # Source
    /// Tevet et al. 2023, Eq. 2; the weights of the geometric losses are 0 in the released settings.
    fn loss(
        &self,
        model: &Conditioned<Mdm>,
        batch: &MdmBatch<'_>,
        device: &Device,
        pass: &Pass,
    ) -> Tensor<1> {
        let (rows, crops) = (batch.timesteps.len(), &batch.crops);
        let x0 = crops.tensor(device);
        let noise = send(batch.noise.clone(), x0.dims(), device);
        let text = model.text_vectors(&batch.texts, rows, device)
            * send(batch.text_kept.clone(), [rows, 1], device);
        let x_t = self.schedule.q_sample(x0.clone(), &batch.timesteps, noise);
        let lengths = self.record.train.mask_frames.then_some(&*crops.lengths);
        let predicted = model
            .network
            .forward(x_t, &batch.timesteps, text, lengths, pass);
        masked_l2(predicted, x0, &crops.lengths).mean()
    }
}

/// The mean squared error of each row, over the frames that are not padding.
///
/// # Shapes
/// `predicted` and `target` `[B, T, F]`; `lengths` and the result `[B]`.
///
/// # Source
/// `masked_l2` of the released code.
pub fn masked_l2(predicted: Tensor<3>, target: Tensor<3>, lengths: &[usize]) -> Tensor<1> {
    let [rows, frames, width] = predicted.dims();
    let weights: Vec<f32> = lengths
        .iter()
        .flat_map(|&length| {
            let weight = 1.0 / (length.max(1) * width) as f32;
            (0..frames).map(move |frame| if frame < length { weight } else { 0.0 })
        })
        .collect();
    let weights = send(weights, [rows, frames, 1], &predicted.device());
    let errors = (predicted - target).square() * weights;
    errors.sum_dim(2).sum_dim(1).reshape([rows])
}
