//! Tasks: motions, answers, suggestions, queues and events.

use serde::{Deserialize, Serialize};

use super::answer::{Answer, Revision, Suggestion, yes};
use super::names::{
    EventKind, RevisionState, SkipReason, SuggestionUse, TaskKind, TaskState, Verdict,
};
use super::problem::Problem;

/// `GET skeleton`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkeletonInfo {
    /// Names of the 28 keypoints, in the order of the binaries.
    pub joints: Vec<String>,
    /// Parent of each; -1 for the root.
    pub parents: Vec<i32>,
    /// `left`, `right` or `middle` of each.
    pub sides: Vec<String>,
    /// The body joint (0 to 21) whose membership a keypoint shows: eyes go with the head, knuckles
    /// with the wrist.
    pub body_joint: Vec<usize>,
    /// All parts; the five of the release come first, in the order of the rows of heat and diff.
    pub parts: Vec<PartInfo>,
    /// Version of the membership.
    pub mask_def_version: u32,
}

/// A body part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartInfo {
    /// Name in the release's spelling.
    pub name: String,
    /// The same in words: "left arm".
    pub phrase: String,
    /// Whether it is one of the five of the release.
    pub release: bool,
    /// Body joints taken whole.
    pub hard: Vec<usize>,
    /// Body joints of the soft ring.
    pub soft: Vec<usize>,
}

/// A motion, without its frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionInfo {
    /// Content hash, the name in addresses.
    pub hash: String,
    /// Id in the dataset.
    pub id: String,
    /// Frames.
    pub frames: usize,
    /// Frames a second.
    pub fps: f64,
    /// train, val or test.
    pub split: String,
    /// Captions of the source.
    pub captions: Vec<String>,
    /// Style label of the source.
    pub style: Option<String>,
}

/// A task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Id.
    pub id: i64,
    /// What is asked.
    pub kind: TaskKind,
    /// Where it stands.
    pub state: TaskState,
    /// One motion, or the one before and the one after the edit.
    pub motions: Vec<MotionInfo>,
    /// Action category, for the quota.
    pub category: Option<String>,
    /// What a pair was generated or recorded for, if the source says.
    pub hint: Option<String>,
    /// Style the source gives.
    pub style: Option<String>,
    /// Answers wanted.
    pub wanted: u32,
    /// Answers handed in.
    pub submitted: u32,
    /// The bundle, for pairs.
    pub bundle: Option<Bundle>,
}

/// Pairs that are leased together and submitted one by one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bundle {
    /// Id.
    pub id: i64,
    /// Its tasks, in order.
    pub tasks: Vec<BundleItem>,
}

/// A task of a bundle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BundleItem {
    /// Task.
    pub task: i64,
    /// My answer's state, if there is one.
    pub mine: Option<RevisionState>,
    /// My verdict, if it is handed in.
    pub verdict: Option<Verdict>,
    /// Whether I hold a lease on it.
    pub leased: bool,
}

/// A right to work on a task for a while.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lease {
    /// Id.
    pub id: i64,
    /// Task.
    pub task: i64,
    /// Holder.
    pub user: i64,
    /// Fencing number, to be sent with every event.
    pub epoch: i64,
    /// When it ends unless renewed.
    pub expires: i64,
}

/// A held lease, as the dashboard lists it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldLease {
    /// The lease.
    pub lease: Lease,
    /// Name of its holder.
    pub user_name: String,
    /// Kind of its task.
    pub kind: TaskKind,
    /// `annotate`, `review`, or `returned` for one kept for its author.
    pub purpose: String,
}

/// `GET tasks/{id}`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskView {
    /// The task.
    pub task: Task,
    /// My lease, if I hold one.
    pub lease: Option<Lease>,
    /// My answer, if I began one.
    pub mine: Option<Revision>,
    /// The reviewer's comment, if the task came back.
    pub comment: Option<String>,
    /// Suggestions; none where the task is blind.
    pub suggestions: Vec<Suggestion>,
    /// Whether suggestions are withheld, to measure what they do.
    pub blind: bool,
}

/// `POST queue/next`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NextRequest {
    /// Kind of task.
    pub kind: TaskKind,
}

/// Answer to `POST queue/next`: a task, or why there is none.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Next {
    /// The task and the lease on it.
    pub task: Option<TaskView>,
    /// Why there is none.
    pub empty: Option<Empty>,
    /// Hashes of the motions of the tasks that follow, to be fetched ahead.
    pub prefetch: Vec<String>,
}

/// Why a queue is empty. Counts are tasks of the kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Empty {
    /// All tasks.
    pub total: i64,
    /// Have all answers they want.
    pub done: i64,
    /// I have answered; others have not yet.
    pub waiting_for_others: i64,
    /// Held by others.
    pub leased_by_others: i64,
    /// When the first of those leases ends.
    pub soonest_expiry: Option<i64>,
    /// I skipped them.
    pub skipped_by_me: i64,
    /// Dropped by reviewers.
    pub dropped: i64,
}

/// `POST tasks/{id}/events`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventBatch {
    /// In the order they happened.
    pub events: Vec<NewEvent>,
}

/// Something that happened to a task in the browser.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewEvent {
    /// Made by the browser, unique: 8 to 64 letters, digits and dashes.
    pub idem_key: String,
    /// What happened.
    pub kind: EventKind,
    /// Fencing number of the lease; not looked at for `undo`.
    #[serde(default)]
    pub lease_epoch: i64,
    /// Revision this one is made from; 0 for none.
    #[serde(default)]
    pub base_rev: i64,
    /// The answer, for `draft` and `submit`.
    #[serde(default)]
    pub answer: Option<Answer>,
    /// The reason, for `skip`.
    #[serde(default)]
    pub reason: Option<SkipReason>,
    /// More about the reason.
    #[serde(default)]
    pub note: String,
    /// The suggestion, for `suggestion_used`.
    #[serde(default)]
    pub suggestion: Option<i64>,
    /// What became of it.
    #[serde(default)]
    pub used: Option<SuggestionUse>,
    /// Seconds the author was at it since the event before.
    #[serde(default)]
    pub secs: f64,
}

/// Answer to `POST tasks/{id}/events`. The status is 200; each event has its own.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventResults {
    /// In the order of the events. After the first one that fails the others are not looked at and
    /// have no result: send them again.
    pub results: Vec<EventResult>,
}

/// What became of an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventResult {
    /// Key of the event.
    pub idem_key: String,
    /// 200 once it is durable, or the status of the problem.
    pub status: u16,
    /// Its place in the log; none if nothing was logged.
    pub seq: Option<i64>,
    /// My revision after it.
    pub rev: i64,
    /// State of the task after it.
    pub state: Option<TaskState>,
    /// My lease after it.
    pub lease: Option<Lease>,
    /// What went wrong.
    pub problem: Option<Problem>,
}

/// `POST blend`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlendRequest {
    /// Hash of the motion that is edited.
    pub src: String,
    /// Hash of the motion the masked parts come from.
    pub tgt: String,
    /// Names of the parts.
    pub parts: Vec<String>,
    /// Whether the soft ring is blended.
    #[serde(default = "yes")]
    pub soft: bool,
    /// Weight of `tgt` on the soft ring, 0 to 1.
    pub alpha: f64,
}

/// `POST tasks/{id}/suggest`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuggestRequest {
    /// Parts the text is to speak of.
    pub parts: Vec<String>,
}
