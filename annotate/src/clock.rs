//! The clock a caller gives to the server.

use std::sync::Arc;

use crate::store::Millis;

/// Milliseconds since the epoch, now.
pub type Clock = Arc<dyn Fn() -> Millis + Send + Sync>;
