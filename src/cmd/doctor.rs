//! `stance doctor`

use std::path::PathBuf;

use pipeline::doctor::examine;

use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Report what folders hold, before any work: formats, releases, their missing files and where to get
/// them, and the cost of ingestion.
///
/// Files are listed; their first bytes, labels and licences are read; nothing is written.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Files and folders to look at
    #[arg(required = true)]
    sources: Vec<PathBuf>,
    /// HumanML3D's index.csv, to say which AMASS recordings it needs are missing
    #[arg(long, value_name = "CSV")]
    humanml3d_index: Option<PathBuf>,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let diagnosis = examine(&args.sources, args.humanml3d_index.as_deref())?;
    if global.json {
        report::json(&diagnosis)?;
    } else {
        report::text(&diagnosis.to_string());
    }
    Ok(Exit::Done)
}
