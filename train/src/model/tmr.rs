//! The TMR networks: encoders of motions and texts into one latent space, and a decoder of motions.

use burn::module::{Initializer, Module, Param};
use burn::nn::{Dropout, DropoutConfig, Embedding, EmbeddingConfig, Linear, LinearConfig};
use burn::tensor::activation::log_softmax;
use burn::tensor::{Bool, Device, Tensor, TensorData};

use super::pass::Pass;
use super::position::positions;
use super::text::token_tensor;
use super::transformer::{Decoder, Encoder, Padding};
use super::weights::Networks;
use crate::config::NetworkConfig;
use crate::vocabulary::TokenBatch;

/// Number of learned tokens put before a sequence: one becomes the mean, the other the log variance.
pub(super) const NUM_TOKENS: usize = 2;

/// Puts learned tokens, `[2, d]`, before the sequences of a batch.
///
/// # Shapes
/// `x` `[B, T, d]`; the result `[B, 2 + T, d]`.
pub(super) fn with_tokens(tokens: &Param<Tensor<2>>, x: Tensor<3>) -> Tensor<3> {
    let [batch, _, width] = x.dims();
    let tokens = tokens.val().unsqueeze_dim::<3>(0);
    Tensor::cat(vec![tokens.expand([batch, NUM_TOKENS, width]), x], 1)
}

/// A normal distribution over the latent space.
#[derive(Clone, Debug)]
pub struct Distribution {
    /// Mean, `[B, d]`.
    pub mu: Tensor<2>,
    /// Logarithm of the variance, `[B, d]`.
    pub logvar: Tensor<2>,
}

impl Distribution {
    /// Takes mean and log variance from the encoded learned tokens.
    ///
    /// # Shapes
    /// `[B, 2 + T, d]`
    pub(super) fn of_tokens(encoded: &Tensor<3>) -> Self {
        let token = |index: usize| encoded.clone().narrow(1, index, 1).squeeze_dim::<2>(1);
        Self {
            mu: token(0),
            logvar: token(1),
        }
    }

    /// A sample, computed from standard normal noise.
    ///
    /// # Shapes
    /// `[B, d]`
    pub fn sample(&self, noise: Tensor<2>) -> Tensor<2> {
        self.mu.clone() + noise * self.logvar.clone().mul_scalar(0.5).exp()
    }

    /// The standard normal distribution of the same shape.
    pub fn standard(&self) -> Self {
        Self {
            mu: self.mu.zeros_like(),
            logvar: self.logvar.zeros_like(),
        }
    }

    /// The Kullback-Leibler divergence from `self` to `other`, averaged over batch and dimensions.
    ///
    /// # Shapes
    /// One number.
    pub fn kl(&self, other: &Self) -> Tensor<1> {
        let log_ratio = self.logvar.clone() - other.logvar.clone();
        let shift =
            (self.mu.clone() - other.mu.clone()).square() * other.logvar.clone().neg().exp();
        (log_ratio.clone().exp() + shift - log_ratio)
            .sub_scalar(1.0)
            .mul_scalar(0.5)
            .mean()
    }
}

/// A sequence encoder like that of ACTOR.
///
/// # Source
/// Petrovich et al. 2021 and 2023 (`algorithms` section 15).
#[derive(Module, Debug)]
pub struct SequenceEncoder {
    projection: Linear,
    tokens: Param<Tensor<2>>,
    sequence_encoder: Encoder,
    dropout: Dropout,
}

impl SequenceEncoder {
    /// Builds the encoder for sequences with `num_features` numbers per step.
    pub fn new(num_features: usize, config: &NetworkConfig, device: &Device) -> Self {
        Self {
            projection: LinearConfig::new(num_features, config.width).init(device),
            tokens: Initializer::Zeros.init([NUM_TOKENS, config.width], device),
            sequence_encoder: Encoder::new(config, device),
            dropout: DropoutConfig::new(config.dropout).init(),
        }
    }

    /// Encodes sequences.
    ///
    /// # Shapes
    /// `x` `[B, T, F]`; `lengths` `[B]`, the steps of each row that are not padding.
    pub fn forward(&self, x: Tensor<3>, lengths: &[usize], pass: &Pass) -> Distribution {
        let device = x.device();
        let x = with_tokens(&self.tokens, self.projection.forward(x));
        let [_, length, width] = x.dims();
        let x = x + positions(length, width, &device);
        let lengths: Vec<usize> = lengths.iter().map(|steps| NUM_TOKENS + steps).collect();
        let padding = Padding::where_shorter(&lengths, length);
        let x = pass.drop_out(&self.dropout, x);
        Distribution::of_tokens(&self.sequence_encoder.forward(x, padding.as_ref(), pass))
    }
}

/// A sequence decoder: queries made only of positional encodings attend to one latent vector.
#[derive(Module, Debug)]
pub struct SequenceDecoder {
    sequence_decoder: Decoder,
    final_layer: Linear,
    dropout: Dropout,
}

impl SequenceDecoder {
    /// Builds the decoder for sequences with `num_features` numbers per step.
    pub fn new(num_features: usize, config: &NetworkConfig, device: &Device) -> Self {
        Self {
            sequence_decoder: Decoder::new(config, device),
            final_layer: LinearConfig::new(config.width, num_features).init(device),
            dropout: DropoutConfig::new(config.dropout).init(),
        }
    }

    /// Decodes latent vectors to sequences of `steps` steps; steps after a row's length are zero.
    ///
    /// # Shapes
    /// `latent` `[B, d]`; the result `[B, steps, F]`.
    pub fn forward(
        &self,
        latent: Tensor<2>,
        lengths: &[usize],
        steps: usize,
        pass: &Pass,
    ) -> Tensor<3> {
        let [batch, width] = latent.dims();
        let device = latent.device();
        let queries = positions(steps, width, &device).expand([batch, steps, width]);
        let padding = Padding::where_shorter(lengths, steps);
        let x = self.sequence_decoder.forward(
            pass.drop_out(&self.dropout, queries),
            latent.unsqueeze_dim(1),
            padding.as_ref(),
            pass,
        );
        let x = self.final_layer.forward(x);
        match padding {
            None => x,
            Some(padding) => padding.clear(x),
        }
    }
}

/// Motion and text encoders, the motion decoder, and the word vectors trained with them.
#[derive(Module, Debug)]
pub struct Tmr {
    /// Encoder of motions.
    pub motion_encoder: SequenceEncoder,
    /// Encoder of word vectors.
    pub text_encoder: SequenceEncoder,
    /// Decoder of motions.
    pub motion_decoder: SequenceDecoder,
    words: Embedding,
}

impl Networks for Tmr {
    const FILE: &'static str = "tmr.safetensors";
}

impl Tmr {
    /// Builds the networks for motion frames of `num_features` numbers and `num_tokens` words with vectors of
    /// `word_width`. The width of the transformers is that of the latent space.
    pub fn new(
        config: &NetworkConfig,
        num_features: usize,
        [num_tokens, word_width]: [usize; 2],
        device: &Device,
    ) -> Self {
        Self {
            motion_encoder: SequenceEncoder::new(num_features, config, device),
            text_encoder: SequenceEncoder::new(word_width, config, device),
            motion_decoder: SequenceDecoder::new(num_features, config, device),
            words: EmbeddingConfig::new(num_tokens, word_width).init(device),
        }
    }

    /// Encodes texts.
    ///
    /// # Shapes
    /// `B` rows of tokens give distributions over `[B, d]`.
    pub fn encode_text(&self, tokens: &TokenBatch, pass: &Pass) -> Distribution {
        let lengths: Vec<usize> = tokens.lengths().map(|length| length.max(1)).collect();
        let ids = token_tensor(tokens, &self.words.weight.val().device());
        self.text_encoder
            .forward(self.words.forward(ids), &lengths, pass)
    }
}

/// The symmetric InfoNCE loss between texts and motions, which match row by row.
///
/// `ignored` marks pairs that are left out of the negatives: if two texts have the same meaning, their motions are
/// false negatives of each other.
///
/// # Shapes
/// `texts` and `motions` `[B, d]`; `ignored` `[B * B]` row-major; the result is one number.
///
/// # Source
/// Petrovich et al. 2023, Sec. 3.2 (`algorithms` section 15).
pub fn info_nce(
    texts: Tensor<2>,
    motions: Tensor<2>,
    temperature: f64,
    ignored: &[bool],
) -> Tensor<1> {
    let [batch, _] = texts.dims();
    let device = texts.device();
    let mut logits = cosine_similarity(texts, motions).div_scalar(temperature);
    if ignored.iter().any(|&ignored| ignored) {
        let mask = TensorData::new(ignored.to_vec(), [batch, batch]);
        let mask = Tensor::<2, Bool>::from_data(mask, &device);
        logits = logits.mask_fill(mask, f32::NEG_INFINITY);
    }
    // Matching pairs lie on the diagonal.
    let diagonal = Tensor::<2>::eye(batch, &device).bool();
    let matched = |logits: Tensor<2>, dim: usize| {
        let chances = log_softmax(logits, dim);
        chances
            .zeros_like()
            .mask_where(diagonal.clone(), chances)
            .sum()
    };
    (matched(logits.clone(), 1) + matched(logits, 0)).div_scalar(-2.0 * batch as f64)
}

/// Cosine similarities between all rows of two batches.
///
/// # Shapes
/// `[A, d]` and `[B, d]` give `[A, B]`.
pub fn cosine_similarity(a: Tensor<2>, b: Tensor<2>) -> Tensor<2> {
    // PyTorch's lower bound for a norm that is used as a divisor.
    const MIN_LENGTH: f64 = 1e-12;
    let unit = |x: Tensor<2>| {
        let length = x.clone().square().sum_dim(1).sqrt().clamp_min(MIN_LENGTH);
        x / length
    };
    unit(a).matmul(unit(b).transpose())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(values: &[f32], width: usize) -> Tensor<2> {
        let rows = values.len() / width;
        Tensor::from_data(
            TensorData::new(values.to_vec(), [rows, width]),
            &Device::flex(),
        )
    }

    #[test]
    fn the_divergence_of_shifted_normals_is_half_the_squared_shift() {
        let q = Distribution {
            mu: rows(&[2.0, 0.0], 1),
            logvar: rows(&[0.0, 0.0], 1),
        };
        let kl: f32 = q.kl(&q.standard()).into_scalar();
        assert!((kl - 1.0).abs() < 1e-6);
        assert_eq!(q.kl(&q).into_scalar::<f32>(), 0.0);
    }

    #[test]
    fn orthogonal_pairs_leave_the_softmax_of_one_against_zero() {
        let x = rows(&[1.0, 0.0, 0.0, 1.0], 2);
        let none = [false; 4];
        let loss: f32 = info_nce(x.clone(), x.clone(), 1.0, &none).into_scalar();
        // -ln(e / (e + 1))
        assert!((loss - (1.0f32 + (-1.0f32).exp()).ln()).abs() < 1e-6);
        let ignored = [false, true, true, false];
        let alone: f32 = info_nce(x.clone(), x, 1.0, &ignored).into_scalar();
        assert!(alone.abs() < 1e-6, "no negative is left");
    }
}
