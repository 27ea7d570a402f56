//! Deterministic sampling with a network that predicts noise.

use burn::tensor::Tensor;

use crate::Error;
use crate::config::ensure;
use crate::schedule::Schedule;

/// Added to every sampled timestep, so that they are 1, 21, 41 and so on (`steps_offset` of MLD's scheduler).
const OFFSET: usize = 1;

/// Steps from noise to a clean sample without noise of their own.
///
/// # Source
/// Song et al. 2021, Eq. 12 with `sigma = 0`; the steps and the end are those of diffusers as MLD sets it
/// (`algorithms` section 14).
#[derive(Clone, Debug)]
pub struct Ddim {
    schedule: Schedule,
    stride: usize,
    /// Falling.
    timesteps: Vec<usize>,
}

impl Ddim {
    /// `num_steps` steps, spread over those of a schedule.
    ///
    /// # Errors
    /// There is no step, or there are more than half of those of the schedule.
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

    /// The diffusion steps in the order they are made.
    pub fn timesteps(&self) -> &[usize] {
        &self.timesteps
    }

    /// The sample one step cleaner, given the predicted noise. The last step ends with the noise of step 0.
    ///
    /// # Shapes
    /// Any, the same.
    pub fn step<const D: usize>(&self, x: Tensor<D>, eps: Tensor<D>, timestep: usize) -> Tensor<D> {
        let signal = |timestep: usize| self.schedule.alphas_cumprod[timestep];
        let (now, next) = (
            signal(timestep),
            signal(timestep.saturating_sub(self.stride)),
        );
        let x0 = (x - eps.clone().mul_scalar((1.0 - now).sqrt())).div_scalar(now.sqrt());
        x0.mul_scalar(next.sqrt()) + eps.mul_scalar((1.0 - next).sqrt())
    }

    /// Samples from noise. `predict` gives the noise of a sample at a step, guidance included; `on_step`
    /// sees each result.
    ///
    /// # Errors
    /// Whatever `predict` returns.
    pub fn sample<const D: usize>(
        &self,
        noise: Tensor<D>,
        mut predict: impl FnMut(&Tensor<D>, usize) -> Result<Tensor<D>, Error>,
        mut on_step: impl FnMut(&Tensor<D>),
    ) -> Result<Tensor<D>, Error> {
        let mut x = noise;
        for &timestep in &self.timesteps {
            let eps = predict(&x, timestep)?;
            x = self.step(x, eps, timestep);
            on_step(&x);
        }
        Ok(x)
    }
}
