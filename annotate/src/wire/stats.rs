//! Figures of the dashboard.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::names::{EditType, TaskKind, TaskState};
use super::people::User;

/// A figure with its interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Lower end of the 95 % bootstrap interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Number of items.
    pub items: usize,
}

/// `GET stats/funnel`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Funnel {
    /// Tasks by kind and state.
    pub counts: BTreeMap<TaskKind, BTreeMap<TaskState, i64>>,
    /// Weeks, oldest first.
    pub weeks: Vec<Week>,
}

/// A week of work.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Week {
    /// Midnight of its Monday in the project's time zone.
    pub start: i64,
    /// Answers handed in.
    pub submitted: i64,
    /// Answers accepted.
    pub accepted: i64,
    /// Answers returned.
    pub returned: i64,
    /// Median seconds of an answer.
    pub median_secs: Option<f64>,
    /// Mean agreement on the tasks whose last answer came in this week: 1 for equal verdicts or joint sets.
    pub agreement: Option<f64>,
    /// Number of those tasks.
    pub shared_items: usize,
}

/// `GET stats/people`: one for each person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// Who.
    pub user: User,
    /// Answers handed in.
    pub done: i64,
    /// Median seconds of an answer.
    pub median_secs: Option<f64>,
    /// Answers accepted.
    pub accepted: i64,
    /// Answers sent back.
    pub returned: i64,
    /// Share of unchanged texts among those that started from a draft.
    pub draft_unchanged: Option<f64>,
    /// Mean edit distance from the draft, 0 to 1.
    pub draft_distance: Option<f64>,
    /// Gold tasks answered.
    pub gold_items: i64,
    /// Mean score on gold tasks, 0 to 1.
    pub gold_score: Option<f64>,
    /// Agreement with others (mean Jaccard index of the joints and frames of masks).
    pub agreement: Option<Estimate>,
    /// Time of the last log entry.
    pub last_seen: Option<i64>,
}

/// `GET stats/agreement`. Figures are `null` below 30 shared items.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Agreement {
    /// One for each of the release's parts, and `overall` of their decisions together.
    pub parts: Vec<PartAgreement>,
    /// Mean Jaccard index of the joints and frames of masks.
    pub jaccard: Option<Estimate>,
    /// Agreement on the verdicts about pairs.
    pub verdicts: Option<PartAgreement>,
    /// Tasks with two answers or more.
    pub shared_items: usize,
    /// Share of answers that reviewers accepted unchanged.
    pub accepted_share: Option<Estimate>,
    /// Edit distance from the draft, with drafts shown and with drafts withheld.
    pub draft_distance: Option<f64>,
    /// Seconds per answer with drafts and without.
    pub secs_with_and_without_draft: Option<[f64; 2]>,
}

/// Agreement on one decision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct PartAgreement {
    /// Name of the part.
    pub part: String,
    /// Items with two answers or more.
    pub items: usize,
    /// Gwet's AC1: the agreement beyond chance.
    pub gwet_ac1: Option<Estimate>,
}

/// `GET stats/quota`: one for each category and edit type.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct QuotaRow {
    /// Category; empty where the source gives none.
    pub category: String,
    /// Edit type.
    pub edit_type: EditType,
    /// Pairs kept: answered `keep` and not sent back.
    pub kept: i64,
    /// Pairs wanted; 0 for no bound.
    pub wanted: i64,
    /// Pairs of the category that are given out at most, of all edit types together; 0 for no bound.
    pub category_wanted: i64,
}

/// `GET stats/edit-types`: one for each edit type that the project has a quota of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct EditTypeCount {
    /// Edit type.
    pub edit_type: EditType,
    /// Pairs kept: answered `keep` and not sent back.
    pub kept: i64,
    /// Pairs wanted.
    pub wanted: i64,
}

/// `GET stats/days?from=&to=`: work of a person on a day, the last 28 days by default. The day
/// of `from` is counted whole.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct DayWork {
    /// First millisecond of the day in the project's time zone, in Unix time.
    pub start: i64,
    /// Id of the person.
    pub user: i64,
    /// Name of the person.
    pub name: String,
    /// Kind of task.
    pub kind: TaskKind,
    /// Seconds of work.
    pub secs: f64,
    /// Answers handed in.
    pub answers: i64,
    /// Tasks skipped or postponed.
    pub skips: i64,
    /// Decisions as a reviewer. Bulk actions are not counted.
    pub reviews: i64,
}

/// `GET stats/outlook`: what is left of a kind, at the pace of the last seven days.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Outlook {
    /// Kind.
    pub kind: TaskKind,
    /// Answers that tasks still want.
    pub answers_left: i64,
    /// Tasks that wait for a reviewer.
    pub reviews_left: i64,
    /// Answers in a day.
    pub answers_per_day: f64,
    /// Decisions of reviewers in a day.
    pub reviews_per_day: f64,
    /// Mean seconds of an answer.
    pub secs_per_answer: Option<f64>,
    /// Hours of work left: the median seconds of an answer for each.
    pub hours_left: Option<f64>,
    /// Days left.
    pub days_left: Option<f64>,
    /// When it ends.
    pub ends: Option<i64>,
}
