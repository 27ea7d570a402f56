//! The networks of MLD: an autoencoder between motions and single latent vectors, and a denoiser of latent vectors.

use burn::module::{Initializer, Module, Param};
use burn::nn::{Linear, LinearConfig};
use burn::tensor::activation::{relu, silu};
use burn::tensor::{Device, Tensor};

use super::pass::Pass;
use super::position::Tables;
use super::skip::{SkipDecoder, SkipEncoder};
use super::tmr::{Distribution, NUM_TOKENS, with_tokens};
use super::transformer::Padding;
use super::weights::Networks;
use crate::config::NetworkConfig;

/// Number of positions in the released tables.
pub(crate) const MAX_POSITIONS: usize = 500;

#[derive(Module, Debug)]
struct LearnedPositions {
    pe: Param<Tensor<3>>,
}

impl LearnedPositions {
    fn new(positions: usize, width: usize, device: &Device) -> Self {
        Self {
            pe: Initializer::Zeros.init([positions, 1, width], device),
        }
    }

    /// The first `length` rows, `[1, length, d]`.
    fn rows(&self, length: usize) -> Tensor<3> {
        self.pe.val().narrow(0, 0, length).swap_dims(0, 1)
    }
}

/// The autoencoder of motions.
///
/// # Source
/// Chen et al. 2023, Sec. 3.1; the layout and the names are those of the released code with one latent
/// token (`algorithms` section 14).
#[derive(Module, Debug)]
pub struct MotionVae {
    skel_embedding: Linear,
    global_motion_token: Param<Tensor<2>>,
    query_pos_encoder: LearnedPositions,
    query_pos_decoder: LearnedPositions,
    encoder: SkipEncoder,
    decoder: SkipDecoder,
    final_layer: Linear,
}

impl Networks for MotionVae {
    const FILE: &'static str = "autoencoder.safetensors";
}

impl MotionVae {
    /// Builds the networks for frames of `num_features` numbers, with position tables of the given size.
    pub fn new(
        config: &NetworkConfig,
        num_features: usize,
        positions: usize,
        device: &Device,
    ) -> Self {
        let table = || LearnedPositions::new(positions, config.width, device);
        Self {
            skel_embedding: LinearConfig::new(num_features, config.width).init(device),
            global_motion_token: Initializer::Zeros.init([NUM_TOKENS, config.width], device),
            query_pos_encoder: table(),
            query_pos_decoder: table(),
            encoder: SkipEncoder::encoder(config, device),
            decoder: SkipDecoder::decoder(config, device),
            final_layer: LinearConfig::new(config.width, num_features).init(device),
        }
    }

    /// Encodes motions.
    ///
    /// # Shapes
    /// `x` `[B, T, F]`; `lengths` `[B]`, the frames of each row that are not padding.
    pub fn encode(&self, x: Tensor<3>, lengths: &[usize], pass: &Pass) -> Distribution {
        let [_, frames, _] = x.dims();
        let x = self.skel_embedding.forward(x);
        let length = NUM_TOKENS + frames;
        let x = with_tokens(&self.global_motion_token, x) + self.query_pos_encoder.rows(length);
        let lengths: Vec<usize> = lengths.iter().map(|frames| NUM_TOKENS + frames).collect();
        let padding = Padding::after(&lengths, length);
        Distribution::of_tokens(&self.encoder.encode(x, Some(&padding), pass))
    }

    /// Decodes latent vectors to motions of `frames` frames; frames after a row's length are zero.
    ///
    /// # Shapes
    /// `latent` `[B, d]`; `lengths` `[B]`; the result `[B, frames, F]`.
    pub fn decode(
        &self,
        latent: Tensor<2>,
        lengths: &[usize],
        frames: usize,
        pass: &Pass,
    ) -> Tensor<3> {
        let [batch, width] = latent.dims();
        let queries = self
            .query_pos_decoder
            .rows(frames)
            .expand([batch, frames, width]);
        let padding = Padding::after(lengths, frames);
        let x = self
            .decoder
            .decode(queries, &latent.unsqueeze_dim(1), Some(&padding), pass);
        padding.clear(self.final_layer.forward(x))
    }
}

/// Two layers that map the sinusoid of a diffusion step to a token.
#[derive(Module, Debug)]
struct TimeEmbedding {
    linear_1: Linear,
    linear_2: Linear,
}

/// The denoiser of latent vectors: a transformer over the tokens `[latent | diffusion step | text]`.
///
/// # Source
/// Chen et al. 2023, Sec. 3.2; the layout and the names are those of the released code
/// (`algorithms` section 14).
#[derive(Module, Debug)]
pub struct LatentDenoiser {
    time_embedding: TimeEmbedding,
    text_emb_proj: Linear,
    query_pos: LearnedPositions,
    encoder: SkipEncoder,
}

impl Networks for LatentDenoiser {
    const FILE: &'static str = "denoiser.safetensors";
}

impl LatentDenoiser {
    /// Builds the network for text vectors of `text_width` numbers, with a position table of the given size.
    pub fn new(
        config: &NetworkConfig,
        text_width: usize,
        positions: usize,
        device: &Device,
    ) -> Self {
        let linear = |from, to| LinearConfig::new(from, to).init(device);
        Self {
            // As in the released code, the sinusoidal embedding of the timestep has the width of the text vectors.
            time_embedding: TimeEmbedding {
                linear_1: linear(text_width, config.width),
                linear_2: linear(config.width, config.width),
            },
            text_emb_proj: linear(text_width, config.width),
            query_pos: LearnedPositions::new(positions, config.width, device),
            encoder: SkipEncoder::encoder(config, device),
        }
    }

    /// Predicts the noise in latent vectors.
    ///
    /// # Shapes
    /// `z` and the result `[B, d]`; `timesteps` `[B]`; `text` `[B, text_width]`.
    pub fn forward(
        &self,
        z: Tensor<2>,
        timesteps: &[usize],
        text: Tensor<2>,
        pass: &Pass,
    ) -> Tensor<2> {
        let [_, text_width] = text.dims();
        let time = step_sinusoid(timesteps, text_width, &z.device());
        let embedding = &self.time_embedding;
        let time = embedding
            .linear_2
            .forward(silu(embedding.linear_1.forward(time)));
        let text = self.text_emb_proj.forward(relu(text));
        let tokens = Tensor::stack::<3>(vec![z, time, text], 1);
        let [_, length, _] = tokens.dims();
        let tokens = tokens + self.query_pos.rows(length);
        let encoded = self.encoder.encode(tokens, None, pass);
        encoded.narrow(1, 0, 1).squeeze_dim(1)
    }
}

/// The sinusoids of diffusion steps in the layout of diffusers: all cosines, then all sines.
///
/// # Shapes
/// `[B]` steps give `[B, width]`.
pub fn step_sinusoid(timesteps: &[usize], width: usize, device: &Device) -> Tensor<2> {
    static TABLES: Tables = Tables::new(step_sinusoid_values);
    TABLES.rows(timesteps, width, device)
}

/// The values of [`step_sinusoid`], row by row.
fn step_sinusoid_values(timesteps: &[usize], width: usize) -> Vec<f32> {
    /// Base of the wavelengths.
    const BASE: f64 = 10_000.0;
    let half = width / 2;
    let mut values = Vec::with_capacity(timesteps.len() * width);
    for &timestep in timesteps {
        let angle = |pair: usize| timestep as f64 * BASE.powf(-(pair as f64) / half as f64);
        values.extend((0..half).map(|pair| angle(pair).cos() as f32));
        values.extend((0..half).map(|pair| angle(pair).sin() as f32));
        values.resize(values.len() + width % 2, 0.0);
    }
    values
}
