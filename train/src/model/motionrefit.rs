//! The denoiser together with the text encoder trained with it.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

use super::denoiser::Denoiser;
use super::text::LearnedText;
use crate::config::DiffusionConfig;
use crate::config::NetworkConfig;
use crate::data::NoisyBatch;
use crate::diffusion::{Schedule, training_loss};

/// MotionReFit with a text encoder of its own.
#[derive(Module, Debug)]
pub struct MotionRefit {
    /// Predicts noise.
    pub denoiser: Denoiser,
    /// Turns instructions into vectors.
    pub text: LearnedText,
}

impl MotionRefit {
    /// Builds both networks.
    pub fn new(config: &NetworkConfig, num_tokens: usize, device: &Device) -> Self {
        Self {
            denoiser: Denoiser::new(config, device),
            text: LearnedText::new(num_tokens, config.width, device),
        }
    }

    /// The training loss of a batch. A dropped instruction is a row of zeros.
    ///
    /// # Shapes
    /// The result is one number.
    pub fn loss(
        &self,
        schedule: &Schedule,
        batch: &NoisyBatch,
        config: &DiffusionConfig,
    ) -> Tensor<1> {
        let text = self.text.forward(&batch.tokens);
        let kept = Tensor::<2>::from_data(
            TensorData::new(batch.text_kept.clone(), [batch.len(), 1]),
            &text.device(),
        );
        training_loss(&self.denoiser, schedule, batch, text * kept, config)
    }
}
