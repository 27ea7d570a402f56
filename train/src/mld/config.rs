//! Settings of MLD.

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::config::{
    NetworkConfig, OptimizerConfig, Preset, RunLength, RunSettings, TextConfig, TrainConfig,
    ensure, finite, not_negative, positive, share,
};
use crate::ddim::Ddim;
use crate::model::mld::MAX_POSITIONS;
use crate::schedule::Schedule;

/// Settings of the autoencoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AutoencoderConfig {
    /// Sizes of the two transformers. Their width is that of a latent vector, and the number of layers is odd.
    pub model: NetworkConfig,
    /// Minimum length of training motions, in frames at 20 fps.
    pub min_frames: usize,
    /// Maximum length of training crops, in frames at 20 fps.
    pub max_frames: usize,
    /// Weight of the loss on joint positions, relative to that on features.
    pub joints_weight: f64,
    /// Weight of the divergence of the latent vectors from the standard normal distribution.
    pub kl_weight: f64,
    /// Settings that every training run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

/// Settings of MLD.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MldConfig {
    /// Settings of the autoencoder, which is trained first.
    pub autoencoder: AutoencoderConfig,
    /// Sizes of the denoiser. Its width is that of a latent vector, and the number of layers is odd.
    pub model: NetworkConfig,
    /// Text encoder.
    pub text: TextConfig,
    /// Number of diffusion steps in training.
    pub diffusion_steps: usize,
    /// Number of sampling steps.
    pub sampling_steps: usize,
    /// Guidance weight of the text.
    pub guidance: f64,
    /// Probability that a training motion is shown with the empty text.
    pub text_dropout: f64,
    /// Settings that every training run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl MldConfig {
    /// The settings of a preset.
    ///
    /// # Source
    /// `Paper` and `Official`: the released configuration for HumanML3D (`algorithms` section 14), its
    /// epochs limited to ten million steps. `Tiny`: our choice for two processor cores and a few minutes.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Paper | Preset::Official => Self::official(),
            Preset::Tiny => Self::tiny(),
        }
    }

    fn official() -> Self {
        let model = NetworkConfig {
            width: 256,
            num_layers: 9,
            num_heads: 4,
            feed_forward: 1024,
            dropout: 0.1,
        };
        let run = |batch_size, epochs| RunSettings {
            optimizer: OptimizerConfig::of_rate(1e-4),
            batch_size,
            micro_batch_size: None,
            length: RunLength {
                epochs: Some(epochs),
                steps: 10_000_000,
            },
            log_every: 100,
            val_every: 5_000,
            keep_epochs: 0,
            seed: 0,
        };
        Self {
            autoencoder: AutoencoderConfig {
                model,
                min_frames: 40,
                max_frames: 196,
                joints_weight: 1.0,
                kl_weight: 1e-4,
                run: run(128, 6_000),
            },
            model,
            text: TextConfig::clip(),
            diffusion_steps: 1_000,
            sampling_steps: 50,
            guidance: 7.5,
            text_dropout: 0.1,
            run: run(64, 2_000),
        }
    }

    fn tiny() -> Self {
        let model = NetworkConfig {
            width: 64,
            num_layers: 3,
            num_heads: 4,
            feed_forward: 128,
            dropout: 0.0,
        };
        let editor = TrainConfig::preset(Preset::Tiny);
        let run = RunSettings {
            batch_size: 16,
            micro_batch_size: None,
            length: RunLength::of_steps(1_500),
            ..editor.run
        };
        let official = Self::official();
        Self {
            autoencoder: AutoencoderConfig {
                model,
                min_frames: 16,
                run,
                ..official.autoencoder
            },
            model,
            text: editor.text,
            // With a learned vocabulary, strong guidance leads away from the training motions.
            guidance: 2.0,
            run,
            ..official
        }
    }

    /// Checks that the settings allow training.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        self.autoencoder.check()?;
        check_layers("model.num_layers", &self.model)?;
        self.run.check()?;
        self.text.check_pooled()?;
        self.text.check_words()?;
        share("text_dropout", self.text_dropout)?;
        finite("guidance", self.guidance)?;
        let schedule = Schedule::scaled_linear(self.diffusion_steps)?;
        Ddim::new(schedule, self.sampling_steps)?;
        let (width, latent) = (self.model.width, self.autoencoder.model.width);
        let problem = format!("it is {width}, and latent vectors have {latent} numbers");
        ensure(width == latent, "model.width", problem)
    }
}

impl AutoencoderConfig {
    /// Checks that the settings allow training.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        check_layers("autoencoder.model.num_layers", &self.model)?;
        self.run.check()?;
        positive("autoencoder.min_frames", self.min_frames as u64)?;
        // Two learned tokens precede the frames.
        let (frames, least, most) = (self.max_frames, self.min_frames, MAX_POSITIONS - 2);
        let problem = format!("it is {frames}, and must be from min_frames {least} to {most}");
        ensure(
            (least..=most).contains(&frames),
            "autoencoder.max_frames",
            problem,
        )?;
        not_negative("autoencoder.joints_weight", self.joints_weight)?;
        not_negative("autoencoder.kl_weight", self.kl_weight)
    }
}

/// Checks that the number of layers is odd, because skip connections pair the layers around a middle one.
fn check_layers(field: &'static str, model: &NetworkConfig) -> Result<(), Error> {
    model.check()?;
    let layers = model.num_layers;
    let problem = format!("it is {layers}, and must be odd");
    ensure(!layers.is_multiple_of(2), field, problem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_usable_and_an_even_number_of_layers_is_not() {
        for preset in Preset::ALL {
            MldConfig::preset(preset).check().expect("usable");
        }
        let mut config = MldConfig::preset(Preset::Tiny);
        config.model.num_layers = 4;
        let refused = config.check();
        assert!(matches!(refused, Err(Error::Config { field, .. }) if field == "model.num_layers"));
    }
}
