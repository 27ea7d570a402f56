//! Training of the evaluation encoder on a dataset.

use datasets_spec::Split;

use super::MOTIONS;
use super::captioned::CaptionedClips;
use crate::captioned::CaptionedCorpus;
use crate::kind::{Input, ModelKind, TrainRequest, Trained, document};
use crate::tmr::{self, TmrConfig, train_tmr};
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
fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&TmrConfig::preset(request.preset))?;
    request.change(&mut config.run);
    let (dataset, run) = (request.dataset, request.start.run);
    let train = CaptionedClips::read(dataset, Split::Train)?;
    let corpus = CaptionedCorpus {
        train: &train.clips,
        val: &CaptionedClips::read(dataset, Split::Val)?.clips,
        vectors: None,
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&MOTIONS),
    };
    let report = train_tmr(request.start, &config, corpus, session)?;
    Ok(Trained::from_report(report.without(train.left_out), run))
}
