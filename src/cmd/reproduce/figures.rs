//! Figures of a plan: scores of a system along the values of its settings.

use datasets_spec::record::ScoreRow;
use eval::format::grid::Grid;
use eval::names::ALL_TASKS;
use eval::protocol::Protocol;
use eval::report::Chart;
use serde::Serialize;
use serde_json::Value;

use super::failed::Failed;
use super::files::file_name;
use super::plan::{FigureSpecs, Plan, Trained};
use super::scores::{Scored, in_json, scored, several};
use super::work::Work;
use crate::global::Global;
use crate::report;
use crate::session::is_stopped;

/// A figure.
pub(super) struct FigureMade {
    pub(super) name: String,
    pub(super) charts: Vec<(String, Chart)>,
    /// Names of the metrics and tasks that it shows.
    pub(super) shows: [Vec<String>; 2],
    /// Values of the figure.
    pub(super) grid: Grid,
    pub(super) points: Vec<PointMade>,
    /// Number of items that are too short for some point of the figure.
    pub(super) left_out: usize,
}

#[derive(Serialize)]
pub(super) struct PointMade {
    pub(super) point: String,
    pub(super) values: Vec<Value>,
    pub(super) scores: Vec<Value>,
    /// Scores of each training, if there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) trainings: Vec<Vec<Value>>,
}

/// Makes the points of a figure, and draws it. None if an interrupt ended it.
pub(super) fn drawn(
    specs: &FigureSpecs<'_>,
    plan: &Plan,
    work: &Work<'_>,
    failed: &mut Failed,
    global: &Global,
) -> anyhow::Result<Option<FigureMade>> {
    let protocol = plan.protocol(None, global);
    let Some(at_points) = scores_at_points(specs, &protocol, work, failed)? else {
        return Ok(None);
    };
    let figure = specs.figure;
    if at_points.left_out > 0 {
        report::note(&format!(
            "{}: {} items are shorter than the longest window and count at no point",
            figure.name, at_points.left_out
        ));
    }
    let charts = charts(specs, &at_points);
    let grid = figure.grid(
        &specs.metrics,
        &specs.tasks,
        &specs.points,
        &at_points.scores,
    );
    let of_metrics = specs.metrics.iter().map(|metric| metric.name.to_owned());
    let of_tasks = specs.tasks.iter().map(|&task| task.to_owned());
    let shows = [of_metrics.collect(), of_tasks.collect()];
    Ok(Some(FigureMade {
        name: figure.name.clone(),
        shows,
        charts,
        grid,
        left_out: at_points.left_out,
        points: points(specs, at_points, work)?,
    }))
}

/// Scores at the points of a figure; none at a point that failed.
struct AtPoints {
    /// Means over the trainings.
    scores: Vec<Vec<ScoreRow>>,
    /// Scores of each training, if there are several.
    trainings: Vec<Vec<Vec<ScoreRow>>>,
    /// Number of items that are too short for some point of the figure.
    left_out: usize,
}

/// Trains, edits and scores at every point. None if an interrupt ended it.
fn scores_at_points(
    specs: &FigureSpecs<'_>,
    protocol: &Protocol,
    work: &Work<'_>,
    failed: &mut Failed,
) -> anyhow::Result<Option<AtPoints>> {
    let mut at_points = AtPoints {
        scores: Vec::with_capacity(specs.points.len()),
        trainings: Vec::with_capacity(specs.points.len()),
        left_out: 0,
    };
    let at_point = |trained: &Trained| -> anyhow::Result<Option<Scored>> {
        let Some(edits) = work.edits_of(trained)? else {
            return Ok(None);
        };
        scored(&[&edits], specs.min_frames, protocol, work).map(Some)
    };
    for (place, trained) in specs.trained.iter().enumerate() {
        if is_stopped() {
            return Ok(None);
        }
        let name = &trained.name;
        report::note(&format!(
            "point {} of {}: {name}",
            place + 1,
            specs.points.len()
        ));
        match at_point(trained) {
            Ok(Some(scored)) => {
                at_points.left_out = scored.left_out;
                at_points.scores.push(scored.scores.rows);
                at_points.trainings.push(several(scored.trainings));
            }
            Ok(None) => return Ok(None),
            Err(error) => {
                failed.add(name, error)?;
                at_points.scores.push(Vec::new());
                at_points.trainings.push(Vec::new());
            }
        }
    }
    Ok(Some(at_points))
}

/// A drawing of each metric and task, with the name of its file.
fn charts(specs: &FigureSpecs<'_>, at_points: &AtPoints) -> Vec<(String, Chart)> {
    let figure = specs.figure;
    let scores = &at_points.scores;
    let mut charts = Vec::new();
    for &task in &specs.tasks {
        if at_points.left_out > 0 && !scores.iter().flatten().any(|row| row.task == task) {
            report::note(&format!(
                "{}: no {task} item is as long as the longest window, so that its drawing is empty; give this task a \
                 figure with shorter windows",
                figure.name
            ));
        }
        for &metric in &specs.metrics {
            let of_task = match task {
                ALL_TASKS => String::new(),
                task => format!("-{task}"),
            };
            let name = file_name(&format!("{}{of_task}-{}", figure.name, metric.name));
            charts.push((name, figure.chart(metric, task, &specs.points, scores)));
        }
    }
    charts
}

/// The points with their scores, as in the JSON document.
fn points(
    specs: &FigureSpecs<'_>,
    at_points: AtPoints,
    work: &Work<'_>,
) -> anyhow::Result<Vec<PointMade>> {
    let scores = std::iter::zip(at_points.scores, at_points.trainings);
    std::iter::zip(&specs.points, scores)
        .map(|(point, (rows, trainings))| {
            let trainings = trainings.iter().map(|rows| in_json(rows, &work.judges()));
            Ok(PointMade {
                point: point.name(),
                values: point
                    .changes
                    .iter()
                    .map(|(_, value)| value.clone())
                    .collect(),
                scores: in_json(&rows, &work.judges())?,
                trainings: trainings.collect::<anyhow::Result<_>>()?,
            })
        })
        .collect()
}
