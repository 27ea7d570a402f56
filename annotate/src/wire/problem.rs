//! Problems: the error responses.

use serde::{Deserialize, Serialize};

use super::answer::Revision;
use super::names::Code;

/// A problem (RFC 9457), as `application/problem+json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Problem {
    /// `/problems/` and the code.
    #[serde(rename = "type")]
    pub kind: String,
    /// Meaning of the code.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// Stable code.
    pub code: Code,
    /// What happened, and what to do.
    pub detail: String,
    /// The invalid field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// Seconds until a retry is allowed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry_after_secs: Option<u64>,
    /// The current revision of the store, if the request is based on another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub theirs: Option<Box<Revision>>,
}
