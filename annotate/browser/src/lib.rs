//! What the browser tests share: a server of their own, a Chromium of their own, and words for what a
//! person does at the keyboard.
//!
//! The tests drive the built `stance` command (`STANCE_BIN`) with Debian's Chromium through its own
//! driver. Each test has a data folder, a server on a free port and a browser profile to itself, so
//! they run in any order and side by side.

mod browser;
mod server;

pub use browser::{Browser, Graphics, keys};
pub use server::{Dataset, Server, report_page};

use std::time::Duration;

/// How long anything that is expected may take. Long, because the machines of a check may be slow;
/// nothing is measured by it.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Between two looks at a condition.
pub const LOOK_EVERY: Duration = Duration::from_millis(40);
