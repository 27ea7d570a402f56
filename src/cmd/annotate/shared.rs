//! What all actions need: the time, and how they say their result.

use std::time::{SystemTime, UNIX_EPOCH};

use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Milliseconds since 1970.
pub(super) fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| {
        i64::try_from(since.as_millis()).unwrap_or(i64::MAX)
    })
}

/// Prints a result, for programs or for people.
pub(super) fn say(
    global: &Global,
    document: &serde_json::Value,
    text: &str,
) -> anyhow::Result<Exit> {
    if global.json {
        report::json(document)?;
    } else {
        report::text(text);
    }
    Ok(Exit::Done)
}
