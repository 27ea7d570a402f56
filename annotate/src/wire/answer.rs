//! Answers and suggestions.

use serde::{Deserialize, Serialize};

use super::names::{
    CountReason, EditType, Extent, JointWeight, RevisionState, SuggestionSource, Verdict,
};

/// One mask of an answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct MaskAnswer {
    /// Names of the parts as entered: LEFT_ARM with RIGHT_ARM is not merged to BOTH_ARMS.
    pub parts: Vec<String>,
    /// Whether the soft ring is blended.
    #[serde(default = "yes")]
    pub soft: bool,
    /// Joints whose weight differs from the one that the parts and `soft` give them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joints: Vec<JointChoice>,
    /// First frame that the mask holds for, and the one after the last; the whole clip if missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[i32; 2]>,
    /// What the parts do.
    pub text: String,
    /// The suggestion the text started from, if any.
    #[serde(default)]
    pub suggestion: Option<i64>,
}

/// The weight that a person chose for a joint of a mask.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct JointChoice {
    /// Name of one of the 22 body joints.
    pub joint: String,
    /// Its weight.
    pub weight: JointWeight,
}

pub(super) fn yes() -> bool {
    true
}

/// An answer. Which fields count depends on the kind of the task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Answer {
    /// To a task `mask_text`.
    MaskText {
        /// The masks.
        masks: Vec<MaskAnswer>,
        /// Reason for fewer or more masks than the project wants.
        #[serde(default)]
        count_reason: Option<CountReason>,
        /// Note.
        #[serde(default)]
        note: String,
    },
    /// To a task `pair`.
    Pair {
        /// Verdict.
        verdict: Verdict,
        /// Parts the edit changes.
        #[serde(default)]
        parts: Vec<String>,
        /// Type of the edit.
        #[serde(default)]
        edit_type: Option<EditType>,
        /// The instruction.
        #[serde(default)]
        text: String,
        /// The suggestion the text started from, if any.
        #[serde(default)]
        suggestion: Option<i64>,
        /// Note.
        #[serde(default)]
        note: String,
    },
    /// To a task `style`.
    Style {
        /// Verdict.
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
        /// The suggestion the text started from, if any.
        #[serde(default)]
        suggestion: Option<i64>,
        /// Note.
        #[serde(default)]
        note: String,
    },
}

/// The current answer of a user to a task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Revision {
    /// Task.
    pub task: i64,
    /// Author.
    pub author: i64,
    /// Revision number: counts drafts and submissions from 1.
    pub rev: i64,
    /// State.
    pub state: RevisionState,
    /// The answer.
    pub answer: Answer,
    /// When it was last written.
    pub at: i64,
    /// Seconds of work.
    pub secs: f64,
}

/// A proposal by a program or the source; never an answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Suggestion {
    /// Id.
    pub id: i64,
    /// Origin.
    pub source: SuggestionSource,
    /// Parts that it describes.
    pub parts: Vec<String>,
    /// Text; empty for parts alone.
    pub text: String,
    /// Name of the model or program.
    pub model: String,
}
