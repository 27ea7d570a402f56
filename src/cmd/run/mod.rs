//! `stance run`

mod page;

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use compose::recording::{self, Kind, Settings};
use compose::{ComposeConfig, EditKind, ItemConfig};
use datasets_spec::record::PairRow;
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Seed, Split};
use eval::answers::Answered;
use eval::protocol::Protocol;
use page::{Done, page, print};
use pipeline::annotation::masks::MaskConfig;
use pipeline::annotation::pairs::PairConfig;
use pipeline::ingest::{IngestReport, SourceArg};
use pipeline::stage::{self, IngestConfig, Judged};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use train::config::{Preset, TrainConfig};
use train::coordinator::CoordinatorConfig;
use train::fit::TrainReport;
use train::j2s::J2sConfig;
use train::stage::coordinator::train_coordinator;
use train::stage::editor::{EditorInputs, train_editor};
use train::stage::encoder::train_encoder;
use train::stage::poses::train_j2s;
use train::system::{EditConfig, SystemSource};
use train::text::source::TextEncoderSource;
use train::tmr::TmrConfig;

use crate::evaluators::{EvaluatorRuns, WeakJudgeArgs, report_on_encoder};
use crate::exit::Exit;
use crate::global::Global;
use crate::judge::{BUILTIN, EncoderConfig};
use crate::local;
use crate::seeds::Seeds;
use crate::session::{stopped, text_encoder, with_session};
use crate::trainings::{TrainingsArgs, side_by_side};
use crate::{report, settings, stages};

/// Run the whole chain on your own motions: build a dataset, train, edit, and score.
///
/// The configuration is a TOML file; every key but `sources` and `out` may be left out. Relative
/// paths are relative to the file. Interrupted and run again, it continues.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Configuration file
    #[arg(long)]
    config: PathBuf,
    #[command(flatten)]
    weak_judge: WeakJudgeArgs,
    #[command(flatten)]
    trainings: TrainingsArgs,
}

/// The configuration file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunConfig {
    /// Files, folders and URLs to ingest, each as NAME=PATH or a path.
    sources: Vec<SourceArg>,
    /// Folder for everything the run makes.
    out: PathBuf,
    /// Named settings of the models.
    #[serde(default = "default_preset")]
    preset: Preset,
    /// Folder of CLIP or a table of vectors, for settings with a frozen text encoder; without it CLIP is searched in the
    /// hub's cache.
    #[serde(alias = "clip")]
    text_encoder: Option<PathBuf>,
    /// Triplets recorded for inspection; training composes its own.
    #[serde(default = "default_triplets")]
    triplets: u64,
    #[serde(default)]
    pub(crate) ingest: IngestConfig,
    #[serde(default)]
    masks: MaskConfig,
    /// Optional stages.
    #[serde(default)]
    pub(crate) stages: Stages,
    /// Style pairs from labels.
    #[serde(default)]
    pairs: PairConfig,
    /// Values in place of the preset's for the composer.
    #[serde(default)]
    compose: Map<String, Value>,
    /// Values in place of the preset's for the editor.
    #[serde(default)]
    train: Map<String, Value>,
    /// Values in place of the preset's for the coordinator.
    #[serde(default)]
    coordinator: Map<String, Value>,
    /// Values in place of the preset's for the pose network.
    #[serde(default)]
    poses: Map<String, Value>,
    /// `"builtin"` for the encoder that ships with the program, or values in place of the preset's for one that is
    /// trained.
    #[serde(default)]
    pub(crate) encoder: EncoderConfig,
    /// Seeds of split, items, training and sampling.
    #[serde(default)]
    seeds: Seeds,
    /// Test questions.
    #[serde(default)]
    pub(crate) items: ItemConfig,
    #[serde(default)]
    pub(crate) edit: EditConfig,
    #[serde(default)]
    eval: Protocol,
}

/// Stages beside dataset, encoder and editor; each is skipped where the data do not allow it.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Stages {
    /// Style pairs, where motions have style labels.
    pairs: bool,
    /// A coordinator, and a row of the table that it guides; where there are motions of two sources.
    coordinator: bool,
    /// A pose network, which every system edits with.
    poses: bool,
    /// An editor trained on pairs that were composed once, and its row of the table.
    pub(crate) composed_once: bool,
    /// An editor trained on captured pairs alone, and its row of the table; where there are pairs.
    pub(crate) captured_alone: bool,
}

impl Default for Stages {
    fn default() -> Self {
        Self {
            pairs: true,
            coordinator: true,
            poses: true,
            composed_once: false,
            captured_alone: false,
        }
    }
}

fn default_preset() -> Preset {
    Preset::Tiny
}

fn default_triplets() -> u64 {
    64
}

impl RunConfig {
    /// The default settings for these sources.
    pub(crate) fn new(sources: Vec<SourceArg>, out: PathBuf) -> Self {
        Self {
            sources,
            out,
            preset: default_preset(),
            text_encoder: None,
            triplets: default_triplets(),
            ingest: IngestConfig::default(),
            masks: MaskConfig::default(),
            stages: Stages::default(),
            pairs: PairConfig::default(),
            compose: Map::new(),
            train: Map::new(),
            coordinator: Map::new(),
            poses: Map::new(),
            encoder: EncoderConfig::default(),
            seeds: Seeds::default(),
            items: ItemConfig::default(),
            edit: EditConfig::default(),
            eval: Protocol::default(),
        }
    }
}

/// A configuration with everything resolved.
pub(crate) struct Plan {
    config: RunConfig,
    pub(crate) compose: ComposeConfig,
    pub(crate) train: TrainConfig,
    pub(crate) coordinator: CoordinatorConfig,
    pub(crate) poses: J2sConfig,
    pub(crate) encoder: TmrConfig,
    /// Whether the built-in encoder evaluates, and none is trained.
    with_builtin: bool,
    pub(crate) title: String,
    pub(crate) commands: Vec<String>,
}

impl Plan {
    /// Resolves the presets and the seed.
    pub(crate) fn new(config: RunConfig, global: &Global) -> anyhow::Result<Self> {
        let preset = config.preset;
        let own = &config.train;
        let mut train = settings::over(&TrainConfig::preset(preset), "train", own)?;
        let own_encoder = &config.encoder.settings();
        let with_builtin = config.encoder.is_builtin();
        let mut encoder = settings::over(&TmrConfig::preset(preset), "encoder", own_encoder)?;
        let own = &config.coordinator;
        let mut coordinator =
            settings::over(&CoordinatorConfig::preset(preset), "coordinator", own)?;
        let mut poses = settings::over(&J2sConfig::of(preset), "poses", &config.poses)?;
        let seeds = config.seeds;
        for (seed, own) in [
            (&mut train.run.seed, &config.train),
            (&mut coordinator.run.seed, &config.coordinator),
            (&mut poses.run.seed, &config.poses),
            (&mut encoder.run.seed, own_encoder),
        ] {
            *seed = seeds.of_model(*seed, own, global).0;
        }
        let compose = &TrainConfig::compose_preset(preset);
        let compose = settings::over(compose, "compose", &config.compose)?;
        Ok(Self {
            config,
            compose,
            train,
            coordinator,
            poses,
            encoder,
            with_builtin,
            title: "stance run".to_owned(),
            commands: Vec::new(),
        })
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    args.trainings.choose()?;
    let mut config: RunConfig = settings::read(&args.config)?;
    let base = args.config.parent().unwrap_or(Path::new("."));
    let sources = config.sources.into_iter();
    config.sources = sources.map(|source| source.below(base)).collect();
    let files = [&mut config.out]
        .into_iter()
        .chain(&mut config.ingest.pairs);
    for path in files.chain(&mut config.text_encoder) {
        *path = base.join(&*path);
    }
    if config.sources.is_empty() {
        bail!("{} names no sources", args.config.display());
    }
    let mut plan = Plan::new(config, global).map_err(|error| settings::at(&args.config, error))?;
    let name = args
        .config
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    plan.commands = vec![format!(
        "stance run --config {name}{}",
        global.seed_option()
    )];
    finish(plan, &args.trainings, args.weak_judge, global)
}

/// Where the pieces of a run lie.
struct Places {
    dataset: PathBuf,
    triplets: PathBuf,
    editor: PathBuf,
    composed_once: PathBuf,
    captured_alone: PathBuf,
    coordinator: PathBuf,
    poses: PathBuf,
    encoder: PathBuf,
    items: PathBuf,
    edits: PathBuf,
    scores: PathBuf,
    report: PathBuf,
}

impl Places {
    fn under(out: &Path, with_builtin: bool) -> Self {
        Self {
            dataset: out.join("dataset"),
            triplets: out.join("triplets"),
            editor: out.join("runs/motionrefit"),
            composed_once: out.join("runs/composed-once"),
            captured_alone: out.join("runs/captured-alone"),
            coordinator: out.join("runs/coordinator"),
            poses: out.join("runs/j2s"),
            encoder: match with_builtin {
                true => BUILTIN.into(),
                false => out.join("runs/tmr"),
            },
            items: out.join("items"),
            edits: out.join("edits"),
            scores: out.join("scores"),
            report: out.join("report.html"),
        }
    }
}

/// Runs all stages; those already done are passed over.
pub(crate) fn finish(
    plan: Plan,
    trainings: &TrainingsArgs,
    weak_judge: WeakJudgeArgs,
    global: &Global,
) -> anyhow::Result<Exit> {
    let config = &plan.config;
    let places = Places::under(&config.out, plan.with_builtin);
    let ingested = make_dataset(&plan, &places, global)?;
    let dataset = Dataset::open(&places.dataset)?;
    let text_encoder = text_encoder(config.text_encoder.as_deref());
    let Some(trained) = train_all(&plan, &places, &text_encoder, trainings, global)? else {
        return Ok(stopped());
    };
    stages::items(
        &dataset,
        &places.items,
        Split::Test,
        &config.items,
        config.seeds.items(global),
        global,
    )
    .context("stage items")?;
    let tables = edit_all(&plan, &places, &trained, &text_encoder, global)?;
    let protocol = Protocol {
        seed: global.seed_or(Some(config.eval.seed.0)),
        ..config.eval
    };
    let edits = Answered::read_for_table(&tables)?;
    let runs = EvaluatorRuns {
        encoder: &places.encoder,
        coordinator: None,
    };
    let scores = stages::scores(&edits, &runs, &protocol, global).context("stage eval")?;
    scores
        .commit(&places.scores, &edits.skeleton, &global.holder())
        .context("stage eval")?;

    let unknown = stages::unknown_words(&tables)?;
    let done = Done {
        plan: &plan,
        seeds: config.seeds.in_words(global),
        ingested: &ingested,
        dataset: &dataset,
        encoder: trained.encoder.as_ref(),
        editor: &trained.editor,
        edits: &edits,
        unknown: &unknown,
        scores: &scores,
    };
    let html = page(&done, &places)?;
    local::write(&places.report, html.as_bytes())?;
    print(&done, &places, global)?;
    let exit = match ingested.accounting.quarantined {
        0 => Exit::Done,
        _ => Exit::Quarantined,
    };
    Ok(weak_judge.exit(scores.unranked(), exit))
}

/// Ingests the sources, and derives masks, pairs and recorded triplets from them.
fn make_dataset(plan: &Plan, places: &Places, global: &Global) -> anyhow::Result<IngestReport> {
    let config = &plan.config;
    let ingested = stages::ingested(
        &config.sources,
        &places.dataset,
        &config.ingest,
        config.seeds.split(global),
        global,
        &global.bars(),
    )
    .context("stage ingest")?;
    global
        .stage(|context| stage::masks(&places.dataset, &config.masks, Judged::Keep, None, context))
        .context("stage masks")?;
    if config.stages.pairs {
        global
            .stage(|context| {
                stage::pairs(
                    &places.dataset,
                    &config.pairs,
                    config.seeds.split(global),
                    None,
                    context,
                )
            })
            .context("stage pairs")?;
    }
    let recorded = Settings {
        kind: Kind::Triplets,
        count: config.triplets,
        config: plan.compose.clone(),
        seed: Seed(plan.train.run.seed),
        condition: None,
    };
    global
        .stage(|context| recording::record(&places.dataset, &places.triplets, &recorded, context))
        .context("stage triplets")?;
    Ok(ingested)
}

/// Answers the items with each system that is a row of the table. Returns their folders of edits.
fn edit_all(
    plan: &Plan,
    places: &Places,
    trained: &Trained,
    text_encoder: &TextEncoderSource,
    global: &Global,
) -> anyhow::Result<Vec<PathBuf>> {
    let config = &plan.config;
    let mut tables = Vec::new();
    let mut edit = |run: &Path, coordinator: Option<&Path>, folder: &str| {
        let source = SystemSource {
            coordinator: coordinator.map(Path::to_owned),
            poses: config.stages.poses.then(|| places.poses.clone()),
            ..SystemSource::best(run, text_encoder.clone())
        };
        let out = places.edits.join(folder);
        let seed = config.seeds.sample(global);
        stages::edits(&places.items, &source, &out, &config.edit, seed, global)
            .context("stage edit")?;
        tables.push(out);
        anyhow::Ok(())
    };
    if trained.is_guided {
        edit(&places.editor, Some(&places.coordinator), "full")?;
    }
    edit(&places.editor, None, "editor")?;
    if config.stages.composed_once {
        edit(&places.composed_once, None, "composed-once")?;
    }
    if trained.is_captured_alone {
        edit(&places.captured_alone, None, "captured-alone")?;
    }
    Ok(tables)
}

/// What training gives to the page.
struct Trained {
    editor: TrainReport,
    /// None where the built-in encoder evaluates.
    encoder: Option<TrainReport>,
    /// Whether there is a coordinator.
    is_guided: bool,
    /// Whether there is an editor of captured pairs alone.
    is_captured_alone: bool,
}

/// A model of a run.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Trains {
    Editor,
    ComposedOnce,
    CapturedAlone,
    Coordinator,
    Poses,
    Encoder,
}

/// Trains the models that are not trained yet. Returns none after an interrupt.
fn train_all(
    plan: &Plan,
    places: &Places,
    text_encoder: &TextEncoderSource,
    trainings: &TrainingsArgs,
    global: &Global,
) -> anyhow::Result<Option<Trained>> {
    let config = &plan.config;
    let is_guided = config.stages.coordinator && stage::can_coordinate(&places.dataset)?;
    if config.stages.coordinator && !is_guided {
        report::note("no coordinator: the training split holds motions of a single source");
    }
    let num_pairs = Dataset::open_unverified(&places.dataset)?
        .manifest()
        .rows(PairRow::TABLE, Some(Split::Train));
    let is_captured_alone = config.stages.captured_alone && num_pairs > 0;
    if config.stages.captured_alone && !is_captured_alone {
        report::note("no editor of captured pairs alone: the training split has no pairs");
    }
    // The longest come first, so that the last ones fill the time that is left.
    let wanted = [
        (Trains::Editor, true),
        (Trains::ComposedOnce, config.stages.composed_once),
        (Trains::CapturedAlone, is_captured_alone),
        (Trains::Coordinator, is_guided),
        (
            Trains::Poses,
            config.stages.poses && !places.poses.join("checkpoint").exists(),
        ),
        (Trains::Encoder, !plan.with_builtin),
    ];
    let wanted: Vec<Trains> = wanted
        .into_iter()
        .filter_map(|(model, is_wanted)| is_wanted.then_some(model))
        .collect();
    let at_once = trainings.at_once(config.preset);
    let reports = side_by_side(wanted.clone(), at_once, |model| {
        train_one(model, plan, places, text_encoder, global)
    })?;
    let Some(reports) = reports else {
        return Ok(None);
    };
    let report = |model| {
        let place = wanted.iter().position(|&of| of == model);
        place.and_then(|place| reports[place].clone())
    };
    Ok(Some(Trained {
        editor: report(Trains::Editor).expect("every run trains an editor"),
        encoder: report(Trains::Encoder),
        is_guided,
        is_captured_alone,
    }))
}

/// Trains one model. Returns none for a pose network, whose report is of another kind.
fn train_one(
    model: Trains,
    plan: &Plan,
    places: &Places,
    text_encoder: &TextEncoderSource,
    global: &Global,
) -> anyhow::Result<Option<TrainReport>> {
    let dataset = &Dataset::open(&places.dataset)?;
    let composed_once = ComposeConfig {
        fixed_pairs: true,
        ..plan.compose.clone()
    };
    let captured_alone = ComposeConfig {
        undonored_ratio: Some(1.0),
        kinds: vec![EditKind::Style, EditKind::FineGrained],
        ..plan.compose.clone()
    };
    let (name, run, compose) = match model {
        Trains::Editor => ("motionrefit", &places.editor, &plan.compose),
        Trains::ComposedOnce => ("motionrefit", &places.composed_once, &composed_once),
        Trains::CapturedAlone => ("motionrefit", &places.captured_alone, &captured_alone),
        Trains::Coordinator => ("coordinator", &places.coordinator, &plan.compose),
        Trains::Poses => ("j2s", &places.poses, &plan.compose),
        Trains::Encoder => ("tmr", &places.encoder, &plan.compose),
    };
    with_session(&global.bars().of(run), |session| match model {
        Trains::Editor | Trains::ComposedOnce | Trains::CapturedAlone => {
            let inputs = EditorInputs {
                compose,
                windows: None,
                text_encoder,
            };
            train_editor(dataset, run, &plan.train, &inputs, session).map(Some)
        }
        Trains::Coordinator => {
            train_coordinator(dataset, run, &plan.coordinator, compose, session).map(Some)
        }
        Trains::Poses => train_j2s(dataset, run, &plan.poses, session).map(|_| None),
        Trains::Encoder => train_encoder(dataset, run, &plan.encoder, session).map(Some),
    })
    .map_err(anyhow::Error::from)
    .and_then(|trained| {
        let is_complete = trained.as_ref().is_some_and(|report| report.is_complete);
        if model == Trains::Encoder && is_complete {
            report_on_encoder(dataset, run, Seed(plan.encoder.run.seed))?;
        }
        Ok(trained)
    })
    .with_context(|| format!("stage train {name}"))
}
