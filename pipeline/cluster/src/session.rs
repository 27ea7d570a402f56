//! Sessions of DataFusion that know the function and give every task one partition.

use std::sync::Arc;

use ballista_core::config::BALLISTA_SCHEDULER_MAX_PARTITIONS_PER_TASK;
use ballista_core::extension::SessionConfigExt;
use datafusion::common::Result;
use datafusion::execution::context::{SessionConfig, SessionState};
use datafusion::execution::{FunctionRegistry, SessionStateBuilder};

use crate::function::{self, Isolation};

/// Settings of the query; `others` are further keys of Ballista.
///
/// # Errors
/// A key is unknown or its value does not fit.
pub(crate) fn config(partitions: usize, others: &[(String, String)]) -> Result<SessionConfig> {
    let mut config = SessionConfig::new_with_ballista()
        .with_target_partitions(partitions.max(1))
        .with_ballista_adaptive_query_planner(false);
    let options = config.options_mut();
    // Unbounded by default: a task would take as many partitions as its executor has cores, and all would be repeated
    // if the executor is lost.
    options.set(BALLISTA_SCHEDULER_MAX_PARTITIONS_PER_TASK, "1")?;
    for (key, value) in others {
        options.set(key, value)?;
    }
    Ok(config)
}

/// A session with the function.
///
/// # Errors
/// The function cannot be registered.
pub(crate) fn state(config: SessionConfig, isolation: Isolation) -> Result<SessionState> {
    let mut state = SessionStateBuilder::new()
        .with_default_features()
        .with_config(config)
        .build();
    state.register_udf(Arc::new(function::function(isolation)))?;
    Ok(state)
}
