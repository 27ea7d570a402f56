//! Progress of a run: losses, speed, and lines of the metrics file.

use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::transfer::read_all;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TrainState {
    pub(super) step: u64,
    /// Losses of the steps since the last line of the metrics file.
    pub(super) pending: Vec<f32>,
    pub(super) first_loss: Option<f32>,
    pub(super) last_loss: Option<f32>,
    pub(super) best_val_loss: Option<f32>,
    pub(super) best_step: u64,
}

impl TrainState {
    /// Mean loss since the last log line; resets it.
    pub(super) fn take_loss(&mut self) -> f32 {
        let sum: f64 = self.pending.iter().map(|&loss| f64::from(loss)).sum();
        let loss = (sum / self.pending.len().max(1) as f64) as f32;
        self.first_loss.get_or_insert(loss);
        self.last_loss = Some(loss);
        self.pending.clear();
        loss
    }

    /// Records the validation loss of a step, and returns whether it is the lowest so far.
    pub(super) fn note_validation(&mut self, val_loss: f32) -> bool {
        let is_best = self.best_val_loss.is_none_or(|best| val_loss < best);
        if is_best {
            self.best_val_loss = Some(val_loss);
            self.best_step = self.step;
        }
        is_best
    }
}

#[derive(Serialize)]
pub(super) struct MetricsLine {
    pub(super) step: u64,
    pub(super) loss: f32,
    pub(super) learning_rate: f64,
    /// Norm of the last step's gradient before clipping; none without clipping.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gradient_norm: Option<f64>,
    pub(super) samples_per_sec: f64,
    pub(super) data_wait_share: f64,
}

#[derive(Serialize)]
pub(super) struct ValidationLine {
    pub(super) step: u64,
    pub(super) val_loss: f32,
    pub(super) is_best: bool,
}

/// Time spent on training steps, and the part of it spent waiting for data.
#[derive(Default)]
pub(super) struct Speed {
    steps: u64,
    total_secs: f64,
    wait_secs: f64,
}

impl Speed {
    pub(super) fn add(&mut self, total_secs: f64, wait_secs: f64) {
        self.steps += 1;
        self.total_secs += total_secs;
        self.wait_secs += wait_secs;
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.steps += other.steps;
        self.total_secs += other.total_secs;
        self.wait_secs += other.wait_secs;
    }

    pub(super) fn samples_per_sec(&self, batch_size: usize) -> f64 {
        self.per_sec((self.steps * batch_size as u64) as f64)
    }

    pub(super) fn wait_share(&self) -> f64 {
        self.per_sec(self.wait_secs)
    }

    fn per_sec(&self, amount: f64) -> f64 {
        if self.total_secs > 0.0 {
            amount / self.total_secs
        } else {
            0.0
        }
    }
}

#[derive(Default)]
pub(super) struct Unread {
    pub(super) losses: Vec<Tensor<1>>,
    /// Norm of the last step's gradient before clipping.
    pub(super) norm: Option<Tensor<1>>,
}

impl Unread {
    /// Reads all values in one transfer: appends the losses to those of `state`, and returns the norm.
    pub(super) fn read(&mut self, state: &mut TrainState, kept: u64) -> Result<Option<f64>, Error> {
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
