//! Training loop shared by all models: training, stopping, resuming, checkpoints.
//!
//! A model implements [`Task`]; [`train`] does the rest.

use std::collections::BTreeMap;
use std::path::Path;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param, ParamId};
use burn::optim::{GradientsAccumulator, GradientsParams, ModuleOptimizer};
use burn::tensor::{Bytes, Device, Tensor};
use datasets_spec::Seed;
use serde::{Deserialize, Serialize};

use crate::checkpoint::{self, EMA_PREFIX, Files, Run, STATE, Slot, take};
use crate::config::RunSettings;
use crate::data::prefetch;
use crate::model::dropout::seeded;
use crate::optimizer::adamw;
use crate::{Error, Session};

const OPTIMIZER: &str = "optimizer.bpk";

/// What the trainer needs of a model: data, loss and checkpoint files.
pub trait Task: Sync {
    /// The networks.
    type Model: Module;
    /// Data of a micro-batch.
    type Batch: Send + Sync;

    /// The micro-batches of a step, each with its share of the step's loss. The shares add up to
    /// one. The data depend on the seed of the run and on the step alone.
    ///
    /// # Errors
    /// The data cannot be read.
    fn draw(&self, step: u64) -> Result<Vec<(f64, Self::Batch)>, Error>;

    /// The mean loss of a micro-batch.
    fn loss(&self, model: &Self::Model, batch: &Self::Batch, device: &Device) -> Tensor<1>;

    /// Mean loss over the validation data, which are the same at every validation.
    fn validate(&self, model: &Self::Model, device: &Device) -> f32;

    /// The networks as files of a checkpoint.
    ///
    /// # Errors
    /// A network cannot be written.
    fn save(&self, model: &Self::Model, run_dir: &Path) -> Result<Files, Error>;

    /// The inverse of [`Task::save`]: takes the files it needs.
    ///
    /// # Errors
    /// A file is missing, damaged or of another network.
    fn load(&self, model: &mut Self::Model, files: &mut Files, run_dir: &Path)
    -> Result<(), Error>;
}

/// Settings of the trainer.
#[derive(Clone, Copy, Debug)]
pub struct TrainerConfig {
    /// Kind of model, shown with the progress.
    pub kind: &'static str,
    /// What a sample is called, in the plural.
    pub samples: &'static str,
    /// Settings that every training run has.
    pub run: RunSettings,
    /// Samples of an epoch.
    pub epoch_len: u64,
}

impl TrainerConfig {
    fn steps_per_epoch(&self) -> u64 {
        self.epoch_len.div_ceil(self.run.batch_size as u64).max(1)
    }

    /// Steps of the run.
    fn num_steps(&self) -> u64 {
        self.run.length.num_steps(self.steps_per_epoch())
    }
}

/// Result of a training run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrainReport {
    /// Steps made, those of earlier sessions included.
    pub steps: u64,
    /// Whether the run reached its last step.
    pub is_complete: bool,
    /// Trainable numbers.
    pub num_parameters: usize,
    /// Mean loss up to the first line of the metrics file.
    pub first_loss: Option<f64>,
    /// Mean loss of the last line of the metrics file.
    pub last_loss: Option<f64>,
    /// Lowest validation loss.
    pub best_val_loss: Option<f64>,
    /// Step of the lowest validation loss.
    pub best_step: u64,
    /// Training samples per second in this session, without validations and checkpoints.
    pub samples_per_sec: f64,
    /// Share of that time spent waiting for data.
    pub data_wait_share: f64,
}

impl TrainReport {
    /// The report in one line.
    pub fn summary(&self, run: &Path) -> String {
        let loss = |loss: Option<f64>| loss.map_or("-".to_owned(), |loss| format!("{loss:.4}"));
        format!(
            "{} steps{}, {} parameters, loss {} -> {}, best validation {} at step {}, {:.0} samples/s, {:.1} % of the time waiting for data; in {}",
            self.steps,
            if self.is_complete { "" } else { " (stopped)" },
            self.num_parameters,
            loss(self.first_loss),
            loss(self.last_loss),
            loss(self.best_val_loss),
            self.best_step,
            self.samples_per_sec,
            100.0 * self.data_wait_share,
            run.display()
        )
    }
}

/// Progress of a run, saved with every checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TrainState {
    step: u64,
    /// Losses of the steps since the last line of the metrics file.
    pending: Vec<f32>,
    first_loss: Option<f32>,
    last_loss: Option<f32>,
    best_val_loss: Option<f32>,
    best_step: u64,
}

#[derive(Serialize)]
struct MetricsLine {
    step: u64,
    loss: f32,
    learning_rate: f64,
    /// Norm of the last step's gradient before clipping; only where gradients are clipped.
    #[serde(skip_serializing_if = "Option::is_none")]
    gradient_norm: Option<f64>,
    samples_per_sec: f64,
    data_wait_share: f64,
}

#[derive(Serialize)]
struct ValidationLine {
    step: u64,
    val_loss: f32,
    is_best: bool,
}

/// Time spent on training steps, and the part of it spent waiting for data.
#[derive(Default)]
struct Speed {
    steps: u64,
    total_secs: f64,
    wait_secs: f64,
}

impl Speed {
    fn add(&mut self, total_secs: f64, wait_secs: f64) {
        self.steps += 1;
        self.total_secs += total_secs;
        self.wait_secs += wait_secs;
    }

    fn merge(&mut self, other: &Self) {
        self.steps += other.steps;
        self.total_secs += other.total_secs;
        self.wait_secs += other.wait_secs;
    }

    fn samples_per_sec(&self, batch_size: usize) -> f64 {
        if self.total_secs > 0.0 {
            (self.steps * batch_size as u64) as f64 / self.total_secs
        } else {
            0.0
        }
    }

    fn wait_share(&self) -> f64 {
        if self.total_secs > 0.0 {
            self.wait_secs / self.total_secs
        } else {
            0.0
        }
    }
}

/// Trains a model, or continues where the run folder left off, and returns it as it is used: with
/// averaged weights (EMA) where the settings ask for them.
///
/// A run that was interrupted continues exactly: weights, optimiser, data, noise and learning rate
/// are those of an uninterrupted one.
///
/// # Errors
/// The run folder holds a damaged checkpoint or a longer run, the data cannot be read, a loss is not
/// finite, or a file cannot be written.
pub fn train<T: Task>(
    task: &T,
    mut model: T::Model,
    config: &TrainerConfig,
    run: &Run,
    session: &Session<'_>,
) -> Result<(T::Model, TrainReport), Error> {
    let run_dir = run.dir();
    let device = session.device.clone().autodiff();
    let (settings, num_steps) = (&config.run, config.num_steps());
    let mut optimizer = adamw(settings.optimizer.weight_decay);
    let mut state = TrainState::default();
    let mut ema = None;
    if let Some(mut files) = checkpoint::read(run_dir, Slot::Last)? {
        if settings.optimizer.ema_decay.is_some() {
            ema = Some(load_ema(task, &model, &mut files, run_dir)?);
        }
        task.load(&mut model, &mut files, run_dir)?;
        (optimizer, state) = load_progress(optimizer, &mut files, run_dir)?;
    } else if let Some((from, mut files)) = run.init() {
        task.load(&mut model, &mut files, from)?;
    }
    if state.step > num_steps {
        return Err(Error::Config {
            field: "length",
            problem: format!(
                "it is {num_steps} steps, and the run has made {} already",
                state.step
            ),
        });
    }
    run.settle()?;
    run.rewind_log(state.step)?;
    let mut kept = state.step;
    if ema.is_none() && settings.optimizer.ema_decay.is_some() {
        ema = Some(Ema::of(&model.valid()));
    }

    let mut whole = Speed::default();
    session
        .progress
        .begin(&format!("train {}", config.kind), Some(num_steps));
    session.progress.advance(state.step);
    let model = std::thread::scope(|scope| {
        let batches = prefetch(scope, state.step..num_steps, |step| task.draw(step));
        let mut recent = Speed::default();
        while state.step < num_steps && !session.is_stopped() {
            let begun = session.secs();
            let parts = batches
                .recv()
                .expect("the producer sends a batch or an error for every step")?;
            let received = session.secs();

            let masks = Seed(settings.seed).derive(&["dropout", &state.step.to_string()]);
            let rate = settings.optimizer.rate_at(state.step, num_steps);
            let (loss, mut gradients) = gradients_of(task, &model, &parts, &device, masks, session);
            if !loss.is_finite() {
                return Err(Error::Diverged {
                    what: "training",
                    step: state.step,
                    kept,
                });
            }
            let gradient_norm = settings
                .optimizer
                .max_gradient_norm
                .map(|max_norm| clip_grad_norm(&mut gradients, &model, max_norm));
            model = optimizer.step(rate, model, gradients);
            if let (Some(ema), Some(decay)) = (&mut ema, settings.optimizer.ema_decay) {
                ema.update(&model.valid(), decay);
            }

            state.step += 1;
            state.pending.push(loss);
            recent.add(session.secs() - begun, received - begun);
            session.progress.advance(1);
            let is_last = state.step == num_steps;
            if state.step.is_multiple_of(settings.log_every) || is_last {
                let loss = mean(&state.pending);
                let samples_per_sec = recent.samples_per_sec(settings.batch_size);
                run.log(&MetricsLine {
                    step: state.step,
                    loss,
                    learning_rate: rate,
                    gradient_norm,
                    samples_per_sec,
                    data_wait_share: recent.wait_share(),
                })?;
                session.progress.message(&format!(
                    "loss {loss:.4}, {samples_per_sec:.0} {}/s, {:.1} % waiting",
                    config.samples,
                    100.0 * recent.wait_share()
                ));
                state.first_loss.get_or_insert(loss);
                state.last_loss = Some(loss);
                state.pending.clear();
                whole.merge(&recent);
                recent = Speed::default();
            }
            let keep_every = settings.keep_epochs * config.steps_per_epoch();
            let is_kept = keep_every > 0 && state.step.is_multiple_of(keep_every);
            if state.step.is_multiple_of(settings.val_every) || is_last {
                let used = used(&model, ema.as_ref());
                let val_loss = task.validate(&used, session.device);
                if !val_loss.is_finite() {
                    return Err(Error::Diverged {
                        what: "validation",
                        step: state.step,
                        kept,
                    });
                }
                let is_best = state.best_val_loss.is_none_or(|best| val_loss < best);
                run.log(&ValidationLine {
                    step: state.step,
                    val_loss,
                    is_best,
                })?;
                if is_best {
                    state.best_val_loss = Some(val_loss);
                    state.best_step = state.step;
                }
                let files = save(task, &model, ema.as_ref(), &optimizer, &state, run_dir)?;
                run.write(Slot::Last, &files)?;
                kept = state.step;
                if is_best {
                    run.write(Slot::Best, &task.save(&used, run_dir)?)?;
                }
            }
            if is_kept {
                let epoch = state.step / config.steps_per_epoch();
                let files = task.save(&used(&model, ema.as_ref()), run_dir)?;
                run.write(Slot::Epoch(epoch), &files)?;
            }
        }
        whole.merge(&recent);
        Ok(model)
    })?;

    let is_complete = state.step == num_steps;
    if !is_complete {
        let files = save(task, &model, ema.as_ref(), &optimizer, &state, run_dir)?;
        run.write(Slot::Last, &files)?;
    }
    session.progress.finish(&format!(
        "{} steps, best validation loss {}{}",
        state.step,
        state
            .best_val_loss
            .map_or("none yet".to_owned(), |loss| format!("{loss:.4}")),
        if is_complete {
            ""
        } else {
            "; stopped and saved, the same command continues it"
        }
    ));
    let report = TrainReport {
        steps: state.step,
        is_complete,
        num_parameters: model.num_params(),
        first_loss: state.first_loss.map(f64::from),
        last_loss: state.last_loss.map(f64::from),
        best_val_loss: state.best_val_loss.map(f64::from),
        best_step: state.best_step,
        samples_per_sec: whole.samples_per_sec(settings.batch_size),
        data_wait_share: whole.wait_share(),
    };
    Ok((used(&model, ema.as_ref()), report))
}

/// The loss of a step and its gradients on the first device. The micro-batches are spread over all
/// devices of the session, each of which holds a copy of the model; their results are added in the order
/// of the micro-batches, so that a step does not depend on which device is done first.
fn gradients_of<T: Task>(
    task: &T,
    model: &T::Model,
    parts: &[(f64, T::Batch)],
    device: &Device,
    masks: Seed,
    session: &Session<'_>,
) -> (f32, GradientsParams) {
    let others: Vec<Device> = session
        .more_devices
        .iter()
        .map(|device| device.clone().autodiff())
        .collect();
    let one = |model: &T::Model, index: usize, device: &Device| {
        let (share, batch) = &parts[index];
        // Dropout depends on the step and the micro-batch, so that a continued run repeats it. A GPU
        // draws its own masks.
        let seed = masks.draw_u64(&[&index.to_string()]);
        device.seed(seed);
        let loss = seeded(seed, || task.loss(model, batch, device)).mul_scalar(*share);
        let value: f32 = loss.clone().into_scalar();
        (value, GradientsParams::from_grads(loss.backward(), model))
    };
    if parts.len() == 1 {
        return one(model, 0, device);
    }
    let mut total = 0.0;
    let mut sum = GradientsAccumulator::new();
    if others.is_empty() {
        for index in 0..parts.len() {
            let (loss, gradients) = one(model, index, device);
            total += loss;
            sum.accumulate(model, gradients);
        }
        return (total, sum.grads());
    }
    let devices: Vec<Device> = std::iter::once(device.clone()).chain(others).collect();
    let mut found: Vec<(usize, f32, GradientsParams)> = std::thread::scope(|scope| {
        let running: Vec<_> = devices
            .iter()
            .enumerate()
            .map(|(place, device)| {
                let copy = model.clone().fork(device);
                let (one, stride) = (&one, devices.len());
                scope.spawn(move || {
                    (place..parts.len())
                        .step_by(stride)
                        .map(|index| {
                            let (loss, gradients) = one(&copy, index, device);
                            (index, loss, gradients)
                        })
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        running
            .into_iter()
            .flat_map(|thread| thread.join().expect("a device's thread does not panic"))
            .collect()
    });
    found.sort_by_key(|(index, ..)| *index);
    for (_, loss, gradients) in found {
        total += loss;
        sum.accumulate(model, gradients.to_device(device, model));
    }
    (total, sum.grads())
}

/// The model for validation and inference: with EMA weights if the settings ask for them.
fn used<M: Module>(model: &M, ema: Option<&Ema>) -> M {
    match ema {
        Some(ema) => ema.put_into(model.valid()),
        None => model.valid(),
    }
}

fn mean(losses: &[f32]) -> f32 {
    let sum: f64 = losses.iter().map(|&loss| f64::from(loss)).sum();
    (sum / losses.len().max(1) as f64) as f32
}

/// Scales the gradients down to `max_norm` if their total norm is larger, as `clip_grad_norm_` of
/// PyTorch does, and returns the norm before.
fn clip_grad_norm<M: Module>(gradients: &mut GradientsParams, model: &M, max_norm: f64) -> f64 {
    struct Norm<'a> {
        gradients: &'a GradientsParams,
        square: f64,
    }
    impl ModuleVisitor for Norm<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = self.gradients.get::<D>(param.id) {
                let square: f32 = gradient.square().sum().into_scalar();
                self.square += f64::from(square);
            }
        }
    }
    struct Scale<'a> {
        gradients: &'a mut GradientsParams,
        by: f64,
    }
    impl ModuleVisitor for Scale<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = self.gradients.remove::<D>(param.id) {
                self.gradients
                    .register(param.id, gradient.mul_scalar(self.by));
            }
        }
    }
    let mut norm = Norm {
        gradients,
        square: 0.0,
    };
    model.visit(&mut norm);
    let norm = norm.square.sqrt();
    if norm > max_norm {
        model.visit(&mut Scale {
            gradients,
            by: max_norm / norm,
        });
    }
    norm
}

/// The exponential moving average (EMA) of the weights; every parameter is flattened.
#[derive(Clone, Debug)]
struct Ema(BTreeMap<ParamId, Tensor<1>>);

impl Ema {
    /// Starts at the weights of a model.
    fn of<M: Module>(model: &M) -> Self {
        let mut ema = Self(BTreeMap::new());
        ema.update(model, 0.0);
        ema
    }

    /// `decay * self + (1 - decay) * weights`.
    fn update<M: Module>(&mut self, model: &M, decay: f64) {
        struct Update<'a> {
            ema: &'a mut BTreeMap<ParamId, Tensor<1>>,
            decay: f64,
        }
        impl ModuleVisitor for Update<'_> {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                let now = param.val().reshape([-1]);
                let next = match self.ema.remove(&param.id) {
                    Some(before) => {
                        before.mul_scalar(self.decay) + now.mul_scalar(1.0 - self.decay)
                    }
                    None => now,
                };
                self.ema.insert(param.id, next);
            }
        }
        model.visit(&mut Update {
            ema: &mut self.0,
            decay,
        });
    }

    /// A model with the averaged weights.
    fn put_into<M: Module>(&self, model: M) -> M {
        struct Put<'a>(&'a BTreeMap<ParamId, Tensor<1>>);
        impl ModuleMapper for Put<'_> {
            fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
                match self.0.get(&param.id) {
                    Some(average) => {
                        let average = average.clone();
                        param.map(|now| average.reshape(now.dims()))
                    }
                    None => param,
                }
            }
        }
        model.map(&mut Put(&self.0))
    }
}

fn save<T: Task>(
    task: &T,
    model: &T::Model,
    ema: Option<&Ema>,
    optimizer: &ModuleOptimizer,
    state: &TrainState,
    run_dir: &Path,
) -> Result<Files, Error> {
    let moments = optimizer
        .into_bytes()
        .map_err(|problem| Error::weights(&run_dir.join(OPTIMIZER), problem))?;
    let state = serde_json::to_vec(state).map_err(|source| Error::Json {
        path: run_dir.join(STATE),
        source,
    })?;
    let mut files = task.save(&model.valid(), run_dir)?;
    files.insert(OPTIMIZER.to_owned(), moments.to_vec());
    files.insert(STATE.to_owned(), state);
    if let Some(ema) = ema {
        let averaged = task.save(&ema.put_into(model.valid()), run_dir)?;
        files.extend(
            averaged
                .into_iter()
                .map(|(name, bytes)| (format!("{EMA_PREFIX}{name}"), bytes)),
        );
    }
    Ok(files)
}

fn load_ema<T: Task>(
    task: &T,
    model: &T::Model,
    files: &mut Files,
    run_dir: &Path,
) -> Result<Ema, Error> {
    let mut averaged: Files = files
        .iter()
        .filter_map(|(name, bytes)| {
            Some((name.strip_prefix(EMA_PREFIX)?.to_owned(), bytes.clone()))
        })
        .collect();
    let mut twin = model.clone();
    task.load(&mut twin, &mut averaged, run_dir)?;
    Ok(Ema::of(&twin.valid()))
}

fn load_progress(
    optimizer: ModuleOptimizer,
    files: &mut Files,
    run_dir: &Path,
) -> Result<(ModuleOptimizer, TrainState), Error> {
    let moments = Bytes::from_bytes_vec(take(files, OPTIMIZER, run_dir)?);
    let optimizer = optimizer
        .from_bytes(moments)
        .map_err(|problem| Error::weights(&run_dir.join(OPTIMIZER), problem))?;
    let state =
        serde_json::from_slice(&take(files, STATE, run_dir)?).map_err(|source| Error::Json {
            path: run_dir.join(STATE),
            source,
        })?;
    Ok((optimizer, state))
}

#[cfg(test)]
mod tests {
    use burn::nn::{Linear, LinearConfig};

    use super::*;
    use crate::model::weights::draw;

    fn numbers(layer: &Linear) -> Vec<f32> {
        let weight = layer.weight.val().into_data();
        weight.try_into_vec_as().expect("floats")
    }

    fn layer(seed: u64, device: &Device) -> Linear {
        draw(LinearConfig::new(3, 2).init(device), Seed(seed)).expect("a known layer")
    }

    #[test]
    fn the_ema_moves_by_its_decay() {
        let device = Device::flex();
        let (first, second) = (layer(1, &device), layer(2, &device));
        let mut ema = Ema::of(&first);
        ema.update(&second, 0.75);
        let mixed = numbers(&ema.put_into(layer(3, &device)));
        for ((mixed, first), second) in mixed.iter().zip(numbers(&first)).zip(numbers(&second)) {
            assert!((mixed - (0.75 * first + 0.25 * second)).abs() < 1e-6);
        }
    }

    #[test]
    fn large_gradients_are_clipped_together_and_small_ones_are_left() {
        let device = Device::flex().autodiff();
        let model = layer(1, &device);
        let gradients = || {
            let x = Tensor::<2>::from_data([[3.0, 0.0, 4.0]], &device);
            GradientsParams::from_grads(model.forward(x).sum().backward(), &model)
        };
        // Weights: two columns of (3, 0, 4); biases: two ones.
        let expected = (2.0 * 25.0 + 2.0f64).sqrt();
        let mut clipped = gradients();
        let norm = clip_grad_norm(&mut clipped, &model, 1.0);
        assert!((norm - expected).abs() < 1e-5);
        assert!((clip_grad_norm(&mut clipped, &model, 100.0) - 1.0).abs() < 1e-5);
        let mut left = gradients();
        clip_grad_norm(&mut left, &model, 100.0);
        assert!((clip_grad_norm(&mut left, &model, 100.0) - expected).abs() < 1e-5);
    }
}
