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

/// Fixed frames as the network sees them in training. The editor always shows them clean.
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
/// The paper leaves it open: Eq. 2 reads as the noise, Eq. 4 as the clean window. The released code
/// predicts the noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Prediction {
    /// The noise. Its 84 numbers a frame are all surprise and must fit through the network.
    Noise,
    /// The clean window.
    Clean,
    /// The clean window minus the original one. Both are canonical, so an edit that leaves most of
    /// the body alone is mostly zero; a narrow network learns it far sooner (our addition).
    Change,
    /// Bones, as vectors from joint to joint, each the sum of three parts with a gate between 0 and 1: the
    /// original's bone, the extrapolated change from the fixed frames, and a bone of the network's own. A
    /// bone that the instruction does not touch is copied, and one that it replaces need not be cancelled
    /// first: a narrow network can say which it is, while the numbers of both do not fit through it (our
    /// addition). Errors count in units of the spread of what the
    /// [extrapolation](crate::extrapolation::Extrapolation) leaves open in each frame: the frames just after the
    /// fixed ones, which follow from them almost, count as much as any other, and windows join (the scaling is that of
    /// Karras et al. 2022, Sec. 5, by frame in place of by noise level).
    Gated,
}

impl Prediction {
    /// Whether the target is relative to an [extrapolation](crate::extrapolation::Extrapolation) of the change.
    pub fn is_extrapolated(self) -> bool {
        self == Self::Gated
    }
}

/// Noise that windows are mixed with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoiseKind {
    /// White noise about zero, as published.
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
    /// Diffusion steps.
    pub num_steps: usize,
    /// Noise schedule.
    pub schedule: ScheduleName,
    /// Noise that windows are mixed with.
    #[serde(default, skip_serializing_if = "is_default")]
    pub noise: NoiseKind,
    /// Target of the network.
    pub prediction: Prediction,
    /// Loss on the prediction.
    pub loss: Loss,
    /// Fixed frames as the network sees them in training.
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
    /// Weight of the loss on feet that slide beside the loss on the prediction: the speed of each foot,
    /// in units of 0.1 m/s, in frames in which the edited motion's is slower than that (after Tevet et al.
    /// 2023, Eq. 4; neither publication has it).
    #[serde(default, skip_serializing_if = "is_default")]
    pub contact_weight: f64,
    /// Weight of the loss on bones, as vectors from joint to joint in units of 10 cm, beside the loss on the
    /// prediction. In the loss on keypoints, the path of the root counts once for every keypoint, and an arm's movement
    /// hardly counts (our addition).
    #[serde(default, skip_serializing_if = "is_default")]
    pub bone_weight: f64,
    /// Guidance weight the editor uses unless told otherwise.
    pub guidance: f64,
    /// Factor of the noise the editor draws, unless told otherwise: 1 samples what was learned, less
    /// stays nearer to its mean.
    pub temperature: f64,
    /// Share of the training windows that are shown as the first of their motion, without fixed frames. At 0 the editor
    /// starts a motion on the first frames of the original, as published, although training always fixes those of the
    /// edited motion; above 0 it generates them.
    #[serde(default, skip_serializing_if = "is_default")]
    pub generated_starts: f64,
    /// Standard deviation in model units of noise on the clean fixed frames shown while training. While
    /// editing they are the network's own, and what they are wrong by is carried from window to window
    /// unless the network has learned to mend it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub fixed_noise: f64,
    /// Generated frames that a window of an edit shares with the one before it, beside the fixed ones. The two are
    /// blended there, so that windows that disagree change over gradually. At 0 each window begins where the one before
    /// ends, as published.
    #[serde(default, skip_serializing_if = "is_default")]
    pub overlap: usize,
    /// Whether instruction, diffusion step and progress are added to every frame that the network sees,
    /// beside their own token.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub tell_frames: bool,
}

pub(crate) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// How the frames before a window, which are its fixed first frames, enter the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PreviousFrames {
    /// The frames are noisy like all other frames of the window (released code).
    Inpainted,
    /// A network of two layers encodes each into the token of its place (paper, Sec. 5.1; that the
    /// tokens stand in the place of the frames is our reading).
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
