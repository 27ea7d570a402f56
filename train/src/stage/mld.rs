//! Training of MLD on the captioned motions of a dataset.

use datasets_spec::{Dataset, Split};

use super::MOTIONS;
use super::captioned::{TimedClips, caption_vectors};
use crate::captioned::CaptionedCorpus;
use crate::kind::{ModelKind, TrainRequest, Trained};
use crate::mld::{self, MldConfig, train_mld};
use crate::{Error, Session};

/// MLD, which makes variants of motions.
pub(crate) const MODEL: ModelKind = ModelKind {
    name: mld::KIND,
    about: "MLD, an autoencoder of motions and a diffusion of its latents, for `stance variants`",
    train,
    open: None,
};

/// Trains MLD as a command line asks for it. Seed and length hold for both of its runs.
fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&MldConfig::preset(request.preset))?;
    request.change(&mut config.autoencoder.run);
    request.change(&mut config.run);
    let dataset = Dataset::open(request.dataset)?;
    let train = TimedClips::read(&dataset, Split::Train)?;
    let val = TimedClips::read(&dataset, Split::Val)?;
    let vectors = caption_vectors((&config.text, mld::CLIP), &[&train, &val], request, session)?;
    let corpus = CaptionedCorpus {
        train: &train.views(),
        val: &val.views(),
        vectors: vectors.as_ref().map(|table| table as _),
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&MOTIONS),
    };
    let report = train_mld(request.start, &config, corpus, session)?;
    Ok(Trained::from_report(report, request.start.run))
}
