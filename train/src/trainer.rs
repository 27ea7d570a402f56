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
use crate::model::pass::{Arithmetic, Pass};
use crate::optimizer::adamw;
use crate::transfer::{read_all, weighted_mean};
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
    fn loss(
        &self,
        model: &Self::Model,
        batch: &Self::Batch,
        device: &Device,
        pass: &Pass,
    ) -> Tensor<1>;

    /// The validation data, which are the same at every validation: micro-batches, and the number of samples that
    /// each counts for.
    fn validation(&self) -> impl Iterator<Item = (usize, &Self::Batch)>;

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
    let mut optimizer = adamw(settings.optimizer.weight_decay, session.arithmetic);
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
    let mut unread = Unread::default();
    session
        .progress
        .begin(&format!("train {}", config.kind), Some(num_steps));
    session.progress.advance(state.step);
    let model = std::thread::scope(|scope| -> Result<T::Model, Error> {
        let batches = prefetch(scope, state.step..num_steps, |step| task.draw(step));
        let mut recent = Speed::default();
        let mut others = Others::new(&model, session.more_devices);
        while state.step < num_steps && !session.is_stopped() {
            let begun = session.secs();
            let parts = batches
                .recv()
                .expect("the producer sends a batch or an error for every step")?;
            let received = session.secs();

            let masks = Seed(settings.seed).derive(&["dropout", &state.step.to_string()]);
            let rate = settings.optimizer.rate_at(state.step, num_steps);
            let (loss, mut gradients) = gradients_of(
                task,
                &model,
                &parts,
                &device,
                masks,
                &mut others,
                session.arithmetic,
            );
            unread.losses.push(loss);
            unread.norm = settings
                .optimizer
                .max_gradient_norm
                .map(|max_norm| clip_grad_norm(&mut gradients, &model, max_norm));
            model = optimizer.step(rate, model, gradients);
            if let (Some(ema), Some(decay)) = (&mut ema, settings.optimizer.ema_decay) {
                ema.update(&model.valid(), warmed_up(decay, state.step));
            }

            state.step += 1;
            let is_last = state.step == num_steps;
            let is_logged = state.step.is_multiple_of(settings.log_every) || is_last;
            let is_validated = state.step.is_multiple_of(settings.val_every) || is_last;
            // A card is waited for here alone, so the time of a line holds all that its steps took.
            let gradient_norm = if is_logged || is_validated {
                unread.read(&mut state, kept)?
            } else {
                None
            };
            recent.add(session.secs() - begun, received - begun);
            session.progress.advance(1);
            if is_logged {
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
            if is_validated {
                let used = used(&model, ema.as_ref());
                let val_loss = validate(task, &used, session);
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
        // A run that is stopped is saved with the losses since its last line.
        unread.read(&mut state, kept)?;
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

/// The losses and the norm of steps that are still on the device.
#[derive(Default)]
struct Unread {
    losses: Vec<Tensor<1>>,
    /// Norm of the last step's gradient before clipping.
    norm: Option<Tensor<1>>,
}

impl Unread {
    /// Reads everything at once: appends the losses to those of `state`, and returns the norm.
    fn read(&mut self, state: &mut TrainState, kept: u64) -> Result<Option<f64>, Error> {
        let Self { mut losses, norm } = std::mem::take(self);
        let first = state.step - losses.len() as u64;
        let num_losses = losses.len();
        losses.extend(norm);
        let mut values = read_all(losses);
        let norm = values.drain(num_losses..).next().map(f64::from);
        if let Some(place) = values.iter().position(|loss| !loss.is_finite()) {
            return Err(Error::Diverged {
                what: "training",
                step: first + place as u64,
                kept,
            });
        }
        state.pending.extend(values);
        Ok(norm)
    }
}

/// The devices beside the first that compute micro-batches, each with a copy of the model.
struct Others<M> {
    devices: Vec<Device>,
    copies: Vec<M>,
}

impl<M: Module> Others<M> {
    fn new(model: &M, devices: &[Device]) -> Self {
        let devices: Vec<Device> = devices
            .iter()
            .map(|device| device.clone().autodiff())
            .collect();
        Self {
            copies: devices
                .iter()
                .map(|device| model.clone().fork(device))
                .collect(),
            devices,
        }
    }

    /// Gives the copies the weights that the model has now, each device in one transfer.
    fn update(&mut self, model: &M) {
        let weights = Flat::of_weights(model);
        let copies = std::mem::take(&mut self.copies);
        self.copies = copies
            .into_iter()
            .zip(&self.devices)
            .map(|(copy, device)| {
                copy.map(&mut PutWeights {
                    from: &weights.to_device(device),
                    next: 0,
                })
            })
            .collect();
    }
}

/// Numbers of parameters in one tensor without gradients of its own, in the order in which a model visits
/// the parameters.
struct Flat {
    ids: Vec<ParamId>,
    values: Tensor<1>,
}

impl Flat {
    /// The weights of a model.
    fn of_weights<M: Module>(model: &M) -> Self {
        struct Collect(Vec<ParamId>, Vec<Tensor<1>>);
        impl ModuleVisitor for Collect {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                self.0.push(param.id);
                self.1.push(param.val().inner().reshape([-1]));
            }
        }
        let mut found = Collect(Vec::new(), Vec::new());
        model.visit(&mut found);
        Self {
            ids: found.0,
            values: Tensor::cat(found.1, 0),
        }
    }

    /// The gradients of a model; some parameters may have none.
    fn of_gradients<M: Module>(model: &M, gradients: &GradientsParams) -> Self {
        struct Collect<'a>(&'a GradientsParams, Vec<ParamId>, Vec<Tensor<1>>);
        impl ModuleVisitor for Collect<'_> {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                if let Some(gradient) = self.0.get::<D>(param.id) {
                    self.1.push(param.id);
                    self.2.push(gradient.reshape([-1]));
                }
            }
        }
        let mut found = Collect(gradients, Vec::new(), Vec::new());
        model.visit(&mut found);
        Self {
            ids: found.1,
            values: Tensor::cat(found.2, 0),
        }
    }

    fn to_device(&self, device: &Device) -> Self {
        Self {
            ids: self.ids.clone(),
            values: self.values.clone().to_device(&device.clone().inner()),
        }
    }

    /// The inverse of [`Flat::of_gradients`].
    fn into_gradients<M: Module>(self, model: &M) -> GradientsParams {
        struct Put {
            from: Flat,
            next: usize,
            place: usize,
            gradients: GradientsParams,
        }
        impl ModuleVisitor for Put {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                if self.from.ids.get(self.place) == Some(&param.id) {
                    let shape = param.shape();
                    let count = shape.num_elements();
                    let values = self.from.values.clone().narrow(0, self.next, count);
                    self.gradients
                        .register::<D>(param.id, values.reshape(shape));
                    self.next += count;
                    self.place += 1;
                }
            }
        }
        let mut put = Put {
            from: self,
            next: 0,
            place: 0,
            gradients: GradientsParams::new(),
        };
        model.visit(&mut put);
        put.gradients
    }
}

/// Replaces the weights of a model by those of a [`Flat`] of the same model.
struct PutWeights<'a> {
    from: &'a Flat,
    next: usize,
}

impl ModuleMapper for PutWeights<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|now| {
            let count = now.shape().num_elements();
            let values = self.from.values.clone().narrow(0, self.next, count);
            self.next += count;
            Tensor::from_inner(values.reshape(now.dims())).set_require_grad(now.is_require_grad())
        })
    }
}

/// The loss of a step and its gradients on the first device. Every device computes a share of the
/// micro-batches and adds up their gradients; the sums cross to the first device in one transfer each and
/// are added in the order of the devices, so that a step does not depend on which is done first.
fn gradients_of<T: Task>(
    task: &T,
    model: &T::Model,
    parts: &[(f64, T::Batch)],
    device: &Device,
    masks: Seed,
    others: &mut Others<T::Model>,
    arithmetic: Arithmetic,
) -> (Tensor<1>, GradientsParams) {
    let one = |model: &T::Model, index: usize, device: &Device| {
        let (share, batch) = &parts[index];
        // Dropout depends on the step and the micro-batch, so that a continued run repeats it. A GPU
        // draws its own masks.
        let seed = masks.draw_u64(&[&index.to_string()]);
        device.seed(seed);
        let pass = Pass::seeded(arithmetic, seed);
        let loss = task.loss(model, batch, device, &pass).mul_scalar(*share);
        let value = loss.clone().inner();
        (value, GradientsParams::from_grads(loss.backward(), model))
    };
    if parts.len() == 1 {
        return one(model, 0, device);
    }
    let num_devices = 1 + others.devices.len();
    // The share of one device: the losses of its micro-batches, and the sum of their gradients.
    let share_of = |model: &T::Model, place: usize, device: &Device| {
        let mut losses = Vec::new();
        let mut sum = GradientsAccumulator::new();
        for index in (place..parts.len()).step_by(num_devices) {
            let (loss, gradients) = one(model, index, device);
            losses.push((index, loss));
            sum.accumulate(model, gradients);
        }
        (losses, sum.grads())
    };
    let (mut losses, gradients) = if others.devices.is_empty() {
        share_of(model, 0, device)
    } else {
        others.update(model);
        let shares: Vec<_> = std::thread::scope(|scope| {
            let running: Vec<_> = (1..)
                .zip(others.copies.iter().zip(&others.devices))
                .map(|(place, (copy, device))| {
                    // A handle of its own for the thread; the numbers are shared.
                    let (copy, share_of) = (copy.clone(), &share_of);
                    scope.spawn(move || {
                        // With fewer micro-batches than devices, some have nothing to do.
                        (place < parts.len()).then(|| {
                            let (losses, gradients) = share_of(&copy, place, device);
                            (losses, Flat::of_gradients(&copy, &gradients))
                        })
                    })
                })
                .collect();
            let (losses, gradients) = share_of(model, 0, device);
            let mut shares = vec![(losses, gradients)];
            for thread in running {
                let found = thread.join().expect("a device's thread does not panic");
                shares.extend(found.map(|(losses, gradients)| {
                    let gradients = gradients.to_device(device);
                    (losses, gradients.into_gradients(model))
                }));
            }
            shares
        });
        let mut sum = GradientsAccumulator::new();
        let mut all = Vec::new();
        for (losses, gradients) in shares {
            all.extend(losses);
            sum.accumulate(model, gradients);
        }
        (all, sum.grads())
    };
    losses.sort_by_key(|(index, _)| *index);
    let plain = device.clone().inner();
    let total = losses
        .into_iter()
        .map(|(_, loss)| loss.to_device(&plain))
        .reduce(|total, loss| total + loss)
        .expect("a step has a micro-batch");
    (total, gradients)
}

/// Mean loss over the validation data.
fn validate<T: Task>(task: &T, model: &T::Model, session: &Session<'_>) -> f32 {
    let pass = Pass::new(session.arithmetic);
    let loss = |batch: &T::Batch| task.loss(model, batch, session.device, &pass);
    weighted_mean(
        task.validation()
            .map(|(samples, batch)| (samples, loss(batch))),
    )
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
/// PyTorch does, and returns the norm before. Nothing is read: gradients within the norm are
/// multiplied by one.
fn clip_grad_norm<M: Module>(
    gradients: &mut GradientsParams,
    model: &M,
    max_norm: f64,
) -> Tensor<1> {
    struct Squares<'a>(&'a GradientsParams, Vec<Tensor<1>>);
    impl ModuleVisitor for Squares<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = self.0.get::<D>(param.id) {
                self.1.push(gradient.square().sum());
            }
        }
    }
    struct Scale<'a> {
        gradients: &'a mut GradientsParams,
        by: Tensor<1>,
    }
    impl ModuleVisitor for Scale<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = self.gradients.remove::<D>(param.id) {
                let scaled = gradient * self.by.clone().reshape([1; D]);
                self.gradients.register(param.id, scaled);
            }
        }
    }
    let mut squares = Squares(gradients, Vec::new());
    model.visit(&mut squares);
    let norm = Tensor::cat(squares.1, 0).sum().sqrt();
    let by = norm.clone().recip().mul_scalar(max_norm).clamp_max(1.0);
    model.visit(&mut Scale { gradients, by });
    norm
}

/// The decay of the EMA in a step: less at first, so that an average over a short run is not that of
/// the weights it began with.
fn warmed_up(decay: f64, step: u64) -> f64 {
    let step = step as f64;
    decay.min((1.0 + step) / (10.0 + step))
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
    fn an_average_over_a_short_run_forgets_the_weights_it_began_with() {
        let left: f64 = (0..40).map(|step| warmed_up(0.998, step)).product();
        assert!(left < 1e-6, "{left}");
        assert!(warmed_up(0.998, 10_000) == 0.998);
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
        let clip = |gradients: &mut GradientsParams, max_norm| -> f64 {
            let norm = clip_grad_norm(gradients, &model, max_norm);
            f64::from(norm.into_scalar::<f32>())
        };
        assert!((clip(&mut clipped, 1.0) - expected).abs() < 1e-5);
        assert!((clip(&mut clipped, 100.0) - 1.0).abs() < 1e-5);
        let mut left = gradients();
        clip(&mut left, 100.0);
        assert!((clip(&mut left, 100.0) - expected).abs() < 1e-5);
        // A model at rest, and one beyond the range of numbers.
        let mut none = gradients();
        let zero = model.weight.val().inner().zeros_like();
        none.register(model.weight.id, zero.clone());
        let bias = model.bias.as_ref().expect("it has a bias");
        none.register(bias.id, bias.val().inner().zeros_like());
        assert_eq!(clip(&mut none, 1.0), 0.0);
        let left = none.get::<2>(model.weight.id).expect("a gradient");
        assert_eq!(left.into_data(), zero.into_data());
    }

    #[test]
    fn weights_and_gradients_cross_in_one_tensor_and_come_back() {
        let device = Device::flex().autodiff();
        let (model, other) = (layer(1, &device), layer(2, &device));
        let mut others = Others::new(&model, &[Device::flex()]);
        let weights = Flat::of_weights(&other);
        let mut put = PutWeights {
            from: &weights,
            next: 0,
        };
        others.update(&model.clone().map(&mut put));
        let copy = &others.copies[0];
        assert_eq!(numbers(copy), numbers(&other));
        let x = Tensor::<2>::from_data([[3.0, 0.0, 4.0]], &device);
        let gradients = GradientsParams::from_grads(copy.forward(x).sum().backward(), copy);
        let flat = Flat::of_gradients(copy, &gradients).to_device(&device);
        let back = flat.into_gradients(&model);
        let weight = back.get::<2>(model.weight.id).expect("a gradient");
        let expected = gradients.get::<2>(model.weight.id).expect("a gradient");
        assert_eq!(weight.into_data(), expected.into_data());
        assert_eq!(back.len(), 2);
    }
}
