//! The networks of BERT and DistilBERT.

use std::path::Path;

use burn::module::Module;
use burn::nn::{Embedding, EmbeddingConfig, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::{gelu, gelu_approximate, relu};
use burn::tensor::module::attention;
use burn::tensor::ops::AttentionModuleOptions;
use burn::tensor::{Device, Tensor};
use safetensors::SafeTensors;
use serde::Deserialize;

use crate::Error;
use crate::error::json_error;
use crate::model::text::token_tensor;
use crate::model::torch::{StoredTensor, float_tensor, safetensors_of};
use crate::model::transformer::{Padding, join_heads, split_heads};
use crate::model::weights::from_safetensors;
use crate::vocabulary::TokenBatch;

/// Prefixes of tensor names: none for the bare network, or one for a network with a head.
const PREFIXES: [&str; 4] = ["", "bert.", "distilbert.", "model."];
const WORDS: &str = "embeddings.word_embeddings.weight";
/// Names of the parts of a layer: ours, BERT's, and DistilBERT's.
const PARTS: [(&str, &str, &str); 8] = [
    ("query", "attention.self.query", "attention.q_lin"),
    ("key", "attention.self.key", "attention.k_lin"),
    ("value", "attention.self.value", "attention.v_lin"),
    ("attended", "attention.output.dense", "attention.out_lin"),
    (
        "attention_norm",
        "attention.output.LayerNorm",
        "sa_layer_norm",
    ),
    ("hidden", "intermediate.dense", "ffn.lin1"),
    ("output", "output.dense", "ffn.lin2"),
    ("output_norm", "output.LayerNorm", "output_layer_norm"),
];

/// Supported networks. They differ in tensor names, and DistilBERT has no segment embeddings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum BertKind {
    /// Also the kind of MiniLM.
    #[default]
    Bert,
    DistilBert,
}

/// Activation of the feed-forward layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Activation {
    #[default]
    Gelu,
    GeluTanh,
    Relu,
}

/// Sizes of a network from its `config.json`, whose fields the two kinds name differently.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(super) struct BertConfig {
    /// Set from `model_type` by [`BertConfig::parse`].
    #[serde(skip)]
    kind: BertKind,
    #[serde(rename = "vocab_size")]
    pub(super) num_tokens: usize,
    /// Maximum number of tokens in a row, including start and end.
    #[serde(rename = "max_position_embeddings")]
    pub(super) context: usize,
    /// Number of segments for pairs of texts; none for DistilBERT.
    #[serde(rename = "type_vocab_size", default = "two_segments")]
    num_segments: usize,
    #[serde(rename = "hidden_size", alias = "dim")]
    pub(super) width: usize,
    #[serde(rename = "num_hidden_layers", alias = "n_layers")]
    num_layers: usize,
    #[serde(rename = "num_attention_heads", alias = "n_heads")]
    pub(super) num_heads: usize,
    #[serde(rename = "intermediate_size", alias = "hidden_dim")]
    feed_forward: usize,
    /// Name of the activation in the file, from which `activation` is set.
    #[serde(alias = "activation")]
    hidden_act: String,
    #[serde(skip)]
    pub(super) activation: Activation,
    /// Added to the variance in layer norms.
    #[serde(rename = "layer_norm_eps", default = "tiny_epsilon")]
    pub(super) norm_epsilon: f64,
    /// Only `absolute` is accepted.
    position_embedding_type: Option<String>,
}

fn two_segments() -> usize {
    2
}

fn tiny_epsilon() -> f64 {
    1e-12
}

impl BertConfig {
    /// Reads a `config.json`; `path` names the file in errors.
    pub(super) fn parse(document: &[u8], path: &Path) -> Result<Self, Error> {
        #[derive(Deserialize)]
        struct Named {
            model_type: Option<String>,
        }
        let json = json_error(path);
        let refused = |detail: String| Error::text_model(path, detail);
        let named: Named = serde_json::from_slice(document).map_err(json)?;
        let kind = match named.model_type.as_deref() {
            Some("bert") => BertKind::Bert,
            Some("distilbert") => BertKind::DistilBert,
            Some(other) => {
                let problem = format!("model_type is {other}; bert and distilbert are known");
                return Err(refused(problem));
            }
            None => return Err(refused("it has no model_type".to_owned())),
        };
        let mut config: Self = serde_json::from_slice(document).map_err(json)?;
        let position = config.position_embedding_type.as_deref();
        if position.is_some_and(|position| position != "absolute") {
            let problem = "position_embedding_type is not absolute".to_owned();
            return Err(refused(problem));
        }
        config.activation = match config.hidden_act.as_str() {
            "gelu" => Activation::Gelu,
            "gelu_new" | "gelu_fast" | "gelu_pytorch_tanh" => Activation::GeluTanh,
            "relu" => Activation::Relu,
            other => return Err(refused(format!("activation {other} is not known"))),
        };
        let (width, heads) = (config.width, config.num_heads);
        if heads == 0 || width == 0 || !width.is_multiple_of(heads) {
            let problem = format!("its width is {width}, and it has {heads} attention heads");
            return Err(refused(problem));
        }
        config.kind = kind;
        if kind == BertKind::DistilBert {
            config.num_segments = 0;
        }
        Ok(config)
    }

    /// The tensors of the network: their names in the file and in this program, and their shapes in PyTorch.
    fn tensors(&self) -> Vec<(String, String, Vec<usize>)> {
        let (width, hidden) = (self.width, self.feed_forward);
        let mut found = Vec::new();
        let mut table = |theirs: &str, ours: &str, rows: usize| {
            found.push((theirs.to_owned(), ours.to_owned(), vec![rows, width]));
        };
        table(WORDS, "words.weight", self.num_tokens);
        let places = "embeddings.position_embeddings.weight";
        table(places, "places.weight", self.context);
        if self.num_segments > 0 {
            let segments = "embeddings.token_type_embeddings.weight";
            table(segments, "segments.weight", self.num_segments);
        }
        let mut part = |theirs: String, ours: String, weight: Vec<usize>| {
            let bias = (
                format!("{theirs}.bias"),
                format!("{ours}.bias"),
                vec![weight[0]],
            );
            found.push((format!("{theirs}.weight"), format!("{ours}.weight"), weight));
            found.push(bias);
        };
        let norm = "embeddings.LayerNorm".to_owned();
        part(norm, "norm".to_owned(), vec![width]);
        for layer in 0..self.num_layers {
            for (ours, bert, distilbert) in PARTS {
                let theirs = match self.kind {
                    BertKind::Bert => format!("encoder.layer.{layer}.{bert}"),
                    BertKind::DistilBert => format!("transformer.layer.{layer}.{distilbert}"),
                };
                let weight = match ours {
                    "attention_norm" | "output_norm" => vec![width],
                    "hidden" => vec![hidden, width],
                    "output" => vec![width, hidden],
                    _ => vec![width, width],
                };
                part(theirs, format!("layers.{layer}.{ours}"), weight);
            }
        }
        found
    }
}

/// BERT or DistilBERT without heads, for inference: a post-norm transformer in which every token attends to all tokens.
///
/// # Source
/// Devlin et al. 2019, Sec. 3, and Sanh et al. 2019; parameters are those of Hugging Face's `BertModel` and
/// `DistilBertModel`.
#[derive(Module, Debug)]
pub(super) struct BertText {
    words: Embedding,
    places: Embedding,
    segments: Option<Embedding>,
    norm: LayerNorm,
    layers: Vec<BertLayer>,
}

impl BertText {
    /// Builds the network with placeholder weights.
    pub(super) fn new(config: &BertConfig, device: &Device) -> Self {
        let table = |rows| EmbeddingConfig::new(rows, config.width).init(device);
        Self {
            words: table(config.num_tokens),
            places: table(config.context),
            segments: (config.num_segments > 0).then(|| table(config.num_segments)),
            norm: norm(config, device),
            layers: (0..config.num_layers)
                .map(|_| BertLayer::new(config, device))
                .collect(),
        }
    }

    /// Builds the network and loads its weights from a safetensors file. Tensors have Hugging Face's names, with or
    /// without a prefix such as `bert.`; others, such as those of a head, are ignored. Weights of half and double
    /// precision are converted to single precision. `path` names the file in errors.
    pub(super) fn from_safetensors(
        config: &BertConfig,
        bytes: &[u8],
        path: &Path,
        device: &Device,
    ) -> Result<Self, Error> {
        let file = SafeTensors::deserialize(bytes).map_err(|error| Error::weights(path, error))?;
        let prefix = PREFIXES
            .into_iter()
            .find(|prefix| file.tensor(&format!("{prefix}{WORDS}")).is_ok())
            .ok_or_else(|| Error::weights(path, format!("{WORDS} is missing")))?;
        let mut tensors: Vec<(String, StoredTensor)> = Vec::new();
        for (theirs, ours, shape) in config.tensors() {
            let name = format!("{prefix}{theirs}");
            let found = file.tensor(&name).or_else(|_| file.tensor(&former(&name)));
            let Ok(view) = found else {
                return Err(Error::weights(path, format!("{name} is missing")));
            };
            if view.shape() != shape {
                let problem = format!("{name} is {:?}, not {shape:?}", view.shape());
                return Err(Error::weights(path, problem));
            }
            tensors.push((ours, float_tensor(&name, &view, path)?));
        }
        let mut network = Self::new(config, device);
        from_safetensors(&mut network, safetensors_of(tensors, path)?, "", path)?;
        Ok(network.no_grad())
    }

    /// The output of the last layer for every token. Tokens after a row's length are masked, and their own outputs are
    /// meaningless.
    ///
    /// # Shapes
    /// `B` rows of `T` tokens give `[B, T, d]`; `lengths` `[B]`.
    ///
    /// # Panics
    /// If rows are longer than the context.
    ///
    /// # Source
    /// `last_hidden_state` of the reference, with all texts in the first segment.
    pub(super) fn hidden(
        &self,
        config: &BertConfig,
        tokens: &TokenBatch,
        lengths: &[usize],
    ) -> Tensor<3> {
        let device = self.words.weight.val().device();
        let words = self.words.forward(token_tensor(tokens, &device));
        let [_, length, _] = words.dims();
        let places = self.places.weight.val().narrow(0, 0, length);
        let mut x = words + places.unsqueeze_dim::<3>(0);
        if let Some(segments) = &self.segments {
            let first = segments.weight.val().narrow(0, 0, 1);
            x = x + first.unsqueeze_dim::<3>(0);
        }
        let padding = Padding::where_shorter(lengths, length);
        self.layers.iter().fold(self.norm.forward(x), |x, layer| {
            layer.forward(config, x, padding.as_ref())
        })
    }
}

/// The name of a layer norm's weight or bias in files converted from TensorFlow.
fn former(name: &str) -> String {
    name.replace("LayerNorm.weight", "LayerNorm.gamma")
        .replace("LayerNorm.bias", "LayerNorm.beta")
}

fn norm(config: &BertConfig, device: &Device) -> LayerNorm {
    LayerNormConfig::new(config.width)
        .with_epsilon(config.norm_epsilon)
        .init(device)
}

#[derive(Module, Debug)]
struct BertLayer {
    query: Linear,
    key: Linear,
    value: Linear,
    attended: Linear,
    attention_norm: LayerNorm,
    hidden: Linear,
    output: Linear,
    output_norm: LayerNorm,
}

impl BertLayer {
    fn new(config: &BertConfig, device: &Device) -> Self {
        let linear = |from, to| LinearConfig::new(from, to).init(device);
        let (width, hidden) = (config.width, config.feed_forward);
        Self {
            query: linear(width, width),
            key: linear(width, width),
            value: linear(width, width),
            attended: linear(width, width),
            attention_norm: norm(config, device),
            hidden: linear(width, hidden),
            output: linear(hidden, width),
            output_norm: norm(config, device),
        }
    }

    fn forward(&self, config: &BertConfig, x: Tensor<3>, padding: Option<&Padding>) -> Tensor<3> {
        let heads = |layer: &Linear| split_heads(layer.forward(x.clone()), config.num_heads);
        let attended = attention(
            heads(&self.query),
            heads(&self.key),
            heads(&self.value),
            padding.map(|padding| padding.of_attention(config.num_heads, &x.device())),
            None,
            AttentionModuleOptions::default(),
        );
        let attended = self.attended.forward(join_heads(attended));
        let x = self.attention_norm.forward(x.clone() + attended);
        let hidden = self.hidden.forward(x.clone());
        let hidden = match config.activation {
            Activation::Gelu => gelu(hidden),
            Activation::GeluTanh => gelu_approximate(hidden),
            Activation::Relu => relu(hidden),
        };
        self.output_norm.forward(x + self.output.forward(hidden))
    }
}
