//! The text tower of CLIP.

use std::path::Path;

use burn::module::Module;
use burn::nn::{Embedding, EmbeddingConfig, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::sigmoid;
use burn::tensor::module::attention;
use burn::tensor::ops::AttentionModuleOptions;
use burn::tensor::{Device, Int, Tensor, TensorData};
use safetensors::SafeTensors;

use super::text::token_tensor;
use super::torch::{StoredTensor, float_tensor, safetensors_of};
use super::transformer::{join_heads, split_heads};
use super::weights::from_safetensors_named;
use crate::Error;
use crate::vocabulary::TokenBatch;

/// Patterns in the tensor names of Hugging Face's `CLIPTextModelWithProjection`, which `CLIPModel` also uses, and their
/// replacements in our names.
const RENAMES: [(&str, &str); 3] = [
    (r"^text_model\.embeddings\.", ""),
    (r"^text_model\.encoder\.", ""),
    (r"^text_model\.", ""),
];

/// Prefixes of the text tower's tensors; files may also contain the vision tower.
const TEXT_TOWER: [&str; 2] = ["text_model.", "text_projection."];

/// End token in older configurations, which did not record the real one. The reference then takes the largest token
/// number of a row, which is the end token of CLIP's vocabulary.
const LEGACY_END_TOKEN: usize = 2;

/// Factor in the sigmoid of CLIP's approximation of GELU.
const QUICK_GELU_SLOPE: f64 = 1.702;

/// Sizes of a text tower.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClipConfig {
    /// Number of tokens in the vocabulary.
    pub num_tokens: usize,
    /// Maximum number of tokens in a row, including start and end token.
    pub context: usize,
    /// Width of a token.
    pub width: usize,
    /// Number of transformer layers.
    pub num_layers: usize,
    /// Number of attention heads.
    pub num_heads: usize,
    /// Hidden width of the feed-forward layers.
    pub feed_forward: usize,
    /// Width of the projected text.
    pub projection: usize,
    /// Number of the end token; 2 stands for the largest token number of a row.
    pub end_token: usize,
}

impl ClipConfig {
    /// The text tower of ViT-B/32.
    ///
    /// # Source
    /// Radford et al. 2021, Table 19; `openai/clip-vit-base-patch32`.
    pub fn vit_b_32() -> Self {
        Self {
            num_tokens: 49_408,
            context: 77,
            width: 512,
            num_layers: 12,
            num_heads: 8,
            feed_forward: 2048,
            projection: 512,
            end_token: 49_407,
        }
    }

    /// The text tower of ViT-L/14, which TMED and MLD use.
    ///
    /// # Source
    /// Radford et al. 2021, Table 19; `openai/clip-vit-large-patch14`.
    pub fn vit_l_14() -> Self {
        Self {
            width: 768,
            num_heads: 12,
            feed_forward: 3072,
            projection: 768,
            ..Self::vit_b_32()
        }
    }
}

/// CLIP's text tower with its projection, for inference: a pre-norm transformer with causal attention.
///
/// # Source
/// Radford et al. 2021, Sec. 2.4; parameters and names are those of Hugging Face's
/// `CLIPTextModelWithProjection`.
#[derive(Module, Debug)]
pub struct ClipText {
    token_embedding: Embedding,
    position_embedding: Embedding,
    layers: Vec<ClipLayer>,
    final_layer_norm: LayerNorm,
    text_projection: Linear,
    context: usize,
    end_token: usize,
}

impl ClipText {
    /// Builds the network with placeholder weights; [`ClipText::from_safetensors`] loads real ones.
    pub fn new(config: &ClipConfig, device: &Device) -> Self {
        Self {
            token_embedding: EmbeddingConfig::new(config.num_tokens, config.width).init(device),
            position_embedding: EmbeddingConfig::new(config.context, config.width).init(device),
            layers: (0..config.num_layers)
                .map(|_| ClipLayer::new(config, device))
                .collect(),
            final_layer_norm: LayerNormConfig::new(config.width).init(device),
            text_projection: LinearConfig::new(config.width, config.projection)
                .with_bias(false)
                .init(device),
            context: config.context,
            end_token: config.end_token,
        }
    }

    /// Builds the network with the weights of a safetensors file whose names are `prefix` followed by Hugging Face's.
    /// Weights of half and double precision are converted to single precision, and tensors of the vision tower are
    /// ignored. `path` names the file in errors.
    ///
    /// # Errors
    /// The file is malformed, or a tensor is missing or of another shape.
    pub fn from_safetensors(
        config: &ClipConfig,
        bytes: &[u8],
        prefix: &str,
        path: &Path,
        device: &Device,
    ) -> Result<Self, Error> {
        let file = SafeTensors::deserialize(bytes).map_err(|error| Error::weights(path, error))?;
        let tower: Vec<(String, StoredTensor)> = file
            .iter()
            .filter_map(|(name, view)| Some((name.strip_prefix(prefix)?, view)))
            .filter(|(name, _)| TEXT_TOWER.iter().any(|part| name.starts_with(part)))
            // Older files store position indices as a tensor, which is not a parameter.
            .filter(|(name, _)| !name.ends_with("position_ids"))
            .map(|(name, view)| Ok((name.to_owned(), float_tensor(name, &view, path)?)))
            .collect::<Result<_, Error>>()?;
        let tower = safetensors_of(tower, path)?;
        let mut network = Self::new(config, device);
        from_safetensors_named(&mut network, tower, "", path, &RENAMES)?;
        Ok(network.no_grad())
    }

    /// Width of an encoded text.
    pub fn width(&self) -> usize {
        let [_, width] = self.text_projection.weight.shape().dims();
        width
    }

    /// Width of a token.
    pub fn token_width(&self) -> usize {
        let [width, _] = self.text_projection.weight.shape().dims();
        width
    }

    /// Number of tokens in each row up to and including its end token.
    pub(crate) fn lengths(&self, tokens: &TokenBatch) -> Vec<usize> {
        let rows = tokens.ids.chunks_exact(tokens.width);
        rows.map(|ids| 1 + end_place(ids, self.end_token)).collect()
    }

    /// Maximum number of tokens in a row.
    pub fn context(&self) -> usize {
        self.context
    }

    /// Encodes texts: the projected vector of each end token, not normalised.
    ///
    /// Attention is causal, so rows may be padded with any tokens after their end token, and the batch may be truncated
    /// to the longest row.
    ///
    /// # Shapes
    /// `B` rows of tokens give `[B, d]`.
    ///
    /// # Panics
    /// If rows are longer than the context.
    pub fn forward(&self, tokens: &TokenBatch) -> Tensor<2> {
        self.project(self.hidden(tokens), tokens)
    }

    /// The output of the last norm for every token.
    ///
    /// # Shapes
    /// `B` rows of `T` tokens give `[B, T, d]`.
    ///
    /// # Panics
    /// If rows are longer than the context.
    pub fn hidden(&self, tokens: &TokenBatch) -> Tensor<3> {
        assert!(
            tokens.width <= self.context,
            "rows of {} tokens in a context of {}",
            tokens.width,
            self.context
        );
        let device = self.token_embedding.weight.val().device();
        let words = self.token_embedding.forward(token_tensor(tokens, &device));
        let places = self.position_embedding.weight.val();
        let places = places.narrow(0, 0, tokens.width);
        let mut x = words + places.unsqueeze_dim(0);
        for layer in &self.layers {
            x = layer.forward(x);
        }
        self.final_layer_norm.forward(x)
    }

    /// Projects the end token of each row; the input is the result of [`ClipText::hidden`].
    ///
    /// # Shapes
    /// `[B, T, d]` gives `[B, d]`.
    pub fn project(&self, hidden: Tensor<3>, tokens: &TokenBatch) -> Tensor<2> {
        let [batch, width, d] = hidden.dims();
        let places: Vec<i32> = tokens
            .ids
            .chunks_exact(width)
            .enumerate()
            .map(|(row, ids)| (row * width + end_place(ids, self.end_token)) as i32)
            .collect();
        let places = TensorData::new(places, [batch]);
        let places = Tensor::<1, Int>::from_data(places, &hidden.device());
        let ends = hidden.reshape([batch * width, d]).select(0, places);
        self.text_projection.forward(ends)
    }
}

/// Position of a row's first end token; 0 if it has none.
fn end_place(ids: &[i32], end_token: usize) -> usize {
    let end = if end_token == LEGACY_END_TOKEN {
        ids.iter().copied().max()
    } else {
        i32::try_from(end_token).ok()
    };
    ids.iter().position(|&id| Some(id) == end).unwrap_or(0)
}

#[derive(Module, Debug)]
struct ClipLayer {
    self_attn: ClipAttention,
    layer_norm1: LayerNorm,
    mlp: ClipMlp,
    layer_norm2: LayerNorm,
}

impl ClipLayer {
    fn new(config: &ClipConfig, device: &Device) -> Self {
        Self {
            self_attn: ClipAttention::new(config, device),
            layer_norm1: LayerNormConfig::new(config.width).init(device),
            mlp: ClipMlp {
                fc1: LinearConfig::new(config.width, config.feed_forward).init(device),
                fc2: LinearConfig::new(config.feed_forward, config.width).init(device),
            },
            layer_norm2: LayerNormConfig::new(config.width).init(device),
        }
    }

    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let normed = self.layer_norm1.forward(x.clone());
        let x = x + self.self_attn.forward(normed);
        let normed = self.layer_norm2.forward(x.clone());
        x + self.mlp.forward(normed)
    }
}

/// Causal multi-head self-attention: a token attends to itself and earlier tokens.
#[derive(Module, Debug)]
struct ClipAttention {
    q_proj: Linear,
    k_proj: Linear,
    v_proj: Linear,
    out_proj: Linear,
    num_heads: usize,
}

impl ClipAttention {
    fn new(config: &ClipConfig, device: &Device) -> Self {
        let linear = || LinearConfig::new(config.width, config.width).init(device);
        Self {
            q_proj: linear(),
            k_proj: linear(),
            v_proj: linear(),
            out_proj: linear(),
            num_heads: config.num_heads,
        }
    }

    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let heads = |layer: &Linear| split_heads(layer.forward(x.clone()), self.num_heads);
        let options = AttentionModuleOptions {
            is_causal: true,
            ..Default::default()
        };
        let attended = attention(
            heads(&self.q_proj),
            heads(&self.k_proj),
            heads(&self.v_proj),
            None,
            None,
            options,
        );
        self.out_proj.forward(join_heads(attended))
    }
}

#[derive(Module, Debug)]
struct ClipMlp {
    fc1: Linear,
    fc2: Linear,
}

impl ClipMlp {
    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let hidden = self.fc1.forward(x);
        // The activation is x * sigmoid(1.702 x), with which CLIP was trained, rather than the exact GELU.
        let gate = sigmoid(hidden.clone().mul_scalar(QUICK_GELU_SLOPE));
        self.fc2.forward(hidden * gate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_ends_at_its_first_end_token() {
        assert_eq!(end_place(&[8, 3, 9, 9, 9], 9), 2);
        assert_eq!(end_place(&[8, 3, 9, 0, 0], 9), 2);
        assert_eq!(end_place(&[8, 2, 9, 0, 0], 9), 2);
        assert_eq!(end_place(&[8, 3, 0, 0, 0], 9), 0);
        // The legacy end token 2 means "the largest token number", even if token 2 itself comes first.
        assert_eq!(end_place(&[8, 2, 9, 9, 9], 2), 2);
        assert_eq!(end_place(&[8, 2, 9, 0, 0], 2), 2);
    }

    #[test]
    fn the_published_sizes_are_those_of_the_paper() {
        // The text tower of ViT-B/32 has 63 million parameters (Radford et al. 2021, Sec. 2.4), plus its projection.
        let parameters = |config: &ClipConfig| {
            let d = config.width;
            let layer = 4 * (d * d + d) + 2 * d * config.feed_forward + config.feed_forward + 5 * d;
            (config.num_tokens + config.context) * d
                + config.num_layers * layer
                + 2 * d
                + d * config.projection
        };
        assert_eq!(parameters(&ClipConfig::vit_b_32()), 63_428_096);
        assert_eq!(parameters(&ClipConfig::vit_l_14()), 123_650_304);
    }
}
