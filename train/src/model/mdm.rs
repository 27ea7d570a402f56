//! The MDM network: it predicts a clean motion from a noisy one, a diffusion step and a caption.

use burn::module::Module;
use burn::nn::{Dropout, DropoutConfig, Linear, LinearConfig};
use burn::tensor::{Device, Tensor};

use super::denoiser::TwoLayers;
use super::pass::{Arithmetic, Pass};
use super::position::positions;
use super::transformer::{Encoder, Padding, PreparedWeights};
use super::weights::Networks;
use crate::config::NetworkConfig;

/// A transformer over one token of diffusion step and caption, and a token for each frame.
///
/// # Source
/// Tevet et al. 2023, Sec. 3; the layout and the names are those of the released code with
/// `arch=trans_enc` (`algorithms` section 12).
#[derive(Module, Debug)]
pub struct Mdm {
    pose_embedding: Linear,
    embed_timestep: TwoLayers,
    embed_text: Linear,
    sequence_encoder: Encoder,
    pose_final: Linear,
    dropout: Dropout,
}

impl Networks for Mdm {
    const FILE: &'static str = "mdm.safetensors";
}

impl Mdm {
    /// Builds the network for frames of `num_features` numbers and text vectors of `text_width`.
    pub fn new(
        config: &NetworkConfig,
        num_features: usize,
        text_width: usize,
        device: &Device,
    ) -> Self {
        let linear = |from, to| LinearConfig::new(from, to).init(device);
        Self {
            pose_embedding: linear(num_features, config.width),
            embed_timestep: TwoLayers::new([config.width; 3], device),
            embed_text: linear(text_width, config.width),
            sequence_encoder: Encoder::new(config, device),
            pose_final: linear(config.width, num_features),
            dropout: DropoutConfig::new(config.dropout).init(),
        }
    }

    /// Predicts the clean motion.
    ///
    /// A text row of zeros means no text; the text layer's bias is still added, as in the released code. With
    /// `lengths`, frames after a row's length are masked in attention.
    ///
    /// # Shapes
    /// `x` and the result `[B, T, F]`; `timesteps` `[B]`; `text` `[B, text_width]`; `lengths` `[B]`.
    pub fn forward(
        &self,
        x: Tensor<3>,
        timesteps: &[usize],
        text: Tensor<2>,
        lengths: Option<&[usize]>,
        pass: &Pass,
    ) -> Tensor<3> {
        let [_, frames, _] = x.dims();
        let padding = lengths.map(|lengths| {
            let tokens: Vec<usize> = lengths.iter().map(|length| 1 + length).collect();
            Padding::after(&tokens, 1 + frames)
        });
        let tokens = pass.drop_out(&self.dropout, self.tokens(x, timesteps, text));
        let tokens = self
            .sequence_encoder
            .forward(tokens, padding.as_ref(), pass);
        self.frames(tokens)
    }

    /// Prepares the current weights of the layers for sampling.
    pub fn prepare(&self, arithmetic: Arithmetic) -> PreparedWeights {
        self.sequence_encoder.prepare(arithmetic)
    }

    /// [`Mdm::forward`] without gradients and without masking.
    ///
    /// # Shapes
    /// As [`Mdm::forward`].
    pub fn infer(
        &self,
        weights: &PreparedWeights,
        x: Tensor<3>,
        timesteps: &[usize],
        text: Tensor<2>,
    ) -> Tensor<3> {
        let tokens = self.tokens(x, timesteps, text);
        self.frames(self.sequence_encoder.infer(weights, tokens))
    }

    /// Tokens with positional encoding: one of diffusion step and text, then the frames, `[B, 1 + T, d]`.
    fn tokens(&self, x: Tensor<3>, timesteps: &[usize], text: Tensor<2>) -> Tensor<3> {
        let device = x.device();
        let condition = self.embed_timestep.embed(timesteps) + self.embed_text.forward(text);
        let tokens = Tensor::cat(
            vec![condition.unsqueeze_dim(1), self.pose_embedding.forward(x)],
            1,
        );
        let [_, length, width] = tokens.dims();
        tokens + positions(length, width, &device)
    }

    /// The output of the network, computed from the encoded tokens.
    fn frames(&self, tokens: Tensor<3>) -> Tensor<3> {
        let [_, length, _] = tokens.dims();
        self.pose_final.forward(tokens.narrow(1, 1, length - 1))
    }
}
