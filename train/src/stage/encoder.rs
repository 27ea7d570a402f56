//! Training of the evaluation encoder on a dataset.

use datasets_spec::{Dataset, Split};

use super::MOTIONS;
use super::captioned::CaptionedClips;
use crate::captioned::CaptionedCorpus;
use crate::checkpoint::Start;
use crate::kind::{Input, ModelKind, TrainRequest, Trained, document};
use crate::tmr::{self, TmrConfig, train_tmr};
use crate::trainer::TrainReport;
use crate::{Error, Session};

pub(crate) const MODEL: ModelKind = ModelKind {
    name: tmr::KIND,
    about: "The encoder of motions and texts that evaluation measures with",
    uses: &[Input::Length],
    preset: |preset| document(&TmrConfig::preset(preset)),
    train,
    open: None,
};

/// Trains the evaluation encoder, or continues its run.
///
/// # Errors
/// As [`train_tmr`], or the dataset cannot be read.
pub fn train_encoder<'a>(
    dataset: &Dataset,
    start: impl Into<Start<'a>>,
    config: &TmrConfig,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    let train = CaptionedClips::read(dataset, Split::Train)?;
    let corpus = CaptionedCorpus {
        train: &train.clips,
        val: &CaptionedClips::read(dataset, Split::Val)?.clips,
        vectors: None,
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&MOTIONS),
    };
    Ok(train_tmr(start, config, corpus, session)?.without(train.left_out))
}

fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&TmrConfig::preset(request.preset))?;
    request.change(&mut config.run);
    let report = train_encoder(request.dataset, request.start, &config, session)?;
    Ok(Trained::from_report(report, request.start.run))
}
