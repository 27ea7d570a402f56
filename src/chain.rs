//! The stages as the verbs, `stance run` and `stance demo` call them: open what the stage before
//! wrote, hand it to the library that does the work, commit what comes back.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock, Once};
use std::time::Instant;

use anyhow::{Context, bail};
use datasets_spec::dataset::{Commit, commit_made, commit_rows};
use datasets_spec::record::{
    EditRow, ItemRow, MaskRow, MotionRow, NormalizerRow, PairRow, ScoreRow, TripletRow, WindowRow,
};
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{
    Dataset, Fps, Motion, MotionId, Progress, Resample, Seed, Skeleton, Split, Transaction,
};
use eval::EncoderError;
use eval::compare::{Comparison, compare};
use eval::evaluators::{Evaluators, MotionClassifier, MotionEncoder};
use eval::linalg::Matrix;
use eval::metric::matching::{CrossRetrieval, cross_retrieval};
use eval::metric::retrieval::unit_rows;
use eval::protocol::Protocol;
use eval::times::WindowTimes;
use kinematics::canonical::{FIXED_FRAMES, WINDOW_FRAMES};
use kinematics::normalise::Normalizer;
use pipeline::catalogue::other_than_motions;
use pipeline::compose::{
    ComposeConfig, EditKind, ItemConfig, ItemCount, Library, ReadOrder, Stream, WindowLoader,
    draw_items,
};
use pipeline::ingest::{IngestOptions, IngestReport, ingest};
use pipeline::masks::{MaskConfig, automatic_masks};
use pipeline::pairs::{PairConfig, PairList, RefusedLine, is_from_labels, style_pairs};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use train::Session;
use train::checkpoint::{Slot, Start, check_skeleton};
use train::compose::ComposeRecord;
use train::config::{GuidanceConfig, Preset, TextEncoder, TrainConfig};
use train::coordinator::{self, CoordinatorConfig, Segments, TrainedCoordinator};
use train::edit::{self, Remarks, SystemIdentity};
use train::fit::{Corpus, TextRecord, TrainReport, train_motionrefit};
use train::j2s::{self, J2sConfig, J2sReport, PoseNet};
use train::sample::{EditSettings, EditTimes, Editor, FitMethod};
use train::text::clip::{ClipEncoder, ClipFiles, ClipModel};
use train::text::hub::HubCache;
use train::text::table::EmbeddingTable;
use train::tmr::{CaptionedMotion, TmrConfig, TmrCorpus, TmrEncoder, train_tmr};

use crate::cli::Global;
use crate::cmd::ingest as ingest_cmd;
use crate::device::{device, devices};
use crate::exit::Exit;
use crate::report;

/// Name of an editor in the `edits` table and the result table, where the user gives none: what it is,
/// and what of it differs from the preset.
fn system_name(editor: &Editor) -> String {
    let record = &editor.record().config;
    let (model, compose) = (record.train.model, &record.compose.config);
    let mut name = "MotionReFit".to_owned();
    if model == TrainConfig::preset(Preset::Tiny).model {
        name += " tiny";
    }
    let percent = |share: f64| format!("{:.3}", 100.0 * share);
    let percent = |share: f64| {
        let text = percent(share);
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    };
    if compose.fixed_pairs {
        name += ", w/o MCM";
    } else if compose.mcm_ratio < 1.0 {
        name += &format!(", {} % MCM", percent(compose.mcm_ratio));
    }
    if compose.annotated_ratio < 1.0 {
        name += &format!(", {} % annotated", percent(compose.annotated_ratio));
    }
    if compose.kinds != EditKind::ALL {
        let kinds: Vec<&str> = compose.kinds.iter().map(|kind| kind.as_str()).collect();
        name += &format!(", {} only", kinds.join(" and "));
    }
    if editor.has_coordinator() {
        name += " + coordinator";
    }
    name
}

/// The skeleton a dataset's motions drive.
pub(crate) fn skeleton_of(dataset: &Dataset) -> anyhow::Result<Skeleton> {
    Ok(dataset.skeleton()?)
}

/// A hash of whatever a stage depends on, as the plan of its table.
pub(crate) fn plan<T: Serialize>(stage: &str, inputs: &T) -> anyhow::Result<String> {
    let text = serde_json::to_string(&(stage, env!("CARGO_PKG_VERSION"), inputs))?;
    Ok(blake3::hash(text.as_bytes()).to_hex().to_string())
}

/// Tables that composed edits follow from.
const COMPOSED: [&str; 3] = [MotionRow::TABLE, MaskRow::TABLE, PairRow::TABLE];
/// Tables that what is learned of motions alone follows from.
const MOTIONS: [&str; 1] = [MotionRow::TABLE];

/// Hash of the plan that made a table, so that what depends on the table alone is not redone when
/// another table of the same dataset changes.
fn plan_of<'a>(dataset: &'a Dataset, table: &str) -> &'a str {
    dataset
        .manifest()
        .plans
        .get(table)
        .map_or("", String::as_str)
}

/// What becomes of masks that people have judged when automatic ones are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Judged {
    /// They stay, and the stage does nothing.
    Keep,
    /// The stage fails and says so.
    Refuse,
    /// They are discarded.
    Replace,
}

/// Derives the automatic masks of a dataset and commits them beside its motions.
pub(crate) fn masks(
    root: &Path,
    config: &MaskConfig,
    judged: Judged,
    global: &Global,
    progress: &dyn Progress,
) -> anyhow::Result<Dataset> {
    let dataset = open_motions(root)?;
    let plan_hash = plan("masks", &(plan_of(&dataset, MotionRow::TABLE), config))?;
    if plan_of(&dataset, MaskRow::TABLE) == plan_hash {
        return Ok(dataset);
    }
    let present: Vec<MaskRow> = dataset.read(None)?;
    let by_people = present
        .iter()
        .filter(|mask| mask.text_origin == "human")
        .count();
    match judged {
        Judged::Keep if by_people > 0 => return Ok(dataset),
        Judged::Refuse if by_people > 0 => bail!(
            "{} holds {by_people} masks judged by people, which automatic masks would replace; \
             pass --replace to discard them",
            root.display()
        ),
        Judged::Keep | Judged::Refuse | Judged::Replace => {}
    }
    let motions: Vec<MotionRow> = dataset.read(None)?;
    progress.begin("masks", Some(motions.len() as u64));
    let skeleton = skeleton_of(&dataset)?;
    let mut rows: Vec<MaskRow> = present
        .into_iter()
        .filter(|mask| mask.text_origin == "imported")
        .collect();
    // Where the source came with masks, nothing is guessed beside them.
    let imported: BTreeSet<MotionId> = rows.iter().map(|mask| mask.motion_id.clone()).collect();
    let automatic = automatic_masks(&motions, &skeleton, config)?;
    rows.extend(
        automatic
            .into_iter()
            .filter(|mask| !imported.contains(&mask.motion_id)),
    );
    progress.finish(&format!("{} masks on {} clips", rows.len(), motions.len()));
    let split_of = |row: &MaskRow| row.split;
    Ok(commit_rows(
        root,
        &rows,
        Some(split_of),
        &skeleton,
        &plan_hash,
        &global.holder(),
    )?)
}

/// How files become rows.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct IngestConfig {
    fps: Fps,
    resample: Resample,
    license: Option<String>,
}

impl Default for IngestConfig {
    fn default() -> Self {
        Self {
            fps: Fps::STORE,
            resample: Resample::Exact,
            license: None,
        }
    }
}

/// Ingests folders, or continues.
pub(crate) fn ingested(
    sources: &[PathBuf],
    root: &Path,
    config: &IngestConfig,
    seed: Seed,
    global: &Global,
    progress: &dyn Progress,
) -> anyhow::Result<IngestReport> {
    let options = IngestOptions {
        fps: Some(config.fps),
        resample: config.resample,
        license: config.license.clone(),
        seed,
        ..IngestOptions::default()
    };
    let done = ingest(sources, root, &options, &global.holder(), progress)?;
    if done.accounting.quarantined > 0 && !global.json {
        report::note(&ingest_cmd::summary(&done));
    } else {
        for remark in &done.remarks {
            report::note(&format!("note: {remark}"));
        }
    }
    Ok(done)
}

/// Makes style pairs from the labels of a dataset and commits them beside those that its sources
/// came with. Also gives the styled motions without a counterpart.
pub(crate) fn pairs(
    root: &Path,
    config: &PairConfig,
    global: &Global,
    progress: &dyn Progress,
) -> anyhow::Result<(Dataset, Vec<MotionId>)> {
    let dataset = open_motions(root)?;
    let inputs = (plan_of(&dataset, MotionRow::TABLE), config, global.seed());
    let plan_hash = plan(pipeline::pairs::SOURCE, &inputs)?;
    let motions: Vec<MotionRow> = dataset.read(None)?;
    let made = style_pairs(&motions, config, global.seed());
    if plan_of(&dataset, PairRow::TABLE) == plan_hash {
        return Ok((dataset, made.alone));
    }
    progress.begin("pairs", None);
    let mut rows: Vec<PairRow> = dataset.read(None)?;
    rows.retain(|row| !is_from_labels(row));
    rows.extend(made.rows);
    progress.finish(&format!("{} pairs", rows.len()));
    if rows.is_empty() && !dataset.manifest().tables.contains_key(PairRow::TABLE) {
        return Ok((dataset, made.alone));
    }
    let split_of = |row: &PairRow| row.split;
    let dataset = commit_rows(
        root,
        &rows,
        Some(split_of),
        &skeleton_of(&dataset)?,
        &plan_hash,
        &global.holder(),
    )?;
    Ok((dataset, made.alone))
}

/// Adds the style pairs of a list to those of a dataset, in place of earlier ones of a list with the
/// same motions. Also gives the lines that no pair was made of.
pub(crate) fn listed_pairs(
    root: &Path,
    file: &Path,
    global: &Global,
) -> anyhow::Result<(Dataset, Vec<RefusedLine>)> {
    let list = PairList::read(file)?;
    let dataset = open_motions(root)?;
    let mut motions = BTreeMap::new();
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let rows = read_rows::<MotionRow>(&path)?.into_iter();
        motions.extend(rows.map(|row| (row.id, row.split)));
    }
    let mut before: Vec<PairRow> = dataset.read(None)?;
    before.sort_by(|a, b| a.id.cmp(&b.id));
    let (listed, known): (Vec<PairRow>, Vec<PairRow>) = before
        .iter()
        .cloned()
        .partition(|row| row.source == pipeline::pairs::LISTED);
    let made = list.pairs(&motions, &known);
    let mut rows: BTreeMap<String, PairRow> = listed
        .into_iter()
        .chain(known)
        .map(|row| (row.id.clone(), row))
        .collect();
    rows.extend(made.rows.into_iter().map(|row| (row.id.clone(), row)));
    let rows: Vec<PairRow> = rows.into_values().collect();
    if rows == before {
        return Ok((dataset, made.refused));
    }
    let inputs = (plan_of(&dataset, PairRow::TABLE), &list.hash());
    let dataset = commit_rows(
        root,
        &rows,
        Some(|row: &PairRow| row.split),
        &skeleton_of(&dataset)?,
        &plan(pipeline::pairs::LISTED, &inputs)?,
        &global.holder(),
    )?;
    Ok((dataset, made.refused))
}

/// Opens a dataset for a verb that works on motions. A folder of something else is refused with
/// what it is and which verb takes it.
pub(crate) fn open_motions(root: &Path) -> anyhow::Result<Dataset> {
    let dataset = Dataset::open(root)?;
    if let Some(other) = other_than_motions(&dataset) {
        bail!("{} is {other}", root.display());
    }
    Ok(dataset)
}

/// The motions, masks and pairs of one split.
pub(crate) fn library(dataset: &Dataset, split: Split) -> anyhow::Result<Arc<Library>> {
    let masks: Vec<MaskRow> = dataset.read(Some(split))?;
    let pairs: Vec<PairRow> = dataset.read(Some(split))?;
    if masks.is_empty() && pairs.is_empty() {
        bail!(
            "{} has neither masks nor pairs in split {split}; run `stance masks {}` for semantic edits, \
             `stance pairs {}` for styles",
            dataset.root().display(),
            dataset.root().display(),
            dataset.root().display()
        );
    }
    let motions: Vec<MotionRow> = dataset.read(Some(split))?;
    let skeleton = skeleton_of(dataset)?;
    Ok(Arc::new(Library::new(
        split, &motions, &masks, &pairs, &skeleton,
    )?))
}

/// The composer's stream over the training split, and the range of its windows: the one given, or
/// else that fitted to them.
pub(crate) fn train_stream(
    dataset: &Dataset,
    config: &ComposeConfig,
    seed: Seed,
    range: Option<Normalizer>,
) -> anyhow::Result<(Stream, Normalizer)> {
    let library = library(dataset, Split::Train)?;
    let normalizer = match range {
        Some(range) => range,
        None => library.fit_normalizer(config)?,
    };
    let stream = Stream::new(library, config.clone(), seed, &normalizer)?;
    Ok((stream, normalizer))
}

/// Records whole-clip triplets of the training stream as a dataset of their own.
pub(crate) fn triplets(
    root: &Path,
    out: &Path,
    count: u64,
    config: &ComposeConfig,
    seed: Seed,
    global: &Global,
    progress: &dyn Progress,
) -> anyhow::Result<Dataset> {
    let dataset = Dataset::open(root)?;
    let (stream, _) = train_stream(&dataset, config, seed, None)?;
    let inputs = (dataset.content_hash(&COMPOSED), config, seed, count);
    let plan_hash = plan("triplets", &inputs)?;
    progress.begin("triplets", Some(count));
    let rows: Vec<TripletRow> = (0..count)
        .into_par_iter()
        .map(|number| {
            let (epoch, item) = (number / stream.epoch_len(), number % stream.epoch_len());
            let row = stream.triplet(epoch, item).to_row();
            progress.advance(1);
            row
        })
        .collect();
    progress.finish(&format!("{count} triplets composed"));
    let split_of = |row: &TripletRow| row.split;
    Ok(commit_rows(
        out,
        &rows,
        Some(split_of),
        &dataset.skeleton()?,
        &plan_hash,
        &global.holder(),
    )?)
}

/// Records windows of the training stream as a dataset of their own, with the range they are in.
pub(crate) fn windows(
    root: &Path,
    out: &Path,
    count: u64,
    config: &ComposeConfig,
    global: &Global,
    progress: &dyn Progress,
) -> anyhow::Result<Dataset> {
    let dataset = Dataset::open(root)?;
    let (stream, normalizer) = train_stream(&dataset, config, global.seed(), None)?;
    let inputs = (
        dataset.content_hash(&COMPOSED),
        config,
        global.seed(),
        count,
    );
    let plan_hash = plan("windows", &inputs)?;
    progress.begin("windows", Some(count));
    let skeleton = dataset.skeleton()?;
    let holder = global.holder();
    let make = |windows: Range<u64>| {
        let mut rows = Vec::new();
        stream.for_each_recorded(windows, |row: WindowRow, _, _| {
            rows.push(row);
            progress.advance(1);
        });
        rows
    };
    commit_made(
        out,
        Split::Train,
        count,
        make,
        &skeleton,
        &plan_hash,
        &holder,
    )?;
    progress.finish(&format!("{count} windows recorded"));
    let settings = config.range_settings();
    store_normalizer(out, &normalizer, &settings, &skeleton, &plan_hash, &holder)
}

/// Commits the range of model units beside windows that are in it.
fn store_normalizer(
    root: &Path,
    normalizer: &Normalizer,
    settings: &str,
    skeleton: &Skeleton,
    plan_hash: &str,
    holder: &str,
) -> anyhow::Result<Dataset> {
    let rows = [NormalizerRow::new(normalizer, settings, plan_hash)];
    let plan_hash = plan("normalizers", &(plan_hash, &rows[0].id))?;
    Ok(commit_rows(
        root, &rows, None, skeleton, &plan_hash, holder,
    )?)
}

/// Set by the first interrupt: what is being trained is saved and ends.
static STOP: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// Whether an interrupt has ended the work.
pub(crate) fn is_stopped() -> bool {
    STOP.load(Ordering::Relaxed)
}

/// Turns the first interrupt into a request to save and end; a second one ends at once.
fn listen_for_interrupts() {
    static LISTENING: Once = Once::new();
    LISTENING.call_once(|| {
        for signal in [SIGINT, SIGTERM] {
            let second = Exit::Interrupted.code().into();
            // Registered first, so that it sees the flag before this signal sets it. Without a
            // handler a signal ends the program at once, which loses no more than the steps since
            // the last checkpoint.
            let _ = flag::register_conditional_shutdown(signal, second, Arc::clone(&STOP));
            let _ = flag::register(signal, Arc::clone(&STOP));
        }
    });
}

pub(crate) fn with_session<T>(
    progress: &dyn Progress,
    act: impl FnOnce(&Session<'_>) -> Result<T, train::Error>,
) -> Result<T, train::Error> {
    listen_for_interrupts();
    let begun = Instant::now();
    act(&Session {
        device: &device(),
        more_devices: &devices()[1..],
        progress,
        stop: &STOP,
        clock: &|| begun.elapsed(),
    })
}

/// What the editor is trained on besides a dataset.
pub(crate) struct TrainInputs<'a> {
    /// How edits are composed.
    pub(crate) compose: &'a ComposeConfig,
    /// Windows recorded before, in place of composing them.
    pub(crate) windows: Option<&'a Path>,
    /// Folder of CLIP, where the settings listen to it; none looks into the hub's cache.
    pub(crate) clip: Option<&'a Path>,
}

/// Table of instructions a run was trained with, in its folder.
const EMBEDDINGS: &str = "embeddings.safetensors";

/// CLIP from a folder, or from the cache of the Hugging Face hub.
pub(crate) fn clip(folder: Option<&Path>) -> anyhow::Result<ClipEncoder> {
    let model = ClipModel::VitB32;
    let files = match folder {
        Some(folder) => ClipFiles::in_folder(folder)?,
        None => {
            let cache = hub_cache()?;
            ClipFiles::in_cache(model, &cache).context(
                "the model listens to CLIP; fetch it with `stance model fetch`, or give its folder \
                 with --clip",
            )?
        }
    };
    Ok(ClipEncoder::load(&model.config(), &files, &device())?)
}

/// The cache of the Hugging Face hub that the environment names.
pub(crate) fn hub_cache() -> anyhow::Result<HubCache> {
    HubCache::from_variables(|name| std::env::var_os(name))
        .context("neither HF_HOME nor HOME is set; set one to say where downloads are kept")
}

/// Vectors of texts: those a run holds where they suffice, else made with CLIP.
fn embeddings(
    run: &Path,
    texts: &[String],
    folder: Option<&Path>,
    progress: &dyn Progress,
) -> anyhow::Result<EmbeddingTable> {
    let path = run.join(EMBEDDINGS);
    if path.exists() {
        let table = EmbeddingTable::load(&path)?;
        if table.check_texts(texts.iter().map(String::as_str)).is_ok() {
            return Ok(table);
        }
    }
    let encoder = clip(folder)?;
    progress.begin("texts", Some(texts.len() as u64));
    let mut reported = 0;
    let table = EmbeddingTable::compute(
        &encoder,
        texts.iter().map(String::as_str),
        &mut |done, _| {
            progress.advance((done - reported) as u64);
            reported = done;
        },
    )?;
    progress.finish(&format!("{} texts encoded by CLIP", table.texts().len()));
    Ok(table)
}

/// An editor that knows the instructions it will be given, if it listens to a frozen encoder.
pub(crate) fn with_texts(
    editor: Editor,
    source: &EditorSource<'_>,
    texts: &[String],
    progress: &dyn Progress,
) -> anyhow::Result<Editor> {
    match editor.record().config.text {
        TextRecord::Learned(_) => Ok(editor),
        TextRecord::Frozen { .. } => {
            let table = embeddings(source.run, texts, source.clip, progress)?;
            Ok(editor.with_vectors(Box::new(table))?)
        }
    }
}

/// The composer's settings without those that an ablation thins the training data or fixes its pairs
/// by: what a model is validated on stays the same.
fn unthinned(compose: &ComposeConfig) -> ComposeConfig {
    ComposeConfig {
        mcm_ratio: 1.0,
        annotated_ratio: 1.0,
        fixed_pairs: false,
        ..compose.clone()
    }
}

/// The composer's settings with the model's window, unless they say otherwise themselves; then the
/// model refuses what does not fit it.
fn with_window(compose: &ComposeConfig, window: usize) -> ComposeConfig {
    let own = compose.window;
    ComposeConfig {
        window: if own == WINDOW_FRAMES { window } else { own },
        ..compose.clone()
    }
}

/// Trains the editor on the composer's stream, or continues its run.
pub(crate) fn train_editor<'a>(
    root: &Path,
    start: impl Into<Start<'a>>,
    config: &TrainConfig,
    inputs: &TrainInputs<'_>,
    progress: &dyn Progress,
) -> anyhow::Result<TrainReport> {
    let (start, seed) = (start.into(), Seed(config.seed));
    let run = start.run;
    let compose = &with_window(inputs.compose, config.window);
    let dataset = Dataset::open(root)?;
    let (train, normalizer) = train_stream(&dataset, compose, seed, start.range()?)?;
    let val = library(&dataset, Split::Val)?;
    let val = Stream::new(val, unthinned(compose), seed, &normalizer)
        .context("the validation split cannot be composed; ingest more clips")?;
    let recorded = match inputs.windows {
        Some(folder) => {
            let fitted = library(&dataset, Split::Train)?.fit_normalizer(compose)?;
            Some(recorded_windows(folder, [&fitted, &normalizer], seed)?)
        }
        None => None,
    };
    let instructions = match &recorded {
        Some(loader) => loader.instructions().to_vec(),
        None => train.instructions(),
    };
    let vectors = match config.text.encoder {
        TextEncoder::Learned => None,
        TextEncoder::Clip => {
            let all = [instructions.clone(), val.instructions()].concat();
            let table = embeddings(run, &all, inputs.clip, progress)?;
            std::fs::create_dir_all(run)
                .with_context(|| format!("cannot create {}", run.display()))?;
            table.save(&run.join(EMBEDDINGS))?;
            Some(table)
        }
    };
    let corpus = Corpus {
        train: match &recorded {
            Some(loader) => loader,
            None => &train,
        },
        val: &val,
        instructions: &instructions,
        vectors: vectors.as_ref().map(|table| table as _),
        normalizer,
        skeleton: &dataset.skeleton()?,
        dataset_hash: &learned_from(&dataset, inputs.windows)?,
        compose: &ComposeRecord {
            config: compose.clone(),
            seed,
        },
    };
    let report = with_session(progress, |session| {
        train_motionrefit(start, config, corpus, session)
    })?;
    Ok(report)
}

/// What identifies the data an editor learns from: the tables edits are composed from, and the windows
/// that were recorded of them where it learns from these.
fn learned_from(dataset: &Dataset, windows: Option<&Path>) -> anyhow::Result<String> {
    let composed = dataset.content_hash(&COMPOSED);
    let Some(folder) = windows else {
        return Ok(composed);
    };
    let recorded = Dataset::open_unverified(folder)?.content_hash(&[WindowRow::TABLE]);
    let both = blake3::hash(format!("{composed} {recorded}").as_bytes());
    Ok(both.to_hex().to_string())
}

/// Trains the coordinator on segments of the motions an editor is trained on, or continues its run.
pub(crate) fn train_coordinator<'a>(
    root: &Path,
    start: impl Into<Start<'a>>,
    config: &CoordinatorConfig,
    compose: &ComposeConfig,
    progress: &dyn Progress,
) -> anyhow::Result<TrainReport> {
    let (start, seed) = (start.into(), Seed(config.seed));
    let compose = &with_window(compose, config.window);
    let dataset = Dataset::open(root)?;
    let (train, normalizer) = train_stream(&dataset, compose, seed, start.range()?)?;
    let val = library(&dataset, Split::Val)?;
    let val = Stream::new(val, unthinned(compose), seed, &normalizer)
        .context("the validation split cannot be composed; ingest more clips")?;
    let record = ComposeRecord {
        config: compose.clone(),
        seed,
    };
    let segments = Segments {
        train: &train,
        val: &val,
        normalizer,
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&COMPOSED),
        compose: &record,
    };
    Ok(with_session(progress, |session| {
        coordinator::train_coordinator(start, config, segments, session)
    })?)
}

/// Opens recorded windows, which must be in the range fitted to the dataset, and that in the one the
/// run trains in.
fn recorded_windows(
    folder: &Path,
    [fitted, used]: [&Normalizer; 2],
    seed: Seed,
) -> anyhow::Result<WindowLoader> {
    let recorded = Dataset::open(folder)?;
    let rows: Vec<NormalizerRow> = recorded.read(None)?;
    if used.hash() != fitted.hash() {
        bail!(
            "the windows in {} are in the range of model units of their dataset, and the run keeps \
             that of the weights it begins with; train it on composed windows, without --windows",
            folder.display()
        );
    }
    let hash = fitted.hash();
    if rows.iter().all(|row| row.id != hash) {
        bail!(
            "the windows in {} were recorded in another range of model units than the dataset's; \
             record them again: stance triplets DATASET --windows N --out FOLDER",
            folder.display()
        );
    }
    let order = ReadOrder::Shuffled(seed);
    Ok(WindowLoader::open(&recorded, Split::Train, order)?)
}

/// Whether the training split can teach a coordinator: composing takes motions of two sources.
pub(crate) fn can_coordinate(root: &Path) -> anyhow::Result<bool> {
    let motions: Vec<MotionRow> = Dataset::open(root)?.read(Some(Split::Train))?;
    let origins: BTreeSet<&str> = motions.iter().map(|row| row.id.source_clip()).collect();
    Ok(origins.len() > 1)
}

/// Trains the network from keypoints to rotations on the motions of the training split, and measures
/// it on those of the validation split.
pub(crate) fn train_j2s<'a>(
    root: &Path,
    start: impl Into<Start<'a>>,
    config: &J2sConfig,
    progress: &dyn Progress,
) -> anyhow::Result<J2sReport> {
    let dataset = Dataset::open(root)?;
    let motions = |split: Split| -> anyhow::Result<Vec<Motion>> {
        let rows: Vec<MotionRow> = dataset.read(Some(split))?;
        Ok(rows
            .iter()
            .map(MotionRow::motion)
            .collect::<Result<_, _>>()?)
    };
    let (train, val) = (motions(Split::Train)?, motions(Split::Val)?);
    let (skeleton, hash) = (dataset.skeleton()?, dataset.content_hash(&MOTIONS));
    Ok(with_session(progress, |session| {
        j2s::train_j2s(start, config, [&train, &val], &skeleton, &hash, session)
    })?)
}

/// Id, motion and captions of a clip.
type Captioned = (String, Motion, Vec<String>);

/// The clips of a split that have a caption.
fn captioned(dataset: &Dataset, split: Split) -> anyhow::Result<Vec<Captioned>> {
    let rows: Vec<MotionRow> = dataset.read(Some(split))?;
    let clips = rows.into_iter().filter(|row| !row.captions.is_empty());
    clips
        .map(|row| {
            let motion = row.motion().with_context(|| row.id.to_string())?;
            let captions = row.captions.into_iter().map(|caption| caption.text);
            Ok((row.id.to_string(), motion, captions.collect()))
        })
        .collect()
}

/// How well an encoder's texts and motions find each other in a split: one result a repeat.
pub(crate) fn cross_scores(
    root: &Path,
    run: &Path,
    split: Split,
    protocol: &Protocol,
) -> anyhow::Result<(usize, Vec<CrossRetrieval>)> {
    protocol.check()?;
    let encoder = TmrEncoder::load(run, Slot::Best, &device())?;
    let mut clips = captioned(&Dataset::open(root)?, split)?;
    let kept: BTreeSet<usize> = protocol.scored_items(clips.len())?.into_iter().collect();
    let mut place = 0..clips.len();
    clips.retain(|_| place.next().is_some_and(|place| kept.contains(&place)));
    if clips.is_empty() {
        bail!("no clip of split {split} has a caption; ask for another one with --split");
    }
    let texts: Vec<&str> = clips
        .iter()
        .map(|(_, _, captions)| captions[0].as_str())
        .collect();
    let motions: Vec<&Motion> = clips.iter().map(|(_, motion, _)| motion).collect();
    let unit = |latents: Vec<Vec<f32>>| {
        let rows: Vec<Vec<f64>> = latents
            .into_iter()
            .map(|row| row.into_iter().map(f64::from).collect())
            .collect();
        unit_rows(&Matrix::from_rows(&rows))
    };
    let (texts_at, motions_at) = (
        unit(encoder.encode_texts(&texts)?)?,
        unit(encoder.encode(&motions)?)?,
    );
    let repeats = (0..protocol.repeats)
        .map(|repeat| {
            let galleries = protocol.galleries(clips.len(), repeat);
            cross_retrieval(&texts_at, &motions_at, &galleries, |a, b| {
                texts[a] == texts[b]
            })
        })
        .collect::<Result<_, _>>()?;
    Ok((clips.len(), repeats))
}

/// Trains the encoder that evaluation measures with, or continues its run.
pub(crate) fn train_encoder<'a>(
    root: &Path,
    start: impl Into<Start<'a>>,
    config: &TmrConfig,
    progress: &dyn Progress,
) -> anyhow::Result<TrainReport> {
    let dataset = Dataset::open(root)?;
    let (train, val) = (
        captioned(&dataset, Split::Train)?,
        captioned(&dataset, Split::Val)?,
    );
    fn views(clips: &[Captioned]) -> Vec<CaptionedMotion<'_>> {
        clips
            .iter()
            .map(|(id, motion, captions)| CaptionedMotion {
                id,
                motion,
                captions,
            })
            .collect()
    }
    let corpus = TmrCorpus {
        train: &views(&train),
        val: &views(&val),
        skeleton: &dataset.skeleton()?,
        dataset_hash: &dataset.content_hash(&MOTIONS),
    };
    let report = with_session(progress, |session| {
        train_tmr(start, config, corpus, session)
    })?;
    Ok(report)
}

/// Draws test questions from a split and commits them as a dataset of their own.
pub(crate) fn items(
    root: &Path,
    out: &Path,
    split: Split,
    config: &ItemConfig,
    seed: Seed,
    global: &Global,
) -> anyhow::Result<Dataset> {
    let dataset = Dataset::open(root)?;
    let content = dataset.content_hash(&COMPOSED);
    let plan_hash = plan("items", &(content, split, config, seed))?;
    if let Ok(done) = Dataset::open_unverified(out)
        && plan_of(&done, ItemRow::TABLE) == plan_hash
    {
        return Ok(Dataset::open(out)?);
    }
    let rows = draw_items(&library(&dataset, split)?, config, seed)?;
    if let ItemCount::Exactly(count) = config.count
        && rows.len() < count
    {
        report::note(&format!(
            "split {split} of {} gives {} different items, {count} were asked for",
            root.display(),
            rows.len()
        ));
    }
    let split_of = |row: &ItemRow| row.split;
    Ok(commit_rows(
        out,
        &rows,
        Some(split_of),
        &dataset.skeleton()?,
        &plan_hash,
        &global.holder(),
    )?)
}

/// How items are edited.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct EditConfig {
    /// Name of the system in tables; none is one that says what it is.
    pub(crate) name: Option<String>,
    /// Edits of every item, each with a sampling seed of its own.
    pub(crate) takes: u64,
    /// Guidance weight; none is the one the editor was trained for.
    pub(crate) guidance: Option<f64>,
    /// Factor of the noise; none is the one the editor was trained for.
    pub(crate) temperature: Option<f64>,
    /// Windows generated at a time.
    pub(crate) max_batch: usize,
    /// How SMPL-X parameters are found.
    pub(crate) fit: FitMethod,
    /// Weight in m^2/rad^2 by which the exact fit holds rotations to those it starts from; none is
    /// that of [`NETWORK_PRIOR`] with a pose network, and none without.
    pub(crate) prior: Option<f64>,
    /// How strongly a coordinator guides; none is what the editor's settings say.
    pub(crate) coordinator_strength: Option<f64>,
    /// Last steps a coordinator guides; none is what the editor's settings say.
    pub(crate) coordinator_steps: Option<usize>,
}

impl Default for EditConfig {
    fn default() -> Self {
        Self {
            name: None,
            takes: 1,
            guidance: None,
            temperature: None,
            max_batch: 64,
            fit: FitMethod::Exact,
            prior: None,
            coordinator_strength: None,
            coordinator_steps: None,
        }
    }
}

/// Weight of a pose network's rotations in the fit, in m^2/rad^2: it moves the joints of head and
/// hands, whose points lie centimetres apart, and hardly those of limbs. The best of 1e-4 to 3e-2 by
/// E2T AvgR on edited clips of the Bandai-Namco set's test split, the only one that was edited then:
/// on that split it is a choice that has seen the answers.
const NETWORK_PRIOR: f64 = 0.01;

/// The settings the editor samples with.
pub(crate) fn edit_settings(editor: &Editor, config: &EditConfig, seed: Seed) -> EditSettings {
    let trained = &editor.record().config.train;
    EditSettings {
        seed,
        guidance: config.guidance.unwrap_or(trained.diffusion.guidance),
        temperature: config.temperature.unwrap_or(trained.diffusion.temperature),
        coordinator: GuidanceConfig {
            target: trained.coordinator.target,
            strength: config
                .coordinator_strength
                .unwrap_or(trained.coordinator.strength),
            num_steps: config
                .coordinator_steps
                .unwrap_or(trained.coordinator.num_steps),
        },
        fit: config.fit,
        prior: config.prior.unwrap_or(if editor.has_poses() {
            NETWORK_PRIOR
        } else {
            0.0
        }),
        max_batch: config.max_batch,
    }
}

/// Where an editor is loaded from.
#[derive(Clone, Debug)]
pub(crate) struct EditorSource<'a> {
    /// Its run folder.
    pub(crate) run: &'a Path,
    /// Which of its checkpoints.
    pub(crate) slot: Slot,
    /// Run folder of the coordinator that guides it.
    pub(crate) coordinator: Option<&'a Path>,
    /// Run folder of the network whose twists its poses get.
    pub(crate) poses: Option<&'a Path>,
    /// Folder of CLIP, where it listens to it; none looks into the hub's cache.
    pub(crate) clip: Option<&'a Path>,
}

impl<'a> EditorSource<'a> {
    /// The best checkpoint of a run, unguided.
    pub(crate) fn best(run: &'a Path) -> Self {
        Self {
            run,
            slot: Slot::Best,
            coordinator: None,
            poses: None,
            clip: None,
        }
    }

    /// Loads the editor, for motions on a skeleton.
    pub(crate) fn load(&self, skeleton: &Skeleton) -> anyhow::Result<Editor> {
        check_skeleton(self.run, "the editor", skeleton)?;
        if let Some(run) = self.poses {
            check_skeleton(run, "the pose network", skeleton)?;
        }
        if let Some(run) = self.coordinator {
            check_skeleton(run, "the coordinator", skeleton)?;
        }
        let device = device();
        let mut editor = Editor::load(self.run, self.slot, &device)?;
        if let Some(run) = self.poses {
            let (net, hash) = PoseNet::load(run, Slot::Best, &device)?;
            editor = editor.with_poses(net, &hash);
        }
        match self.coordinator {
            Some(run) => {
                let coordinator = TrainedCoordinator::load(run, Slot::Best, &device)?;
                Ok(editor.with_coordinator(coordinator)?)
            }
            None => Ok(editor),
        }
    }
}

/// What an editor edits with, as rows of edits record it. What does not change a result, such as the
/// size of a batch, is left out.
fn settings_document(
    editor: &Editor,
    source: &EditorSource<'_>,
    settings: &EditSettings,
) -> serde_json::Value {
    let coordinator = editor.has_coordinator().then_some(settings.coordinator);
    let record = &editor.record().config;
    serde_json::json!({
        "checkpoint": source.slot.name(),
        "guidance": settings.guidance,
        "temperature": settings.temperature,
        "prior": settings.prior,
        "poses": editor.has_poses(),
        "coordinator": coordinator,
        "fit": settings.fit,
        "window": record.train.window,
        "advance": record.train.window - FIXED_FRAMES,
        "fps": record.compose.config.fps,
    })
}

/// What an editor is called and what it edits with.
pub(crate) fn identity(
    editor: &Editor,
    source: &EditorSource<'_>,
    settings: &EditSettings,
    name: Option<&str>,
) -> anyhow::Result<SystemIdentity> {
    let name = match name {
        Some(name) => name.to_owned(),
        None => system_name(editor),
    };
    Ok(SystemIdentity {
        name,
        settings: settings_document(editor, source, settings).to_string(),
    })
}

/// Answers items with an editor, and commits the items and the answers as a dataset of their own.
pub(crate) fn edits(
    items: &Path,
    source: &EditorSource<'_>,
    out: &Path,
    config: &EditConfig,
    seed: Seed,
    global: &Global,
    progress: &dyn Progress,
) -> anyhow::Result<MadeEdits> {
    let asked = Dataset::open(items)?;
    let skeleton = skeleton_of(&asked)?;
    let editor = source.load(&skeleton)?;
    let settings = edit_settings(&editor, config, seed);
    let system = identity(&editor, source, &settings, config.name.as_deref())?;
    let rows: Vec<ItemRow> = item_rows(&asked)?;
    let remarks = item_remarks(&editor, &rows)?;
    note_remarks(&remarks);
    let ids: Vec<&str> = rows.iter().map(|row| row.id.as_str()).collect();
    let inputs = (
        ids,
        editor.hash(),
        &system.name,
        &system.settings,
        seed,
        config.takes,
    );
    // The number counts changes of what the table holds.
    let plan_hash = plan("edits-4", &inputs)?;
    if let Ok(done) = Dataset::open_unverified(out)
        && plan_of(&done, EditRow::TABLE) == plan_hash
    {
        return Ok(MadeEdits {
            dataset: Dataset::open(out)?,
            times: None,
            remarks,
        });
    }
    let texts: Vec<String> = rows.iter().map(|row| row.instruction.clone()).collect();
    let editor = with_texts(editor, source, &texts, progress)?;
    let mut times = EditTimes::default();
    let mut answers = Vec::new();
    for take in 0..config.takes.max(1) {
        let settings = EditSettings {
            seed: Seed(seed.0.wrapping_add(take)),
            ..settings
        };
        let (made, spent) = with_session(progress, |session| {
            edit::edit_items(&editor, &system, &rows, &skeleton, &settings, session)
        })?;
        answers.extend(made);
        times += spent;
    }
    let done = commit_edits(out, &rows, &answers, &skeleton, &plan_hash, global)?;
    let path = out.join(TIMES);
    std::fs::write(&path, serde_json::to_vec_pretty(&per_window(&times))?)
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(MadeEdits {
        dataset: done,
        times: Some(times),
        remarks,
    })
}

/// Prints the warnings about edits to stderr.
pub(crate) fn note_remarks(remarks: &Remarks) {
    if remarks.num_short > 0 {
        report::note(&format!(
            "{} shorter than a window of the model: the last pose is held while editing, and what is \
             added is cut off again",
            match remarks.num_short {
                1 => "1 motion is".to_owned(),
                many => format!("{many} motions are"),
            }
        ));
    }
    if !remarks.unknown_words.is_empty() {
        let words: Vec<&str> = remarks.unknown_words.iter().map(String::as_str).collect();
        report::note(&format!(
            "the editor has never seen {}: it cannot know what is asked for by that",
            words.join(", ")
        ));
    }
}

/// What is to be known of an editor's answers to items.
pub(crate) fn item_remarks(editor: &Editor, items: &[ItemRow]) -> anyhow::Result<Remarks> {
    let motions = items
        .iter()
        .map(|item| {
            let frames = usize::try_from(item.source_frames).unwrap_or(0);
            Ok((frames, Fps::new(f64::from(item.fps))?))
        })
        .collect::<Result<Vec<_>, datasets_spec::Error>>()?;
    let texts = items.iter().map(|item| item.instruction.as_str());
    Ok(Remarks::of(&editor.record().config, motions, texts))
}

/// What [`edits`] gives.
pub(crate) struct MadeEdits {
    /// The folder of items and edits.
    pub(crate) dataset: Dataset,
    /// Missing where the answers were there already.
    pub(crate) times: Option<EditTimes>,
    /// What is to be known of them.
    pub(crate) remarks: Remarks,
}

/// Commits items and what was made of them together.
pub(crate) fn commit_edits(
    out: &Path,
    items: &[ItemRow],
    edits: &[EditRow],
    skeleton: &Skeleton,
    plan_hash: &str,
    global: &Global,
) -> anyhow::Result<Dataset> {
    let transaction = Transaction::begin(out, &global.holder())?;
    let item_split: fn(&ItemRow) -> Split = |row| row.split;
    let edit_split: fn(&EditRow) -> Split = |row| row.split;
    let tables = [
        (
            ItemRow::TABLE,
            transaction.write_rows(items, Some(item_split), skeleton, plan_hash)?,
        ),
        (
            EditRow::TABLE,
            transaction.write_rows(edits, Some(edit_split), skeleton, plan_hash)?,
        ),
    ];
    Ok(transaction.commit(Commit {
        tables: tables
            .map(|(table, files)| (table.to_owned(), files))
            .into(),
        plan_hash: plan_hash.to_owned(),
        skeleton: skeleton.clone(),
        ..Commit::default()
    })?)
}

/// The items of a folder, each checked against its id.
fn item_rows(folder: &Dataset) -> anyhow::Result<Vec<ItemRow>> {
    let rows: Vec<ItemRow> = folder.read(None)?;
    if rows.is_empty() {
        bail!(
            "{} holds no items; draw them: stance items DATASET --out ITEMS",
            folder.root().display()
        );
    }
    for row in &rows {
        row.check()
            .with_context(|| format!("in {}", folder.root().display()))?;
    }
    Ok(rows)
}

/// The trained encoder as evaluation asks for it.
struct Encoder(TmrEncoder);

impl MotionEncoder for Encoder {
    fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError> {
        let latents = self.0.encode(motions)?;
        Ok(latents
            .into_iter()
            .map(|latent| latent.into_iter().map(f64::from).collect())
            .collect())
    }

    fn hash(&self) -> String {
        self.0.hash().to_owned()
    }

    fn recipe(&self) -> String {
        format!(
            "{} at {} fps, trained on dataset {:.12}",
            self.0.recipe().name(),
            self.0.fps(),
            self.0.dataset_hash()
        )
    }
}

/// Scores and the recipes of the encoders behind them.
#[derive(Debug)]
pub(crate) struct Scores {
    pub(crate) rows: Vec<ScoreRow>,
    pub(crate) recipes: BTreeMap<String, String>,
}

/// Scores every system of one or more tables of edits.
pub(crate) fn scores(
    edits: &[PathBuf],
    runs: &EvaluatorRuns<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> anyhow::Result<Scores> {
    let answered = Answered::read_for_table(edits)?;
    runs.with(&answered.skeleton, |evaluators| {
        let (items, edits) = (&answered.items, &answered.edits);
        let rows = eval::score::score(items, edits, evaluators, protocol, progress)?;
        let encoder = evaluators.encoder;
        Ok(Scores {
            rows,
            recipes: BTreeMap::from([(encoder.hash(), encoder.recipe())]),
        })
    })
}

/// Compares two systems of one or more tables of edits item by item.
pub(crate) fn comparison(
    edits: [&Path; 2],
    runs: &EvaluatorRuns<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> anyhow::Result<Vec<Comparison>> {
    // Checks that both are of the same items.
    let Answered {
        items, skeleton, ..
    } = Answered::read(&edits.map(Path::to_owned))?;
    let mut rows: Vec<EditRow> = Vec::new();
    let mut names: Vec<String> = Vec::new();
    for (path, side) in edits.into_iter().zip(["A", "B"]) {
        let found: Vec<EditRow> = Dataset::open(path)?.read(None)?;
        check_systems(&found).with_context(|| format!("in {}", path.display()))?;
        let systems: BTreeSet<String> = found.iter().map(|row| row.system.clone()).collect();
        let [system] = Vec::from_iter(systems)
            .try_into()
            .map_err(|found: Vec<String>| {
                anyhow::anyhow!(
                    "{} holds {} systems ({}), and a comparison needs one",
                    path.display(),
                    found.len(),
                    found.join(", ")
                )
            })?;
        // Two runs of one method bear the same name.
        let name = format!("{system} ({side})");
        rows.extend(found.into_iter().map(|row| EditRow {
            system: name.clone(),
            ..row
        }));
        names.push(name);
    }
    runs.with(&skeleton, |evaluators| {
        let names = [names[0].as_str(), names[1].as_str()];
        Ok(compare(
            &items, &rows, names, evaluators, protocol, progress,
        )?)
    })
}

/// Run folders of the networks that motions are measured with.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EvaluatorRuns<'a> {
    /// The evaluation encoder.
    pub(crate) encoder: &'a Path,
    /// A coordinator.
    pub(crate) coordinator: Option<&'a Path>,
}

impl EvaluatorRuns<'_> {
    fn with<T>(
        &self,
        skeleton: &Skeleton,
        act: impl FnOnce(Evaluators<'_>) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        check_skeleton(self.encoder, "the encoder", skeleton)?;
        if let Some(run) = self.coordinator {
            check_skeleton(run, "the coordinator", skeleton)?;
        }
        let encoder = Encoder(TmrEncoder::load(self.encoder, Slot::Best, &device())?);
        let classifier = match self.coordinator {
            Some(run) => Some(Classifier {
                network: TrainedCoordinator::load(run, Slot::Best, &device())?,
                skeleton,
            }),
            None => None,
        };
        act(Evaluators {
            encoder: &encoder,
            classifier: classifier
                .as_ref()
                .map(|classifier| classifier as &dyn MotionClassifier),
            skeleton,
        })
    }
}

/// A coordinator as the classifier of evaluation.
struct Classifier<'a> {
    network: TrainedCoordinator,
    skeleton: &'a Skeleton,
}

impl MotionClassifier for Classifier<'_> {
    fn composed(&self, motions: &[&Motion]) -> Result<Vec<f64>, EncoderError> {
        motions
            .iter()
            .map(|motion| Ok(self.network.composed_share(motion, self.skeleton)?))
            .collect()
    }
}

/// Items and what systems made of them.
#[derive(Debug)]
pub(crate) struct Answered {
    pub(crate) items: Vec<ItemRow>,
    pub(crate) edits: Vec<EditRow>,
    pub(crate) skeleton: Skeleton,
}

impl Answered {
    /// Reads tables of edits of the same items. A folder of items alone has no edits.
    pub(crate) fn read(folders: &[PathBuf]) -> anyhow::Result<Self> {
        let mut all: Option<(&Path, Self)> = None;
        for path in folders {
            let folder = Dataset::open(path)?;
            let items = item_rows(&folder)?;
            let edits: Vec<EditRow> = folder.read(None)?;
            let skeleton = skeleton_of(&folder)?;
            let Some((first, all)) = &mut all else {
                all = Some((
                    path,
                    Self {
                        items,
                        edits,
                        skeleton,
                    },
                ));
                continue;
            };
            if skeleton != all.skeleton {
                bail!(
                    "{} is posed on skeleton {}, {} on {}; tables of edits are compared on one body",
                    first.display(),
                    all.skeleton.name(),
                    path.display(),
                    skeleton.name()
                );
            }
            let ids = |items: &[ItemRow]| -> BTreeSet<String> {
                items.iter().map(|item| item.id.clone()).collect()
            };
            let (ours, theirs) = (ids(&all.items), ids(&items));
            if ours != theirs {
                bail!(
                    "{} and {} answer different items: {} of {} are in {} alone, {} of {} in {} alone; \
                     edit the same items: stance edit RUN --items ITEMS",
                    first.display(),
                    path.display(),
                    ours.difference(&theirs).count(),
                    ours.len(),
                    first.display(),
                    theirs.difference(&ours).count(),
                    theirs.len(),
                    path.display()
                );
            }
            all.edits.extend(edits);
        }
        let Some((_, all)) = all else {
            bail!("no table of edits was given");
        };
        Ok(all)
    }

    /// Reads tables of edits whose systems are rows of one table.
    pub(crate) fn read_for_table(folders: &[PathBuf]) -> anyhow::Result<Self> {
        let all = Self::read(folders)?;
        check_systems(&all.edits)?;
        Ok(all)
    }
}

/// Refuses two checkpoints, or two settings, under one name: they would become one row of a table. So
/// would a take that is there twice.
fn check_systems(edits: &[EditRow]) -> anyhow::Result<()> {
    let mut known: BTreeMap<&str, &EditRow> = BTreeMap::new();
    let mut takes: BTreeSet<(&str, &str, u64)> = BTreeSet::new();
    for row in edits {
        let first = *known.entry(&row.system).or_insert(row);
        let differs = |what: &str, a: &str, b: &str| {
            anyhow::anyhow!(
                "system {:?} stands for two {what}: {a} and {b}; edit again with --name to tell them apart",
                row.system
            )
        };
        if first.checkpoint_hash != row.checkpoint_hash {
            let (a, b) = (&first.checkpoint_hash, &row.checkpoint_hash);
            return Err(differs(
                "checkpoints",
                &format!("{a:.12}"),
                &format!("{b:.12}"),
            ));
        }
        if first.settings_hash != row.settings_hash {
            return Err(differs("settings", &first.settings, &row.settings));
        }
        if !takes.insert((&row.system, &row.id, row.seed)) {
            bail!(
                "system {:?} has two motions of item {:?} sampled with seed {}; give each take once, or \
                 edit again with another --seed",
                row.system,
                row.id,
                row.seed
            );
        }
    }
    Ok(())
}

/// Beside a table of edits: where the time of making it went, which its hash does not cover.
const TIMES: &str = "times.json";

/// The times recorded beside a table of edits.
pub(crate) fn window_times(edits: &Path) -> anyhow::Result<WindowTimes> {
    let path = edits.join(TIMES);
    let bytes = std::fs::read(&path).with_context(|| {
        format!(
            "cannot read {}; it is written when `stance edit` edits a split",
            path.display()
        )
    })?;
    serde_json::from_slice(&bytes).with_context(|| format!("in {}", path.display()))
}

/// The times of editing, for one window.
pub(crate) fn per_window(times: &EditTimes) -> WindowTimes {
    let windows = times.num_windows.max(1) as f64;
    WindowTimes {
        window: times.window,
        diffusion_secs: times.diffusion_secs / windows,
        coordinator_secs: times.coordinator_secs / windows,
        fit_secs: times.fit_secs / windows,
        batch: (times.num_batches > 0).then(|| windows / times.num_batches as f64),
    }
}

/// Commits scores as a dataset of their own.
pub(crate) fn commit_scores(
    out: &Path,
    scores: &Scores,
    skeleton: &Skeleton,
    global: &Global,
) -> anyhow::Result<Dataset> {
    let values: Vec<_> = scores
        .rows
        .iter()
        .map(|row| (&row.system, &row.task, &row.metric, row.mean.to_bits()))
        .collect();
    let plan_hash = plan("scores", &values)?;
    let holder = global.holder();
    Ok(commit_rows(
        out,
        &scores.rows,
        None,
        skeleton,
        &plan_hash,
        &holder,
    )?)
}

/// A preset with the user's own values in place of some of its own. Unknown keys are errors.
pub(crate) fn overlay<T: Serialize + for<'de> Deserialize<'de>>(
    preset: &T,
    own: Option<&toml::Table>,
) -> anyhow::Result<T> {
    let mut value = toml::Value::try_from(preset)?;
    if let Some(own) = own {
        merge(&mut value, &toml::Value::Table(own.clone()));
    }
    Ok(value.try_into()?)
}

/// Puts values in place of others, table by table.
pub(crate) fn merge(base: &mut toml::Value, own: &toml::Value) {
    match (base, own) {
        (toml::Value::Table(base), toml::Value::Table(own)) => {
            for (key, value) in own {
                match base.get_mut(key) {
                    Some(inner) => merge(inner, value),
                    None => {
                        base.insert(key.clone(), value.clone());
                    }
                }
            }
        }
        (base, own) => *base = own.clone(),
    }
}

/// The presets by name.
pub(crate) fn preset(name: &str) -> anyhow::Result<Preset> {
    match name {
        "tiny" => Ok(Preset::Tiny),
        "paper" => Ok(Preset::Paper),
        "official" => Ok(Preset::Official),
        other => bail!("unknown preset {other:?}; known: tiny, paper, official"),
    }
}
