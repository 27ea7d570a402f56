//! Training of TMED.

use burn::tensor::Device;
use datasets_spec::{Seed, Skeleton};
use serde::{Deserialize, Serialize};

use super::clips::{ClipBatch, ClipSampler, ClipSource, statistics};
use super::config::{ClipData, StatisticsSplits, TmedConfig};
use super::features::{FeatureStatistics, NUM_FEATURES};
use super::objective;
use crate::checkpoint::{Run, RunRecord, Start};
use crate::compose::ComposeRecord;
use crate::config::ensure;
use crate::data::Timesteps;
use crate::fit::TextRecord;
use crate::model::tmed::TmedModel;
use crate::schedule::Schedule;
use crate::text::source::keep_vectors;
use crate::text::table::EmbeddingTable;
use crate::trainer::{Task, TrainReport, train};
use crate::{Error, Session};

pub(crate) const KIND: &str = "tmed";

/// Training data of TMED.
#[derive(Clone, Copy)]
pub struct TmedCorpus<'a> {
    /// Training clips.
    pub train: &'a dyn ClipSource,
    /// Validation clips.
    pub val: &'a dyn ClipSource,
    /// Instructions of the training split; their words are the vocabulary of learned word vectors.
    pub instructions: &'a [String],
    /// Token vectors of the instructions of both splits and of the empty text, from a frozen encoder.
    pub vectors: Option<&'a EmbeddingTable>,
    /// The skeleton of the motions.
    pub skeleton: &'a Skeleton,
    /// Hash of the tables that the clips are made from.
    pub dataset_hash: &'a str,
    /// Composition settings of the clips; none for captured pairs.
    pub compose: Option<&'a ComposeRecord>,
}

/// Record of a run of TMED: its settings and the values fitted to the training split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TmedRecord {
    pub(crate) train: TmedConfig,
    pub(crate) statistics: FeatureStatistics,
    pub(crate) text: TextRecord,
    /// Composition settings of the clips; none for captured pairs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) compose: Option<ComposeRecord>,
}

impl TmedRecord {
    /// Checks a record after reading.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.train.check()?;
        self.statistics.check()
    }

    pub(crate) fn model(&self, device: &Device) -> TmedModel {
        TmedModel::new(&self.train.model, self.text.source(), NUM_FEATURES, device)
    }
}

/// Trains TMED, or continues the training of the run folder, exactly like an uninterrupted run.
///
/// # Errors
/// The settings are unusable, the folder holds another run or a damaged checkpoint, a motion cannot be resampled, a
/// loss is not finite, or a file cannot be written.
pub fn train_tmed<'a>(
    start: impl Into<Start<'a>>,
    config: &TmedConfig,
    corpus: TmedCorpus<'_>,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    config.check()?;
    ensure(
        corpus.compose.is_some() == (config.data == ClipData::Composed),
        "data",
        "composed clips come with the composer's settings, pairs with none",
    )?;
    let start = start.into();
    let fitted: Option<TmedRecord> = start.fitted(KIND)?;
    let (known_text, known_statistics) = fitted.map(|known| (known.text, known.statistics)).unzip();
    let statistics = match known_statistics {
        Some(known) => known,
        None => statistics_of(&corpus, config)?,
    };
    let instructions = corpus.instructions.iter().map(String::as_str);
    let vectors = corpus.vectors;
    let text = TextRecord::chosen(&config.text, start, known_text, instructions, vectors)?;
    let record = TmedRecord {
        train: config.clone(),
        statistics,
        text,
        compose: corpus.compose.cloned(),
    };
    let document = RunRecord::new(KIND, corpus.dataset_hash, corpus.skeleton, record.clone())
        .trained_in(session);
    let run = Run::open(start, &document)?;
    keep_vectors(corpus.vectors, run.dir())?;
    let seed = Seed(config.run.seed);
    let sampler = ClipSampler {
        source: corpus.train,
        config,
        statistics: &record.statistics,
        skeleton: corpus.skeleton,
        texts: record.text.texts(corpus.vectors)?,
        seed: seed.derive(&["train"]),
        timesteps: Timesteps::Random,
        hides: true,
    };
    let val_sampler = ClipSampler {
        source: corpus.val,
        seed: seed.derive(&["val"]),
        timesteps: Timesteps::Spread(config.val_clips),
        hides: false,
        ..sampler
    };
    let schedule = Schedule::cosine(config.diffusion.num_steps)?;
    let training = |first, count| sampler.draw(first, count);
    let validation = |first, count| val_sampler.draw(first, count);
    let task = Task::<TmedModel, ClipBatch> {
        kind: KIND,
        samples: "clips",
        run: config.run,
        // The loss is a mean over frames, not clips, and positions can depend on the longest source.
        of_thread: None,
        epoch_len: corpus.train.num_clips(),
        network: &|device| record.model(device),
        draw: &config.run.batches(training),
        loss: &|model, batch, device, pass| {
            objective::loss(model, batch, config, &schedule, device, pass)
        },
        validation: config.run.validation(config.val_clips, validation)?,
    };
    train(&task, &run, session)
}

fn statistics_of(corpus: &TmedCorpus<'_>, config: &TmedConfig) -> Result<FeatureStatistics, Error> {
    let both = [corpus.train, corpus.val];
    let sources = match config.statistics {
        StatisticsSplits::Train => &both[..1],
        StatisticsSplits::TrainAndVal => &both[..],
    };
    statistics(sources, config.fps, config.max_frames, corpus.skeleton)
}
