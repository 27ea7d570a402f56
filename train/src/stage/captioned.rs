//! Training of MDM and of MLD on the captioned motions of a dataset.

use datasets_spec::record::MotionRow;
use datasets_spec::{Dataset, Fps, Split};
use kinematics::resample;

use super::MOTIONS;
use crate::captioned::{CaptionedClip, CaptionedCorpus};
use crate::config::TextEncoder;
use crate::error::motion_error;
use crate::kind::{Input, ModelKind, TrainRequest, Trained, document};
use crate::mdm::{self, MdmConfig, train_mdm};
use crate::mdm_bp;
use crate::mld::{self, MldConfig, train_mld};
use crate::text::clip::ClipModel;
use crate::trainer::TrainReport;
use crate::{Error, Session};

pub(crate) const MDM: ModelKind = ModelKind {
    name: mdm::KIND,
    about: "MDM, on motions and their captions; it edits body parts as MDM-BP",
    uses: &[Input::TextEncoder, Input::Length, Input::Memory],
    preset: |preset| document(&MdmConfig::preset(preset)),
    train: |request, session| {
        let mut config = request.settings(&MdmConfig::preset(request.preset))?;
        request.change(&mut config.run);
        request.split(&mut config.run, &config.model, 1 + config.max_frames);
        let encoder = (config.text.encoder, mdm::CLIP);
        train_on_captions(request, encoder, session, |corpus| {
            train_mdm(request.start, &config, corpus, session)
        })
    },
    open: Some(mdm_bp::EDITING),
};

/// MLD. A request's seed and length apply to both of its runs.
pub(crate) const MLD: ModelKind = ModelKind {
    name: mld::KIND,
    about: "MLD, an autoencoder of motions and a diffusion of its latents, for `stance variants`",
    uses: &[Input::TextEncoder, Input::Length, Input::Memory],
    preset: |preset| document(&MldConfig::preset(preset)),
    train: |request, session| {
        let mut config = request.settings(&MldConfig::preset(request.preset))?;
        request.change(&mut config.autoencoder.run);
        request.change(&mut config.run);
        // The autoencoder has an encoder and a decoder of this size, so a sample counts twice the tokens.
        let autoencoder = &mut config.autoencoder;
        let tokens = 2 * (2 + autoencoder.max_frames);
        request.split(&mut autoencoder.run, &autoencoder.model, tokens);
        request.split(&mut config.run, &config.model, 3);
        let encoder = (config.text.encoder, mld::CLIP);
        train_on_captions(request, encoder, session, |corpus| {
            train_mld(request.start, &config, corpus, session)
        })
    },
    open: None,
};

/// The captioned clips of a split.
#[derive(Debug, Default)]
pub struct CaptionedClips {
    /// The clips, each with captions of the whole clip. A part of a clip with its own caption is a separate clip.
    pub clips: Vec<CaptionedClip>,
    /// Number of captions whose part has fewer than two frames at 20 frames a second.
    pub left_out: u64,
}

impl CaptionedClips {
    /// Reads those of a dataset.
    ///
    /// # Source
    /// `Text2MotionDatasetV2` of HumanML3D.
    ///
    /// # Errors
    /// The dataset cannot be read, or a row does not hold a motion.
    pub fn read(dataset: &Dataset, split: Split) -> Result<Self, Error> {
        let rows: Vec<MotionRow> = dataset.read(Some(split))?;
        let mut found = Self::default();
        for row in rows.iter().filter(|row| !row.captions.is_empty()) {
            found.push(row).map_err(motion_error(row.id.as_str()))?;
        }
        Ok(found)
    }

    fn push(&mut self, row: &MotionRow) -> Result<(), datasets_spec::Error> {
        let motion = row.motion()?;
        let mut of_all = Vec::new();
        for caption in &row.captions {
            if caption.from_s == 0.0 && caption.to_s == 0.0 {
                of_all.push(caption.text.clone());
                continue;
            }
            let frame =
                |secs: f32| ((f64::from(secs) * motion.fps().get()) as usize).min(motion.len());
            let frames = frame(caption.from_s)..frame(caption.to_s);
            if resample::grid(frames.len(), motion.fps(), Fps::STORE).len() < 2 {
                self.left_out += 1;
                continue;
            }
            self.clips.push(CaptionedClip {
                id: format!("{} {}:{}", row.id, frames.start, frames.end),
                motion: motion.crop(frames)?,
                captions: vec![caption.text.clone()],
            });
        }
        if !of_all.is_empty() {
            self.clips.push(CaptionedClip {
                id: row.id.to_string(),
                motion,
                captions: of_all,
            });
        }
        Ok(())
    }
}

/// Trains a model on the captioned clips of a dataset, with captions encoded by `encoder`. If the encoder is frozen,
/// the vectors of all captions and of the empty text are stored in the run folder.
fn train_on_captions(
    request: &TrainRequest<'_>,
    encoder: (TextEncoder, ClipModel),
    session: &Session<'_>,
    fit: impl FnOnce(CaptionedCorpus<'_>) -> Result<TrainReport, Error>,
) -> Result<Trained, Error> {
    let dataset = request.dataset;
    let train = CaptionedClips::read(dataset, Split::Train)?;
    let val = CaptionedClips::read(dataset, Split::Val)?.clips;
    let captions = train
        .clips
        .iter()
        .chain(&val)
        .flat_map(|clip| &clip.captions);
    let captions: Vec<String> = captions.cloned().chain([String::new()]).collect();
    let (run, source) = (request.start.run, request.text_encoder);
    let known = request.start.known().unwrap_or(run);
    let vectors = source.embeddings(known, &captions, encoder, session)?;
    let report = fit(CaptionedCorpus {
        train: &train.clips,
        val: &val,
        vectors: vectors.as_ref(),
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&MOTIONS),
    })?;
    Ok(Trained::from_report(report.without(train.left_out), run))
}
