//! Settings of the diffusion: schedule, prediction, loss, fixed frames.

use serde::{Deserialize, Serialize};

use super::check::{ensure, finite, not_negative, share};
use super::schedule::ScheduleName;
use crate::Error;
use crate::schedule::Schedule;

/// Loss on the prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Loss {
    /// Smooth L1 with a threshold of 1 (released code).
    SmoothL1,
    /// Squared error (paper, Eq. 2).
    Mse,
}

/// How the network sees the fixed frames in training. The editor always shows them clean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FixedFrames {
    /// Scaled like the signal of a noisy frame, without noise (released code).
    Scaled,
    /// Clean, as while editing.
    Clean,
}

/// Target of the network.
///
/// # Source
/// The paper leaves it open: Eq. 2 suggests the noise, Eq. 4 the clean window. The released code predicts the noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Prediction {
    /// The noise. A frame has 84 unpredictable numbers, all of which must pass through the network.
    Noise,
    /// The clean window.
    Clean,
    /// The clean window minus the original one, both in canonical coordinates. If an edit leaves most of the body
    /// unchanged, the difference is mostly zero. A narrow network learns it far sooner (our addition).
    Change,
    /// Bones, as vectors from joint to joint. Each is a gated sum of the original's bone, the change extrapolated from
    /// the fixed frames, a bone predicted by the network and, with shaped noise, an estimate from the noisy window.
    /// Gates are between 0 and 1. So a narrow network copies or replaces bones by predicting gates, without reproducing
    /// the numbers of the original (our addition). Errors are divided by the standard deviation of the residual of the
    /// [extrapolation](crate::extrapolation::Extrapolation) in each frame. The frames after the fixed ones are almost
    /// determined by them, and this scaling gives them the same weight as others, so that windows join smoothly (the
    /// scaling is that of Karras et al. 2022, Sec. 5, per frame instead of per noise level).
    Gated,
}

impl Prediction {
    /// Whether the target is relative to an [extrapolation](crate::extrapolation::Extrapolation) of the change.
    pub fn is_extrapolated(self) -> bool {
        self == Self::Gated
    }
}

/// Noise added to windows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoiseKind {
    /// White noise with mean zero, as published.
    #[default]
    White,
    /// Noise centred on the extrapolated change, with the covariance of its residual
    /// ([`NoiseShape`](crate::noise_shape::NoiseShape)).
    Shaped,
}

/// Noise schedule, loss and guidance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiffusionConfig {
    /// Number of diffusion steps.
    pub num_steps: usize,
    /// Noise schedule.
    pub schedule: ScheduleName,
    /// Noise added to windows.
    #[serde(default, skip_serializing_if = "is_default")]
    pub noise: NoiseKind,
    /// Target of the network.
    pub prediction: Prediction,
    /// Loss on the prediction.
    pub loss: Loss,
    /// How the network sees the fixed frames in training.
    pub fixed_frames: FixedFrames,
    /// How the fixed frames enter the network.
    pub previous: PreviousFrames,
    /// Whether the editor clips its estimates of the clean window to [-1, 1]. This range holds the central 95 % of the
    /// data, so clipping cuts off the lowest feet and the longest steps.
    pub clip: bool,
    /// Probability that a training window is shown without its text.
    pub text_dropout: f64,
    /// Weight of the loss on frame differences, added to the loss on frames if the clean window or the change is
    /// predicted. It reduces jitter (as in Tevet et al. 2023, Eq. 5; neither publication has it).
    pub motion_weight: f64,
    /// Weight of the loss on sliding feet, added to the loss on the prediction: the speed of each foot, in units of 0.1
    /// m/s, in frames in which that foot of the edited motion moves slower than 0.1 m/s (after Tevet et al. 2023, Eq.
    /// 4; neither publication has it).
    #[serde(default, skip_serializing_if = "is_default")]
    pub contact_weight: f64,
    /// Weight of the loss on bones, as vectors from joint to joint in units of 10 cm, added to the loss on the
    /// prediction. Without it, the path of the root counts once for every keypoint, and an arm's movement hardly counts
    /// (our addition).
    #[serde(default, skip_serializing_if = "is_default")]
    pub bone_weight: f64,
    /// Default guidance weight of the editor.
    pub guidance: f64,
    /// Default factor of the noise that the editor draws: 1 samples the learned distribution, smaller values stay
    /// nearer to its mean.
    pub temperature: f64,
    /// Share of training windows that are shown as the first of their motion, without fixed frames. At 0, the editor
    /// fixes the first frames of the original at the start of a motion, as published, although training fixes those of
    /// the edited motion. Above 0, the editor generates them.
    #[serde(default, skip_serializing_if = "is_default")]
    pub generated_starts: f64,
    /// Standard deviation, in model units, of the noise on clean fixed frames in training. While editing, the fixed
    /// frames are the network's own output, so their errors carry over from window to window unless the network has
    /// learned to correct them.
    #[serde(default, skip_serializing_if = "is_default")]
    pub fixed_noise: f64,
    /// Number of generated frames that a window shares with the previous one, besides the fixed frames. Both windows
    /// are blended there, so that differences between them fade gradually. At 0, each window begins where the previous
    /// one ends, as published.
    #[serde(default, skip_serializing_if = "is_default")]
    pub overlap: usize,
    /// Whether instruction, diffusion step and progress are added to every frame that the network sees, in addition to
    /// their own token.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub tell_frames: bool,
}

pub(crate) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// How the previous frames, which are the fixed first frames of a window, enter the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PreviousFrames {
    /// They are embedded like all other frames of the window (released code).
    Inpainted,
    /// A two-layer network encodes each previous frame into the token at its position (paper, Sec. 5.1; our reading is
    /// that these tokens replace those of the frames).
    Encoded,
}

impl DiffusionConfig {
    pub(super) fn check(&self) -> Result<(), Error> {
        share("diffusion.text_dropout", self.text_dropout)?;
        share("diffusion.generated_starts", self.generated_starts)?;
        finite("diffusion.guidance", self.guidance)?;
        for (field, value) in [
            ("diffusion.motion_weight", self.motion_weight),
            ("diffusion.contact_weight", self.contact_weight),
            ("diffusion.bone_weight", self.bone_weight),
            ("diffusion.temperature", self.temperature),
            ("diffusion.fixed_noise", self.fixed_noise),
        ] {
            not_negative(field, value)?;
        }
        let is_clean = matches!(self.prediction, Prediction::Clean | Prediction::Change);
        ensure(
            self.motion_weight == 0.0 || is_clean,
            "diffusion.motion_weight",
            "frames follow each other in a clean window or a change, not in noise",
        )?;
        ensure(
            self.noise == NoiseKind::White || self.prediction == Prediction::Gated,
            "diffusion.noise",
            "it is shaped, which only the prediction gated supports; set it to white",
        )?;
        let needs_clean = self.prediction.is_extrapolated() || self.fixed_noise > 0.0;
        ensure(
            self.fixed_frames == FixedFrames::Clean || !needs_clean,
            "diffusion.fixed_frames",
            "a residual and noise on the fixed frames need them clean",
        )?;
        Schedule::new(self.schedule, self.num_steps).map(|_| ())
    }
}
