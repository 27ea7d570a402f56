//! Problems: what a refused request is answered with.

use serde::{Deserialize, Serialize};

use super::answer::Revision;
use super::names::Code;

/// A problem (RFC 9457), as `application/problem+json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Problem {
    /// `/problems/` and the code.
    #[serde(rename = "type")]
    pub kind: String,
    /// What the code means.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// Stable code.
    pub code: Code,
    /// What happened here, and what to do.
    pub detail: String,
    /// The field that is wrong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// When to come back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry_after_secs: Option<u64>,
    /// The revision the store has, where yours is based on another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub theirs: Option<Box<Revision>>,
}
