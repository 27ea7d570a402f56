//! Helpers of several topics.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use burn::tensor::Device;
use datasets_spec::{Fps, NoProgress, Seed, Skeleton};
use kinematics::normalise::Normalizer;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use train::config::DiffusionConfig;
use train::diffusion::Objective;
use train::features::{FeatureRecipe, FeatureStats};
use train::fit::{EditorRecord, TextRecord};
use train::registry::open_system;
use train::sample::{EditSettings, FitMethod};
use train::schedule::Schedule;
use train::system::{EditConfig, EditSystem, SystemSource};
use train::text::source::TextEncoderSource;
use train::{Error, Session};

/// Checks that the result is an error whose message contains `why`.
#[track_caller]
pub(crate) fn refused<T>(result: Result<T, Error>, why: &str) {
    let Err(error) = result else {
        panic!("not refused: {why}");
    };
    let error = error.to_string();
    assert!(error.contains(why), "{why:?} is not in: {error}");
}

/// Runs `act` with a session that reports nothing and never stops.
pub(crate) fn quietly<T>(act: impl FnOnce(&Session<'_>) -> T) -> T {
    support::on(&Device::flex(), &NoProgress, &AtomicBool::new(false), act)
}

/// Opens the editor of a run.
#[track_caller]
pub(crate) fn opened(run: &Path, config: &EditConfig) -> Box<dyn EditSystem> {
    let source = SystemSource::best(run, TextEncoderSource::default());
    let skeleton = Skeleton::smplx_neutral();
    open_system(&source, config, &skeleton, &Device::flex()).expect("an editor")
}

/// A normaliser whose model units are metres.
pub(crate) const METRES: Normalizer = Normalizer {
    min: [-1.0; 3],
    max: [1.0; 3],
};

/// The objective for windows at 20 fps, whose model units are metres.
pub(crate) fn objective<'a>(schedule: &'a Schedule, config: &'a DiffusionConfig) -> Objective<'a> {
    Objective {
        schedule,
        extrapolation: None,
        config,
        normalizer: &METRES,
        fps: Fps::STORE,
    }
}

/// Settings of edits with two windows at a time, without guidance.
pub(crate) fn edit_settings(record: &EditorRecord) -> EditSettings {
    EditSettings {
        seed: Seed(5),
        guidance: 1.0,
        temperature: 1.0,
        coordinator: record.train.coordinator,
        fit: FitMethod::Exact,
        prior: 0.0,
        max_batch: 2,
    }
}

/// Statistics that leave features as they are.
pub(crate) fn plain_stats(recipe: FeatureRecipe, width: usize) -> FeatureStats {
    FeatureStats {
        recipe,
        mean: vec![0.0; width],
        std: vec![1.0; width],
    }
}

/// The record of a frozen text encoder.
pub(crate) fn frozen_text(width: usize) -> TextRecord {
    TextRecord::Frozen {
        encoder_hash: "clip".to_owned(),
        width,
    }
}

/// Shapes and values of tensors by name.
pub(crate) type Weights = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

pub(crate) fn le_bytes(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

pub(crate) fn as_safetensors(weights: &Weights) -> Vec<u8> {
    let data = weights.iter();
    let data = data.map(|(name, (shape, values))| (name, shape, le_bytes(values)));
    let data: Vec<_> = data.collect();
    let views = data.iter().map(|(name, shape, data)| {
        let view = TensorView::new(Dtype::F32, shape.to_vec(), data).expect("fits");
        (name.as_str(), view)
    });
    safetensors::serialize(views, None).expect("serialises")
}
