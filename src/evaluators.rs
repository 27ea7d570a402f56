//! Adapters between the traits of `eval` and the trained models of `train`.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::bail;
use datasets_spec::{Dataset, Motion, Skeleton, Split};
use eval::EncoderError;
use eval::answers;
use eval::evaluators::{Evaluators, MotionClassifier, MotionEncoder};
use eval::metric::cross_retrieval::CrossRetrieval;
use eval::protocol::Protocol;
use train::checkpoint::{Slot, check_skeleton};
use train::coordinator::TrainedCoordinator;
use train::stage::encoder::{CaptionedClip, captioned_clips};
use train::tmr::TmrEncoder;

use crate::device::device;

/// Run folders of the models that motions are evaluated with.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EvaluatorRuns<'a> {
    /// The evaluation encoder.
    pub(crate) encoder: &'a Path,
    /// A coordinator.
    pub(crate) coordinator: Option<&'a Path>,
}

impl EvaluatorRuns<'_> {
    /// Loads the models for motions on a skeleton.
    pub(crate) fn with<T>(
        &self,
        skeleton: &Skeleton,
        act: impl FnOnce(Evaluators<'_>) -> Result<T, eval::Error>,
    ) -> anyhow::Result<T> {
        check_skeleton(self.encoder, "the encoder", skeleton)?;
        if let Some(run) = self.coordinator {
            check_skeleton(run, "the coordinator", skeleton)?;
        }
        let encoder = Encoder(TmrEncoder::load(self.encoder, Slot::Best, &device())?);
        let classifier = match self.coordinator {
            Some(run) => Some(Classifier {
                network: TrainedCoordinator::load(run, Slot::Best, &device())?,
                skeleton,
            }),
            None => None,
        };
        Ok(act(Evaluators {
            encoder: &encoder,
            classifier: classifier.as_ref().map(|it| it as &dyn MotionClassifier),
            skeleton,
        })?)
    }
}

struct Encoder(TmrEncoder);

fn in_double(latents: Vec<Vec<f32>>) -> Vec<Vec<f64>> {
    latents
        .into_iter()
        .map(|latent| latent.into_iter().map(f64::from).collect())
        .collect()
}

impl MotionEncoder for Encoder {
    fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError> {
        Ok(in_double(self.0.encode(motions)?))
    }

    fn hash(&self) -> String {
        self.0.hash().to_owned()
    }

    fn recipe(&self) -> String {
        self.0.description()
    }
}

/// A coordinator, which tells composed motions from natural ones.
struct Classifier<'a> {
    network: TrainedCoordinator,
    skeleton: &'a Skeleton,
}

impl MotionClassifier for Classifier<'_> {
    fn composed(&self, motions: &[&Motion]) -> Result<Vec<f64>, EncoderError> {
        motions
            .iter()
            .map(|motion| Ok(self.network.composed_share(motion, self.skeleton)?))
            .collect()
    }
}

/// How well an encoder's texts and motions retrieve each other in a split: the number of clips, and one
/// result a repeat.
pub(crate) fn encoder_retrieval(
    root: &Path,
    run: &Path,
    split: Split,
    protocol: &Protocol,
) -> anyhow::Result<(usize, Vec<CrossRetrieval>)> {
    protocol.check()?;
    let encoder = TmrEncoder::load(run, Slot::Best, &device())?;
    let clips = captioned_clips(&Dataset::open(root)?, split)?;
    let kept: BTreeSet<usize> = protocol.scored_items(clips.len())?.into_iter().collect();
    let clips: Vec<&CaptionedClip> = clips
        .iter()
        .enumerate()
        .filter_map(|(place, clip)| kept.contains(&place).then_some(clip))
        .collect();
    if clips.is_empty() {
        bail!("no clip of split {split} has a caption; choose another split with --split");
    }
    let texts: Vec<&str> = clips.iter().map(|clip| clip.captions[0].as_str()).collect();
    let motions: Vec<&Motion> = clips.iter().map(|clip| &clip.motion).collect();
    let repeats = answers::encoder_retrieval(
        &texts,
        &in_double(encoder.encode_texts(&texts)?),
        &in_double(encoder.encode(&motions)?),
        protocol,
    )?;
    Ok((clips.len(), repeats))
}
