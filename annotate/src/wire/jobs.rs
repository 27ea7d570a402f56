//! Exports and other jobs.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::names::ExportFormat;

/// `POST exports`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct ExportRequest {
    /// Layout.
    pub format: ExportFormat,
    /// Splits to export; all if empty.
    #[serde(default)]
    pub splits: Vec<String>,
    /// Also write the log (format `parquet` only).
    #[serde(default)]
    pub events: bool,
}

/// `GET jobs/{id}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// Id.
    pub id: i64,
    /// `import` or `export`.
    pub kind: String,
    /// Layout.
    pub format: String,
    /// `running`, `done` or `failed`.
    pub state: String,
    /// Items done.
    pub done: i64,
    /// Items in all, once known.
    pub total: Option<i64>,
    /// Counts of imported, written and omitted items.
    pub counts: BTreeMap<String, i64>,
    /// Messages about errors and omitted items.
    pub messages: Vec<String>,
    /// Files to download, at `jobs/{id}/files/{name}`.
    pub files: Vec<String>,
    /// When it began.
    pub started: i64,
    /// When it ended.
    pub finished: Option<i64>,
    /// When its server last reported on it.
    #[serde(default)]
    pub heartbeat: i64,
}
