//! `stance train`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::ValueEnum;
use train::config::TrainConfig;
use train::fit::TrainReport;
use train::j2s::{J2sConfig, J2sPreset};
use train::tmr::TmrConfig;

use crate::chain;
use crate::cli::Global;
use crate::cmd::triplets::ComposeArgs;
use crate::exit::Exit;
use crate::report;

/// Train a model on a dataset, or continue its run.
///
/// The run folder holds the resolved settings, what was fitted to the training split, the metrics
/// and the checkpoints. The same command continues an interrupted run exactly where it stopped.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// What to train
    #[arg(value_enum)]
    model: Model,
    /// Dataset folder
    dataset: PathBuf,
    /// Run folder to write
    #[arg(long)]
    out: PathBuf,
    /// Named settings: tiny (two cores, minutes) or official (the released configuration)
    #[arg(long, default_value = "tiny")]
    preset: String,
    /// TOML file of settings that differ from the preset
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Steps to train, in place of the preset's
    #[arg(long)]
    steps: Option<u64>,
    #[command(flatten)]
    compose: ComposeArgs,
    /// Train on windows recorded by `stance triplets --windows` in place of composing them
    #[arg(long, value_name = "FOLDER")]
    windows: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Model {
    /// The editor, on triplets composed from motions and masks
    Motionrefit,
    /// The encoder of motions and texts that evaluation measures with
    Tmr,
    /// The network from keypoints to rotations, in preset paper or official, measured beside the
    /// fits that follow it
    J2s,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let own = args.config.as_deref().map(read_table).transpose()?;
    if let Model::J2s = args.model {
        return train_j2s(args, own.as_ref(), global);
    }
    let preset = chain::preset(&args.preset)?;
    let bars = global.bars();
    let seed = global.seed();
    let done = match args.model {
        Model::Motionrefit => {
            let mut config = chain::overlay(&TrainConfig::preset(preset), own.as_ref())?;
            config.seed = seed.0;
            config.num_steps = args.steps.unwrap_or(config.num_steps);
            let compose = args.compose.config()?;
            let windows = args.windows.as_deref();
            let (root, out) = (&args.dataset, &args.out);
            chain::train_editor(root, out, &config, &compose, windows, seed, &bars)?
        }
        Model::J2s => unreachable!("handled above"),
        Model::Tmr => {
            let mut config = chain::overlay(&TmrConfig::preset(preset), own.as_ref())?;
            config.seed = seed.0;
            config.num_steps = args.steps.unwrap_or(config.num_steps);
            chain::train_encoder(&args.dataset, &args.out, &config, &bars)?
        }
    };
    if global.json {
        report::json(&done)?;
    } else {
        report::text(&summary(&done, &args.out));
    }
    Ok(Exit::Done)
}

fn train_j2s(args: &Args, own: Option<&toml::Table>, global: &Global) -> anyhow::Result<Exit> {
    let preset = match args.preset.as_str() {
        "paper" | "tiny" => J2sPreset::Paper,
        "official" => J2sPreset::Official,
        other => bail!("j2s has no preset {other:?}; known are paper and official"),
    };
    let mut config = chain::overlay(&J2sConfig::preset(preset), own)?;
    config.seed = global.seed().0;
    config.num_steps = args.steps.unwrap_or(config.num_steps);
    let report = chain::train_j2s(&args.dataset, &args.out, &config, &global.bars())?;
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
            args.out.display()
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
        "{} steps, {} parameters, loss {} -> {}, best validation {} at step {}, {:.0} samples/s, {:.1} % of the time waiting for data; in {}",
        done.steps,
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
