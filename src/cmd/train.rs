//! `stance train`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::ValueEnum;
use eval::draw::plot::{Curve, Plot, Scale, plot};
use train::checkpoint::Start;
use train::config::{RunLength, TrainConfig};
use train::coordinator::CoordinatorConfig;
use train::fit::TrainReport;
use train::j2s::{J2sConfig, J2sPreset};
use train::tmr::TmrConfig;

use crate::chain::{self, TrainInputs};
use crate::cli::Global;
use crate::cmd::model::Features;
use crate::cmd::render::write_picture;
use crate::cmd::triplets::ComposeArgs;
use crate::exit::Exit;
use crate::report;

/// Train a model on a dataset, continue its run, or plot its losses.
///
/// The run folder holds the resolved settings, what was fitted to the training split, the metrics
/// and the checkpoints. The same command continues an interrupted run exactly where it stopped; an
/// interrupt saves and ends.
#[derive(clap::Args, Debug)]
#[command(subcommand_negates_reqs = true, args_conflicts_with_subcommands = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Option<Action>,
    /// What to train
    #[arg(value_enum, required = true)]
    model: Option<Model>,
    /// Dataset folder
    #[arg(required = true)]
    dataset: Option<PathBuf>,
    /// Run folder to write
    #[arg(long, required = true)]
    out: Option<PathBuf>,
    /// Named settings: tiny (two cores, minutes), paper, or official (the released configuration)
    #[arg(long, default_value = "tiny")]
    preset: String,
    /// TOML file of settings that differ from the preset
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// What the evaluation encoder sees of a motion, in place of what the preset says
    #[arg(long, value_enum)]
    features: Option<Features>,
    /// Steps to train, in place of the preset's length
    #[arg(long)]
    steps: Option<u64>,
    /// Epochs to train, in place of the preset's length
    #[arg(long, conflicts_with = "steps")]
    epochs: Option<u64>,
    /// Continue the run of --out with other settings: a longer one, other rates of learning, other
    /// intervals; the record keeps what changed at which step
    #[arg(long)]
    extend: bool,
    /// Begin with the weights of another run of the same network, whose range of model units and words
    /// are kept; the dataset may be another
    #[arg(long, value_name = "RUN", conflicts_with = "extend")]
    init: Option<PathBuf>,
    #[command(flatten)]
    compose: ComposeArgs,
    /// Train on windows recorded by `stance triplets --windows` in place of composing them
    #[arg(long, value_name = "FOLDER")]
    windows: Option<PathBuf>,
    /// Folder of the CLIP text encoder, for settings that listen to it [default: the hub's cache]
    #[arg(long, value_name = "FOLDER")]
    clip: Option<PathBuf>,
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
    #[arg(long)]
    out: PathBuf,
    /// Draw losses on a logarithmic axis
    #[arg(long)]
    log: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Model {
    /// The editor, on triplets composed from motions and masks
    Motionrefit,
    /// The body-part coordinator, on natural segments and composed ones
    Coordinator,
    /// The encoder of motions and texts that evaluation measures with
    Tmr,
    /// The network from keypoints to rotations, in preset paper or official, measured beside the
    /// fits that follow it
    J2s,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    if let Some(Action::Plot(args)) = &args.action {
        return draw(args, global);
    }
    let (Some(model), Some(dataset), Some(out)) = (args.model, &args.dataset, &args.out) else {
        bail!("name a model, a dataset and --out");
    };
    let own = args.config.as_deref().map(read_table).transpose()?;
    let start = Start {
        run: out,
        extend: args.extend,
        init: args.init.as_deref(),
    };
    if let Model::J2s = model {
        return train_j2s(args, dataset, start, own.as_ref(), global);
    }
    if args.features.is_some() && !matches!(model, Model::Tmr) {
        bail!("--features is about the evaluation encoder: stance train tmr");
    }
    let preset = chain::preset(&args.preset)?;
    let bars = global.bars();
    let length = |preset: RunLength| match (args.steps, args.epochs) {
        (Some(steps), _) => RunLength::of_steps(steps),
        (None, Some(epochs)) => RunLength {
            epochs: Some(epochs),
            steps: u64::MAX,
        },
        (None, None) => preset,
    };
    let done = match model {
        Model::Motionrefit => {
            let mut config = chain::overlay(&TrainConfig::preset(preset), own.as_ref())?;
            config.seed = global.seed_or(Some(config.seed)).0;
            config.length = length(config.length);
            let inputs = TrainInputs {
                compose: &args.compose.over(&TrainConfig::compose_preset(preset))?,
                windows: args.windows.as_deref(),
                clip: args.clip.as_deref(),
            };
            chain::train_editor(dataset, start, &config, &inputs, &bars)?
        }
        Model::Coordinator => {
            let mut config = chain::overlay(&CoordinatorConfig::preset(preset), own.as_ref())?;
            config.seed = global.seed_or(Some(config.seed)).0;
            config.length = length(config.length);
            let compose = args.compose.over(&TrainConfig::compose_preset(preset))?;
            chain::train_coordinator(dataset, start, &config, &compose, &bars)?
        }
        Model::Tmr => {
            let mut config = chain::overlay(&TmrConfig::preset(preset), own.as_ref())?;
            config.seed = global.seed_or(Some(config.seed)).0;
            if args.epochs.is_some() {
                bail!("the length of a run of tmr is given in --steps");
            }
            config.num_steps = args.steps.unwrap_or(config.num_steps);
            if let Some(features) = args.features {
                config.features = features.recipe();
            }
            chain::train_encoder(dataset, start, &config, &bars)?
        }
        Model::J2s => unreachable!("handled above"),
    };
    if global.json {
        report::json(&done)?;
    } else {
        report::text(&summary(&done, out));
    }
    Ok(if done.is_complete {
        Exit::Done
    } else {
        Exit::Interrupted
    })
}

fn train_j2s(
    args: &Args,
    dataset: &Path,
    start: Start<'_>,
    own: Option<&toml::Table>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let preset = match args.preset.as_str() {
        "paper" | "tiny" => J2sPreset::Paper,
        "official" => J2sPreset::Official,
        other => bail!("j2s has no preset {other:?}; known are paper and official"),
    };
    let mut config = chain::overlay(&J2sConfig::preset(preset), own)?;
    config.seed = global.seed_or(Some(config.seed)).0;
    config.num_steps = args.steps.unwrap_or(config.num_steps);
    let report = chain::train_j2s(dataset, start, &config, &global.bars())?;
    if global.json {
        report::json(&report)?;
        return Ok(Exit::Done);
    }
    let mut lines = vec![
        format!(
            "{} steps, loss {:.5} -> {:.5}; in {}",
            config.num_steps,
            report.loss[0],
            report.loss[1],
            start.run.display()
        ),
        "way back                  keypoints mm  rotations deg    frames/s".to_owned(),
    ];
    lines.extend(report.ways.iter().map(|way| {
        format!(
            "{:<25} {:>12.3} {:>14.2} {:>11.0}",
            way.name, way.error_mm, way.error_deg, way.frames_per_sec
        )
    }));
    report::text(&lines.join("\n"));
    Ok(Exit::Done)
}

fn draw(args: &PlotArgs, global: &Global) -> anyhow::Result<Exit> {
    let mut curves = Vec::new();
    for run in &args.runs {
        let name = match args.runs.len() {
            1 => String::new(),
            _ => format!("{} ", run.file_name().unwrap_or_default().to_string_lossy()),
        };
        let metrics = train::metrics::read(run)?;
        curves.push(Curve {
            name: format!("{name}training"),
            points: metrics.loss,
            ..Curve::default()
        });
        curves.push(Curve {
            name: format!("{name}validation"),
            points: metrics.val_loss,
            ..Curve::default()
        });
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
    if global.json {
        report::json(&serde_json::json!({ "out": args.out, "runs": args.runs }))?;
    } else {
        report::text(&format!(
            "{} runs drawn in {}",
            args.runs.len(),
            args.out.display()
        ));
    }
    Ok(Exit::Done)
}

fn read_table(path: &Path) -> anyhow::Result<toml::Table> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    text.parse()
        .with_context(|| format!("{} is not TOML", path.display()))
}

/// A run in one line.
pub(crate) fn summary(done: &TrainReport, run: &Path) -> String {
    let loss = |loss: Option<f64>| loss.map_or("-".to_owned(), |loss| format!("{loss:.4}"));
    format!(
        "{} steps{}, {} parameters, loss {} -> {}, best validation {} at step {}, {:.0} samples/s, {:.1} % of the time waiting for data; in {}",
        done.steps,
        if done.is_complete { "" } else { " (stopped)" },
        done.num_parameters,
        loss(done.first_loss),
        loss(done.last_loss),
        loss(done.best_val_loss),
        done.best_step,
        done.samples_per_sec,
        100.0 * done.data_wait_share,
        run.display()
    )
}
