//! Noise for the sampling steps.
//!
//! The program draws it, not the device. So a motion is the same on every device, up to rounding, and does not depend
//! on the rest of its batch. The noise of many steps is drawn and transferred at once, so that the device need not wait
//! in each step.

use burn::tensor::{Device, Tensor};
use datasets_spec::Rng;
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use crate::noise_shape::NoiseShape;
use crate::transfer::send;

/// Number of values drawn and transferred at once: 16 MB. Most batches need one or two such blocks.
const BLOCK: usize = 1 << 22;

/// Noise for a batch of sequences, one step after another: standard normal, unless it is scaled or shaped. Each
/// sequence has its own generator.
pub(crate) struct Noise<'a> {
    rngs: Vec<&'a mut Rng>,
    /// Number of frames in a sequence, and of values in a frame.
    shape: [usize; 2],
    scale: f32,
    /// Covariance of the noise, and whether the windows have no fixed frames; none for white noise.
    covariance: Option<(&'a NoiseShape, bool)>,
    device: &'a Device,
    left: usize,
    /// Noise drawn ahead, `[S, B, T, width]`, and the index of the first step not yet used.
    block: Option<(Tensor<4>, usize)>,
}

impl<'a> Noise<'a> {
    /// Noise of `num_steps` steps for sequences of `shape`: number of frames, and of values in a frame.
    pub(crate) fn new(
        rngs: impl IntoIterator<Item = &'a mut Rng>,
        shape: [usize; 2],
        num_steps: usize,
        device: &'a Device,
    ) -> Self {
        Self {
            rngs: rngs.into_iter().collect(),
            shape,
            scale: 1.0,
            covariance: None,
            device,
            left: num_steps,
            block: None,
        }
    }

    pub(crate) fn scaled(mut self, scale: f64) -> Self {
        self.scale = scale as f32;
        self
    }

    /// The same noise with a covariance; `is_start` tells whether the windows have no fixed frames.
    pub(crate) fn shaped(mut self, shape: Option<&'a NoiseShape>, is_start: bool) -> Self {
        self.covariance = shape.map(|shape| (shape, is_start));
        self
    }

    /// The noise of the next step.
    ///
    /// # Shapes
    /// `[B, T, width]`
    ///
    /// # Panics
    /// If all steps were used.
    pub(crate) fn step(&mut self) -> Tensor<3> {
        let (block, next) = match self.block.take() {
            Some((block, next)) if next < block.dims()[0] => (block, next),
            _ => (self.draw(), 0),
        };
        let noise = block.clone().narrow(0, next, 1).squeeze_dim::<3>(0);
        self.block = Some((block, next + 1));
        noise
    }

    fn draw(&mut self) -> Tensor<4> {
        assert!(self.left > 0, "noise is drawn for the steps that are made");
        let [frames, width] = self.shape;
        let (rows, row) = (self.rngs.len(), frames * width);
        let steps = (BLOCK / (rows * row).max(1)).clamp(1, self.left);
        self.left -= steps;
        let (scale, covariance) = (self.scale, self.covariance);
        let drawn: Vec<Vec<f32>> = self
            .rngs
            .par_iter_mut()
            .map(|rng| {
                let mut drawn: Vec<f32> = (0..steps * row)
                    .map(|_| scale * rng.sample::<f32, _>(StandardNormal))
                    .collect();
                if let Some((shape, is_start)) = covariance {
                    for window in drawn.chunks_exact_mut(row) {
                        shape.apply(window, width / 3, is_start);
                    }
                }
                drawn
            })
            .collect();
        let mut values = Vec::with_capacity(steps * rows * row);
        for step in 0..steps {
            for drawn in &drawn {
                values.extend_from_slice(&drawn[step * row..(step + 1) * row]);
            }
        }
        let shape = [steps, rows, frames, width];
        send(values, shape, self.device)
    }
}

/// Draws `count` numbers from the standard normal distribution.
pub(crate) fn normal(rng: &mut Rng, count: usize) -> Vec<f32> {
    (0..count).map(|_| rng.sample(StandardNormal)).collect()
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;

    use super::*;
    use crate::transfer::read;

    #[test]
    fn noise_is_that_of_each_row_whatever_is_drawn_ahead() {
        const SHAPE: [usize; 2] = [700, 300];
        let device = Device::flex();
        let rngs = || ["a", "b"].map(|row| Seed(1).rng(&["row", row]));
        let mut one_by_one = rngs();
        let mut ahead = rngs();
        // Two blocks: the first holds nine steps of two rows.
        let mut noise = Noise::new(&mut ahead, SHAPE, 11, &device).scaled(0.5);
        for _ in 0..11 {
            let step = read(noise.step());
            let expected: Vec<f32> = one_by_one
                .iter_mut()
                .flat_map(|rng| {
                    (0..SHAPE[0] * SHAPE[1])
                        .map(|_| 0.5 * rng.sample::<f32, _>(StandardNormal))
                        .collect::<Vec<f32>>()
                })
                .collect();
            assert!(step == expected);
        }
    }
}
