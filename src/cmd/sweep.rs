//! `stance sweep`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use datasets_spec::record::ScoreRow;
use datasets_spec::{Dataset, Split};
use eval::draw::plot::{Curve, HeatMap, Plot, Scale, heat_map, plot};
use eval::metric::retrieval::E2T_AVERAGE_RANK;
use eval::metric::{self, Metric};
use eval::names::{ALL_TASKS, IDENTITY, NOISE_FLOOR, REAL_DATA};
use eval::protocol::Protocol;
use pipeline::compose::{ComposeConfig, ItemConfig};
use serde::{Deserialize, Serialize};
use train::config::TrainConfig;
use train::tmr::TmrConfig;

use crate::chain::{self, EditConfig, EditorSource, EvaluatorRuns, Scores, TrainInputs};
use crate::cli::Global;
use crate::exit::Exit;
use crate::report;
use crate::seeds::Seeds;

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
    /// Folder of CLIP, where the settings listen to it.
    clip: Option<PathBuf>,
    #[serde(default = "tiny")]
    preset: String,
    /// Metrics that are drawn.
    #[serde(default = "drawn")]
    metrics: Vec<String>,
    /// Split the points are scored on: what a sweep chooses by is no test set.
    #[serde(default = "validation")]
    split: Split,
    /// Test questions, the same at every point.
    #[serde(default)]
    items: ItemConfig,
    #[serde(default)]
    train: toml::Table,
    #[serde(default)]
    compose: toml::Table,
    #[serde(default)]
    edit: toml::Table,
    /// Seeds of items, training and sampling.
    #[serde(default)]
    seeds: Seeds,
    #[serde(default)]
    eval: Protocol,
    #[serde(rename = "axis")]
    axes: Vec<Axis>,
}

fn tiny() -> String {
    "tiny".to_owned()
}

fn validation() -> Split {
    Split::Val
}

fn drawn() -> Vec<String> {
    vec![E2T_AVERAGE_RANK.name.to_owned()]
}

/// Settings that change together along one or two lists.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Axis {
    /// Names the drawing.
    name: String,
    /// The setting, such as `compose.mcm_ratio`, and its values.
    key: String,
    values: Vec<toml::Value>,
    /// A second setting; every pair of values is a point.
    second_key: Option<String>,
    #[serde(default)]
    second_values: Vec<toml::Value>,
}

/// Sections a setting can be in.
const SECTIONS: [&str; 3] = ["train", "compose", "edit"];

/// Settings of a point, resolved.
#[derive(Clone, Debug, Serialize)]
struct Settings {
    train: TrainConfig,
    compose: ComposeConfig,
    edit: EditConfig,
}

/// A point of the plan.
struct Point {
    /// Place in the list of axes; none for the settings without any change.
    axis: Option<usize>,
    /// The values on the axis.
    at: Vec<toml::Value>,
    settings: Settings,
}

impl Point {
    fn name(&self, axes: &[Axis]) -> String {
        let Some(axis) = self.axis.map(|axis| &axes[axis]) else {
            return "unchanged".to_owned();
        };
        let keys = std::iter::once(&axis.key).chain(&axis.second_key);
        let parts: Vec<String> = keys
            .zip(&self.at)
            .map(|(key, value)| format!("{key} = {value}"))
            .collect();
        parts.join(", ")
    }
}

/// A row of the collected scores.
#[derive(Serialize)]
struct Collected<'a> {
    point: String,
    axis: Option<&'a str>,
    values: Vec<toml::Value>,
    system: &'a str,
    task: &'a str,
    metric: &'a str,
    n: u32,
    mean: f64,
    ci95: Option<f64>,
}

impl Plan {
    fn read(path: &Path) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let mut plan: Self =
            toml::from_str(&text).with_context(|| format!("in {}", path.display()))?;
        let base = path.parent().unwrap_or(Path::new("."));
        let folders = [&mut plan.dataset, &mut plan.out];
        let optional = [&mut plan.encoder, &mut plan.coordinator, &mut plan.clip];
        for folder in folders.into_iter().chain(optional.into_iter().flatten()) {
            *folder = base.join(&*folder);
        }
        Ok(plan)
    }

    fn settings(
        &self,
        changes: &[(&str, &toml::Value)],
        global: &Global,
    ) -> anyhow::Result<Settings> {
        let mut sections: BTreeMap<&str, toml::Value> = [
            ("train", &self.train),
            ("compose", &self.compose),
            ("edit", &self.edit),
        ]
        .map(|(name, own)| (name, toml::Value::Table(own.clone())))
        .into();
        for (key, value) in changes {
            let (section, setting) = key.split_once('.').unwrap_or((key, ""));
            let Some(section) = sections.get_mut(section).filter(|_| !setting.is_empty()) else {
                bail!(
                    "{key:?} is no setting: it must begin with one of {}, such as \
                     compose.mcm_ratio",
                    SECTIONS.join(", ")
                );
            };
            let nested = setting.rsplit('.').fold((*value).clone(), |inner, name| {
                toml::Value::Table([(name.to_owned(), inner)].into_iter().collect())
            });
            chain::merge(section, &nested);
        }
        let own = |section: &str| sections[section].as_table();
        let preset = chain::preset(&self.preset)?;
        let mut train = chain::overlay(&TrainConfig::preset(preset), own("train"))
            .context("section [train]")?;
        // A point of an axis over the seed keeps its own.
        if !changes.iter().any(|(key, _)| *key == "train.seed") {
            train.seed = self.seeds.of_model(train.seed, &self.train, global).0;
        }
        Ok(Settings {
            train,
            compose: chain::overlay(&TrainConfig::compose_preset(preset), own("compose"))
                .context("section [compose]")?,
            edit: chain::overlay(&EditConfig::default(), own("edit")).context("section [edit]")?,
        })
    }

    fn points(&self, global: &Global) -> anyhow::Result<Vec<Point>> {
        let mut points = vec![Point {
            axis: None,
            at: Vec::new(),
            settings: self.settings(&[], global)?,
        }];
        for (index, axis) in self.axes.iter().enumerate() {
            if axis.second_key.is_some() == axis.second_values.is_empty() {
                bail!(
                    "axis {:?} needs second_key and second_values together",
                    axis.name
                );
            }
            for value in &axis.values {
                let seconds: Vec<Option<&toml::Value>> = match &axis.second_key {
                    Some(_) => axis.second_values.iter().map(Some).collect(),
                    None => vec![None],
                };
                for second in seconds {
                    let mut changes = vec![(axis.key.as_str(), value)];
                    changes.extend(axis.second_key.as_deref().zip(second));
                    let settings = self
                        .settings(&changes, global)
                        .with_context(|| format!("axis {:?}", axis.name))?;
                    points.push(Point {
                        axis: Some(index),
                        at: changes.iter().map(|(_, value)| (*value).clone()).collect(),
                        settings,
                    });
                }
            }
        }
        Ok(points)
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let plan = Plan::read(&args.plan)?;
    let metrics: Vec<&Metric> = plan
        .metrics
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
        .collect::<anyhow::Result<_>>()?;
    let points = plan.points(global)?;
    if args.dry_run {
        let names: Vec<String> = points.iter().map(|point| point.name(&plan.axes)).collect();
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
            let mut config = TmrConfig::preset(chain::preset(&plan.preset)?);
            config.seed = plan.seeds.train(global).0;
            chain::train_encoder(&plan.dataset, &run, &config, &bars).context("encoder")?;
            run
        }
    };
    let items = plan.out.join("items");
    let seed = plan.seeds.items(global);
    chain::items(&plan.dataset, &items, plan.split, &plan.items, seed, global).context("items")?;
    let mut scored: Vec<Vec<ScoreRow>> = Vec::with_capacity(points.len());
    let mut failed: Vec<String> = Vec::new();
    for (number, point) in points.iter().enumerate() {
        let name = point.name(&plan.axes);
        if chain::is_stopped() {
            report::note("stopped and saved; the same command goes on from here");
            return Ok(Exit::Interrupted);
        }
        report::note(&format!("point {} of {}: {name}", number + 1, points.len()));
        match at_point(&plan, point, &items, &encoder, global) {
            Ok(Some(rows)) => scored.push(rows),
            Ok(None) => {
                report::note("stopped and saved; the same command goes on from here");
                return Ok(Exit::Interrupted);
            }
            // What stops the program stops the sweep; what a point cannot do is its own affair.
            Err(error) if Exit::of_error(&error) != Exit::Failed => return Err(error.context(name)),
            Err(error) => {
                report::error(&error.context(format!("point {name}")));
                scored.push(Vec::new());
                failed.push(name);
            }
        }
    }

    let collected: Vec<Collected<'_>> = points
        .iter()
        .zip(&scored)
        .flat_map(|(point, rows)| {
            rows.iter().map(|row| Collected {
                point: point.name(&plan.axes),
                axis: point.axis.map(|axis| plan.axes[axis].name.as_str()),
                values: point.at.clone(),
                system: &row.system,
                task: &row.task,
                metric: &row.metric,
                n: row.n,
                mean: row.mean,
                ci95: row.ci95,
            })
        })
        .collect();
    let document = plan.out.join("sweep.json");
    write(&document, &serde_json::to_vec_pretty(&collected)?)?;
    let mut written = vec![document];
    for (index, axis) in plan.axes.iter().enumerate() {
        for &metric in &metrics {
            let svg = drawing(axis, index, metric, &points, &scored);
            let name = format!("{}-{}", axis.name, metric.name);
            let name: String = name
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

/// Names a folder by the settings behind it.
fn short<T: Serialize>(settings: &T) -> anyhow::Result<String> {
    Ok(format!("{:.12}", chain::plan("sweep", settings)?))
}

/// Trains, edits and scores at a point, passing over what is there already; none where an interrupt
/// ended the training.
fn at_point(
    plan: &Plan,
    point: &Point,
    items: &Path,
    encoder: &Path,
    global: &Global,
) -> anyhow::Result<Option<Vec<ScoreRow>>> {
    let bars = global.bars();
    let Settings {
        train,
        compose,
        edit,
    } = &point.settings;
    let training = short(&(train, compose))?;
    let asked = Dataset::open_unverified(items)?
        .manifest()
        .root_hash
        .clone();
    let seed = plan.seeds.sample(global);
    let editing = short(&(&training, edit, &plan.coordinator, asked, seed))?;
    let run = plan.out.join("runs").join(&training);
    let edits = plan.out.join("edits").join(&editing);
    let protocol = Protocol {
        seed: global.seed_or(Some(plan.eval.seed.0)),
        ..plan.eval
    };
    let measured = short(&(&editing, protocol, encoder))?;
    let scores = plan.out.join("scores").join(measured);
    if let Ok(done) = Dataset::open(&scores) {
        return Ok(Some(done.read::<ScoreRow>(None)?));
    }
    let inputs = TrainInputs {
        compose,
        windows: None,
        clip: plan.clip.as_deref(),
    };
    chain::train_editor(&plan.dataset, &run, train, &inputs, &bars)?;
    if chain::is_stopped() {
        return Ok(None);
    }
    let source = EditorSource {
        coordinator: plan.coordinator.as_deref(),
        clip: plan.clip.as_deref(),
        ..EditorSource::best(&run)
    };
    chain::edits(items, &source, &edits, edit, seed, global, &bars)?;
    let runs = EvaluatorRuns {
        encoder,
        coordinator: None,
    };
    let found: Scores = chain::scores(std::slice::from_ref(&edits), &runs, &protocol, &bars)?;
    let skeleton = chain::skeleton_of(&Dataset::open_unverified(items)?)?;
    chain::commit_scores(&scores, &found, &skeleton, global)?;
    Ok(Some(found.rows))
}

/// The curve of an axis, or the heat map of a pair of them. As in the paper's Figures 6 and A1 a
/// point is the value over all tasks.
fn drawing(
    axis: &Axis,
    index: usize,
    metric: &Metric,
    points: &[Point],
    scored: &[Vec<ScoreRow>],
) -> String {
    let value = |rows: &[ScoreRow], wanted: &dyn Fn(&str) -> bool| -> (f64, f64) {
        let of_metric = |row: &&ScoreRow| row.metric == metric.name && wanted(&row.system);
        let mut found = rows.iter().filter(of_metric);
        // With one kind of edit alone there is no task of all.
        let all = found.clone().find(|row| row.task == ALL_TASKS);
        all.or_else(|| found.next())
            .map_or((f64::NAN, f64::NAN), |row| {
                (row.mean, row.ci95.unwrap_or(f64::NAN))
            })
    };
    let is_edited = |system: &str| ![REAL_DATA, IDENTITY, NOISE_FLOOR].contains(&system);
    let on_axis: Vec<(&Point, (f64, f64))> = points
        .iter()
        .zip(scored)
        .filter(|(point, _)| point.axis == Some(index))
        .map(|(point, rows)| (point, value(rows, &is_edited)))
        .collect();
    let title = format!(
        "{}: {metric} {}",
        axis.name,
        (metric.better)(ALL_TASKS).arrow()
    );
    if let Some(second) = &axis.second_key {
        let label = |value: &toml::Value| value.to_string();
        return heat_map(&HeatMap {
            title,
            x: (
                second.clone(),
                axis.second_values.iter().map(label).collect(),
            ),
            y: (axis.key.clone(), axis.values.iter().map(label).collect()),
            values: on_axis.into_iter().map(|(_, (mean, _))| mean).collect(),
        });
    }
    let number = |value: &toml::Value| match value {
        toml::Value::Integer(value) => Some(*value as f64),
        toml::Value::Float(value) => Some(*value),
        _ => None,
    };
    // Values that are no numbers stand side by side under their names.
    let numbers: Option<Vec<f64>> = on_axis
        .iter()
        .map(|(point, _)| number(&point.at[0]))
        .collect();
    let x_names: Vec<String> = match numbers {
        Some(_) => Vec::new(),
        None => on_axis
            .iter()
            .map(|(point, _)| named(&point.at[0]))
            .collect(),
    };
    let places = numbers.unwrap_or_else(|| (0..on_axis.len()).map(|at| at as f64).collect());
    // Nothing edits in its row, so that any point that was scored has it.
    let (identity, _) = scored
        .iter()
        .find(|rows| !rows.is_empty())
        .map_or((f64::NAN, f64::NAN), |rows| {
            value(rows, &|system| system == IDENTITY)
        });
    plot(&Plot {
        title,
        x_label: axis.key.clone(),
        x_names,
        y_label: metric.name.to_owned(),
        y_scale: Scale::Linear,
        curves: vec![
            Curve {
                name: "edited".to_owned(),
                points: places
                    .iter()
                    .copied()
                    .zip(on_axis.iter().map(|(_, (mean, _))| *mean))
                    .collect(),
                intervals: on_axis.iter().map(|(_, (_, half))| *half).collect(),
            },
            Curve {
                name: IDENTITY.to_owned(),
                points: places.iter().map(|&place| (place, identity)).collect(),
                intervals: Vec::new(),
            },
        ],
    })
}

/// A value of an axis as its label: texts without quotes.
fn named(value: &toml::Value) -> String {
    match value {
        toml::Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
