//! `stance train`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::builder::{PossibleValue, PossibleValuesParser};
use eval::draw::plot::{Curve, Plot, Scale, plot};
use serde_json::{Map, Value};
use train::checkpoint::Start;
use train::config::{Preset, RunLength, TrainConfig, overlay};
use train::features::FeatureRecipe;
use train::kind::{Input, ModelKind, TrainRequest};
use train::registry::{self, MODELS};
use train::stage::editor::settings_replaced_by;

use crate::chosen::ChosenArgs;
use crate::cmd::model::FEATURES;
use crate::cmd::render::write_picture;
use crate::cmd::triplets::ComposeArgs;
use crate::device::TrainDeviceArgs;
use crate::exit::Exit;
use crate::global::{Global, PRESETS, one_of};
use crate::session::text_encoder;
use crate::stages::{ENCODER, trained};
use crate::{local, report, settings};

/// Train a model on a dataset, continue its run, or plot its losses.
///
/// The run folder holds the resolved settings, the normaliser and vocabulary, the metrics
/// and the checkpoints. The same command continues an interrupted run exactly where it stopped; an
/// interrupt saves and ends.
///
/// Training of the evaluation encoder ends with a report of its retrieval on the validation clips (report.json in the
/// run folder). Without this report, tables do not rank systems.
#[derive(clap::Args, Debug)]
#[command(subcommand_negates_reqs = true, args_conflicts_with_subcommands = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Option<Action>,
    /// Model to train
    #[arg(required = true, value_parser = model_names())]
    model: Option<String>,
    /// Dataset folder
    #[arg(required = true)]
    dataset: Option<PathBuf>,
    #[command(flatten)]
    chosen: ChosenArgs,
    /// Run folder to write
    #[arg(long, required = true, value_parser = crate::local::path())]
    out: Option<PathBuf>,
    /// Named settings
    #[arg(long, value_parser = one_of(PRESETS), default_value = "tiny")]
    preset: Preset,
    /// TOML file of settings that differ from the preset
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Motion features of the evaluation encoder, instead of the preset's
    #[arg(long, value_parser = one_of(FEATURES))]
    features: Option<FeatureRecipe>,
    /// Steps to train, instead of the preset's length
    #[arg(long)]
    steps: Option<u64>,
    /// Epochs to train, instead of the preset's length
    #[arg(long, conflicts_with = "steps")]
    epochs: Option<u64>,
    /// Continue the run of --out with other settings, such as a longer training, other learning rates or other
    /// intervals; the run records what changed at which step
    #[arg(long)]
    extend: bool,
    /// Start from the weights of another run of the same network, and keep its normaliser and vocabulary; the dataset
    /// may be another
    #[arg(long, value_name = "RUN", conflicts_with = "extend")]
    init: Option<PathBuf>,
    #[command(flatten)]
    compose: ComposeArgs,
    /// Train on windows recorded by `stance triplets --windows` instead of composing them; the folder states how they
    /// were composed
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["compose", "phrases"])]
    windows: Option<PathBuf>,
    /// Folder of CLIP or BERT, or a table of vectors (`stance model table`), for settings with a frozen text encoder
    /// [default: CLIP in the hub's cache]
    #[arg(long, value_name = "PATH")]
    text_encoder: Option<PathBuf>,
    /// Memory of the device in GB: steps are split into micro-batches that fit, instead of by the setting
    /// micro_batch_size
    #[arg(long, value_name = "GB", value_parser = gigabytes)]
    memory: Option<f64>,
    #[command(flatten)]
    device: TrainDeviceArgs,
}

fn gigabytes(text: &str) -> Result<f64, String> {
    let parsed = text.parse::<f64>().ok();
    parsed
        .filter(|gb| gb.is_finite() && *gb > 0.0)
        .ok_or_else(|| format!("{text:?} is no positive number"))
}

fn model_names() -> PossibleValuesParser {
    let names = MODELS.iter();
    names
        .map(|kind| PossibleValue::new(kind.name).help(kind.about))
        .into()
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    Plot(PlotArgs),
}

/// Draw the losses of one or more runs over their steps.
#[derive(clap::Args, Debug)]
struct PlotArgs {
    /// Run folders
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// Picture to draw: .svg or .png
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
    /// Draw losses on a logarithmic axis
    #[arg(long)]
    log: bool,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    if let Some(Action::Plot(args)) = &args.action {
        return draw(args, global);
    }
    args.device.choose()?;
    let (Some(model), Some(dataset), Some(out)) = (&args.model, &args.dataset, &args.out) else {
        bail!("name a model, a dataset and --out");
    };
    let kind = registry::model(model).context("the parser knows the models")?;
    refuse_unused(args, kind)?;
    let mut own: Map<String, Value> = match &args.config {
        Some(path) => settings::read(path)?,
        None => Map::new(),
    };
    if let Some(features) = args.features {
        if kind.name != ENCODER {
            bail!("--features is about the evaluation encoder: stance train tmr");
        }
        own.insert("features".to_owned(), serde_json::to_value(features)?);
    }
    let (preset, own) = (args.preset, Value::Object(own));
    if args.text_encoder.is_some() {
        refuse_learned_words(kind, preset, &own)?;
    }
    let length = match (args.steps, args.epochs) {
        (Some(steps), _) => Some(RunLength::of_steps(steps)),
        (None, Some(epochs)) => Some(RunLength {
            epochs: Some(epochs),
            steps: u64::MAX,
        }),
        (None, None) => None,
    };
    let dataset = &args.chosen.open(dataset)?;
    let compose = args.compose.over(&TrainConfig::compose_preset(preset))?;
    if let Some(windows) = &args.windows {
        let replaced = settings_replaced_by(windows, &compose)?;
        if !replaced.is_empty() {
            report::note(&format!(
                "note: the windows in {} were composed otherwise than preset {} does: {}; the run records their settings",
                windows.display(),
                preset,
                replaced.join(", ")
            ));
        }
    }
    let request = TrainRequest {
        dataset,
        start: Start {
            run: out,
            extend: args.extend,
            init: args.init.as_deref(),
        },
        preset,
        own: &own,
        compose: &compose,
        windows: args.windows.as_deref(),
        text_encoder: &text_encoder(args.text_encoder.as_deref()),
        seed: global.seed,
        length,
        memory: args.memory.map(|gb| (1e9 * gb) as u64),
    };
    let done = trained(kind, &request, global);
    let (mut done, judge) = match &args.config {
        Some(path) => done.map_err(|error| settings::at(path, error))?,
        None => done?,
    };
    if let Some(found) = judge {
        done.summary += &format!("\n{}", found.lines().join("\n"));
        done.document["judge"] = serde_json::to_value(&found)?;
    }
    global.say(&done.document, &done.summary)?;
    Ok(match done.is_complete {
        true => Exit::Done,
        false => Exit::Interrupted,
    })
}

/// Refuses options that the model would ignore.
fn refuse_unused(args: &Args, kind: &ModelKind) -> anyhow::Result<()> {
    let has_length = args.steps.is_some() || args.epochs.is_some();
    let (has_compose, has_encoder) = (args.compose.is_given(), args.text_encoder.is_some());
    // A model without a length has neither weights to begin with nor settings that may change.
    let has_weights = args.extend || args.init.is_some();
    for (options, input, is_given) in [
        ("--compose and --phrases", Input::Compose, has_compose),
        ("--windows", Input::Windows, args.windows.is_some()),
        ("--text-encoder", Input::TextEncoder, has_encoder),
        ("--steps and --epochs", Input::Length, has_length),
        ("--extend and --init", Input::Length, has_weights),
        ("--memory", Input::Memory, args.memory.is_some()),
    ] {
        if is_given && !kind.uses.contains(&input) {
            bail!(
                "the model {} makes no use of {options}; train it without",
                kind.name
            );
        }
    }
    Ok(())
}

/// Refuses a text encoder for settings that train one with the model, and would ignore it.
fn refuse_learned_words(kind: &ModelKind, preset: Preset, own: &Value) -> anyhow::Result<()> {
    // Training reports settings that do not fit.
    let settings = overlay(&(kind.preset)(preset), own).unwrap_or_default();
    if settings
        .pointer("/text/encoder")
        .is_some_and(|encoder| encoder == "learned")
    {
        bail!(
            "text.encoder is learned, which makes no use of --text-encoder; set it to clip, bert or \
             table in --config, or train without"
        );
    }
    Ok(())
}

/// The training and validation losses of a run over its steps. `before` is the prefix of the names of the curves.
pub(crate) fn loss_curves(run: &Path, before: &str) -> anyhow::Result<[Curve; 2]> {
    let metrics = train::metrics::read(run)?;
    let curves = [("training", metrics.loss), ("validation", metrics.val_loss)];
    Ok(curves.map(|(name, points)| Curve {
        name: format!("{before}{name}"),
        points,
        ..Curve::default()
    }))
}

fn draw(args: &PlotArgs, global: &Global) -> anyhow::Result<Exit> {
    let mut curves = Vec::new();
    for (run, name) in args.runs.iter().zip(local::names_of(&args.runs)) {
        let name = match args.runs.len() {
            1 => String::new(),
            _ => format!("{name} "),
        };
        curves.extend(loss_curves(run, &name)?);
    }
    let svg = plot(&Plot {
        title: String::new(),
        x_label: "step".to_owned(),
        y_label: "loss".to_owned(),
        y_scale: if args.log { Scale::Log } else { Scale::Linear },
        curves,
        ..Plot::default()
    });
    write_picture(&args.out, &svg, 2.0)?;
    global.say(
        &serde_json::json!({ "out": args.out, "runs": args.runs }),
        &format!("{} runs drawn in {}", args.runs.len(), args.out.display()),
    )
}
