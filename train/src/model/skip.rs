//! Transformers with skip connections from the first half of their layers to the second, as in MLD.

use burn::module::Module;
use burn::nn::{LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::{Device, Tensor};

use super::pass::Pass;
use super::transformer::{DecoderLayer, EncoderLayer, Padding};
use crate::config::NetworkConfig;

/// Layers with skip connections: each layer of the second half also gets the output of its mirror image in the first
/// half, the last layer that of the first, and so on. A final norm follows.
///
/// # Source
/// MLD, `operator/cross_attention.py`, after the U-ViT of Bao et al. 2023.
#[derive(Module, Debug)]
pub(super) struct SkipLayers<L: Module> {
    input_blocks: Vec<L>,
    middle_block: L,
    output_blocks: Vec<L>,
    linear_blocks: Vec<Linear>,
    norm: LayerNorm,
}

impl<L: Module> SkipLayers<L> {
    /// Builds `num_layers` layers, or one less if the number is even.
    fn new(config: &NetworkConfig, device: &Device, layer: impl Fn() -> L) -> Self {
        let half = config.num_layers.saturating_sub(1) / 2;
        let half_of = || (0..half).map(|_| layer()).collect();
        Self {
            input_blocks: half_of(),
            middle_block: layer(),
            output_blocks: half_of(),
            linear_blocks: (0..half)
                .map(|_| LinearConfig::new(2 * config.width, config.width).init(device))
                .collect(),
            norm: LayerNormConfig::new(config.width).init(device),
        }
    }

    fn forward(&self, mut x: Tensor<3>, apply: impl Fn(&L, Tensor<3>) -> Tensor<3>) -> Tensor<3> {
        let mut kept = Vec::with_capacity(self.input_blocks.len());
        for layer in &self.input_blocks {
            x = apply(layer, x);
            kept.push(x.clone());
        }
        x = apply(&self.middle_block, x);
        let second = self.linear_blocks.iter().zip(&self.output_blocks);
        for ((linear, layer), kept) in second.zip(kept.into_iter().rev()) {
            x = apply(layer, linear.forward(Tensor::cat(vec![x, kept], 2)));
        }
        self.norm.forward(x)
    }
}

pub(super) type SkipEncoder = SkipLayers<EncoderLayer>;

impl SkipLayers<EncoderLayer> {
    pub(super) fn encoder(config: &NetworkConfig, device: &Device) -> Self {
        Self::new(config, device, || EncoderLayer::new(config, device))
    }

    /// # Shapes
    /// `x` and the result `[B, T, d]`; `padding` has `B` rows of `T` tokens.
    pub(super) fn encode(&self, x: Tensor<3>, padding: Option<&Padding>, pass: &Pass) -> Tensor<3> {
        self.forward(x, |layer, x| layer.forward(x, padding, pass))
    }
}

/// A decoder with skip connections, whose memory is one token.
pub(super) type SkipDecoder = SkipLayers<DecoderLayer>;

impl SkipLayers<DecoderLayer> {
    pub(super) fn decoder(config: &NetworkConfig, device: &Device) -> Self {
        Self::new(config, device, || DecoderLayer::new(config, device))
    }

    /// # Shapes
    /// `x` and the result `[B, T, d]`; `memory` `[B, 1, d]`; `padding` has `B` rows of `T` tokens.
    pub(super) fn decode(
        &self,
        x: Tensor<3>,
        memory: &Tensor<3>,
        padding: Option<&Padding>,
        pass: &Pass,
    ) -> Tensor<3> {
        self.forward(x, |layer, x| {
            layer.forward(x, memory.clone(), padding, pass)
        })
    }
}
