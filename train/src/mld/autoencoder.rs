//! The autoencoder of motions: its training and its use.

use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor};
use datasets_spec::Seed;
use serde::{Deserialize, Serialize};

use super::config::AutoencoderConfig;
use super::joints::recovered_joints;
use crate::captioned::{CaptionedCorpus, CaptionedRows, CropSampler, Crops, grouped_stats};
use crate::checkpoint::{Run, RunRecord, Slot, open_for_use};
use crate::config::Loss;
use crate::features::FeatureStats;
use crate::model::mld::{MAX_POSITIONS, MotionVae};
use crate::model::pass::Pass;
use crate::model::weights::Networks;
use crate::sample::noise::normal;
use crate::trainer::{self, Task, TrainReport};
use crate::transfer::send;
use crate::{Error, Session};

const KIND: &str = "mld-autoencoder";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AutoencoderRecord {
    train: AutoencoderConfig,
    features: FeatureStats,
}

fn folder(run: &Path) -> PathBuf {
    run.join("autoencoder")
}

/// Trains the autoencoder, or continues the training of its folder.
pub(super) fn train(
    run: &Path,
    config: &AutoencoderConfig,
    splits: [&[CaptionedRows]; 2],
    corpus: &CaptionedCorpus<'_>,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    let [clips, val] = splits;
    let record = AutoencoderRecord {
        train: config.clone(),
        features: grouped_stats(clips),
    };
    let document = RunRecord::new(KIND, corpus.dataset_hash, corpus.skeleton, record.clone())
        .trained_in(session);
    let run = Run::open(&folder(run), &document)?;
    let seed = Seed(config.run.seed);
    let sampler = |clips, name| CropSampler {
        clips,
        stats: &record.features,
        max_frames: config.max_frames,
        pads_to_max: false,
        seed: seed.derive(&[name]),
    };
    let val = sampler(val, "val").whole(config.run.micro_batch());
    let sampler = sampler(clips, "train");
    let task = Task::<MotionVae, NoisyCrops<'_>> {
        kind: KIND,
        samples: "motions",
        run: config.run,
        // The loss also averages over padding, and so depends on the longest motion of the micro-batch.
        of_thread: None,
        epoch_len: clips.len() as u64,
        network: &|device| record.network(device),
        draw: &config.run.batches(|first, count| {
            let noise = latent_noise(sampler.seed, first, count, config.model.width);
            Ok((sampler.draw(first, count), Some(noise)))
        }),
        loss: &|model, batch, device, pass| record.loss(model, batch, device, pass),
        // A validation uses the mean latent vectors.
        validation: val
            .into_iter()
            .map(|crops| (crops.lengths.len(), (crops, None)))
            .collect(),
    };
    trainer::train(&task, &run, session)
}

/// Crops, and the noise for their latent vectors, `[B, d]`.
type NoisyCrops<'a> = (Crops<'a>, Option<Vec<f32>>);

impl AutoencoderRecord {
    fn network(&self, device: &Device) -> MotionVae {
        let width = self.features.recipe.width();
        MotionVae::new(&self.train.model, width, MAX_POSITIONS, device)
    }

    /// The loss: errors of features and joints, and the divergence of the latent vectors from the standard normal
    /// distribution.
    ///
    /// # Source
    /// Chen et al. 2023, Eq. 2 with the released weights; joints past the end of a motion are left out
    /// here.
    fn loss(
        &self,
        model: &MotionVae,
        (crops, noise): &NoisyCrops<'_>,
        device: &Device,
        pass: &Pass,
    ) -> Tensor<1> {
        let (config, stats) = (&self.train, &self.features);
        let features = crops.tensor(device);
        let encoded = model.encode(features.clone(), &crops.lengths, pass);
        let latent = match noise {
            Some(noise) => {
                let shape = encoded.mu.dims();
                encoded.sample(send(noise.clone(), shape, device))
            }
            None => encoded.mu.clone(),
        };
        let decoded = model.decode(latent, &crops.lengths, crops.frames, pass);
        let kl = encoded.kl(&encoded.standard());
        let mut loss = Loss::SmoothL1.mean(decoded.clone(), features.clone())
            + kl.mul_scalar(config.kl_weight);
        if config.joints_weight > 0.0 {
            let column = |values: &[f32]| -> Tensor<3> {
                send(values.to_vec(), [1, 1, values.len()], device)
            };
            let (mean, std) = (column(&stats.mean), column(&stats.std));
            let valid = crops.valid(device);
            let joints = |features: Tensor<3>| {
                recovered_joints(features * std.clone() + mean.clone()) * valid.clone()
            };
            let error = Loss::SmoothL1.mean(joints(decoded), joints(features));
            loss = loss + error.mul_scalar(config.joints_weight);
        }
        loss
    }
}

/// Standard normal noise for the latent vectors of the samples starting at `first`, `[count, width]`. It depends only
/// on the seed and the sample's index.
pub(super) fn latent_noise(seed: Seed, first: u64, count: usize, width: usize) -> Vec<f32> {
    (first..first + count as u64)
        .flat_map(|sample| normal(&mut seed.rng(&["latent", &sample.to_string()]), width))
        .collect()
}

/// A trained autoencoder.
#[derive(Debug)]
pub(super) struct Autoencoder {
    pub(super) network: MotionVae,
    pub(super) stats: FeatureStats,
    /// Maximum length of training crops, in frames.
    pub(super) max_frames: usize,
    pub(super) hash: String,
}

impl Autoencoder {
    /// Loads the autoencoder of a generator. `run` is the run folder of `stance train mld`.
    pub(super) fn load(run: &Path, device: &Device) -> Result<Self, Error> {
        let dir = folder(run);
        let mut opened = open_for_use::<AutoencoderRecord>(&dir, Slot::Best, KIND)?;
        let record = opened.record.config;
        record.train.check()?;
        let mut network = record.network(device);
        network.take_files(&mut opened.files, &dir)?;
        Ok(Self {
            network,
            max_frames: record.train.max_frames,
            stats: record.features,
            hash: opened.hash,
        })
    }

    /// The latent vectors of crops, sampled from their distributions with the given noise.
    ///
    /// # Shapes
    /// `noise` `[B, d]`, row by row; the result `[B, d]` on the device of the session.
    pub(super) fn latents(
        &self,
        crops: &Crops<'_>,
        noise: &[f32],
        session: &Session<'_>,
    ) -> Tensor<2> {
        let device = session.device;
        let pass = Pass::new(session.arithmetic);
        let motions = crops.tensor(device);
        let encoded = self.network.encode(motions, &crops.lengths, &pass);
        encoded.sample(send(noise.to_vec(), encoded.mu.dims(), device))
    }
}
