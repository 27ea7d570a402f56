//! Training of the editor.

use burn::tensor::Device;
use datasets_spec::{Seed, Skeleton};
use kinematics::normalise::Normalizer;
use serde::{Deserialize, Serialize};

use crate::checkpoint::{Run, RunRecord, Start};
use crate::compose::ComposeRecord;
use crate::config::{
    BertVectors, NoiseKind, TextConfig, TextEncoder, TrainConfig, check_windows, ensure,
};
use crate::data::{NoisyBatch, Texts, Timesteps, WindowSampler, WindowSource};
use crate::diffusion::Objective;
use crate::extrapolation::Extrapolation;
use crate::model::motionrefit::{MotionRefit, TextSource};
use crate::schedule::Schedule;
use crate::text::FrozenText;
use crate::text::source::keep_vectors;
use crate::text::table::EmbeddingTable;
pub use crate::trainer::TrainReport;
use crate::trainer::{Task, train};
use crate::vocabulary::Vocabulary;
use crate::{Error, Session};

pub(crate) const KIND: &str = "motionrefit";

/// Number of windows to which the linear prediction is fitted. Each gives 84 samples, one for each coordinate.
const EXTRAPOLATED_WINDOWS: usize = 4_096;

/// Training data of the editor.
#[derive(Clone, Copy)]
pub struct Corpus<'a> {
    /// Training windows.
    pub train: &'a dyn WindowSource,
    /// Validation windows.
    pub val: &'a dyn WindowSource,
    /// Instructions of the training split; their words are the vocabulary of a learned encoder.
    pub instructions: &'a [String],
    /// Vectors of the instructions of both splits, from a frozen encoder.
    pub vectors: Option<&'a EmbeddingTable>,
    /// Normaliser with which the windows were scaled.
    pub normalizer: Normalizer,
    /// The skeleton of the motions.
    pub skeleton: &'a Skeleton,
    /// Hash of the tables that the windows are composed from.
    pub dataset_hash: &'a str,
    /// Composition settings of the windows.
    pub compose: &'a ComposeRecord,
}

/// Record of an editor's run: its settings and the values fitted to the training split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditorRecord {
    /// The resolved settings.
    pub train: TrainConfig,
    /// Normaliser with which the windows are scaled.
    pub normalizer: Normalizer,
    /// Text encoder of the network.
    pub text: TextRecord,
    /// Composition settings of the windows.
    pub compose: ComposeRecord,
    /// Linear guess for predictions that are relative to it; none for other predictions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extrapolation: Option<Extrapolation>,
}

impl EditorRecord {
    /// Checks a record after reading.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.train.check()?;
        self.compose.check(self.train.window)?;
        let wanted =
            (self.train.diffusion.prediction.is_extrapolated()).then_some(self.train.window);
        ensure(
            self.extrapolation.as_ref().map(Extrapolation::window) == wanted,
            "extrapolation",
            "gated predictions are relative to one of the model's window, others to none",
        )?;
        let shape = self.extrapolation.as_ref().and_then(Extrapolation::shape);
        let is_shaped = self.train.diffusion.noise == NoiseKind::Shaped;
        ensure(
            shape.map_or(!is_shaped, |shape| {
                is_shaped && shape.fits(self.train.window)
            }),
            "extrapolation.shape",
            "shaped noise has one of the model's window, white noise none",
        )
    }

    pub(crate) fn network(&self, device: &Device) -> MotionRefit {
        let config = &self.train;
        MotionRefit::new(
            &config.model,
            &config.diffusion,
            self.text.source(),
            3 * config.keypoints,
            device,
        )
    }
}

/// Text encoder of a network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TextRecord {
    /// Vocabulary of the learned encoder.
    Learned(Vocabulary),
    /// The frozen encoder.
    Frozen {
        /// Identity of the encoder: the hash of its weights, or the name that a table gives it.
        encoder_hash: String,
        /// Width of its vectors.
        width: usize,
    },
}

impl TextRecord {
    /// The text encoder that the settings select: that of the run whose weights are taken over, otherwise one with the
    /// words of `texts`, or the encoder of `vectors`.
    pub(crate) fn chosen<'a>(
        config: &TextConfig,
        start: Start<'_>,
        known: Option<Self>,
        texts: impl IntoIterator<Item = &'a str>,
        vectors: Option<&EmbeddingTable>,
    ) -> Result<Self, Error> {
        let misfit = |problem| Error::config("text.encoder", problem);
        let is_learned = config.encoder == TextEncoder::Learned;
        match known {
            Some(text) if matches!(text, Self::Learned(_)) == is_learned => {
                if let Self::Learned(vocabulary) = &text {
                    vocabulary.check_kept("text.words", &config.words, start)?;
                }
                Ok(text)
            }
            Some(_) => Err(misfit(
                "it is not that of the run whose weights are to be taken over",
            )),
            None if is_learned => {
                let words = &config.words;
                let vocabulary = Vocabulary::build(texts, words.num_buckets, words.max_words)?;
                Ok(Self::Learned(vocabulary))
            }
            None => {
                let vectors = vectors.ok_or_else(|| {
                    misfit("it is a frozen one; name it with --text-encoder, or set it to learned")
                })?;
                Ok(Self::Frozen {
                    encoder_hash: vectors.encoder().to_owned(),
                    width: vectors.width(),
                })
            }
        }
    }

    /// Record of a frozen encoder.
    pub fn frozen(encoder: &impl FrozenText, vectors: BertVectors) -> Self {
        Self::Frozen {
            encoder_hash: encoder.identity(vectors),
            width: encoder.width(vectors),
        }
    }

    pub(crate) fn source(&self) -> TextSource {
        match self {
            Self::Learned(vocabulary) => TextSource::Learned(vocabulary.num_tokens()),
            Self::Frozen { width, .. } => TextSource::Frozen(*width),
        }
    }

    /// Selects how instructions are encoded for the network.
    pub(crate) fn texts<'a>(
        &'a self,
        vectors: Option<&'a EmbeddingTable>,
    ) -> Result<Texts<'a>, Error> {
        let (encoder_hash, width) = match self {
            Self::Learned(vocabulary) => return Ok(Texts::Words(vocabulary)),
            Self::Frozen {
                encoder_hash,
                width,
            } => (encoder_hash, width),
        };
        let Some(vectors) = vectors else {
            return Err(Error::misfit(
                "no text encoder",
                "it uses a frozen one; name it with --text-encoder",
            ));
        };
        if vectors.encoder() != encoder_hash || vectors.width() != *width {
            let given = vectors.encoder();
            let problem =
                format!("it is {given:.12}, the model was trained with {encoder_hash:.12}");
            return Err(Error::misfit("the text encoder", problem));
        }
        Ok(Texts::Vectors(vectors))
    }
}

/// Trains the editor, or continues the training of the run folder.
///
/// An interrupted run continues exactly: weights, optimiser, data, noise and learning rate are those of an
/// uninterrupted run. A run that starts from another run's weights keeps that run's vocabulary and extrapolation.
///
/// # Errors
/// The settings are unusable, the folder holds another run or a damaged checkpoint, the source of
/// windows fails, a loss is not finite, or a file cannot be written.
pub fn train_motionrefit<'a>(
    start: impl Into<Start<'a>>,
    config: &TrainConfig,
    corpus: Corpus<'_>,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    config.check()?;
    corpus.compose.check(config.window)?;
    for source in [corpus.train, corpus.val] {
        check_windows(config.window, source.window_len())?;
    }
    let start = start.into();
    let fitted: Option<EditorRecord> = start.fitted(KIND)?;
    let (known_text, known_extrapolation) = fitted
        .map(|known| (known.text, known.extrapolation))
        .unzip();
    let instructions = corpus.instructions.iter().map(String::as_str);
    let vectors = corpus.vectors;
    let text = TextRecord::chosen(&config.text, start, known_text, instructions, vectors)?;
    let seed = Seed(config.run.seed);
    let schedule = Schedule::new(config.diffusion.schedule, config.diffusion.num_steps)?;
    let sampler = WindowSampler {
        source: corpus.train,
        keypoints: config.keypoints,
        texts: text.texts(corpus.vectors)?,
        seed: seed.derive(&["train"]),
        num_timesteps: schedule.len(),
        timesteps: Timesteps::Random,
        text_dropout: config.diffusion.text_dropout,
        generated_starts: config.diffusion.generated_starts,
        fixed_noise: config.diffusion.fixed_noise,
        shape: None,
    };
    let extrapolation = chosen_extrapolation(config, known_extrapolation.flatten(), &sampler)?;
    let sampler = WindowSampler {
        shape: extrapolation.as_ref().and_then(Extrapolation::shape),
        ..sampler
    };
    let val_sampler = WindowSampler {
        source: corpus.val,
        seed: seed.derive(&["val"]),
        timesteps: Timesteps::Spread(config.val_windows),
        text_dropout: 0.0,
        ..sampler
    };
    let record = EditorRecord {
        train: config.clone(),
        normalizer: corpus.normalizer,
        text: text.clone(),
        compose: corpus.compose.clone(),
        extrapolation: extrapolation.clone(),
    };
    record.check()?;
    let document = RunRecord::new(KIND, corpus.dataset_hash, corpus.skeleton, record.clone())
        .trained_in(session);
    let run = Run::open(start, &document)?;
    keep_vectors(corpus.vectors, run.dir())?;
    let objective = Objective {
        schedule: &schedule,
        extrapolation: record.extrapolation.as_ref(),
        config: &config.diffusion,
        normalizer: &record.normalizer,
        fps: record.compose.config.fps,
    };
    let training = |first, count| sampler.draw(first, count);
    let validation = |first, count| val_sampler.draw(first, count);
    let task = Task::<MotionRefit, NoisyBatch> {
        kind: KIND,
        samples: "windows",
        run: config.run,
        of_thread: Some(16),
        epoch_len: corpus.train.epoch_len(),
        network: &|device| record.network(device),
        draw: &config.run.batches(training),
        loss: &|model, batch, device, pass| model.loss(&objective, batch, device, pass),
        validation: config.run.validation(config.val_windows, validation)?,
    };
    train(&task, &run, session)
}

/// The extrapolation of the run whose weights are taken over, otherwise one fitted to the first windows of `sampler`.
/// None if the prediction is not relative to an extrapolation.
fn chosen_extrapolation(
    config: &TrainConfig,
    known: Option<Extrapolation>,
    sampler: &WindowSampler<'_>,
) -> Result<Option<Extrapolation>, Error> {
    if !config.diffusion.prediction.is_extrapolated() {
        return Ok(None);
    }
    if known.is_some() {
        return Ok(known);
    }
    let windows = sampler.windows(0, EXTRAPOLATED_WINDOWS)?;
    Ok(Some(Extrapolation::fit(
        &windows.original,
        &windows.edited,
        config.window,
        config.diffusion.fixed_noise,
        config.diffusion.noise,
    )))
}
