//! `record.jsonl`: the scores that tables and figures show, one per line. It is small enough to be stored beside a
//! document that quotes them, so that a test can compare the two (`eval/RESULTS.md`, `tests/it/evidence.rs`).

use serde::Serialize;
use serde_json::Value;

/// A score.
#[derive(Serialize)]
struct Line<'a> {
    /// The table or figure that shows the value.
    shown_in: &'a str,
    /// Values of the settings at the point of a figure.
    #[serde(skip_serializing_if = "<[Value]>::is_empty")]
    at: &'a [Value],
    task: &'a Value,
    system: &'a Value,
    metric: &'a Value,
    mean: &'a Value,
    #[serde(skip_serializing_if = "Value::is_null")]
    ci95: &'a Value,
    /// Scores of each training, if there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    trainings: Vec<&'a Value>,
}

/// The lines so far.
#[derive(Default)]
pub(super) struct Record(Vec<u8>);

impl Record {
    /// Adds the scores in a table, or in a figure at a point, with those of its trainings.
    pub(super) fn add(
        &mut self,
        (shown_in, at): (&str, &[Value]),
        scores: &[Value],
        trainings: &[Vec<Value>],
        is_shown: impl Fn(&Value) -> bool,
    ) -> serde_json::Result<()> {
        for score in scores.iter().filter(|score| is_shown(score)) {
            let [task, system, metric] = ["task", "system", "metric"].map(|key| &score[key]);
            let is_same = |row: &&Value| {
                (&row["task"], &row["system"], &row["metric"]) == (task, system, metric)
            };
            let line = Line {
                shown_in,
                at,
                task,
                system,
                metric,
                mean: &score["mean"],
                ci95: &score["ci95"],
                trainings: trainings
                    .iter()
                    .filter_map(|rows| rows.iter().find(is_same))
                    .map(|row| &row["mean"])
                    .collect(),
            };
            serde_json::to_writer(&mut self.0, &line)?;
            self.0.push(b'\n');
        }
        Ok(())
    }

    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.0
    }
}
