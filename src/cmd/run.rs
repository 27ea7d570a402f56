//! `stance run`

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use datasets_spec::manifest::Accounting;
use datasets_spec::record::{EditRow, MaskRow, MotionRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Seed, Split};
use eval::answers::{Answered, Scores};
use eval::draw::plot::{Bars, Curve, Plot, Scale};
use eval::format;
use eval::protocol::Protocol;
use eval::report::{Card, Chart, Details, Report, Strip};
use pipeline::annotation::masks::MaskConfig;
use pipeline::annotation::pairs::PairConfig;
use pipeline::compose::{ComposeConfig, ItemConfig};
use pipeline::ingest::{IngestReport, SourceArg};
use pipeline::recording::{self, Kind, Settings};
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

use crate::cmd::eval::tables;
use crate::cmd::page::{opening, strip_of};
use crate::evaluators::{EvaluatorRuns, WeakJudgeArgs, report_on_encoder};
use crate::exit::Exit;
use crate::global::Global;
use crate::judge::BUILTIN;
use crate::local;
use crate::seeds::Seeds;
use crate::session::{stopped, text_encoder, with_session};
use crate::trainings::{TrainingsArgs, side_by_side};
use crate::{report, settings, stages};

/// Run the whole chain on your own motions: build a dataset, train models on it, edit, and score the edits.
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
    /// Values in place of the preset's for the encoder.
    #[serde(default)]
    encoder: Map<String, Value>,
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
    /// An editor trained on fixed pairs, and its row of the table.
    pub(crate) without_mcm: bool,
}

impl Default for Stages {
    fn default() -> Self {
        Self {
            pairs: true,
            coordinator: true,
            poses: true,
            without_mcm: false,
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
            encoder: Map::new(),
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
    pub(crate) with_builtin: bool,
    pub(crate) title: String,
    pub(crate) commands: Vec<String>,
}

impl Plan {
    /// Resolves the presets and the seed.
    pub(crate) fn new(config: RunConfig, global: &Global) -> anyhow::Result<Self> {
        let preset = config.preset;
        let own = &config.train;
        let mut train = settings::over(&TrainConfig::preset(preset), "train", own)?;
        let own = &config.encoder;
        let mut encoder = settings::over(&TmrConfig::preset(preset), "encoder", own)?;
        let own = &config.coordinator;
        let mut coordinator =
            settings::over(&CoordinatorConfig::preset(preset), "coordinator", own)?;
        let mut poses = settings::over(&J2sConfig::of(preset), "poses", &config.poses)?;
        let seeds = config.seeds;
        for (seed, own) in [
            (&mut train.run.seed, &config.train),
            (&mut coordinator.run.seed, &config.coordinator),
            (&mut poses.run.seed, &config.poses),
            (&mut encoder.run.seed, &config.encoder),
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
            with_builtin: false,
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
    without_mcm: PathBuf,
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
            without_mcm: out.join("runs/without-mcm"),
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
    let bars = global.bars();

    let ingested = stages::ingested(
        &config.sources,
        &places.dataset,
        &config.ingest,
        config.seeds.split(global),
        global,
        &bars,
    )
    .context("stage ingest")?;
    global
        .stage(|context| stage::masks(&places.dataset, &config.masks, Judged::Keep, context))
        .context("stage masks")?;
    if config.stages.pairs {
        global
            .stage(|context| {
                stage::pairs(
                    &places.dataset,
                    &config.pairs,
                    config.seeds.split(global),
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
    };
    global
        .stage(|context| recording::record(&places.dataset, &places.triplets, &recorded, context))
        .context("stage triplets")?;
    let dataset = Dataset::open(&places.dataset)?;
    let text_encoder = text_encoder(config.text_encoder.as_deref());
    let Some(trained) = train_all(&plan, &places, &text_encoder, trainings, global)? else {
        return Ok(stopped());
    };
    stages::items(
        &places.dataset,
        &places.items,
        Split::Test,
        &config.items,
        config.seeds.items(global),
        global,
    )
    .context("stage items")?;
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
    if config.stages.without_mcm {
        edit(&places.without_mcm, None, "without-mcm")?;
    }
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

/// What training gives to the page.
struct Trained {
    editor: TrainReport,
    /// None where the built-in encoder evaluates.
    encoder: Option<TrainReport>,
    /// Whether there is a coordinator.
    is_guided: bool,
}

/// A model of a run.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Trains {
    Editor,
    WithoutMcm,
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
    // The longest come first, so that the last ones fill the time that is left.
    let wanted = [
        (Trains::Editor, true),
        (Trains::WithoutMcm, config.stages.without_mcm),
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
    let dataset = &places.dataset;
    let fixed_pairs = ComposeConfig {
        fixed_pairs: true,
        ..plan.compose.clone()
    };
    let (name, run, compose) = match model {
        Trains::Editor => ("motionrefit", &places.editor, &plan.compose),
        Trains::WithoutMcm => ("motionrefit", &places.without_mcm, &fixed_pairs),
        Trains::Coordinator => ("coordinator", &places.coordinator, &plan.compose),
        Trains::Poses => ("j2s", &places.poses, &plan.compose),
        Trains::Encoder => ("tmr", &places.encoder, &plan.compose),
    };
    with_session(&global.bars().of(run), |session| match model {
        Trains::Editor | Trains::WithoutMcm => {
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

/// Results of the stages.
struct Done<'a> {
    plan: &'a Plan,
    seeds: String,
    ingested: &'a IngestReport,
    dataset: &'a Dataset,
    encoder: Option<&'a TrainReport>,
    editor: &'a TrainReport,
    edits: &'a Answered,
    /// Words of the instructions that some system has never seen.
    unknown: &'a BTreeSet<String>,
    scores: &'a Scores,
}

/// The `--json` document.
#[derive(Serialize)]
struct Document<'a> {
    out: &'a Path,
    report: &'a Path,
    accounting: &'a Accounting,
    root_hash: &'a str,
    /// None where the built-in encoder evaluates.
    encoder: Option<&'a TrainReport>,
    editor: &'a TrainReport,
    scores: serde_json::Value,
}

fn print(done: &Done, places: &Places, global: &Global) -> anyhow::Result<()> {
    if global.json {
        return report::json(&Document {
            out: &done.plan.config.out,
            report: &places.report,
            accounting: &done.ingested.accounting,
            root_hash: &done.dataset.manifest().root_hash,
            encoder: done.encoder,
            editor: done.editor,
            scores: serde_json::from_str(&format::json::render(
                &done.scores.rows,
                &done.scores.judges,
            )?)?,
        });
    }
    report::text(&format::text::render(&tables(done.scores)));
    let lines = [
        ("dataset", &places.dataset),
        ("triplets", &places.triplets),
        ("encoder", &places.encoder),
        ("editor", &places.editor),
        ("items", &places.items),
        ("edits", &places.edits),
        ("scores", &places.scores),
        ("report", &places.report),
    ];
    let mut text = String::new();
    for (name, path) in lines {
        text += &format!("{name:<9} {}\n", path.display());
    }
    report::text(&text);
    Ok(())
}

/// Items shown as strips.
const STRIPS: usize = 6;

fn page(done: &Done, places: &Places) -> anyhow::Result<String> {
    let manifest = done.dataset.manifest();
    let accounting = &done.ingested.accounting;
    let rows = |table: &str, split| manifest.rows(table, split);
    let motions = rows(MotionRow::TABLE, None);
    let card = |label: &str, value: String, note: String| Card {
        label: label.to_owned(),
        value,
        note,
    };
    let loss = |loss: Option<f64>| loss.map_or("–".to_owned(), |loss| format!("{loss:.3}"));
    let cards = vec![
        card(
            "clips",
            motions.to_string(),
            format!(
                "{} quarantined, {} skipped",
                accounting.quarantined, accounting.skipped
            ),
        ),
        card(
            "masks",
            rows(MaskRow::TABLE, None).to_string(),
            String::new(),
        ),
        card(
            "editor steps",
            done.editor.steps.to_string(),
            format!(
                "loss {} → {}",
                loss(done.editor.first_loss),
                loss(done.editor.last_loss)
            ),
        ),
        card(
            "samples/s",
            format!("{:.0}", done.editor.samples_per_sec),
            format!(
                "{:.1} % waiting for data",
                100.0 * done.editor.data_wait_share
            ),
        ),
    ];
    let mut charts = vec![Chart::Lines(curves(
        &places.editor,
        "Editor: denoising loss",
        Scale::Log,
    )?)];
    if done.encoder.is_some() {
        let title = "Encoder of the evaluation";
        charts.push(Chart::Lines(curves(&places.encoder, title, Scale::Log)?));
    }
    charts.push(Chart::Bars(actions(done.dataset)?));
    let facts = vec![
        ("root hash".to_owned(), manifest.root_hash.clone()),
        (
            "format".to_owned(),
            format!("{} {}", manifest.format, manifest.schema_version),
        ),
        ("skeleton".to_owned(), manifest.skeleton.clone()),
        (
            "train / val / test".to_owned(),
            Split::ALL
                .map(|split| rows(MotionRow::TABLE, Some(split)).to_string())
                .join(" / "),
        ),
        (
            "sources".to_owned(),
            format!(
                "{} = {} ingested + {} quarantined + {} skipped",
                accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
            ),
        ),
    ];
    let settings = vec![
        ("stance".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("seeds".to_owned(), done.seeds.clone()),
    ];
    let config = &done.plan.config;
    let details = [
        ("Editor", serde_json::to_value(&done.plan.train)?),
        (
            "Encoder",
            match done.encoder {
                Some(_) => serde_json::to_value(&done.plan.encoder)?,
                None => BUILTIN.into(),
            },
        ),
        ("Stages", serde_json::to_value(config.stages)?),
        ("Composition", serde_json::to_value(&done.plan.compose)?),
        ("Items", serde_json::to_value(&config.items)?),
        ("Edits", serde_json::to_value(&config.edit)?),
        ("Evaluation", serde_json::to_value(config.eval)?),
    ];
    let details = details.map(|(title, value)| Details::of_json(title, &[("value", &value)]));
    let rows_of_items = done.edits.items.len();
    Ok(Report {
        title: done.plan.title.clone(),
        subtitle: format!(
            "{motions} clips, {} items, from source files to the table below",
            rows_of_items
        ),
        opening: opening(done.edits, done.unknown)?,
        cards,
        tables: tables(done.scores),
        figures: Vec::new(),
        charts,
        strips: strips(done)?,
        facts,
        settings,
        details: details.into(),
        commands: done.plan.commands.clone(),
    }
    .to_html())
}

fn curves(run: &Path, title: &str, y_scale: Scale) -> anyhow::Result<Plot> {
    let metrics = train::metrics::read(run)?;
    Ok(Plot {
        title: title.to_owned(),
        x_label: "step".to_owned(),
        y_label: "loss".to_owned(),
        y_scale,
        curves: vec![
            Curve {
                name: "training".to_owned(),
                points: metrics.loss,
                ..Curve::default()
            },
            Curve {
                name: "validation".to_owned(),
                points: metrics.val_loss,
                ..Curve::default()
            },
        ],
        ..Plot::default()
    })
}

fn actions(dataset: &Dataset) -> anyhow::Result<Bars> {
    let groups = pipeline::catalogue::catalogue(dataset)?.actions;
    Ok(Bars {
        title: "Clips by action".to_owned(),
        x_label: "action".to_owned(),
        bars: groups
            .into_iter()
            .map(|group| (group.label, group.clips as f64))
            .collect(),
    })
}

/// The first items of different parts, each as source, edit and target.
fn strips(done: &Done) -> anyhow::Result<Vec<Strip>> {
    let Answered {
        items,
        edits,
        skeleton,
    } = done.edits;
    let step = (items.len() / STRIPS).max(1);
    items
        .iter()
        .step_by(step)
        .take(STRIPS)
        .map(|item| {
            let made: Vec<&EditRow> = edits.iter().filter(|row| row.id == item.id).collect();
            strip_of(item, &made, skeleton, done.unknown)
        })
        .collect()
}
