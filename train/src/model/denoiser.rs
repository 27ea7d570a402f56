//! The MotionReFit denoiser.

use burn::module::Module;
use burn::nn::{Dropout, DropoutConfig, Linear, LinearConfig};
use burn::tensor::activation::silu;
use burn::tensor::{Device, Tensor};
use kinematics::canonical::FIXED_FRAMES;

use super::pass::{Arithmetic, Pass};
use super::position::{positions, sinusoid};
use super::transformer::{Encoder, PreparedWeights};
use super::weights::Networks;
use crate::config::{NetworkConfig, PreviousFrames};

/// Divisor of the text feature before it joins the condition token (released code).
pub const TEXT_DIVISOR: f64 = 10.0;

/// Number of steps into which progress in [0, 1] is quantised before the table look-up (released code).
const PROGRESS_STEPS: f32 = 100.0;

/// Two layers with SiLU between them.
#[derive(Module, Debug)]
pub struct TwoLayers {
    hidden: Linear,
    output: Linear,
}

impl TwoLayers {
    /// Builds two layers with the given input, hidden and output widths.
    pub(crate) fn new([input, hidden, output]: [usize; 3], device: &Device) -> Self {
        Self {
            hidden: LinearConfig::new(input, hidden).init(device),
            output: LinearConfig::new(hidden, output).init(device),
        }
    }

    /// Applies the layers.
    ///
    /// # Shapes
    /// `[.., input]` gives `[.., output]`.
    pub fn forward<const D: usize>(&self, x: Tensor<D>) -> Tensor<D> {
        self.output.forward(silu(self.hidden.forward(x)))
    }

    /// Embeds indices by their rows of the sinusoidal table.
    ///
    /// # Shapes
    /// `[B]` indices give `[B, output]`.
    pub fn embed(&self, indices: &[usize]) -> Tensor<2> {
        let weight = self.hidden.weight.val();
        self.forward(sinusoid(indices, weight.dims()[0], &weight.device()))
    }
}

/// A transformer over one condition token and the frames of a noisy window.
///
/// # Source
/// Paper, Sec. 5.1; the layout and the scales are those of the released code (`algorithms` section 6). The previous two
/// frames are the first two frames of the noisy window. With [`PreviousFrames::Encoded`] a separate network embeds
/// them; with [`PreviousFrames::Inpainted`] they are embedded like all frames.
#[derive(Module, Debug)]
pub struct Denoiser {
    /// Maps each previous frame to the token at its position.
    embed_previous: Option<TwoLayers>,
    project_text: Option<Linear>,
    embedding_input: Linear,
    embedding_original: Linear,
    embed_timestep: TwoLayers,
    embed_prog_ind: TwoLayers,
    transformer: Encoder,
    out: Linear,
    /// Layer for the gates of each keypoint; none for predictions without gates.
    gate: Option<Linear>,
    /// Whether the condition is added to every frame, in addition to its own token.
    #[module(skip)]
    tells_frames: bool,
    dropout: Dropout,
}

impl Networks for Denoiser {
    const FILE: &'static str = "denoiser.safetensors";
}

impl Denoiser {
    /// Builds the network for text vectors of `text_width` numbers and frames of `frame_width`: 84 for all keypoints.
    /// If the text vectors have another width than the network, a layer maps them; neither publication has such a
    /// layer.
    pub fn new(
        config: &NetworkConfig,
        previous: PreviousFrames,
        text_width: usize,
        frame_width: usize,
        device: &Device,
    ) -> Self {
        let width = config.width;
        let linear = LinearConfig::new;
        Self {
            embed_previous: (previous == PreviousFrames::Encoded)
                .then(|| TwoLayers::new([frame_width, width, width], device)),
            project_text: (text_width != width)
                .then(|| linear(text_width, width).with_bias(false).init(device)),
            embedding_input: linear(frame_width, width).init(device),
            embedding_original: linear(frame_width, width).init(device),
            embed_timestep: TwoLayers::new([width; 3], device),
            embed_prog_ind: TwoLayers::new([width; 3], device),
            transformer: Encoder::new(config, device),
            out: linear(width, frame_width).init(device),
            gate: None,
            tells_frames: false,
            dropout: DropoutConfig::new(config.dropout).init(),
        }
    }

    /// Sets whether the condition is added to every frame, in addition to its own token.
    #[must_use]
    pub fn telling_frames(mut self, tells_frames: bool) -> Self {
        self.tells_frames = tells_frames;
        self
    }

    /// Adds a layer that outputs `gates` numbers for each keypoint, after the numbers of the frame.
    #[must_use]
    pub fn gated(mut self, gates: usize) -> Self {
        let [width, frame_width] = self.out.weight.val().dims();
        let device = self.out.weight.val().device();
        self.gate = Some(LinearConfig::new(width, gates * frame_width / 3).init(&device));
        self
    }

    /// The input of the transformer: the condition and the frames as tokens with positional encoding, `[B, 1 + W, d]`.
    /// `original` holds the tokens of the original frames.
    fn tokens(
        &self,
        x: Tensor<3>,
        original: Tensor<3>,
        condition: Tensor<2>,
        positions: Tensor<3>,
    ) -> Tensor<3> {
        let [_, width] = condition.dims();
        let scale = (width as f64).sqrt();
        let mut frames = (self.embed_frames(x) + original).mul_scalar(scale / 2.0);
        let condition = condition.mul_scalar(scale).unsqueeze_dim::<3>(1);
        if self.tells_frames {
            frames = frames + condition.clone();
        }
        Tensor::cat(vec![condition, frames], 1) + positions
    }

    /// Output of the network, computed from the encoded tokens of frames.
    fn read(&self, frames: Tensor<3>) -> Tensor<3> {
        match &self.gate {
            None => self.out.forward(frames),
            Some(gate) => Tensor::cat(
                vec![self.out.forward(frames.clone()), gate.forward(frames)],
                2,
            ),
        }
    }

    /// Number of values in a frame.
    pub fn frame_width(&self) -> usize {
        let [_, frame_width] = self.out.weight.val().dims();
        frame_width
    }

    /// Computes the [prediction](crate::config::Prediction) for noisy windows `x`.
    ///
    /// # Shapes
    /// `x`, `original` and the result `[B, W, frame_width]`, the result followed by the gates of each frame, if any;
    /// `timesteps` and `progress` `[B]`; `text` `[B, text_width]`, where a row of zeros means no text.
    pub fn forward(
        &self,
        x: Tensor<3>,
        timesteps: &[usize],
        text: Tensor<2>,
        progress: &[f32],
        original: Tensor<3>,
        pass: &Pass,
    ) -> Tensor<3> {
        let [_, window, _] = x.dims();
        let text = self.project(text);
        let [_, width] = text.dims();
        let positions = positions(1 + window, width, &x.device());
        let original = self.embedding_original.forward(original);
        let condition = self.embed_timestep.embed(timesteps)
            + text.div_scalar(TEXT_DIVISOR)
            + self.embed_prog_ind.embed(&progress_indices(progress));
        let tokens = self.tokens(x, original, condition, positions);
        let tokens = self
            .transformer
            .forward(pass.drop_out(&self.dropout, tokens), None, pass);
        self.read(tokens.narrow(1, 1, window))
    }

    /// Maps text vectors to the width of the network. The layer has no bias, so zeros, which mean no text, stay zeros.
    fn project(&self, text: Tensor<2>) -> Tensor<2> {
        match &self.project_text {
            Some(layer) => layer.forward(text),
            None => text,
        }
    }

    /// The tokens of noisy frames, `[B, W, d]`.
    fn embed_frames(&self, x: Tensor<3>) -> Tensor<3> {
        let Some(embedding) = &self.embed_previous else {
            return self.embedding_input.forward(x);
        };
        let [_, window, _] = x.dims();
        let previous = embedding.forward(x.clone().narrow(1, 0, FIXED_FRAMES));
        let rest = x.narrow(1, FIXED_FRAMES, window - FIXED_FRAMES);
        Tensor::cat(vec![previous, self.embedding_input.forward(rest)], 1)
    }

    /// Prepares the weights in the layout in which sampling multiplies them.
    pub fn prepared_weights(&self, arithmetic: Arithmetic) -> PreparedWeights {
        self.transformer.prepare(arithmetic)
    }

    /// Computes once all inputs that do not change between sampling steps: embeddings of all diffusion steps, of the
    /// original windows, and of progress and positions. The weights must be this denoiser's, from
    /// [`Denoiser::prepared_weights`].
    ///
    /// # Shapes
    /// As [`Denoiser::forward`].
    pub fn prepare<'a>(
        &'a self,
        weights: &'a PreparedWeights,
        num_steps: usize,
        text: Tensor<2>,
        progress: &[f32],
        original: Tensor<3>,
    ) -> PreparedDenoiser<'a> {
        let [_, window, _] = original.dims();
        let text = self.project(text);
        let [_, width] = text.dims();
        let device = original.device();
        let steps: Vec<usize> = (0..num_steps).collect();
        PreparedDenoiser {
            denoiser: self,
            weights,
            steps: self.embed_timestep.embed(&steps),
            condition: text.div_scalar(TEXT_DIVISOR)
                + self.embed_prog_ind.embed(&progress_indices(progress)),
            original: self.embedding_original.forward(original),
            positions: positions(1 + window, width, &device),
        }
    }
}

/// A denoiser with its precomputed conditions, for sampling. On a processor, no gradients flow through it.
#[derive(Debug)]
pub struct PreparedDenoiser<'a> {
    denoiser: &'a Denoiser,
    weights: &'a PreparedWeights,
    /// `[S, d]`
    steps: Tensor<2>,
    /// `[B, d]`
    condition: Tensor<2>,
    /// `[B, W, d]`
    original: Tensor<3>,
    /// `[1, 1 + W, d]`
    positions: Tensor<3>,
}

impl PreparedDenoiser<'_> {
    /// As [`Denoiser::forward`], at one diffusion step.
    ///
    /// # Shapes
    /// As [`Denoiser::forward`].
    pub fn forward(&self, x: Tensor<3>, timestep: usize) -> Tensor<3> {
        let [_, window, _] = x.dims();
        let condition = self.steps.clone().narrow(0, timestep, 1) + self.condition.clone();
        let (original, positions) = (self.original.clone(), self.positions.clone());
        let tokens = self.denoiser.tokens(x, original, condition, positions);
        let encoded = self.denoiser.transformer.infer(self.weights, tokens);
        self.denoiser.read(encoded.narrow(1, 1, window))
    }
}

/// Rows of the sinusoidal table for progress values. Halves are rounded to even, as in the released code.
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
    fn a_prepared_denoiser_predicts_the_same() {
        use burn::tensor::Distribution;
        use datasets_spec::Seed;
        use kinematics::normalise::FRAME_WIDTH;

        use crate::model::weights::draw;

        let device = Device::flex();
        let config = NetworkConfig {
            width: 32,
            num_layers: 2,
            num_heads: 2,
            feed_forward: 48,
            dropout: 0.1,
        };
        for (previous, text_width, is_ours) in [
            (PreviousFrames::Inpainted, 32, false),
            (PreviousFrames::Inpainted, 32, true),
            (PreviousFrames::Encoded, 12, false),
        ] {
            let denoiser = Denoiser::new(&config, previous, text_width, FRAME_WIDTH, &device);
            let denoiser = if is_ours {
                denoiser.gated(2).telling_frames(true)
            } else {
                denoiser
            };
            let denoiser = draw(denoiser, Seed(4)).expect("known layers");
            let normal = |shape: [usize; 3]| {
                Tensor::<3>::random(shape, Distribution::Normal(0.0, 1.0), &device)
            };
            let (x, original) = (normal([3, 16, FRAME_WIDTH]), normal([3, 16, FRAME_WIDTH]));
            let text = normal([3, 1, text_width]).squeeze_dim::<2>(1);
            let progress = [0.0, 0.4, 1.0];
            let weights = denoiser.prepared_weights(Arithmetic::default());
            let prepared =
                denoiser.prepare(&weights, 10, text.clone(), &progress, original.clone());
            for timestep in [0, 7] {
                let found = prepared.forward(x.clone(), timestep);
                let expected = denoiser.forward(
                    x.clone(),
                    &[timestep; 3],
                    text.clone(),
                    &progress,
                    original.clone(),
                    &Pass::default(),
                );
                let difference: f32 = (found - expected).abs().max().into_scalar();
                assert!(difference < 1e-5, "{difference}");
            }
        }
    }

    #[test]
    fn progress_is_rounded_half_to_even() {
        assert_eq!(
            progress_indices(&[0.0, 0.125, 0.375, 0.994, 1.0, 1.7]),
            [0, 12, 38, 99, 100, 100]
        );
    }
}
