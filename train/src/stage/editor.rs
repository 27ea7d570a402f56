//! Training of the MotionReFit editor on a dataset.

use std::path::Path;

use compose::recording::{is_recorded_from, settings_of};
use compose::{COMPOSED, ComposeConfig, ReadOrder, WindowLoader, library};
use datasets_spec::record::{NormalizerRow, WindowRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Seed, Split};
use kinematics::normalise::Normalizer;

use super::Streams;
use crate::checkpoint::{Start, differences};
use crate::compose::ComposeRecord;
use crate::config::TrainConfig;
use crate::edit;
use crate::error::json_error;
use crate::fit::{self, Corpus, train_motionrefit};
use crate::kind::{Input, ModelKind, TrainRequest, Trained, document};
use crate::text::clip::ClipModel;
use crate::text::source::TextEncoderSource;
use crate::trainer::TrainReport;
use crate::{Error, Session};

pub(crate) const MODEL: ModelKind = ModelKind {
    name: fit::KIND,
    about: "The MotionReFit editor, on triplets composed from motions and masks",
    uses: &[
        Input::Compose,
        Input::Windows,
        Input::TextEncoder,
        Input::Length,
        Input::Memory,
    ],
    preset: |preset| document(&TrainConfig::preset(preset)),
    train,
    open: Some(edit::EDITING),
};

/// Trains the editor on composed windows, or on those recorded in the folder `windows`, or continues its run. Recorded
/// windows state how they were composed, and `compose` is not used for them. `text_encoder` is the source of a frozen
/// text encoder, for settings that use one.
///
/// # Errors
/// As [`train_motionrefit`], or the dataset, recorded windows or the text encoder cannot be read, or windows do not state
/// how they were composed.
pub fn train_editor<'a>(
    dataset: &Dataset,
    start: impl Into<Start<'a>>,
    config: &TrainConfig,
    compose: &ComposeConfig,
    windows: Option<&Path>,
    text_encoder: &TextEncoderSource,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    // Check the settings before the slow encoding of texts.
    config.check()?;
    let start = start.into();
    let seed = config.run.seed;
    let windows = windows.map(|folder| recorded_windows(folder, dataset, config.window));
    let windows = windows.transpose()?;
    let compose = windows.as_ref().map_or(compose, |(_, made)| &made.config);
    let mut streams = Streams::open(dataset, compose, config.window, seed, start.range()?)?;
    let normalizer = &streams.normalizer;
    let recorded = match &windows {
        Some((windows, made)) => {
            streams.compose.seed = made.seed;
            let fitted = library(dataset, Split::Train)?.fit_normalizer(&made.config)?;
            Some(loader(windows, [&fitted, normalizer], Seed(seed))?)
        }
        None => None,
    };
    let windows = windows.as_ref().map(|(windows, _)| windows);
    let instructions = match &recorded {
        Some(loader) => loader.instructions().to_vec(),
        None => streams.train.instructions(),
    };
    let all = [instructions.clone(), streams.val.instructions()].concat();
    let encoder = (config.text.encoder, ClipModel::VitB32);
    let known = start.known().unwrap_or(start.run);
    let vectors = text_encoder.embeddings(known, &all, encoder, session)?;
    let corpus = Corpus {
        train: match &recorded {
            Some(loader) => loader,
            None => &streams.train,
        },
        val: &streams.val,
        instructions: &instructions,
        vectors: vectors.as_ref(),
        normalizer: *normalizer,
        skeleton: &dataset.skeleton()?,
        dataset_hash: &data_hash(dataset, windows),
        compose: &streams.compose,
    };
    let num_short = streams.train.num_short() as u64;
    Ok(train_motionrefit(start, config, corpus, session)?.without(num_short))
}

/// The composer's settings in which recorded windows differ from `compose`, in whose place they are used: names, with
/// both values where they are short. The length of a window is left out, because the network determines it. Empty if
/// the windows do not state their settings, which a training refuses.
///
/// # Errors
/// The windows cannot be opened, or another version wrote their settings.
pub fn settings_replaced_by(windows: &Path, compose: &ComposeConfig) -> Result<Vec<String>, Error> {
    let opened = Dataset::open_unverified(windows)?;
    let Some(made) = settings_of(&opened).map_err(json_error(windows))? else {
        return Ok(Vec::new());
    };
    let theirs = ComposeConfig {
        window: compose.window,
        ..made.config
    };
    let differences = differences(&document(compose), &document(&theirs)).into_iter();
    let mut names: Vec<String> = differences
        .map(|(name, [ours, theirs])| match name.split_once('.') {
            Some((section, _)) => section.to_owned(),
            None => format!("{name} {theirs} instead of {ours}"),
        })
        .collect();
    names.dedup();
    Ok(names)
}

fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&TrainConfig::preset(request.preset))?;
    request.change(&mut config.run);
    request.split(&mut config.run, &config.model, 1 + config.window);
    let report = train_editor(
        request.dataset,
        request.start,
        &config,
        request.compose,
        request.windows,
        request.text_encoder,
        session,
    )?;
    Ok(Trained::from_report(report, request.start.run))
}

/// Identifies the editor's training data: the tables that edits are composed from, and recorded windows, if any.
fn data_hash(dataset: &Dataset, windows: Option<&Dataset>) -> String {
    let composed = dataset.content_hash(&COMPOSED);
    let Some(windows) = windows else {
        return composed;
    };
    let recorded = windows.content_hash(&[WindowRow::TABLE]);
    let both = blake3::hash(format!("{composed} {recorded}").as_bytes());
    both.to_hex().to_string()
}

/// Recorded windows, and how they were composed. The network takes windows of `window` frames.
fn recorded_windows(
    folder: &Path,
    dataset: &Dataset,
    window: usize,
) -> Result<(Dataset, ComposeRecord), Error> {
    let windows = Dataset::open(folder)?;
    let Some(made) = settings_of(&windows).map_err(json_error(folder))? else {
        return Err(Error::Refused(format!(
            "{} does not state how windows were composed (version 0.2 and earlier left that out); record them again: \
             stance triplets DATASET --windows N --out FOLDER",
            folder.display()
        )));
    };
    if !is_recorded_from(&windows, &made, dataset)? {
        return Err(Error::Refused(format!(
            "the windows in {} were recorded from other motions, masks or pairs than {} has now; record them again: \
             stance triplets {} --windows N --out FOLDER",
            folder.display(),
            dataset.root().display(),
            dataset.root().display()
        )));
    }
    let made = ComposeRecord {
        config: made.config,
        seed: made.seed,
    };
    made.check(window)?;
    Ok((windows, made))
}

/// Opens recorded windows for training. Their normaliser must be the one fitted to the dataset, and that of the run.
fn loader(
    windows: &Dataset,
    [fitted, used]: [&Normalizer; 2],
    seed: Seed,
) -> Result<WindowLoader, Error> {
    let rows: Vec<NormalizerRow> = windows.read(None)?;
    let folder = windows.root().display();
    let misfit = |problem| Error::Refused(format!("the windows in {folder} {problem}"));
    if used.hash() != fitted.hash() {
        return Err(misfit(
            "use the normaliser of their dataset, and the run keeps that of the weights it begins \
             with; train it on composed windows, without --windows",
        ));
    }
    let hash = fitted.hash();
    if rows.iter().all(|row| row.id != hash) {
        return Err(misfit(
            "were recorded with another normaliser than the dataset's; record them again: \
             stance triplets DATASET --windows N --out FOLDER, with the --where that they were recorded with",
        ));
    }
    let order = ReadOrder::Shuffled(seed);
    Ok(WindowLoader::open(windows, Split::Train, order)?)
}
