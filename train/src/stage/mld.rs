//! Training of MLD on the captioned motions of a dataset.

use super::captioned::train_on_captions;
use crate::kind::{ModelKind, TrainRequest, Trained, document};
use crate::mld::{self, MldConfig, train_mld};
use crate::{Error, Session};

pub(crate) const MODEL: ModelKind = ModelKind {
    name: mld::KIND,
    about: "MLD, an autoencoder of motions and a diffusion of its latents, for `stance variants`",
    preset: |preset| document(&MldConfig::preset(preset)),
    train,
    open: None,
};

/// Trains MLD as requested. The request's seed and length apply to both of its runs.
fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&MldConfig::preset(request.preset))?;
    request.change(&mut config.autoencoder.run);
    request.change(&mut config.run);
    // The encoder and the decoder of motions have twice the layers, so a sample counts twice the tokens.
    let autoencoder = &mut config.autoencoder;
    let tokens = 2 * (2 + autoencoder.max_frames);
    request.split(&mut autoencoder.run, &autoencoder.model, tokens);
    request.split(&mut config.run, &config.model, 3);
    let encoder = (config.text.encoder, mld::CLIP);
    train_on_captions(request, encoder, session, |corpus| {
        train_mld(request.start, &config, corpus, session)
    })
}
