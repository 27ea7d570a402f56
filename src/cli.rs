//! The command line: the verbs, and what runs for each.

use clap::{CommandFactory, Parser, Subcommand};

use crate::cmd;
use crate::exit::Exit;
use crate::global::Global;

/// Notes on URLs, and on failures for scripts.
const NOTES: &str = "A dataset or source may be a URL: s3://BUCKET/PATH, gs://, az://, and for reading http://, https:// \
                     and hf://datasets/OWNER/NAME. Credentials and endpoint are those of the environment (AWS_*, \
                     GOOGLE_*, AZURE_*); STANCE_REMOTE_CACHE_SIZE (10GB; 0 for none) bounds the local cache.\n\n\
                     With --json, a failure is a JSON document on stdout too, with the fields code (such as \
                        E-IO), item (a file, folder or clip, or null) and reason.";

/// Human-motion data from raw files to a published result table, for text-guided motion editing.
#[derive(Debug, Parser)]
#[command(name = "stance", version, arg_required_else_help = true, after_help = NOTES)]
pub(crate) struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

impl Cli {
    /// Whether results are printed as JSON.
    pub(crate) fn json(&self) -> bool {
        self.global.json
    }

    /// Runs the verb.
    pub(crate) fn run(&self) -> anyhow::Result<Exit> {
        let global = &self.global;
        global.start()?;
        match &self.command {
            Command::Demo(args) => cmd::demo::run(args, global),
            Command::Build(args) => cmd::build::run(args, global),
            Command::Run(args) => cmd::run::run(args, global),
            Command::Corpus(args) => cmd::corpus::run(args, global),
            Command::Dataset(args) => cmd::dataset::run(args, global),
            Command::Doctor(args) => cmd::doctor::run(args, global),
            Command::Ingest(args) => cmd::ingest::run(args, global),
            Command::Inspect(args) => cmd::inspect::run(args, global),
            Command::Verify(args) => cmd::verify::run(args, global),
            Command::Stage(args) => cmd::stage::run(args, global),
            Command::Query(args) => cmd::query::run(args, global),
            Command::Stats(args) => cmd::stats::run(args, global),
            Command::Export(args) => cmd::export::run(args, global),
            Command::Annotate(args) => cmd::annotate::run(args, global),
            Command::Masks(args) => cmd::masks::run(args, global),
            Command::Pairs(args) => cmd::pairs::run(args, global),
            Command::Triplets(args) => cmd::triplets::run(args, global),
            Command::Items(args) => cmd::items::run(args, global),
            Command::Train(args) => cmd::train::run(args, global),
            Command::Variants(args) => cmd::variants::run(args, global),
            Command::Model(args) => cmd::model::run(args, global),
            Command::Edit(args) => cmd::edit::run(args, global),
            Command::Edits(args) => cmd::edits::run(args, global),
            Command::Eval(args) => cmd::eval::run(args, global),
            Command::Reproduce(args) => cmd::reproduce::run(args, global),
            Command::Report(args) => cmd::page::run(args, global),
            Command::Render(args) => cmd::render::run(args, global),
            Command::Completions(args) => Ok(cmd::completions::run(args, Self::command())),
            Command::Man(args) => cmd::completions::man(args, Self::command(), global),
        }
    }
}

/// The verbs.
#[derive(Debug, Subcommand)]
enum Command {
    Demo(cmd::demo::Args),
    Run(cmd::run::Args),
    Build(cmd::build::Args),
    Corpus(cmd::corpus::Args),
    Doctor(cmd::doctor::Args),
    Ingest(cmd::ingest::RunArgs),
    Inspect(cmd::inspect::Args),
    Verify(cmd::verify::Args),
    Dataset(cmd::dataset::Args),
    Stats(cmd::stats::Args),
    Query(cmd::query::Args),
    Export(cmd::export::Args),
    Annotate(cmd::annotate::Args),
    Masks(cmd::masks::Args),
    Pairs(cmd::pairs::Args),
    Triplets(cmd::triplets::Args),
    Items(cmd::items::Args),
    Train(cmd::train::Args),
    Variants(cmd::variants::Args),
    Model(cmd::model::Args),
    Edit(cmd::edit::Args),
    Edits(cmd::edits::Args),
    Eval(cmd::eval::Args),
    Reproduce(cmd::reproduce::Args),
    Report(cmd::page::Args),
    Render(cmd::render::Args),
    Stage(cmd::stage::Args),
    Completions(cmd::completions::Args),
    Man(cmd::completions::ManArgs),
}
