//! The interface of a model to the rest of the program: it is trained from a dataset folder and, if it
//! edits motions, opened as a system.

use std::path::Path;

use burn::tensor::Device;
use compose::ComposeConfig;
use datasets_spec::{Dataset, Skeleton};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::checkpoint::Start;
use crate::config::{NetworkConfig, Preset, RunLength, RunSettings, overlay};
use crate::system::{EditConfig, EditSystem, SystemSource};
use crate::text::source::TextEncoderSource;
use crate::trainer::TrainReport;
use crate::{Error, Session};

/// A kind of model.
#[derive(Clone, Copy, Debug)]
pub struct ModelKind {
    /// Name on the command line and in run folders.
    pub name: &'static str,
    /// Description in one line.
    pub about: &'static str,
    /// All settings of a preset: a JSON object, or null for a model without settings.
    pub preset: fn(Preset) -> Value,
    /// Trains a model of this kind on a dataset.
    pub train: fn(&TrainRequest<'_>, &Session<'_>) -> Result<Trained, Error>,
    /// Opens a trained one as an editing system; `None` for models that do not edit motions.
    pub open: Option<OpenSystem>,
}

pub(crate) fn document<T: Serialize>(settings: &T) -> Value {
    serde_json::to_value(settings).expect("settings serialise")
}

/// Opens a run folder as an editing system for motions on a skeleton.
pub type OpenSystem =
    fn(&SystemSource, &EditConfig, &Skeleton, &Device) -> Result<Box<dyn EditSystem>, Error>;

/// A training run as it is asked for. Models ignore inputs that they have no use for.
#[derive(Clone, Copy, Debug)]
pub struct TrainRequest<'a> {
    /// The dataset, or the chosen part of it.
    pub dataset: &'a Dataset,
    /// Run folder, and what the run begins with.
    pub start: Start<'a>,
    /// Named settings.
    pub preset: Preset,
    /// Settings that override the preset's: a JSON object.
    pub own: &'a Value,
    /// How edits are composed.
    pub compose: &'a ComposeConfig,
    /// Windows recorded before, in place of composing them.
    pub windows: Option<&'a Path>,
    /// Source of a frozen text encoder, for settings that use one.
    pub text_encoder: &'a TextEncoderSource,
    /// Seed that overrides that of the settings.
    pub seed: Option<u64>,
    /// Length that overrides that of the settings.
    pub length: Option<RunLength>,
    /// Memory of the device in bytes, which decides the micro-batches in place of the settings.
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

    /// Applies seed and length of the request.
    pub fn change(&self, run: &mut RunSettings) {
        run.seed = self.seed.unwrap_or(run.seed);
        run.length = self.length.unwrap_or(run.length);
    }

    /// Splits the steps of a run into micro-batches that fit into the request's memory. `tokens` are those
    /// of a sample.
    pub(crate) fn split(&self, run: &mut RunSettings, model: &NetworkConfig, tokens: usize) {
        if let Some(memory) = self.memory {
            let fitting = model.samples_in(memory, tokens);
            run.micro_batch_size = Some(fitting.min(run.batch_size));
        }
    }
}

/// Result of a training run, whatever was trained.
#[derive(Clone, Debug)]
pub struct Trained {
    /// Whether the run reached its last step.
    pub is_complete: bool,
    /// For people.
    pub summary: String,
    /// For programs.
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
