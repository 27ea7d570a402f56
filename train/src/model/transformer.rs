//! The post-norm transformer of `torch.nn`, in its own layout and names.

use burn::module::Module;
use burn::nn::{LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::{gelu, softmax};
use burn::tensor::module::{attention, linear};
use burn::tensor::ops::AttentionModuleOptions;
use burn::tensor::{Bool, Device, Tensor, TensorData};

use super::dropout::Dropout;
use crate::config::NetworkConfig;

/// Multi-head self-attention with query, key and value in one projection.
#[derive(Module, Debug)]
pub struct SelfAttention {
    in_proj: Linear,
    out_proj: Linear,
    dropout: Dropout,
    num_heads: usize,
}

impl SelfAttention {
    /// Builds the layer.
    pub fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            in_proj: LinearConfig::new(config.width, 3 * config.width).init(device),
            out_proj: LinearConfig::new(config.width, config.width).init(device),
            dropout: Dropout::new(config.dropout),
            num_heads: config.num_heads,
        }
    }

    /// Attends from every token to every token that is not padding.
    ///
    /// # Shapes
    /// `x` and the result `[B, T, d]`; `padding` `[B, 1, 1, T]`, true where a token is padding.
    pub fn forward(&self, x: Tensor<3>, padding: Option<&Tensor<4, Bool>>) -> Tensor<3> {
        let [batch, length, width] = x.dims();
        let head = width / self.num_heads;
        let weight = self.in_proj.weight.val();
        let bias = self.in_proj.bias.as_ref().map(|bias| bias.val());
        // The weights are cut in three, not the result: the gradient of a cut fills the whole with
        // zeros, and weights are small beside activations.
        let [q, k, v] = [0, 1, 2].map(|part| {
            let weight = weight.clone().narrow(1, part * width, width);
            let bias = bias.clone().map(|bias| bias.narrow(0, part * width, width));
            linear(x.clone(), weight, bias)
                .reshape([batch, length, self.num_heads, head])
                .swap_dims(1, 2)
        });
        let mask = padding.map(|padding| {
            padding
                .clone()
                .expand([batch, self.num_heads, length, length])
        });
        let attended = if q.device().is_autodiff() {
            // The fused product has no gradient of its own: its fallback would also carry
            // gradients through the row maximum, and it cannot drop attention weights.
            let scale = (head as f64).sqrt().recip();
            let mut scores = q.mul_scalar(scale).matmul(k.swap_dims(2, 3));
            if let Some(mask) = mask {
                scores = scores.mask_fill(mask, f32::NEG_INFINITY);
            }
            self.dropout.forward(softmax(scores, 3)).matmul(v)
        } else {
            attention(q, k, v, mask, None, AttentionModuleOptions::default())
        };
        self.out_proj
            .forward(attended.swap_dims(1, 2).reshape([batch, length, width]))
    }
}

/// Attention to a memory of one token.
///
/// The weight of the only key is 1 whatever the query, so every token receives the projected value
/// and queries and keys play no part. Their weights are kept, because `torch.nn` stores them.
/// Dropout of attention weights, which would only remove the memory from single tokens, is left
/// out.
#[derive(Module, Debug)]
pub struct SingleMemoryAttention {
    in_proj: Linear,
    out_proj: Linear,
}

impl SingleMemoryAttention {
    /// Builds the layer.
    pub fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            in_proj: LinearConfig::new(config.width, 3 * config.width).init(device),
            out_proj: LinearConfig::new(config.width, config.width).init(device),
        }
    }

    /// What every token receives from the memory.
    ///
    /// # Shapes
    /// `[B, 1, d]` to `[B, 1, d]`
    pub fn forward(&self, memory: Tensor<3>) -> Tensor<3> {
        let [_, _, width] = memory.dims();
        let weight = self.in_proj.weight.val().narrow(1, 2 * width, width);
        let bias = self
            .in_proj
            .bias
            .as_ref()
            .map(|bias| bias.val().narrow(0, 2 * width, width));
        self.out_proj.forward(linear(memory, weight, bias))
    }
}

/// `nn.TransformerEncoderLayer` with `norm_first=False` and the exact GELU.
#[derive(Module, Debug)]
pub struct EncoderLayer {
    self_attn: SelfAttention,
    linear1: Linear,
    linear2: Linear,
    norm1: LayerNorm,
    norm2: LayerNorm,
    dropout: Dropout,
}

impl EncoderLayer {
    /// Builds the layer.
    pub fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            self_attn: SelfAttention::new(config, device),
            linear1: LinearConfig::new(config.width, config.feed_forward).init(device),
            linear2: LinearConfig::new(config.feed_forward, config.width).init(device),
            norm1: LayerNormConfig::new(config.width).init(device),
            norm2: LayerNormConfig::new(config.width).init(device),
            dropout: Dropout::new(config.dropout),
        }
    }

    /// Applies the layer.
    ///
    /// # Shapes
    /// As [`SelfAttention::forward`].
    pub fn forward(&self, x: Tensor<3>, padding: Option<&Tensor<4, Bool>>) -> Tensor<3> {
        let attended = self.self_attn.forward(x.clone(), padding);
        let x = self.norm1.forward(x + self.dropout.forward(attended));
        let hidden = self.dropout.forward(gelu(self.linear1.forward(x.clone())));
        let hidden = self.linear2.forward(hidden);
        self.norm2.forward(x + self.dropout.forward(hidden))
    }
}

/// `nn.TransformerEncoder` without a final norm.
#[derive(Module, Debug)]
pub struct Encoder {
    layers: Vec<EncoderLayer>,
}

impl Encoder {
    /// Builds the layers.
    pub fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            layers: (0..config.num_layers)
                .map(|_| EncoderLayer::new(config, device))
                .collect(),
        }
    }

    /// Applies all layers.
    ///
    /// # Shapes
    /// As [`SelfAttention::forward`].
    pub fn forward(&self, x: Tensor<3>, padding: Option<&Tensor<4, Bool>>) -> Tensor<3> {
        self.layers
            .iter()
            .fold(x, |x, layer| layer.forward(x, padding))
    }
}

/// `nn.TransformerDecoderLayer` whose memory is one token.
#[derive(Module, Debug)]
pub struct DecoderLayer {
    self_attn: SelfAttention,
    multihead_attn: SingleMemoryAttention,
    linear1: Linear,
    linear2: Linear,
    norm1: LayerNorm,
    norm2: LayerNorm,
    norm3: LayerNorm,
    dropout: Dropout,
}

impl DecoderLayer {
    /// Builds the layer.
    pub fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            self_attn: SelfAttention::new(config, device),
            multihead_attn: SingleMemoryAttention::new(config, device),
            linear1: LinearConfig::new(config.width, config.feed_forward).init(device),
            linear2: LinearConfig::new(config.feed_forward, config.width).init(device),
            norm1: LayerNormConfig::new(config.width).init(device),
            norm2: LayerNormConfig::new(config.width).init(device),
            norm3: LayerNormConfig::new(config.width).init(device),
            dropout: Dropout::new(config.dropout),
        }
    }

    /// Applies the layer.
    ///
    /// # Shapes
    /// `x` and the result `[B, T, d]`; `memory` `[B, 1, d]`; `padding` `[B, 1, 1, T]`.
    pub fn forward(
        &self,
        x: Tensor<3>,
        memory: Tensor<3>,
        padding: Option<&Tensor<4, Bool>>,
    ) -> Tensor<3> {
        let attended = self.self_attn.forward(x.clone(), padding);
        let x = self.norm1.forward(x + self.dropout.forward(attended));
        let remembered = self.multihead_attn.forward(memory);
        let x = self.norm2.forward(x + self.dropout.forward(remembered));
        let hidden = self.dropout.forward(gelu(self.linear1.forward(x.clone())));
        let hidden = self.linear2.forward(hidden);
        self.norm3.forward(x + self.dropout.forward(hidden))
    }
}

/// `nn.TransformerDecoder` whose memory is one token, without a final norm.
#[derive(Module, Debug)]
pub struct Decoder {
    layers: Vec<DecoderLayer>,
}

impl Decoder {
    /// Builds the layers.
    pub fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            layers: (0..config.num_layers)
                .map(|_| DecoderLayer::new(config, device))
                .collect(),
        }
    }

    /// Applies all layers.
    ///
    /// # Shapes
    /// As [`DecoderLayer::forward`].
    pub fn forward(
        &self,
        x: Tensor<3>,
        memory: Tensor<3>,
        padding: Option<&Tensor<4, Bool>>,
    ) -> Tensor<3> {
        self.layers
            .iter()
            .fold(x, |x, layer| layer.forward(x, memory.clone(), padding))
    }
}

/// The mask of rows that end before `width` tokens: true from a row's length on.
///
/// # Shapes
/// `[B]` lengths give `[B, width]`.
pub fn padding_of(lengths: &[usize], width: usize, device: &Device) -> Tensor<2, Bool> {
    let padded: Vec<bool> = lengths
        .iter()
        .flat_map(|&length| (0..width).map(move |token| token >= length))
        .collect();
    Tensor::from_data(TensorData::new(padded, [lengths.len(), width]), device)
}
