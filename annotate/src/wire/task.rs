//! Messages of annotators: tasks, answers, events, the home page, their own answers, and practice.

#![expect(
    missing_docs,
    reason = "a field whose name says what it is needs no words"
)]

use serde::{Deserialize, Serialize};

use super::{
    CountReason, EditType, Estimate, EventKind, Extent, JointWeight, Problem, RevisionState,
    SkipReason, Standing, SuggestionSource, SuggestionUse, TaskKind, TaskState, Verdict,
};

messages! {
    /// One mask of an answer.
    #[serde(deny_unknown_fields)]
    pub struct MaskAnswer {
        /// Names of the parts as entered: LEFT_ARM and RIGHT_ARM are not merged into BOTH_ARMS.
        pub parts: Vec<String>,
        /// Whether the soft ring is on: the joints around the parts are interpolated.
        #[serde(default = "yes")]
        pub soft: bool,
        /// Joints whose weight differs from the one that the parts and `soft` give them.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        pub joints: Vec<JointChoice>,
        /// First frame of the mask, and the frame after the last; the whole clip if missing.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub range: Option<[i32; 2]>,
        /// Description of what the parts do.
        pub text: String,
        /// The suggestion the text started from, if any.
        pub suggestion: Option<i64>,
    }

    /// The weight that a person chose for a joint of a mask.
    #[derive(Eq)]
    #[serde(deny_unknown_fields)]
    pub struct JointChoice {
        /// Name of one of the 22 body joints.
        pub joint: String,
        pub weight: JointWeight,
    }

    /// The current answer of a user to a task.
    pub struct Revision {
        pub task: i64,
        pub author: i64,
        /// Revision number: counts drafts and submissions from 1.
        pub rev: i64,
        pub state: RevisionState,
        pub answer: Answer,
        pub at: i64,
        pub secs: f64,
    }

    /// A proposal by a program or the source; never an answer.
    pub struct Suggestion {
        pub id: i64,
        pub source: SuggestionSource,
        pub parts: Vec<String>,
        /// Text; empty if only parts are suggested.
        pub text: String,
        /// Name of the model or program.
        pub model: String,
    }

    /// `GET skeleton`.
    pub struct SkeletonInfo {
        /// Names of the 28 keypoints, in the order of the binaries.
        pub joints: Vec<String>,
        /// Parent of each keypoint; -1 for the root.
        pub parents: Vec<i32>,
        /// `left`, `right` or `middle` of each keypoint.
        pub sides: Vec<String>,
        /// All parts; the five of the release come first, in the order of the rows of heat and diff.
        pub parts: Vec<PartInfo>,
    }

    /// A body part.
    pub struct PartInfo {
        /// Name in the release's spelling.
        pub name: String,
        /// Name in words: "left arm".
        pub phrase: String,
        /// Whether it is one of the five release parts.
        pub release: bool,
        /// Hard body joints.
        pub hard: Vec<usize>,
        /// Body joints of the soft ring.
        pub soft: Vec<usize>,
    }

    /// A motion, without its frames.
    pub struct MotionInfo {
        /// Content hash; identifies the motion in URLs.
        pub hash: String,
        /// Id in the dataset.
        pub id: String,
        pub frames: usize,
        pub fps: f64,
        /// train, val or test.
        pub split: String,
        pub captions: Vec<String>,
        /// Style label of the source.
        pub style: Option<String>,
    }

    /// A task.
    pub struct Task {
        pub id: i64,
        pub kind: TaskKind,
        pub state: TaskState,
        /// One motion; for a pair, the motions before and after the edit.
        pub motions: Vec<MotionInfo>,
        /// Action category, for the quota.
        pub category: Option<String>,
        /// Edit that the pair was made for, if the source states it.
        pub hint: Option<String>,
        /// Style label of the source.
        pub style: Option<String>,
        /// Answers wanted.
        pub wanted: u32,
        /// Submitted answers.
        pub submitted: u32,
        /// The bundle, for pairs.
        pub bundle: Option<Bundle>,
        /// Whether this is a practice task: after my answer, the known answer is shown.
        pub practice: bool,
    }

    /// Pairs that are leased together and submitted one by one.
    pub struct Bundle {
        pub id: i64,
        pub tasks: Vec<BundleItem>,
    }

    /// A task of a bundle.
    pub struct BundleItem {
        pub task: i64,
        /// My answer's state, if there is one.
        pub mine: Option<RevisionState>,
        /// My verdict, if it is submitted.
        pub verdict: Option<Verdict>,
        pub leased: bool,
    }

    /// A lease: the right to work on a task for a limited time.
    pub struct Lease {
        pub id: i64,
        pub task: i64,
        pub user: i64,
        /// Fencing number, sent with every event.
        pub epoch: i64,
        /// Time at which the lease ends unless it is renewed.
        pub expires: i64,
    }

    /// A held lease, as the dashboard lists it.
    pub struct HeldLease {
        pub lease: Lease,
        pub user_name: String,
        pub kind: TaskKind,
        /// `annotate`, `review`, `returned` (reserved for the author) or `assigned`.
        pub purpose: String,
    }

    /// `GET tasks/{id}`.
    pub struct TaskView {
        pub task: Task,
        pub lease: Option<Lease>,
        pub mine: Option<Revision>,
        /// The reviewer's comment, if the task was returned.
        pub comment: Option<String>,
        /// Suggestions; empty if the task is blind.
        pub suggestions: Vec<Suggestion>,
        /// Whether suggestions are withheld, to measure their effect.
        pub blind: bool,
        /// Whether the clip was ingested again, with other content, after I wrote my answer.
        pub clip_changed: bool,
    }

    /// `POST queue/next`.
    #[serde(deny_unknown_fields)]
    pub struct NextRequest {
        pub kind: TaskKind,
    }

    /// Answer to `POST queue/next`: a task, or why there is none.
    pub struct Next {
        pub task: Option<TaskView>,
        pub empty: Option<Empty>,
        /// Hashes of the motions of the following tasks, for prefetching.
        pub prefetch: Vec<String>,
    }

    /// Why a queue is empty, as numbers of tasks of its kind.
    #[derive(Default)]
    pub struct Empty {
        pub total: i64,
        /// Tasks with all wanted answers.
        pub done: i64,
        /// Tasks that I answered and that wait for others.
        pub waiting_for_others: i64,
        pub leased_by_others: i64,
        /// Time at which the first lease of another user expires.
        pub soonest_expiry: Option<i64>,
        pub skipped_by_me: i64,
        pub dropped: i64,
        /// Pairs that are not given out because their category has as many as the project wants.
        pub quota_full: i64,
        /// Tasks whose clip is no longer in the dataset.
        pub clip_gone: i64,
    }

    /// `POST tasks/{id}/events`.
    #[serde(deny_unknown_fields)]
    pub struct EventBatch {
        /// Events in the order in which they happened.
        pub events: Vec<NewEvent>,
    }

    /// An event of a task in the browser.
    #[serde(deny_unknown_fields)]
    pub struct NewEvent {
        /// Unique key made by the browser: 8 to 64 letters, digits and dashes.
        pub idem_key: String,
        pub kind: EventKind,
        /// Fencing number of the lease; ignored for `undo`.
        #[serde(default)]
        pub lease_epoch: i64,
        /// Revision on which this one is based; 0 for none.
        #[serde(default)]
        pub base_rev: i64,
        /// The answer, for `draft` and `submit`.
        pub answer: Option<Answer>,
        /// The reason, for `skip`.
        pub reason: Option<SkipReason>,
        /// Note on the reason.
        #[serde(default)]
        pub note: String,
        /// The suggestion, for `suggestion_used`.
        pub suggestion: Option<i64>,
        pub used: Option<SuggestionUse>,
        /// Seconds of work since the previous event.
        #[serde(default)]
        pub secs: f64,
    }

    /// Answer to `POST tasks/{id}/events`. The status is 200; each event has its own.
    pub struct EventResults {
        /// Results in the order of the events. Events after the first failed one are not processed and have no result:
        /// send them again.
        pub results: Vec<EventResult>,
    }

    /// Result of an event.
    pub struct EventResult {
        pub idem_key: String,
        /// 200 once it is durable, or the status of the problem.
        pub status: u16,
        /// Sequence number of the event in the log; `null` if nothing was logged.
        pub seq: Option<i64>,
        /// My revision after the event.
        pub rev: i64,
        /// State of the task after the event.
        pub state: Option<TaskState>,
        pub lease: Option<Lease>,
        pub problem: Option<Problem>,
        /// The known answer, after an answer to a practice task.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub feedback: Option<Feedback>,
    }

    /// Feedback on an answer to a practice task.
    pub struct Feedback {
        /// Score of the answer: 1 minus its distance from the known one.
        pub score: f64,
        pub known: Answer,
    }

    /// `GET practice`: my progress in the practice of a kind of task. Until it is passed, `POST queue/next` gives
    /// practice tasks instead of real ones.
    pub struct Practice {
        pub kind: TaskKind,
        /// Practice tasks to do; 0 if the kind needs no practice.
        pub needed: i64,
        /// Practice tasks done, up to `needed`.
        pub done: i64,
        /// Mean score of the last `needed` practice tasks, 0 to 1.
        pub score: Option<f64>,
        /// Score to reach, 0 to 1.
        pub threshold: f64,
        /// Whether real work is open. This is always true for reviewers and admins.
        pub passed: bool,
    }

    /// `POST blend`: a preview. `soft` and `joints` are as in `MaskAnswer`.
    #[serde(deny_unknown_fields)]
    pub struct BlendRequest {
        /// Hash of the edited motion.
        pub src: String,
        /// Hash of the motion the masked parts come from.
        pub tgt: String,
        pub parts: Vec<String>,
        #[serde(default = "yes")]
        pub soft: bool,
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        pub joints: Vec<JointChoice>,
        /// Weight of `tgt` on the soft ring, 0 to 1.
        pub alpha: f64,
    }

    /// `POST tasks/{id}/suggest`.
    #[serde(deny_unknown_fields)]
    pub struct SuggestRequest {
        /// Parts that the text must describe.
        pub parts: Vec<String>,
    }

    /// `GET home`.
    pub struct Home {
        pub queues: Vec<QueueInfo>,
        pub returned: Vec<ReturnedTask>,
        /// Tasks on which I hold leases, the one last renewed first.
        pub held: Vec<Lease>,
        /// Answers I submitted today, without practice. Days begin at midnight in the project's time zone.
        pub today: i64,
        /// Seconds I worked today: on answers, skips and reviews.
        pub today_secs: f64,
        /// Median seconds of my answers today.
        pub median_secs: Option<f64>,
        /// My agreement with others; `null` below 30 shared items.
        pub agreement: Option<Estimate>,
        /// Answers submitted by everybody today.
        pub today_all: i64,
    }

    /// The tasks of a kind, from my point of view.
    pub struct QueueInfo {
        pub kind: TaskKind,
        pub total: i64,
        /// Tasks with all wanted answers.
        pub done: i64,
        /// Tasks that I answered or hold, or that were returned to me, without practice.
        pub mine: i64,
        /// Tasks I hold now, without practice.
        pub held: i64,
        /// Time at which my first lease ends unless I continue.
        pub held_until: Option<i64>,
        /// Tasks that claims would give me now: new and postponed ones, those I hold, and those returned to me. Until
        /// practice is passed, the remaining practice tasks count instead of new ones.
        pub open: i64,
    }

    /// A returned task.
    pub struct ReturnedTask {
        pub task: i64,
        pub kind: TaskKind,
        pub comment: String,
        /// Time from which others can claim the task.
        pub until: i64,
    }

    /// `GET shelf`: accepted answers.
    pub struct Shelf {
        /// Newest first.
        pub items: Vec<ShelfItem>,
        /// Value of `before` for the next page.
        pub next: Option<i64>,
    }

    /// An accepted answer.
    pub struct ShelfItem {
        pub task: Task,
        pub answer: Answer,
        pub at: i64,
    }

    /// `GET answers?standing=&kind=&task=&before=&limit=`: my answers, newest first.
    pub struct MyAnswers {
        pub items: Vec<MyAnswer>,
        /// Value of `before` for the next page.
        pub next: Option<String>,
    }

    /// An answer of mine.
    pub struct MyAnswer {
        pub task: Task,
        /// The answer as I last wrote it.
        pub mine: Revision,
        pub standing: Standing,
        /// Answers that the task still waits for.
        pub missing: u32,
        /// Comment with which the answer was sent back, or the task was dropped.
        pub comment: Option<String>,
        /// The accepted answer, if it is not mine.
        pub accepted: Option<Answer>,
        /// How the answer was accepted: `review`, `own`, `rule:NAME` or `import`.
        pub accepted_by: Option<String>,
        /// Whether I can take the answer back now, with the event `undo` of `POST tasks/{id}/events`.
        pub can_take_back: bool,
        /// Time from which a returned task is offered to others.
        pub until: Option<i64>,
        /// The known answer and my score, if this is a practice task that I submitted.
        pub feedback: Option<Feedback>,
    }
}

fn yes() -> bool {
    true
}

/// An answer; its fields depend on the kind of the task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Answer {
    /// Answer to a task `mask_text`.
    MaskText {
        masks: Vec<MaskAnswer>,
        /// Reason for fewer or more masks than the project wants.
        count_reason: Option<CountReason>,
        #[serde(default)]
        note: String,
    },
    /// Answer to a task `pair`.
    Pair {
        verdict: Verdict,
        /// Parts the edit changes.
        #[serde(default)]
        parts: Vec<String>,
        /// Type of the edit.
        edit_type: Option<EditType>,
        /// The instruction.
        #[serde(default)]
        text: String,
        /// The suggestion the text started from, if any.
        suggestion: Option<i64>,
        #[serde(default)]
        note: String,
    },
    /// Answer to a task `style`.
    Style {
        verdict: Verdict,
        /// Parts the style shows in.
        #[serde(default)]
        parts: Vec<String>,
        style: Option<String>,
        /// How much of the body shows the style.
        extent: Option<Extent>,
        /// The instruction.
        #[serde(default)]
        text: String,
        /// The suggestion the text started from, if any.
        suggestion: Option<i64>,
        #[serde(default)]
        note: String,
    },
}
