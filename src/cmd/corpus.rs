//! `stance corpus`

use std::path::PathBuf;

use corpus::{CorpusOptions, PAIR_LIST, write_corpus, write_held_out_corpus};

use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Write the built-in procedural motion corpus as source files.
///
/// Half of the clips are AMASS-layout npz, half are BVH, each with captions beside it. They are
/// synthetic and free of any licence (CC0), and depend on the seed alone. With
/// `--adjusted`, neutral clips are there again with a small change each, and pairs.csv pairs them for
/// `stance ingest --pairs`.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Folder to write to
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
    /// Number of clips, without the adjusted ones
    #[arg(long, default_value_t = CorpusOptions::default().clips)]
    clips: usize,
    /// Adjusted clips of each neutral one, which make fine-grained pairs
    #[arg(long, value_name = "N", default_value_t = CorpusOptions::default().adjusted)]
    adjusted: usize,
    /// State splits that ask something of a model: actions, a performer, and a style of every action are held out of
    /// training. The test set builtin-1 is of `--clips 780 --adjusted 2 --held-out`
    #[arg(long)]
    held_out: bool,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let options = CorpusOptions {
        clips: args.clips,
        adjusted: args.adjusted,
        seed: global.seed(),
    };
    let write = if args.held_out {
        write_held_out_corpus
    } else {
        write_corpus
    };
    let summary = write(&args.out, &options, &global.bars())?;
    if global.json {
        report::json(&summary)?;
    } else {
        let out = args.out.display();
        let (adjusted, pairs) = match summary.adjusted {
            0 => (String::new(), String::new()),
            count => (
                format!(" and {count} adjusted"),
                format!(" --pairs {}", args.out.join(PAIR_LIST).display()),
            ),
        };
        report::text(&format!(
            "{} clips{adjusted} in {out}\nnext: stance ingest {out}{pairs} --out DATASET",
            summary.clips
        ));
    }
    Ok(Exit::Done)
}
