//! `stance-cluster scheduler`

use std::net::SocketAddr;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, anyhow};
use ballista_core::config::TaskSchedulingPolicy;
use ballista_scheduler::cluster::BallistaCluster;
use ballista_scheduler::config::SchedulerConfig;
use ballista_scheduler::scheduler_process::{create_scheduler, start_grpc_service_with_listener};
use datafusion_proto::protobuf::{LogicalPlanNode, PhysicalPlanNode};
use tokio::net::TcpListener;

use crate::function::Isolation;
use crate::{note, session};

/// Start the scheduler. It keeps its jobs in memory: after a restart, run the plan again.
///
/// Ballista has no passwords: listen on a private network only.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Address to listen on; port 0 takes a free one
    #[arg(long, default_value = "127.0.0.1:50050")]
    listen: SocketAddr,
    /// Seconds without a word from an executor after which its pieces go to others
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(8..))]
    executor_timeout: u64,
    /// Seconds that a job waits for an executor after the last one is lost
    #[arg(long, default_value_t = 60)]
    grace: u64,
}

/// Runs until the process is ended.
pub(crate) async fn run(args: Args) -> anyhow::Result<ExitCode> {
    let listener = TcpListener::bind(args.listen)
        .await
        .with_context(|| format!("cannot listen on {}", args.listen))?;
    let address = listener.local_addr()?;
    let config = SchedulerConfig {
        bind_host: address.ip().to_string(),
        external_host: address.ip().to_string(),
        bind_port: address.port(),
        // Executors poll for work, which is also their heartbeat, so they continue after a restart of the scheduler.
        scheduling_policy: TaskSchedulingPolicy::PullStaged,
        executor_timeout_seconds: args.executor_timeout,
        expire_dead_executor_interval_seconds: 2,
        no_executors_grace_period_seconds: args.grace,
        // A piece that ends its executor is tried this many times.
        task_max_failures: 4,
        override_session_builder: Some(Arc::new(|config| session::state(config, Isolation::None))),
        ..SchedulerConfig::default()
    };
    let cluster = BallistaCluster::new_from_config(&config)
        .await
        .map_err(|error| anyhow!("{error}"))?;
    let config = Arc::new(config);
    config.validate().map_err(|error| anyhow!("{error}"))?;
    let scheduler = create_scheduler::<LogicalPlanNode, PhysicalPlanNode>(cluster, config)
        .await
        .map_err(|error| anyhow!("{error}"))?;
    note(&format!("scheduler on {address}"));
    start_grpc_service_with_listener(listener, scheduler)
        .await
        .map_err(|error| anyhow!("{error}"))
        .with_context(|| format!("the scheduler on {address} ended"))?;
    Ok(ExitCode::SUCCESS)
}
