//! The MotionReFit denoiser.

use burn::module::Module;
use burn::nn::{Linear, LinearConfig};
use burn::tensor::activation::silu;
use burn::tensor::{Device, Tensor};
use datasets_spec::canonical::FIXED_FRAMES;
use datasets_spec::normalise::FRAME_WIDTH;

use super::dropout::Dropout;
use super::position::{positions, sinusoid};
use super::transformer::Encoder;
use crate::config::{NetworkConfig, PreviousFrames};

/// What the text feature is divided by before it joins the condition token (released code).
pub const TEXT_DIVISOR: f64 = 10.0;

/// Steps progress in [0, 1] is divided into before it is looked up (released code).
const PROGRESS_STEPS: f32 = 100.0;

/// An index looked up in the sinusoidal table and mapped by two layers.
#[derive(Module, Debug)]
pub struct IndexEmbedding {
    hidden: Linear,
    output: Linear,
}

impl IndexEmbedding {
    pub(crate) fn new(width: usize, device: &Device) -> Self {
        Self {
            hidden: LinearConfig::new(width, width).init(device),
            output: LinearConfig::new(width, width).init(device),
        }
    }

    /// Embeds indices.
    ///
    /// # Shapes
    /// `[B]` indices give `[B, d]`.
    pub fn forward(&self, indices: &[usize]) -> Tensor<2> {
        let weight = self.hidden.weight.val();
        let table = sinusoid(indices, weight.dims()[0], &weight.device());
        self.output.forward(silu(self.hidden.forward(table)))
    }
}

/// Frames before a window, each mapped by two layers to the token of its place.
#[derive(Module, Debug)]
pub struct PreviousEmbedding {
    hidden: Linear,
    output: Linear,
}

impl PreviousEmbedding {
    fn new(width: usize, device: &Device) -> Self {
        Self {
            hidden: LinearConfig::new(FRAME_WIDTH, width).init(device),
            output: LinearConfig::new(width, width).init(device),
        }
    }

    /// Embeds frames.
    ///
    /// # Shapes
    /// `[B, F, 84]` give `[B, F, d]`.
    pub fn forward(&self, frames: Tensor<3>) -> Tensor<3> {
        self.output.forward(silu(self.hidden.forward(frames)))
    }
}

/// The noise predictor: a transformer over one condition token and the frames of a window.
///
/// # Source
/// Paper Sec. 4.1; the layout and the scales are those of the released code (`algorithms`
/// section 6). The previous two frames are the first two frames of the noisy window; of
/// [`PreviousFrames::Encoded`] a network of its own embeds them, of [`PreviousFrames::Inpainted`]
/// that of every frame.
#[derive(Module, Debug)]
pub struct Denoiser {
    embed_previous: Option<PreviousEmbedding>,
    project_text: Option<Linear>,
    embedding_input: Linear,
    embedding_original: Linear,
    embed_timestep: IndexEmbedding,
    embed_prog_ind: IndexEmbedding,
    transformer: Encoder,
    out: Linear,
    dropout: Dropout,
}

impl Denoiser {
    /// Builds the network for text vectors of `text_width` numbers. If that is not the network's own
    /// width, a layer maps one to the other; neither publication has one.
    pub fn new(
        config: &NetworkConfig,
        previous: PreviousFrames,
        text_width: usize,
        device: &Device,
    ) -> Self {
        Self {
            embed_previous: match previous {
                PreviousFrames::Encoded => Some(PreviousEmbedding::new(config.width, device)),
                PreviousFrames::Inpainted => None,
            },
            project_text: (text_width != config.width).then(|| {
                LinearConfig::new(text_width, config.width)
                    .with_bias(false)
                    .init(device)
            }),
            embedding_input: LinearConfig::new(FRAME_WIDTH, config.width).init(device),
            embedding_original: LinearConfig::new(FRAME_WIDTH, config.width).init(device),
            embed_timestep: IndexEmbedding::new(config.width, device),
            embed_prog_ind: IndexEmbedding::new(config.width, device),
            transformer: Encoder::new(config, device),
            out: LinearConfig::new(config.width, FRAME_WIDTH).init(device),
            dropout: Dropout::new(config.dropout),
        }
    }

    /// Predicts the noise in `x`.
    ///
    /// # Shapes
    /// `x`, `original` and the result `[B, W, 84]`; `timesteps` and `progress` `[B]`; `text`
    /// `[B, text_width]`, a row of zeros standing for no text.
    pub fn forward(
        &self,
        x: Tensor<3>,
        timesteps: &[usize],
        text: Tensor<2>,
        progress: &[f32],
        original: Tensor<3>,
    ) -> Tensor<3> {
        let [_, window, _] = x.dims();
        let device = x.device();
        // A layer without bias keeps zeros zeros: no text stays no text.
        let text = match &self.project_text {
            Some(layer) => layer.forward(text),
            None => text,
        };
        let [_, width] = text.dims();
        let scale = (width as f64).sqrt();

        let seen = match &self.embed_previous {
            Some(embedding) => {
                let previous = embedding.forward(x.clone().narrow(1, 0, FIXED_FRAMES));
                let rest = x.narrow(1, FIXED_FRAMES, window - FIXED_FRAMES);
                Tensor::cat(vec![previous, self.embedding_input.forward(rest)], 1)
            }
            None => self.embedding_input.forward(x),
        };
        let frames = (seen + self.embedding_original.forward(original)).mul_scalar(scale / 2.0);
        let condition = self.embed_timestep.forward(timesteps)
            + text.div_scalar(TEXT_DIVISOR)
            + self.embed_prog_ind.forward(&progress_indices(progress));
        let condition = condition.mul_scalar(scale).unsqueeze_dim::<3>(1);

        let tokens = Tensor::cat(vec![condition, frames], 1);
        let tokens = tokens + positions(1 + window, width, &device);
        let tokens = self.transformer.forward(self.dropout.forward(tokens), None);
        self.out.forward(tokens.narrow(1, 1, window))
    }
}

/// The table rows of progress values, rounded half to even as the released code rounds.
pub fn progress_indices(progress: &[f32]) -> Vec<usize> {
    progress
        .iter()
        .map(|&value| (PROGRESS_STEPS * value.clamp(0.0, 1.0)).round_ties_even() as usize)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_is_rounded_half_to_even() {
        assert_eq!(
            progress_indices(&[0.0, 0.125, 0.375, 0.994, 1.0, 1.7]),
            [0, 12, 38, 99, 100, 100]
        );
    }
}
