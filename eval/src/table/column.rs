//! Columns of result tables.

use crate::metric::{Better, Metric};

/// A column of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    /// The metric.
    pub metric: &'static Metric,
    /// Good values of the metric for this task.
    pub better: Better,
}

impl Column {
    /// The metric with its arrow, such as `FID ↓`.
    pub fn label(&self) -> String {
        format!("{} {}", self.metric, self.better.arrow())
    }
}
