//! `stance demo`

use std::path::PathBuf;

use compose::ItemCount;
use corpus::{CLIPS_PER_TAKE, CorpusOptions, PAIR_LIST, write_corpus, write_held_out_corpus};
use datasets_spec::Seed;
use pipeline::ingest::SourceArg;
use serde_json::{Map, Value, json};
use train::config::RunLength;

use crate::cmd::run::{Plan, RunConfig, finish};
use crate::evaluators::WeakJudgeArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::judge::EncoderConfig;
use crate::test_set::{self, ADJUSTED};
use crate::trainings::TrainingsArgs;

/// Run the whole chain on the built-in motion corpus, without files of your own.
///
/// It needs no download and no licence, and ends with a result table, measured with the encoder that ships with the
/// program. Run again after an interruption, it continues. `stance run` does the same with your own motions.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Folder for everything the demo makes
    #[arg(long, default_value = "stance-demo", value_parser = crate::local::path())]
    out: PathBuf,
    /// Fewer clips and far fewer training steps: shows that the chain works, not how well, with all rows of --full
    #[arg(long)]
    quick: bool,
    /// Train the rows to compare with, too: pairs composed once, and captured pairs alone; and score on all 300 items of
    /// the test set builtin-2, instead of the first 150
    #[arg(long, conflicts_with = "quick")]
    full: bool,
    #[command(flatten)]
    weak_judge: WeakJudgeArgs,
    #[command(flatten)]
    trainings: TrainingsArgs,
}

/// Steps of the editor, fewer than the preset's; they take five minutes on one core at 900 windows a second.
const STEPS: u64 = 4_000;
/// Steps of the coordinator. The preset's 6,000 lower its validation loss by a hundredth and take a minute more.
const COORDINATOR_STEPS: u64 = 3_000;
/// Steps of each model in the quick form.
const QUICK_STEPS: u64 = 40;
/// Items edited in the quick form.
const QUICK_ITEMS: usize = 24;

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    args.trainings.device.choose()?;
    let seed = global.seed();
    let quick = CorpusOptions {
        seed,
        clips: CLIPS_PER_TAKE,
        adjusted: ADJUSTED,
    };
    let folder = args.out.join("corpus");
    match args.quick {
        true => write_corpus(&folder, &quick, &global.bars())?,
        false => write_held_out_corpus(&folder, &test_set::corpus(seed), &global.bars())?,
    };

    let pairs = folder.join(PAIR_LIST);
    // With a fixed name, the source stays the same if the demo folder is moved or copied.
    let source = SourceArg {
        name: Some("corpus".to_owned()),
        path: folder,
    };
    let mut config = RunConfig::new(vec![source], args.out.clone());
    config.ingest.pairs = Some(pairs);
    // Off by default: each of these systems takes as long to train as the editor.
    let compares = args.full || args.quick;
    config.stages.composed_once = compares;
    config.stages.captured_alone = compares;
    config.encoder = EncoderConfig::BUILTIN;
    if args.quick {
        config.items.count = ItemCount::Exactly(QUICK_ITEMS);
        config.poses = settings(json!({
            "length": RunLength::of_steps(QUICK_STEPS),
            "val_every": QUICK_STEPS / 2,
            "log_every": QUICK_STEPS / 8,
        }));
        config.train = config.poses.clone();
        config.train.insert("val_windows".to_owned(), 64.into());
        config.coordinator = config.train.clone();
    } else {
        config.items = test_set::items(seed, args.full);
        config.train = settings(json!({ "length": RunLength::of_steps(STEPS) }));
        let length = RunLength::of_steps(COORDINATOR_STEPS);
        config.coordinator = settings(json!({ "length": length }));
    }
    let mut plan = Plan::new(config, global)?;
    let mut command = "stance demo".to_owned();
    if args.quick {
        command += " --quick";
    }
    if args.full {
        command += " --full";
    }
    if seed != Seed(0) {
        command += &global.seed_option();
    }
    plan.title = "stance demo".to_owned();
    plan.commands = vec![command];
    finish(plan, &args.trainings, args.weak_judge, global)
}

fn settings(document: Value) -> Map<String, Value> {
    serde_json::from_value(document).expect("settings are an object")
}
