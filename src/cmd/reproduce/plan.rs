//! The plan of `stance reproduce`: its file, and the trainings and edits that it needs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use compose::{ComposeConfig, ItemConfig, ItemTask};
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Split};
use eval::figure::{EPOCH, Figure, Point, Sections};
use eval::metric::interval::MOST_TRAININGS;
use eval::metric::{self, Metric};
use eval::names::ALL_TASKS;
use eval::protocol::Protocol;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use train::checkpoint::Slot;
use train::config::{Preset, TrainConfig, overlay};
use train::coordinator::CoordinatorConfig;
use train::j2s::J2sConfig;
use train::kind::ModelKind;
use train::registry::{self, MODELS};
use train::system::{EditConfig, EditInput};
use train::text::bert::BertFiles;
use train::tmr::TmrConfig;

use super::files::{chart_name, file_name, table_name};
use super::pictures::Picture;
use crate::cmd::edit::system_name;
use crate::cmd::eval::TableArg;
use crate::global::Global;
use crate::judge::is_builtin;
use crate::seeds::Seeds;
use crate::stages::ENCODER;
use crate::{local, settings};

/// Model of a system that names none.
const EDITOR: &str = "motionrefit";
const COORDINATOR: &str = "coordinator";
const POSES: &str = "j2s";

/// Settings that override those of a preset.
type Own = Map<String, Value>;

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Plan {
    /// Title of the page.
    #[serde(default = "title")]
    pub(super) title: String,
    /// Dataset with masks or pairs.
    pub(super) dataset: PathBuf,
    /// Folder for trainings, edits, scores, tables and figures.
    pub(super) out: PathBuf,
    /// Run folder of the encoder that motions are scored with, or `builtin`; without it one is trained under `out`.
    encoder: Option<PathBuf>,
    /// Folder of CLIP or BERT, or a table of vectors, for settings with a frozen text encoder.
    #[serde(alias = "clip")]
    pub(super) text_encoder: Option<PathBuf>,
    #[serde(default)]
    pub(super) preset: Preset,
    /// Split that the items are drawn from.
    #[serde(default = "test")]
    pub(super) split: Split,
    /// Test questions, the same for every system.
    #[serde(default)]
    pub(super) items: ItemConfig,
    /// Seeds of items, training and sampling.
    #[serde(default)]
    pub(super) seeds: Seeds,
    /// Seeds of training. Every system is trained once with each, and tables and figures show means over the
    /// trainings. If there are none, every system is trained once, with the seed in `seeds`.
    #[serde(default)]
    train_seeds: Vec<u64>,
    #[serde(default)]
    pub(super) eval: Protocol,
    /// Settings of each model, by its name.
    #[serde(default)]
    models: BTreeMap<String, Own>,
    /// Settings of the composer.
    #[serde(default)]
    compose: Own,
    /// Settings of editing.
    #[serde(default)]
    edit: Own,
    /// The rows, in the order of the tables.
    #[serde(rename = "system")]
    systems: Vec<System>,
    #[serde(default, rename = "table")]
    pub(super) tables: Vec<PaperTable>,
    #[serde(default, rename = "figure")]
    pub(super) figures: Vec<Figure>,
    #[serde(default, rename = "picture")]
    pub(super) pictures: Vec<Picture>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct System {
    /// Name of the system in tables.
    name: String,
    #[serde(default = "editor")]
    model: String,
    /// Settings of the system's training that override those of its model.
    #[serde(default)]
    train: Own,
    /// Settings of the composer that override the plan's.
    #[serde(default)]
    compose: Own,
    /// Settings of editing that override the plan's.
    #[serde(default)]
    edit: Own,
    /// Whether a coordinator guides the system.
    #[serde(default)]
    coordinator: bool,
    /// Whether a pose network estimates the rotations of the system's edits.
    #[serde(default)]
    poses: bool,
    /// Training seeds that override the plan's.
    train_seeds: Option<Vec<u64>>,
}

impl System {
    /// Refuses settings of a coordinator's guidance if no coordinator guides the system. Those of sections that several
    /// systems share pass.
    fn check_guided(&self, mut keys: impl Iterator<Item = String>) -> anyhow::Result<()> {
        const OF_GUIDANCE: [&str; 2] = ["edit.coordinator_", "train.coordinator."];
        let is_of_guidance = |key: &String| OF_GUIDANCE.iter().any(|begin| key.starts_with(begin));
        match keys.find(is_of_guidance).filter(|_| !self.coordinator) {
            Some(key) => bail!(
                "system {:?} makes no use of {key}; give it a coordinator (coordinator = true)",
                self.name
            ),
            None => Ok(()),
        }
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PaperTable {
    /// The table: main, 1, 2, a1, a2, a3 or a4.
    pub(super) paper: TableArg,
    /// Names of the systems in the table; if empty, all.
    #[serde(default)]
    pub(super) systems: Vec<String>,
    /// Whether the table also shows the published rows.
    #[serde(default)]
    pub(super) published: bool,
}

fn title() -> String {
    "Reproduction".to_owned()
}

fn test() -> Split {
    Split::Test
}

fn editor() -> String {
    EDITOR.to_owned()
}

/// A training. Equal trainings are made once.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Training {
    #[serde(serialize_with = "name_of")]
    pub(super) model: &'static ModelKind,
    pub(super) preset: Preset,
    pub(super) own: Value,
    /// All settings of the preset, because another version of the program may give the preset other settings.
    pub(super) settings_of_preset: Value,
    /// Hash of the table of text vectors, or of BERT's files, if the model uses one as its text encoder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) text_table: Option<String>,
    pub(super) compose: ComposeConfig,
    /// Seed that overrides that of the model's settings.
    pub(super) seed: Option<u64>,
}

fn name_of<S: serde::Serializer>(model: &&'static ModelKind, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(model.name)
}

/// A system, or a point of a figure, with a specification for each of its trainings.
pub(super) struct Trained {
    /// Name of the system, or of the figure and its point.
    pub(super) name: String,
    pub(super) specs: Vec<Spec>,
}

/// One training of a system, with everything that its edits depend on.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Spec {
    pub(super) name: String,
    pub(super) training: Training,
    pub(super) coordinator: Option<Training>,
    pub(super) poses: Option<Training>,
    pub(super) edit: EditConfig,
    /// Epoch of the checkpoint; none for the best one.
    epoch: Option<u64>,
}

impl Spec {
    pub(super) fn trainings(&self) -> impl Iterator<Item = &Training> {
        let helpers = self.coordinator.iter().chain(&self.poses);
        std::iter::once(&self.training).chain(helpers)
    }

    pub(super) fn slot(&self) -> Slot {
        self.epoch.map_or(Slot::Best, Slot::Epoch)
    }
}

impl Plan {
    /// Checks that the dataset, if it exists, has data for each task of the items.
    pub(super) fn check_tasks(&self) -> anyhow::Result<()> {
        let dataset = match Dataset::open_unverified(&self.dataset) {
            Err(datasets_spec::Error::NotADataset { .. }) => return Ok(()),
            dataset => dataset?,
        };
        let has_masks = dataset.manifest().rows(MaskRow::TABLE, Some(self.split)) > 0;
        let pairs: Vec<PairRow> = dataset.read(Some(self.split))?;
        let is_motionfix = |pair: &PairRow| pair.source == ItemTask::MotionFix.as_str();
        for task in &self.items.tasks {
            let is_of_kind = |pair: &PairRow| pair.kind == task.as_str() && !is_motionfix(pair);
            let (is_there, data) = match task {
                ItemTask::Semantic => (has_masks, "masks"),
                ItemTask::MotionFix => (pairs.iter().any(is_motionfix), "pairs"),
                ItemTask::Style | ItemTask::FineGrained => (pairs.iter().any(is_of_kind), "pairs"),
            };
            if !is_there {
                let (task, split, dataset) = (task.as_str(), self.split, self.dataset.display());
                bail!(
                    "the plan asks for items of task {task}, and split {split} of {dataset} has none of its {data}; name \
                     a dataset that has them with --dataset, or choose another plan (--list)"
                );
            }
        }
        Ok(())
    }
}

pub(super) struct FigureSpecs<'a> {
    pub(super) figure: &'a Figure,
    pub(super) points: Vec<Point>,
    pub(super) trained: Vec<Trained>,
    pub(super) metrics: Vec<&'static Metric>,
    pub(super) tasks: Vec<&'a str>,
    /// Frames at the model's rate that a source must have to be scored: the longest window, if the figure is
    /// about windows. Shorter items would be padded at some points and not at others.
    pub(super) min_frames: Option<usize>,
}

impl Plan {
    /// Reads a plan. Paths are relative to its file; `dataset` and `out` override those of the plan.
    pub(super) fn read(
        text: &str,
        path: &Path,
        dataset: Option<&Path>,
        out: Option<&Path>,
    ) -> anyhow::Result<Self> {
        let mut plan: Self = settings::parse(text, path)?;
        let base = path.parent().unwrap_or(Path::new("."));
        let folders = [&mut plan.dataset, &mut plan.out];
        let encoder = plan.encoder.as_mut().filter(|run| !is_builtin(run));
        let optional = [encoder, plan.text_encoder.as_mut()];
        for folder in folders.into_iter().chain(optional.into_iter().flatten()) {
            *folder = base.join(&*folder);
        }
        plan.dataset = dataset.map_or(plan.dataset, Path::to_owned);
        plan.out = out.map_or(plan.out, Path::to_owned);
        plan.check()?;
        Ok(plan)
    }

    fn check(&self) -> anyhow::Result<()> {
        let models: Vec<&str> = MODELS.iter().map(|model| model.name).collect();
        let named = self.systems.iter().map(|system| &system.model);
        for name in self.models.keys().chain(named) {
            if registry::model(name).is_none() {
                bail!(
                    "there is no model {name:?}; there are: {}",
                    models.join(", ")
                );
            }
        }
        for system in &self.systems {
            let (name, model) = (&system.name, &system.model);
            system_name(name)
                .map_err(|problem| anyhow::anyhow!("name of a [[system]]: {problem}"))?;
            let own = system.edit.keys().map(|key| format!("edit.{key}"));
            system.check_guided(own)?;
            if registry::model(model).is_some_and(|kind| kind.open.is_none()) {
                bail!("system {name:?} is of model {model}, which edits no motions");
            }
            if (system.coordinator || system.poses) && model != EDITOR {
                bail!(
                    "system {name:?} is of model {model}, which uses no coordinator and no pose network; leave both out"
                );
            }
        }
        let own = self.systems.iter().flat_map(|system| &system.train_seeds);
        for seeds in own.chain([&self.train_seeds]) {
            if seeds.len() > MOST_TRAININGS {
                bail!(
                    "train_seeds holds {} seeds; at most {MOST_TRAININGS} trainings of a system can be summarised",
                    seeds.len()
                );
            }
            if let Some(seed) = twice(seeds) {
                bail!(
                    "train_seeds holds {seed} twice; equal trainings say nothing of their spread"
                );
            }
        }
        let names: Vec<&String> = self.systems.iter().map(|system| &system.name).collect();
        if let Some(name) = twice(&names) {
            bail!("two systems are called {name:?}; name them apart");
        }
        let of_tables = self.tables.iter().flat_map(|table| &table.systems);
        let of_figures = self.figures.iter().flat_map(|figure| &figure.system);
        let of_pictures = self.pictures.iter().flat_map(|picture| &picture.systems);
        for name in of_tables.chain(of_figures).chain(of_pictures) {
            self.system(Some(name))?;
        }
        for figure in &self.figures {
            let keys = [Some(&figure.key), figure.second_key.as_ref()];
            self.system(figure.system.as_ref())?
                .check_guided(keys.into_iter().flatten().cloned())
                .with_context(|| format!("figure {}", figure.name))?;
        }
        self.check_files()
    }

    /// Checks that every table, figure and picture has files of its own. Names of files keep neither capitals nor
    /// punctuation, so results with different names can have the same files.
    fn check_files(&self) -> anyhow::Result<()> {
        let tables = self.tables.iter().map(|table| {
            let files = BTreeSet::from([format!("tables/{}", table_name(table.paper))]);
            (format!("table {}", table.paper.name()), files)
        });
        let figures = self.figures.iter().map(|figure| {
            let of_task = |task: &str| -> Vec<String> {
                let charts = figure.metrics.iter();
                let charts = charts.map(|metric| chart_name(figure, task, metric));
                charts.map(|name| format!("figures/{name}")).collect()
            };
            let mut files = BTreeSet::from([format!("tables/{}", file_name(&figure.name))]);
            files.extend(tasks(figure).into_iter().flat_map(of_task));
            (format!("figure {:?}", figure.name), files)
        });
        let pictures = self.pictures.iter().map(|picture| {
            let files = BTreeSet::from([format!("figures/{}", file_name(&picture.name))]);
            (format!("picture {:?}", picture.name), files)
        });
        let mut owners: BTreeMap<String, String> = BTreeMap::new();
        for (owner, files) in tables.chain(figures).chain(pictures) {
            for file in files {
                if let Some(other) = owners.get(&file) {
                    bail!(
                        "{other} and {owner} would both be written to {file}; give figures and pictures names that \
                         differ in a letter or a digit, and a second table of the same name a plan of its own"
                    );
                }
                owners.insert(file, owner.clone());
            }
        }
        Ok(())
    }

    fn system(&self, name: Option<&String>) -> anyhow::Result<&System> {
        let mut systems = self.systems.iter();
        match name {
            Some(name) => systems
                .find(|system| system.name == *name)
                .with_context(|| format!("there is no [[system]] named {name:?}")),
            None => systems.next().context("the plan has no [[system]]"),
        }
    }

    /// The systems with these names, or all if no name is given.
    pub(super) fn systems_named<'a>(&'a self, names: &'a [String]) -> Vec<&'a str> {
        let all = self.systems.iter().map(|system| system.name.as_str());
        match names.is_empty() {
            true => all.collect(),
            false => names.iter().map(String::as_str).collect(),
        }
    }

    /// The run folder of the encoder, or as `Err` the training that makes it.
    pub(super) fn encoder(&self, global: &Global) -> anyhow::Result<Result<PathBuf, Training>> {
        Ok(match &self.encoder {
            Some(run) => Ok(run.clone()),
            None => Err(self.training(ENCODER, Value::Null, None, global)?),
        })
    }

    pub(super) fn trained(&self, global: &Global) -> anyhow::Result<Vec<Trained>> {
        let trained = |system: &System| {
            let specs = self.specs(system, &self.sections(system)?, None, global)?;
            let name = system.name.clone();
            Ok(Trained { name, specs })
        };
        self.systems.iter().map(trained).collect()
    }

    pub(super) fn figure_specs(&self, global: &Global) -> anyhow::Result<Vec<FigureSpecs<'_>>> {
        let figures = self.figures.iter();
        figures
            .map(|figure| {
                let system = self.system(figure.system.as_ref())?;
                let points = figure.points(&self.sections(system)?)?;
                let trained = points.iter().map(|point| {
                    let name = format!("{}, {}", figure.name, point.name());
                    let specs = self
                        .specs(system, &point.sections, point.epoch, global)
                        .with_context(|| format!("figure {name}"))?;
                    Ok(Trained { name, specs })
                });
                let window = |point: &Point| point.value("train.window")?.as_u64();
                let longest = points.iter().filter_map(window).max();
                Ok(FigureSpecs {
                    figure,
                    trained: trained.collect::<anyhow::Result<_>>()?,
                    metrics: metrics(&figure.metrics)?,
                    tasks: tasks(figure),
                    min_frames: longest.map(|frames| frames as usize),
                    points,
                })
            })
            .collect()
    }

    /// Settings of a system, by section: the plan's, overridden by its own.
    fn sections(&self, system: &System) -> anyhow::Result<Sections> {
        let over = |base: Option<&Own>, own: &Own| -> anyhow::Result<Value> {
            let base = Value::Object(base.cloned().unwrap_or_default());
            Ok(overlay(&base, &Value::Object(own.clone()))?)
        };
        let of_model = self.models.get(&system.model);
        Ok(BTreeMap::from([
            ("train", over(of_model, &system.train)?),
            ("compose", over(Some(&self.compose), &system.compose)?),
            ("edit", over(Some(&self.edit), &system.edit)?),
        ]))
    }

    /// One specification for each training seed; a single one if there are none, if the settings of the model hold a
    /// seed, or if `--seed` is given.
    fn specs(
        &self,
        system: &System,
        sections: &Sections,
        epoch: Option<u64>,
        global: &Global,
    ) -> anyhow::Result<Vec<Spec>> {
        let seeds = system.train_seeds.as_ref().unwrap_or(&self.train_seeds);
        let is_given = global.seed.is_some() || sections["train"].get("seed").is_some();
        if is_given || seeds.is_empty() {
            return Ok(vec![self.spec(system, sections, None, epoch, global)?]);
        }
        let seeds = seeds.iter();
        seeds
            .map(|&seed| self.spec(system, sections, Some(seed), epoch, global))
            .collect()
    }

    fn spec(
        &self,
        system: &System,
        sections: &Sections,
        seed: Option<u64>,
        epoch: Option<u64>,
        global: &Global,
    ) -> anyhow::Result<Spec> {
        let own = |section: &str| -> Own {
            let own = sections[section].as_object().cloned();
            own.unwrap_or_default()
        };
        let compose = &TrainConfig::compose_preset(self.preset);
        let compose = settings::over(compose, "compose", &own("compose"))?;
        let training = Training {
            compose,
            ..self.training(&system.model, sections["train"].clone(), seed, global)?
        };
        let coordinator = match system.coordinator {
            true => {
                // The coordinator must be trained on the windows of the editor that it guides.
                let train: TrainConfig =
                    overlay(&TrainConfig::preset(self.preset), &sections["train"])?;
                let mut shared = json!({ "window": train.window, "keypoints": train.keypoints });
                // Settings of the preset are left out, so that trainings of former versions keep their names.
                let diffusion = train.diffusion;
                let of_preset = CoordinatorConfig::preset(self.preset);
                let own = self.models.get(COORDINATOR);
                let is_given = |key| own.is_some_and(|own| own.contains_key(key));
                if is_given("schedule") || diffusion.schedule != of_preset.schedule {
                    shared["schedule"] = json!(diffusion.schedule);
                }
                if is_given("diffusion_steps") || diffusion.num_steps != of_preset.diffusion_steps {
                    shared["diffusion_steps"] = json!(diffusion.num_steps);
                }
                let coordinator = self.training(COORDINATOR, shared, seed, global)?;
                // Its other composer settings are those of the plan, so that systems that differ in them share a coordinator.
                let compose = ComposeConfig {
                    fps: training.compose.fps,
                    anchor: training.compose.anchor,
                    range: training.compose.range,
                    ..coordinator.compose
                };
                Some(Training {
                    compose,
                    ..coordinator
                })
            }
            false => None,
        };
        let poses = system
            .poses
            .then(|| self.training(POSES, Value::Null, None, global));
        let edit = EditConfig {
            name: Some(system.name.clone()),
            ..settings::over(&EditConfig::default(), "edit", &own("edit"))?
        };
        edit.check()?;
        let checkpoint = epoch.map(|_| (EPOCH, EditInput::Checkpoint));
        let given = edit.given().chain(checkpoint);
        let checked = training.model.check_edit_inputs(given);
        checked.with_context(|| format!("system {:?}", system.name))?;
        Ok(Spec {
            name: system.name.clone(),
            training,
            coordinator,
            poses: poses.transpose()?,
            edit,
            epoch,
        })
    }

    /// The training of a model. `own` overrides the plan's settings of the model, and `seed`, if given, its seed.
    fn training(
        &self,
        name: &str,
        own: Value,
        seed: Option<u64>,
        global: &Global,
    ) -> anyhow::Result<Training> {
        let model = registry::model(name).with_context(|| format!("no model {name:?}"))?;
        let of_plan = Value::Object(self.models.get(name).cloned().unwrap_or_default());
        let own = match own {
            Value::Null => of_plan,
            own => overlay(&of_plan, &own)?,
        };
        let has_seed = own.get("seed").is_some();
        let own = own_of(name, self.preset, own).with_context(|| format!("settings of {name}"))?;
        let compose = &TrainConfig::compose_preset(self.preset);
        let seed = match (seed, has_seed) {
            (Some(seed), _) => Some(seed),
            (None, true) => global.seed,
            (None, false) => Some(global.seed_or(self.seeds.train).0),
        };
        Ok(Training {
            model,
            preset: self.preset,
            settings_of_preset: (model.preset)(self.preset),
            text_table: self.text_table(&own)?,
            own,
            compose: settings::over(compose, "compose", &self.compose)?,
            seed,
        })
    }

    /// Hash of the table of text vectors or of the folder of BERT, if the settings ask for one and it exists.
    fn text_table(&self, own: &Value) -> anyhow::Result<Option<String>> {
        let asked = own.pointer("/text/encoder").and_then(Value::as_str);
        match (asked, &self.text_encoder) {
            (Some("table"), Some(path)) if path.is_file() => {
                let hash = blake3::hash(&local::read(path)?);
                Ok(Some(hash.to_hex().to_string()))
            }
            (Some("bert"), Some(folder)) if folder.is_dir() => {
                Ok(Some(BertFiles::in_folder(folder)?.hash()?))
            }
            _ => Ok(None),
        }
    }

    /// The protocol; for a table of the paper, with the paper's gallery.
    pub(super) fn protocol(&self, table: Option<TableArg>, global: &Global) -> Protocol {
        let scored = table.and_then(TableArg::scored);
        Protocol {
            gallery: scored.map_or(self.eval.gallery, |table| table.gallery()),
            seed: global.seed_or(Some(self.eval.seed.0)),
            ..self.eval
        }
    }
}

/// Checks and returns the settings of a model. Settings of an editor that equal its preset's are left out, so that a
/// point of a figure with the preset's value needs no further training. Settings of models that this function does not
/// know are checked when they are trained.
fn own_of(name: &str, preset: Preset, own: Value) -> anyhow::Result<Value> {
    let checked = match name {
        EDITOR => {
            let preset = TrainConfig::preset(preset);
            overlay(&preset, &own)?;
            return Ok(settings::changes(&serde_json::to_value(preset)?, own));
        }
        COORDINATOR => overlay(&CoordinatorConfig::preset(preset), &own).map(drop),
        POSES => overlay(&J2sConfig::of(preset), &own).map(drop),
        ENCODER => overlay(&TmrConfig::preset(preset), &own).map(drop),
        _ => Ok(()),
    };
    checked?;
    Ok(own)
}

/// The first value that occurs twice.
fn twice<T: PartialEq>(values: &[T]) -> Option<&T> {
    let mut places = 0..values.len();
    let place = places.find(|&place| values[..place].contains(&values[place]))?;
    Some(&values[place])
}

/// The tasks of a figure, each with drawings of its own.
fn tasks(figure: &Figure) -> Vec<&str> {
    match figure.tasks.is_empty() {
        true => vec![ALL_TASKS],
        false => figure.tasks.iter().map(String::as_str).collect(),
    }
}

fn metrics(names: &[String]) -> anyhow::Result<Vec<&'static Metric>> {
    let known: Vec<&str> = metric::ALL.iter().map(|metric| metric.name).collect();
    let metric = |name: &String| {
        metric::from_name(name).with_context(|| {
            let known = known.join(", ");
            format!("there is no metric {name:?}; there are: {known}")
        })
    };
    names.iter().map(metric).collect()
}
