//! Training of the diffusion of latent vectors.

use burn::tensor::{Device, Tensor};
use datasets_spec::Seed;
use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::KIND;
use super::autoencoder::{self, Autoencoder, latent_noise};
use super::config::MldConfig;
use crate::captioned::{CaptionedCorpus, CropSampler, Crops, captioned_rows};
use crate::checkpoint::{Run, RunRecord, Start, check_free};
use crate::data::{TextBatch, Texts};
use crate::features::Moments;
use crate::fit::TextRecord;
use crate::model::conditioned::Conditioned;
use crate::model::mld::{LatentDenoiser, MAX_POSITIONS};
use crate::model::pass::Pass;
use crate::sample::noise::normal;
use crate::schedule::Schedule;
use crate::text::source::keep_vectors;
use crate::trainer::{self, Task, TrainReport};
use crate::transfer::{read, send};
use crate::{Error, Session};

/// Record of a run of the latent diffusion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MldRecord {
    pub(crate) train: MldConfig,
    pub(crate) text: TextRecord,
    /// Hash of the autoencoder: BLAKE3, hexadecimal.
    pub(crate) autoencoder: String,
    /// Standard deviation of the latent vectors of the training split, over all their elements.
    pub(crate) latent_std: f32,
}

impl MldRecord {
    pub(super) fn network(&self, device: &Device) -> Conditioned<LatentDenoiser> {
        let config = &self.train.model;
        Conditioned::new(self.text.source(), config.width, device, |text_width| {
            LatentDenoiser::new(config, text_width, MAX_POSITIONS, device)
        })
    }
}

/// Trains the autoencoder and then the diffusion of its latent vectors, or continues the training of the run folder.
/// The autoencoder is a separate run in the subfolder `autoencoder`. Clips shorter than its `min_frames` are left out.
/// Returns the report of the part that was trained last.
///
/// # Errors
/// - The settings are unusable, or the text encoder is missing.
/// - A split has no clip that is long enough, or a clip has no caption.
/// - The folder holds another run, a dataset or a damaged checkpoint, another process writes to it, or a file cannot be
///   written.
/// - `start` asks to extend a run or to start from another run's weights.
/// - A loss is not finite.
pub fn train_mld<'a>(
    start: impl Into<Start<'a>>,
    config: &MldConfig,
    corpus: CaptionedCorpus<'_>,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    config.check()?;
    let start = start.into();
    if start.extend || start.init.is_some() {
        return Err(Error::Refused(
            "MLD consists of two runs, and --extend and --init are for one; train it into a new folder without them"
                .to_owned(),
        ));
    }
    check_free(start.run)?;
    let min_frames = config.autoencoder.min_frames;
    let rows = |clips, what| captioned_rows(clips, corpus.skeleton, min_frames, what);
    let train = rows(corpus.train, "training split of MLD")?;
    let val = rows(corpus.val, "validation split of MLD")?;
    let autoencoder = &config.autoencoder;
    let report = autoencoder::train(start.run, autoencoder, [&train, &val], &corpus, session)?;
    let num_short = (corpus.train.len() - train.len()) as u64;
    if !report.is_complete {
        return Ok(report.without(num_short));
    }
    let autoencoder = Autoencoder::load(start.run, session.device)?;
    let seed = Seed(config.run.seed);
    let sampler = |clips, name| CropSampler {
        clips,
        stats: &autoencoder.stats,
        max_frames: autoencoder.max_frames,
        pads_to_max: false,
        seed: seed.derive(&[name]),
    };
    // Another device gives other last digits, so a resumed run keeps the value that it began with.
    let known = start.fitted::<MldRecord>(KIND)?;
    let latent_std = match known.filter(|known| known.autoencoder == autoencoder.hash) {
        Some(known) => known.latent_std,
        None => latent_std(&autoencoder, &sampler(&train, "std"), config, session),
    };
    let texts = corpus.captions();
    let record = MldRecord {
        train: config.clone(),
        text: TextRecord::chosen(&config.text, start, None, texts, corpus.vectors)?,
        autoencoder: autoencoder.hash.clone(),
        latent_std,
    };
    let document = RunRecord::new(KIND, corpus.dataset_hash, corpus.skeleton, record.clone())
        .trained_in(session);
    let run = Run::open(start, &document)?;
    keep_vectors(corpus.vectors, run.dir())?;
    let noising = Noising {
        record: &record,
        autoencoder: &autoencoder,
        session,
        schedule: Schedule::scaled_linear(config.diffusion_steps)?,
        texts: record.text.texts(corpus.vectors)?,
    };
    let (held_out, sampler) = (sampler(&val, "val"), sampler(&train, "train"));
    let val_batches = held_out.validation(config.run.micro_batch(), config.diffusion_steps);
    let val_batches = val_batches.map(|(first, timesteps, crops)| {
        let batch = noising.noisy(&crops, held_out.seed, first, 0.0)?;
        Ok((timesteps.len(), LatentBatch { timesteps, ..batch }))
    });
    let task = Task::<Conditioned<LatentDenoiser>, LatentBatch> {
        kind: KIND,
        samples: "motions",
        run: config.run,
        of_thread: Some(64),
        epoch_len: train.len() as u64,
        network: &|device| record.network(device),
        draw: &config.run.batches(|first, count| {
            let crops = sampler.draw(first, count);
            noising.noisy(&crops, sampler.seed, first, config.text_dropout)
        }),
        loss: &|model, batch, device, pass| noising.loss(model, batch, device, pass),
        validation: val_batches.collect::<Result<_, Error>>()?,
    };
    Ok(trainer::train(&task, &run, session)?.without(num_short))
}

/// The standard deviation of the latent vectors of clips: the square root of the mean variance of their elements.
fn latent_std(
    autoencoder: &Autoencoder,
    sampler: &CropSampler<'_>,
    config: &MldConfig,
    session: &Session<'_>,
) -> f32 {
    let width = config.model.width;
    let (mut first, mut moments) = (0, Moments::none(width));
    for crops in sampler.whole(config.run.micro_batch()) {
        let rows = crops.lengths.len();
        let noise = latent_noise(sampler.seed, first, rows, width);
        let latents = read(autoencoder.latents(&crops, &noise, session));
        moments = moments.merge(&Moments::of(width, latents.chunks_exact(width)));
        first += rows as u64;
    }
    let variances = moments.deviations().map(|std| std.powi(2));
    (variances.sum::<f64>() / width as f64).sqrt() as f32
}

/// Latent vectors of motions with their captions, and all random draws of a training step.
struct LatentBatch {
    /// `[B, d]`
    latents: Vec<f32>,
    /// Standard normal noise, `[B, d]`.
    noise: Vec<f32>,
    /// Diffusion steps, `[B]`.
    timesteps: Vec<usize>,
    texts: TextBatch,
}

/// Adds diffusion noise to latent vectors and computes the loss.
struct Noising<'a> {
    record: &'a MldRecord,
    autoencoder: &'a Autoencoder,
    /// Device and arithmetic of the autoencoder.
    session: &'a Session<'a>,
    schedule: Schedule,
    texts: Texts<'a>,
}

impl Noising<'_> {
    /// Draws latent vectors, noise, diffusion steps and dropped captions of crops. The first crop is sample `first` of
    /// the run.
    fn noisy(
        &self,
        crops: &Crops<'_>,
        seed: Seed,
        first: u64,
        text_dropout: f64,
    ) -> Result<LatentBatch, Error> {
        let (count, width) = (crops.lengths.len(), self.record.train.model.width);
        let spread = latent_noise(seed, first, count, width);
        let latents = self.autoencoder.latents(crops, &spread, self.session);
        let mut noise = Vec::with_capacity(count * width);
        let (mut timesteps, mut captions) = (Vec::new(), Vec::new());
        for (index, &caption) in crops.captions.iter().enumerate() {
            let sample = first + index as u64;
            let mut rng = seed.rng(&["noise", &sample.to_string()]);
            timesteps.push(rng.random_range(0..self.schedule.len()));
            let is_dropped = rng.random_bool(text_dropout);
            captions.push(if is_dropped { "" } else { caption });
            noise.extend(normal(&mut rng, width));
        }
        Ok(LatentBatch {
            latents: read(latents),
            noise,
            timesteps,
            texts: self.texts.batch(captions.into_iter())?,
        })
    }

    /// The loss: the squared error of the predicted noise.
    ///
    /// # Source
    /// Chen et al. 2023, Eq. 4.
    fn loss(
        &self,
        model: &Conditioned<LatentDenoiser>,
        batch: &LatentBatch,
        device: &Device,
        pass: &Pass,
    ) -> Tensor<1> {
        let rows = batch.timesteps.len();
        let latents = |values: &[f32]| -> Tensor<3> {
            let shape = [rows, 1, values.len() / rows];
            send(values.to_vec(), shape, device)
        };
        let noise = latents(&batch.noise);
        let z_t = self
            .schedule
            .q_sample(latents(&batch.latents), &batch.timesteps, noise.clone());
        let text = model.text_vectors(&batch.texts, rows, device);
        let flat = |x: Tensor<3>| x.squeeze_dim::<2>(1);
        let predicted = model
            .network
            .forward(flat(z_t), &batch.timesteps, text, pass);
        (predicted - flat(noise)).square().mean()
    }
}
