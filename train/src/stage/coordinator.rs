//! Training of the body-part coordinator on a dataset.

use compose::COMPOSED;
use compose::ComposeConfig;
use datasets_spec::{Dataset, Seed};

use super::Streams;
use crate::checkpoint::Start;
use crate::compose::ComposeRecord;
use crate::coordinator::{self, CoordinatorConfig, Segments};
use crate::kind::{ModelKind, TrainRequest, Trained, document};
use crate::trainer::TrainReport;
use crate::{Error, Session};

/// The body-part coordinator.
pub(crate) const MODEL: ModelKind = ModelKind {
    name: coordinator::KIND,
    about: "The body-part coordinator, on natural segments and composed ones",
    preset: |preset| document(&CoordinatorConfig::preset(preset)),
    train,
    open: None,
};

/// Trains the coordinator on segments of the motions an editor is trained on, or continues its run.
///
/// # Errors
/// As [`coordinator::train_coordinator`], or the dataset cannot be read.
pub fn train_coordinator<'a>(
    dataset: &Dataset,
    start: impl Into<Start<'a>>,
    config: &CoordinatorConfig,
    compose: &ComposeConfig,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    let start = start.into();
    let seed = config.run.seed;
    let compose = ComposeConfig {
        mirrored_ratio: if compose.mirrored_ratio > 0.0 {
            compose.mirrored_ratio
        } else {
            config.mirrored_ratio
        },
        ..compose.clone()
    };
    let streams = Streams::open(dataset, &compose, config.window, seed, start.range()?)?;
    let record = ComposeRecord {
        config: streams.compose,
        seed: Seed(seed),
    };
    let segments = Segments {
        train: &streams.train,
        val: &streams.val,
        normalizer: streams.normalizer,
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&COMPOSED),
        compose: &record,
    };
    coordinator::train_coordinator(start, config, segments, session)
}

/// Trains the coordinator as a command line asks for it.
fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&CoordinatorConfig::preset(request.preset))?;
    request.change(&mut config.run);
    request.split(&mut config.run, &config.model, 1 + config.window);
    let report = train_coordinator(
        request.dataset,
        request.start,
        &config,
        request.compose,
        session,
    )?;
    Ok(Trained::from_report(report, request.start.run))
}
