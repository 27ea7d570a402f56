//! The training of the editor, from the first batch to the last checkpoint.

use std::path::Path;

use burn::module::Module;
use burn::optim::{AdamWConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::Bytes;
use datasets_spec::Seed;
use datasets_spec::normalise::Normalizer;
use serde::{Deserialize, Serialize};

use crate::checkpoint::{self, Files, Run, RunRecord, Slot, take};
use crate::config::{OptimizerConfig, TrainConfig};
use crate::data::{Drawer, NoisyBatch, Timesteps, WindowSource, prefetch};
use crate::diffusion::Schedule;
use crate::model::motionrefit::MotionRefit;
use crate::model::weights::{draw, from_safetensors, to_safetensors};
use crate::vocabulary::Vocabulary;
use crate::{Error, Session};

/// Kind of run.
pub(crate) const KIND: &str = "motionrefit";

pub(crate) const DENOISER: &str = "denoiser.safetensors";
pub(crate) const TEXT: &str = "text.safetensors";
pub(crate) const OPTIMIZER: &str = "optimizer.bpk";
pub(crate) const STATE: &str = "state.json";

/// What AdamW adds to the root of the second moment (PyTorch's default).
const ADAMW_EPSILON: f32 = 1e-8;

/// What the editor learns from.
#[derive(Clone, Copy)]
pub struct Corpus<'a> {
    /// Training windows.
    pub train: &'a dyn WindowSource,
    /// Validation windows.
    pub val: &'a dyn WindowSource,
    /// Instructions of the training split, whose words are the vocabulary.
    pub instructions: &'a [String],
    /// Range the windows were scaled by.
    pub normalizer: Normalizer,
    /// Name of the skeleton the motions drive.
    pub skeleton: &'a str,
    /// Root hash of the dataset.
    pub dataset_hash: &'a str,
}

/// What is recorded of an editor's run: its settings and what was fitted to the training split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditorRecord {
    /// The resolved settings.
    pub train: TrainConfig,
    /// Range the windows are scaled by.
    pub normalizer: Normalizer,
    /// Words the text encoder knows.
    pub vocabulary: Vocabulary,
}

/// What a training run came to.
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
    /// Items trained on per second in this session, validations and checkpoints left out.
    pub samples_per_sec: f64,
    /// Share of that time spent waiting for data.
    pub data_wait_share: f64,
}

/// The place in a run, saved with every checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TrainState {
    pub(crate) step: u64,
    /// Losses of the steps since the last line of the metrics file.
    pub(crate) pending: Vec<f32>,
    pub(crate) first_loss: Option<f32>,
    pub(crate) last_loss: Option<f32>,
    pub(crate) best_val_loss: Option<f32>,
    pub(crate) best_step: u64,
}

#[derive(Serialize)]
pub(crate) struct MetricsLine {
    pub(crate) step: u64,
    pub(crate) loss: f32,
    pub(crate) learning_rate: f64,
    pub(crate) samples_per_sec: f64,
    pub(crate) data_wait_share: f64,
}

#[derive(Serialize)]
pub(crate) struct ValidationLine {
    pub(crate) step: u64,
    pub(crate) val_loss: f32,
    pub(crate) is_best: bool,
}

/// Time spent on training steps, and the part of it spent waiting for data.
#[derive(Default)]
pub(crate) struct Speed {
    steps: u64,
    total_secs: f64,
    wait_secs: f64,
}

impl Speed {
    pub(crate) fn add(&mut self, total_secs: f64, wait_secs: f64) {
        self.steps += 1;
        self.total_secs += total_secs;
        self.wait_secs += wait_secs;
    }

    pub(crate) fn merge(&mut self, other: &Self) {
        self.steps += other.steps;
        self.total_secs += other.total_secs;
        self.wait_secs += other.wait_secs;
    }

    pub(crate) fn samples_per_sec(&self, batch_size: usize) -> f64 {
        if self.total_secs > 0.0 {
            (self.steps * batch_size as u64) as f64 / self.total_secs
        } else {
            0.0
        }
    }

    pub(crate) fn wait_share(&self) -> f64 {
        if self.total_secs > 0.0 {
            self.wait_secs / self.total_secs
        } else {
            0.0
        }
    }
}

/// Trains the editor, or continues where the run folder left off.
///
/// A run that was interrupted continues exactly: weights, optimiser, data, noise and learning rate
/// are those of an uninterrupted one.
///
/// # Errors
/// The settings are unusable, the folder holds another run or a damaged checkpoint, the source of
/// windows fails, the loss is not finite, or a file cannot be written.
pub fn train_motionrefit(
    run_dir: &Path,
    config: &TrainConfig,
    corpus: Corpus<'_>,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    config.check()?;
    let record = EditorRecord {
        train: config.clone(),
        normalizer: corpus.normalizer,
        vocabulary: Vocabulary::build(
            corpus.instructions.iter().map(String::as_str),
            config.text.num_buckets,
            config.text.max_words,
        )?,
    };
    let vocabulary = &record.vocabulary;
    let run = Run::open(
        run_dir,
        &RunRecord::new(KIND, corpus.dataset_hash, corpus.skeleton, &record),
    )?;

    let seed = Seed(config.seed);
    let schedule = Schedule::new(config.diffusion.schedule, config.diffusion.num_steps)?;
    let device = session.device.clone().autodiff();
    let mut model = draw(
        MotionRefit::new(&config.model, vocabulary.num_tokens(), &device),
        seed.derive(&["weights"]),
    );
    let mut optimizer = adamw(&config.optimizer);
    let mut state = TrainState::default();
    if let Some(mut files) = checkpoint::read(run_dir, Slot::Last)? {
        load_weights(&mut model, &mut files, run_dir)?;
        (optimizer, state) = load_progress(optimizer, &mut files, run_dir)?;
    }
    run.rewind_log(state.step)?;

    let drawer = Drawer {
        source: corpus.train,
        vocabulary,
        seed: seed.derive(&["train"]),
        num_timesteps: schedule.len(),
        timesteps: Timesteps::Random,
        text_dropout: config.diffusion.text_dropout,
    };
    let val_drawer = Drawer {
        source: corpus.val,
        seed: seed.derive(&["val"]),
        timesteps: Timesteps::Spread,
        text_dropout: 0.0,
        ..drawer
    };
    let val_batches = (0..config.val_windows)
        .step_by(config.batch_size)
        .map(|first| {
            let num_windows = config.batch_size.min(config.val_windows - first);
            val_drawer.draw(first as u64, num_windows)
        })
        .collect::<Result<Vec<_>, _>>()?;

    let mut whole = Speed::default();
    session
        .progress
        .begin("train motionrefit", Some(config.num_steps));
    session.progress.advance(state.step);
    let model = std::thread::scope(|scope| {
        let batches = prefetch(scope, state.step..config.num_steps, |step| {
            drawer.draw(step * config.batch_size as u64, config.batch_size)
        });
        let mut recent = Speed::default();
        while state.step < config.num_steps && !session.is_stopped() {
            let begun = session.secs();
            let batch = batches
                .recv()
                .expect("the producer sends a batch or an error for every step")?;
            let received = session.secs();

            if config.model.dropout > 0.0 {
                // Dropout draws on the device; seeding every step lets a continued run repeat it.
                device.seed(seed.draw_u64(&["dropout", &state.step.to_string()]));
            }
            let rate = config.optimizer.rate_at(state.step, config.num_steps);
            let loss = model.loss(&schedule, &batch, &config.diffusion);
            let loss_value: f32 = loss.clone().into_scalar();
            if !loss_value.is_finite() {
                return Err(Error::Diverged { step: state.step });
            }
            let gradients = GradientsParams::from_grads(loss.backward(), &model);
            model = optimizer.step(rate, model, gradients);

            state.step += 1;
            state.pending.push(loss_value);
            recent.add(session.secs() - begun, received - begun);
            session.progress.advance(1);
            let is_last = state.step == config.num_steps;
            if state.step.is_multiple_of(config.log_every) || is_last {
                let loss = mean(&state.pending);
                run.log(&MetricsLine {
                    step: state.step,
                    loss,
                    learning_rate: rate,
                    samples_per_sec: recent.samples_per_sec(config.batch_size),
                    data_wait_share: recent.wait_share(),
                })?;
                session.progress.message(&format!(
                    "loss {loss:.4}, {:.0} windows/s",
                    recent.samples_per_sec(config.batch_size)
                ));
                state.first_loss.get_or_insert(loss);
                state.last_loss = Some(loss);
                state.pending.clear();
                whole.merge(&recent);
                recent = Speed::default();
            }
            if state.step.is_multiple_of(config.val_every) || is_last {
                let val_loss = validate(&model.valid(), &schedule, &val_batches, config);
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
                let files = save(&model, &optimizer, &state, run_dir)?;
                run.write(Slot::Last, &files)?;
                if is_best {
                    run.write(Slot::Best, &files)?;
                }
            }
        }
        whole.merge(&recent);
        Ok(model)
    })?;

    let is_complete = state.step == config.num_steps;
    if !is_complete {
        run.write(Slot::Last, &save(&model, &optimizer, &state, run_dir)?)?;
    }
    session.progress.finish(&format!(
        "{} steps, best validation loss {}",
        state.step,
        state
            .best_val_loss
            .map_or("none yet".to_owned(), |loss| format!("{loss:.4}"))
    ));
    Ok(report(
        &state,
        is_complete,
        model.num_params(),
        &whole,
        config.batch_size,
    ))
}

pub(crate) fn report(
    state: &TrainState,
    is_complete: bool,
    num_parameters: usize,
    speed: &Speed,
    batch_size: usize,
) -> TrainReport {
    TrainReport {
        steps: state.step,
        is_complete,
        num_parameters,
        first_loss: state.first_loss.map(f64::from),
        last_loss: state.last_loss.map(f64::from),
        best_val_loss: state.best_val_loss.map(f64::from),
        best_step: state.best_step,
        samples_per_sec: speed.samples_per_sec(batch_size),
        data_wait_share: speed.wait_share(),
    }
}

pub(crate) fn adamw(config: &OptimizerConfig) -> ModuleOptimizer {
    AdamWConfig::new()
        .with_epsilon(ADAMW_EPSILON)
        .with_weight_decay(config.weight_decay as f32)
        .init()
}

pub(crate) fn mean(losses: &[f32]) -> f32 {
    let sum: f64 = losses.iter().map(|&loss| f64::from(loss)).sum();
    (sum / losses.len().max(1) as f64) as f32
}

/// The mean loss over the validation windows, whose noise never changes.
fn validate(
    model: &MotionRefit,
    schedule: &Schedule,
    batches: &[NoisyBatch],
    config: &TrainConfig,
) -> f32 {
    let sum: f64 = batches
        .iter()
        .map(|batch| {
            let loss: f32 = model.loss(schedule, batch, &config.diffusion).into_scalar();
            f64::from(loss) * batch.len() as f64
        })
        .sum();
    (sum / config.val_windows as f64) as f32
}

fn save(
    model: &MotionRefit,
    optimizer: &ModuleOptimizer,
    state: &TrainState,
    run_dir: &Path,
) -> Result<Files, Error> {
    let mut files = save_progress(optimizer, state, run_dir)?;
    for (name, bytes) in [
        (DENOISER, to_safetensors(&model.denoiser, run_dir)?),
        (TEXT, to_safetensors(&model.text, run_dir)?),
    ] {
        files.insert(name.to_owned(), bytes);
    }
    Ok(files)
}

/// Loads both networks of an editor.
pub(crate) fn load_weights(
    model: &mut MotionRefit,
    files: &mut Files,
    run_dir: &Path,
) -> Result<(), Error> {
    let path = run_dir.join(DENOISER);
    let bytes = take(files, DENOISER, run_dir)?;
    from_safetensors(&mut model.denoiser, bytes, "", &path)?;
    let path = run_dir.join(TEXT);
    from_safetensors(&mut model.text, take(files, TEXT, run_dir)?, "", &path)
}

/// The optimiser and the place in the run as files.
pub(crate) fn save_progress(
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
    Ok([(OPTIMIZER, moments.to_vec()), (STATE, state)]
        .map(|(name, bytes)| (name.to_owned(), bytes))
        .into())
}

/// The inverse of [`save_progress`].
pub(crate) fn load_progress(
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
