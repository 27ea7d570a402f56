//! Settings that every training run has: batches, length, optimiser.

use serde::{Deserialize, Serialize};

use super::check::{above_zero, ensure, not_negative, positive, share};
use crate::Error;

/// Settings that every training run has, whatever is trained. In files they stand beside the
/// settings of the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSettings {
    /// Optimiser.
    pub optimizer: OptimizerConfig,
    /// Samples in a step.
    pub batch_size: usize,
    /// Samples computed at once. The gradients of a larger step are accumulated over several
    /// micro-batches. `None` computes a step at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub micro_batch_size: Option<usize>,
    /// Length of the run.
    pub length: RunLength,
    /// Steps between two lines of the metrics file.
    #[serde(default = "default_log_every")]
    pub log_every: u64,
    /// Steps between two validations; each is followed by a checkpoint.
    #[serde(default = "default_val_every")]
    pub val_every: u64,
    /// Epochs between two checkpoints that are kept for good; 0 keeps only the best and the last.
    #[serde(default)]
    pub keep_epochs: u64,
    /// Seed of the weights and of everything drawn while training.
    pub seed: u64,
}

/// For records of pose networks of version 0.1, which had no such setting.
fn default_log_every() -> u64 {
    100
}

/// For records of pose networks of version 0.1, which had no such setting.
fn default_val_every() -> u64 {
    200
}

impl RunSettings {
    pub(crate) fn micro_batch(&self) -> usize {
        self.micro_batch_size
            .map_or(self.batch_size, |size| size.min(self.batch_size))
    }

    /// The micro-batches of a step: first sample, counted over the whole run, and number of samples.
    pub(super) fn micro_batches(&self, step: u64) -> impl Iterator<Item = (u64, usize)> {
        let (size, micro) = (self.batch_size, self.micro_batch());
        (0..size)
            .step_by(micro)
            .map(move |first| (step * size as u64 + first as u64, micro.min(size - first)))
    }

    /// Draws the micro-batches of a step. `draw` is given the first item and the number of items; each micro-batch comes with its
    /// share of the step's items.
    pub(crate) fn batches<B>(
        &self,
        step: u64,
        draw: impl Fn(u64, usize) -> Result<B, Error>,
    ) -> Result<Vec<(f64, B)>, Error> {
        let share = |count: usize| count as f64 / self.batch_size as f64;
        self.micro_batches(step)
            .map(|(first, count)| Ok((share(count), draw(first, count)?)))
            .collect()
    }

    /// Draws the micro-batches of a validation of so many items, as [`RunSettings::batches`] draws those of a step; each comes
    /// with its number of items.
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

    /// Checks that a run can be made with the settings.
    ///
    /// # Errors
    /// A setting is out of range.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.optimizer.check()?;
        self.length.check()?;
        positive("batch_size", self.batch_size as u64)?;
        positive("micro_batch_size", self.micro_batch() as u64)?;
        positive("log_every", self.log_every)?;
        positive("val_every", self.val_every)
    }

    /// Refuses micro-batches for a model whose loss needs the whole batch.
    pub(crate) fn check_whole(&self, why: &str) -> Result<(), Error> {
        ensure(
            self.micro_batch() == self.batch_size,
            "micro_batch_size",
            format!("a step of this model cannot be split: {why}; leave it out"),
        )
    }
}

/// How long a run is: so many epochs, but not more than so many steps.
///
/// An epoch visits every window of every annotated motion and of every pair once.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunLength {
    /// Epochs, if they are counted.
    pub epochs: Option<u64>,
    /// Steps at most.
    pub steps: u64,
}

impl RunLength {
    /// A run of so many steps.
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
    /// Highest learning rate.
    pub learning_rate: f64,
    /// How the rate falls.
    pub decay: Decay,
    /// Steps over which the rate rises from zero.
    pub warmup_steps: u64,
    /// Decoupled weight decay.
    pub weight_decay: f64,
    /// Norm that all gradients together are clipped to; `None` does not clip.
    pub max_gradient_norm: Option<f64>,
    /// Decay of the exponential moving average (EMA) of the weights. In step `n`, counted from 0, the decay is at
    /// most `(1 + n) / (10 + n)`, so that the average soon forgets the initial weights. Validation and editing use
    /// the averaged weights. `None` keeps no average.
    pub ema_decay: Option<f64>,
}

/// How the learning rate falls over a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Decay {
    /// A constant rate.
    Constant,
    /// Linear decay to zero at the last step.
    Linear,
}

impl OptimizerConfig {
    /// A constant learning rate and PyTorch's weight decay; no clipping, warm-up or averaging.
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

    /// The learning rate of a step, counted from 0, of a run of `num_steps`.
    pub fn rate_at(&self, step: u64, num_steps: u64) -> f64 {
        let warmup = ((step + 1) as f64 / (self.warmup_steps + 1) as f64).min(1.0);
        let decay = match self.decay {
            Decay::Constant => 1.0,
            Decay::Linear => 1.0 - step as f64 / num_steps as f64,
        };
        self.learning_rate * warmup * decay
    }
}
