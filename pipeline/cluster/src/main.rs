//! The `stance-cluster` command: pieces of a plan on several machines, scheduled by Ballista.
//!
//! `stance stage plan` writes the plan, and `stance stage commit` can also commit it: this command is another way to
//! make the same shards. Ballista schedules, retries and detects lost machines; the crate [`work`] defines and makes
//! the pieces.

mod client;
mod executor;
mod function;
mod scheduler;
mod session;
mod work_list;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Run the pieces of a plan of `stance stage plan` on a cluster.
#[derive(Debug, Parser)]
#[command(name = "stance-cluster", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Scheduler(scheduler::Args),
    Executor(executor::Args),
    Run(client::Args),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn"))
        .target(env_logger::Target::Stderr)
        .init();
    let done = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(anyhow::Error::from)
        .and_then(|runtime| {
            runtime.block_on(async {
                match cli.command {
                    Command::Scheduler(args) => scheduler::run(args).await,
                    Command::Executor(args) => executor::run(args).await,
                    Command::Run(args) => client::run(args).await,
                }
            })
        });
    match done {
        Ok(code) => code,
        Err(error) => {
            note(&format!("error: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

/// Prints a line for the user to stderr.
#[expect(clippy::print_stderr, reason = "notes go to stderr, results to stdout")]
fn note(text: &str) {
    eprintln!("{text}");
}

/// Prints a result to stdout.
#[expect(clippy::print_stdout, reason = "results go to stdout")]
fn result(text: &str) {
    println!("{text}");
}
