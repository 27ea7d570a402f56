//! `stance doctor`

use std::path::PathBuf;

use formats::source::{ReadOptions, Unit};
use pipeline::doctor::examine;

use crate::cmd::ingest::read_markers;
use crate::exit::Exit;
use crate::global::Global;

/// Report what folders contain, what is missing, and what ingestion will cost.
///
/// Formats, releases, their missing files and where to get them, and the cost of ingestion are printed. Labels,
/// licences and marker captures are read completely, releases as far as it takes to count their clips, and of other
/// files the first bytes. Nothing is written.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Files and folders to look at
    #[arg(required = true)]
    sources: Vec<PathBuf>,
    /// HumanML3D's index.csv, to list the AMASS recordings that it needs and that are missing
    #[arg(long, value_name = "CSV")]
    humanml3d_index: Option<PathBuf>,
    /// Marker set in JSON that captures will be ingested with
    #[arg(long, value_name = "JSON")]
    markers: Option<PathBuf>,
    /// Unit that captures will be ingested with, regardless of the unit that they state
    #[arg(long)]
    unit: Option<Unit>,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let options = ReadOptions {
        markers: args.markers.as_deref().map(read_markers).transpose()?,
        unit: args.unit,
        ..ReadOptions::default()
    };
    let index = args.humanml3d_index.as_deref();
    let diagnosis = examine(&args.sources, index, &options, &global.bars())?;
    global.say(&diagnosis, &diagnosis.to_string())
}
