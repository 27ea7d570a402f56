//! `stance corpus`

use std::path::PathBuf;

use corpus::{CorpusOptions, write_corpus};

use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Write the built-in procedural motion corpus as source files.
///
/// Half of the clips are AMASS-layout npz, half are BVH, each with captions beside it. They are
/// synthetic and free of any licence (CC0), and depend on the seed alone.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Folder to write to
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
    /// Number of clips
    #[arg(long, default_value_t = CorpusOptions::default().clips)]
    clips: usize,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let options = CorpusOptions {
        clips: args.clips,
        seed: global.seed(),
    };
    let summary = write_corpus(&args.out, &options, &global.bars())?;
    if global.json {
        report::json(&summary)?;
    } else {
        report::text(&format!(
            "{} clips in {}\nnext: stance ingest {} --out DATASET",
            summary.clips,
            args.out.display(),
            args.out.display()
        ));
    }
    Ok(Exit::Done)
}
