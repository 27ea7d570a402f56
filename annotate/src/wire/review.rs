//! Messages of reviewers: reviews, the task browser, bulk actions, and rules of acceptance.

#![expect(
    missing_docs,
    reason = "a field whose name says what it is needs no words"
)]

use std::collections::BTreeMap;

use super::{
    Answer, BulkAction, Decision, EditType, Lease, ReviewQueue, Revision, RevisionState, RuleKind,
    SkipFilter, SkipReason, Suggestion, Task, TaskKind, TaskSort, TaskState, Verdict,
};

messages! {
    /// `POST review/next`.
    #[serde(deny_unknown_fields)]
    pub struct ReviewRequest {
        pub queue: ReviewQueue,
        /// Only tasks of this kind.
        pub kind: Option<TaskKind>,
        /// Only this task, regardless of its queue and kind.
        pub task: Option<i64>,
    }

    /// Answer to `POST review/next`.
    pub struct ReviewNext {
        pub review: Option<ReviewView>,
        pub empty: Option<ReviewEmpty>,
    }

    /// Why there is nothing to review.
    #[derive(Default)]
    pub struct ReviewEmpty {
        /// Tasks of the kind that wait for review, in any queue.
        pub waiting: i64,
        /// Waiting tasks that I answered.
        pub mine: i64,
        /// Tasks of the kind that other reviewers hold.
        pub in_review: i64,
    }

    /// A task to review.
    pub struct ReviewView {
        pub task: Task,
        pub lease: Lease,
        pub candidates: Vec<Candidate>,
        /// Largest distance of the answers, 0 to 1; `null` for a single answer.
        pub distance: Option<f64>,
        /// Comments of earlier rounds, oldest first.
        pub comments: Vec<String>,
        /// Suggestions that the annotators were offered. An annotator who got the task blind saw none.
        pub suggestions: Vec<Suggestion>,
        /// Whether the clip was ingested again, with other content, after the answers were written.
        pub clip_changed: bool,
        /// The imported or merged answer that was accepted before the task was reopened.
        pub former: Option<Answer>,
    }

    /// An answer to review.
    pub struct Candidate {
        pub revision: Revision,
        pub author_name: String,
        /// Hard body joints of the answer's parts and masks, for the viewer.
        pub joints: Vec<usize>,
        /// Edit distance of the answer's texts from their drafts, 0 to 1.
        pub draft_distance: Option<f64>,
    }

    /// `POST reviews`.
    #[serde(deny_unknown_fields)]
    pub struct NewReview {
        /// Unique key made by the browser.
        pub idem_key: String,
        pub task: i64,
        /// Fencing number of the lease; ignored for `reopen`. 0 is for a `drop` of a task that the reviewer does not hold.
        #[serde(default)]
        pub lease_epoch: i64,
        pub decision: Decision,
        /// Author of the answer that is accepted or returned; all authors if missing.
        pub author: Option<i64>,
        /// The answer, for `merge`.
        pub answer: Option<Answer>,
        /// Required for `return`, `drop` and `reopen`.
        #[serde(default)]
        pub comment: String,
        /// Seconds of work on the review.
        #[serde(default, skip_serializing_if = "none")]
        pub secs: f64,
    }

    /// Answer to `POST reviews`.
    pub struct ReviewDone {
        /// Sequence number of the decision in the log.
        pub seq: i64,
        /// State of the task after the decision.
        pub state: TaskState,
    }

    /// A filter of tasks: a task must match every given field. Gold and practice tasks are left out.
    #[derive(Default)]
    #[serde(deny_unknown_fields, default)]
    pub struct TaskFilter {
        pub kind: Option<TaskKind>,
        pub state: Option<TaskState>,
        /// Text to find in the answers, the captions, the ids of the motions, the category, the hint and the style.
        /// Case is ignored.
        pub q: Option<String>,
        /// A person who answered, skipped or holds the task.
        pub person: Option<i64>,
        /// A part that an answer names.
        pub part: Option<String>,
        pub edit_type: Option<EditType>,
        pub verdict: Option<Verdict>,
        pub category: Option<String>,
        /// train, val or test.
        pub split: Option<String>,
        /// Minimum distance of the answers, 0 to 1. Tasks with fewer than two answers do not match.
        pub min_distance: Option<f64>,
        /// Maximum distance of the answers, 0 to 1. Tasks with fewer than two answers do not match.
        pub max_distance: Option<f64>,
        pub skipped: Option<SkipFilter>,
        /// Only tasks accepted by the rule with this name.
        pub rule: Option<String>,
        pub task: Option<i64>,
    }

    /// `GET tasks`: a page of tasks. The query has the fields of [`TaskFilter`], `sort`, `reverse` (0 or 1), `after`
    /// and `limit` (up to 200).
    pub struct TaskPage {
        pub rows: Vec<TaskRow>,
        /// Value of `after` for the next page.
        pub next: Option<String>,
        /// Number of matching tasks; only on the first page.
        pub total: Option<i64>,
        pub sort: TaskSort,
    }

    /// A task in the browser.
    pub struct TaskRow {
        pub id: i64,
        /// Key of the task, the same in every store and export of the dataset.
        pub key: String,
        pub kind: TaskKind,
        pub state: TaskState,
        /// Id of the motion; for a pair, of the motion before the edit.
        pub source_id: String,
        /// Id of the motion after the edit.
        pub target_id: Option<String>,
        /// train, val or test.
        pub split: String,
        pub category: Option<String>,
        pub hint: Option<String>,
        pub style: Option<String>,
        pub wanted: u32,
        pub submitted: u32,
        /// Largest distance of its answers, 0 to 1; `null` below two answers.
        pub distance: Option<f64>,
        /// Time of the last answer, skip or decision; 0 without one.
        pub touched: i64,
        /// Answers in short, in the order they were handed in. Drafts are left out.
        pub answers: Vec<AnswerBrief>,
        /// Leases and reservations of the task.
        pub holders: Vec<Holder>,
        pub skips: Vec<SkipBrief>,
        /// How the task was accepted: `review`, `own` (by its author), `rule:NAME` or `import`.
        pub accepted_by: Option<String>,
    }

    /// An answer in short.
    pub struct AnswerBrief {
        pub author: i64,
        pub name: String,
        pub state: RevisionState,
        /// Texts of the answer, joined.
        pub text: String,
        pub parts: Vec<String>,
        pub verdict: Option<Verdict>,
        pub edit_type: Option<EditType>,
        pub at: i64,
    }

    /// Who holds a task.
    pub struct Holder {
        /// Id of the lease or the reservation.
        pub lease: i64,
        pub user: i64,
        pub name: String,
        /// `annotate`, `review`, `returned` (waits for the author it was sent back to) or `assigned`.
        pub purpose: String,
        pub until: i64,
    }

    /// A skip.
    pub struct SkipBrief {
        pub user: i64,
        pub name: String,
        /// Whether it was only postponed.
        pub postponed: bool,
        /// Why; `null` for a postponed task.
        pub reason: Option<SkipReason>,
        pub note: String,
        pub at: i64,
    }

    /// A decision on a task.
    pub struct DecisionRow {
        /// Sequence number of the decision in the log.
        pub seq: i64,
        pub task: i64,
        pub key: String,
        /// `accepted`, `merged`, `returned`, `dropped` or `reopened`.
        pub decision: String,
        /// Id of the reviewer; 0 for a rule.
        pub reviewer: i64,
        /// Name of the reviewer; empty for a rule.
        pub reviewer_name: String,
        /// Names of the authors whose answers the decision concerned.
        pub authors: Vec<String>,
        /// The rule that accepted the task, or whose acceptance was taken back.
        pub rule: Option<String>,
        pub comment: String,
        pub at: i64,
        /// State of the task now.
        pub state: TaskState,
    }

    /// `GET reviews`: decisions, newest first.
    pub struct Decisions {
        pub items: Vec<DecisionRow>,
        /// Value of `before` for the next page.
        pub next: Option<i64>,
    }

    /// `GET tasks/{id}/record`: everything about a task, for reviewers.
    pub struct TaskFile {
        pub task: Task,
        pub row: TaskRow,
        /// All submitted answers with their authors.
        pub answers: Vec<Candidate>,
        pub accepted: Option<Answer>,
        /// Decisions, oldest first.
        pub decisions: Vec<DecisionRow>,
        /// Suggestions that the annotators were offered.
        pub suggestions: Vec<Suggestion>,
    }

    /// `POST bulk` and `POST bulk/preview`: one action on all tasks of a filter.
    #[serde(deny_unknown_fields)]
    pub struct BulkRequest {
        pub filter: TaskFilter,
        pub action: BulkAction,
        /// Required for `return`, `drop` and `reopen`; a preview needs none.
        #[serde(default)]
        pub comment: String,
        /// The person, for `assign`.
        pub person: Option<i64>,
        /// Id of the last task that was checked; without it, begins with the first task.
        pub after: Option<i64>,
    }

    /// Answer to `POST bulk` and `POST bulk/preview`. A preview looks at all tasks and changes nothing; `POST bulk`
    /// looks at up to 2,000.
    #[derive(Default)]
    pub struct BulkDone {
        /// Tasks of the filter that were checked.
        pub looked_at: i64,
        /// Tasks changed, or that would be changed.
        pub done: i64,
        /// Unchanged tasks, by reason: `wrong_state`, `own_work`, `held` (by another person), `answers_differ`,
        /// `answered` (by the person), `task_full`, `new_style` (a reviewer has to see it), `clip_changed`
        /// (the clip was ingested anew after the answers, so a reviewer has to see them).
        pub left_alone: BTreeMap<String, i64>,
        /// Value of `after` for the next request; `null` once all are done.
        pub next: Option<i64>,
    }

    /// A rule of acceptance. It looks at tasks that have all their answers and wait for review; the first enabled rule
    /// that fits accepts the task at once. A rule never touches a task that a reviewer returned or reopened, nor a gold
    /// task.
    #[serde(deny_unknown_fields)]
    pub struct Rule {
        /// Name, unique in the project: 1 to 40 letters, digits and dashes. Every acceptance records it.
        pub name: String,
        pub enabled: bool,
        pub accepts: RuleKind,
        /// Kinds of task; all if empty.
        #[serde(default)]
        pub kinds: Vec<TaskKind>,
        /// Ids of the trusted people, for `trusted`: the answer of the first one in this list who answered is accepted.
        /// Other rules accept the answer that was submitted first.
        #[serde(default)]
        pub people: Vec<i64>,
        #[serde(default = "one")]
        pub min_answers: u32,
        /// Maximum distance between the answers to a task, 0 to 1: 0 asks for equal parts and labels, and of a rule
        /// that accepts any answer also for equal texts. Rejections with different verdicts have distance 1.
        #[serde(default)]
        pub max_distance: f64,
        /// Share of the matching tasks that is left to reviewers, 0 to 100. The choice depends only on the task and the
        /// project's seed.
        #[serde(default)]
        pub review_percent: u32,
    }

    /// `GET rules`: a rule, and what it does. The rules are edited as a part of the settings.
    pub struct RuleState {
        /// The rule. A removed rule stays listed while one of its acceptances is valid.
        pub rule: Rule,
        /// Whether the settings contain the rule.
        pub known: bool,
        pub accepted: i64,
        /// Waiting tasks that the rule would accept now, whether or not it is enabled.
        pub would_accept: i64,
        /// Waiting tasks that match the rule and are left to reviewers.
        pub left_to_review: i64,
    }

    /// `POST rules/apply`: applies the enabled rules to the tasks that wait for review.
    #[derive(Default)]
    #[serde(deny_unknown_fields, default)]
    pub struct ApplyRules {
        /// Id of the last task that was checked; without it, begins with the first task.
        pub after: Option<i64>,
    }

    /// Answer to `POST rules/apply`. One request looks at up to 2,000 tasks.
    #[derive(Default)]
    pub struct RulesApplied {
        pub looked_at: i64,
        /// Tasks accepted, by the name of the rule.
        pub accepted: BTreeMap<String, i64>,
        /// Value of `after` for the next request; `null` once all are done.
        pub next: Option<i64>,
    }

    /// Answer to `POST rules/{name}/undo`: the rule is disabled, and its acceptances are taken back, up to 2,000 in one
    /// request. The tasks wait for review again.
    #[derive(Default)]
    pub struct RuleUndone {
        /// Acceptances taken back by this request.
        pub reopened: i64,
        /// Acceptances still to be taken back: repeat the request until this is 0.
        pub left: i64,
    }
}

/// Leaves out zero seconds, so that such a request has the same hash as before the field existed.
#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn none(secs: &f64) -> bool {
    *secs == 0.0
}

fn one() -> u32 {
    1
}
