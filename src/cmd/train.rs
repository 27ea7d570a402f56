//! `stance train`

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::ValueEnum;
use pipeline::compose::ComposeConfig;
use train::config::TrainConfig;
use train::fit::TrainReport;
use train::tmr::TmrConfig;

use crate::chain;
use crate::cli::Global;
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
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Model {
    /// The editor, on triplets composed from motions and masks
    Motionrefit,
    /// The encoder of motions and texts that evaluation measures with
    Tmr,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let own = args.config.as_deref().map(read_table).transpose()?;
    let preset = chain::preset(&args.preset)?;
    let bars = global.bars();
    let seed = global.seed();
    let done = match args.model {
        Model::Motionrefit => {
            let mut config = chain::overlay(&TrainConfig::preset(preset), own.as_ref())?;
            config.seed = seed.0;
            config.num_steps = args.steps.unwrap_or(config.num_steps);
            let compose = ComposeConfig::default();
            chain::train_editor(&args.dataset, &args.out, &config, &compose, seed, &bars)?
        }
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
