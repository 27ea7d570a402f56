//! The MotionReFit denoiser, and the text encoder trained with it, if there is one.

use std::path::Path;

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::denoiser::Denoiser;
use super::pass::Pass;
use super::text::{LearnedText, TextBatch, text_vectors};
use super::weights::{Networks, both_files};
use crate::Error;
use crate::checkpoint::Files;
use crate::config::{DiffusionConfig, NetworkConfig, Prediction};
use crate::data::NoisyBatch;
use crate::diffusion::{Objective, num_gates};
use crate::transfer::send;

/// The trainable networks of MotionReFit.
#[derive(Module, Debug)]
pub struct MotionRefit {
    /// The denoiser.
    pub denoiser: Denoiser,
    /// The learned text encoder; none if the vectors come from a frozen encoder.
    pub text: Option<LearnedText>,
}

/// Source of a model's text vectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextSource {
    /// An encoder trained with the denoiser, with this number of tokens.
    Learned(usize),
    /// A frozen encoder, with vectors of this width.
    Frozen(usize),
}

impl TextSource {
    /// The width of the text vectors, and the encoder to train, if any. The learned encoder's vectors have width
    /// `width`.
    pub(super) fn encoder(self, width: usize, device: &Device) -> (usize, Option<LearnedText>) {
        match self {
            Self::Learned(tokens) => (width, Some(LearnedText::new(tokens, width, device))),
            Self::Frozen(width) => (width, None),
        }
    }
}

impl Networks for MotionRefit {
    const FILE: &'static str = Denoiser::FILE;

    fn to_files(&self, run_dir: &Path) -> Result<Files, Error> {
        both_files(&self.denoiser, &self.text, run_dir)
    }

    fn take_files(&mut self, files: &mut Files, run_dir: &Path) -> Result<(), Error> {
        self.denoiser.take_files(files, run_dir)?;
        self.text.take_files(files, run_dir)
    }
}

impl MotionRefit {
    /// Builds the networks for frames of `frame_width` numbers: 84 for all keypoints.
    pub fn new(
        config: &NetworkConfig,
        diffusion: &DiffusionConfig,
        text: TextSource,
        frame_width: usize,
        device: &Device,
    ) -> Self {
        let (text_width, text) = text.encoder(config.width, device);
        let denoiser = Denoiser::new(config, diffusion.previous, text_width, frame_width, device);
        let denoiser = match diffusion.prediction {
            Prediction::Gated => denoiser.gated(num_gates(diffusion.noise)),
            _ => denoiser,
        };
        Self {
            denoiser: denoiser.telling_frames(diffusion.tell_frames),
            text,
        }
    }

    /// The vectors of a batch of instructions.
    ///
    /// # Shapes
    /// `[B, text_width]`
    ///
    /// # Panics
    /// If words are given to a model without a learned encoder.
    pub fn text_vectors(&self, texts: &TextBatch, rows: usize, device: &Device) -> Tensor<2> {
        text_vectors(self.text.as_ref(), texts, rows, device)
    }

    /// The training loss of a batch. A dropped instruction is a row of zeros.
    ///
    /// # Shapes
    /// The result is one number.
    pub fn loss(
        &self,
        objective: &Objective<'_>,
        batch: &NoisyBatch,
        device: &Device,
        pass: &Pass,
    ) -> Tensor<1> {
        let text = self.text_vectors(&batch.texts, batch.len(), device);
        let kept = send(batch.text_kept.clone(), [batch.len(), 1], device);
        objective.loss(&self.denoiser, batch, text * kept, pass)
    }
}
