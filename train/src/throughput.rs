//! Training speed of a device: training steps of the editor's network on synthetic windows, without a dataset.

use std::time::Duration;

use burn::optim::GradientsParams;
use burn::tensor::{Device, Distribution, Tensor};
use datasets_spec::{Fps, Seed};
use kinematics::canonical::WINDOW_FRAMES;
use kinematics::normalise::{FRAME_WIDTH, Normalizer};

use crate::config::{Preset, ScheduleName, TrainConfig};
use crate::data::{NoisyBatch, TextBatch};
use crate::diffusion::Objective;
use crate::model::denoiser::Denoiser;
use crate::model::pass::{Arithmetic, Pass};
use crate::model::weights::draw;
use crate::optimizer::adamw;
use crate::schedule::Schedule;
use crate::transfer::read;

/// Number of steps before timing starts; the first steps compile kernels and allocate memory.
const WARM_UP: usize = 3;
const DIFFUSION_STEPS: usize = 100;

/// The editor's network of a preset, with random initial weights.
pub fn network(preset: Preset, device: &Device) -> Denoiser {
    let config = TrainConfig::preset(preset);
    let (model, previous) = (&config.model, config.diffusion.previous);
    let network = Denoiser::new(model, previous, model.width, FRAME_WIDTH, device);
    draw(network, Seed(1)).expect("every layer has a rule")
}

/// Trains the network of preset `paper` or `official` (those without our additions) for at least `least`, in steps of
/// `rows` windows. A step sends the batch to the device, and computes the loss, the gradients and AdamW. A value is
/// read from the device after 1, 2, 4, ... further steps. Returns the number of timed steps and their duration in
/// seconds.
///
/// # Errors
/// The loss is not finite, or the device fails.
pub fn of_training(
    preset: Preset,
    rows: usize,
    least: Duration,
    device: &Device,
    arithmetic: Arithmetic,
    clock: &dyn Fn() -> Duration,
) -> Result<(usize, f64), String> {
    let config = TrainConfig::preset(preset);
    let device = device.clone().autodiff();
    let schedule = Schedule::new(ScheduleName::Official, DIFFUSION_STEPS)
        .map_err(|error| error.to_string())?;
    let objective = Objective {
        schedule: &schedule,
        extrapolation: None,
        config: &config.diffusion,
        normalizer: &Normalizer {
            min: [-1.0; 3],
            max: [1.0; 3],
        },
        fps: Fps::STORE,
    };
    let batch = noisy_batch(rows);
    let text = Tensor::random(
        [rows, config.model.width],
        Distribution::Normal(0.0, 1.0),
        &device,
    );
    let mut model = network(preset, &device);
    let mut optimizer = adamw(0.01, arithmetic);
    let pass = Pass::new(arithmetic);
    let mut begun = clock();
    let mut steps = 0;
    // A read waits for the device. Training runs read only every few steps, so the rounds between reads grow.
    let rounds = std::iter::successors(Some(1), |round| Some(2 * round));
    for (place, round) in std::iter::once(WARM_UP).chain(rounds).enumerate() {
        let mut last = None;
        for _ in 0..round {
            let loss = objective.loss(&model, &batch, text.clone(), &pass);
            last = Some(loss.clone().inner());
            let gradients = GradientsParams::from_grads(loss.backward(), &model);
            model = optimizer.step(1e-4, model, gradients);
        }
        let loss = last.map_or(f32::NAN, |loss| read(loss)[0]);
        device
            .sync()
            .map_err(|error| format!("does not answer: {error:?}"))?;
        if !loss.is_finite() {
            return Err(format!("gives a loss of {loss}"));
        }
        if place == 0 {
            begun = clock();
            continue;
        }
        steps += round;
        if clock() - begun >= least {
            break;
        }
    }
    Ok((steps, (clock() - begun).as_secs_f64()))
}

/// A batch of windows without texts, because the objective is given their vectors.
///
/// # Shapes
/// Windows of `rows` items, `[B, W * 84]`.
pub fn noisy_batch(rows: usize) -> NoisyBatch {
    let numbers = rows * WINDOW_FRAMES * FRAME_WIDTH;
    let values = || -> Vec<f32> { (0..numbers).map(|at| (at as f32 * 0.37).sin()).collect() };
    NoisyBatch {
        original: values(),
        edited: values(),
        noise: values(),
        timesteps: (0..rows).map(|row| row % DIFFUSION_STEPS).collect(),
        progress: vec![0.5; rows],
        texts: TextBatch::Vectors {
            values: Vec::new(),
            lengths: Vec::new(),
        },
        text_kept: vec![1.0; rows],
        is_start: vec![false; rows],
    }
}
