//! Answers and suggestions.

use serde::{Deserialize, Serialize};

use super::names::{CountReason, EditType, Extent, RevisionState, SuggestionSource, Verdict};

/// One mask of an answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaskAnswer {
    /// Names of the parts, as typed: LEFT+RIGHT stays so.
    pub parts: Vec<String>,
    /// Whether the soft ring is blended.
    #[serde(default = "yes")]
    pub soft: bool,
    /// What the parts do.
    pub text: String,
    /// The suggestion the text began as, if any.
    #[serde(default)]
    pub suggestion: Option<i64>,
}

pub(super) fn yes() -> bool {
    true
}

/// An answer. Which fields count depends on the kind of the task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Answer {
    /// To a task `mask_text`.
    MaskText {
        /// The masks.
        masks: Vec<MaskAnswer>,
        /// Why there are fewer or more than the project asks for.
        #[serde(default)]
        count_reason: Option<CountReason>,
        /// Anything else.
        #[serde(default)]
        note: String,
    },
    /// To a task `pair`.
    Pair {
        /// Whether it is kept, and why not.
        verdict: Verdict,
        /// Parts the edit changes.
        #[serde(default)]
        parts: Vec<String>,
        /// What it changes.
        #[serde(default)]
        edit_type: Option<EditType>,
        /// The instruction.
        #[serde(default)]
        text: String,
        /// The suggestion the text began as, if any.
        #[serde(default)]
        suggestion: Option<i64>,
        /// Anything else.
        #[serde(default)]
        note: String,
    },
    /// To a task `style`.
    Style {
        /// Whether it is kept, and why not.
        verdict: Verdict,
        /// Parts the style shows in.
        #[serde(default)]
        parts: Vec<String>,
        /// The style.
        #[serde(default)]
        style: Option<String>,
        /// How much of the body it shows in.
        #[serde(default)]
        extent: Option<Extent>,
        /// The instruction.
        #[serde(default)]
        text: String,
        /// The suggestion the text began as, if any.
        #[serde(default)]
        suggestion: Option<i64>,
        /// Anything else.
        #[serde(default)]
        note: String,
    },
}

/// The current answer of somebody to a task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Revision {
    /// Task.
    pub task: i64,
    /// Author.
    pub author: i64,
    /// Counts every draft and submission, from 1.
    pub rev: i64,
    /// Where it stands.
    pub state: RevisionState,
    /// What it says.
    pub answer: Answer,
    /// When it was last written.
    pub at: i64,
    /// Seconds the author was at it.
    pub secs: f64,
}

/// What a machine or the source proposes. It is never an answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suggestion {
    /// Id.
    pub id: i64,
    /// Where it came from.
    pub source: SuggestionSource,
    /// Parts it speaks of.
    pub parts: Vec<String>,
    /// Text; empty for parts alone.
    pub text: String,
    /// What made it.
    pub model: String,
}
