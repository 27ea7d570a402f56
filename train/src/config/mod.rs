//! Settings of a training run. The resolved settings are saved beside every result.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

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
    /// Frames of a window, the two fixed ones among them.
    pub window: usize,
    /// Keypoints of a frame that the network sees and makes: all 28, or the 22 body joints alone (paper
    /// App. C.6, for MotionFix).
    #[serde(default = "all_keypoints", skip_serializing_if = "is_all_keypoints")]
    pub keypoints: usize,
    /// Windows in a validation.
    pub val_windows: usize,
    /// Settings that every training run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

/// Settings that every training run has, whatever is trained. In files they stand beside the
/// settings of the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSettings {
    /// Optimiser.
    pub optimizer: OptimizerConfig,
    /// Samples in a step.
    pub batch_size: usize,
    /// Samples computed at once. The gradients of a larger step are accumulated over several
    /// micro-batches. `None` computes a step at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub micro_batch_size: Option<usize>,
    /// Length of the run.
    pub length: RunLength,
    /// Steps between two lines of the metrics file.
    #[serde(default = "default_log_every")]
    pub log_every: u64,
    /// Steps between two validations; each is followed by a checkpoint.
    #[serde(default = "default_val_every")]
    pub val_every: u64,
    /// Epochs between two checkpoints that are kept for good; 0 keeps only the best and the last.
    #[serde(default)]
    pub keep_epochs: u64,
    /// Seed of the weights and of everything drawn while training.
    pub seed: u64,
}

/// For records of pose networks of version 0.1, which had no such setting.
fn default_log_every() -> u64 {
    100
}

/// For records of pose networks of version 0.1, which had no such setting.
fn default_val_every() -> u64 {
    200
}

impl RunSettings {
    /// Samples computed at once.
    pub(crate) fn micro_batch(&self) -> usize {
        self.micro_batch_size
            .map_or(self.batch_size, |size| size.min(self.batch_size))
    }

    /// The micro-batches of a step: first sample, counted over the whole run, and number of samples.
    pub(crate) fn micro_batches(&self, step: u64) -> impl Iterator<Item = (u64, usize)> {
        let (size, micro) = (self.batch_size, self.micro_batch());
        (0..size)
            .step_by(micro)
            .map(move |first| (step * size as u64 + first as u64, micro.min(size - first)))
    }

    /// Checks that a run can be made with the settings.
    ///
    /// # Errors
    /// A setting is out of range.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.optimizer.check()?;
        self.length.check()?;
        positive("batch_size", self.batch_size as u64)?;
        positive("micro_batch_size", self.micro_batch() as u64)?;
        positive("log_every", self.log_every)?;
        positive("val_every", self.val_every)
    }

    /// Refuses micro-batches for a model whose loss needs the whole batch.
    pub(crate) fn check_whole(&self, why: &str) -> Result<(), Error> {
        if self.micro_batch() == self.batch_size {
            return Ok(());
        }
        Err(Error::Config {
            field: "micro_batch_size",
            problem: format!("a step of this model cannot be split: {why}; leave it out"),
        })
    }
}

/// Gives settings of version 0.1 their present names: in records on disk and in files of settings.
pub(crate) fn rename_former(settings: &mut Value) {
    let Some(table) = settings.as_object_mut() else {
        return;
    };
    if let Some(size) = table.remove("max_part") {
        table.insert("micro_batch_size".to_owned(), size);
    }
    if let Some(ratio) = table.remove("plain_pairs") {
        table.insert("undonored_ratio".to_owned(), ratio);
    }
    if let Some(steps) = table.remove("num_steps") {
        table.insert(
            "length".to_owned(),
            json!({ "epochs": null, "steps": steps }),
        );
    }
    if let Some(rate) = table.remove("learning_rate") {
        // The pose network's other settings of the optimiser were fixed.
        let optimizer = json!({
            "learning_rate": rate, "decay": "linear", "warmup_steps": 0, "weight_decay": 0.0,
        });
        table.insert("optimizer".to_owned(), optimizer);
    }
    if let Some(optimizer) = table.get_mut("optimizer").and_then(Value::as_object_mut)
        && let Some(decay) = optimizer.remove("average")
    {
        optimizer.insert("ema_decay".to_owned(), decay);
    }
}

/// A preset with the user's own values in place of some of its own. Names of version 0.1 are known.
///
/// # Errors
/// A key is unknown, or a value is of another type.
pub fn overlay<T: Serialize + DeserializeOwned>(
    preset: &T,
    own: &Value,
) -> Result<T, serde_json::Error> {
    fn merge(base: &mut Value, own: Value) {
        match (base, own) {
            (Value::Object(base), Value::Object(own)) => {
                for (key, value) in own {
                    merge(base.entry(key).or_insert(Value::Null), value);
                }
            }
            (base, own) => *base = own,
        }
    }
    let mut own = own.clone();
    rename_former(&mut own);
    let mut settings = serde_json::to_value(preset)?;
    merge(&mut settings, own);
    serde_json::from_value(settings)
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
    /// A network of two layers encodes each into the token of its place (paper, Sec. 5.1; that the
    /// tokens stand in the place of the frames is our reading).
    Encoded,
}

/// How the coordinator guides the editor.
///
/// The coordinator gives the probability that a window was composed of several; guidance descends its
/// gradient. The paper writes the gradient of the opposite probability and ascends it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuidanceConfig {
    /// What is moved.
    pub target: GuidanceTarget,
    /// Factor of the gradient.
    pub strength: f64,
    /// Last diffusion steps that are guided.
    pub num_steps: usize,
}

/// What the coordinator's guidance moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GuidanceTarget {
    /// The estimate of the clean window, by the gradient there (paper Sec. 5.2).
    CleanPrediction,
    /// The mean of the posterior, by the gradient there times the posterior's standard deviation; the
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
    /// Norm that all gradients together are clipped to; `None` does not clip.
    pub max_gradient_norm: Option<f64>,
    /// Decay of the exponential moving average (EMA) of the weights: the share of itself that it keeps
    /// in a step. The averaged weights are validated and used. `None` keeps no average.
    pub ema_decay: Option<f64>,
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
    /// `Paper`: Sec. 5.1 and App. B (6 layers, squared error, batch 1024, 1,500 epochs and at
    /// most 800 k steps, learning rate 1e-4 with linear decay, a checkpoint every 50 epochs, guidance
    /// `w = 3`, which is weight 4 here); what it leaves open is as released. `Official`: the released
    /// configuration (8 layers, smooth L1, batch 256, 4,000 epochs); `algorithms` section 10 lists
    /// where the two differ. `Tiny`: our choice. It uses the rescaled schedule, under which the last
    /// step is almost pure noise, so that sampling starts where training ended. It shows the network the
    /// fixed frames nearly clean, as the editor does: the little noise on them teaches it to correct its
    /// own errors from window to window, and a fifth of the windows has no fixed frames, because the
    /// instruction alone has to begin an edit. It predicts the residual of a linear extrapolation, unclipped:
    /// noise does not fit through so narrow a network, and windows of the residual join smoothly.
    /// Guidance is light, because an amplified change overshoots.
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
                window: WINDOW_FRAMES,
                keypoints: NUM_KEYPOINTS,
                val_windows: 1_024,
                run: RunSettings {
                    optimizer: OptimizerConfig {
                        learning_rate: 1e-4,
                        decay: Decay::Linear,
                        warmup_steps: 0,
                        weight_decay: 0.01,
                        max_gradient_norm: None,
                        ema_decay: None,
                    },
                    batch_size: 1024,
                    micro_batch_size: Some(256),
                    length: RunLength {
                        epochs: Some(1_500),
                        steps: 800_000,
                    },
                    log_every: 20,
                    val_every: 1_000,
                    keep_epochs: 50,
                    seed: 0,
                },
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
                run: RunSettings {
                    batch_size: 256,
                    length: RunLength {
                        epochs: Some(4_000),
                        steps: 800_000,
                    },
                    ..Self::preset(Preset::Paper).run
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
                    prediction: Prediction::Residual,
                    loss: Loss::SmoothL1,
                    fixed_frames: FixedFrames::Clean,
                    previous: PreviousFrames::Inpainted,
                    clip: false,
                    text_dropout: 0.1,
                    motion_weight: 0.0,
                    guidance: 1.25,
                    temperature: 1.0,
                    generated_starts: 0.2,
                    fixed_noise: 0.02,
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
                window: WINDOW_FRAMES,
                keypoints: NUM_KEYPOINTS,
                val_windows: 256,
                run: RunSettings {
                    optimizer: OptimizerConfig {
                        learning_rate: 1e-3,
                        decay: Decay::Linear,
                        warmup_steps: 50,
                        weight_decay: 0.01,
                        max_gradient_norm: None,
                        ema_decay: Some(0.99),
                    },
                    batch_size: 64,
                    micro_batch_size: Some(256),
                    length: RunLength::of_steps(1_000),
                    log_every: 20,
                    val_every: 100,
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
        self.diffusion.check()?;
        self.run.check()?;
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
        share("optimizer.ema_decay", self.ema_decay.unwrap_or(0.0))?;
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
    fn records_of_version_0_1_are_read() {
        let mut old = serde_json::to_value(TrainConfig::preset(Preset::Tiny)).expect("serialises");
        let table = old.as_object_mut().expect("a table");
        let part = table.remove("micro_batch_size").expect("a setting");
        table.insert("max_part".to_owned(), part);
        let optimizer = table["optimizer"].as_object_mut().expect("a table");
        optimizer.remove("ema_decay");
        optimizer.insert("average".to_owned(), json!(0.9));
        assert!(serde_json::from_value::<TrainConfig>(old.clone()).is_err());
        rename_former(&mut old);
        let mut expected = TrainConfig::preset(Preset::Tiny);
        expected.run.optimizer.ema_decay = Some(0.9);
        let read: TrainConfig = serde_json::from_value(old).expect("a present record");
        assert_eq!(read, expected);
    }

    #[test]
    fn a_preset_takes_own_values_under_present_and_former_names() {
        let preset = TrainConfig::preset(Preset::Tiny);
        let own = json!({
            "max_part": 8, "batch_size": 16, "length": { "steps": 7 },
            "optimizer": { "average": 0.5 },
        });
        let mut expected = preset.clone();
        expected.run.micro_batch_size = Some(8);
        expected.run.batch_size = 16;
        expected.run.length.steps = 7;
        expected.run.optimizer.ema_decay = Some(0.5);
        assert_eq!(overlay(&preset, &own).expect("known settings"), expected);
        let problem = overlay(&preset, &json!({ "batchsize": 8 })).expect_err("unknown");
        assert!(problem.to_string().contains("unknown field `batchsize`"));
    }

    #[test]
    fn micro_batches_cover_a_step() {
        let mut run = TrainConfig::preset(Preset::Tiny).run;
        (run.batch_size, run.micro_batch_size) = (10, Some(4));
        let parts: Vec<_> = run.micro_batches(3).collect();
        assert_eq!(parts, [(30, 4), (34, 4), (38, 2)]);
        run.micro_batch_size = None;
        assert_eq!(run.micro_batches(1).collect::<Vec<_>>(), [(10, 10)]);
        run.check_whole("").expect("whole");
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
        config.run.batch_size = 0;
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
            ema_decay: None,
        };
        let rates: Vec<f64> = (0..4).map(|step| optimizer.rate_at(step, 4)).collect();
        assert_eq!(rates, [0.5, 0.75, 0.5, 0.25]);
    }
}
