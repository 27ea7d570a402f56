//! What I handed in.

use serde::{Deserialize, Serialize};

use super::answer::{Answer, Revision};
use super::names::Standing;
use super::task::{Feedback, Task};

/// `GET answers?standing=&kind=&task=&before=&limit=`: my answers, newest first.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct MyAnswers {
    /// The answers.
    pub items: Vec<MyAnswer>,
    /// Value of `before` for the next page.
    pub next: Option<String>,
}

/// An answer of mine.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct MyAnswer {
    /// The task.
    pub task: Task,
    /// The answer as I last wrote it.
    pub mine: Revision,
    /// Where it stands.
    pub standing: Standing,
    /// Answers that the task still waits for.
    pub missing: u32,
    /// The comment it was sent back with, or the task was dropped with.
    pub comment: Option<String>,
    /// The answer that was accepted instead, if it is another one.
    pub accepted: Option<Answer>,
    /// How it was accepted: `review`, `own`, `rule:NAME` or `import`.
    pub accepted_by: Option<String>,
    /// Whether the event `undo` of `POST tasks/{id}/events` takes it back now.
    pub can_take_back: bool,
    /// When a returned task is offered to others.
    pub until: Option<i64>,
    /// The known answer and my score, if it is practice that I handed in.
    pub feedback: Option<Feedback>,
}
