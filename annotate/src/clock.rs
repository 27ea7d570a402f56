//! Clock passed to the server by its caller.

use std::sync::Arc;

use crate::store::Millis;

/// Returns the current time in milliseconds since the epoch.
pub type Clock = Arc<dyn Fn() -> Millis + Send + Sync>;
