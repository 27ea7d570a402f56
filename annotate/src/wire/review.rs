//! Reviews.

use serde::{Deserialize, Serialize};

use super::answer::{Answer, Revision, Suggestion};
use super::names::{Decision, ReviewQueue, TaskKind, TaskState};
use super::task::{Lease, Task};

/// `POST review/next`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct ReviewRequest {
    /// Queue.
    pub queue: ReviewQueue,
    /// Only this kind.
    #[serde(default)]
    pub kind: Option<TaskKind>,
    /// This task, whatever its queue and kind.
    #[serde(default)]
    pub task: Option<i64>,
}

/// Answer to `POST review/next`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct ReviewNext {
    /// The task and its answers.
    pub review: Option<ReviewView>,
    /// Why there is none.
    pub empty: Option<ReviewEmpty>,
}

/// Why there is nothing to review.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct ReviewEmpty {
    /// Submitted tasks of the queue.
    pub waiting: i64,
    /// Of these, those I answered myself.
    pub mine: i64,
    /// Of these, those leased by another reviewer.
    pub in_review: i64,
}

/// A task to review.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct ReviewView {
    /// The task.
    pub task: Task,
    /// My lease.
    pub lease: Lease,
    /// The submitted answers.
    pub candidates: Vec<Candidate>,
    /// Largest distance of the answers, 0 to 1; `null` for a single answer.
    pub distance: Option<f64>,
    /// Comments of earlier rounds, oldest first.
    pub comments: Vec<String>,
    /// Suggestions that the annotators were offered, unless theirs was a blind task.
    pub suggestions: Vec<Suggestion>,
    /// Whether the clip was ingested anew, with other content, after the answers were written.
    pub clip_changed: bool,
}

/// An answer to review.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Candidate {
    /// The answer.
    pub revision: Revision,
    /// Name of its author.
    pub author_name: String,
    /// Body joints of its masks, hard or soft, for the viewer.
    pub joints: Vec<usize>,
    /// Edit distance of its texts from their drafts, 0 to 1.
    pub draft_distance: Option<f64>,
}

/// Requests without seconds keep the hash they had before there was this field.
#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn none(secs: &f64) -> bool {
    *secs == 0.0
}

/// `POST reviews`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct NewReview {
    /// Unique key made by the browser.
    pub idem_key: String,
    /// Task.
    pub task: i64,
    /// Fencing number of the lease; ignored for `reopen` and `drop`.
    #[serde(default)]
    pub lease_epoch: i64,
    /// Decision.
    pub decision: Decision,
    /// Author of the answer that is accepted or returned; all authors if missing.
    #[serde(default)]
    pub author: Option<i64>,
    /// The answer, for `merge`.
    #[serde(default)]
    pub answer: Option<Answer>,
    /// Required for `return`, `drop` and `reopen`.
    #[serde(default)]
    pub comment: String,
    /// Seconds of work on the review.
    #[serde(default, skip_serializing_if = "none")]
    pub secs: f64,
}

/// Answer to `POST reviews`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct ReviewDone {
    /// Its sequence number in the log.
    pub seq: i64,
    /// State of the task after it.
    pub state: TaskState,
}
