//! What a model is to the trainer.

use std::path::Path;

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::Error;
use crate::checkpoint::Files;
use crate::model::pass::Pass;
use crate::model::weights::{load_network, to_safetensors};

/// What the trainer needs of a model: data, loss and checkpoint files.
pub trait Task: Sync {
    /// The networks.
    type Model: Module;
    /// Data of a micro-batch.
    type Batch: Send + Sync;

    /// Name of the file of the network in a checkpoint; where there are several, of the main one.
    const WEIGHTS: &'static str;

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
    fn save(&self, model: &Self::Model, run_dir: &Path) -> Result<Files, Error> {
        Ok([(Self::WEIGHTS.to_owned(), to_safetensors(model, run_dir)?)].into())
    }

    /// The inverse of [`Task::save`]: takes the files it needs.
    ///
    /// # Errors
    /// A file is missing, damaged or of another network.
    fn load(
        &self,
        model: &mut Self::Model,
        files: &mut Files,
        run_dir: &Path,
    ) -> Result<(), Error> {
        load_network(model, files, Self::WEIGHTS, run_dir)
    }
}
