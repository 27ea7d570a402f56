//! The evaluation encoder: training and use.

use std::ops::Range;
use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use datasets_spec::{Motion, Seed, Skeleton};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::checkpoint::{
    self, Files, MOTION_KIND, Run, RunRecord, Slot, Start, read_for_use, read_kind, take,
    weights_hash,
};
use crate::config::Loss;
use crate::config::{
    Decay, NetworkConfig, OptimizerConfig, Preset, RunLength, RunSettings, WordsConfig, positive,
};
use crate::features::{FeatureRecipe, FeatureStats, Prepared};
use crate::model::tmr::{SequenceEncoder, Tmr, TmrSizes, info_nce};
use crate::model::weights::{draw, from_safetensors, to_safetensors};
use crate::trainer::{self, Task, TrainReport, TrainerConfig};
use crate::transfer::{read, weighted_mean};
use crate::vocabulary::{TokenBatch, Vocabulary};
use crate::{Error, Session};

pub(crate) const KIND: &str = "tmr";
const WEIGHTS: &str = "tmr.safetensors";

/// Weights of a motion encoder trained elsewhere.
pub(crate) const MOTION_WEIGHTS: &str = "motion_encoder.safetensors";

/// Motions or texts encoded at a time.
const ENCODE_BATCH: usize = 32;

/// Settings of the encoder's training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TmrConfig {
    /// Input features of the encoder.
    pub features: FeatureRecipe,
    /// Sizes of the transformers; the width is that of the latent space.
    pub model: NetworkConfig,
    /// Width of a word vector.
    pub word_width: usize,
    /// Vocabulary.
    pub text: WordsConfig,
    /// Frames at the rate of the features from one frame of the encoder to the next.
    pub frame_stride: usize,
    /// Shortest crop shown in training, in frames of the encoder.
    pub min_frames: usize,
    /// Longest crop shown in training, in frames of the encoder. Later frames of a longer motion are
    /// ignored.
    pub max_frames: usize,
    /// Weights of the parts of the loss.
    pub weights: LossWeights,
    /// Temperature of the contrastive loss.
    pub temperature: f64,
    /// Settings that every training run has. The contrastive loss compares all pairs of a batch, so a
    /// batch is not split into micro-batches.
    #[serde(flatten)]
    pub run: RunSettings,
}

/// Weights of the parts of the encoder's loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LossWeights {
    /// Reconstruction loss of the motions decoded from either latent vector.
    pub reconstruction: f64,
    /// KL divergences between the two distributions and from the standard normal one.
    pub kl: f64,
    /// Distance between the two latent vectors.
    pub latent: f64,
    /// Contrastive loss over the pairs of the batch.
    pub contrastive: f64,
}

impl TmrConfig {
    /// The named settings.
    ///
    /// # Source
    /// `Official`: Petrovich et al. 2023 (`algorithms` section 15), its 500 epochs of HumanML3D at
    /// batch 32 given as steps. `Tiny`: our choice, for a few hundred clips and a minute on two
    /// processor cores: every second frame, a smaller network, and a larger weight of the contrastive
    /// loss, because training is too short for the reconstruction to shape the space.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Paper | Preset::Official => Self {
                features: FeatureRecipe::HumanMl3d,
                model: NetworkConfig {
                    width: 256,
                    num_layers: 6,
                    num_heads: 4,
                    feed_forward: 1024,
                    dropout: 0.1,
                },
                word_width: 256,
                text: WordsConfig {
                    num_buckets: 64,
                    max_words: 64,
                },
                frame_stride: 1,
                min_frames: 40,
                max_frames: 200,
                weights: LossWeights {
                    reconstruction: 1.0,
                    kl: 1e-5,
                    latent: 1e-5,
                    contrastive: 0.1,
                },
                temperature: 0.1,
                run: RunSettings {
                    optimizer: OptimizerConfig {
                        learning_rate: 1e-4,
                        decay: Decay::Constant,
                        warmup_steps: 0,
                        weight_decay: 0.01,
                        max_gradient_norm: None,
                        ema_decay: None,
                    },
                    batch_size: 32,
                    micro_batch_size: None,
                    length: RunLength::of_steps(365_000),
                    log_every: 100,
                    val_every: 5_000,
                    keep_epochs: 0,
                    seed: 0,
                },
            },
            Preset::Tiny => Self {
                features: FeatureRecipe::Smpl135,
                model: NetworkConfig {
                    width: 64,
                    num_layers: 2,
                    num_heads: 4,
                    feed_forward: 128,
                    dropout: 0.0,
                },
                word_width: 64,
                text: WordsConfig {
                    num_buckets: 16,
                    max_words: 24,
                },
                frame_stride: 2,
                min_frames: 16,
                max_frames: 100,
                weights: LossWeights {
                    reconstruction: 1.0,
                    kl: 1e-5,
                    latent: 1e-5,
                    contrastive: 1.0,
                },
                temperature: 0.1,
                run: RunSettings {
                    optimizer: OptimizerConfig {
                        learning_rate: 1e-3,
                        decay: Decay::Linear,
                        warmup_steps: 20,
                        weight_decay: 0.01,
                        max_gradient_norm: None,
                        ema_decay: None,
                    },
                    batch_size: 32,
                    micro_batch_size: None,
                    length: RunLength::of_steps(300),
                    log_every: 10,
                    val_every: 50,
                    keep_epochs: 0,
                    seed: 0,
                },
            },
        }
    }

    /// Checks that the settings can be trained with.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        self.model.check()?;
        self.run.check()?;
        self.run
            .check_whole("every pair of a batch is contrasted with every other")?;
        positive("word_width", self.word_width as u64)?;
        positive("frame_stride", self.frame_stride as u64)?;
        positive("min_frames", self.min_frames as u64)?;
        if self.max_frames < self.min_frames {
            return Err(Error::Config {
                field: "max_frames",
                problem: format!(
                    "it is {}, less than min_frames {}",
                    self.max_frames, self.min_frames
                ),
            });
        }
        if !(self.temperature.is_finite() && self.temperature > 0.0) {
            return Err(Error::Config {
                field: "temperature",
                problem: format!("it is {}, and must be positive", self.temperature),
            });
        }
        Ok(())
    }

    fn sizes(&self, vocabulary: &Vocabulary) -> TmrSizes {
        TmrSizes {
            motion_features: self.features.width(),
            num_tokens: vocabulary.num_tokens(),
            word_width: self.word_width,
            network: self.model,
        }
    }
}

/// A motion and its captions.
#[derive(Clone, Copy, Debug)]
pub struct CaptionedMotion<'a> {
    /// Names the motion in errors.
    pub id: &'a str,
    /// The motion.
    pub motion: &'a Motion,
    /// Its captions, at least one.
    pub captions: &'a [String],
}

/// What the encoder learns from.
#[derive(Clone, Copy, Debug)]
pub struct TmrCorpus<'a> {
    /// Training clips.
    pub train: &'a [CaptionedMotion<'a>],
    /// Validation clips.
    pub val: &'a [CaptionedMotion<'a>],
    /// The skeleton the motions drive.
    pub skeleton: &'a Skeleton,
    /// Hash of the table of motions.
    pub dataset_hash: &'a str,
}

/// Record of an encoder's run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TmrRecord {
    /// The resolved settings.
    pub train: TmrConfig,
    /// Mean and spread of the features over the training split.
    pub features: FeatureStats,
    /// Words the encoder knows.
    pub vocabulary: Vocabulary,
}

/// Features and tokenised captions of a clip.
struct Clip {
    motion: Prepared,
    captions: Vec<Vec<i32>>,
}

/// A batch of clips with everything a step draws.
struct ClipBatch {
    features: Vec<f32>,
    lengths: Vec<usize>,
    steps: usize,
    tokens: TokenBatch,
    /// Pairs with equal texts, `[B * B]`.
    same_text: Vec<bool>,
    /// Standard normal noise for the text and the motion latents, `[2, B, d]`.
    noise: Vec<f32>,
}

/// Trains the encoder, or continues where the run folder left off, exactly as
/// [`crate::fit::train_motionrefit`] does. A run that starts from the weights of another keeps its
/// vocabulary and feature statistics.
///
/// # Errors
/// The settings are unusable, a split is empty or a clip without caption, the folder holds another
/// run or a damaged checkpoint, a loss is not finite, or a file cannot be written.
pub fn train_tmr<'a>(
    start: impl Into<Start<'a>>,
    config: &TmrConfig,
    corpus: TmrCorpus<'_>,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    config.check()?;
    let start = start.into();
    let fitted: Option<TmrRecord> = start.fitted(KIND)?;
    let (vocabulary, features) = match fitted {
        Some(fitted) if fitted.features.recipe == config.features => {
            (fitted.vocabulary, Some(fitted.features))
        }
        Some(fitted) => {
            return Err(Error::Config {
                field: "features",
                problem: format!(
                    "it is {}, and the run whose weights are to be taken over sees {}",
                    config.features.name(),
                    fitted.features.recipe.name()
                ),
            });
        }
        None => {
            let captions = corpus
                .train
                .iter()
                .flat_map(|clip| clip.captions.iter().map(String::as_str));
            let WordsConfig {
                num_buckets,
                max_words,
            } = config.text;
            (Vocabulary::build(captions, num_buckets, max_words)?, None)
        }
    };
    let train = clips(
        corpus.train,
        "training split of the encoder",
        &vocabulary,
        config,
    )?;
    let val = clips(
        corpus.val,
        "validation split of the encoder",
        &vocabulary,
        config,
    )?;
    let record = TmrRecord {
        train: config.clone(),
        features: match features {
            Some(features) => features,
            None => fit_features(config.features, &train)?,
        },
        vocabulary,
    };
    let run = Run::open(
        start,
        &RunRecord::new(KIND, corpus.dataset_hash, corpus.skeleton, record.clone()),
    )?;

    let seed = Seed(config.run.seed);
    let device = session.device.clone().autodiff();
    let sizes = config.sizes(&record.vocabulary);
    let model = draw(Tmr::new(&sizes, &device), seed.derive(&["weights"]))?;
    let sampler = ClipSampler {
        clips: &train,
        features: &record.features,
        config,
        seed: seed.derive(&["train"]),
    };
    let val_batches: Vec<ClipBatch> = ClipSampler {
        clips: &val,
        seed: seed.derive(&["val"]),
        ..sampler
    }
    .whole();
    let trainer = TrainerConfig {
        kind: KIND,
        samples: "clips",
        run: config.run,
        epoch_len: train.len() as u64,
    };
    let task = TmrTask {
        config,
        sampler,
        val_batches,
    };
    let (_, report) = trainer::train(&task, model, &trainer, &run, session)?;
    Ok(report)
}

struct TmrTask<'a> {
    config: &'a TmrConfig,
    sampler: ClipSampler<'a>,
    val_batches: Vec<ClipBatch>,
}

impl Task for TmrTask<'_> {
    type Model = Tmr;
    type Batch = ClipBatch;

    fn draw(&self, step: u64) -> Result<Vec<(f64, ClipBatch)>, Error> {
        // The contrastive loss compares all pairs of a batch, so a batch is not split.
        Ok(vec![(1.0, self.sampler.draw(step))])
    }

    fn loss(&self, model: &Tmr, batch: &ClipBatch, device: &Device) -> Tensor<1> {
        batch_loss(model, batch, self.config, device)
    }

    fn validate(&self, model: &Tmr, device: &Device) -> f32 {
        validate(model, &self.val_batches, self.config, device)
    }

    fn save(&self, model: &Tmr, run_dir: &Path) -> Result<Files, Error> {
        Ok([(WEIGHTS.to_owned(), to_safetensors(model, run_dir)?)].into())
    }

    fn load(&self, model: &mut Tmr, files: &mut Files, run_dir: &Path) -> Result<(), Error> {
        load(model, files, run_dir)
    }
}

/// The loss of a batch.
///
/// # Source
/// Petrovich et al. 2023, Eq. 4 (`algorithms` section 15).
fn batch_loss(model: &Tmr, batch: &ClipBatch, config: &TmrConfig, device: &Device) -> Tensor<1> {
    let num_clips = batch.lengths.len();
    let features = Tensor::<3>::from_data(
        TensorData::new(
            batch.features.clone(),
            [num_clips, batch.steps, config.features.width()],
        ),
        device,
    );
    let noise = Tensor::<3>::from_data(
        TensorData::new(batch.noise.clone(), [2, num_clips, config.model.width]),
        device,
    );
    let noise = |side: usize| noise.clone().narrow(0, side, 1).squeeze_dim::<2>(0);

    let text = model.encode_text(&batch.tokens);
    let motion = model
        .motion_encoder
        .forward(features.clone(), &batch.lengths);
    let text_latent = text.sample(noise(0));
    let motion_latent = motion.sample(noise(1));

    // Both latents are decoded in one batch.
    let latents = Tensor::cat(vec![text_latent.clone(), motion_latent.clone()], 0);
    let decoded = model
        .motion_decoder
        .forward(latents, &batch.lengths.repeat(2), batch.steps);
    let reconstruction = Loss::SmoothL1
        .mean(decoded, Tensor::cat(vec![features.clone(), features], 0))
        .mul_scalar(2.0);
    let standard = text.standard();
    let kl = text.kl(&motion) + motion.kl(&text) + motion.kl(&standard) + text.kl(&standard);
    let latent = Loss::SmoothL1.mean(
        text_latent.clone().unsqueeze_dim(0),
        motion_latent.clone().unsqueeze_dim(0),
    );
    let contrastive = info_nce(
        text_latent,
        motion_latent,
        config.temperature,
        &batch.same_text,
    );
    let weights = &config.weights;
    reconstruction.mul_scalar(weights.reconstruction)
        + kl.mul_scalar(weights.kl)
        + latent.mul_scalar(weights.latent)
        + contrastive.mul_scalar(weights.contrastive)
}

fn validate(model: &Tmr, batches: &[ClipBatch], config: &TmrConfig, device: &Device) -> f32 {
    weighted_mean(batches.iter().map(|batch| {
        let loss = batch_loss(model, batch, config, device);
        (batch.lengths.len(), loss)
    }))
}

fn clips(
    motions: &[CaptionedMotion<'_>],
    what: &'static str,
    vocabulary: &Vocabulary,
    config: &TmrConfig,
) -> Result<Vec<Clip>, Error> {
    if motions.is_empty() {
        return Err(Error::Empty { what });
    }
    motions
        .par_iter()
        .map(|clip| {
            if clip.captions.is_empty() {
                return Err(Error::Item {
                    id: clip.id.to_owned(),
                    problem: "has no caption".to_owned(),
                });
            }
            Ok(Clip {
                motion: Prepared::new(clip.motion, config.features, config.frame_stride, clip.id)?,
                captions: clip
                    .captions
                    .iter()
                    .map(|caption| vocabulary.encode(caption))
                    .collect(),
            })
        })
        .collect()
}

fn fit_features(recipe: FeatureRecipe, clips: &[Clip]) -> Result<FeatureStats, Error> {
    let rows: Vec<_> = clips
        .par_iter()
        .map(|clip| clip.motion.features(0..clip.motion.len()))
        .collect();
    let width = recipe.width();
    FeatureStats::fit(
        recipe,
        rows.iter().flat_map(|rows| rows.chunks_exact(width)),
    )
}

/// Samples batches of clips; a batch depends on the seed and the step alone.
#[derive(Clone, Copy)]
struct ClipSampler<'a> {
    clips: &'a [Clip],
    features: &'a FeatureStats,
    config: &'a TmrConfig,
    seed: Seed,
}

impl ClipSampler<'_> {
    /// The batch of a step: the next clips of the epoch's order, a caption and a crop of each. All
    /// crops of a step share one drawn length, so that little of the batch is padding.
    fn draw(&self, step: u64) -> ClipBatch {
        let batch_size = self.config.run.batch_size.min(self.clips.len());
        let num_batches = (self.clips.len() / batch_size) as u64;
        let (epoch, batch) = (step / num_batches, step % num_batches);
        let mut order: Vec<usize> = (0..self.clips.len()).collect();
        order.shuffle(&mut self.seed.rng(&["epoch", &epoch.to_string()]));
        let first = batch as usize * batch_size;

        let mut rng = self.seed.rng(&["step", &step.to_string()]);
        let longest = rng.random_range(self.config.min_frames..=self.config.max_frames);
        let crops: Vec<Crop> = order[first..first + batch_size]
            .iter()
            .map(|&clip| {
                let num_frames = self.clips[clip].motion.len();
                let frames = longest.min(num_frames);
                Crop {
                    clip,
                    caption: rng.random_range(0..self.clips[clip].captions.len()),
                    start: rng.random_range(0..=num_frames - frames),
                    frames,
                }
            })
            .collect();
        let noise = (0..2 * crops.len() * self.config.model.width)
            .map(|_| rng.sample(StandardNormal))
            .collect();
        self.batch(&crops, noise)
    }

    /// The validation batch: all clips from their first frame, with their first caption and the mean
    /// latents.
    fn whole(&self) -> Vec<ClipBatch> {
        let crops: Vec<Crop> = (0..self.clips.len())
            .map(|clip| Crop {
                clip,
                caption: 0,
                start: 0,
                frames: self.clips[clip].motion.len().min(self.config.max_frames),
            })
            .collect();
        crops
            .chunks(self.config.run.batch_size)
            .map(|crops| {
                let noise = vec![0.0; 2 * crops.len() * self.config.model.width];
                self.batch(crops, noise)
            })
            .collect()
    }

    fn batch(&self, crops: &[Crop], noise: Vec<f32>) -> ClipBatch {
        let texts: Vec<&[i32]> = crops
            .iter()
            .map(|crop| self.clips[crop.clip].captions[crop.caption].as_slice())
            .collect();
        let width = texts.iter().map(|text| text.len()).max().unwrap_or(1);
        let mut ids = Vec::with_capacity(texts.len() * width);
        for text in &texts {
            let filled = ids.len() + width;
            ids.extend_from_slice(text);
            ids.resize(filled, crate::vocabulary::PADDING);
        }
        let same_text = (0..texts.len())
            .flat_map(|i| {
                let texts = &texts;
                (0..texts.len()).map(move |j| i != j && texts[i] == texts[j])
            })
            .collect();
        let segments: Vec<(&Prepared, Range<usize>)> = crops
            .iter()
            .map(|crop| {
                let range = crop.start..crop.start + crop.frames;
                (&self.clips[crop.clip].motion, range)
            })
            .collect();
        let (features, lengths, steps) = feature_rows(&segments, self.features);
        ClipBatch {
            features,
            lengths,
            steps,
            tokens: TokenBatch { ids, width },
            same_text,
            noise,
        }
    }
}

#[derive(Clone, Copy)]
struct Crop {
    clip: usize,
    caption: usize,
    start: usize,
    frames: usize,
}

/// Normalised features of segments, padded with zeros to the longest: values `[B, T, F]`, lengths and
/// `T`.
fn feature_rows(
    segments: &[(&Prepared, Range<usize>)],
    stats: &FeatureStats,
) -> (Vec<f32>, Vec<usize>, usize) {
    let lengths: Vec<usize> = segments.iter().map(|(_, range)| range.len()).collect();
    let steps = lengths.iter().copied().max().unwrap_or(0);
    let width = stats.recipe.width();
    let mut values = Vec::with_capacity(segments.len() * steps * width);
    for (row, (clip, range)) in segments.iter().enumerate() {
        stats.push_normalized(&clip.features(range.clone()), &mut values);
        values.resize((row + 1) * steps * width, 0.0);
    }
    (values, lengths, steps)
}

fn load(model: &mut Tmr, files: &mut Files, run_dir: &Path) -> Result<(), Error> {
    let bytes = take(files, WEIGHTS, run_dir)?;
    from_safetensors(model, bytes, "", &run_dir.join(WEIGHTS))
}

/// Record of a motion encoder trained elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionEncoderRecord {
    /// Size of the transformer.
    pub model: NetworkConfig,
    /// Features of a motion, and their normaliser.
    pub features: FeatureStats,
}

/// A trained encoder.
#[derive(Debug)]
pub struct TmrEncoder {
    motion_encoder: SequenceEncoder,
    /// The text encoder, if there is one.
    texts: Option<(Tmr, Vocabulary)>,
    features: FeatureStats,
    frame_stride: usize,
    /// Frames beyond this number are ignored.
    max_frames: usize,
    dataset_hash: String,
    hash: String,
    device: Device,
}

impl TmrEncoder {
    /// Loads an encoder from its run folder.
    ///
    /// # Errors
    /// The folder is not a run of the encoder, or its checkpoint is missing or damaged.
    pub fn load(run_dir: &Path, slot: Slot, device: &Device) -> Result<Self, Error> {
        if read_kind(run_dir)? == MOTION_KIND {
            return Self::load_motion(run_dir, device);
        }
        let record = checkpoint::read_record(run_dir, KIND)?;
        Self::of_files(record, read_for_use(run_dir, slot, KIND)?, run_dir, device)
    }

    /// Loads an encoder from the document `config.json` of its run and the weights of its checkpoint. `name` stands for the
    /// run folder in errors.
    ///
    /// # Errors
    /// The document is not that of an encoder, or the weights do not fit it.
    pub fn from_bytes(
        config: &str,
        weights: &[u8],
        name: &Path,
        device: &Device,
    ) -> Result<Self, Error> {
        let files = [(WEIGHTS.to_owned(), weights.to_owned())].into();
        let record = checkpoint::record_of(config, name, KIND)?;
        Self::of_files(record, files, name, device)
    }

    fn of_files(
        record: RunRecord<TmrRecord>,
        mut files: Files,
        run_dir: &Path,
        device: &Device,
    ) -> Result<Self, Error> {
        let config = &record.config.train;
        config.check()?;
        let weights = files.get(WEIGHTS).map_or(&[][..], Vec::as_slice);
        let hash = weights_hash(&record.config, &[weights]);
        let sizes = config.sizes(&record.config.vocabulary);
        let mut model = Tmr::new(&sizes, device);
        load(&mut model, &mut files, run_dir)?;
        Ok(Self {
            motion_encoder: model.motion_encoder.clone(),
            frame_stride: config.frame_stride,
            max_frames: config.max_frames,
            texts: Some((model, record.config.vocabulary)),
            features: record.config.features,
            dataset_hash: record.dataset_hash,
            hash,
            device: device.clone(),
        })
    }

    fn load_motion(run_dir: &Path, device: &Device) -> Result<Self, Error> {
        let record: RunRecord<MotionEncoderRecord> = checkpoint::read_record(run_dir, MOTION_KIND)?;
        let MotionEncoderRecord { model, features } = record.config.clone();
        model.check()?;
        let mut files = read_for_use(run_dir, Slot::Best, MOTION_KIND)?;
        let bytes = take(&mut files, MOTION_WEIGHTS, run_dir)?;
        let hash = weights_hash(&record.config, &[&bytes]);
        let mut motion_encoder = SequenceEncoder::new(features.recipe.width(), &model, device);
        from_safetensors(
            &mut motion_encoder,
            bytes,
            "",
            &run_dir.join(MOTION_WEIGHTS),
        )?;
        Ok(Self {
            motion_encoder,
            texts: None,
            features,
            frame_stride: 1,
            max_frames: usize::MAX,
            dataset_hash: record.dataset_hash,
            hash,
            device: device.clone(),
        })
    }

    /// What it sees and was trained on, in words.
    pub fn description(&self) -> String {
        format!(
            "{} at {} fps, trained on dataset {:.12}",
            self.recipe().name(),
            self.fps(),
            self.dataset_hash
        )
    }

    /// Features that the encoder sees.
    pub fn recipe(&self) -> FeatureRecipe {
        self.features.recipe
    }

    /// Frames a second the encoder sees.
    pub fn fps(&self) -> f64 {
        self.features.recipe.fps().get() / self.frame_stride as f64
    }

    /// Hash of the motions it was trained on; `imported` where that is not known.
    pub fn dataset_hash(&self) -> &str {
        &self.dataset_hash
    }

    /// What identifies the weights: BLAKE3, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// The mean latent vector of each motion, `[d]`.
    ///
    /// # Errors
    /// A motion cannot be brought to the encoder's rate, or is too short for its features.
    pub fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f32>>, Error> {
        let mut codes = Vec::with_capacity(motions.len());
        for (chunk_index, chunk) in motions.chunks(ENCODE_BATCH).enumerate() {
            let clips: Vec<Prepared> = chunk
                .par_iter()
                .enumerate()
                .map(|(index, motion)| {
                    let id = format!("#{}", chunk_index * ENCODE_BATCH + index);
                    Prepared::new(motion, self.features.recipe, self.frame_stride, &id)
                })
                .collect::<Result<_, Error>>()?;
            let segments: Vec<(&Prepared, Range<usize>)> = clips
                .iter()
                .map(|clip| (clip, 0..clip.len().min(self.max_frames)))
                .collect();
            let (features, lengths, steps) = feature_rows(&segments, &self.features);
            codes.extend(self.encode_features(features, &lengths, steps));
        }
        Ok(codes)
    }

    /// The mean latent vectors of normalised features.
    ///
    /// # Shapes
    /// `features` is `[B, T, F]` with zeros after each row's length; the result `[B][d]`.
    ///
    /// # Panics
    /// If the sizes disagree.
    pub fn encode_features(
        &self,
        features: Vec<f32>,
        lengths: &[usize],
        steps: usize,
    ) -> Vec<Vec<f32>> {
        let shape = [lengths.len(), steps, self.features.recipe.width()];
        let features = Tensor::<3>::from_data(TensorData::new(features, shape), &self.device);
        rows(self.motion_encoder.forward(features, lengths).mu)
    }

    /// The mean latent vector of each text, `[d]`.
    ///
    /// # Errors
    /// The encoder was trained elsewhere, without its text encoder.
    pub fn encode_texts(&self, texts: &[&str]) -> Result<Vec<Vec<f32>>, Error> {
        let Some((model, vocabulary)) = &self.texts else {
            return Err(Error::Encoder {
                problem: "was imported and knows motions alone: the released text side stands on \
                          DistilBERT, which this program has not"
                    .to_owned(),
            });
        };
        Ok(texts
            .chunks(ENCODE_BATCH)
            .flat_map(|chunk| {
                rows(
                    model
                        .encode_text(&vocabulary.encode_batch(chunk.iter().copied()))
                        .mu,
                )
            })
            .collect())
    }
}

fn rows(tensor: Tensor<2>) -> Vec<Vec<f32>> {
    let [_, width] = tensor.dims();
    read(tensor)
        .chunks_exact(width)
        .map(<[f32]>::to_vec)
        .collect()
}
