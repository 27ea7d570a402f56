//! Figures of a plan: scores of a system for several values of its settings.

use std::path::PathBuf;

use datasets_spec::record::ScoreRow;
use eval::format::grid::Grid;
use eval::judge::Judges;
use eval::report::Chart;
use eval::table::Table;
use serde::Serialize;
use serde_json::Value;

use super::files::{Failed, chart_name};
use super::plan::{FigureSpecs, Plan, Trained};
use super::work::{Work, in_json};
use crate::global::Global;
use crate::report;
use crate::session::go_on;

/// A figure, as in the JSON document.
#[derive(Serialize)]
pub(super) struct FigureMade {
    pub(super) name: String,
    /// Files of the charts, once they are written.
    pub(super) drawings: Vec<PathBuf>,
    /// Number of items that are too short for at least one point; they are scored at no point.
    pub(super) left_out: usize,
    pub(super) points: Vec<PointMade>,
    /// What was measured, by which encoder, and what the figure lacks.
    pub(super) notes: Vec<String>,
    #[serde(skip)]
    pub(super) charts: Vec<(String, Chart)>,
    /// Names of the metrics and tasks that it shows.
    #[serde(skip)]
    pub(super) shows: [Vec<String>; 2],
    /// Values of the figure.
    #[serde(skip)]
    pub(super) grid: Grid,
}

#[derive(Serialize)]
pub(super) struct PointMade {
    pub(super) point: String,
    pub(super) values: Vec<Value>,
    /// Means over the trainings; none at a point that failed.
    pub(super) scores: Vec<Value>,
    /// Scores of each training, if there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) trainings: Vec<Vec<Value>>,
}

/// Trains, edits and scores at every point of a figure, and draws it.
pub(super) fn drawn(
    specs: &FigureSpecs<'_>,
    plan: &Plan,
    work: &Work<'_>,
    failed: &mut Failed,
    global: &Global,
) -> anyhow::Result<FigureMade> {
    let (figure, judges) = (specs.figure, work.judges());
    let protocol = plan.protocol(None, global);
    let at_point = |trained: &Trained| {
        let edits = work.edits_of(trained)?;
        work.scored(&[&edits], specs.min_frames, &protocol)
    };
    let (mut scores, mut points, mut left_out) = (Vec::new(), Vec::new(), 0);
    for (place, trained) in specs.trained.iter().enumerate() {
        go_on()?;
        let (count, name) = (specs.points.len(), &trained.name);
        report::note(&format!("point {} of {count}: {name}", place + 1));
        let (rows, trainings) = match at_point(trained) {
            Ok(scored) => {
                left_out = scored.left_out;
                (scored.scores.rows, scored.trainings)
            }
            Err(error) => {
                failed.add(name, error)?;
                (Vec::new(), Vec::new())
            }
        };
        let point = &specs.points[place];
        let values = point.changes.iter().map(|(_, value)| value.clone());
        let trainings = trainings.iter().map(|rows| in_json(rows, &judges));
        points.push(PointMade {
            point: point.name(),
            values: values.collect(),
            scores: in_json(&rows, &judges)?,
            trainings: trainings.collect::<anyhow::Result<_>>()?,
        });
        scores.push(rows);
    }
    if left_out > 0 {
        report::note(&format!(
            "{}: {left_out} items are shorter than the longest window and count at no point",
            figure.name
        ));
    }
    let of_metrics = specs.metrics.iter().map(|metric| metric.name.to_owned());
    let of_tasks = specs.tasks.iter().map(|&task| task.to_owned());
    Ok(FigureMade {
        name: figure.name.clone(),
        drawings: Vec::new(),
        left_out,
        points,
        notes: notes(specs, &scores, &judges, left_out),
        charts: charts(specs, &scores, left_out),
        shows: [of_metrics.collect(), of_tasks.collect()],
        grid: figure.grid(&specs.metrics, &specs.tasks, &specs.points, &scores),
    })
}

/// The conditions of the figure, points at which no system is ranked, and what it lacks.
fn notes(
    specs: &FigureSpecs<'_>,
    scores: &[Vec<ScoreRow>],
    judges: &Judges,
    left_out: usize,
) -> Vec<String> {
    let of_tasks = |rows: &[ScoreRow]| -> Vec<Table> {
        let mut tables = Table::from_scores(rows, judges, &specs.metrics);
        let is_shown = |table: &Table| specs.tasks.contains(&table.task.as_str());
        // With one kind of edit, no table covers all tasks.
        match tables.iter().any(is_shown) {
            true => tables.retain(is_shown),
            false => tables.truncate(1),
        }
        tables
    };
    let first = scores.iter().find(|rows| !rows.is_empty());
    let tables = first.map_or_else(Vec::new, |rows| of_tasks(rows));
    let mut notes: Vec<String> = tables.iter().map(Table::head).collect();
    for (point, rows) in specs.points.iter().zip(scores) {
        let name = point.name();
        if rows.is_empty() {
            notes.push(format!("{name} has no values."));
        }
        let unranked = of_tasks(rows)
            .into_iter()
            .filter_map(|table| table.unranked);
        notes.extend(unranked.map(|reason| format!("{name}: {reason}")));
    }
    if left_out > 0 {
        notes.push(format!(
            "{left_out} items are shorter than the longest window and count at no point."
        ));
    }
    notes
}

/// A chart for each task and metric, with the name of its file.
fn charts(
    specs: &FigureSpecs<'_>,
    scores: &[Vec<ScoreRow>],
    left_out: usize,
) -> Vec<(String, Chart)> {
    let figure = specs.figure;
    let mut charts = Vec::new();
    for &task in &specs.tasks {
        if left_out > 0 && !scores.iter().flatten().any(|row| row.task == task) {
            report::note(&format!(
                "{}: no {task} item is as long as the longest window, so that its drawing is empty; give this task a \
                 figure with shorter windows",
                figure.name
            ));
        }
        for &metric in &specs.metrics {
            let name = chart_name(figure, task, metric.name);
            charts.push((name, figure.chart(metric, task, &specs.points, scores)));
        }
    }
    charts
}
