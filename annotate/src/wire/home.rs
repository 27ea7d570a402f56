//! What somebody finds when they come in, and accepted answers to learn from.

use serde::{Deserialize, Serialize};

use super::answer::Answer;
use super::names::TaskKind;
use super::stats::Estimate;
use super::task::{Lease, Task};

/// `GET home`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Home {
    /// One for each kind.
    pub queues: Vec<QueueInfo>,
    /// Tasks that came back to me.
    pub returned: Vec<ReturnedTask>,
    /// Tasks I hold leases on, the one last renewed first.
    pub held: Vec<Lease>,
    /// Answers I handed in today, by the server's clock in UTC.
    pub today: i64,
    /// Median seconds of my answers today.
    pub median_secs: Option<f64>,
    /// My agreement with others; none below 30 shared items.
    pub agreement: Option<Estimate>,
    /// Answers handed in by everybody today.
    pub today_all: i64,
}

/// A queue as I see it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QueueInfo {
    /// Kind.
    pub kind: TaskKind,
    /// Tasks in all.
    pub total: i64,
    /// Tasks with all answers they want, whoever gave them.
    pub done: i64,
    /// Tasks I answered.
    pub mine: i64,
    /// Tasks I could be given now.
    pub open: i64,
}

/// A task that came back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReturnedTask {
    /// Task.
    pub task: i64,
    /// Kind.
    pub kind: TaskKind,
    /// Why it came back.
    pub comment: String,
    /// When it goes to others.
    pub until: i64,
}

/// `GET shelf`: accepted answers to learn from.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shelf {
    /// Newest first.
    pub items: Vec<ShelfItem>,
    /// To be passed as `before` for more.
    pub next: Option<i64>,
}

/// An accepted answer.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShelfItem {
    /// Its task.
    pub task: Task,
    /// The answer.
    pub answer: Answer,
    /// When it was accepted.
    pub at: i64,
}
