//! Inference with a trained MLD: generates motions from captions, and variants of them.

use std::path::Path;

use burn::tensor::{Device, Tensor};
use datasets_spec::Seed;
use features::humanml3d::Features;
use serde::{Deserialize, Serialize};

use super::autoencoder::Autoencoder;
use super::diffusion::MldRecord;
use super::{CLIP, KIND};
use crate::checkpoint::{Slot, open_for_use};
use crate::config::TextEncoder;
use crate::ddim::Ddim;
use crate::diffusion::guide;
use crate::model::conditioned::Conditioned;
use crate::model::mld::LatentDenoiser;
use crate::model::pass::Pass;
use crate::model::weights::Networks;
use crate::sample::noise::normal;
use crate::schedule::Schedule;
use crate::text::source::TextEncoderSource;
use crate::text::table::EmbeddingTable;
use crate::transfer::{read, send};
use crate::{Error, Session};

/// A motion to generate variants of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Base {
    /// Id of the base motion. Together with the seed it determines the noise.
    pub id: String,
    /// Caption of the base motion.
    pub text: String,
    /// Length in frames at 20 fps.
    pub frames: usize,
}

/// Standard deviation of the noise that distinguishes the latent vectors of variants.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LatentNoise {
    /// In units of the latent space, as published.
    Absolute(f64),
    /// In standard deviations of the motions' latent vectors, because the autoencoder's training only weakly enforces
    /// the standard normal distribution.
    Relative(f64),
}

/// A trained generator of motions from captions.
#[derive(Debug)]
pub struct Generator {
    model: Conditioned<LatentDenoiser>,
    autoencoder: Autoencoder,
    record: MldRecord,
    ddim: Ddim,
    vectors: Option<EmbeddingTable>,
    hash: String,
    device: Device,
}

impl Generator {
    /// Loads a generator from its run folder.
    ///
    /// # Errors
    /// The folder is not a run of MLD, its autoencoder is not the one that the diffusion was trained with, or a
    /// checkpoint is missing or damaged.
    pub fn load(run: &Path, device: &Device) -> Result<Self, Error> {
        let mut opened = open_for_use::<MldRecord>(run, Slot::Best, KIND)?;
        let record = opened.record.config;
        record.train.check()?;
        let autoencoder = Autoencoder::load(run, device)?;
        if autoencoder.hash != record.autoencoder {
            return Err(Error::misfit(
                "the autoencoder",
                "it was trained again after the diffusion of its latent vectors; train MLD \
                          into another folder",
            ));
        }
        let mut model = record.network(device);
        model.take_files(&mut opened.files, run)?;
        let schedule = Schedule::scaled_linear(record.train.diffusion_steps)?;
        Ok(Self {
            ddim: Ddim::new(schedule, record.train.sampling_steps)?,
            model,
            autoencoder,
            record,
            vectors: None,
            hash: opened.hash,
            device: device.clone(),
        })
    }

    /// Hash of the weights of both networks: BLAKE3, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    pub(crate) fn text_encoder(&self) -> TextEncoder {
        self.record.train.text.encoder
    }

    /// Standard deviation of the latent vectors of the training motions.
    pub fn latent_std(&self) -> f32 {
        self.record.latent_std
    }

    /// Minimum and maximum length of the training motions in frames.
    pub fn frames(&self) -> [usize; 2] {
        let config = &self.record.train.autoencoder;
        [config.min_frames, config.max_frames]
    }

    /// Prepares the generator for texts. Must be called before [`Generator::variants`].
    ///
    /// # Errors
    /// The text encoder is missing or cannot encode a text.
    pub fn prepare(
        &mut self,
        run: &Path,
        texts: &[String],
        source: &TextEncoderSource,
        session: &Session<'_>,
    ) -> Result<(), Error> {
        let texts = [texts, &[String::new()]].concat();
        let encoder = (self.record.train.text.encoder, CLIP);
        self.vectors = source.embeddings(run, &texts, encoder, session)?;
        self.record.text.texts(self.vectors.as_ref()).map(|_| ())
    }

    /// Features of `count` variants of each base motion. A latent vector is sampled for the text, and each variant adds
    /// its own noise to it. All variants of a base motion have its length.
    ///
    /// # Shapes
    /// `[bases][count][frames]`.
    ///
    /// # Errors
    /// A text has no vector, or the session is stopped.
    ///
    /// # Source
    /// MotionReFit, Sec. 4.1 and App. D.3.
    pub fn variants(
        &self,
        bases: &[Base],
        count: usize,
        noise: LatentNoise,
        seed: Seed,
        session: &Session<'_>,
    ) -> Result<Vec<Vec<Vec<Features>>>, Error> {
        let sigma = match noise {
            LatentNoise::Absolute(sigma) => sigma,
            LatentNoise::Relative(share) => share * f64::from(self.latent_std()),
        } as f32;
        let latents = self.latents(bases, seed, session)?;
        let width = self.record.train.model.width;
        bases
            .iter()
            .zip(latents.chunks_exact(width))
            .map(|(base, latent)| {
                session.go_on("generating")?;
                let values: Vec<f32> = (0..count)
                    .flat_map(|variant| {
                        let mut rng = seed.rng(&["variant", &base.id, &variant.to_string()]);
                        let moved = latent.iter().zip(normal(&mut rng, width));
                        moved
                            .map(|(value, noise)| value + sigma * noise)
                            .collect::<Vec<f32>>()
                    })
                    .collect();
                Ok(self.decoded(values, count, base.frames, session))
            })
            .collect()
    }

    /// Samples latent vectors for texts, row by row.
    fn latents(
        &self,
        bases: &[Base],
        seed: Seed,
        session: &Session<'_>,
    ) -> Result<Vec<f32>, Error> {
        let (rows, width) = (bases.len(), self.record.train.model.width);
        let start: Vec<f32> = bases
            .iter()
            .flat_map(|base| normal(&mut seed.rng(&["base", &base.id]), width))
            .collect();
        let start = send(start, [rows, width], &self.device);
        let texts = self.record.text.texts(self.vectors.as_ref())?;
        let none = std::iter::repeat_n("", rows);
        let texts = texts.batch(bases.iter().map(|base| base.text.as_str()).chain(none))?;
        let text = self.model.text_vectors(&texts, 2 * rows, &self.device);
        let pass = Pass::new(session.arithmetic);
        let latents = self.ddim.sample(start, |z, timestep| {
            session.go_on("generating")?;
            let both = Tensor::cat(vec![z.clone(), z.clone()], 0);
            let timesteps = vec![timestep; 2 * rows];
            let network = &self.model.network;
            let both = network.forward(both, &timesteps, text.clone(), &pass);
            let half = |index: usize| both.clone().narrow(0, index * rows, rows);
            Ok(guide(half(0), half(1), self.record.train.guidance))
        })?;
        Ok(read(latents))
    }

    /// Decodes latent vectors to motions, all of the same length.
    fn decoded(
        &self,
        latents: Vec<f32>,
        rows: usize,
        frames: usize,
        session: &Session<'_>,
    ) -> Vec<Vec<Features>> {
        let latents = send(latents, [rows, self.record.train.model.width], &self.device);
        let network = &self.autoencoder.network;
        let pass = Pass::new(session.arithmetic);
        let values = read(network.decode(latents, &vec![frames; rows], frames, &pass));
        let restored = self.autoencoder.stats.restored(&values);
        let (features, _) = restored.as_chunks();
        features.chunks_exact(frames).map(<[_]>::to_vec).collect()
    }
}
