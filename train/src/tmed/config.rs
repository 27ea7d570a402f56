//! Settings of TMED.

use datasets_spec::Fps;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::config::{
    NetworkConfig, OptimizerConfig, Preset, RunLength, RunSettings, TextConfig, TextEncoder,
    TrainConfig, ensure, finite, positive, share,
};
use crate::gaussian::{Respacing, SampleSteps};

/// Settings of TMED.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TmedConfig {
    /// Sizes of the transformer.
    pub model: NetworkConfig,
    /// Text encoder: the tokens of CLIP ViT-L/14 or of BERT, or learned word vectors.
    pub text: TextConfig,
    /// Training data.
    pub data: ClipData,
    /// Frame rate of the motions.
    pub fps: Fps,
    /// Maximum length of training clips, in frames at that rate; longer clips are truncated.
    pub max_frames: usize,
    /// Splits from whose motions the normalisation of the features is computed.
    pub statistics: StatisticsSplits,
    /// Diffusion and guidance.
    pub diffusion: TmedDiffusion,
    /// Number of clips in a validation.
    pub val_clips: usize,
    /// Settings that every training run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

/// Clips for training TMED.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ClipData {
    /// The captured pairs of the dataset, whose motions may differ in length (released code).
    Pairs,
    /// Whole clips of the composer: MotionCutMix, or, if its settings say `fixed_pairs`, fixed pairs by the rule of
    /// SINC.
    Composed,
}

/// Splits from whose motions the normalisation of the features is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StatisticsSplits {
    /// Only the training split.
    Train,
    /// The training and the validation split (released code).
    TrainAndVal,
}

/// Diffusion and guidance of TMED.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TmedDiffusion {
    /// Number of diffusion steps.
    pub num_steps: usize,
    /// Probability of hiding the instruction in training.
    pub text_dropout: f64,
    /// Probability of hiding the source in training.
    pub source_dropout: f64,
    /// Probability of hiding both instruction and source, in addition to the separate probabilities. The released
    /// settings say 5 %, but the code applies 15 %.
    pub both_dropout: f64,
    /// Guidance weight of the instruction.
    pub guidance: f64,
    /// Guidance weight of the source.
    pub source_guidance: f64,
    /// Position of the target in the position table.
    pub places: TargetPlaces,
    /// Input that replaces the source for guidance without a source.
    pub no_source: NoSource,
    /// Starting point of an edit's sampling.
    pub start: EditStart,
    /// Number of steps of an edit; by default that of training.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edit_steps: Option<usize>,
    /// Selection of steps if an edit uses fewer than training.
    pub respacing: Respacing,
}

/// Position of the target in the position table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TargetPlaces {
    /// After the longest source of the batch, so a target's positions depend on the rest of its batch (released code).
    Padded,
    /// After the target's own source, as while editing.
    Own,
}

/// Input of the network that replaces the source for guidance without a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoSource {
    /// A masked source, as in training.
    Hidden,
    /// Frames of zeros (released code).
    Zeros,
}

/// Starting point of an edit's sampling.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EditStart {
    /// Sampling starts from noise.
    Noise,
    /// Sampling starts from the normalised source without noise, truncated to the length of the edit or padded with
    /// zeros (`init_from=source` of the released code).
    Source,
}

impl TmedConfig {
    /// The settings of a preset.
    ///
    /// # Source
    /// `Official`: the released code, including its defects (`baselines` A1), with the guidance weights of its README.
    /// `Paper`: the same network without these defects, trained on the composer's clips like every system of the
    /// MotionReFit paper: 1,500 epochs in batches of 1,024. `Tiny`: our choice, for a few hundred clips and two
    /// processor cores.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Paper => Self::paper(),
            Preset::Official => Self::official(),
            Preset::Tiny => Self::tiny(),
        }
    }

    fn official() -> Self {
        Self {
            model: NetworkConfig {
                width: 512,
                num_layers: 8,
                num_heads: 4,
                feed_forward: 1024,
                dropout: 0.1,
            },
            text: TextConfig::clip(),
            data: ClipData::Pairs,
            fps: Fps::new(30.0).expect("a rate"),
            max_frames: 300,
            statistics: StatisticsSplits::TrainAndVal,
            diffusion: TmedDiffusion {
                num_steps: 300,
                text_dropout: 0.05,
                source_dropout: 0.05,
                both_dropout: 0.15,
                guidance: 2.0,
                source_guidance: 2.0,
                places: TargetPlaces::Padded,
                no_source: NoSource::Zeros,
                start: EditStart::Noise,
                edit_steps: None,
                respacing: Respacing::Official,
            },
            val_clips: 256,
            run: RunSettings {
                optimizer: OptimizerConfig::of_rate(1e-4),
                batch_size: 128,
                micro_batch_size: Some(32),
                length: RunLength {
                    epochs: Some(1_001),
                    steps: 800_000,
                },
                log_every: 20,
                val_every: 1_000,
                keep_epochs: 50,
                seed: 0,
            },
        }
    }

    fn paper() -> Self {
        let official = Self::official();
        let editor = TrainConfig::preset(Preset::Paper).run;
        Self {
            data: ClipData::Composed,
            statistics: StatisticsSplits::Train,
            diffusion: TmedDiffusion {
                both_dropout: 0.05,
                places: TargetPlaces::Own,
                no_source: NoSource::Hidden,
                respacing: Respacing::Spread,
                ..official.diffusion
            },
            run: RunSettings {
                batch_size: editor.batch_size,
                micro_batch_size: Some(64),
                length: editor.length,
                ..official.run
            },
            ..official
        }
    }

    fn tiny() -> Self {
        let (editor, paper) = (TrainConfig::preset(Preset::Tiny), Self::paper());
        Self {
            model: editor.model,
            text: editor.text,
            fps: Fps::MODEL,
            max_frames: 60,
            diffusion: TmedDiffusion {
                num_steps: 50,
                ..paper.diffusion
            },
            val_clips: 64,
            run: RunSettings {
                batch_size: 32,
                micro_batch_size: None,
                ..editor.run
            },
            ..paper
        }
    }

    /// Checks that the settings allow training.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        self.model.check()?;
        self.run.check()?;
        self.diffusion.check()?;
        self.text.check()?;
        ensure(
            self.text.encoder != TextEncoder::Table,
            "text.encoder",
            "a table holds one vector for each text, and TMED reads tokens; set it to learned, clip or bert",
        )?;
        positive("max_frames", self.max_frames as u64)?;
        positive("val_clips", self.val_clips as u64)?;
        self.text.check_words()
    }

    /// Number of positions in the position table that are reserved for a text.
    pub(crate) fn text_places(&self) -> usize {
        const CLIP_TOKENS: usize = 77;
        const BERT_TOKENS: usize = 512;
        match self.text.encoder {
            TextEncoder::Clip | TextEncoder::Table => CLIP_TOKENS,
            TextEncoder::Bert => BERT_TOKENS,
            TextEncoder::Learned => self.text.words.max_words,
        }
    }
}

impl TmedDiffusion {
    fn check(&self) -> Result<(), Error> {
        share("diffusion.text_dropout", self.text_dropout)?;
        share("diffusion.source_dropout", self.source_dropout)?;
        share("diffusion.both_dropout", self.both_dropout)?;
        finite("diffusion.guidance", self.guidance)?;
        finite("diffusion.source_guidance", self.source_guidance)?;
        self.steps(self.edit_steps).map(|_| ())
    }

    /// The sampling steps of an edit; without `edit_steps`, as many as in training.
    pub(crate) fn steps(&self, edit_steps: Option<usize>) -> Result<SampleSteps, Error> {
        let steps = edit_steps.unwrap_or(self.num_steps);
        SampleSteps::new(self.num_steps, steps, self.respacing)
    }
}
