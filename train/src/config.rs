//! Settings of a training run. The resolved settings are saved beside every result.

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::diffusion::{FixedFrames, Loss, Prediction, ScheduleName};

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
    /// Optimiser.
    pub optimizer: OptimizerConfig,
    /// Windows in a step.
    pub batch_size: usize,
    /// Steps of the whole run.
    pub num_steps: u64,
    /// Steps between two lines of the metrics file.
    pub log_every: u64,
    /// Steps between two validations; each is followed by a checkpoint.
    pub val_every: u64,
    /// Windows in a validation.
    pub val_windows: usize,
    /// Seed of weights, noise and time steps.
    pub seed: u64,
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
    /// Whether the editor clips its estimates of the clean window to [-1, 1]. The range holds the
    /// central 95 % of the data, so that clipping cuts the lowest feet and the longest steps.
    pub clip: bool,
    /// Probability of training a window without its text.
    pub text_dropout: f64,
    /// Guidance weight the editor uses unless told otherwise.
    pub guidance: f64,
}

/// Text encoder trained with the denoiser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextConfig {
    /// Buckets unknown words fall into.
    pub num_buckets: usize,
    /// Words after which an instruction is cut.
    pub max_words: usize,
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
    /// The released configuration.
    Official,
    /// Small enough for two processor cores and two minutes.
    Tiny,
}

impl TrainConfig {
    /// The named settings.
    ///
    /// # Source
    /// `Official`: the released configuration (8 layers, smooth L1, 100 steps of the linear
    /// schedule, batch 256); the paper gives 6 layers, a mean squared error and a linear decay, and
    /// bounds the training at 800 k steps. `Tiny`: our choice. It uses the rescaled schedule, under
    /// which the last step is almost pure noise, so that sampling from pure noise starts where
    /// training ended; it shows the network the fixed frames as the editor will; and it predicts
    /// the change, without clipping, because noise does not fit through so narrow a network. A
    /// change that is amplified overshoots, so that guidance is light.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Official => Self {
                model: NetworkConfig {
                    width: 512,
                    num_layers: 8,
                    num_heads: 16,
                    feed_forward: 2048,
                    dropout: 0.1,
                },
                diffusion: DiffusionConfig {
                    num_steps: 100,
                    schedule: ScheduleName::Official,
                    prediction: Prediction::Noise,
                    loss: Loss::SmoothL1,
                    fixed_frames: FixedFrames::Scaled,
                    clip: true,
                    text_dropout: 0.1,
                    guidance: 3.0,
                },
                text: TextConfig {
                    num_buckets: 64,
                    max_words: 32,
                },
                optimizer: OptimizerConfig {
                    learning_rate: 1e-4,
                    decay: Decay::Linear,
                    warmup_steps: 0,
                    weight_decay: 0.01,
                },
                batch_size: 256,
                num_steps: 800_000,
                log_every: 100,
                val_every: 5_000,
                val_windows: 1_024,
                seed: 0,
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
                    clip: false,
                    text_dropout: 0.1,
                    guidance: 1.25,
                },
                text: TextConfig {
                    num_buckets: 16,
                    max_words: 24,
                },
                optimizer: OptimizerConfig {
                    learning_rate: 1e-3,
                    decay: Decay::Linear,
                    warmup_steps: 50,
                    weight_decay: 0.01,
                },
                batch_size: 64,
                num_steps: 1_000,
                log_every: 20,
                val_every: 100,
                val_windows: 256,
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
        positive("num_steps", self.num_steps)?;
        positive("log_every", self.log_every)?;
        positive("val_every", self.val_every)?;
        positive("val_windows", self.val_windows as u64)?;
        positive("text.num_buckets", self.text.num_buckets as u64)?;
        positive("text.max_words", self.text.max_words as u64)
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
        if !self.guidance.is_finite() {
            return Err(Error::Config {
                field: "diffusion.guidance",
                problem: format!("it is {}", self.guidance),
            });
        }
        crate::diffusion::Schedule::new(self.schedule, self.num_steps).map(|_| ())
    }
}

impl OptimizerConfig {
    pub(crate) fn check(&self) -> Result<(), Error> {
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
        for preset in [Preset::Official, Preset::Tiny] {
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
    fn the_rate_rises_then_falls_to_zero() {
        let optimizer = OptimizerConfig {
            learning_rate: 1.0,
            decay: Decay::Linear,
            warmup_steps: 1,
            weight_decay: 0.0,
        };
        let rates: Vec<f64> = (0..4).map(|step| optimizer.rate_at(step, 4)).collect();
        assert_eq!(rates, [0.5, 0.75, 0.5, 0.25]);
    }
}
