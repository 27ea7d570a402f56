//! Settings of the evaluation encoder.

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::config::{
    Decay, NetworkConfig, OptimizerConfig, Preset, RunLength, RunSettings, WordsConfig, above_zero,
    check_lengths, positive,
};
use crate::features::FeatureRecipe;
use crate::model::tmr::Tmr;
use crate::vocabulary::Vocabulary;

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
    /// Settings of the vocabulary.
    pub text: WordsConfig,
    /// The encoder uses every `frame_stride`-th frame of the features.
    pub frame_stride: usize,
    /// Minimum length of a training crop, in frames of the encoder.
    pub min_frames: usize,
    /// Maximum length of a training crop, in frames of the encoder. Later frames of a motion to encode are ignored.
    pub max_frames: usize,
    /// Weights of the terms of the loss.
    pub weights: LossWeights,
    /// Temperature of the contrastive loss.
    pub temperature: f64,
    /// Settings that every training run has. The contrastive loss compares all pairs of a batch, so a
    /// batch is not split into micro-batches.
    #[serde(flatten)]
    pub run: RunSettings,
}

/// Weights of the terms of the encoder's loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LossWeights {
    /// Reconstruction loss of the motions decoded from both latent vectors.
    pub reconstruction: f64,
    /// KL divergences between the two distributions, and of each from the standard normal distribution.
    pub kl: f64,
    /// Distance between the two latent vectors.
    pub latent: f64,
    /// Contrastive loss over all pairs of a batch.
    pub contrastive: f64,
}

impl TmrConfig {
    /// The settings of a preset.
    ///
    /// # Source
    /// `Official`: Petrovich et al. 2023 (`algorithms` section 15), with its 500 epochs of HumanML3D at batch size 32
    /// converted to steps. `Tiny`: our choice, for a few hundred clips and a minute on two processor cores. It uses
    /// every second frame, a smaller network and a larger weight of the contrastive loss, because training is too short
    /// for the reconstruction loss to shape the latent space.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Paper | Preset::Official => Self::official(),
            Preset::Tiny => Self::tiny(),
        }
    }

    fn official() -> Self {
        Self {
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
                optimizer: OptimizerConfig::of_rate(1e-4),
                batch_size: 32,
                micro_batch_size: None,
                length: RunLength::of_steps(365_000),
                log_every: 100,
                val_every: 5_000,
                keep_epochs: 0,
                seed: 0,
            },
        }
    }

    fn tiny() -> Self {
        let official = Self::official();
        Self {
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
                contrastive: 1.0,
                ..official.weights
            },
            temperature: official.temperature,
            run: RunSettings {
                optimizer: OptimizerConfig {
                    decay: Decay::Linear,
                    warmup_steps: 20,
                    ..OptimizerConfig::of_rate(1e-3)
                },
                length: RunLength::of_steps(300),
                log_every: 10,
                val_every: 50,
                ..official.run
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
        self.run
            .check_whole("every pair of a batch is contrasted with every other")?;
        positive("word_width", self.word_width as u64)?;
        positive("frame_stride", self.frame_stride as u64)?;
        check_lengths(self.min_frames, self.max_frames)?;
        above_zero("temperature", self.temperature)
    }

    pub(super) fn network(&self, vocabulary: &Vocabulary, device: &Device) -> Tmr {
        let words = [vocabulary.num_tokens(), self.word_width];
        Tmr::new(&self.model, self.features.width(), words, device)
    }
}
