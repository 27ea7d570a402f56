//! Deterministic sampling with a network that predicts noise.

use burn::tensor::Tensor;

use crate::Error;
use crate::config::ensure;
use crate::schedule::Schedule;

/// Added to every sampled timestep, so that the timesteps are 1, 21, 41 and so on (`steps_offset` of MLD's scheduler).
const OFFSET: usize = 1;

/// Deterministic steps from noise to a clean sample.
///
/// # Source
/// Song et al. 2021, Eq. 12 with `sigma = 0`; the timesteps and the last step are those of diffusers with MLD's
/// settings (`algorithms` section 14).
#[derive(Clone, Debug)]
pub struct Ddim {
    schedule: Schedule,
    stride: usize,
    /// Diffusion steps in descending order.
    timesteps: Vec<usize>,
}

impl Ddim {
    /// Spreads `num_steps` sampling steps over the steps of a schedule.
    ///
    /// # Errors
    /// `num_steps` is 0, or more than half the number of steps of the schedule.
    pub fn new(schedule: Schedule, num_steps: usize) -> Result<Self, Error> {
        let most = schedule.len() / 2;
        let problem = format!("it is {num_steps}, and must be from 1 to {most}");
        ensure((1..=most).contains(&num_steps), "sampling_steps", problem)?;
        let stride = schedule.len() / num_steps;
        let timesteps = (0..num_steps).rev().map(|step| step * stride + OFFSET);
        Ok(Self {
            timesteps: timesteps.collect(),
            schedule,
            stride,
        })
    }

    /// The diffusion steps in sampling order.
    pub fn timesteps(&self) -> &[usize] {
        &self.timesteps
    }

    /// Denoising step: computes the next sample from the predicted noise `eps`. The last step ends at the noise level
    /// of step 0.
    ///
    /// # Shapes
    /// Both tensors have the same shape, which is that of the result.
    pub fn step<const D: usize>(&self, x: Tensor<D>, eps: Tensor<D>, timestep: usize) -> Tensor<D> {
        let signal = |timestep: usize| self.schedule.alphas_cumprod[timestep];
        let (now, next) = (
            signal(timestep),
            signal(timestep.saturating_sub(self.stride)),
        );
        let x0 = (x - eps.clone().mul_scalar((1.0 - now).sqrt())).div_scalar(now.sqrt());
        x0.mul_scalar(next.sqrt()) + eps.mul_scalar((1.0 - next).sqrt())
    }

    /// Samples from noise. `predict` returns the noise of a sample at a step, including guidance.
    ///
    /// # Errors
    /// Whatever `predict` returns.
    pub fn sample<const D: usize>(
        &self,
        noise: Tensor<D>,
        mut predict: impl FnMut(&Tensor<D>, usize) -> Result<Tensor<D>, Error>,
    ) -> Result<Tensor<D>, Error> {
        let mut x = noise;
        for &timestep in &self.timesteps {
            let eps = predict(&x, timestep)?;
            x = self.step(x, eps, timestep);
        }
        Ok(x)
    }
}
