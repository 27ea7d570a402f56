//! The log, changes, and the guide.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::names::{TaskKind, TextForm};

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
    /// What holds for all kinds, plain text.
    pub text: String,
    /// Guidelines of each kind.
    pub kinds: BTreeMap<TaskKind, KindGuide>,
    /// What the texts of each kind are.
    pub forms: BTreeMap<TaskKind, TextForm>,
}

/// Guidelines of a kind of task. `GET`/`PUT guide/{kind}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields, default)]
pub struct KindGuide {
    /// Plain text.
    pub text: String,
    /// Examples.
    pub pictures: Vec<GuidePicture>,
}

/// A picture of a right or a wrong answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct GuidePicture {
    /// Name, at `guide/pictures/{name}`.
    pub name: String,
    /// What it shows.
    pub caption: String,
    /// Whether the answer it shows is right.
    pub right: bool,
}

/// `GET guide/pictures`: a stored picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct PictureInfo {
    /// Name: up to 60 letters, digits, dashes, dots and underscores.
    pub name: String,
    /// Type of its content.
    pub mime: String,
    /// Size in bytes.
    pub bytes: usize,
}
