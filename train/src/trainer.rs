//! Training loop shared by all models: training, stopping, resuming, checkpoints.
//!
//! A model gives data and loss as a `Task`; `train` does the rest.

mod clipping;
mod devices;
mod ema;
mod flat;
mod progress;
mod task;

use std::path::Path;

use burn::optim::ModuleOptimizer;
use burn::tensor::Bytes;
use datasets_spec::Seed;
use serde::Serialize;

use self::clipping::clip_grad_norm;
use self::devices::{Devices, Step};
use self::ema::Ema;
use self::progress::{MetricsLine, Speed, TrainState, Unread, ValidationLine};
pub(crate) use self::task::Task;
use crate::checkpoint::{self, EMA_PREFIX, Files, Run, STATE, Slot, take};
use crate::config::ensure;
use crate::data::prefetch;
use crate::error::json_error;
use crate::model::pass::Pass;
use crate::model::weights::{Networks, draw};
use crate::optimizer::adamw;
use crate::transfer::weighted_mean;
use crate::{Error, Session};

const OPTIMIZER: &str = "optimizer.bpk";

/// Result of a training run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrainReport {
    /// Number of steps made, including earlier sessions.
    pub steps: u64,
    /// Whether the run reached its last step.
    pub is_complete: bool,
    /// Number of trainable parameters.
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
    /// Share of the training time in this session that was spent waiting for data.
    pub data_wait_share: f64,
    /// Number of training clips, of captions of a part of one, and of masks and pairs, that are too short for the model and
    /// were not used.
    pub left_out: u64,
}

impl TrainReport {
    /// The report of a training for which some more clips were too short.
    pub(crate) fn without(self, count: u64) -> Self {
        Self {
            left_out: self.left_out + count,
            ..self
        }
    }

    /// The report in one line.
    pub fn summary(&self, run: &Path) -> String {
        let loss = |loss: Option<f64>| loss.map_or("-".to_owned(), |loss| format!("{loss:.4}"));
        format!(
            "{} steps{}, {} parameters, loss {} -> {}, best validation {} at step {}, {:.0} samples/s, {:.1} % of the time waiting for data{}; in {}",
            self.steps,
            if self.is_complete { "" } else { " (stopped)" },
            self.num_parameters,
            loss(self.first_loss),
            loss(self.last_loss),
            loss(self.best_val_loss),
            self.best_step,
            self.samples_per_sec,
            100.0 * self.data_wait_share,
            match self.left_out {
                0 => String::new(),
                count => format!(", {count} clips, masks or pairs too short and not used"),
            },
            run.display()
        )
    }
}

/// Trains a model, or continues the training of the run folder. The initial weights depend on the seed of the run.
///
/// An interrupted run continues exactly: weights, optimiser, data, noise and learning rate are those of an
/// uninterrupted run.
///
/// # Errors
/// The run folder holds a damaged checkpoint or a longer run, the data cannot be read, a loss is not
/// finite, or a file cannot be written.
pub(crate) fn train<M: Networks, B: Send + Sync>(
    task: &Task<'_, M, B>,
    run: &Run,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    let seed = Seed(task.run.seed).derive(&["weights"]);
    let mut model = draw((task.network)(&session.device.clone().autodiff()), seed)?;
    let mut training = Training::begin(task, &mut model, run, session)?;
    let num_steps = task.num_steps();
    session
        .progress
        .begin(&format!("train {}", task.kind), Some(num_steps));
    session.progress.advance(training.state.step);
    let model = std::thread::scope(|scope| -> Result<M, Error> {
        let steps = training.state.step..num_steps;
        let micro = devices::micro_batch(task, session);
        let batches = prefetch(scope, steps, move |step| (task.draw)(step, micro));
        let mut devices = Devices::new(&model, session, task.run.micro_batch() / micro);
        while training.state.step < num_steps && !session.is_stopped() {
            let begun = session.secs();
            let parts = batches
                .recv()
                .expect("the producer sends a batch or an error for every step")?;
            let received = session.secs();
            model = training.step(model, &parts, &mut devices)?;
            let since = session.secs() - begun;
            training.recent.add(since, received - begun);
            session.progress.advance(1);
            training.report_step(&model)?;
        }
        // When a run is stopped, the losses since its last line are saved too.
        training.read()?;
        training.whole.merge(&training.recent);
        Ok(model)
    })?;
    training.end(&model)
}

/// State of a run in training, without the model, which is passed through every step.
struct Training<'a, M, B> {
    task: &'a Task<'a, M, B>,
    run: &'a Run,
    session: &'a Session<'a>,
    optimizer: ModuleOptimizer,
    ema: Option<Ema>,
    state: TrainState,
    /// Step of the newest checkpoint.
    kept: u64,
    unread: Unread,
    /// Norm of the gradient of the last step whose values were read from the device.
    gradient_norm: Option<f64>,
    /// Speed since the last line of the metrics file.
    recent: Speed,
    /// Speed in this session, up to the last line.
    whole: Speed,
}

struct Due {
    line: bool,
    validation: bool,
    /// The epoch whose checkpoint is kept permanently, if one is due.
    epoch: Option<u64>,
}

impl<'a, M: Networks, B: Send + Sync> Training<'a, M, B> {
    /// Starts a training, or restores the state of the run folder, including the weights of `model`.
    fn begin(
        task: &'a Task<'a, M, B>,
        model: &mut M,
        run: &'a Run,
        session: &'a Session<'a>,
    ) -> Result<Self, Error> {
        let (run_dir, settings) = (run.dir(), &task.run.optimizer);
        let mut optimizer = adamw(settings.weight_decay, session.arithmetic);
        let mut state = TrainState::default();
        let mut ema = None;
        if let Some(mut files) = checkpoint::read(run_dir, Slot::Last)? {
            if settings.ema_decay.is_some() {
                ema = Some(load_ema(model, &files, run_dir)?);
            }
            model.take_files(&mut files, run_dir)?;
            (optimizer, state) = load_progress(optimizer, &mut files, run_dir)?;
        } else if let Some((from, mut files)) = run.init() {
            model.take_files(&mut files, from)?;
        }
        let num_steps = task.num_steps();
        let made = state.step;
        let problem = format!("it is {num_steps} steps, and the run has made {made} already");
        ensure(made <= num_steps, "length", problem)?;
        run.settle()?;
        run.rewind_log(state.step)?;
        if ema.is_none() && settings.ema_decay.is_some() {
            ema = Some(Ema::of(&model.valid()));
        }
        Ok(Self {
            task,
            run,
            session,
            optimizer,
            ema,
            kept: state.step,
            state,
            unread: Unread::default(),
            gradient_norm: None,
            recent: Speed::default(),
            whole: Speed::default(),
        })
    }

    fn step(&mut self, model: M, parts: &[(f64, B)], devices: &mut Devices<M>) -> Result<M, Error> {
        let (settings, step) = (&self.task.run, self.state.step);
        let (loss, mut gradients) = Step {
            task: self.task,
            parts,
            masks: Seed(settings.seed).derive(&["dropout", &step.to_string()]),
            arithmetic: self.session.arithmetic,
        }
        .gradients(&model, devices);
        self.unread.losses.push(loss);
        let max_norm = settings.optimizer.max_gradient_norm;
        self.unread.norm =
            max_norm.map(|max_norm| clip_grad_norm(&mut gradients, &model, max_norm));
        let rate = self.rate(step);
        let model = self.optimizer.step(rate, model, gradients);
        if let (Some(ema), Some(decay)) = (&mut self.ema, settings.optimizer.ema_decay) {
            ema.update(&model.valid(), decay, step);
        }
        self.state.step += 1;
        let due = self.due();
        // Only reading the loss waits for the device, so the time of a line covers exactly its steps.
        if due.line || due.validation {
            self.read()?;
        }
        Ok(model)
    }

    fn rate(&self, step: u64) -> f64 {
        let optimizer = &self.task.run.optimizer;
        optimizer.rate_at(step, self.task.num_steps())
    }

    fn due(&self) -> Due {
        let (settings, step) = (&self.task.run, self.state.step);
        let is_last = step == self.task.num_steps();
        let epoch_len = self.task.steps_per_epoch();
        let keep_every = settings.keep_epochs * epoch_len;
        let is_kept = keep_every > 0 && step.is_multiple_of(keep_every);
        Due {
            line: step.is_multiple_of(settings.log_every) || is_last,
            validation: step.is_multiple_of(settings.val_every) || is_last,
            epoch: is_kept.then(|| step / epoch_len),
        }
    }

    fn read(&mut self) -> Result<(), Error> {
        self.gradient_norm = self.unread.read(&mut self.state, self.kept)?;
        Ok(())
    }

    fn report_step(&mut self, model: &M) -> Result<(), Error> {
        let due = self.due();
        if due.line {
            self.log()?;
        }
        if due.validation && self.validate(model)? {
            self.keep(Slot::Best, model)?;
        }
        if let Some(epoch) = due.epoch {
            self.keep(Slot::Epoch(epoch), model)?;
        }
        // A run continues from this checkpoint, so it is the last one written: a run that is killed before makes the
        // step again, and with it the checkpoints above.
        if due.validation {
            self.save(model)?;
        }
        Ok(())
    }

    /// Writes the weights for use.
    fn keep(&self, slot: Slot, model: &M) -> Result<(), Error> {
        let files = self.used(model).to_files(self.run.dir())?;
        self.run.write(slot, &files)
    }

    fn log(&mut self) -> Result<(), Error> {
        let step = self.state.step;
        let loss = self.state.take_loss();
        let samples_per_sec = self.recent.samples_per_sec(self.task.run.batch_size);
        let data_wait_share = self.recent.wait_share();
        self.run.log(&MetricsLine {
            step,
            loss,
            learning_rate: self.rate(step - 1),
            gradient_norm: self.gradient_norm,
            samples_per_sec,
            data_wait_share,
        })?;
        self.session.progress.message(&format!(
            "loss {loss:.4}, {samples_per_sec:.0} {}/s, {:.1} % waiting",
            self.task.samples,
            100.0 * data_wait_share
        ));
        self.whole.merge(&self.recent);
        self.recent = Speed::default();
        Ok(())
    }

    /// Measures the validation loss, and returns whether it is the lowest so far.
    fn validate(&mut self, model: &M) -> Result<bool, Error> {
        let used = self.used(model);
        let pass = Pass::new(self.session.arithmetic);
        let device = self.session.device;
        let batches = self.task.validation.iter();
        let losses = batches
            .map(|(samples, batch)| (*samples, (self.task.loss)(&used, batch, device, &pass)));
        let val_loss = weighted_mean(losses);
        let step = self.state.step;
        if !val_loss.is_finite() {
            return Err(Error::Diverged {
                what: "validation",
                step,
                kept: self.kept,
            });
        }
        let is_best = self.state.note_validation(val_loss);
        self.run.log(&ValidationLine {
            step,
            val_loss,
            is_best,
        })?;
        Ok(is_best)
    }

    /// The model for validation and inference: with EMA weights if the settings ask for them.
    fn used(&self, model: &M) -> M {
        match &self.ema {
            Some(ema) => ema.put_into(model.valid()),
            None => model.valid(),
        }
    }

    fn save(&mut self, model: &M) -> Result<(), Error> {
        let run_dir = self.run.dir();
        let moments = self
            .optimizer
            .into_bytes()
            .map_err(|problem| Error::weights(&run_dir.join(OPTIMIZER), problem))?;
        let state = serde_json::to_vec(&self.state).map_err(json_error(&run_dir.join(STATE)))?;
        let mut files = model.valid().to_files(run_dir)?;
        files.insert(OPTIMIZER.to_owned(), moments.to_vec());
        files.insert(STATE.to_owned(), state);
        if self.ema.is_some() {
            let averaged = self.used(model).to_files(run_dir)?;
            files.extend(
                averaged
                    .into_iter()
                    .map(|(name, bytes)| (format!("{EMA_PREFIX}{name}"), bytes)),
            );
        }
        self.run.write(Slot::Last, &files)?;
        self.kept = self.state.step;
        Ok(())
    }

    /// Ends the session. If the run is not complete, a checkpoint is written.
    fn end(&mut self, model: &M) -> Result<TrainReport, Error> {
        let is_complete = self.state.step == self.task.num_steps();
        if !is_complete {
            self.save(model)?;
        }
        let state = &self.state;
        self.session.progress.finish(&format!(
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
        Ok(TrainReport {
            steps: state.step,
            is_complete,
            num_parameters: burn::module::Module::num_params(model),
            first_loss: state.first_loss.map(f64::from),
            last_loss: state.last_loss.map(f64::from),
            best_val_loss: state.best_val_loss.map(f64::from),
            best_step: state.best_step,
            samples_per_sec: self.whole.samples_per_sec(self.task.run.batch_size),
            data_wait_share: self.whole.wait_share(),
            left_out: 0,
        })
    }
}

fn load_ema<M: Networks>(model: &M, files: &Files, run_dir: &Path) -> Result<Ema, Error> {
    let mut averaged: Files = files
        .iter()
        .filter_map(|(name, bytes)| {
            Some((name.strip_prefix(EMA_PREFIX)?.to_owned(), bytes.clone()))
        })
        .collect();
    let mut twin = model.clone();
    twin.take_files(&mut averaged, run_dir)?;
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
    let state = serde_json::from_slice(&take(files, STATE, run_dir)?)
        .map_err(json_error(&run_dir.join(STATE)))?;
    Ok((optimizer, state))
}
