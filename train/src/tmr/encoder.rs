//! A trained evaluation encoder: it encodes motions and texts as vectors.

use std::ops::Range;
use std::path::Path;

use burn::tensor::{Device, Tensor};
use datasets_spec::Motion;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::clips::feature_rows;
use super::task::{KIND, TmrRecord};
use crate::Error;
use crate::checkpoint::{Files, MOTION_KIND, Opened, Slot, open_for_use, read_kind, record_of};
use crate::config::{BertVectors, NetworkConfig};
use crate::features::{FeatureRecipe, FeatureStats, Prepared};
use crate::model::pass::{Arithmetic, Pass};
use crate::model::tmr::{SequenceEncoder, Tmr};
use crate::model::weights::{Networks, load_network};
use crate::text::FrozenText;
use crate::text::bert::{BertEncoder, BertFiles};
use crate::transfer::{read, send};
use crate::vocabulary::{Vocabulary, padded_rows};

pub(crate) const MOTION_WEIGHTS: &str = "motion_encoder.safetensors";

/// Files of an imported text encoder: its weights, and the folder of the network whose states it reads.
pub(crate) const TEXT_WEIGHTS: &str = "text_encoder.safetensors";
pub(crate) const TEXT_FOLDER: &str = "text_encoder";

const ENCODE_BATCH: usize = 32;

/// Record of a motion encoder trained elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MotionEncoderRecord {
    pub(crate) model: NetworkConfig,
    pub(crate) features: FeatureStats,
    /// The text encoder, if it was imported too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) text: Option<ImportedText>,
}

/// Record of an imported text encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ImportedText {
    pub(crate) model: NetworkConfig,
    /// Identity of the frozen network whose states the encoder reads.
    pub(crate) encoder_hash: String,
    /// Width of a state.
    pub(crate) width: usize,
}

#[derive(Debug)]
enum TextEncoding {
    /// Word vectors trained with the motion encoder.
    Words(Box<(Tmr, Vocabulary)>),
    /// Last hidden states of a frozen network, as in the released TMR.
    States(Box<(SequenceEncoder, BertEncoder)>),
}

/// A trained evaluation encoder.
#[derive(Debug)]
pub struct TmrEncoder {
    motion_encoder: SequenceEncoder,
    texts: Option<TextEncoding>,
    features: FeatureStats,
    frame_stride: usize,
    /// Frames beyond this number are ignored.
    max_frames: usize,
    dataset_hash: String,
    hash: String,
    device: Device,
    arithmetic: Arithmetic,
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
        Self::of_run(open_for_use(run_dir, slot, KIND)?, run_dir, device)
    }

    /// Loads an encoder from its run's document `config.json` and its checkpoint's weights. `name` stands for the run
    /// folder in errors.
    ///
    /// # Errors
    /// The document is not the record of an encoder, or the weights do not match it.
    pub fn from_bytes(
        config: &str,
        weights: &[u8],
        name: &Path,
        device: &Device,
    ) -> Result<Self, Error> {
        let files = [(Tmr::FILE.to_owned(), weights.to_owned())].into();
        let opened = Opened::new(record_of(config, name, KIND)?, files);
        Self::of_run(opened, name, device)
    }

    fn of_run(opened: Opened<TmrRecord>, run_dir: &Path, device: &Device) -> Result<Self, Error> {
        let (record, hash, mut files) = (opened.record, opened.hash, opened.files);
        let config = &record.config.train;
        config.check()?;
        let mut model = config.network(&record.config.vocabulary, device);
        model.take_files(&mut files, run_dir)?;
        Ok(Self {
            motion_encoder: model.motion_encoder.clone(),
            frame_stride: config.frame_stride,
            max_frames: config.max_frames,
            texts: Some(TextEncoding::Words(Box::new((
                model,
                record.config.vocabulary,
            )))),
            features: record.config.features,
            dataset_hash: record.dataset_hash,
            hash,
            device: device.clone(),
            arithmetic: Arithmetic::default(),
        })
    }

    fn load_motion(run_dir: &Path, device: &Device) -> Result<Self, Error> {
        let opened = open_for_use::<MotionEncoderRecord>(run_dir, Slot::Best, MOTION_KIND)?;
        let (record, hash, mut files) = (opened.record, opened.hash, opened.files);
        let config = record.config;
        config.model.check()?;
        let texts = config
            .text
            .map(|text| load_texts(&text, &mut files, run_dir, device))
            .transpose()?;
        let width = config.features.recipe.width();
        let mut motion_encoder = SequenceEncoder::new(width, &config.model, device);
        load_network(&mut motion_encoder, &mut files, MOTION_WEIGHTS, run_dir)?;
        Ok(Self {
            motion_encoder,
            texts,
            features: config.features,
            frame_stride: 1,
            max_frames: usize::MAX,
            dataset_hash: record.dataset_hash,
            hash,
            device: device.clone(),
            arithmetic: Arithmetic::default(),
        })
    }

    /// Returns the encoder with other arithmetic.
    #[must_use]
    pub fn with_arithmetic(mut self, arithmetic: Arithmetic) -> Self {
        self.arithmetic = arithmetic;
        self
    }

    /// Features of the encoder, how much of a motion it reads, and its training data, in words.
    pub fn description(&self) -> String {
        let body = match self.recipe() {
            FeatureRecipe::HumanMl3d => " of the SMPL body",
            FeatureRecipe::Smpl135 | FeatureRecipe::MotionFix => "",
        };
        // The released encoders read whole motions.
        let read = match self.max_frames {
            usize::MAX => String::new(),
            frames => format!(" of the first {:.0} s", frames as f64 / self.fps()),
        };
        format!(
            "{}{body} at {} fps{read}, trained on dataset {:.12}",
            self.recipe().name(),
            self.fps(),
            self.dataset_hash
        )
    }

    /// Features that the encoder takes.
    pub fn recipe(&self) -> FeatureRecipe {
        self.features.recipe
    }

    /// Frame rate of the encoder's input, in frames per second.
    pub fn fps(&self) -> f64 {
        self.features.recipe.fps().get() / self.frame_stride as f64
    }

    /// Hash of the training motions; `imported` if not known.
    pub fn dataset_hash(&self) -> &str {
        &self.dataset_hash
    }

    /// Hash of the weights: BLAKE3, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// The mean latent vector of each motion, `[d]`. Of a longer motion, it is that of the first frames that the encoder
    /// reads.
    ///
    /// # Errors
    /// A motion cannot be resampled to the encoder's rate, or is too short for its features.
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
        let features = send(features, shape, &self.device);
        let pass = Pass::new(self.arithmetic);
        rows(self.motion_encoder.forward(features, lengths, &pass).mu)
    }

    /// The mean latent vector of each text, `[d]`.
    ///
    /// # Errors
    /// The encoder was imported without its text encoder, or a text cannot be tokenised.
    pub fn encode_texts(&self, texts: &[&str]) -> Result<Vec<Vec<f32>>, Error> {
        let Some(encoding) = &self.texts else {
            return Err(Error::encoder(
                "was imported without its text side and knows motions alone; import it with --text-encoder, the \
                 folder of DistilBERT",
            ));
        };
        let pass = Pass::new(self.arithmetic);
        let mut codes = Vec::with_capacity(texts.len());
        for chunk in texts.chunks(ENCODE_BATCH) {
            let latent = match encoding {
                TextEncoding::Words(words) => {
                    let (model, vocabulary) = &**words;
                    let tokens = vocabulary.encode_batch(chunk.iter().copied());
                    model.encode_text(&tokens, &pass)
                }
                TextEncoding::States(states) => {
                    let (network, encoder) = &**states;
                    let states = encoder.encode(chunk, BertVectors::States)?;
                    let (states, lengths) =
                        padded(&states, encoder.width(BertVectors::States), &self.device);
                    network.forward(states, &lengths, &pass)
                }
            };
            codes.extend(rows(latent.mu));
        }
        Ok(codes)
    }
}

fn load_texts(
    record: &ImportedText,
    files: &mut Files,
    run_dir: &Path,
    device: &Device,
) -> Result<TextEncoding, Error> {
    let folder = run_dir.join(TEXT_FOLDER);
    let encoder = BertEncoder::load(&BertFiles::in_folder(&folder)?, device)?;
    if encoder.identity(BertVectors::States) != record.encoder_hash {
        let detail = "it holds another text encoder than the one that was imported";
        return Err(Error::corrupt(&folder, detail));
    }
    let mut network = SequenceEncoder::new(record.width, &record.model, device);
    load_network(&mut network, files, TEXT_WEIGHTS, run_dir)?;
    Ok(TextEncoding::States(Box::new((network, encoder))))
}

/// States of texts as one array `[B, T, d]`, zero after the end of each text, and the number of tokens in each.
fn padded(states: &[Vec<f32>], width: usize, device: &Device) -> (Tensor<3>, Vec<usize>) {
    let (values, longest) = padded_rows(states.iter().map(Vec::as_slice), 0.0);
    let lengths = states.iter().map(|row| row.len() / width).collect();
    let shape = [states.len(), longest / width, width];
    (send(values, shape, device), lengths)
}

fn rows(tensor: Tensor<2>) -> Vec<Vec<f32>> {
    let [_, width] = tensor.dims();
    read(tensor)
        .chunks_exact(width)
        .map(<[f32]>::to_vec)
        .collect()
}
