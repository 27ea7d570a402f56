//! Figures of the dashboard, the log, jobs, and the capture plan.

#![expect(
    missing_docs,
    reason = "a field whose name says what it is needs no words"
)]

use std::collections::BTreeMap;

use super::{EditType, ExportFormat, TaskKind, TaskState, User};

messages! {
    /// A figure with its interval.
    #[derive(Copy)]
    pub struct Estimate {
        pub value: f64,
        /// Lower end of the 95 % bootstrap interval.
        pub low: f64,
        pub high: f64,
        pub items: usize,
    }

    /// `GET stats/funnel`.
    pub struct Funnel {
        /// Tasks by kind and state.
        pub counts: BTreeMap<TaskKind, BTreeMap<TaskState, i64>>,
        /// Weeks, oldest first.
        pub weeks: Vec<Week>,
    }

    /// A week of work.
    pub struct Week {
        /// Midnight of its Monday in the project's time zone.
        pub start: i64,
        pub submitted: i64,
        pub accepted: i64,
        pub returned: i64,
        pub median_secs: Option<f64>,
        /// Mean agreement on the tasks whose last answer was submitted in this week: 1 for equal verdicts or masks.
        pub agreement: Option<f64>,
        /// Number of tasks behind `agreement`.
        pub shared_items: usize,
    }

    /// `GET stats/people`: figures of a person.
    pub struct Person {
        pub user: User,
        /// Submitted answers.
        pub done: i64,
        pub median_secs: Option<f64>,
        pub accepted: i64,
        pub returned: i64,
        /// Share of unchanged texts among those that started from a draft.
        pub draft_unchanged: Option<f64>,
        /// Mean edit distance from the draft, 0 to 1.
        pub draft_distance: Option<f64>,
        pub gold_items: i64,
        pub gold_score: Option<f64>,
        /// Mean agreement with others on shared tasks: the Jaccard index of the joints and frames of masks, or 1 for
        /// equal verdicts and 0 for others.
        pub agreement: Option<Estimate>,
        /// Time of the last log entry.
        pub last_seen: Option<i64>,
    }

    /// `GET stats/agreement`. Figures are `null` below 30 shared items.
    pub struct Agreement {
        /// One entry for each part of the release, and `overall` for all their decisions together.
        pub parts: Vec<PartAgreement>,
        /// Mean Jaccard index of the joints and frames of masks.
        pub jaccard: Option<Estimate>,
        /// The same mean, between answers to different tasks as if their clips were equally long: the value that answers
        /// reach without looking at the clip.
        pub jaccard_chance: Option<f64>,
        pub verdicts: Option<PartAgreement>,
        /// Tasks with two answers or more, without gold tasks.
        pub shared_items: usize,
        /// Share of the decided answers that were accepted unchanged; the others were returned at some time, or superseded.
        pub accepted_share: Option<Estimate>,
        /// Mean edit distance of the texts from their drafts, 0 to 1; `null` only without such texts.
        pub draft_distance: Option<f64>,
        /// Median seconds per answer: of those that started from a draft, and of those to tasks shown without drafts.
        pub secs_with_and_without_draft: Option<[f64; 2]>,
    }

    /// Agreement on one decision.
    pub struct PartAgreement {
        pub part: String,
        /// Items with two answers or more.
        pub items: usize,
        /// Gwet's AC1: the agreement beyond chance.
        pub gwet_ac1: Option<Estimate>,
        /// AC1 of the same answers, each compared with answers to other tasks. It is above 0 if nearly all answers are equal.
        pub chance: Option<f64>,
    }

    /// `GET stats/quota`: a row for each category and edit type with kept pairs.
    pub struct QuotaRow {
        /// Category; empty for pairs without one.
        pub category: String,
        pub edit_type: EditType,
        /// Pairs kept: answered `keep` and not sent back.
        pub kept: i64,
        /// Pairs wanted; 0 for no bound.
        pub wanted: i64,
        /// Maximum number of pairs of the category that are given out, of all edit types together; 0 for no bound.
        pub category_wanted: i64,
    }

    /// `GET stats/edit-types`: the count of an edit type that has a quota.
    pub struct EditTypeCount {
        pub edit_type: EditType,
        pub kept: i64,
        pub wanted: i64,
    }

    /// `GET stats/days?from=&to=`: work of a person on a day, the last 28 days by default. The day of `from` is counted
    /// whole.
    pub struct DayWork {
        /// First millisecond of the day in the project's time zone, in Unix time.
        pub start: i64,
        pub user: i64,
        pub name: String,
        pub kind: TaskKind,
        pub secs: f64,
        pub answers: i64,
        /// Tasks skipped or postponed.
        pub skips: i64,
        /// Decisions as a reviewer. Bulk actions are not counted.
        pub reviews: i64,
    }

    /// `GET stats/outlook`: the remaining work on a kind of task, at the pace of the last seven days.
    pub struct Outlook {
        pub kind: TaskKind,
        /// Answers that tasks still want.
        pub answers_left: i64,
        /// Tasks that wait for a reviewer.
        pub reviews_left: i64,
        pub answers_per_day: f64,
        pub reviews_per_day: f64,
        /// Mean seconds of an answer, including all reported work on its kind.
        pub secs_per_answer: Option<f64>,
        /// Hours of work left, at the median seconds of an answer.
        pub hours_left: Option<f64>,
        pub days_left: Option<f64>,
        pub ends: Option<i64>,
    }

    /// An entry of the log, for `GET audit` and `GET tasks/{id}/history`.
    pub struct AuditEntry {
        /// Sequence number in the log.
        pub seq: i64,
        pub at: i64,
        /// User; `null` for the program itself.
        pub actor: Option<i64>,
        pub actor_name: Option<String>,
        pub kind: String,
        pub task: Option<i64>,
        #[ts(type = "unknown")]
        pub body: serde_json::Value,
    }

    /// `GET audit`: newest first.
    pub struct Audit {
        pub entries: Vec<AuditEntry>,
        /// Value of `before` for the next page.
        pub next: Option<i64>,
    }

    /// An entry of `GET stream` (event `change`).
    pub struct Change {
        /// Sequence number in the log.
        pub seq: i64,
        pub kind: String,
        pub task: Option<i64>,
    }

    /// `POST exports`.
    #[serde(deny_unknown_fields)]
    pub struct ExportRequest {
        pub format: ExportFormat,
        /// Splits to export; all if empty.
        #[serde(default)]
        pub splits: Vec<String>,
        /// Also write the log (format `parquet` only).
        #[serde(default)]
        pub events: bool,
    }

    /// `GET jobs/{id}`.
    #[derive(Default)]
    pub struct Job {
        pub id: i64,
        /// `import` or `export`.
        pub kind: String,
        pub format: String,
        /// `running`, `done` or `failed`.
        pub state: String,
        pub done: i64,
        /// Items in all, once known.
        pub total: Option<i64>,
        /// Counts of imported, written and omitted items.
        pub counts: BTreeMap<String, i64>,
        /// Messages about errors and omitted items.
        pub messages: Vec<String>,
        /// Files to download, at `jobs/{id}/files/{name}`.
        pub files: Vec<String>,
        pub started: i64,
        pub finished: Option<i64>,
        /// Time of the last report by the job's server.
        #[serde(default)]
        pub heartbeat: i64,
    }

    /// `PUT captures`: the whole plan, which replaces the previous one.
    #[serde(deny_unknown_fields)]
    pub struct CapturePlan {
        /// Cells of the plan, each motion with each style once.
        pub cells: Vec<PlannedCapture>,
    }

    /// A cell of the plan.
    #[serde(deny_unknown_fields)]
    pub struct PlannedCapture {
        /// Id of the source motion; the project does not have to know it yet.
        pub motion: String,
        pub style: String,
        /// Number of takes wanted, 1 to 1,000.
        pub takes: u32,
    }

    /// `GET captures`, and the answer to `PUT captures`: the plan, with the number of takes that have arrived. A take
    /// is a style pair of the motion in the style.
    #[derive(Default)]
    pub struct Captures {
        /// The cells in the order of the plan.
        pub cells: Vec<CaptureCell>,
        /// Number of style pairs that belong to no cell of the plan, without rejected ones.
        pub unplanned: u32,
    }

    /// A cell of the plan: a motion in a style, with its number of takes.
    pub struct CaptureCell {
        pub motion: String,
        pub style: String,
        pub takes: u32,
        /// Takes that arrived and are not rejected.
        pub arrived: u32,
        /// Takes that were judged unusable or dropped.
        pub rejected: u32,
        pub missing: u32,
        /// Whether the project has a motion of this id.
        pub known: bool,
    }
}
