//! `stance run`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use datasets_spec::manifest::Accounting;
use datasets_spec::record::{EditRow, ItemRow, MaskRow, MotionRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Seed, Split};
use eval::draw::plot::{Bars, Curve, Plot, Scale};
use eval::format;
use eval::protocol::Protocol;
use eval::report::{Card, Chart, Report, Strip};
use pipeline::compose::{ComposeConfig, ItemConfig};
use pipeline::ingest::IngestReport;
use pipeline::masks::MaskConfig;
use pipeline::pairs::PairConfig;
use serde::{Deserialize, Serialize};
use train::config::TrainConfig;
use train::fit::TrainReport;
use train::tmr::TmrConfig;

use crate::chain::{
    self, EditConfig, EditorSource, IngestConfig, Judged, Judges, Scores, TrainInputs,
};
use crate::cli::Global;
use crate::cmd::eval::tables;
use crate::cmd::page::strip_of;
use crate::exit::Exit;
use crate::report;

/// Run the whole chain on your own folders: ingest, masks, triplets, training, edits, table.
///
/// The configuration is a TOML file; every key but `sources` and `out` may be left out. Relative
/// paths are relative to the file. Interrupted and run again, it continues.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Configuration file
    #[arg(long)]
    config: PathBuf,
}

/// The configuration file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunConfig {
    /// Files and folders to ingest.
    sources: Vec<PathBuf>,
    /// Folder for everything the run makes.
    out: PathBuf,
    /// Named settings of the models.
    #[serde(default = "default_preset")]
    preset: String,
    /// Folder of the CLIP text encoder, for settings that listen to it; none looks into the hub's
    /// cache.
    clip: Option<PathBuf>,
    /// Triplets recorded for inspection; training composes its own.
    #[serde(default = "default_triplets")]
    triplets: u64,
    #[serde(default)]
    ingest: IngestConfig,
    #[serde(default)]
    masks: MaskConfig,
    /// Style pairs from labels; none without this section.
    pairs: Option<PairConfig>,
    #[serde(default)]
    compose: ComposeConfig,
    /// Values in place of the preset's for the editor.
    #[serde(default)]
    train: toml::Table,
    /// Values in place of the preset's for the encoder.
    #[serde(default)]
    encoder: toml::Table,
    /// Test questions.
    #[serde(default)]
    pub(crate) items: ItemConfig,
    #[serde(default)]
    pub(crate) edit: EditConfig,
    #[serde(default)]
    eval: Protocol,
}

fn default_preset() -> String {
    "tiny".to_owned()
}

fn default_triplets() -> u64 {
    64
}

impl RunConfig {
    /// The default settings for these sources.
    pub(crate) fn new(sources: Vec<PathBuf>, out: PathBuf) -> Self {
        Self {
            sources,
            out,
            preset: default_preset(),
            clip: None,
            triplets: default_triplets(),
            ingest: IngestConfig::default(),
            masks: MaskConfig::default(),
            pairs: None,
            compose: ComposeConfig::default(),
            train: toml::Table::new(),
            encoder: toml::Table::new(),
            items: ItemConfig::default(),
            edit: EditConfig::default(),
            eval: Protocol::default(),
        }
    }
}

/// A configuration with everything resolved.
pub(crate) struct Plan {
    config: RunConfig,
    pub(crate) train: TrainConfig,
    pub(crate) encoder: TmrConfig,
    pub(crate) title: String,
    pub(crate) commands: Vec<String>,
}

impl Plan {
    /// Resolves the presets and the seed.
    pub(crate) fn new(config: RunConfig, global: &Global) -> anyhow::Result<Self> {
        let preset = chain::preset(&config.preset)?;
        let mut train = chain::overlay(&TrainConfig::preset(preset), Some(&config.train))
            .context("section [train]")?;
        let mut encoder = chain::overlay(&TmrConfig::preset(preset), Some(&config.encoder))
            .context("section [encoder]")?;
        train.seed = global.seed().0;
        encoder.seed = global.seed().0;
        Ok(Self {
            config,
            train,
            encoder,
            title: "stance run".to_owned(),
            commands: Vec::new(),
        })
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let text = std::fs::read_to_string(&args.config)
        .with_context(|| format!("cannot read {}", args.config.display()))?;
    let mut config: RunConfig =
        toml::from_str(&text).with_context(|| format!("in {}", args.config.display()))?;
    let base = args.config.parent().unwrap_or(Path::new("."));
    let folders = config.sources.iter_mut().chain([&mut config.out]);
    for path in folders.chain(&mut config.clip) {
        *path = base.join(&*path);
    }
    if config.sources.is_empty() {
        bail!("{} names no sources", args.config.display());
    }
    let mut plan = Plan::new(config, global)?;
    let name = args
        .config
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    plan.commands = vec![format!(
        "stance run --config {name} --seed {}",
        global.seed().0
    )];
    finish(plan, global)
}

/// Where the pieces of a run lie.
struct Places {
    dataset: PathBuf,
    triplets: PathBuf,
    editor: PathBuf,
    encoder: PathBuf,
    items: PathBuf,
    edits: PathBuf,
    scores: PathBuf,
    report: PathBuf,
}

impl Places {
    fn under(out: &Path) -> Self {
        Self {
            dataset: out.join("dataset"),
            triplets: out.join("triplets"),
            editor: out.join("runs/motionrefit"),
            encoder: out.join("runs/tmr"),
            items: out.join("items"),
            edits: out.join("edits"),
            scores: out.join("scores"),
            report: out.join("report.html"),
        }
    }
}

/// Runs all stages; those already done are passed over.
pub(crate) fn finish(plan: Plan, global: &Global) -> anyhow::Result<Exit> {
    let config = &plan.config;
    let places = Places::under(&config.out);
    let bars = global.bars();
    let seed = global.seed();

    let ingested = chain::ingested(
        &config.sources,
        &places.dataset,
        &config.ingest,
        global,
        &bars,
    )
    .context("stage ingest")?;
    chain::masks(&places.dataset, &config.masks, Judged::Keep, global, &bars)
        .context("stage masks")?;
    if let Some(pairs) = &config.pairs {
        chain::pairs(&places.dataset, pairs, global, &bars).context("stage pairs")?;
    }
    chain::triplets(
        &places.dataset,
        &places.triplets,
        config.triplets,
        &config.compose,
        global,
        &bars,
    )
    .context("stage triplets")?;
    // The range of model units is stored with the dataset by now.
    let dataset = Dataset::open(&places.dataset)?;
    let encoder = chain::train_encoder(&places.dataset, &places.encoder, &plan.encoder, &bars)
        .context("stage train tmr")?;
    if chain::is_stopped() {
        return Ok(stopped());
    }
    let editor = chain::train_editor(
        &places.dataset,
        &places.editor,
        &plan.train,
        &TrainInputs {
            compose: &config.compose,
            windows: None,
            clip: config.clip.as_deref(),
        },
        seed,
        &bars,
    )
    .context("stage train motionrefit")?;
    if chain::is_stopped() {
        return Ok(stopped());
    }
    chain::items(
        &places.dataset,
        &places.items,
        Split::Test,
        &config.items,
        seed,
        global,
    )
    .context("stage items")?;
    let (edits, _) = chain::edits(
        &places.items,
        &EditorSource {
            clip: config.clip.as_deref(),
            ..EditorSource::best(&places.editor)
        },
        &places.edits,
        &config.edit,
        seed,
        global,
        &bars,
    )
    .context("stage edit")?;
    let protocol = Protocol {
        seed,
        ..config.eval
    };
    let scores = chain::scores(
        std::slice::from_ref(&places.edits),
        &Judges {
            encoder: &places.encoder,
            coordinator: None,
        },
        &protocol,
        &bars,
    )
    .context("stage eval")?;
    let skeleton = &dataset.skeleton()?;
    chain::commit_scores(&places.scores, &scores, skeleton, global).context("stage eval")?;

    let done = Done {
        plan: &plan,
        seed,
        ingested: &ingested,
        dataset: &dataset,
        encoder: &encoder,
        editor: &editor,
        edits: &edits,
        scores: &scores,
    };
    let html = page(&done, &places)?;
    std::fs::write(&places.report, html)
        .with_context(|| format!("cannot write {}", places.report.display()))?;
    print(&done, &places, global)?;
    Ok(if ingested.accounting.quarantined > 0 {
        Exit::Quarantined
    } else {
        Exit::Done
    })
}

/// Says that an interrupt ended the run between two stages.
fn stopped() -> Exit {
    report::note("stopped and saved; the same command goes on from here");
    Exit::Interrupted
}

/// What the stages came to.
struct Done<'a> {
    plan: &'a Plan,
    seed: Seed,
    ingested: &'a IngestReport,
    dataset: &'a Dataset,
    encoder: &'a TrainReport,
    editor: &'a TrainReport,
    edits: &'a Dataset,
    scores: &'a Scores,
}

/// The `--json` document.
#[derive(Serialize)]
struct Document<'a> {
    out: &'a Path,
    report: &'a Path,
    accounting: &'a Accounting,
    root_hash: &'a str,
    encoder: &'a TrainReport,
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
            scores: serde_json::from_str(&format::json::render(&done.scores.rows)?)?,
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
    let charts = vec![
        Chart::Lines(curves(
            &places.editor,
            "Editor: denoising loss",
            Scale::Log,
        )?),
        Chart::Lines(curves(
            &places.encoder,
            "Encoder of the evaluation",
            Scale::Log,
        )?),
        Chart::Bars(actions(done.dataset)?),
    ];
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
        ("seed".to_owned(), done.seed.0.to_string()),
        (
            "editor".to_owned(),
            serde_json::to_string(&done.plan.train)?,
        ),
        (
            "encoder".to_owned(),
            serde_json::to_string(&done.plan.encoder)?,
        ),
        (
            "composition".to_owned(),
            serde_json::to_string(&done.plan.config.compose)?,
        ),
        (
            "items".to_owned(),
            serde_json::to_string(&done.plan.config.items)?,
        ),
        (
            "edits".to_owned(),
            serde_json::to_string(&done.plan.config.edit)?,
        ),
    ];
    let rows_of_items = done.edits.manifest().rows(ItemRow::TABLE, None);
    Ok(Report {
        title: done.plan.title.clone(),
        subtitle: format!(
            "{motions} clips, {} items, from source files to the table below",
            rows_of_items
        ),
        cards,
        tables: tables(done.scores),
        charts,
        strips: strips(done)?,
        facts,
        settings,
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
            },
            Curve {
                name: "validation".to_owned(),
                points: metrics.val_loss,
            },
        ],
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
    let items: Vec<ItemRow> = done.edits.read(None)?;
    let edits: Vec<EditRow> = done.edits.read(None)?;
    let skeleton = chain::skeleton_of(done.edits)?;
    let step = (items.len() / STRIPS).max(1);
    items
        .iter()
        .step_by(step)
        .take(STRIPS)
        .map(|item| {
            let made: Vec<&EditRow> = edits.iter().filter(|row| row.id == item.id).collect();
            strip_of(item, &made, &skeleton)
        })
        .collect()
}
