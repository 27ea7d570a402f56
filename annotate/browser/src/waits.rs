//! How long tests wait.

use std::time::Duration;

/// Timeout of every wait. It is long because test machines can be slow.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Polling interval of a condition.
pub const LOOK_EVERY: Duration = Duration::from_millis(40);
