//! Sampling with a network that predicts the clean motion under the cosine schedule: TMED and MDM.

use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::config::ensure;
use crate::sample::reverse;
use crate::schedule::Schedule;

/// Selection of steps when sampling uses fewer steps than training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Respacing {
    /// Training steps, spread evenly from the first to the last.
    ///
    /// # Source
    /// Nichol and Dhariwal 2021, Sec. 4.
    #[default]
    Spread,
    /// A separate cosine schedule, whose steps are shown to the network as the first training steps. The network then
    /// sees more noise than it was trained with at those steps: the defect of the released TMED.
    Official,
}

/// A step of sampling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleStep {
    /// Number of steps that remain after this one: 0 at the last step.
    pub index: usize,
    /// The diffusion step that the network is shown.
    pub timestep: usize,
}

/// The steps from noise to a clean motion.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleSteps {
    schedule: Schedule,
    timesteps: Vec<usize>,
}

impl SampleSteps {
    /// Selects `num_steps` sampling steps for a network trained with a cosine schedule of `num_trained` steps.
    ///
    /// # Errors
    /// `num_steps` is 0 or greater than `num_trained`.
    pub fn new(num_trained: usize, num_steps: usize, respacing: Respacing) -> Result<Self, Error> {
        let problem = format!("it is {num_steps}, and must be from 1 to {num_trained}");
        ensure((1..=num_trained).contains(&num_steps), "steps", problem)?;
        if respacing == Respacing::Official {
            return Ok(Self {
                schedule: Schedule::cosine(num_steps)?,
                timesteps: (0..num_steps).collect(),
            });
        }
        let stride = (num_trained - 1) as f64 / (num_steps.max(2) - 1) as f64;
        // A single step starts from the noisiest training step.
        let timesteps: Vec<usize> = (0..num_steps)
            .map(|step| {
                let left = (num_steps - 1 - step) as f64;
                ((num_trained - 1) as f64 - left * stride).round_ties_even() as usize
            })
            .collect();
        Ok(Self {
            schedule: Schedule::cosine(num_trained)?.keeping(&timesteps),
            timesteps,
        })
    }

    /// The noise schedule of the sampling steps.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// The diffusion step that the network is shown at each sampling step, `[N]`, ascending.
    pub fn timesteps(&self) -> &[usize] {
        &self.timesteps
    }

    /// Makes all steps from `start`, which is noise or a noised motion. `clean` estimates the clean motion of a noisy
    /// one, and `noise` returns the noise of a step.
    ///
    /// # Shapes
    /// All `[B, T, D]`.
    ///
    /// # Source
    /// Ho et al. 2020, Algorithm 2, with the posterior variance ("fixed small") and no clipping.
    pub fn sample(
        &self,
        start: Tensor<3>,
        clean: impl Fn(&Tensor<3>, SampleStep) -> Tensor<3>,
        mut noise: impl FnMut(SampleStep) -> Tensor<3>,
    ) -> Tensor<3> {
        let step = |index: usize| SampleStep {
            index,
            timestep: self.timesteps[index],
        };
        reverse(
            &self.schedule,
            None,
            None,
            |x, index| clean(x, step(index)),
            |mean, _| mean,
            |index| index.map_or_else(|| start.clone(), |index| noise(step(index))),
            |_, _| {},
        )
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use datasets_spec::{Rng, Seed};

    use super::*;
    use crate::sample::noise::Noise;
    use crate::transfer::read;

    #[test]
    fn fewer_steps_are_spread_over_those_of_training() {
        let spread = |steps| SampleSteps::new(1_000, steps, Respacing::Spread).expect("steps");
        let ten = spread(10);
        assert_eq!(
            ten.timesteps(),
            [0, 111, 222, 333, 444, 555, 666, 777, 888, 999]
        );
        let whole = Schedule::cosine(1_000).expect("steps");
        for (signal, &step) in ten.schedule().alphas_cumprod.iter().zip(ten.timesteps()) {
            assert!((signal - whole.alphas_cumprod[step]).abs() < 1e-14);
        }
        assert_eq!(spread(1).timesteps(), [999]);
        assert!(spread(1_000).timesteps().iter().copied().eq(0..1_000));
        let official = SampleSteps::new(300, 10, Respacing::Official).expect("steps");
        assert!(official.timesteps().iter().copied().eq(0..10));
        assert_eq!(*official.schedule(), Schedule::cosine(10).expect("steps"));
        assert!(SampleSteps::new(10, 0, Respacing::Spread).is_err());
        assert!(SampleSteps::new(10, 11, Respacing::Spread).is_err());
    }

    #[test]
    fn the_last_step_returns_the_estimate_and_no_row_sees_another() {
        let steps = SampleSteps::new(50, 7, Respacing::Spread).expect("steps");
        let device = Device::flex();
        let rngs = |rows: &[&str]| -> Vec<Rng> {
            rows.iter().map(|row| Seed(1).rng(&["row", row])).collect()
        };
        let sampled = |rows: &[&str]| -> Vec<f32> {
            let mut rngs = rngs(rows);
            let mut noise = Noise::new(&mut rngs, [3, 2], 8, &device);
            let start = noise.step();
            let mut indices = Vec::new();
            let x = steps.sample(
                start,
                |x, step| match step.index {
                    0 => x.clone(),
                    _ => x.clone().mul_scalar(0.5),
                },
                |step| {
                    indices.push(step.index);
                    noise.step()
                },
            );
            assert!(indices.into_iter().eq((0..7).rev()));
            read(x)
        };
        let both = sampled(&["a", "b"]);
        assert_eq!(both[..6], sampled(&["a"]));
        assert_eq!(both[6..], sampled(&["b"]));

        let start = Noise::new(&mut rngs(&["a"]), [3, 2], 1, &device).step();
        let wanted = start.clone().mul_scalar(3.0);
        let x = steps.sample(start.clone(), |_, _| wanted.clone(), |_| start.clone());
        let difference: f32 = (x - wanted).abs().max().into_scalar();
        assert!(difference < 1e-6);
    }
}
