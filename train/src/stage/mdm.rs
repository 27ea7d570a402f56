//! Training of MDM on the captioned motions of a dataset.

use datasets_spec::{Dataset, Split};

use super::MOTIONS;
use super::captioned::{TimedClips, caption_vectors};
use crate::captioned::CaptionedCorpus;
use crate::kind::{ModelKind, TrainRequest, Trained};
use crate::mdm::{self, MdmConfig, train_mdm};
use crate::mdm_bp;
use crate::{Error, Session};

/// MDM, which edits as MDM-BP.
pub(crate) const MODEL: ModelKind = ModelKind {
    name: mdm::KIND,
    about: "MDM, on motions and their captions; it edits body parts as MDM-BP",
    train,
    open: Some(mdm_bp::open),
};

/// Trains MDM as a command line asks for it.
fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&MdmConfig::preset(request.preset))?;
    request.change(&mut config.run);
    let dataset = Dataset::open(request.dataset)?;
    let train = TimedClips::read(&dataset, Split::Train)?;
    let val = TimedClips::read(&dataset, Split::Val)?;
    let vectors = caption_vectors((&config.text, mdm::CLIP), &[&train, &val], request, session)?;
    let corpus = CaptionedCorpus {
        train: &train.views(),
        val: &val.views(),
        vectors: vectors.as_ref().map(|table| table as _),
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&MOTIONS),
    };
    let report = train_mdm(request.start, &config, corpus, session)?;
    Ok(Trained::from_report(report, request.start.run))
}
