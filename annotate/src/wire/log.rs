//! The log, changes, and the guide.

use serde::{Deserialize, Serialize};

/// An entry of the log, for `GET audit` and `GET tasks/{id}/history`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct AuditEntry {
    /// Sequence number in the log.
    pub seq: i64,
    /// When.
    pub at: i64,
    /// User; `null` for the program itself.
    pub actor: Option<i64>,
    /// Their name.
    pub actor_name: Option<String>,
    /// Kind of entry.
    pub kind: String,
    /// Task.
    pub task: Option<i64>,
    /// Body of the entry.
    #[cfg_attr(test, ts(type = "unknown"))]
    pub body: serde_json::Value,
}

/// `GET audit`: newest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Audit {
    /// Entries.
    pub entries: Vec<AuditEntry>,
    /// Value of `before` for the next page.
    pub next: Option<i64>,
}

/// An entry of `GET stream` (event `change`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Change {
    /// Sequence number in the log.
    pub seq: i64,
    /// What happened.
    pub kind: String,
    /// Task.
    pub task: Option<i64>,
    /// Whether the task is one of mine.
    pub mine: bool,
}

/// `GET guide`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Guide {
    /// Plain text.
    pub text: String,
}
