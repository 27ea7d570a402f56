//! Argument and result types of the store.

use serde::{Deserialize, Serialize};

use crate::state::LogKind;
use crate::wire::{
    Answer, EditType, Lease, MotionInfo, Revision, Role, Standing, Suggestion, SuggestionSource,
    TaskKind, TaskState, names,
};

pub use crate::wire::{BundleItem as BundleEntry, TokenShown as IssuedToken};

/// Milliseconds since the epoch.
pub type Millis = i64;

/// A logged-in user.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Who {
    /// Id.
    pub id: i64,
    /// Name.
    pub name: String,
    /// Role.
    pub role: Role,
}

/// A motion that tasks refer to; its frames stay in the dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionRecord {
    /// Content hash.
    pub hash: String,
    /// Id in the dataset.
    pub id: String,
    /// train, val or test.
    pub split: String,
    /// Number of frames.
    pub frames: i64,
    /// Frames per second.
    pub fps: f64,
    /// Captions of the source.
    pub captions: Vec<String>,
    /// Style label of the source.
    pub style: Option<String>,
    /// Action label of the source.
    pub action: Option<String>,
}

impl From<MotionRecord> for MotionInfo {
    fn from(motion: MotionRecord) -> Self {
        Self {
            hash: motion.hash,
            id: motion.id,
            frames: usize::try_from(motion.frames).unwrap_or(0),
            fps: motion.fps,
            split: motion.split,
            captions: motion.captions,
            style: motion.style,
        }
    }
}

/// A task to be imported.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NewTask {
    /// Unique key: importing the same key again changes nothing.
    pub key: String,
    /// Kind of task.
    pub kind: TaskKind,
    /// Hash of the motion; for a pair, of the motion before the edit.
    pub source: String,
    /// Hash of the motion after the edit.
    pub target: Option<String>,
    /// train, val or test.
    pub split: String,
    /// Name of the bundle it belongs to.
    pub bundle: Option<String>,
    /// Place in the bundle.
    pub bundle_index: i64,
    /// Action category.
    pub category: Option<String>,
    /// Edit that the pair was made for.
    pub hint: Option<String>,
    /// Style label of the source.
    pub style: Option<String>,
    /// Edit type that the source states, for the quotas.
    pub edit_type: Option<EditType>,
    /// Tasks of higher priority are given first.
    pub priority: i64,
    /// The known answer of a gold task.
    pub gold: Option<Answer>,
    /// Unknown fields of the source file, kept for export.
    pub extra: Option<serde_json::Value>,
    /// Suggestions.
    pub suggestions: Vec<NewSuggestion>,
    /// A decided answer of the source, with which the task starts as accepted. A task that exists already becomes
    /// accepted if it is about the same motions and nobody has worked on it.
    pub accepted: Option<Answer>,
    /// Author and acceptance of `accepted`, as stated by an export.
    pub credit: Option<Credit>,
}

/// Author and acceptance of an imported answer, as its file states them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Credit {
    /// Pseudonym of its author, from the export of another store.
    pub author: Option<String>,
    /// Whether a reviewer merged it from several answers.
    pub merged: bool,
    /// How the answer was accepted: `review`, `own` or `rule:NAME`.
    #[serde(default)]
    pub accepted_by: Option<String>,
    /// Whether it was imported from the dataset. Exports to a dataset leave such labels as they are.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub of_dataset: bool,
}

/// A suggestion to be stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NewSuggestion {
    /// Origin.
    pub source: SuggestionSource,
    /// Parts that the text describes.
    pub parts: Vec<String>,
    /// Text.
    pub text: String,
    /// Name of the model or program.
    pub model: String,
    /// SHA-256 of the prompt, hexadecimal; empty without one.
    pub prompt_hash: String,
    /// Parameters of the request, JSON.
    pub params: String,
    /// Tokens counted by the model, if it reports them.
    pub tokens: Option<i64>,
    /// SHA-256 of the response, hexadecimal; empty without one.
    pub response_hash: String,
}

/// A task as it is stored.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct TaskRecord {
    /// Id.
    pub id: i64,
    /// Unique key.
    pub key: String,
    /// Kind of task.
    pub kind: TaskKind,
    /// Hash of the motion; for a pair, of the motion before the edit.
    pub source: String,
    /// Hash of the motion after the edit.
    pub target: Option<String>,
    /// train, val or test.
    pub split: String,
    /// Id of its bundle.
    pub bundle: Option<i64>,
    /// Place in the bundle.
    pub bundle_index: i64,
    /// Action category.
    pub category: Option<String>,
    /// Edit that the pair was made for.
    pub hint: Option<String>,
    /// Style label of the source.
    pub style: Option<String>,
    /// Answers wanted.
    pub wanted: u32,
    /// The known answer of a gold or practice task when it was made.
    pub gold: Option<Answer>,
    /// Unknown fields of the source file.
    pub extra: Option<serde_json::Value>,
    /// State.
    pub state: TaskState,
    /// Submitted answers.
    pub submitted: u32,
    /// Pseudo-random number from 0 to 99, drawn from its key.
    pub shuffle: i64,
    /// Largest distance between its answers, 0 to 1; `None` below two answers.
    pub distance: Option<f64>,
    /// Whether it is a practice task: its known answer is shown to those who answered it.
    pub practice: bool,
    /// Whether one of its clips was ingested again with other content after somebody answered.
    pub changed: bool,
}

/// A task with all that its user may see.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskDetail {
    /// The task.
    pub task: TaskRecord,
    /// Tasks of the bundle, from the user's point of view.
    pub bundle: Vec<BundleEntry>,
    /// The user's lease.
    pub lease: Option<Lease>,
    /// The user's answer.
    pub mine: Option<Revision>,
    /// The reviewer's comment, if the answer was returned.
    pub comment: Option<String>,
    /// Suggestions; empty if they are withheld.
    pub suggestions: Vec<Suggestion>,
    /// Whether suggestions are withheld.
    pub blind: bool,
    /// Whether the clip was ingested again, with other content, after the user wrote an answer.
    pub clip_changed: bool,
}

/// A task to review.
#[derive(Clone, Debug, PartialEq)]
pub struct ReviewDetail {
    /// The task.
    pub task: TaskRecord,
    /// The reviewer's lease.
    pub lease: Lease,
    /// Submitted answers with the names of their authors.
    pub candidates: Vec<(Revision, String)>,
    /// Comments of earlier decisions, oldest first.
    pub comments: Vec<String>,
    /// The imported or merged answer that was accepted before the task was reopened.
    pub former: Option<Answer>,
}

/// A range of task keys in byte order: above `after`, up to and including `up_to`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyRange {
    /// The last key before the range.
    pub after: String,
    /// The last key of the range.
    pub up_to: String,
}

/// An answer with its task, for figures and exports.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Label {
    /// Task.
    pub task: i64,
    /// Kind of the task.
    pub kind: TaskKind,
    /// Whether the task is a gold task.
    pub gold: bool,
    /// Number of frames of its first motion; 1 for an unknown motion.
    pub frames: i64,
    /// The answer.
    pub revision: Revision,
    /// Whether suggestions were withheld.
    pub blind: bool,
    /// Whether a reviewer ever returned an answer of its author to the task.
    pub returned: bool,
    /// How the answer was accepted: `review`, `own`, `rule:NAME`. Only exports read it.
    pub accepted_by: Option<String>,
}

/// An accepted answer with its task.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct AcceptedAnswer {
    /// The task.
    pub task: TaskRecord,
    /// The author: an annotator, or the reviewer who merged.
    pub author: i64,
    /// Whether a reviewer merged it from several answers.
    pub merged: bool,
    /// Pseudonym of the author of an imported answer.
    pub credit: Option<String>,
    /// How the answer was accepted: `review`, `own` or `rule:NAME`. An imported answer has `import`, and a label of the
    /// dataset `import.dataset`; if the file says how it was accepted, that follows after a colon: `import:review`.
    pub basis: String,
    /// The answer.
    pub answer: Answer,
    /// Time of acceptance.
    pub at: Millis,
    /// Sequence number in the log.
    pub seq: i64,
}

impl AcceptedAnswer {
    /// Whether it was imported from the dataset, and nobody has judged it here.
    pub fn is_of_dataset(&self) -> bool {
        self.basis.starts_with("import.dataset")
    }

    /// How the answer was accepted, here or before its import: `review`, `own` or `rule:NAME`; or `import`, if the imported
    /// file does not say.
    pub fn accepted_by(&self) -> &str {
        let rest = self.basis.strip_prefix("import");
        let rest = rest.map(|rest| rest.strip_prefix(".dataset").unwrap_or(rest));
        rest.map_or(&self.basis, |rest| {
            rest.strip_prefix(':').unwrap_or("import")
        })
    }
}

/// A dropped or skipped task.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Reject {
    /// The task.
    pub task: TaskRecord,
    /// The user who dropped or skipped the task.
    pub user: Option<i64>,
    /// `dropped`, or the reason of a skip.
    pub reason: String,
    /// Comment of the drop, or note of the skip.
    pub note: String,
}

/// Filter on accepted answers.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShelfFilter {
    /// Only answers of this kind.
    pub kind: Option<TaskKind>,
    /// Only answers with this part.
    pub part: Option<String>,
    /// Only answers that contain this text, regardless of case.
    #[serde(rename = "q")]
    pub text: Option<String>,
    /// Only answers before this sequence number of the log.
    pub before: Option<i64>,
    /// Maximum number of answers.
    pub limit: usize,
}

/// Filter on log entries.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AuditFilter {
    /// Only entries of this user.
    pub actor: Option<i64>,
    /// Only entries of this kind.
    pub kind: Option<LogKind>,
    /// Only entries about this task.
    pub task: Option<i64>,
    /// Only entries before this sequence number of the log.
    pub before: Option<i64>,
    /// Maximum number of entries.
    pub limit: usize,
}

/// Query of a page of a person's answers.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MineQuery {
    /// Only answers with this standing.
    pub standing: Option<Standing>,
    /// Only answers of this kind.
    pub kind: Option<TaskKind>,
    /// Only answers to this task.
    pub task: Option<i64>,
    /// Cursor of the previous page.
    pub before: Option<String>,
    /// Maximum number of answers.
    pub limit: usize,
}

/// Result of an import of tasks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Imported {
    /// New tasks.
    pub new: i64,
    /// Tasks that existed and stay unchanged.
    pub known: i64,
    /// Tasks that existed, that nobody had worked on, and that are accepted now.
    pub filled: i64,
    /// Keys of tasks whose imported answer was skipped, because the task already has an answer or a decision.
    pub conflicts: Vec<String>,
    /// Keys of further such tasks, which once had the imported answer.
    pub earlier: Vec<String>,
    /// Keys under which a task about other motions existed. It stays as it was, and what was imported is skipped.
    pub others: Vec<String>,
}

names! {
    /// Purpose of a token.
    pub enum TokenUse {
        /// For any number of logins, or for the bearer header of a program.
        Token = "token",
        /// For one login.
        Once = "once",
        /// For the cookie of a browser.
        Session = "session",
    }
}
