//! Noise schedules: their coefficients, adding noise, and the reverse step.

use std::f64::consts::FRAC_PI_2;

use burn::tensor::Tensor;

use crate::Error;
use crate::config::{ScheduleName, ensure, positive};
use crate::transfer::send;

/// First and last variance of the linear schedule over [`REFERENCE_STEPS`] steps (Ho et al. 2020).
const LINEAR_VARIANCES: [f64; 2] = [1e-4, 0.02];

const REFERENCE_STEPS: f64 = 1_000.0;

/// The coefficients of a diffusion of `T` steps, all in `f64`.
///
/// # Source
/// Ho et al. 2020, Eq. 4 to 7.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    /// Variance added in each step, `[T]`.
    pub betas: Vec<f64>,
    /// Product of `1 - beta` up to each step, `[T]`.
    pub alphas_cumprod: Vec<f64>,
    /// Product of `1 - beta` up to the previous step, `[T]`.
    pub alphas_cumprod_prev: Vec<f64>,
    /// Variance of the posterior, `[T]`.
    pub posterior_variance: Vec<f64>,
    /// Weight of the clean window in the mean of the posterior, `[T]`.
    pub posterior_mean_coef1: Vec<f64>,
    /// Weight of the noisy window in the mean of the posterior, `[T]`.
    pub posterior_mean_coef2: Vec<f64>,
}

impl Schedule {
    /// Builds the schedule with the given name.
    ///
    /// # Errors
    /// There are fewer than two steps, or so few that a rescaled variance reaches 1.
    pub fn new(name: ScheduleName, num_steps: usize) -> Result<Self, Error> {
        let scale = match name {
            ScheduleName::Official => 1.0,
            ScheduleName::Rescaled => REFERENCE_STEPS / num_steps as f64,
            ScheduleName::Cosine => return Self::cosine(num_steps),
        };
        let [first, last] = LINEAR_VARIANCES.map(|variance| scale * variance);
        let problem = format!("{num_steps} steps are too few for the schedule");
        ensure(num_steps >= 2 && last < 1.0, "diffusion.num_steps", problem)?;
        Ok(Self::of_betas(evenly([first, last], num_steps).collect()))
    }

    /// The squared cosine schedule, with a capped variance in the last steps.
    ///
    /// # Errors
    /// There is no step.
    ///
    /// # Source
    /// Nichol and Dhariwal 2021, Eq. 17.
    pub fn cosine(num_steps: usize) -> Result<Self, Error> {
        const OFFSET: f64 = 0.008;
        const MAX_BETA: f64 = 0.999;
        positive("diffusion.num_steps", num_steps as u64)?;
        let signal = |step: usize| {
            let progress = step as f64 / num_steps as f64;
            let angle = (progress + OFFSET) / (1.0 + OFFSET) * FRAC_PI_2;
            angle.cos().powi(2)
        };
        let betas =
            (0..num_steps).map(|step| (1.0 - signal(step + 1) / signal(step)).min(MAX_BETA));
        Ok(Self::of_betas(betas.collect()))
    }

    /// The schedule of latent diffusion, whose standard deviations are linear.
    ///
    /// # Errors
    /// There are fewer than two steps.
    ///
    /// # Source
    /// Rombach et al. 2022, with the variances of MLD (`algorithms` section 14).
    pub fn scaled_linear(num_steps: usize) -> Result<Self, Error> {
        const VARIANCES: [f64; 2] = [0.00085, 0.012];
        let problem = format!("it is {num_steps}, and must be at least 2");
        ensure(num_steps >= 2, "diffusion_steps", problem)?;
        let deviations = evenly(VARIANCES.map(f64::sqrt), num_steps);
        Ok(Self::of_betas(deviations.map(|std| std.powi(2)).collect()))
    }

    /// The schedule restricted to some of the steps, in ascending order. Each kept step adds the noise of all steps
    /// since the previous kept one.
    ///
    /// # Panics
    /// If a step is not in the schedule.
    ///
    /// # Source
    /// `SpacedDiffusion` of Nichol and Dhariwal 2021.
    pub fn keeping(&self, steps: &[usize]) -> Self {
        let mut before = 1.0;
        let betas = steps.iter().map(|&step| {
            let now = self.alphas_cumprod[step];
            1.0 - now / std::mem::replace(&mut before, now)
        });
        Self::of_betas(betas.collect())
    }

    fn of_betas(betas: Vec<f64>) -> Self {
        let num_steps = betas.len();
        let alphas_cumprod: Vec<f64> = betas
            .iter()
            .scan(1.0, |product, beta| {
                *product *= 1.0 - beta;
                Some(*product)
            })
            .collect();
        let alphas_cumprod_prev: Vec<f64> = std::iter::once(1.0)
            .chain(alphas_cumprod[..num_steps - 1].iter().copied())
            .collect();
        let coefficient = |f: &dyn Fn(f64, f64, f64) -> f64| -> Vec<f64> {
            (0..num_steps)
                .map(|t| f(betas[t], alphas_cumprod[t], alphas_cumprod_prev[t]))
                .collect()
        };
        Self {
            posterior_variance: coefficient(&|beta, now, before| {
                beta * (1.0 - before) / (1.0 - now)
            }),
            posterior_mean_coef1: coefficient(&|beta, now, before| {
                beta * before.sqrt() / (1.0 - now)
            }),
            posterior_mean_coef2: coefficient(&|beta, now, before| {
                (1.0 - before) * (1.0 - beta).sqrt() / (1.0 - now)
            }),
            betas,
            alphas_cumprod,
            alphas_cumprod_prev,
        }
    }

    /// Number of steps.
    #[expect(clippy::len_without_is_empty, reason = "a schedule is never empty")]
    pub fn len(&self) -> usize {
        self.betas.len()
    }

    /// Adds noise to clean windows (Ho et al. 2020, Eq. 4).
    ///
    /// # Shapes
    /// `x0`, `noise` and the result `[B, W, D]`; `timesteps` `[B]`.
    pub fn q_sample(&self, x0: Tensor<3>, timesteps: &[usize], noise: Tensor<3>) -> Tensor<3> {
        let (signal, spread) = self.mixture(timesteps);
        signal.times(x0) + spread.times(noise)
    }

    /// The clean window computed from the predicted noise, before clipping.
    ///
    /// # Shapes
    /// As [`Schedule::q_sample`].
    pub fn predict_x0(&self, x_t: Tensor<3>, timesteps: &[usize], eps: Tensor<3>) -> Tensor<3> {
        let of_x = Column::new(timesteps, |t| self.alphas_cumprod[t].sqrt().recip());
        let of_eps = Column::new(timesteps, |t| (self.alphas_cumprod[t].recip() - 1.0).sqrt());
        of_x.times(x_t) - of_eps.times(eps)
    }

    pub(crate) fn mixture(&self, timesteps: &[usize]) -> (Column, Column) {
        (
            Column::new(timesteps, |t| self.alphas_cumprod[t].sqrt()),
            Column::new(timesteps, |t| (1.0 - self.alphas_cumprod[t]).sqrt()),
        )
    }

    /// The mean of the window after one reverse step, given the clean window (Ho et al. 2020, Eq. 7).
    ///
    /// # Shapes
    /// As [`Schedule::q_sample`].
    pub fn posterior_mean(&self, x0: Tensor<3>, x_t: Tensor<3>, timesteps: &[usize]) -> Tensor<3> {
        let of_x0 = Column::new(timesteps, |t| self.posterior_mean_coef1[t]);
        let of_x = Column::new(timesteps, |t| self.posterior_mean_coef2[t]);
        of_x0.times(x0) + of_x.times(x_t)
    }

    /// One reverse step, given an estimate of the clean window. Noise with the posterior variance is added to the mean,
    /// except at the last step, `timestep` 0.
    ///
    /// # Shapes
    /// All `[B, W, D]`.
    pub fn reverse_step(
        &self,
        x_t: Tensor<3>,
        x0: Tensor<3>,
        timestep: usize,
        noise: Tensor<3>,
    ) -> Tensor<3> {
        let timesteps = vec![timestep; x_t.dims()[0]];
        self.add_noise(self.posterior_mean(x0, x_t, &timesteps), timestep, noise)
    }

    /// Adds noise with the posterior variance to the mean of the posterior, except at the last step.
    ///
    /// # Shapes
    /// All `[B, W, D]`.
    pub fn add_noise(&self, mean: Tensor<3>, timestep: usize, noise: Tensor<3>) -> Tensor<3> {
        if timestep == 0 {
            return mean;
        }
        mean + noise.mul_scalar(self.posterior_variance[timestep].sqrt())
    }
}

/// `count` evenly spaced numbers from the first to the last.
fn evenly([first, last]: [f64; 2], count: usize) -> impl Iterator<Item = f64> {
    let stride = (last - first) / (count - 1) as f64;
    (0..count).map(move |step| first + step as f64 * stride)
}

/// A coefficient per window, to be multiplied with a batch. If all windows are at one step, as in sampling, the
/// coefficient is a scalar argument, and no tensor is sent to the device.
pub(crate) enum Column {
    Same(f64),
    Each(Vec<f32>),
}

impl Column {
    fn new(timesteps: &[usize], coefficient: impl Fn(usize) -> f64) -> Self {
        match timesteps {
            [first, rest @ ..] if rest.iter().all(|timestep| timestep == first) => {
                Self::Same(coefficient(*first))
            }
            _ => Self::Each(timesteps.iter().map(|&t| coefficient(t) as f32).collect()),
        }
    }

    /// Multiplies each window by its coefficient.
    pub(crate) fn times(&self, x: Tensor<3>) -> Tensor<3> {
        match self {
            Self::Same(coefficient) => x.mul_scalar(*coefficient),
            Self::Each(coefficients) => {
                let shape = [coefficients.len(), 1, 1];
                let device = x.device();
                x * send(coefficients.clone(), shape, &device)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use proptest::prelude::*;

    use super::*;
    use crate::transfer::read;

    fn tensor(values: &[f32]) -> Tensor<3> {
        send(values.to_vec(), [1, 1, values.len()], &Device::flex())
    }

    #[test]
    fn the_rescaled_schedule_ends_in_noise_and_the_official_one_does_not() {
        let end = |name, steps| {
            let schedule = Schedule::new(name, steps).expect("enough steps");
            schedule.alphas_cumprod[steps - 1]
        };
        assert!((end(ScheduleName::Official, 100) - 0.3636).abs() < 1e-4);
        assert!(end(ScheduleName::Rescaled, 100) < 3e-5);
        assert!(end(ScheduleName::Rescaled, 50) < 3e-5);
        assert!(Schedule::new(ScheduleName::Rescaled, 20).is_err());
    }

    #[test]
    fn kept_steps_have_the_signal_they_had() {
        let whole = Schedule::cosine(300).expect("steps");
        let steps = [0, 40, 41, 299];
        let kept = whole.keeping(&steps);
        for (kept, &step) in kept.alphas_cumprod.iter().zip(&steps) {
            assert!((kept - whole.alphas_cumprod[step]).abs() < 1e-14);
        }
        let all: Vec<usize> = (0..300).collect();
        for (kept, beta) in whole.keeping(&all).betas.iter().zip(&whole.betas) {
            assert!((kept - beta).abs() < 1e-12);
        }
        assert!(Schedule::cosine(0).is_err());
    }

    #[test]
    fn windows_at_one_step_are_noised_as_those_at_several() {
        let schedule = Schedule::cosine(40).expect("steps");
        let three = |values: [f32; 3]| send(values.to_vec(), [3, 1, 1], &Device::flex());
        let (x0, noise) = (three([0.3, -0.7, 0.9]), three([1.1, -2.0, 0.4]));
        let noised = |timesteps| schedule.q_sample(x0.clone(), timesteps, noise.clone());
        let (same, mixed) = (read(noised(&[7; 3])), read(noised(&[7, 7, 8])));
        assert_eq!(same[..2], mixed[..2]);
        assert_ne!(same[2], mixed[2]);
    }

    proptest! {
        #[test]
        fn the_last_reverse_step_returns_the_clean_window(
            x0 in prop::collection::vec(-0.9f32..0.9, 4),
            x_t in prop::collection::vec(-3.0f32..3.0, 4),
        ) {
            let schedule = Schedule::new(ScheduleName::Rescaled, 50).expect("enough steps");
            let noise = tensor(&[7.0; 4]);
            let last = read(schedule.reverse_step(tensor(&x_t), tensor(&x0), 0, noise));
            for (x0, last) in x0.iter().zip(last) {
                prop_assert!((x0 - last).abs() < 1e-6);
            }
        }
    }
}
