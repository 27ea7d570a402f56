//! `stance corpus`

use std::path::PathBuf;

use corpus::{
    CorpusOptions, Limit, PAIR_LIST, SEEN_PAIR_LIST, write_corpus, write_held_out_corpus,
    write_limits,
};

use crate::exit::Exit;
use crate::global::Global;

/// Write the built-in procedural motion corpus as source files.
///
/// Half of the clips are AMASS-layout npz, half are BVH, each with captions beside it. They are synthetic and free of
/// any licence (CC0), and depend only on the seed. With `--adjusted`, each neutral clip is also written with small
/// changes, and pairs.csv pairs these clips for `stance ingest --pairs`.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Folder to write to
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
    /// Number of clips, without the adjusted ones
    #[arg(long, default_value_t = CorpusOptions::default().clips)]
    clips: usize,
    /// Adjusted clips per neutral clip, which make fine-grained pairs
    #[arg(long, value_name = "N", default_value_t = CorpusOptions::default().adjusted)]
    adjusted: usize,
    /// State splits that test generalisation: actions, a performer, and a style of every action are held out of
    /// training. The test set builtin-2 uses `--clips 780 --adjusted 2 --held-out`
    #[arg(long)]
    held_out: bool,
    /// Instead, write test questions that editors are known to answer badly, in a folder for each kind: counting, left
    /// and right, and words that training does not have
    #[arg(long, conflicts_with_all = ["clips", "adjusted", "held_out"])]
    limits: bool,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    if args.limits {
        return limits(args, global);
    }
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
    let out = args.out.display();
    let (adjusted, pairs) = match summary.adjusted {
        0 => (String::new(), String::new()),
        count => (
            format!(" and {count} adjusted"),
            format!(" --pairs {}", args.out.join(PAIR_LIST).display()),
        ),
    };
    global.say(
        &summary,
        &format!(
            "{} clips{adjusted} in {out}\nnext: stance ingest {out}{pairs} --out DATASET",
            summary.clips
        ),
    )
}

fn limits(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let summary = write_limits(&args.out, global.seed(), &global.bars())?;
    let mut lines = vec![format!("{} clips in {}", summary.clips, args.out.display())];
    for limit in Limit::ALL {
        let folder = args.out.join(limit.name());
        lines.push(format!(
            "next: stance ingest {0} --pairs {0}/{PAIR_LIST} --out {1}; stance items {1} --count all --out ITEMS",
            folder.display(),
            limit.name().to_uppercase(),
        ));
    }
    lines.push(format!(
        "{}/{SEEN_PAIR_LIST} asks for the same in words of training",
        args.out.join(Limit::Wording.name()).display()
    ));
    global.say(&summary, &lines.join("\n"))
}
