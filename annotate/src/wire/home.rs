//! The home page, and the shelf of accepted answers.

use serde::{Deserialize, Serialize};

use super::answer::Answer;
use super::names::TaskKind;
use super::stats::Estimate;
use super::task::{Lease, Task};

/// `GET home`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Home {
    /// One queue for each kind.
    pub queues: Vec<QueueInfo>,
    /// Tasks returned to me.
    pub returned: Vec<ReturnedTask>,
    /// Tasks I hold leases on, the one last renewed first.
    pub held: Vec<Lease>,
    /// Answers I submitted today, which begins at midnight in the project's time zone. Practice is left out.
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

/// A queue as I see it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct QueueInfo {
    /// Kind.
    pub kind: TaskKind,
    /// Tasks in all.
    pub total: i64,
    /// Tasks with all wanted answers.
    pub done: i64,
    /// Tasks I answered, hold, or was sent back. Practice is left out.
    pub mine: i64,
    /// Tasks I hold now. Practice is left out.
    pub held: i64,
    /// When the first of them goes to others unless I go on.
    pub held_until: Option<i64>,
    /// Tasks that claims would give me now: new and postponed ones, those I hold, and those returned to me. Before
    /// practice is passed, the practice tasks that are left stand for the new ones.
    pub open: i64,
}

/// A returned task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct ReturnedTask {
    /// Task.
    pub task: i64,
    /// Kind.
    pub kind: TaskKind,
    /// The reviewer's comment.
    pub comment: String,
    /// When others can claim it.
    pub until: i64,
}

/// `GET shelf`: accepted answers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Shelf {
    /// Newest first.
    pub items: Vec<ShelfItem>,
    /// Value of `before` for the next page.
    pub next: Option<i64>,
}

/// An accepted answer.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct ShelfItem {
    /// Its task.
    pub task: Task,
    /// The answer.
    pub answer: Answer,
    /// When it was accepted.
    pub at: i64,
}
