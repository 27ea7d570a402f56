//! Settings that every training run has: batches, length, optimiser.

use serde::{Deserialize, Serialize};

use super::check::{above_zero, ensure, not_negative, positive, share};
use crate::Error;

/// Settings that every training run has, for any model. In files they are written next to the settings of the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSettings {
    /// Settings of the optimiser.
    pub optimizer: OptimizerConfig,
    /// Number of samples in a step.
    pub batch_size: usize,
    /// Number of samples computed at once. A larger step accumulates the gradients of several micro-batches. `None`
    /// computes a step at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub micro_batch_size: Option<usize>,
    /// Length of the run.
    pub length: RunLength,
    /// Number of steps between two lines of the metrics file.
    #[serde(default = "default_log_every")]
    pub log_every: u64,
    /// Number of steps between two validations; each is followed by a checkpoint.
    #[serde(default = "default_val_every")]
    pub val_every: u64,
    /// Number of epochs between two checkpoints that are kept permanently; 0 keeps only the best and the last
    /// checkpoint.
    #[serde(default)]
    pub keep_epochs: u64,
    /// Seed of the initial weights and of all random draws in training.
    pub seed: u64,
}

/// Default for records of pose networks of version 0.1, which lacked this setting.
fn default_log_every() -> u64 {
    100
}

/// Default for records of pose networks of version 0.1, which lacked this setting.
fn default_val_every() -> u64 {
    200
}

impl RunSettings {
    pub(crate) fn micro_batch(&self) -> usize {
        self.micro_batch_size
            .map_or(self.batch_size, |size| size.min(self.batch_size))
    }

    /// The micro-batches of a step, each as the index of its first sample in the run and its number of samples, at most
    /// `micro`.
    pub(super) fn micro_batches(
        &self,
        step: u64,
        micro: usize,
    ) -> impl Iterator<Item = (u64, usize)> + use<> {
        let size = self.batch_size;
        (0..size)
            .step_by(micro)
            .map(move |first| (step * size as u64 + first as u64, micro.min(size - first)))
    }

    /// Returns a function that draws the micro-batches of a step. It gets the step and the largest size of a
    /// micro-batch, and returns each with its share of the step's items. `draw` gets the first item and the number of
    /// items.
    pub(crate) fn batches<B>(
        &self,
        draw: impl Fn(u64, usize) -> Result<B, Error>,
    ) -> impl Fn(u64, usize) -> Result<Vec<(f64, B)>, Error> {
        let (run, size) = (*self, self.batch_size as f64);
        move |step, micro| -> Result<Vec<(f64, B)>, Error> {
            run.micro_batches(step, micro)
                .map(|(first, count)| Ok((count as f64 / size, draw(first, count)?)))
                .collect()
        }
    }

    /// Draws the micro-batches of a validation of `num_items` items, as [`RunSettings::batches`] does for a step. Each
    /// is returned with its number of items.
    pub(crate) fn validation<B>(
        &self,
        num_items: usize,
        draw: impl Fn(u64, usize) -> Result<B, Error>,
    ) -> Result<Vec<(usize, B)>, Error> {
        let micro = self.micro_batch();
        (0..num_items)
            .step_by(micro)
            .map(|first| (first, micro.min(num_items - first)))
            .map(|(first, count)| Ok((count, draw(first as u64, count)?)))
            .collect()
    }

    /// Checks that the settings allow a run.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.optimizer.check()?;
        self.length.check()?;
        positive("batch_size", self.batch_size as u64)?;
        positive("micro_batch_size", self.micro_batch() as u64)?;
        positive("log_every", self.log_every)?;
        positive("val_every", self.val_every)
    }

    /// Refuses micro-batches; for models whose loss needs the whole batch.
    pub(crate) fn check_whole(&self, why: &str) -> Result<(), Error> {
        ensure(
            self.micro_batch() == self.batch_size,
            "micro_batch_size",
            format!("a step of this model cannot be split: {why}; leave it out"),
        )
    }
}

/// Length of a run: a number of epochs, limited by a number of steps.
///
/// An epoch is one pass over the training data: all windows of annotated motions and pairs, or all clips.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunLength {
    /// Number of epochs; if none, only steps are counted.
    pub epochs: Option<u64>,
    /// Maximum number of steps.
    pub steps: u64,
}

impl RunLength {
    /// A run of a fixed number of steps.
    pub fn of_steps(steps: u64) -> Self {
        Self {
            epochs: None,
            steps,
        }
    }

    /// Number of steps of the run, given the steps of an epoch.
    pub fn num_steps(&self, steps_per_epoch: u64) -> u64 {
        match self.epochs {
            Some(epochs) => self.steps.min(epochs.saturating_mul(steps_per_epoch)),
            None => self.steps,
        }
    }

    pub(crate) fn check(&self) -> Result<(), Error> {
        positive("length.steps", self.steps)?;
        positive("length.epochs", self.epochs.unwrap_or(1))
    }
}

/// AdamW and its learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Maximum learning rate.
    pub learning_rate: f64,
    /// Schedule of the learning rate.
    pub decay: Decay,
    /// Number of steps over which the rate rises from zero.
    pub warmup_steps: u64,
    /// Decoupled weight decay.
    pub weight_decay: f64,
    /// Maximum norm of all gradients together, to which they are clipped; `None` does not clip.
    pub max_gradient_norm: Option<f64>,
    /// Decay of the exponential moving average (EMA) of the weights. In step `n`, counted from 0, the decay is at most
    /// `(1 + n) / (10 + n)`, so that the initial weights soon lose their influence. Validation and editing use the
    /// averaged weights. `None` keeps no average.
    pub ema_decay: Option<f64>,
}

/// How the learning rate decreases over a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Decay {
    /// A constant rate.
    Constant,
    /// Linear decay from the first step, to zero after the last.
    Linear,
}

impl OptimizerConfig {
    /// A constant learning rate with PyTorch's weight decay, and without clipping, warm-up or averaging.
    pub(crate) fn of_rate(learning_rate: f64) -> Self {
        Self {
            learning_rate,
            decay: Decay::Constant,
            warmup_steps: 0,
            weight_decay: 0.01,
            max_gradient_norm: None,
            ema_decay: None,
        }
    }

    pub(crate) fn check(&self) -> Result<(), Error> {
        if let Some(longest) = self.max_gradient_norm {
            above_zero("optimizer.max_gradient_norm", longest)?;
        }
        share("optimizer.ema_decay", self.ema_decay.unwrap_or(0.0))?;
        not_negative("optimizer.learning_rate", self.learning_rate)?;
        not_negative("optimizer.weight_decay", self.weight_decay)
    }

    /// The learning rate of step `step`, counted from 0, in a run of `num_steps`.
    pub fn rate_at(&self, step: u64, num_steps: u64) -> f64 {
        let warmup = ((step + 1) as f64 / (self.warmup_steps + 1) as f64).min(1.0);
        let decay = match self.decay {
            Decay::Constant => 1.0,
            Decay::Linear => 1.0 - step as f64 / num_steps as f64,
        };
        self.learning_rate * warmup * decay
    }
}
