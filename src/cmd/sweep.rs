//! `stance sweep`

use std::path::{Path, PathBuf};

use anyhow::Context;
use datasets_spec::manifest::plan_hash;
use datasets_spec::record::ScoreRow;
use datasets_spec::{Dataset, Split};
use eval::answers::Answered;
use eval::metric::retrieval::E2T_AVERAGE_RANK;
use eval::metric::{self, Metric};
use eval::protocol::Protocol;
use eval::sweep::{Axis, Point, Sections, collected, drawing, points};
use pipeline::compose::{ComposeConfig, ItemConfig};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use train::config::{Preset, TrainConfig};
use train::stage::editor::{EditorInputs, train_editor};
use train::stage::encoder::train_encoder;
use train::system::{EditConfig, SystemSource};
use train::tmr::TmrConfig;

use crate::device::TrainDeviceArgs;
use crate::evaluators::EvaluatorRuns;
use crate::exit::Exit;
use crate::global::Global;
use crate::seeds::Seeds;
use crate::session::{is_stopped, stopped, text_encoder, with_session};
use crate::{report, settings, stages};

/// Run an ablation: train, edit and score at every point of a plan, and draw the curves.
///
/// The plan is a TOML file: a dataset, a folder for the results, settings in place of the preset's,
/// and axes along which one or two of them change. Points that differ only in how they edit share a
/// training. Interrupted and run again, the sweep continues where it stopped.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The plan
    plan: PathBuf,
    /// Check the plan, and list its points without running them
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    device: TrainDeviceArgs,
}

/// The plan as its file holds it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Plan {
    /// Dataset with masks.
    dataset: PathBuf,
    /// Folder for trainings, edits, scores and drawings.
    out: PathBuf,
    /// Run folder of the encoder; without it one is trained under `out`.
    encoder: Option<PathBuf>,
    /// Run folder of the coordinator that guides the editor.
    coordinator: Option<PathBuf>,
    /// Folder of CLIP, for settings that use it.
    #[serde(alias = "clip")]
    text_encoder: Option<PathBuf>,
    #[serde(default = "tiny")]
    preset: Preset,
    /// Metrics that are drawn.
    #[serde(default = "drawn")]
    metrics: Vec<String>,
    /// Split the points are scored on. The default is not the test split, because a sweep chooses by it.
    #[serde(default = "validation")]
    split: Split,
    /// Test questions, the same at every point.
    #[serde(default)]
    items: ItemConfig,
    #[serde(default)]
    train: Map<String, Value>,
    #[serde(default)]
    compose: Map<String, Value>,
    #[serde(default)]
    edit: Map<String, Value>,
    /// Seeds of items, training and sampling.
    #[serde(default)]
    seeds: Seeds,
    #[serde(default)]
    eval: Protocol,
    #[serde(rename = "axis")]
    axes: Vec<Axis>,
}

fn tiny() -> Preset {
    Preset::Tiny
}

fn validation() -> Split {
    Split::Val
}

fn drawn() -> Vec<String> {
    vec![E2T_AVERAGE_RANK.name.to_owned()]
}

/// Settings of a point, resolved.
#[derive(Clone, Debug, Serialize)]
struct Settings {
    train: TrainConfig,
    compose: ComposeConfig,
    edit: EditConfig,
}

impl Plan {
    fn read(path: &Path) -> anyhow::Result<Self> {
        let mut plan: Self = settings::read(path)?;
        let base = path.parent().unwrap_or(Path::new("."));
        let folders = [&mut plan.dataset, &mut plan.out];
        let optional = [
            &mut plan.encoder,
            &mut plan.coordinator,
            &mut plan.text_encoder,
        ];
        for folder in folders.into_iter().chain(optional.into_iter().flatten()) {
            *folder = base.join(&*folder);
        }
        Ok(plan)
    }

    fn metrics(&self) -> anyhow::Result<Vec<&'static Metric>> {
        self.metrics
            .iter()
            .map(|name| {
                metric::from_name(name).with_context(|| {
                    let known: Vec<&str> = metric::ALL.iter().map(|metric| metric.name).collect();
                    format!(
                        "there is no metric {name:?}; there are: {}",
                        known.join(", ")
                    )
                })
            })
            .collect()
    }

    /// The points, and the settings of each.
    fn points(&self, global: &Global) -> anyhow::Result<Vec<(Point, Settings)>> {
        let own: Sections = [
            ("train", &self.train),
            ("compose", &self.compose),
            ("edit", &self.edit),
        ]
        .map(|(name, own)| (name, Value::Object(own.clone())))
        .into();
        points(&self.axes, &own)?
            .into_iter()
            .map(|point| {
                let settings = self
                    .settings(&point, global)
                    .with_context(|| format!("point {}", point.name()))?;
                Ok((point, settings))
            })
            .collect()
    }

    fn settings(&self, point: &Point, global: &Global) -> anyhow::Result<Settings> {
        let own = |section: &str| match &point.sections[section] {
            Value::Object(own) => own.clone(),
            _ => Map::new(),
        };
        let preset = &TrainConfig::preset(self.preset);
        let mut train = settings::over(preset, "train", &own("train"))?;
        // A point of an axis over the seed keeps its own.
        if !point.changes.iter().any(|(key, _)| key == "train.seed") {
            train.run.seed = self.seeds.of_model(train.run.seed, &self.train, global).0;
        }
        let compose = &TrainConfig::compose_preset(self.preset);
        Ok(Settings {
            train,
            compose: settings::over(compose, "compose", &own("compose"))?,
            edit: settings::over(&EditConfig::default(), "edit", &own("edit"))?,
        })
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    args.device.choose()?;
    let plan = Plan::read(&args.plan)?;
    let metrics = plan.metrics()?;
    let (points, settings): (Vec<Point>, Vec<Settings>) = plan.points(global)?.into_iter().unzip();
    if args.dry_run {
        let names: Vec<String> = points.iter().map(Point::name).collect();
        if global.json {
            report::json(&names)?;
        } else {
            report::text(&names.join("\n"));
        }
        return Ok(Exit::Done);
    }

    let bars = global.bars();
    let encoder = match &plan.encoder {
        Some(run) => run.clone(),
        None => {
            let run = plan.out.join("encoder");
            let mut config = TmrConfig::preset(plan.preset);
            config.run.seed = plan.seeds.train(global).0;
            with_session(&bars, |session| {
                train_encoder(&plan.dataset, &run, &config, session)
            })
            .context("encoder")?;
            run
        }
    };
    let items = plan.out.join("items");
    let seed = plan.seeds.items(global);
    stages::items(&plan.dataset, &items, plan.split, &plan.items, seed, global).context("items")?;
    let mut scored: Vec<Vec<ScoreRow>> = Vec::with_capacity(points.len());
    let mut failed: Vec<String> = Vec::new();
    for (number, (point, settings)) in points.iter().zip(&settings).enumerate() {
        let name = point.name();
        if is_stopped() {
            return Ok(stopped());
        }
        report::note(&format!("point {} of {}: {name}", number + 1, points.len()));
        match at_point(&plan, settings, &items, &encoder, global) {
            Ok(Some(rows)) => scored.push(rows),
            Ok(None) => return Ok(stopped()),
            // An interrupt or a lock ends the sweep; another failure leaves out the point alone.
            Err(error) if Exit::of_error(&error) != Exit::Failed => return Err(error.context(name)),
            Err(error) => {
                report::error(&error.context(format!("point {name}")));
                scored.push(Vec::new());
                failed.push(name);
            }
        }
    }

    let collected = collected(&plan.axes, &points, &scored);
    let document = plan.out.join("sweep.json");
    write(&document, &serde_json::to_vec_pretty(&collected)?)?;
    let mut written = vec![document];
    for (index, axis) in plan.axes.iter().enumerate() {
        for &metric in &metrics {
            let svg = drawing(&plan.axes, index, metric, &points, &scored);
            let name: String = format!("{}-{}", axis.name, metric.name)
                .chars()
                .map(|c| if c.is_alphanumeric() { c } else { '-' })
                .collect();
            let path = plan.out.join(format!("{}.svg", name.to_lowercase()));
            write(&path, svg.as_bytes())?;
            written.push(path);
        }
    }
    if global.json {
        report::json(&collected)?;
    } else {
        let lines: Vec<String> = written
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        report::text(&lines.join("\n"));
    }
    if failed.is_empty() {
        return Ok(Exit::Done);
    }
    report::note(&format!(
        "{} of {} points failed and are missing: {}; the others are written, and the same command \
         tries these again",
        failed.len(),
        points.len(),
        failed.join("; ")
    ));
    Ok(Exit::Failed)
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Name of a folder: a hash of the settings.
fn short<T: Serialize>(settings: &T) -> String {
    format!("{:.12}", plan_hash("sweep", settings))
}

/// Trains, edits and scores at a point, except what is there already. `None` if an interrupt ended the
/// training.
fn at_point(
    plan: &Plan,
    settings: &Settings,
    items: &Path,
    encoder: &Path,
    global: &Global,
) -> anyhow::Result<Option<Vec<ScoreRow>>> {
    let Settings {
        train,
        compose,
        edit,
    } = settings;
    let training = short(&(train, compose));
    let asked = Dataset::open_unverified(items)?
        .manifest()
        .root_hash
        .clone();
    let seed = plan.seeds.sample(global);
    let editing = short(&(&training, edit, &plan.coordinator, asked, seed));
    let run = plan.out.join("runs").join(&training);
    let edits = plan.out.join("edits").join(&editing);
    let protocol = Protocol {
        seed: global.seed_or(Some(plan.eval.seed.0)),
        ..plan.eval
    };
    let measured = short(&(&editing, protocol, encoder));
    let scores = plan.out.join("scores").join(measured);
    if let Ok(done) = Dataset::open(&scores) {
        return Ok(Some(done.read::<ScoreRow>(None)?));
    }
    let text_encoder = text_encoder(plan.text_encoder.as_deref());
    let inputs = EditorInputs {
        compose,
        windows: None,
        text_encoder: &text_encoder,
    };
    with_session(&global.bars(), |session| {
        train_editor(&plan.dataset, &run, train, &inputs, session)
    })?;
    if is_stopped() {
        return Ok(None);
    }
    let source = SystemSource {
        coordinator: plan.coordinator.clone(),
        ..SystemSource::best(&run, text_encoder)
    };
    stages::edits(items, &source, &edits, edit, seed, global)?;
    let runs = EvaluatorRuns {
        encoder,
        coordinator: None,
    };
    let answered = Answered::read_for_table(&[edits])?;
    let found = stages::scores(&answered, &runs, &protocol, global)?;
    found.commit(&scores, &answered.skeleton, &global.holder())?;
    Ok(Some(found.rows))
}
