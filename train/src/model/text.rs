//! The text encoder that is trained with a model.

use burn::module::Module;
use burn::nn::{Embedding, EmbeddingConfig, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::{gelu, sigmoid};
use burn::tensor::{Device, Int, Tensor, TensorData};

use super::denoiser::TEXT_DIVISOR;
use super::position::positions;
use super::weights::Networks;
use crate::transfer::send;
use crate::vocabulary::{PADDING, TokenBatch};

/// Encodes the words of a text as one vector: an average of word vectors with positional encoding, each weighted by a
/// gate.
///
/// It needs no download and no pretraining, and averaging gives short and long instructions vectors of similar size.
/// The vector is multiplied by the denoiser's text divisor, so that initially text and diffusion step have the same
/// scale.
#[derive(Module, Debug)]
pub struct LearnedText {
    embedding: Embedding,
    value: Linear,
    gate: Linear,
    norm: LayerNorm,
    output: Linear,
}

impl Networks for LearnedText {
    const FILE: &'static str = "text.safetensors";
}

impl LearnedText {
    /// Builds the encoder.
    pub fn new(num_tokens: usize, width: usize, device: &Device) -> Self {
        Self {
            embedding: EmbeddingConfig::new(num_tokens, width).init(device),
            value: LinearConfig::new(width, width).init(device),
            gate: LinearConfig::new(width, width).init(device),
            norm: LayerNormConfig::new(width).init(device),
            output: LinearConfig::new(width, width).init(device),
        }
    }

    /// Encodes texts.
    ///
    /// # Shapes
    /// `B` rows of tokens give `[B, d]`.
    pub fn forward(&self, tokens: &TokenBatch) -> Tensor<2> {
        let device = self.embedding.weight.val().device();
        let ids = token_tensor(tokens, &device);
        let kept = ids.clone().not_equal_scalar(PADDING).float();
        // A row of only padding counts as one position, so that nothing is divided by zero.
        let count = kept.clone().sum_dim(1).clamp_min(1.0);

        let words = self.embedding.forward(ids);
        let [_, width, d] = words.dims();
        let words = words + positions(width, d, &device);
        let weighed = gelu(self.value.forward(words.clone())) * sigmoid(self.gate.forward(words));
        let sum = (weighed * kept.unsqueeze_dim::<3>(2))
            .sum_dim(1)
            .squeeze_dim::<2>(1);
        let text = self.norm.forward(sum / count);
        self.output.forward(text).mul_scalar(TEXT_DIVISOR)
    }
}

/// Texts in the form that a network takes.
#[derive(Clone, Debug, PartialEq)]
pub enum TextBatch {
    /// Word numbers of the texts.
    Words(TokenBatch),
    /// The vectors of a frozen encoder.
    Vectors {
        /// The vectors of each text's tokens, `[B, N, d]`, zero after its end; N is 1 if each text has one vector.
        values: Vec<f32>,
        /// Number of tokens in each text, `[B]`.
        lengths: Vec<usize>,
    },
}

impl TextBatch {
    /// Number of tokens in each text, `[B]`.
    pub fn lengths(&self) -> Vec<usize> {
        match self {
            Self::Words(tokens) => tokens.lengths().collect(),
            Self::Vectors { lengths, .. } => lengths.clone(),
        }
    }
}

/// The vectors of texts: stored vectors of a frozen encoder, or for words the output of the encoder trained with the
/// model.
///
/// # Shapes
/// `rows` texts give `[B, d]`.
///
/// # Panics
/// If words are given to a model without a learned encoder.
pub(crate) fn text_vectors(
    learned: Option<&LearnedText>,
    texts: &TextBatch,
    rows: usize,
    device: &Device,
) -> Tensor<2> {
    match texts {
        TextBatch::Words(tokens) => learned
            .expect("words are given to a model that learns them")
            .forward(tokens),
        TextBatch::Vectors { values, .. } => {
            send(values.clone(), [rows, values.len() / rows.max(1)], device)
        }
    }
}

/// Token numbers on a device.
///
/// # Shapes
/// `[B, T]`
pub(crate) fn token_tensor(tokens: &TokenBatch, device: &Device) -> Tensor<2, Int> {
    let rows = tokens.ids.len() / tokens.width;
    let ids = TensorData::new(tokens.ids.clone(), [rows, tokens.width]);
    Tensor::from_data(ids, device)
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;

    use super::*;
    use crate::model::weights::draw;
    use crate::transfer::read;
    use crate::vocabulary::Vocabulary;

    #[test]
    fn a_text_does_not_feel_its_neighbours_padding() {
        let device = Device::flex();
        let vocabulary = Vocabulary::build(["raise the left arm slowly"], 2, 8).expect("valid");
        let encoder = draw(
            LearnedText::new(vocabulary.num_tokens(), 8, &device),
            Seed(3),
        )
        .expect("known layers");
        let encode =
            |texts: &[&str]| read(encoder.forward(&vocabulary.encode_batch(texts.iter().copied())));
        let alone = encode(&["left arm"]);
        let beside = encode(&["left arm", "raise the left arm slowly"]);
        for (a, b) in alone.iter().zip(&beside) {
            // Sums of five f32 products in another order.
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
        assert_ne!(encode(&["left arm"]), encode(&["arm left"]));
    }
}
