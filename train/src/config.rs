//! Settings of a training run. The resolved settings are saved beside every result.

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::diffusion::{FixedFrames, Loss, Prediction, ScheduleName};
use kinematics::canonical::{Anchor, FIXED_FRAMES, WINDOW_FRAMES};
use kinematics::normalise::FRAME_WIDTH;
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS};
use pipeline::compose::{ComposeConfig, RangeRule, SlerpRule};

/// Settings of the editor's training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Sizes of the denoiser.
    pub model: NetworkConfig,
    /// Noise schedule, loss and guidance.
    pub diffusion: DiffusionConfig,
    /// Text encoder trained with the denoiser.
    pub text: TextConfig,
    /// Guidance by the coordinator, where one is given while editing.
    pub coordinator: GuidanceConfig,
    /// Optimiser.
    pub optimizer: OptimizerConfig,
    /// Frames of a window, the two fixed ones among them.
    pub window: usize,
    /// Keypoints of a frame that the network sees and makes: all 28, or the 22 body joints alone (paper
    /// App. C.6, for MotionFix).
    #[serde(default = "all_keypoints", skip_serializing_if = "is_all_keypoints")]
    pub keypoints: usize,
    /// Windows in a step.
    pub batch_size: usize,
    /// Windows computed at once. A step of more is computed in parts, whose gradients are added.
    pub max_part: usize,
    /// How long the run is.
    pub length: RunLength,
    /// Steps between two lines of the metrics file.
    pub log_every: u64,
    /// Steps between two validations; each is followed by a checkpoint.
    pub val_every: u64,
    /// Windows in a validation.
    pub val_windows: usize,
    /// Epochs between two checkpoints that are kept for good; 0 keeps the best and the last alone.
    pub keep_epochs: u64,
    /// Seed of weights, noise and time steps.
    pub seed: u64,
}

/// How long a run is: so many epochs, but not more than so many steps.
///
/// An epoch visits every window of every annotated motion and of every pair once.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunLength {
    /// Epochs, if they are counted.
    pub epochs: Option<u64>,
    /// Steps at most.
    pub steps: u64,
}

impl RunLength {
    /// A run of so many steps.
    pub fn of_steps(steps: u64) -> Self {
        Self {
            epochs: None,
            steps,
        }
    }

    /// Steps of the run, given those of an epoch.
    pub fn num_steps(&self, steps_per_epoch: u64) -> u64 {
        match self.epochs {
            Some(epochs) => self.steps.min(epochs.saturating_mul(steps_per_epoch)),
            None => self.steps,
        }
    }
}

/// Sizes of a transformer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Width of a token.
    pub width: usize,
    /// Encoder layers.
    pub num_layers: usize,
    /// Attention heads.
    pub num_heads: usize,
    /// Width of the hidden layer of a feed-forward block.
    pub feed_forward: usize,
    /// Probability of dropping an activation while training.
    pub dropout: f64,
}

/// Noise schedule, loss and guidance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiffusionConfig {
    /// Diffusion steps.
    pub num_steps: usize,
    /// Noise schedule.
    pub schedule: ScheduleName,
    /// What the network predicts.
    pub prediction: Prediction,
    /// Loss on the prediction.
    pub loss: Loss,
    /// What the network sees in place of the fixed frames while training.
    pub fixed_frames: FixedFrames,
    /// How the fixed frames enter the network.
    pub previous: PreviousFrames,
    /// Whether the editor clips its estimates of the clean window to [-1, 1]. The range holds the
    /// central 95 % of the data, so that clipping cuts the lowest feet and the longest steps.
    pub clip: bool,
    /// Probability of training a window without its text.
    pub text_dropout: f64,
    /// Weight of the loss on differences from frame to frame beside the loss on the frames, where the
    /// clean window or the change is predicted: it keeps what is generated from trembling (as in
    /// Tevet et al. 2023, Eq. 5; neither publication has it).
    pub motion_weight: f64,
    /// Guidance weight the editor uses unless told otherwise.
    pub guidance: f64,
    /// Factor of the noise the editor draws, unless told otherwise: 1 samples what was learned, less
    /// stays nearer to its mean.
    pub temperature: f64,
    /// Share of the training windows that are shown as the first of their motion, with nothing fixed.
    /// At 0 the editor starts a motion on the first frames of the original, as published, although
    /// training always fixes those of the edited motion; above 0 it generates them.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub generated_starts: f64,
    /// Standard deviation in model units of noise on the clean fixed frames shown while training. While
    /// editing they are the network's own, and what they are wrong by is carried from window to window
    /// unless the network has learned to mend it.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub fixed_noise: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// How the frames before a window, which are its fixed first frames, enter the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PreviousFrames {
    /// They are frames of the noisy window like any other (released code).
    Inpainted,
    /// A network of two layers encodes each into the token of its place (paper Sec. 4.1; that the
    /// tokens stand in the place of the frames is our reading).
    Encoded,
}

/// How the coordinator guides the editor.
///
/// The coordinator gives the probability that a window was composed of several; guidance goes down
/// its slope. The paper writes the slope of the opposite probability and goes up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuidanceConfig {
    /// What is moved.
    pub target: GuidanceTarget,
    /// How far, as a factor of the slope.
    pub strength: f64,
    /// Last diffusion steps that are guided.
    pub num_steps: usize,
}

/// What the coordinator's guidance moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GuidanceTarget {
    /// The estimate of the clean window, by the slope there (paper Sec. 4.4).
    CleanPrediction,
    /// The mean of the posterior, by the slope there times the posterior's standard deviation; the
    /// last step, which adds no noise, is left alone (released code).
    PosteriorMean,
}

/// What turns instructions into vectors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextConfig {
    /// The encoder.
    pub encoder: TextEncoder,
    /// Words of the learned encoder.
    pub words: WordsConfig,
}

/// How texts become words with numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WordsConfig {
    /// Buckets unknown words fall into.
    pub num_buckets: usize,
    /// Words after which a text is cut.
    pub max_words: usize,
}

/// Text encoders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TextEncoder {
    /// One that is trained with the denoiser and needs no download.
    Learned,
    /// The text tower of CLIP ViT-B/32, frozen; its vectors are made before training.
    Clip,
}

/// AdamW and its learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Highest learning rate.
    pub learning_rate: f64,
    /// How the rate falls.
    pub decay: Decay,
    /// Steps over which the rate rises from zero.
    pub warmup_steps: u64,
    /// Decoupled weight decay.
    pub weight_decay: f64,
    /// Length that all gradients together are cut to, if they are.
    pub max_gradient_norm: Option<f64>,
    /// Share of itself that a running average of the weights keeps in a step. The averaged weights
    /// are validated and used. None keeps no average.
    pub average: Option<f64>,
}

/// How the learning rate falls over a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Decay {
    /// It stays.
    Constant,
    /// It falls linearly to zero at the last step.
    Linear,
}

/// Named settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// What the paper says.
    Paper,
    /// The released configuration.
    Official,
    /// Small enough for two processor cores and two minutes.
    Tiny,
}

impl TrainConfig {
    /// How windows are composed for models of these named settings.
    ///
    /// # Source
    /// `Official`: the released preprocessing puts the translation above the origin, its file of
    /// ranges looks like one for all axes, and its slerp averages nearly equal rotations
    /// (`algorithms` sections 2, 4 and 10).
    pub fn compose_preset(preset: Preset) -> ComposeConfig {
        let paper = ComposeConfig::default();
        match preset {
            Preset::Official => ComposeConfig {
                anchor: Anchor::Translation,
                range: RangeRule::Scalar,
                slerp: SlerpRule::Official,
                ..paper
            },
            Preset::Paper | Preset::Tiny => paper,
        }
    }

    /// The named settings.
    ///
    /// # Source
    /// `Paper`: Sec. 4.1, 5.1 and App. B (6 layers, squared error, batch 1024, 1,500 epochs and at
    /// most 800 k steps, learning rate 1e-4 with linear decay, a checkpoint every 50 epochs, guidance
    /// `w = 3`, which is weight 4 here); what it leaves open is as released. `Official`: the released
    /// configuration (8 layers, smooth L1, batch 256, 4,000 epochs); `algorithms` section 10 lists
    /// where the two differ. `Tiny`: our choice. It uses the rescaled schedule, under which the last
    /// step is almost pure noise, so that sampling from pure noise starts where training ended; it
    /// shows the network the fixed frames as the editor will; and it predicts the change, without
    /// clipping, because noise does not fit through so narrow a network. A change that is amplified
    /// overshoots, so that guidance is light.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Paper => Self {
                model: NetworkConfig {
                    width: 512,
                    num_layers: 6,
                    num_heads: 16,
                    feed_forward: 2048,
                    dropout: 0.1,
                },
                diffusion: DiffusionConfig {
                    num_steps: 100,
                    schedule: ScheduleName::Official,
                    prediction: Prediction::Noise,
                    loss: Loss::Mse,
                    fixed_frames: FixedFrames::Clean,
                    previous: PreviousFrames::Encoded,
                    clip: true,
                    text_dropout: 0.1,
                    motion_weight: 0.0,
                    guidance: 4.0,
                    temperature: 1.0,
                    generated_starts: 0.0,
                    fixed_noise: 0.0,
                },
                text: TextConfig {
                    encoder: TextEncoder::Clip,
                    words: WordsConfig {
                        num_buckets: 64,
                        max_words: 32,
                    },
                },
                coordinator: GuidanceConfig {
                    target: GuidanceTarget::CleanPrediction,
                    strength: 1.0,
                    num_steps: 20,
                },
                optimizer: OptimizerConfig {
                    learning_rate: 1e-4,
                    decay: Decay::Linear,
                    warmup_steps: 0,
                    weight_decay: 0.01,
                    max_gradient_norm: None,
                    average: None,
                },
                window: WINDOW_FRAMES,
                keypoints: NUM_KEYPOINTS,
                batch_size: 1024,
                max_part: 256,
                length: RunLength {
                    epochs: Some(1_500),
                    steps: 800_000,
                },
                log_every: 20,
                val_every: 1_000,
                val_windows: 1_024,
                keep_epochs: 50,
                seed: 0,
            },
            Preset::Official => Self {
                model: NetworkConfig {
                    num_layers: 8,
                    ..Self::preset(Preset::Paper).model
                },
                diffusion: DiffusionConfig {
                    loss: Loss::SmoothL1,
                    fixed_frames: FixedFrames::Scaled,
                    previous: PreviousFrames::Inpainted,
                    guidance: 3.0,
                    ..Self::preset(Preset::Paper).diffusion
                },
                coordinator: GuidanceConfig {
                    target: GuidanceTarget::PosteriorMean,
                    strength: 1.0,
                    num_steps: 5,
                },
                batch_size: 256,
                length: RunLength {
                    epochs: Some(4_000),
                    steps: 800_000,
                },
                ..Self::preset(Preset::Paper)
            },
            Preset::Tiny => Self {
                model: NetworkConfig {
                    width: 128,
                    num_layers: 3,
                    num_heads: 4,
                    feed_forward: 256,
                    dropout: 0.0,
                },
                diffusion: DiffusionConfig {
                    num_steps: 50,
                    schedule: ScheduleName::Rescaled,
                    prediction: Prediction::Change,
                    loss: Loss::SmoothL1,
                    fixed_frames: FixedFrames::Clean,
                    previous: PreviousFrames::Inpainted,
                    clip: false,
                    text_dropout: 0.1,
                    motion_weight: 0.0,
                    guidance: 1.25,
                    temperature: 1.0,
                    generated_starts: 0.0,
                    fixed_noise: 0.0,
                },
                text: TextConfig {
                    encoder: TextEncoder::Learned,
                    words: WordsConfig {
                        num_buckets: 16,
                        max_words: 24,
                    },
                },
                coordinator: GuidanceConfig {
                    target: GuidanceTarget::CleanPrediction,
                    strength: 1.0,
                    num_steps: 10,
                },
                optimizer: OptimizerConfig {
                    learning_rate: 1e-3,
                    decay: Decay::Linear,
                    warmup_steps: 50,
                    weight_decay: 0.01,
                    max_gradient_norm: None,
                    average: None,
                },
                window: WINDOW_FRAMES,
                keypoints: NUM_KEYPOINTS,
                batch_size: 64,
                max_part: 256,
                length: RunLength::of_steps(1_000),
                log_every: 20,
                val_every: 100,
                val_windows: 256,
                keep_epochs: 0,
                seed: 0,
            },
        }
    }

    /// Checks that the settings can be trained with.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        self.model.check()?;
        self.diffusion.check()?;
        self.optimizer.check()?;
        positive("batch_size", self.batch_size as u64)?;
        positive("max_part", self.max_part as u64)?;
        self.length.check()?;
        check_keypoints(self.keypoints)?;
        if self.window <= FIXED_FRAMES {
            return Err(Error::Config {
                field: "window",
                problem: format!(
                    "it is {} frames, of which {FIXED_FRAMES} are fixed; at least one must be free",
                    self.window
                ),
            });
        }
        if !self.coordinator.strength.is_finite() {
            return Err(Error::Config {
                field: "coordinator.strength",
                problem: format!("it is {}", self.coordinator.strength),
            });
        }
        positive("log_every", self.log_every)?;
        positive("val_every", self.val_every)?;
        positive("val_windows", self.val_windows as u64)?;
        positive("text.words.num_buckets", self.text.words.num_buckets as u64)?;
        positive("text.words.max_words", self.text.words.max_words as u64)
    }
}

/// The setting of models recorded before there was a choice.
pub(crate) fn all_keypoints() -> usize {
    NUM_KEYPOINTS
}

/// Left out of records, so that what identifies older models stays as it is.
#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
pub(crate) fn is_all_keypoints(keypoints: &usize) -> bool {
    *keypoints == NUM_KEYPOINTS
}

pub(crate) fn check_keypoints(keypoints: usize) -> Result<(), Error> {
    if [NUM_BODY_JOINTS, NUM_KEYPOINTS].contains(&keypoints) {
        return Ok(());
    }
    Err(Error::Config {
        field: "keypoints",
        problem: format!(
            "it is {keypoints}; known are {NUM_KEYPOINTS}, and the {NUM_BODY_JOINTS} body joints"
        ),
    })
}

/// The first keypoints of frames, which are laid out one after another.
///
/// # Shapes
/// `[.., 84]` in; `[.., 3 keypoints]` out.
pub(crate) fn narrowed(frames: Vec<f32>, keypoints: usize) -> Vec<f32> {
    if keypoints == NUM_KEYPOINTS {
        return frames;
    }
    frames
        .chunks_exact(FRAME_WIDTH)
        .flat_map(|frame| &frame[..3 * keypoints])
        .copied()
        .collect()
}

impl RunLength {
    pub(crate) fn check(&self) -> Result<(), Error> {
        positive("length.steps", self.steps)?;
        positive("length.epochs", self.epochs.unwrap_or(1))
    }
}

impl NetworkConfig {
    pub(crate) fn check(&self) -> Result<(), Error> {
        positive("model.num_layers", self.num_layers as u64)?;
        positive("model.feed_forward", self.feed_forward as u64)?;
        positive("model.num_heads", self.num_heads as u64)?;
        share("model.dropout", self.dropout)?;
        // Sine and cosine share a token in pairs.
        if self.width == 0
            || !self.width.is_multiple_of(2)
            || !self.width.is_multiple_of(self.num_heads)
        {
            return Err(Error::Config {
                field: "model.width",
                problem: format!(
                    "it is {}, and must be even and a multiple of {} heads",
                    self.width, self.num_heads
                ),
            });
        }
        Ok(())
    }
}

impl DiffusionConfig {
    fn check(&self) -> Result<(), Error> {
        share("diffusion.text_dropout", self.text_dropout)?;
        share("diffusion.generated_starts", self.generated_starts)?;
        if !self.guidance.is_finite() {
            return Err(Error::Config {
                field: "diffusion.guidance",
                problem: format!("it is {}", self.guidance),
            });
        }
        for (field, value) in [
            ("diffusion.motion_weight", self.motion_weight),
            ("diffusion.temperature", self.temperature),
            ("diffusion.fixed_noise", self.fixed_noise),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::Config {
                    field,
                    problem: format!("it is {value}, and must be finite and not negative"),
                });
            }
        }
        if self.motion_weight > 0.0
            && !matches!(self.prediction, Prediction::Clean | Prediction::Change)
        {
            return Err(Error::Config {
                field: "diffusion.motion_weight",
                problem: "frames follow each other in a clean window or a change, not in noise"
                    .to_owned(),
            });
        }
        let needs_clean = self.prediction == Prediction::Residual || self.fixed_noise > 0.0;
        if needs_clean && self.fixed_frames != FixedFrames::Clean {
            return Err(Error::Config {
                field: "diffusion.fixed_frames",
                problem: "a residual and noise on the fixed frames need them clean".to_owned(),
            });
        }
        crate::diffusion::Schedule::new(self.schedule, self.num_steps).map(|_| ())
    }
}

impl OptimizerConfig {
    pub(crate) fn check(&self) -> Result<(), Error> {
        if let Some(longest) = self.max_gradient_norm
            && !(longest.is_finite() && longest > 0.0)
        {
            return Err(Error::Config {
                field: "optimizer.max_gradient_norm",
                problem: format!("it is {longest}, and must be positive"),
            });
        }
        share("optimizer.average", self.average.unwrap_or(0.0))?;
        for (field, value) in [
            ("optimizer.learning_rate", self.learning_rate),
            ("optimizer.weight_decay", self.weight_decay),
        ] {
            if !value.is_finite() || value < 0.0 {
                return Err(Error::Config {
                    field,
                    problem: format!("it is {value}, and must be finite and not negative"),
                });
            }
        }
        Ok(())
    }

    /// The learning rate of a step, counted from 0, of a run of `num_steps`.
    pub fn rate_at(&self, step: u64, num_steps: u64) -> f64 {
        let warmup = ((step + 1) as f64 / (self.warmup_steps + 1) as f64).min(1.0);
        let decay = match self.decay {
            Decay::Constant => 1.0,
            Decay::Linear => 1.0 - step as f64 / num_steps as f64,
        };
        self.learning_rate * warmup * decay
    }
}

pub(crate) fn positive(field: &'static str, value: u64) -> Result<(), Error> {
    if value == 0 {
        return Err(Error::Config {
            field,
            problem: "it must be at least 1".to_owned(),
        });
    }
    Ok(())
}

fn share(field: &'static str, value: f64) -> Result<(), Error> {
    if !(0.0..1.0).contains(&value) {
        return Err(Error::Config {
            field,
            problem: format!("it is {value}, and must lie in [0, 1)"),
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_usable_and_survive_json() {
        for preset in [Preset::Paper, Preset::Official, Preset::Tiny] {
            let config = TrainConfig::preset(preset);
            config.check().expect("usable");
            let text = serde_json::to_string(&config).expect("serialises");
            assert_eq!(
                serde_json::from_str::<TrainConfig>(&text).expect("parses"),
                config
            );
        }
    }

    #[test]
    fn records_without_a_number_of_keypoints_are_of_28() {
        let config = TrainConfig::preset(Preset::Tiny);
        let text = serde_json::to_string(&config).expect("serialises");
        assert!(!text.contains("keypoints"));
        let read: TrainConfig = serde_json::from_str(&text).expect("parses");
        assert_eq!(read.keypoints, 28);
        for (keypoints, fits) in [(22, true), (28, true), (24, false)] {
            let config = TrainConfig {
                keypoints,
                ..config.clone()
            };
            assert_eq!(config.check().is_ok(), fits, "{keypoints}");
        }
        let frames: Vec<f32> = (0..2 * FRAME_WIDTH).map(|value| value as f32).collect();
        let narrow = narrowed(frames, 22);
        assert_eq!((narrow.len(), narrow[65], narrow[66]), (132, 65.0, 84.0));
    }

    #[test]
    fn unknown_settings_are_refused() {
        let mut value =
            serde_json::to_value(TrainConfig::preset(Preset::Tiny)).expect("serialises");
        value["diffusion"]["sampler"] = "ddim".into();
        assert!(serde_json::from_value::<TrainConfig>(value).is_err());
    }

    #[test]
    fn impossible_sizes_are_refused_by_name() {
        let mut config = TrainConfig::preset(Preset::Tiny);
        config.model.width = 98;
        assert!(matches!(
            config.check(),
            Err(Error::Config {
                field: "model.width",
                ..
            })
        ));
        let mut config = TrainConfig::preset(Preset::Tiny);
        config.batch_size = 0;
        assert!(matches!(
            config.check(),
            Err(Error::Config {
                field: "batch_size",
                ..
            })
        ));
    }

    #[test]
    fn epochs_count_unless_there_are_too_many_steps_in_them() {
        let length = |epochs| RunLength { epochs, steps: 100 };
        assert_eq!(length(None).num_steps(7), 100);
        assert_eq!(length(Some(3)).num_steps(7), 21);
        assert_eq!(length(Some(u64::MAX)).num_steps(7), 100);
    }

    #[test]
    fn the_rate_rises_then_falls_to_zero() {
        let optimizer = OptimizerConfig {
            learning_rate: 1.0,
            decay: Decay::Linear,
            warmup_steps: 1,
            weight_decay: 0.0,
            max_gradient_norm: None,
            average: None,
        };
        let rates: Vec<f64> = (0..4).map(|step| optimizer.rate_at(step, 4)).collect();
        assert_eq!(rates, [0.5, 0.75, 0.5, 0.25]);
    }
}
