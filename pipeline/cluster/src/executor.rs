//! `stance-cluster executor`

use std::net::{IpAddr, TcpListener};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, anyhow};
use ballista_core::config::TaskSchedulingPolicy;
use ballista_core::registry::BallistaFunctionRegistry;
use ballista_executor::executor_process::{ExecutorProcessConfig, start_executor_process};

use crate::function::{self, Isolation};
use crate::note;

/// Start an executor. It asks the scheduler for pieces until it is stopped, and goes on after a restart of the
/// scheduler.
///
/// The plan, its sources and its destination must lie under the same path or address on all machines.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Scheduler, as HOST:PORT
    #[arg(long, default_value = "127.0.0.1:50050")]
    scheduler: String,
    /// Pieces made at a time. One piece uses all cores if its job can
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pieces: u16,
    /// Address at which the other machines reach this one
    #[arg(long, default_value = "127.0.0.1")]
    host: IpAddr,
    /// Port for results; 0 takes a free one
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Make every piece in a process of its own, with this command `stance`
    #[arg(long, value_name = "STANCE")]
    isolate: Option<PathBuf>,
}

/// Runs until the process is stopped.
pub(crate) async fn run(args: Args) -> anyhow::Result<ExitCode> {
    let (host, port) = args
        .scheduler
        .rsplit_once(':')
        .context("--scheduler is HOST:PORT")?;
    let port: u16 = port.parse().context("--scheduler is HOST:PORT")?;
    let isolation = args.isolate.map_or(Isolation::None, Isolation::Child);
    let mut registry = BallistaFunctionRegistry::default();
    registry.scalar_functions.insert(
        function::NAME.to_owned(),
        Arc::new(function::function(isolation)),
    );
    // Folder for result records of pieces, until the client has them; the shards themselves go to the plan's
    // destination.
    let work = tempfile::tempdir().context("no folder for intermediate results")?;
    let config = ExecutorProcessConfig {
        bind_host: args.host.to_string(),
        external_host: Some(args.host.to_string()),
        port: if args.port == 0 {
            free_port(args.host)?
        } else {
            args.port
        },
        grpc_port: free_port(args.host)?,
        scheduler_host: host.to_owned(),
        scheduler_port: port,
        scheduler_connect_timeout_seconds: u16::MAX,
        vcores: args.pieces.into(),
        task_scheduling_policy: TaskSchedulingPolicy::PullStaged,
        work_dir: Some(work.path().to_string_lossy().into_owned()),
        override_function_registry: Some(Arc::new(registry)),
        ..ExecutorProcessConfig::default()
    };
    note(&format!(
        "executor {} for the scheduler on {}",
        config.executor_id, args.scheduler
    ));
    start_executor_process(Arc::new(config))
        .await
        .map_err(|error| anyhow!("{error}"))?;
    Ok(ExitCode::SUCCESS)
}

fn free_port(host: IpAddr) -> anyhow::Result<u16> {
    let listener = TcpListener::bind((host, 0))
        .with_context(|| format!("{host} is no address of this machine"))?;
    Ok(listener.local_addr()?.port())
}
