//! The post-norm transformer of `torch.nn`, with its layout and parameter names.

use std::cell::OnceCell;
use std::sync::Arc;

use burn::module::Module;
use burn::nn::{Dropout, DropoutConfig, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::{gelu, softmax};
use burn::tensor::module::attention;
use burn::tensor::ops::AttentionModuleOptions;
use burn::tensor::{Bool, Device, Tensor, TensorData};

use super::fused::{LayerTensors, PreparedEncoder, PreparedLayer, encoder_layer};
use super::pass::{Arithmetic, Pass, probability};
use crate::config::NetworkConfig;

/// Padding mask of a batch of sequences. It is kept on the host, so that nothing is read from the device. The first
/// layer that needs it on the device sends it there, once.
#[derive(Clone, Debug)]
pub struct Padding {
    /// Row by row, true where a token is padding.
    values: Arc<[bool]>,
    rows: usize,
    mask: OnceCell<Tensor<4, Bool>>,
}

impl Padding {
    /// The padding mask of `rows` sequences of the same length, row by row.
    pub fn new(values: Vec<bool>, rows: usize) -> Self {
        Self {
            values: values.into(),
            rows,
            mask: OnceCell::new(),
        }
    }

    /// The padding mask of rows with the given lengths, padded to `width` tokens.
    pub fn after(lengths: &[usize], width: usize) -> Self {
        let padded = lengths
            .iter()
            .flat_map(|&length| (0..width).map(move |token| token >= length));
        Self::new(padded.collect(), lengths.len())
    }

    /// As [`Padding::after`], or none if all rows have `width` tokens.
    pub(crate) fn where_shorter(lengths: &[usize], width: usize) -> Option<Self> {
        let is_shorter = lengths.iter().any(|&length| length < width);
        is_shorter.then(|| Self::after(lengths, width))
    }

    /// The mask on a device.
    ///
    /// # Shapes
    /// `[B, 1, 1, T]`
    pub fn mask(&self, device: &Device) -> Tensor<4, Bool> {
        let shape = [self.rows, 1, 1, self.values.len() / self.rows.max(1)];
        self.mask
            .get_or_init(|| Tensor::from_data(TensorData::new(self.values.to_vec(), shape), device))
            .clone()
    }

    /// The attention mask: the same for each head and query.
    ///
    /// # Shapes
    /// `[B, H, T, T]`
    pub(crate) fn of_attention(&self, num_heads: usize, device: &Device) -> Tensor<4, Bool> {
        let mask = self.mask(device);
        let [batch, _, _, length] = mask.dims();
        mask.expand([batch, num_heads, length, length])
    }

    /// Sets padding to zero.
    ///
    /// # Shapes
    /// `[B, T, F]`
    pub(crate) fn clear(&self, x: Tensor<3>) -> Tensor<3> {
        let [batch, length, width] = x.dims();
        let mask = self.mask(&x.device()).reshape([batch, length, 1]);
        x.mask_fill(mask.expand([batch, length, width]), 0.0)
    }
}

/// Splits tokens into heads.
///
/// # Shapes
/// `[B, T, d]` gives `[B, H, T, d / H]`.
pub(crate) fn split_heads(x: Tensor<3>, num_heads: usize) -> Tensor<4> {
    let [batch, length, width] = x.dims();
    x.reshape([batch, length, num_heads, width / num_heads])
        .swap_dims(1, 2)
}

pub(crate) fn join_heads(heads: Tensor<4>) -> Tensor<3> {
    let [batch, num_heads, length, head] = heads.dims();
    heads
        .swap_dims(1, 2)
        .reshape([batch, length, num_heads * head])
}

/// Multi-head self-attention with query, key and value in one projection.
#[derive(Module, Debug)]
struct SelfAttention {
    in_proj: Linear,
    out_proj: Linear,
    dropout: Dropout,
    num_heads: usize,
}

impl SelfAttention {
    fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            in_proj: LinearConfig::new(config.width, 3 * config.width).init(device),
            out_proj: LinearConfig::new(config.width, config.width).init(device),
            dropout: DropoutConfig::new(config.dropout).init(),
            num_heads: config.num_heads,
        }
    }

    /// Attends from every token to every token that is not padding.
    ///
    /// # Shapes
    /// `x` and the result `[B, T, d]`; `padding` has `B` rows of `T` tokens.
    fn forward(&self, x: Tensor<3>, padding: Option<&Padding>, pass: &Pass) -> Tensor<3> {
        let [_, _, width] = x.dims();
        let weight = self.in_proj.weight.val();
        let bias = self.in_proj.bias.as_ref().map(|bias| bias.val());
        // The weights are split in three instead of the result: the gradient of a slice fills an array of the whole
        // size with zeros, and weights are smaller than activations.
        let [q, k, v] = [0, 1, 2].map(|part| {
            let weight = weight.clone().narrow(1, part * width, width);
            let bias = bias.clone().map(|bias| bias.narrow(0, part * width, width));
            split_heads(pass.product(x.clone(), weight, bias), self.num_heads)
        });
        let mask = padding.map(|padding| padding.of_attention(self.num_heads, &x.device()));
        let attended = if q.device().is_autodiff() {
            // The backend's fused attention has no gradient of its own: its fallback would also pass gradients through
            // the row maximum. It cannot drop attention weights either.
            let scale = ((width / self.num_heads) as f64).sqrt().recip();
            let mut scores = q.mul_scalar(scale).matmul(k.swap_dims(2, 3));
            if let Some(mask) = mask {
                scores = scores.mask_fill(mask, f32::NEG_INFINITY);
            }
            pass.drop_out(&self.dropout, softmax(scores, 3)).matmul(v)
        } else {
            attention(q, k, v, mask, None, AttentionModuleOptions::default())
        };
        pass.linear(&self.out_proj, join_heads(attended))
    }
}

/// Attention to a memory of one token.
///
/// The only key has weight 1 for every query, so every token receives the projected value, and queries and keys are not
/// computed. Their weights exist because `torch.nn` stores them. There is no dropout of attention weights, which would
/// only remove the memory from single tokens.
#[derive(Module, Debug)]
struct SingleMemoryAttention {
    in_proj: Linear,
    out_proj: Linear,
}

impl SingleMemoryAttention {
    fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            in_proj: LinearConfig::new(config.width, 3 * config.width).init(device),
            out_proj: LinearConfig::new(config.width, config.width).init(device),
        }
    }

    /// Contribution of the memory to every token, `[B, 1, d]` to `[B, 1, d]`.
    fn forward(&self, memory: Tensor<3>, pass: &Pass) -> Tensor<3> {
        let [_, _, width] = memory.dims();
        let weight = self.in_proj.weight.val().narrow(1, 2 * width, width);
        let bias = self
            .in_proj
            .bias
            .as_ref()
            .map(|bias| bias.val().narrow(0, 2 * width, width));
        pass.linear(&self.out_proj, pass.product(memory, weight, bias))
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
            dropout: DropoutConfig::new(config.dropout).init(),
        }
    }

    /// Applies the layer. If kernels are used and the tensors are on a processor, it is one fused operation; otherwise
    /// it is composed of the backend's operations.
    ///
    /// # Shapes
    /// `x` and the result `[B, T, d]`; `padding` has `B` rows of `T` tokens.
    pub fn forward(&self, x: Tensor<3>, padding: Option<&Padding>, pass: &Pass) -> Tensor<3> {
        let device = x.device();
        let tensors = pass.uses_kernels(&device).then(|| self.tensors()).flatten();
        let fused = tensors.and_then(|tensors| {
            encoder_layer(
                &x,
                tensors,
                self.self_attn.num_heads,
                padding.map(|padding| Arc::clone(&padding.values)),
                probability(&self.dropout, &device),
                || pass.draw_key(),
            )
        });
        fused.unwrap_or_else(|| self.forward_composed(x, padding, pass))
    }

    fn linears(&self) -> [&Linear; 4] {
        [
            &self.self_attn.in_proj,
            &self.self_attn.out_proj,
            &self.linear1,
            &self.linear2,
        ]
    }

    pub(crate) fn weights(&self) -> [Tensor<2>; 4] {
        self.linears().map(|linear| linear.weight.val())
    }

    /// The trainable tensors; none if the layer lacks some.
    fn tensors(&self) -> Option<LayerTensors> {
        let biases = self.linears().map(|linear| linear.bias.as_ref());
        let [b0, b1, b2, b3] = biases.map(|bias| bias.map(|bias| bias.val()));
        let beta = |norm: &LayerNorm| norm.beta.as_ref().map(|beta| beta.val());
        Some(LayerTensors {
            weights: self.weights(),
            vectors: [
                b0?,
                b1?,
                b2?,
                b3?,
                self.norm1.gamma.val(),
                beta(&self.norm1)?,
                self.norm2.gamma.val(),
                beta(&self.norm2)?,
            ],
        })
    }

    fn forward_composed(&self, x: Tensor<3>, padding: Option<&Padding>, pass: &Pass) -> Tensor<3> {
        let drop_out = |x: Tensor<3>| pass.drop_out(&self.dropout, x);
        let attended = self.self_attn.forward(x.clone(), padding, pass);
        let x = self.norm1.forward(x + drop_out(attended));
        let hidden = drop_out(gelu(pass.linear(&self.linear1, x.clone())));
        let hidden = pass.linear(&self.linear2, hidden);
        self.norm2.forward(x + drop_out(hidden))
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

    /// Prepares the weights in the layout in which passes without gradients multiply them.
    pub(crate) fn prepare(&self, arithmetic: Arithmetic) -> PreparedWeights {
        let layers = self.layers.iter().map(|layer| {
            let tensors = layer.tensors()?;
            arithmetic
                .uses_kernels(&tensors.weights[0].device())
                .then(|| PreparedLayer::for_inference(tensors, layer.self_attn.num_heads))?
        });
        PreparedWeights {
            encoder: PreparedEncoder::new(layers),
            arithmetic,
        }
    }

    /// Applies all layers without gradients and without padding.
    ///
    /// # Shapes
    /// `[B, T, d]` to `[B, T, d]`
    pub(crate) fn infer(&self, weights: &PreparedWeights, x: Tensor<3>) -> Tensor<3> {
        let prepared = weights.encoder.as_ref();
        prepared
            .and_then(|encoder| encoder.forward(x.clone()))
            .unwrap_or_else(|| self.forward(x, None, &Pass::new(weights.arithmetic)))
    }

    /// Applies all layers.
    ///
    /// # Shapes
    /// `x` and the result `[B, T, d]`; `padding` has `B` rows of `T` tokens.
    pub fn forward(&self, x: Tensor<3>, padding: Option<&Padding>, pass: &Pass) -> Tensor<3> {
        self.layers
            .iter()
            .fold(x, |x, layer| layer.forward(x, padding, pass))
    }
}

/// A copy of an encoder's weights, prepared for many passes if kernels are used.
#[derive(Debug)]
pub struct PreparedWeights {
    encoder: Option<PreparedEncoder>,
    arithmetic: Arithmetic,
}

impl PreparedWeights {
    pub(crate) fn arithmetic(&self) -> Arithmetic {
        self.arithmetic
    }
}

/// `nn.TransformerDecoderLayer` with a memory of one token.
#[derive(Module, Debug)]
pub(super) struct DecoderLayer {
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
    pub(super) fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            self_attn: SelfAttention::new(config, device),
            multihead_attn: SingleMemoryAttention::new(config, device),
            linear1: LinearConfig::new(config.width, config.feed_forward).init(device),
            linear2: LinearConfig::new(config.feed_forward, config.width).init(device),
            norm1: LayerNormConfig::new(config.width).init(device),
            norm2: LayerNormConfig::new(config.width).init(device),
            norm3: LayerNormConfig::new(config.width).init(device),
            dropout: DropoutConfig::new(config.dropout).init(),
        }
    }

    /// # Shapes
    /// `x` and the result `[B, T, d]`; `memory` `[B, 1, d]`; `padding` has `B` rows of `T` tokens.
    pub(super) fn forward(
        &self,
        x: Tensor<3>,
        memory: Tensor<3>,
        padding: Option<&Padding>,
        pass: &Pass,
    ) -> Tensor<3> {
        let drop_out = |x: Tensor<3>| pass.drop_out(&self.dropout, x);
        let attended = self.self_attn.forward(x.clone(), padding, pass);
        let x = self.norm1.forward(x + drop_out(attended));
        let remembered = self.multihead_attn.forward(memory, pass);
        let x = self.norm2.forward(x + drop_out(remembered));
        let hidden = drop_out(gelu(pass.linear(&self.linear1, x.clone())));
        let hidden = pass.linear(&self.linear2, hidden);
        self.norm3.forward(x + drop_out(hidden))
    }
}

/// `nn.TransformerDecoder` with a memory of one token, without a final norm.
#[derive(Module, Debug)]
pub(super) struct Decoder {
    layers: Vec<DecoderLayer>,
}

impl Decoder {
    pub(super) fn new(config: &NetworkConfig, device: &Device) -> Self {
        Self {
            layers: (0..config.num_layers)
                .map(|_| DecoderLayer::new(config, device))
                .collect(),
        }
    }

    /// # Shapes
    /// As [`DecoderLayer::forward`].
    pub(super) fn forward(
        &self,
        x: Tensor<3>,
        memory: Tensor<3>,
        padding: Option<&Padding>,
        pass: &Pass,
    ) -> Tensor<3> {
        self.layers.iter().fold(x, |x, layer| {
            layer.forward(x, memory.clone(), padding, pass)
        })
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Distribution;
    use datasets_spec::Seed;

    use super::*;
    use crate::model::weights::draw;
    use crate::transfer::{read, send};

    const CONFIG: NetworkConfig = NetworkConfig {
        width: 24,
        num_layers: 1,
        num_heads: 3,
        feed_forward: 40,
        dropout: 0.0,
    };

    fn check_equal(found: &[f32], expected: &[f32], tolerance: f32) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() <= tolerance, "{found} {expected}");
        }
    }

    /// The layer's output, then the gradients of the input and of every tensor.
    fn run(
        layer: &EncoderLayer,
        x: &Tensor<3>,
        forward: impl Fn(&EncoderLayer, Tensor<3>) -> Tensor<3>,
    ) -> Vec<Vec<f32>> {
        let x = x.clone().require_grad();
        let out = forward(layer, x.clone());
        let slope: Vec<f32> = (0..out.shape().num_elements())
            .map(|index| (index as f32 * 0.7).sin())
            .collect();
        let slope = send(slope, out.dims(), &out.device());
        let grads = (out.clone() * slope).sum().backward();
        let tensors = layer.tensors().expect("a whole layer");
        let mut found = vec![read(out), read(x.grad(&grads).expect("a gradient"))];
        for weight in tensors.weights {
            found.push(read(weight.grad(&grads).expect("a gradient")));
        }
        for vector in tensors.vectors {
            found.push(read(vector.grad(&grads).expect("a gradient")));
        }
        found
    }

    #[test]
    fn the_fused_layer_is_the_composed_one_forwards_and_backwards() {
        let device = Device::flex().autodiff();
        let layer = draw(EncoderLayer::new(&CONFIG, &device), Seed(1)).expect("known layers");
        let (batch, length) = (9, 11);
        let x = Tensor::random([batch, length, 24], Distribution::Normal(0.0, 1.0), &device);
        let lengths: Vec<usize> = (0..batch).map(|row| 3 + row).collect();
        let padding = Padding::after(&lengths, length);
        let pass = Pass::default();
        for padding in [None, Some(&padding)] {
            let fused = run(&layer, &x, |layer, x| layer.forward(x, padding, &pass));
            let composed = run(&layer, &x, |layer, x| {
                layer.forward_composed(x, padding, &pass)
            });
            for (fused, composed) in fused.iter().zip(&composed) {
                check_equal(fused, composed, 3e-5);
            }
            let plain = layer.valid();
            let padding = padding.map(|_| Padding::after(&lengths, length));
            let inferred = plain.forward(x.clone().inner(), padding.as_ref(), &pass);
            check_equal(&read(inferred), &fused[0], 1e-5);
        }
    }

    /// The same layer on another backend, with other products, autodiff and normalisation.
    #[test]
    fn the_fused_layer_is_that_of_burn_ndarray() {
        #[expect(deprecated, reason = "the independent backend")]
        let devices = [Device::flex(), Device::ndarray()].map(Device::autodiff);
        let (batch, length) = (9, 11);
        let numbers: Vec<f32> = (0..batch * length * 24)
            .map(|index| 2.0 * (index as f32 * 0.37).sin())
            .collect();
        let lengths: Vec<usize> = (0..batch).map(|row| 3 + row).collect();
        let [ours, theirs] = devices.map(|device| {
            let layer = draw(EncoderLayer::new(&CONFIG, &device), Seed(1)).expect("known layers");
            let x = send(numbers.clone(), [batch, length, 24], &device);
            let padding = Padding::after(&lengths, length);
            run(&layer, &x, |layer, x| {
                layer.forward(x, Some(&padding), &Pass::default())
            })
        });
        // The backend's derivative of GELU uses the tanh approximation, which differs from the exact one by up to 1e-3
        // (burn-backend's `gelu_backward`). Only the result, and the gradients of tensors after GELU, do not depend on
        // it.
        const EXACT: [usize; 4] = [0, 5, 12, 13];
        for (index, (ours, theirs)) in ours.iter().zip(&theirs).enumerate() {
            let tolerance = if EXACT.contains(&index) { 3e-5 } else { 1e-3 };
            check_equal(ours, theirs, tolerance);
        }
    }

    #[test]
    fn dropout_repeats_with_the_key_and_its_gradient_matches_finite_differences() {
        let device = Device::flex().autodiff();
        let layer = draw(EncoderLayer::new(&CONFIG, &device), Seed(2)).expect("known layers");
        let x = Tensor::<3>::random([2, 5, 24], Distribution::Normal(0.0, 1.0), &device);
        let forward = |key: u64, x: Tensor<3>| {
            let tensors = layer.tensors().expect("a whole layer");
            encoder_layer(&x, tensors, 3, None, 0.2, || key).expect("on the processor")
        };
        let on_one_thread = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .expect("a pool")
            .install(|| read(forward(1, x.clone())));
        assert_eq!(read(forward(1, x.clone())), on_one_thread);
        assert_ne!(read(forward(2, x.clone())), on_one_thread);
        let input = x.clone().require_grad();
        let weights: Vec<f32> = (0..240).map(|index| (index as f32 * 0.3).cos()).collect();
        let weights = send(weights, [2, 5, 24], &device);
        let loss = |x: Tensor<3>| (forward(3, x) * weights.clone()).sum();
        let grads = loss(input.clone()).backward();
        let grad = read(input.grad(&grads).expect("a gradient"));
        let at = read(x);
        const STEP: f32 = 1e-2;
        for index in (0..240).step_by(17) {
            let moved = |by: f32| {
                let mut at = at.clone();
                at[index] += by;
                read(loss(send(at, [2, 5, 24], &device)))[0]
            };
            let slope = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
            // The error of the finite difference is of the order of the squared step.
            assert!(
                (slope - grad[index]).abs() < 5e-3,
                "{slope} {}",
                grad[index]
            );
        }
    }
}
