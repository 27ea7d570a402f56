//! What the store takes and gives.

use serde::{Deserialize, Serialize};

use crate::state::LogKind;
use crate::wire::{
    Answer, Empty, Lease, ReviewEmpty, Revision, RevisionState, Role, Suggestion, SuggestionSource,
    TaskKind, TaskState, User, Verdict,
};

/// Milliseconds since the epoch.
pub type Millis = i64;

/// Somebody who is logged in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Who {
    /// Id.
    pub id: i64,
    /// Name.
    pub name: String,
    /// What they may do.
    pub role: Role,
}

/// A motion the tasks speak of; its frames stay in the dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionRecord {
    /// Content hash.
    pub hash: String,
    /// Id in the dataset.
    pub id: String,
    /// train, val or test.
    pub split: String,
    /// Frames.
    pub frames: i64,
    /// Frames a second.
    pub fps: f64,
    /// Captions of the source.
    pub captions: Vec<String>,
    /// Style label of the source.
    pub style: Option<String>,
    /// Action label of the source.
    pub action: Option<String>,
}

/// A task to be imported.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NewTask {
    /// What tells it from others: importing the same key again changes nothing.
    pub key: String,
    /// What is asked.
    pub kind: TaskKind,
    /// Hash of the motion, or of the one before the edit.
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
    /// What a pair was made for.
    pub hint: Option<String>,
    /// Style the source gives.
    pub style: Option<String>,
    /// Tasks of higher priority are given first.
    pub priority: i64,
    /// The known answer, of a gold task.
    pub gold: Option<Answer>,
    /// Fields of a source's file that have no place here, kept to be written back.
    pub extra: Option<serde_json::Value>,
    /// Suggestions that come with it.
    pub suggestions: Vec<NewSuggestion>,
    /// An answer that the source holds as decided: the task is accepted from the start.
    pub accepted: Option<Answer>,
}

/// A suggestion to be stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NewSuggestion {
    /// Where it came from.
    pub source: SuggestionSource,
    /// Parts it speaks of.
    pub parts: Vec<String>,
    /// Text.
    pub text: String,
    /// What made it.
    pub model: String,
    /// SHA-256 of the prompt, hexadecimal; empty without one.
    pub prompt_hash: String,
    /// Parameters of the request, JSON.
    pub params: String,
    /// Tokens the model counted, if it says.
    pub tokens: Option<i64>,
    /// SHA-256 of the response, hexadecimal; empty without one.
    pub response_hash: String,
}

/// A task as it is stored.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskRecord {
    /// Id.
    pub id: i64,
    /// What tells it from others.
    pub key: String,
    /// What is asked.
    pub kind: TaskKind,
    /// Hash of the first motion.
    pub source: String,
    /// Hash of the second motion.
    pub target: Option<String>,
    /// train, val or test.
    pub split: String,
    /// Bundle.
    pub bundle: Option<i64>,
    /// Place in the bundle.
    pub bundle_index: i64,
    /// Action category.
    pub category: Option<String>,
    /// What a pair was made for.
    pub hint: Option<String>,
    /// Style the source gives.
    pub style: Option<String>,
    /// Answers wanted.
    pub wanted: u32,
    /// The known answer, of a gold task.
    pub gold: Option<Answer>,
    /// Fields kept for their source.
    pub extra: Option<serde_json::Value>,
    /// Where it stands.
    pub state: TaskState,
    /// Answers handed in.
    pub submitted: u32,
    /// A number from 0 to 99 drawn by its key.
    pub shuffle: i64,
    /// How far its answers are apart.
    pub distance: Option<f64>,
}

/// A task of a bundle, as somebody sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct BundleEntry {
    /// Task.
    pub task: i64,
    /// State of their answer.
    pub mine: Option<RevisionState>,
    /// Their verdict.
    pub verdict: Option<Verdict>,
    /// Whether they hold a lease on it.
    pub leased: bool,
}

/// A task with everything somebody may see of it.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskDetail {
    /// The task.
    pub task: TaskRecord,
    /// Its bundle.
    pub bundle: Vec<BundleEntry>,
    /// Their lease.
    pub lease: Option<Lease>,
    /// Their answer.
    pub mine: Option<Revision>,
    /// The comment it came back with.
    pub comment: Option<String>,
    /// Suggestions; none where they are withheld.
    pub suggestions: Vec<Suggestion>,
    /// Whether they are withheld.
    pub blind: bool,
}

/// What a claim gives.
#[derive(Clone, Debug, PartialEq)]
pub enum Claimed {
    /// A task; the lease on it is held.
    Task {
        /// The task as its holder may see it.
        detail: Box<TaskDetail>,
        /// Hashes of the motions of the tasks that would follow.
        upcoming: Vec<String>,
    },
    /// Nothing, and why.
    Nothing(Empty),
}

/// What a reviewer is given.
#[derive(Clone, Debug, PartialEq)]
pub enum ReviewClaimed {
    /// A task to be judged.
    Task(Box<ReviewDetail>),
    /// Nothing, and why.
    Nothing(ReviewEmpty),
}

/// A task to be judged.
#[derive(Clone, Debug, PartialEq)]
pub struct ReviewDetail {
    /// The task.
    pub task: TaskRecord,
    /// The reviewer's lease.
    pub lease: Lease,
    /// Answers handed in, with the names of their authors.
    pub candidates: Vec<(Revision, String)>,
    /// Comments of earlier rounds.
    pub comments: Vec<String>,
}

/// Tasks whose keys are above one and not above another, by their bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyRange {
    /// The key before the first.
    pub after: String,
    /// The last key.
    pub up_to: String,
}

/// An answer with its task, for figures and exports.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// Task.
    pub task: i64,
    /// Its kind.
    pub kind: TaskKind,
    /// Whether it is a gold task.
    pub gold: bool,
    /// Its category.
    pub category: Option<String>,
    /// Hash of its first motion.
    pub source: String,
    /// Hash of its second motion.
    pub target: Option<String>,
    /// Split.
    pub split: String,
    /// The answer.
    pub revision: Revision,
    /// Whether suggestions were withheld.
    pub blind: bool,
}

/// An accepted answer with its task.
#[derive(Clone, Debug, PartialEq)]
pub struct AcceptedAnswer {
    /// The task.
    pub task: TaskRecord,
    /// Its author: an annotator, or the reviewer who merged.
    pub author: i64,
    /// Whether a reviewer made it of several.
    pub merged: bool,
    /// The answer.
    pub answer: Answer,
    /// When it was accepted.
    pub at: Millis,
    /// Place in the log.
    pub seq: i64,
}

/// A task that was dropped, or skipped by somebody.
#[derive(Clone, Debug, PartialEq)]
pub struct Reject {
    /// The task.
    pub task: TaskRecord,
    /// Who decided.
    pub user: Option<i64>,
    /// Why.
    pub reason: String,
    /// More about it.
    pub note: String,
}

/// Which accepted answers to show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShelfFilter {
    /// Of one kind.
    pub kind: Option<TaskKind>,
    /// With a part.
    pub part: Option<String>,
    /// With these words.
    pub text: Option<String>,
    /// Before this place in the log.
    pub before: Option<i64>,
    /// At most so many.
    pub limit: usize,
}

/// Which entries of the log to show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AuditFilter {
    /// By somebody.
    pub actor: Option<i64>,
    /// Of a kind.
    pub kind: Option<LogKind>,
    /// About a task.
    pub task: Option<i64>,
    /// Before this place in the log.
    pub before: Option<i64>,
    /// At most so many.
    pub limit: usize,
}

/// What somebody did, summed up.
#[derive(Clone, Debug, PartialEq)]
pub struct PersonCounts {
    /// Who.
    pub user: User,
    /// Answers handed in.
    pub done: i64,
    /// Answers accepted.
    pub accepted: i64,
    /// Answers sent back, ever.
    pub returned: i64,
    /// Scores on gold tasks.
    pub gold: Vec<f64>,
    /// Last entry of the log by them.
    pub last_seen: Option<Millis>,
}

/// Counts of a week.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WeekCounts {
    /// Answers handed in.
    pub submitted: i64,
    /// Accepted or merged.
    pub accepted: i64,
    /// Sent back.
    pub returned: i64,
}

/// A new token, shown once.
#[derive(Clone, Debug, PartialEq)]
pub struct IssuedToken {
    /// Whose it is.
    pub user: User,
    /// Id.
    pub id: i64,
    /// The token.
    pub token: String,
    /// When it ends.
    pub expires: Millis,
}

/// What importing tasks did.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Imported {
    /// Tasks that are new.
    pub new: i64,
    /// Tasks that were there already.
    pub known: i64,
}

/// What a token is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TokenUse {
    /// Access token of a user or a program, for login or as a bearer token.
    Token,
    /// Good for one login.
    Once,
    /// The cookie of a browser.
    Session,
}

impl TokenUse {
    /// Its name in the store.
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Token => "token",
            Self::Once => "once",
            Self::Session => "session",
        }
    }
}
