//! Training of TMED on a dataset.

use compose::{COMPOSED, ComposeConfig, library, train_stream};
use datasets_spec::record::{MotionRow, PairRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Seed, Split};

use super::clips::{CapturedPairs, ClipSource};
use super::config::{ClipData, TmedConfig};
use super::edit;
use super::task::{KIND, TmedCorpus, train_tmed};
use crate::compose::ComposeRecord;
use crate::config::{TrainConfig, ensure};
use crate::kind::{Input, ModelKind, TrainRequest, Trained, document};
use crate::stage::validation_stream;
use crate::{Error, Session};

pub(crate) const MODEL: ModelKind = ModelKind {
    name: KIND,
    about: "TMED, a diffusion over whole motions, on composed clips or on captured pairs",
    uses: &[
        Input::Compose,
        Input::TextEncoder,
        Input::Length,
        Input::Memory,
    ],
    preset: |preset| document(&TmedConfig::preset(preset)),
    train,
    open: Some(edit::EDITING),
};

/// Trains TMED as requested, or continues its run. Its settings select the composer's whole clips or the captured pairs
/// of the dataset.
fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&TmedConfig::preset(request.preset))?;
    request.change(&mut config.run);
    // Tokens: step, text, source, separator and target.
    let tokens = 2 + config.text.words.max_words + 2 * config.max_frames;
    request.split(&mut config.run, &config.model, tokens);
    // Check the settings before the slow encoding of texts.
    config.check()?;
    let is_composed_as_preset = *request.compose == TrainConfig::compose_preset(request.preset);
    ensure(
        config.data == ClipData::Composed || is_composed_as_preset,
        "data",
        "it is pairs, for which settings of the composer have no effect; leave them out, or set it to composed",
    )?;
    let (dataset, run) = (request.dataset, request.start.run);
    let skeleton = dataset.skeleton()?;
    let seed = Seed(config.run.seed);
    let record = ComposeRecord {
        config: request.compose.clone(),
        seed,
    };
    let ([(train, texts), (val, val_texts)], num_short, tables) = match config.data {
        ClipData::Pairs => {
            let splits = [
                captured(dataset, Split::Train)?,
                captured(dataset, Split::Val)?,
            ];
            (splits, 0, &[MotionRow::TABLE, PairRow::TABLE][..])
        }
        ClipData::Composed => {
            let (splits, num_short) = composed(dataset, request.compose, seed)?;
            (splits, num_short, &COMPOSED[..])
        }
    };
    let dataset_hash = dataset.content_hash(tables);
    let all = [texts.as_slice(), &val_texts, &[String::new()]].concat();
    let encoder = request.text_encoder;
    let known = request.start.known().unwrap_or(run);
    let vectors = encoder.token_embeddings(known, &all, &config.text, session)?;
    let corpus = TmedCorpus {
        train: &*train,
        val: &*val,
        instructions: &texts,
        vectors: vectors.as_ref(),
        skeleton: &skeleton,
        dataset_hash: &dataset_hash,
        compose: (config.data == ClipData::Composed).then_some(&record),
    };
    let report = train_tmed(request.start, &config, corpus, session)?;
    Ok(Trained::from_report(report.without(num_short), run))
}

type Clips = (Box<dyn ClipSource>, Vec<String>);

fn captured(dataset: &Dataset, split: Split) -> Result<Clips, Error> {
    let library = library(dataset, split)?;
    let problem = format!("it is pairs, and the {split} split has none; set it to composed");
    ensure(library.num_pairs() > 0, "data", problem)?;
    let texts = (0..library.num_pairs()).map(|pair| library.instruction_of_pair(pair).to_owned());
    let texts = texts.collect();
    Ok((Box::new(CapturedPairs(library)), texts))
}

/// The composer's whole clips of the training and the validation split, and the number of masks and pairs of the training
/// split that are too short.
fn composed(
    dataset: &Dataset,
    compose: &ComposeConfig,
    seed: Seed,
) -> Result<([Clips; 2], u64), Error> {
    let (train, normalizer) = train_stream(dataset, compose, seed, None)?;
    let val = validation_stream(dataset, compose, seed, &normalizer)?;
    let num_short = train.num_short() as u64;
    let clips = [train, val].map(|stream| -> Clips {
        let texts = stream.instructions();
        (Box::new(stream), texts)
    });
    Ok((clips, num_short))
}
