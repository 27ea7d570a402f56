//! The task browser: filters, rows, bulk actions, and everything about one task.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::answer::{Answer, Suggestion};
use super::names::{
    BulkAction, EditType, RevisionState, SkipFilter, SkipReason, TaskKind, TaskSort, TaskState,
    Verdict,
};
use super::review::Candidate;
use super::task::Task;

/// Which tasks: those that fit every given field. Gold and practice tasks are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields, default)]
pub struct TaskFilter {
    /// Kind.
    pub kind: Option<TaskKind>,
    /// State.
    pub state: Option<TaskState>,
    /// Words of an answer, a caption, the id of a motion, the category, the hint or the style. Case is ignored; names
    /// of fields and parts are not searched.
    pub q: Option<String>,
    /// A person who answered, skipped or holds it.
    pub person: Option<i64>,
    /// A part that an answer names.
    pub part: Option<String>,
    /// An edit type that an answer names.
    pub edit_type: Option<EditType>,
    /// A verdict that an answer gives.
    pub verdict: Option<Verdict>,
    /// Category.
    pub category: Option<String>,
    /// train, val or test.
    pub split: Option<String>,
    /// Least distance of its answers, 0 to 1: it has two or more.
    pub min_distance: Option<f64>,
    /// Largest distance of its answers, 0 to 1: it has two or more.
    pub max_distance: Option<f64>,
    /// Skipped tasks.
    pub skipped: Option<SkipFilter>,
    /// Accepted by the rule of this name.
    pub rule: Option<String>,
    /// The task with this id.
    pub task: Option<i64>,
}

/// `GET tasks`: a page of tasks. The query has the fields of [`TaskFilter`], `sort`, `reverse` (0 or 1), `after` and
/// `limit` (up to 200).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct TaskPage {
    /// The rows, in order.
    pub rows: Vec<TaskRow>,
    /// Value of `after` for the next page.
    pub next: Option<String>,
    /// Number of tasks that fit; given for the first page alone.
    pub total: Option<i64>,
    /// Order of the rows.
    pub sort: TaskSort,
}

/// A task in the browser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct TaskRow {
    /// Id.
    pub id: i64,
    /// Key: the same in every store and export of the dataset.
    pub key: String,
    /// Kind.
    pub kind: TaskKind,
    /// State.
    pub state: TaskState,
    /// Id of its motion, or of the one before the edit.
    pub source_id: String,
    /// Id of the motion after the edit.
    pub target_id: Option<String>,
    /// train, val or test.
    pub split: String,
    /// Category.
    pub category: Option<String>,
    /// Edit that the pair was made for.
    pub hint: Option<String>,
    /// Style label of the source.
    pub style: Option<String>,
    /// Answers wanted.
    pub wanted: u32,
    /// Answers handed in.
    pub submitted: u32,
    /// Largest distance of its answers, 0 to 1; `null` below two answers.
    pub distance: Option<f64>,
    /// When it last got an answer, a skip or a decision; 0 before.
    pub touched: i64,
    /// Answers in short, in the order they were handed in. Drafts are left out.
    pub answers: Vec<AnswerBrief>,
    /// Who holds it, and until when.
    pub holders: Vec<Holder>,
    /// Who skipped it, and why.
    pub skips: Vec<SkipBrief>,
    /// How it was accepted: `review`, `own` (by its author), `rule:NAME` or `import`.
    pub accepted_by: Option<String>,
}

/// An answer in short.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct AnswerBrief {
    /// Id of its author.
    pub author: i64,
    /// Name of its author.
    pub name: String,
    /// State.
    pub state: RevisionState,
    /// Its texts, joined.
    pub text: String,
    /// Parts that it names.
    pub parts: Vec<String>,
    /// Verdict.
    pub verdict: Option<Verdict>,
    /// Edit type.
    pub edit_type: Option<EditType>,
    /// When it was last written.
    pub at: i64,
}

/// Who holds a task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Holder {
    /// Id of the lease or the reservation.
    pub lease: i64,
    /// Id.
    pub user: i64,
    /// Name.
    pub name: String,
    /// `annotate`, `review`, `returned` (waits for the author it was sent back to) or `assigned`.
    pub purpose: String,
    /// When the lease or the reservation ends.
    pub until: i64,
}

/// A skip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct SkipBrief {
    /// Id.
    pub user: i64,
    /// Name.
    pub name: String,
    /// Whether it was only postponed.
    pub postponed: bool,
    /// Why; `null` for a postponed task.
    pub reason: Option<SkipReason>,
    /// More about it.
    pub note: String,
    /// When.
    pub at: i64,
}

/// A decision on a task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct DecisionRow {
    /// Its sequence number in the log.
    pub seq: i64,
    /// Task.
    pub task: i64,
    /// Key of the task.
    pub key: String,
    /// `accepted`, `merged`, `returned`, `dropped` or `reopened`.
    pub decision: String,
    /// Id of the reviewer; 0 for a rule.
    pub reviewer: i64,
    /// Name of the reviewer; empty for a rule.
    pub reviewer_name: String,
    /// The author whose answer was accepted or sent back; `null` if it concerns all authors.
    pub author: Option<i64>,
    /// Names of the authors it concerns.
    pub authors: Vec<String>,
    /// The rule that accepted the task, or whose acceptance was taken back.
    pub rule: Option<String>,
    /// Comment.
    pub comment: String,
    /// When.
    pub at: i64,
    /// State of the task now.
    pub state: TaskState,
}

/// `GET reviews`: decisions, newest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Decisions {
    /// The decisions.
    pub items: Vec<DecisionRow>,
    /// Value of `before` for the next page.
    pub next: Option<i64>,
}

/// `GET tasks/{id}/record`: everything about a task, for reviewers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct TaskFile {
    /// The task.
    pub task: Task,
    /// Its row in the browser.
    pub row: TaskRow,
    /// All answers that were handed in, with their authors.
    pub answers: Vec<Candidate>,
    /// The accepted answer.
    pub accepted: Option<Answer>,
    /// Decisions, oldest first.
    pub decisions: Vec<DecisionRow>,
    /// Suggestions the annotators were offered.
    pub suggestions: Vec<Suggestion>,
}

/// `POST bulk` and `POST bulk/preview`: one action on all tasks of a filter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct BulkRequest {
    /// Which tasks.
    pub filter: TaskFilter,
    /// What to do with each.
    pub action: BulkAction,
    /// Required for `return`, `drop` and `reopen`; a preview needs none.
    #[serde(default)]
    pub comment: String,
    /// The person, for `assign`.
    #[serde(default)]
    pub person: Option<i64>,
    /// Id of the last task that was looked at; without it, begins with the first task.
    #[serde(default)]
    pub after: Option<i64>,
}

/// Answer to `POST bulk` and `POST bulk/preview`. A preview looks at all tasks and changes nothing; `POST bulk`
/// looks at up to 2,000.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct BulkDone {
    /// Tasks of the filter that were looked at.
    pub looked_at: i64,
    /// Tasks changed, or that would be changed.
    pub done: i64,
    /// Tasks left alone, by reason: `wrong_state`, `own_work`, `held` (by another person), `answers_differ`,
    /// `answered` (by the person), `task_full`, `new_style` (a reviewer has to see it).
    pub left_alone: BTreeMap<String, i64>,
    /// Value of `after` for the next request; `null` once all are done.
    pub next: Option<i64>,
}
