//! The reverse process from noise to windows.

use std::cell::Cell;

use burn::tensor::Tensor;

use crate::config::{GuidanceConfig, GuidanceTarget, Prediction};
use crate::diffusion::{guide, put_fixed};
use crate::extrapolation::{Basis, Extrapolation};
use crate::model::coordinator::Coordinator;
use crate::model::denoiser::{Denoiser, PreparedDenoiser};
use crate::model::pass::Pass;
use crate::model::transformer::PreparedWeights;
use crate::schedule::Schedule;

/// Conditions of a batch of windows to generate.
#[derive(Clone, Debug)]
pub struct Condition {
    /// Normalised original windows, `[B, W, D]`; `D` is 84, or 66 for the body joints alone.
    pub original: Tensor<3>,
    /// Normalised first frames, `[B, 2, D]`; none if these frames are generated too.
    pub fixed: Option<Tensor<3>>,
    /// Text vectors, `[B, d]`.
    pub text: Tensor<2>,
    /// Position of each window within the range of its instruction, in [0, 1], `[B]`.
    pub progress: Vec<f32>,
}

/// A coordinator that guides sampling.
pub struct Guide<'a> {
    /// The coordinator's network.
    pub network: &'a Coordinator,
    /// The tensor that the guidance moves, and by how much.
    pub config: GuidanceConfig,
    /// Returns the seconds since a fixed moment.
    pub clock: &'a dyn Fn() -> f64,
    /// Seconds spent in the guidance so far. A GPU computes asynchronously, and nothing waits for it here. On a GPU
    /// these are the seconds for queueing operations, and the computation is counted with the denoiser.
    pub secs: Cell<f64>,
}

impl Guide<'_> {
    /// The displacement of `x` at a step; none if the guidance moves another tensor or does not guide this step.
    fn push(
        &self,
        target: GuidanceTarget,
        x: &Tensor<3>,
        timestep: usize,
        pass: &Pass,
    ) -> Option<Tensor<3>> {
        let is_guided = target == self.config.target && timestep < self.config.num_steps;
        if !is_guided || self.config.strength == 0.0 {
            return None;
        }
        let begun = (self.clock)();
        // The network is told that a clean window is at step 0, which has the least noise.
        let seen_as = match target {
            GuidanceTarget::CleanPrediction => 0,
            GuidanceTarget::PosteriorMean => timestep,
        };
        let gradient = self
            .network
            .gradient(x.clone(), &vec![seen_as; x.dims()[0]], pass)
            .mul_scalar(self.config.strength);
        self.secs.set(self.secs.get() + (self.clock)() - begun);
        Some(gradient)
    }
}

/// Generates windows from pure noise.
#[derive(Clone, Copy)]
pub struct Sampler<'a> {
    /// The denoiser's network.
    pub denoiser: &'a Denoiser,
    /// Weights of the denoiser, and the arithmetic of the denoiser and the coordinator.
    pub weights: &'a PreparedWeights,
    /// The schedule that the denoiser was trained with.
    pub schedule: &'a Schedule,
    /// Quantity that the denoiser predicts.
    pub prediction: Prediction,
    /// Linear guess for predictions that are relative to it; none for other predictions.
    pub extrapolation: Option<&'a Extrapolation>,
    /// Whether estimates of the clean window are clipped to [-1, 1].
    pub clip: bool,
    /// Guidance weight of the text.
    pub guidance: f64,
    /// Guidance by a coordinator.
    pub coordinator: Option<&'a Guide<'a>>,
}

impl Sampler<'_> {
    /// Whether predictions with and without text are combined. At weight 1, the prediction without text cancels out.
    fn is_guided(&self) -> bool {
        self.guidance != 1.0
    }

    /// Generates a batch of windows, `[B, W, D]`.
    ///
    /// `noise` is called first for the start (`None`), then for every reverse step in order; `on_step` is given each
    /// result. The fixed frames are restored, unscaled, at the start and after every step. The predictions with and
    /// without text share one batch.
    ///
    /// # Source
    /// Released `p_sample_loop` (`algorithms` section 5).
    pub fn sample(
        &self,
        condition: &Condition,
        noise: impl FnMut(Option<usize>) -> Tensor<3>,
        on_step: impl FnMut(usize, &Tensor<3>),
    ) -> Tensor<3> {
        let windows = Sampling::new(*self, condition);
        let placed = match &condition.fixed {
            Some(fixed) => put_fixed(condition.original.clone(), fixed.clone()),
            None => condition.original.clone(),
        };
        reverse(
            self.schedule,
            condition.fixed.as_ref(),
            windows.basis.centre(&placed).as_ref(),
            |x, timestep| windows.estimate(x, timestep),
            |mean, timestep| windows.nudge(mean, timestep),
            noise,
            on_step,
        )
    }
}

struct Sampling<'a> {
    sampler: Sampler<'a>,
    denoiser: PreparedDenoiser<'a>,
    basis: Basis,
    batch: usize,
    pass: Pass,
}

impl<'a> Sampling<'a> {
    fn new(sampler: Sampler<'a>, condition: &Condition) -> Self {
        let batch = condition.progress.len();
        let (text, original, progress) = if sampler.is_guided() {
            (
                Tensor::cat(vec![condition.text.clone(), condition.text.zeros_like()], 0),
                twice(&condition.original),
                condition.progress.repeat(2),
            )
        } else {
            (
                condition.text.clone(),
                condition.original.clone(),
                condition.progress.clone(),
            )
        };
        let is_start = vec![condition.fixed.is_none(); batch];
        let basis = Basis::new(condition.original.clone(), &is_start, sampler.extrapolation);
        Self {
            denoiser: sampler.denoiser.prepare(
                sampler.weights,
                sampler.schedule.len(),
                text,
                &progress,
                basis.seen(original),
            ),
            basis,
            batch,
            pass: Pass::new(sampler.weights.arithmetic()),
            sampler,
        }
    }

    /// Estimates the clean windows from noisy ones, `[B, W, D]`.
    fn estimate(&self, x: &Tensor<3>, timestep: usize) -> Tensor<3> {
        let Self { sampler, batch, .. } = self;
        let input = if sampler.is_guided() {
            twice(x)
        } else {
            x.clone()
        };
        let predicted = self.denoiser.forward(self.basis.seen(input), timestep);
        let predicted = if sampler.is_guided() {
            guide(
                predicted.clone().narrow(0, 0, *batch),
                predicted.narrow(0, *batch, *batch),
                sampler.guidance,
            )
        } else {
            predicted
        };
        let mut x0 = sampler.schedule.clean_of(
            sampler.prediction,
            predicted,
            x,
            &self.basis,
            &vec![timestep; *batch],
        );
        if sampler.clip {
            x0 = x0.clamp(-1.0, 1.0);
        }
        match self.push(GuidanceTarget::CleanPrediction, &x0, timestep) {
            Some(gradient) => x0 - gradient,
            None => x0,
        }
    }

    /// Moves the mean of a posterior by the coordinator's guidance.
    fn nudge(&self, mean: Tensor<3>, timestep: usize) -> Tensor<3> {
        // The last step has no noise, and the displacement would be multiplied by its standard deviation, 0.
        let gradient = (timestep > 0)
            .then(|| self.push(GuidanceTarget::PosteriorMean, &mean, timestep))
            .flatten();
        match gradient {
            Some(gradient) => {
                let spread = self.sampler.schedule.posterior_variance[timestep].sqrt();
                mean - gradient.mul_scalar(spread)
            }
            None => mean,
        }
    }

    fn push(&self, target: GuidanceTarget, x: &Tensor<3>, timestep: usize) -> Option<Tensor<3>> {
        let coordinator = self.sampler.coordinator?;
        coordinator.push(target, x, timestep, &self.pass)
    }
}

fn twice(x: &Tensor<3>) -> Tensor<3> {
    Tensor::cat(vec![x.clone(), x.clone()], 0)
}

/// Runs the reverse process from pure noise, `[B, W, D]`. `estimate` estimates the clean windows from noisy ones, and
/// `nudge` moves the mean of a posterior. The noise has mean `centre`, or zero. `noise` and `on_step` are those of
/// [`Sampler::sample`].
pub fn reverse(
    schedule: &Schedule,
    fixed: Option<&Tensor<3>>,
    centre: Option<&Tensor<3>>,
    estimate: impl Fn(&Tensor<3>, usize) -> Tensor<3>,
    nudge: impl Fn(Tensor<3>, usize) -> Tensor<3>,
    mut noise: impl FnMut(Option<usize>) -> Tensor<3>,
    mut on_step: impl FnMut(usize, &Tensor<3>),
) -> Tensor<3> {
    let put = |x: Tensor<3>| match fixed {
        Some(fixed) => put_fixed(x, fixed.clone()),
        None => x,
    };
    // Subtracts the centre, and adds it back.
    let from_centre = |x: Tensor<3>| match centre {
        Some(centre) => x - centre.clone(),
        None => x,
    };
    let to_windows = |x: Tensor<3>| match centre {
        Some(centre) => x + centre.clone(),
        None => x,
    };
    let mut x = put(to_windows(noise(None)));
    for timestep in (0..schedule.len()).rev() {
        let x0 = estimate(&x, timestep);
        let timesteps = vec![timestep; x.dims()[0]];
        let mean = schedule.posterior_mean(from_centre(x0), from_centre(x), &timesteps);
        let mean = nudge(to_windows(mean), timestep);
        x = put(schedule.add_noise(mean, timestep, noise(Some(timestep))));
        on_step(timestep, &x);
    }
    x
}
