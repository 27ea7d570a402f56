//! Helpers of several actions: the time, and lines of counts.

use std::collections::BTreeMap;
use std::time::{SystemTime, UNIX_EPOCH};

/// Milliseconds since 1970.
pub(super) fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| {
        i64::try_from(since.as_millis()).unwrap_or(i64::MAX)
    })
}

/// A line for each count, and then the messages.
pub(super) fn lines_of(counts: &BTreeMap<String, i64>, messages: &[String]) -> Vec<String> {
    let counts = counts.iter();
    let lines = counts.map(|(what, count)| format!("  {what:<24} {count:>8}"));
    lines.chain(messages.iter().cloned()).collect()
}
