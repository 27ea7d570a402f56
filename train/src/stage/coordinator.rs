//! Training of the body-part coordinator on a dataset.

use compose::COMPOSED;

use super::Streams;
use crate::coordinator::{self, CoordinatorConfig, Segments};
use crate::kind::{Input, ModelKind, TrainRequest, Trained, document};
use crate::{Error, Session};

pub(crate) const MODEL: ModelKind = ModelKind {
    name: coordinator::KIND,
    about: "The body-part coordinator, on natural segments and composed ones",
    uses: &[Input::Compose, Input::Length, Input::Memory],
    preset: |preset| document(&CoordinatorConfig::preset(preset)),
    train,
    open: None,
};

/// Trains the coordinator on segments of the motions that an editor is trained on, or continues its run.
fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&CoordinatorConfig::preset(request.preset))?;
    request.change(&mut config.run);
    request.split(&mut config.run, &config.model, 1 + config.window);
    let (dataset, start) = (request.dataset, request.start);
    let mut compose = request.compose.clone();
    if compose.mirrored_ratio <= 0.0 {
        compose.mirrored_ratio = config.mirrored_ratio;
    }
    let (window, seed) = (config.window, config.run.seed);
    let streams = Streams::open(dataset, &compose, window, seed, start.range()?)?;
    let segments = Segments {
        train: &streams.train,
        val: &streams.val,
        normalizer: streams.normalizer,
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&COMPOSED),
        compose: &streams.compose,
    };
    let num_short = streams.train.num_short() as u64;
    let report = coordinator::train_coordinator(start, &config, segments, session)?;
    Ok(Trained::from_report(report.without(num_short), start.run))
}
