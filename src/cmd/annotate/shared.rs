//! Helpers of several actions: the time, and lines of counts.

use std::collections::BTreeMap;
use std::time::{SystemTime, UNIX_EPOCH};

use annotate::store::Store;

/// Milliseconds since 1970, by the clock of a store that several machines share.
pub(super) fn now(store: &Store) -> anyhow::Result<i64> {
    Ok(store.now()?.unwrap_or_else(now_here))
}

/// Milliseconds since 1970, by the clock of this machine.
pub(super) fn now_here() -> i64 {
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
