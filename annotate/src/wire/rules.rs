//! Rules that accept answers without a reviewer.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::names::{RuleKind, TaskKind};

/// A rule of acceptance. It looks at tasks that have all their answers and wait for review; the first enabled rule
/// that fits accepts the task at once. A rule never touches a task that a reviewer returned or reopened, nor a gold
/// task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Rule {
    /// Name, unique in the project: 1 to 40 letters, digits and dashes. Every acceptance records it.
    pub name: String,
    /// Whether it is applied.
    pub enabled: bool,
    /// What it looks at.
    pub accepts: RuleKind,
    /// Kinds of task; all if empty.
    #[serde(default)]
    pub kinds: Vec<TaskKind>,
    /// Ids of the trusted people, for `trusted`. The answer of the first of them is accepted; for the other rules
    /// it is the answer handed in first.
    #[serde(default)]
    pub people: Vec<i64>,
    /// Fewest answers of a task.
    #[serde(default = "one")]
    pub min_answers: u32,
    /// Largest distance of the answers of a task, 0 to 1: 0 asks for equal parts and labels. Rejects of different
    /// verdicts have distance 1.
    #[serde(default)]
    pub max_distance: f64,
    /// Share of the fitting tasks that is left to reviewers, 0 to 100. The draw depends on the task and the
    /// project's seed alone.
    #[serde(default)]
    pub review_percent: u32,
}

fn one() -> u32 {
    1
}

/// `GET rules`: a rule, and what it does. The rules are edited as a part of the settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct RuleState {
    /// The rule. A rule that was removed is listed while acceptances of it stand.
    pub rule: Rule,
    /// Whether the settings have it.
    pub known: bool,
    /// Tasks that are accepted by it.
    pub accepted: i64,
    /// Waiting tasks that it would accept now, whether or not it is enabled.
    pub would_accept: i64,
    /// Waiting tasks that fit it and are left to reviewers.
    pub left_to_review: i64,
}

/// `POST rules/apply`: applies the enabled rules to the tasks that wait for review.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields, default)]
pub struct ApplyRules {
    /// Id of the last task that was looked at; without it, begins with the first task.
    pub after: Option<i64>,
}

/// Answer to `POST rules/apply`. One request looks at up to 2,000 tasks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct RulesApplied {
    /// Waiting tasks looked at.
    pub looked_at: i64,
    /// Tasks accepted, by the name of the rule.
    pub accepted: BTreeMap<String, i64>,
    /// Value of `after` for the next request; `null` once all are done.
    pub next: Option<i64>,
}

/// Answer to `POST rules/{name}/undo`: the rule is disabled, and its acceptances are taken back, up to 2,000 in
/// one request. The tasks wait for review again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct RuleUndone {
    /// Acceptances taken back by this request.
    pub reopened: i64,
    /// Acceptances that still stand: repeat the request until it is 0.
    pub left: i64,
}
