//! The interface between a model and the trainer.

use burn::tensor::{Device, Tensor};

use crate::Error;
use crate::config::RunSettings;
use crate::model::pass::Pass;

/// A training of networks `M` with micro-batches `B`: its data, loss and settings.
pub(crate) struct Task<'a, M, B> {
    /// Kind of model, shown with the progress.
    pub(crate) kind: &'static str,
    /// Plural noun for the samples, shown with the progress.
    pub(crate) samples: &'static str,
    pub(crate) run: RunSettings,
    /// Largest micro-batch on a processor, in samples. Smaller ones are slower; with larger ones, a step keeps fewer
    /// threads busy. `None` if the loss is not a mean over samples: then its value depends on how a step is split.
    pub(crate) of_thread: Option<usize>,
    pub(crate) epoch_len: u64,
    /// Builds the networks on a device.
    pub(crate) network: &'a (dyn Fn(&Device) -> M + Sync),
    /// Draws the micro-batches of a step, each with its share of the step's loss. The shares add up to one. The data
    /// depend only on the run's seed and the step. The arguments are the step and the largest size of a micro-batch.
    pub(crate) draw: &'a (dyn Fn(u64, usize) -> Result<Vec<(f64, B)>, Error> + Sync),
    /// Computes the mean loss of a micro-batch.
    pub(crate) loss: &'a (dyn Fn(&M, &B, &Device, &Pass) -> Tensor<1> + Sync),
    /// The micro-batches of a validation, each with its number of samples.
    pub(crate) validation: Vec<(usize, B)>,
}

impl<M, B> Task<'_, M, B> {
    pub(super) fn steps_per_epoch(&self) -> u64 {
        self.epoch_len.div_ceil(self.run.batch_size as u64).max(1)
    }

    pub(super) fn num_steps(&self) -> u64 {
        self.run.length.num_steps(self.steps_per_epoch())
    }
}
