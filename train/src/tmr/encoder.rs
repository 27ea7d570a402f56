//! A trained evaluation encoder: motions and texts to vectors.

use std::ops::Range;
use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use datasets_spec::Motion;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::clips::feature_rows;
use super::task::{KIND, TmrRecord, WEIGHTS, load};
use crate::Error;
use crate::checkpoint::{
    self, Files, MOTION_KIND, RunRecord, Slot, read_for_use, read_kind, take, weights_hash,
};
use crate::config::NetworkConfig;
use crate::features::{FeatureRecipe, FeatureStats, Prepared};
use crate::model::tmr::{SequenceEncoder, Tmr};
use crate::model::weights::from_safetensors;
use crate::transfer::read;
use crate::vocabulary::Vocabulary;

/// Weights of a motion encoder trained elsewhere.
pub(crate) const MOTION_WEIGHTS: &str = "motion_encoder.safetensors";

/// Motions or texts encoded at a time.
const ENCODE_BATCH: usize = 32;

/// Record of a motion encoder trained elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionEncoderRecord {
    /// Size of the transformer.
    pub model: NetworkConfig,
    /// Features of a motion, and their normaliser.
    pub features: FeatureStats,
}

/// A trained encoder.
#[derive(Debug)]
pub struct TmrEncoder {
    motion_encoder: SequenceEncoder,
    /// The text encoder, if there is one.
    texts: Option<(Tmr, Vocabulary)>,
    features: FeatureStats,
    frame_stride: usize,
    /// Frames beyond this number are ignored.
    max_frames: usize,
    dataset_hash: String,
    hash: String,
    device: Device,
}

impl TmrEncoder {
    /// Loads an encoder from its run folder.
    ///
    /// # Errors
    /// The folder is not a run of the encoder, or its checkpoint is missing or damaged.
    pub fn load(run_dir: &Path, slot: Slot, device: &Device) -> Result<Self, Error> {
        if read_kind(run_dir)? == MOTION_KIND {
            return Self::load_motion(run_dir, device);
        }
        let record = checkpoint::read_record(run_dir, KIND)?;
        Self::of_files(record, read_for_use(run_dir, slot, KIND)?, run_dir, device)
    }

    /// Loads an encoder from the document `config.json` of its run and the weights of its checkpoint. `name` stands for the
    /// run folder in errors.
    ///
    /// # Errors
    /// The document is not that of an encoder, or the weights do not fit it.
    pub fn from_bytes(
        config: &str,
        weights: &[u8],
        name: &Path,
        device: &Device,
    ) -> Result<Self, Error> {
        let files = [(WEIGHTS.to_owned(), weights.to_owned())].into();
        let record = checkpoint::record_of(config, name, KIND)?;
        Self::of_files(record, files, name, device)
    }

    fn of_files(
        record: RunRecord<TmrRecord>,
        mut files: Files,
        run_dir: &Path,
        device: &Device,
    ) -> Result<Self, Error> {
        let config = &record.config.train;
        config.check()?;
        let weights = files.get(WEIGHTS).map_or(&[][..], Vec::as_slice);
        let hash = weights_hash(&record.config, &[weights]);
        let sizes = config.sizes(&record.config.vocabulary);
        let mut model = Tmr::new(&sizes, device);
        load(&mut model, &mut files, run_dir)?;
        Ok(Self {
            motion_encoder: model.motion_encoder.clone(),
            frame_stride: config.frame_stride,
            max_frames: config.max_frames,
            texts: Some((model, record.config.vocabulary)),
            features: record.config.features,
            dataset_hash: record.dataset_hash,
            hash,
            device: device.clone(),
        })
    }

    fn load_motion(run_dir: &Path, device: &Device) -> Result<Self, Error> {
        let record: RunRecord<MotionEncoderRecord> = checkpoint::read_record(run_dir, MOTION_KIND)?;
        let MotionEncoderRecord { model, features } = record.config.clone();
        model.check()?;
        let mut files = read_for_use(run_dir, Slot::Best, MOTION_KIND)?;
        let bytes = take(&mut files, MOTION_WEIGHTS, run_dir)?;
        let hash = weights_hash(&record.config, &[&bytes]);
        let mut motion_encoder = SequenceEncoder::new(features.recipe.width(), &model, device);
        from_safetensors(
            &mut motion_encoder,
            bytes,
            "",
            &run_dir.join(MOTION_WEIGHTS),
        )?;
        Ok(Self {
            motion_encoder,
            texts: None,
            features,
            frame_stride: 1,
            max_frames: usize::MAX,
            dataset_hash: record.dataset_hash,
            hash,
            device: device.clone(),
        })
    }

    /// What it sees and was trained on, in words.
    pub fn description(&self) -> String {
        format!(
            "{} at {} fps, trained on dataset {:.12}",
            self.recipe().name(),
            self.fps(),
            self.dataset_hash
        )
    }

    /// Features that the encoder sees.
    pub fn recipe(&self) -> FeatureRecipe {
        self.features.recipe
    }

    /// Frames a second the encoder sees.
    pub fn fps(&self) -> f64 {
        self.features.recipe.fps().get() / self.frame_stride as f64
    }

    /// Hash of the motions it was trained on; `imported` where that is not known.
    pub fn dataset_hash(&self) -> &str {
        &self.dataset_hash
    }

    /// What identifies the weights: BLAKE3, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// The mean latent vector of each motion, `[d]`.
    ///
    /// # Errors
    /// A motion cannot be brought to the encoder's rate, or is too short for its features.
    pub fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f32>>, Error> {
        let mut codes = Vec::with_capacity(motions.len());
        for (chunk_index, chunk) in motions.chunks(ENCODE_BATCH).enumerate() {
            let clips: Vec<Prepared> = chunk
                .par_iter()
                .enumerate()
                .map(|(index, motion)| {
                    let id = format!("#{}", chunk_index * ENCODE_BATCH + index);
                    Prepared::new(motion, self.features.recipe, self.frame_stride, &id)
                })
                .collect::<Result<_, Error>>()?;
            let segments: Vec<(&Prepared, Range<usize>)> = clips
                .iter()
                .map(|clip| (clip, 0..clip.len().min(self.max_frames)))
                .collect();
            let (features, lengths, steps) = feature_rows(&segments, &self.features);
            codes.extend(self.encode_features(features, &lengths, steps));
        }
        Ok(codes)
    }

    /// The mean latent vectors of normalised features.
    ///
    /// # Shapes
    /// `features` is `[B, T, F]` with zeros after each row's length; the result `[B][d]`.
    ///
    /// # Panics
    /// If the sizes disagree.
    pub fn encode_features(
        &self,
        features: Vec<f32>,
        lengths: &[usize],
        steps: usize,
    ) -> Vec<Vec<f32>> {
        let shape = [lengths.len(), steps, self.features.recipe.width()];
        let features = Tensor::<3>::from_data(TensorData::new(features, shape), &self.device);
        rows(self.motion_encoder.forward(features, lengths).mu)
    }

    /// The mean latent vector of each text, `[d]`.
    ///
    /// # Errors
    /// The encoder was trained elsewhere, without its text encoder.
    pub fn encode_texts(&self, texts: &[&str]) -> Result<Vec<Vec<f32>>, Error> {
        let Some((model, vocabulary)) = &self.texts else {
            return Err(Error::Encoder {
                problem: "was imported and knows motions alone: the released text side stands on \
                          DistilBERT, which this program has not"
                    .to_owned(),
            });
        };
        Ok(texts
            .chunks(ENCODE_BATCH)
            .flat_map(|chunk| {
                rows(
                    model
                        .encode_text(&vocabulary.encode_batch(chunk.iter().copied()))
                        .mu,
                )
            })
            .collect())
    }
}

fn rows(tensor: Tensor<2>) -> Vec<Vec<f32>> {
    let [_, width] = tensor.dims();
    read(tensor)
        .chunks_exact(width)
        .map(<[f32]>::to_vec)
        .collect()
}
