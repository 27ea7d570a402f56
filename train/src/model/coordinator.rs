//! The body-part coordinator: classifies windows as natural or composed of several motions.

use burn::module::Module;
use burn::nn::{Dropout, DropoutConfig, Linear, LinearConfig};
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor};
use rayon::prelude::*;

use super::denoiser::TwoLayers;
use super::pass::Pass;
use super::position::positions;
use super::transformer::Encoder;
use super::weights::Networks;
use crate::config::NetworkConfig;

/// A transformer over the frames of a window and a token of the diffusion step, with a classifier of the mean over
/// frames.
///
/// # Source
/// Paper, Sec. 5.2 and App. B.4; the layout is that of the released code with `Disc=True` (`algorithms` section 6). Two
/// of its layers, `embedding_original` and `embed_prog_ind`, are unused; they exist because the released checkpoints
/// store them and the released program requires them.
#[derive(Module, Debug)]
pub struct Coordinator {
    embedding_input: Linear,
    embedding_original: Linear,
    embed_timestep: TwoLayers,
    embed_prog_ind: TwoLayers,
    transformer: Encoder,
    out: Linear,
    /// Classifier of the mean over frames.
    pred: TwoLayers,
    dropout: Dropout,
}

impl Networks for Coordinator {
    const FILE: &'static str = "coordinator.safetensors";
}

impl Coordinator {
    /// Builds the network for frames of `frame_width` numbers: 84 for all keypoints.
    pub fn new(config: &NetworkConfig, frame_width: usize, device: &Device) -> Self {
        let linear = |from, to| LinearConfig::new(from, to).init(device);
        Self {
            embedding_input: linear(frame_width, config.width),
            embedding_original: linear(frame_width, config.width),
            embed_timestep: TwoLayers::new([config.width; 3], device),
            embed_prog_ind: TwoLayers::new([config.width; 3], device),
            transformer: Encoder::new(config, device),
            out: linear(config.width, frame_width),
            pred: TwoLayers::new([frame_width, frame_width, 1], device),
            dropout: DropoutConfig::new(config.dropout).init(),
        }
    }

    /// The logit of the probability that each window was composed.
    ///
    /// # Shapes
    /// `x` `[B, W, frame_width]`, `timesteps` `[B]`; the result `[B, 1]`.
    pub fn logits(&self, x: Tensor<3>, timesteps: &[usize], pass: &Pass) -> Tensor<2> {
        let [_, window, _] = x.dims();
        let device = x.device();
        let frames = self.embedding_input.forward(x);
        let [_, _, width] = frames.dims();
        // Unlike in the denoiser, the step's token is not scaled (released code).
        let step = self.embed_timestep.embed(timesteps).unsqueeze_dim::<3>(1);
        let tokens = Tensor::cat(vec![step, frames.mul_scalar((width as f64).sqrt())], 1);
        let tokens = tokens + positions(1 + window, width, &device);
        let tokens = self
            .transformer
            .forward(pass.drop_out(&self.dropout, tokens), None, pass);
        let frames = self.out.forward(tokens.narrow(1, 1, window));
        let mean = frames.mean_dim(1).squeeze_dim::<2>(1);
        self.pred.forward(mean)
    }

    /// The probability that each window was composed.
    ///
    /// # Shapes
    /// As [`Coordinator::logits`].
    pub fn probability(&self, x: Tensor<3>, timesteps: &[usize], pass: &Pass) -> Tensor<2> {
        sigmoid(self.logits(x, timesteps, pass))
    }

    /// The gradient of the probability of each window with respect to that window.
    ///
    /// # Shapes
    /// `x` and the result `[B, W, frame_width]`, on a device without automatic differentiation; `timesteps` `[B]`.
    pub fn gradient(&self, x: Tensor<3>, timesteps: &[usize], pass: &Pass) -> Tensor<3> {
        // On a device with automatic differentiation, dropout would be active.
        let settled = self.valid();
        if !pass.uses_kernels(&x.device()) {
            return settled.gradient_of_batch(x, timesteps, pass);
        }
        // A matrix product may round a row differently if the number of rows changes. So each window is computed alone,
        // and its gradient does not depend on the other windows of the batch.
        let windows: Vec<Tensor<3>> = (0..timesteps.len())
            .map(|row| x.clone().narrow(0, row, 1))
            .collect();
        let arithmetic = pass.arithmetic();
        let alone = windows
            .into_par_iter()
            .zip(timesteps)
            .map(|(window, step)| {
                settled.gradient_of_batch(window, &[*step], &Pass::new(arithmetic))
            });
        Tensor::cat(alone.collect(), 0)
    }

    fn gradient_of_batch(&self, x: Tensor<3>, timesteps: &[usize], pass: &Pass) -> Tensor<3> {
        let device = x.device();
        let x = Tensor::<3>::from_inner(x).require_grad();
        // Rows are independent, so the gradient of the sum contains the gradient of each row.
        let sum = self.probability(x.clone(), timesteps, pass).sum();
        let gradients = sum.backward();
        x.grad(&gradients)
            .unwrap_or_else(|| Tensor::zeros(x.dims(), &device))
    }
}
