//! Training of MDM on the captioned motions of a dataset.

use super::captioned::train_on_captions;
use crate::kind::{ModelKind, TrainRequest, Trained, document};
use crate::mdm::{self, MdmConfig, train_mdm};
use crate::mdm_bp;
use crate::{Error, Session};

pub(crate) const MODEL: ModelKind = ModelKind {
    name: mdm::KIND,
    about: "MDM, on motions and their captions; it edits body parts as MDM-BP",
    preset: |preset| document(&MdmConfig::preset(preset)),
    train,
    open: Some(mdm_bp::open),
};

fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&MdmConfig::preset(request.preset))?;
    request.change(&mut config.run);
    request.split(&mut config.run, &config.model, 1 + config.max_frames);
    let encoder = (config.text.encoder, mdm::CLIP);
    train_on_captions(request, encoder, session, |corpus| {
        train_mdm(request.start, &config, corpus, session)
    })
}
