//! The interface between a model and the rest of the program: training from a dataset folder and, if the model edits
//! motions, opening it as a system.

use std::path::Path;

use burn::tensor::Device;
use compose::ComposeConfig;
use datasets_spec::{Dataset, Skeleton};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::checkpoint::Start;
use crate::config::{NetworkConfig, Preset, RunLength, RunSettings, overlay};
use crate::system::{EditConfig, EditInput, EditSystem, SystemSource};
use crate::text::source::TextEncoderSource;
use crate::trainer::TrainReport;
use crate::{Error, Session};

/// A kind of model.
#[derive(Clone, Copy, Debug)]
pub struct ModelKind {
    /// Name of the model on the command line and in run folders.
    pub name: &'static str,
    /// Description of the model in one line.
    pub about: &'static str,
    /// Inputs of a training that the model uses; it ignores the others.
    pub uses: &'static [Input],
    /// All settings of a preset: a JSON object, or null for a model without settings.
    pub preset: fn(Preset) -> Value,
    /// Trains a model of this kind on a dataset.
    pub train: fn(&TrainRequest<'_>, &Session<'_>) -> Result<Trained, Error>,
    /// How a trained model is opened as an editing system; `None` for models that do not edit motions.
    pub open: Option<Editing>,
}

impl ModelKind {
    /// Refuses inputs of an edit that the model would ignore. Each input has a name for the error.
    ///
    /// # Errors
    /// The model does not use an input.
    pub fn check_edit_inputs(
        &self,
        given: impl IntoIterator<Item = (&'static str, EditInput)>,
    ) -> Result<(), Error> {
        let uses = self.open.map_or(&[][..], |editing| editing.uses);
        match given.into_iter().find(|(_, input)| !uses.contains(input)) {
            Some((name, _)) => Err(Error::Refused(format!(
                "the model {} makes no use of {name}; edit without it",
                self.name
            ))),
            None => Ok(()),
        }
    }
}

/// An input of a training that not every model uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// Composition settings of edits.
    Compose,
    /// Recorded windows.
    Windows,
    /// Source of a frozen text encoder, for settings that use one.
    TextEncoder,
    /// Length of the training.
    Length,
    /// Memory of the device.
    Memory,
}

/// A model as an editor.
#[derive(Clone, Copy, Debug)]
pub struct Editing {
    /// Inputs of an edit that the model uses; others are refused.
    pub uses: &'static [EditInput],
    /// Opens a trained model.
    pub open: OpenSystem,
}

pub(crate) fn document<T: Serialize>(settings: &T) -> Value {
    serde_json::to_value(settings).expect("settings serialise")
}

/// Opens a run folder as an editing system for motions on a skeleton.
pub type OpenSystem =
    fn(&SystemSource, &EditConfig, &Skeleton, &Device) -> Result<Box<dyn EditSystem>, Error>;

/// A request to train a model. Models ignore inputs that they do not use ([`ModelKind::uses`]).
#[derive(Clone, Copy, Debug)]
pub struct TrainRequest<'a> {
    /// The dataset, or the selected part of it.
    pub dataset: &'a Dataset,
    /// Run folder, and the weights that the run starts from.
    pub start: Start<'a>,
    /// Preset of the settings.
    pub preset: Preset,
    /// Settings that override the preset's: a JSON object.
    pub own: &'a Value,
    /// Composition settings of edits.
    pub compose: &'a ComposeConfig,
    /// Recorded windows, used instead of composing windows.
    pub windows: Option<&'a Path>,
    /// Source of a frozen text encoder, for settings that use one.
    pub text_encoder: &'a TextEncoderSource,
    /// Seed that overrides that of the settings.
    pub seed: Option<u64>,
    /// Length that overrides that of the settings.
    pub length: Option<RunLength>,
    /// Memory of the device in bytes. If given, the micro-batch size is computed from it, overriding the settings.
    pub memory: Option<u64>,
}

impl TrainRequest<'_> {
    /// The preset overridden by the request's own settings.
    ///
    /// # Errors
    /// A setting is unknown or of another type.
    pub fn settings<T: Serialize + DeserializeOwned>(&self, preset: &T) -> Result<T, Error> {
        overlay(preset, self.own).map_err(|source| Error::Settings { source })
    }

    /// Applies the request's seed and length.
    pub fn change(&self, run: &mut RunSettings) {
        run.seed = self.seed.unwrap_or(run.seed);
        run.length = self.length.unwrap_or(run.length);
    }

    /// Splits the steps of a run into micro-batches that fit into the request's memory. `tokens` is the number of
    /// tokens in a sample.
    pub(crate) fn split(&self, run: &mut RunSettings, model: &NetworkConfig, tokens: usize) {
        if let Some(memory) = self.memory {
            let fitting = model.samples_in(memory, tokens);
            run.micro_batch_size = Some(fitting.min(run.batch_size));
        }
    }
}

/// Result of a training run of any model.
#[derive(Clone, Debug)]
pub struct Trained {
    /// Whether the run reached its last step.
    pub is_complete: bool,
    /// Summary for people.
    pub summary: String,
    /// Report for programs.
    pub document: Value,
}

impl Trained {
    pub(crate) fn from_report(report: TrainReport, run: &Path) -> Self {
        Self {
            is_complete: report.is_complete,
            summary: report.summary(run),
            document: serde_json::to_value(&report).expect("plain numbers serialise"),
        }
    }
}
