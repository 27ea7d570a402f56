//! Training of the evaluation encoder on a dataset.

use datasets_spec::record::MotionRow;
use datasets_spec::{Dataset, Split};

use super::MOTIONS;
use crate::captioned::{CaptionedClip, CaptionedCorpus};
use crate::checkpoint::Start;
use crate::error::motion_error;
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

/// The clips of a split that have a caption.
///
/// # Errors
/// The dataset cannot be read, or a row does not hold a motion.
pub fn captioned_clips(dataset: &Dataset, split: Split) -> Result<Vec<CaptionedClip>, Error> {
    let rows: Vec<MotionRow> = dataset.read(Some(split))?;
    let clips = rows.into_iter().filter(|row| !row.captions.is_empty());
    clips
        .map(|row| {
            let id = row.id.to_string();
            let motion = row.motion().map_err(motion_error(&id))?;
            let captions = row.captions.into_iter().map(|caption| caption.text);
            Ok(CaptionedClip {
                id,
                motion,
                captions: captions.collect(),
            })
        })
        .collect()
}

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
    let corpus = CaptionedCorpus {
        train: &captioned_clips(dataset, Split::Train)?,
        val: &captioned_clips(dataset, Split::Val)?,
        vectors: None,
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&MOTIONS),
    };
    train_tmr(start, config, corpus, session)
}

fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&TmrConfig::preset(request.preset))?;
    request.change(&mut config.run);
    let report = train_encoder(request.dataset, request.start, &config, session)?;
    Ok(Trained::from_report(report, request.start.run))
}
