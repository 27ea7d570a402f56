//! Settings of a training run. The resolved settings are saved with every result.

mod check;
mod diffusion;
mod run;
mod schedule;
mod setting;

use serde::{Deserialize, Serialize};

use crate::Error;
use compose::{ComposeConfig, RangeRule, SlerpRule};
use kinematics::canonical::{Anchor, FIXED_FRAMES, WINDOW_FRAMES};
use kinematics::normalise::FRAME_WIDTH;
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS};

pub(crate) use self::check::{
    above_zero, check_lengths, check_windows, ensure, finite, not_negative, positive, share,
};
pub(crate) use self::diffusion::is_default;
pub use self::diffusion::{
    DiffusionConfig, FixedFrames, Loss, NoiseKind, Prediction, PreviousFrames,
};
pub use self::run::{Decay, OptimizerConfig, RunLength, RunSettings};
pub use self::schedule::ScheduleName;
pub(crate) use self::setting::rename_former;
pub use self::setting::{SettingError, overlay};

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
    /// Guidance by the coordinator, used if the editor is given one.
    pub coordinator: GuidanceConfig,
    /// Number of frames in a window, including the two fixed ones.
    pub window: usize,
    /// Number of keypoints in a frame of the network: all 28, or only the 22 body joints (paper App. C.6, for
    /// MotionFix).
    #[serde(default = "all_keypoints", skip_serializing_if = "is_all_keypoints")]
    pub keypoints: usize,
    /// Number of windows in a validation.
    pub val_windows: usize,
    /// Settings that every training run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

/// Sizes of a transformer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Width of a token.
    pub width: usize,
    /// Number of encoder layers.
    pub num_layers: usize,
    /// Number of attention heads.
    pub num_heads: usize,
    /// Width of the hidden layer of a feed-forward block.
    pub feed_forward: usize,
    /// Probability of dropping an activation while training.
    pub dropout: f64,
}

impl NetworkConfig {
    /// Estimates how many samples of `tokens` tokens a training step can compute at once in `memory` bytes; at least
    /// one. The estimate counts the values that layers keep for the backward pass, and for each weight the weight
    /// itself, its gradient and the two moments of AdamW.
    pub fn samples_in(&self, memory: u64, tokens: usize) -> usize {
        const BYTES: u64 = 4;
        let [width, hidden, layers] =
            [self.width, self.feed_forward, self.num_layers].map(|size| size as u64);
        let weights = layers * (4 * width * width + 2 * width * hidden);
        // Values per token: projections, attention, norms and dropout; the hidden layer with activation and dropout;
        // and for each head a row of attention weights with softmax and dropout.
        let kept = 14 * width + 3 * hidden + 3 * (self.num_heads * tokens) as u64;
        let sample = BYTES * layers * tokens as u64 * kept;
        let left = memory.saturating_sub(4 * BYTES * weights);
        usize::try_from(left / sample.max(1)).map_or(usize::MAX, |samples| samples.max(1))
    }

    pub(crate) fn check(&self) -> Result<(), Error> {
        positive("model.num_layers", self.num_layers as u64)?;
        positive("model.feed_forward", self.feed_forward as u64)?;
        positive("model.num_heads", self.num_heads as u64)?;
        share("model.dropout", self.dropout)?;
        // The positional encoding uses pairs of sine and cosine, so the width must be even.
        let (width, heads) = (self.width, self.num_heads);
        let fits = width > 0 && width.is_multiple_of(2) && width.is_multiple_of(heads);
        let problem = format!("it is {width}, and must be even and a multiple of {heads} heads");
        ensure(fits, "model.width", problem)
    }
}

/// How the coordinator guides the editor.
///
/// The coordinator gives the probability that a window was composed of several motions, and guidance descends its
/// gradient. The paper ascends the gradient of the opposite probability.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuidanceConfig {
    /// Tensor that the guidance moves.
    pub target: GuidanceTarget,
    /// Factor of the gradient.
    pub strength: f64,
    /// Number of last diffusion steps that are guided.
    pub num_steps: usize,
}

/// Tensor that the coordinator's guidance moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GuidanceTarget {
    /// The estimate of the clean window, with the gradient computed there (paper Sec. 5.2).
    CleanPrediction,
    /// The mean of the posterior, with the gradient computed there and multiplied by the posterior's standard
    /// deviation. The last step adds no noise and is not guided (released code). The coordinator was trained with white
    /// noise, but sees shaped noise here if the editor uses it.
    PosteriorMean,
}

/// Text encoder settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextConfig {
    /// The encoder.
    pub encoder: TextEncoder,
    /// Output of the encoder `bert` that a model uses. By default, token states if the model reads tokens, else the
    /// pooled vector.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vectors: Option<BertVectors>,
    /// Vocabulary settings of the learned encoder.
    pub words: WordsConfig,
}

impl TextConfig {
    /// CLIP, with vocabulary settings for runs that replace it by a learned encoder.
    pub(crate) fn clip() -> Self {
        Self {
            encoder: TextEncoder::Clip,
            vectors: None,
            words: WordsConfig {
                num_buckets: 64,
                max_words: 32,
            },
        }
    }

    /// Checks the settings of a model that can read token states as well as one vector for each text.
    pub(crate) fn check(&self) -> Result<(), Error> {
        ensure(
            self.vectors.is_none() || self.encoder == TextEncoder::Bert,
            "text.vectors",
            "it is for text.encoder = \"bert\" alone; leave it out",
        )
    }

    pub(crate) fn check_words(&self) -> Result<(), Error> {
        positive("text.words.num_buckets", self.words.num_buckets as u64)?;
        positive("text.words.max_words", self.words.max_words as u64)
    }

    /// Checks the settings of a model that reads one vector for each text.
    pub(crate) fn check_pooled(&self) -> Result<(), Error> {
        ensure(
            self.vectors != Some(BertVectors::States),
            "text.vectors",
            "it is states, one vector for each token, and this model is given one for each text; set it to \
             pooled, or leave it out",
        )?;
        self.check()
    }
}

/// Output of a frozen text encoder that a model uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BertVectors {
    /// One vector for each text, pooled as the encoder's files specify.
    Pooled,
    /// One vector for each token: the last hidden states.
    States,
}

/// Settings of a vocabulary, which maps the words of texts to token ids.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WordsConfig {
    /// Number of buckets for unknown words.
    pub num_buckets: usize,
    /// Number of words after which a text is truncated.
    pub max_words: usize,
}

/// Text encoders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TextEncoder {
    /// A text encoder that is trained with the denoiser and needs no download.
    Learned,
    /// The text tower of CLIP, frozen: ViT-B/32, or ViT-L/14 for TMED. Its vectors are made before training.
    Clip,
    /// BERT or a related model, frozen, from a folder that the user names. Its vectors are made before training.
    Bert,
    /// Any other frozen encoder, given as a table with one vector for each text, which the user makes.
    Table,
}

datasets_spec::named! {
    /// Named settings.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Preset, named by as_str {
        /// Settings of the paper.
        Paper = "paper",
        /// The released configuration.
        Official = "official",
        /// A small model that trains in a few minutes on two processor cores.
        #[default]
        Tiny = "tiny",
    }
}

impl TrainConfig {
    /// Composition settings of a preset.
    ///
    /// # Source
    /// `Official`: the released preprocessing puts the translation above the origin, its file of ranges appears to hold
    /// one range for all axes, and its slerp averages nearly equal rotations (`algorithms` sections 2, 4 and 10).
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

    /// The settings of a preset.
    ///
    /// # Source
    /// `Paper`: Sec. 5.1 and App. B (6 layers, squared error, batch 1024, 1,500 epochs and at most 800 k steps,
    /// learning rate 1e-4 with linear decay, a checkpoint every 50 epochs, guidance `w = 3`, which is weight 4 here);
    /// what it leaves open is as released. `Official`: the released configuration (8 layers, smooth L1, batch 256,
    /// 4,000 epochs); `algorithms` section 10 lists where the two differ. `Tiny`: our choice. Shaped noise lets a small
    /// network learn to read noisy windows, and the cosine schedule ends in pure noise, where sampling starts. Editing
    /// uses temperature 0.5. At temperature 1, edits are more diverse but farther from their targets. The fixed frames
    /// are shown nearly clean, as the editor shows them; their slight noise teaches the network to correct its own
    /// errors from window to window. Two fifths of the windows have no fixed frames, because the first window of an
    /// edit has none. The instruction is added to every frame. Gates mix the original's bone, a linear extrapolation,
    /// the network's own bone and an estimate from the noisy window, so that the narrow network need not reproduce
    /// unchanged parts. Windows overlap by four frames. The loss on bones weighs an arm as much as the path of the
    /// root, and the loss on contacts penalises feet that slide where they should rest. Guidance by the text is off,
    /// because an amplified change overshoots. Guidance by the coordinator is weak: strong guidance moves edits away
    /// from their targets, which are composed motions too.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Paper => Self::paper(),
            Preset::Official => Self::official(),
            Preset::Tiny => Self::tiny(),
        }
    }

    fn paper() -> Self {
        Self {
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
                noise: NoiseKind::White,
                prediction: Prediction::Noise,
                loss: Loss::Mse,
                fixed_frames: FixedFrames::Clean,
                previous: PreviousFrames::Encoded,
                clip: true,
                text_dropout: 0.1,
                motion_weight: 0.0,
                contact_weight: 0.0,
                bone_weight: 0.0,
                guidance: 4.0,
                temperature: 1.0,
                generated_starts: 0.0,
                fixed_noise: 0.0,
                overlap: 0,
                tell_frames: false,
            },
            text: TextConfig::clip(),
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
                    decay: Decay::Linear,
                    ..OptimizerConfig::of_rate(1e-4)
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
        }
    }

    fn official() -> Self {
        let paper = Self::paper();
        Self {
            model: NetworkConfig {
                num_layers: 8,
                ..paper.model
            },
            diffusion: DiffusionConfig {
                loss: Loss::SmoothL1,
                fixed_frames: FixedFrames::Scaled,
                previous: PreviousFrames::Inpainted,
                guidance: 3.0,
                ..paper.diffusion
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
                ..paper.run
            },
            ..paper
        }
    }

    fn tiny() -> Self {
        Self {
            model: NetworkConfig {
                width: 128,
                num_layers: 3,
                num_heads: 4,
                feed_forward: 256,
                dropout: 0.0,
            },
            diffusion: DiffusionConfig {
                num_steps: 20,
                schedule: ScheduleName::Cosine,
                noise: NoiseKind::Shaped,
                prediction: Prediction::Gated,
                loss: Loss::SmoothL1,
                fixed_frames: FixedFrames::Clean,
                previous: PreviousFrames::Inpainted,
                clip: false,
                text_dropout: 0.1,
                motion_weight: 0.0,
                contact_weight: 0.5,
                bone_weight: 12.0,
                guidance: 1.0,
                temperature: 0.5,
                generated_starts: 0.4,
                fixed_noise: 0.02,
                overlap: 4,
                tell_frames: true,
            },
            text: TextConfig {
                encoder: TextEncoder::Learned,
                vectors: None,
                words: WordsConfig {
                    num_buckets: 16,
                    max_words: 24,
                },
            },
            coordinator: GuidanceConfig {
                target: GuidanceTarget::CleanPrediction,
                strength: 0.3,
                num_steps: 8,
            },
            window: WINDOW_FRAMES,
            keypoints: NUM_KEYPOINTS,
            val_windows: 256,
            run: RunSettings {
                optimizer: OptimizerConfig {
                    decay: Decay::Linear,
                    warmup_steps: 50,
                    ema_decay: Some(0.998),
                    ..OptimizerConfig::of_rate(1e-3)
                },
                batch_size: 64,
                micro_batch_size: Some(256),
                length: RunLength::of_steps(4_800),
                log_every: 20,
                val_every: 100,
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
        self.run.check()?;
        check_keypoints(self.keypoints)?;
        let (window, shared) = (self.window, self.diffusion.overlap);
        let problem = format!(
            "it is {window} frames, of which {FIXED_FRAMES} are fixed; at least one must be free"
        );
        ensure(window > FIXED_FRAMES, "window", problem)?;
        let problem = format!(
            "windows of {window} frames share {shared} and have {FIXED_FRAMES} fixed ones; each must add one"
        );
        ensure(window > FIXED_FRAMES + shared, "diffusion.overlap", problem)?;
        finite("coordinator.strength", self.coordinator.strength)?;
        self.text.check_pooled()?;
        positive("val_windows", self.val_windows as u64)?;
        self.text.check_words()
    }
}

/// Value for models recorded before this setting existed.
pub(crate) fn all_keypoints() -> usize {
    NUM_KEYPOINTS
}

/// The default is left out of records, so that the hashes of older models do not change.
#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
pub(crate) fn is_all_keypoints(keypoints: &usize) -> bool {
    *keypoints == NUM_KEYPOINTS
}

pub(crate) fn check_keypoints(keypoints: usize) -> Result<(), Error> {
    let known = [NUM_BODY_JOINTS, NUM_KEYPOINTS];
    let problem = format!(
        "it is {keypoints}; known are {NUM_KEYPOINTS}, and the {NUM_BODY_JOINTS} body joints"
    );
    ensure(known.contains(&keypoints), "keypoints", problem)
}

/// Keeps the first keypoints of each frame; frames are stored one after another.
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn micro_batches_grow_with_memory() {
        const GB: u64 = 1_000_000_000;
        let model = TrainConfig::preset(Preset::Paper).model;
        // A window of 17 tokens needs 5.8 MB, and the weights 0.3 GB.
        let samples = |memory| model.samples_in(memory, 17);
        assert_eq!(samples(0), 1);
        assert!((250..350).contains(&samples(2 * GB)), "{}", samples(2 * GB));
        assert!(samples(8 * GB) > 1_024);
        assert!(model.samples_in(8 * GB, 300) < samples(8 * GB) / 17);
    }

    #[test]
    fn presets_are_usable_and_survive_json() {
        for preset in Preset::ALL {
            let config = TrainConfig::preset(preset);
            config.check().expect("usable");
            let text = serde_json::to_string(&config).expect("serialises");
            let read: TrainConfig = serde_json::from_str(&text).expect("parses");
            assert_eq!(read, config);
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
        let other = json!({ "batchsize": 8 });
        let wrong = json!({ "batch_size": 8, "model": { "width": 32, "num_heads": "two" } });
        let nested = json!({ "model": { "sizes": {} }, "window": 8 });
        for (own, keys, reason) in [
            (other, &["batchsize"][..], "unknown field `batchsize`"),
            (wrong, &["model", "num_heads"], "invalid type"),
            (nested, &[], "unknown field `sizes`"),
        ] {
            let problem = overlay(&preset, &own).expect_err("unknown");
            assert_eq!(problem.keys, keys);
            assert!(problem.to_string().contains(reason), "{problem}");
        }
    }

    #[test]
    fn micro_batches_cover_a_step() {
        let mut run = TrainConfig::preset(Preset::Tiny).run;
        (run.batch_size, run.micro_batch_size) = (10, Some(4));
        let parts: Vec<_> = run.micro_batches(3, run.micro_batch()).collect();
        assert_eq!(parts, [(30, 4), (34, 4), (38, 2)]);
        run.micro_batch_size = None;
        let parts: Vec<_> = run.micro_batches(1, run.micro_batch()).collect();
        assert_eq!(parts, [(10, 10)]);
        run.check_whole("").expect("whole");
    }

    #[test]
    fn impossible_sizes_are_refused_by_name() {
        let [mut odd, mut empty] = [(); 2].map(|()| TrainConfig::preset(Preset::Tiny));
        odd.model.width = 98;
        empty.run.batch_size = 0;
        for (config, name) in [(odd, "model.width"), (empty, "batch_size")] {
            let refused = config.check();
            assert!(matches!(refused, Err(Error::Config { field, .. }) if field == name));
        }
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
