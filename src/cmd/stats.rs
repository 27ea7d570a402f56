//! `stance stats`

use std::path::PathBuf;

use pipeline::stage::open_metadata;
use pipeline::stats::statistics;

use crate::chosen::ChosenArgs;
use crate::exit::Exit;
use crate::global::Global;

/// Count a dataset: clips, hours, captions, masks, pairs, findings, fit errors.
///
/// With --where, only some clips are counted, with their masks and pairs. Only metadata is read; `stance verify` checks
/// the motions.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder
    dataset: PathBuf,
    #[command(flatten)]
    chosen: ChosenArgs,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let dataset = open_metadata(&args.dataset)?;
    let statistics = statistics(&dataset, args.chosen.condition.as_ref())?;
    global.say(&statistics, &statistics.to_string())
}
