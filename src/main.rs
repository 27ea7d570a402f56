//! The `stance` command: parse, dispatch, render. The work is done by the library crates.

mod cli;
mod cmd;
mod device;
mod evaluators;
mod exit;
mod progress;
mod report;
mod seeds;
mod session;
mod settings;
mod stages;

use std::process::ExitCode;

use clap::Parser;

use cli::{Cli, Command};
use exit::Exit;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let outcome = cli.global.start().and_then(|()| dispatch(&cli));
    match outcome {
        Ok(exit) => exit.into(),
        Err(error) => {
            report::error(&error);
            Exit::of_error(&error).into()
        }
    }
}

fn dispatch(cli: &Cli) -> anyhow::Result<Exit> {
    let global = &cli.global;
    match &cli.command {
        Command::Demo(args) => cmd::demo::run(args, global),
        Command::Build(args) => cmd::build::run(args, global),
        Command::Run(args) => cmd::run::run(args, global),
        Command::Corpus(args) => cmd::corpus::run(args, global),
        Command::Doctor(args) => cmd::doctor::run(args, global),
        Command::Ingest(args) => cmd::ingest::run(args, global),
        Command::Inspect(args) => cmd::inspect::run(args, global),
        Command::Verify(args) => cmd::verify::run(args, global),
        Command::Stats(args) => cmd::stats::run(args, global),
        Command::Export(args) => cmd::export::run(args, global),
        Command::Annotate(args) => cmd::annotate::run(args, global),
        Command::Masks(args) => cmd::masks::run(args, global),
        Command::Pairs(args) => cmd::pairs::run(args, global),
        Command::Triplets(args) => cmd::triplets::run(args, global),
        Command::Items(args) => cmd::items::run(args, global),
        Command::Train(args) => cmd::train::run(args, global),
        Command::Model(args) => cmd::model::run(args, global),
        Command::Edit(args) => cmd::edit::run(args, global),
        Command::Edits(args) => cmd::edits::run(args, global),
        Command::Eval(args) => cmd::eval::run(args, global),
        Command::Sweep(args) => cmd::sweep::run(args, global),
        Command::Report(args) => cmd::page::run(args, global),
        Command::Render(args) => cmd::render::run(args, global),
        Command::Completions(args) => Ok(cmd::completions::run(args)),
        Command::Man(args) => cmd::completions::man(args, global),
    }
}
