//! Training of the evaluation encoder.

use burn::tensor::{Device, Tensor};
use datasets_spec::Seed;
use serde::{Deserialize, Serialize};

use super::clips::{ClipBatch, ClipSampler, clips, fit_features};
use super::config::TmrConfig;
use crate::captioned::CaptionedCorpus;
use crate::checkpoint::{Run, RunRecord, Start};
use crate::config::Loss;
use crate::features::FeatureStats;
use crate::model::pass::Pass;
use crate::model::tmr::{Tmr, info_nce};
use crate::trainer::{self, Task, TrainReport};
use crate::transfer::send;
use crate::vocabulary::Vocabulary;
use crate::{Error, Session};

pub(crate) const KIND: &str = "tmr";

/// Record of an encoder's run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TmrRecord {
    pub(crate) train: TmrConfig,
    pub(crate) features: FeatureStats,
    pub(crate) vocabulary: Vocabulary,
}

/// Trains the encoder, or continues the training of the run folder, exactly as [`crate::fit::train_motionrefit`] does.
/// A run that starts from another run's weights keeps that run's vocabulary and feature statistics.
///
/// # Errors
/// The settings are unusable, a split is empty, a clip has no caption, the folder holds another run or a damaged
/// checkpoint, a loss is not finite, or a file cannot be written.
pub fn train_tmr<'a>(
    start: impl Into<Start<'a>>,
    config: &TmrConfig,
    corpus: CaptionedCorpus<'_>,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    config.check()?;
    let start = start.into();
    let fitted: Option<TmrRecord> = start.fitted(KIND)?;
    let (vocabulary, features) = taken_over(start, fitted, config, &corpus)?;
    let prepared = |split, what| clips(split, what, &vocabulary, config);
    let train = prepared(corpus.train, "training split of the encoder")?;
    let val = prepared(corpus.val, "validation split of the encoder")?;
    let record = TmrRecord {
        train: config.clone(),
        features: match features {
            Some(features) => features,
            None => fit_features(config.features, &train)?,
        },
        vocabulary,
    };
    let document = RunRecord::new(KIND, corpus.dataset_hash, corpus.skeleton, record.clone())
        .trained_in(session);
    let run = Run::open(start, &document)?;

    let seed = Seed(config.run.seed);
    let sampler = ClipSampler {
        clips: &train,
        features: &record.features,
        config,
        seed: seed.derive(&["train"]),
    };
    let val_batches = ClipSampler {
        clips: &val,
        seed: seed.derive(&["val"]),
        ..sampler
    }
    .whole();
    let task = Task::<Tmr, ClipBatch> {
        kind: KIND,
        samples: "clips",
        run: config.run,
        of_thread: None,
        epoch_len: train.len() as u64,
        network: &|device| config.network(&record.vocabulary, device),
        // The contrastive loss compares all pairs of a batch, so a batch is not split.
        draw: &|step, _| Ok(vec![(1.0, sampler.draw(step))]),
        loss: &|model, batch, device, pass| batch_loss(model, batch, config, device, pass),
        validation: val_batches
            .into_iter()
            .map(|batch| (batch.lengths.len(), batch))
            .collect(),
    };
    trainer::train(&task, &run, session)
}

/// The vocabulary and the feature statistics of the run whose weights are taken over. Without such a run, the words of
/// the captions, and no statistics yet.
fn taken_over(
    start: Start<'_>,
    fitted: Option<TmrRecord>,
    config: &TmrConfig,
    corpus: &CaptionedCorpus<'_>,
) -> Result<(Vocabulary, Option<FeatureStats>), Error> {
    match fitted {
        Some(fitted) if fitted.features.recipe == config.features => {
            fitted.vocabulary.check_kept("text", &config.text, start)?;
            Ok((fitted.vocabulary, Some(fitted.features)))
        }
        Some(fitted) => {
            let (own, seen) = (config.features.name(), fitted.features.recipe.name());
            let problem =
                format!("it is {own}, and the run whose weights are to be taken over sees {seen}");
            Err(Error::config("features", problem))
        }
        None => {
            let words = &config.text;
            let vocabulary =
                Vocabulary::build(corpus.captions(), words.num_buckets, words.max_words)?;
            Ok((vocabulary, None))
        }
    }
}

/// The loss of a batch.
///
/// # Source
/// Petrovich et al. 2023, Eq. 4 (`algorithms` section 15).
fn batch_loss(
    model: &Tmr,
    batch: &ClipBatch,
    config: &TmrConfig,
    device: &Device,
    pass: &Pass,
) -> Tensor<1> {
    let num_clips = batch.lengths.len();
    let shape = [num_clips, batch.steps, config.features.width()];
    let features = send(batch.features.clone(), shape, device);
    let shape = [2, num_clips, config.model.width];
    let noise = send(batch.noise.clone(), shape, device);
    let noise = |side: usize| noise.clone().narrow(0, side, 1).squeeze_dim::<2>(0);

    let text = model.encode_text(&batch.tokens, pass);
    let motion = model
        .motion_encoder
        .forward(features.clone(), &batch.lengths, pass);
    let text_latent = text.sample(noise(0));
    let motion_latent = motion.sample(noise(1));

    // Both latents are decoded in one batch.
    let latents = Tensor::cat(vec![text_latent.clone(), motion_latent.clone()], 0);
    let decoded =
        model
            .motion_decoder
            .forward(latents, &batch.lengths.repeat(2), batch.steps, pass);
    let reconstruction = Loss::SmoothL1
        .mean(decoded, Tensor::cat(vec![features.clone(), features], 0))
        .mul_scalar(2.0);
    let standard = text.standard();
    let kl = text.kl(&motion) + motion.kl(&text) + motion.kl(&standard) + text.kl(&standard);
    let latent = Loss::SmoothL1.mean(
        text_latent.clone().unsqueeze_dim(0),
        motion_latent.clone().unsqueeze_dim(0),
    );
    let contrastive = info_nce(
        text_latent,
        motion_latent,
        config.temperature,
        &batch.same_text,
    );
    let weights = &config.weights;
    reconstruction.mul_scalar(weights.reconstruction)
        + kl.mul_scalar(weights.kl)
        + latent.mul_scalar(weights.latent)
        + contrastive.mul_scalar(weights.contrastive)
}
