//! Figures of ablations: their points along a setting, and plots of the scores.

use std::collections::BTreeMap;

use datasets_spec::record::ScoreRow;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::Error;
use crate::draw::plot::{Curve, HeatMap, Plot, Scale};
use crate::format::ABSENT;
use crate::format::grid::Grid;
use crate::metric::Metric;
use crate::names::{ALL_TASKS, GIVEN, IDENTITY, REAL_DATA};
use crate::report::Chart;

/// Sections of the settings. The key of a setting begins with its section, as in `compose.mcm_ratio`.
pub const SECTIONS: [&str; 3] = ["train", "compose", "edit"];

/// Key for the epoch of a kept checkpoint, used in place of a setting.
pub const EPOCH: &str = "epoch";

/// Settings that replace those of a preset, by section.
pub type Sections = BTreeMap<&'static str, Value>;

/// A figure: how one or two settings of a system change its scores.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Figure {
    /// Name of the figure, and of its drawings' files.
    pub name: String,
    /// The system whose setting changes; by default the first of the plan.
    pub system: Option<String>,
    /// The setting, such as `compose.mcm_ratio`, or [`EPOCH`].
    pub key: String,
    /// Values of the setting.
    pub values: Vec<Value>,
    /// A second setting; every pair of values is a point.
    pub second_key: Option<String>,
    /// Values of the second setting.
    #[serde(default)]
    pub second_values: Vec<Value>,
    /// Names of the metrics that are drawn.
    #[serde(default = "average_rank")]
    pub metrics: Vec<String>,
    /// Tasks, each in a drawing of its own. If empty, the value over all tasks is drawn.
    #[serde(default)]
    pub tasks: Vec<String>,
}

fn average_rank() -> Vec<String> {
    vec![crate::metric::retrieval::E2T_AVERAGE_RANK.name.to_owned()]
}

/// A point of a figure.
#[derive(Clone, Debug)]
pub struct Point {
    /// Changed settings and their values.
    pub changes: Vec<(String, Value)>,
    /// Settings of the system with the changes applied.
    pub sections: Sections,
    /// Epoch of the checkpoint, if the figure is over checkpoints.
    pub epoch: Option<u64>,
}

impl Point {
    /// The changes in words.
    pub fn name(&self) -> String {
        let changes = self.changes.iter();
        let parts = changes.map(|(key, value)| format!("{key} = {value}"));
        parts.collect::<Vec<_>>().join(", ")
    }

    /// The value of a changed setting.
    pub fn value(&self, key: &str) -> Option<&Value> {
        let (_, value) = self.changes.iter().find(|(changed, _)| changed == key)?;
        Some(value)
    }
}

impl Figure {
    /// The points, in the order of the values.
    ///
    /// # Errors
    /// A second setting has no values, values have no second setting, or a key names no section.
    pub fn points(&self, own: &Sections) -> Result<Vec<Point>, Error> {
        let failed = |problem: String| Error::Invalid(format!("figure {:?}: {problem}", self.name));
        if self.second_key.is_some() == self.second_values.is_empty() {
            let problem = "it needs second_key and second_values together";
            return Err(failed(problem.to_owned()));
        }
        let mut points = Vec::new();
        for value in &self.values {
            let first = (self.key.clone(), value.clone());
            let changes: Vec<Vec<(String, Value)>> = match &self.second_key {
                None => vec![vec![first]],
                Some(key) => self
                    .second_values
                    .iter()
                    .map(|second| vec![first.clone(), (key.clone(), second.clone())])
                    .collect(),
            };
            for changes in changes {
                let mut point = Point {
                    changes: changes.clone(),
                    sections: own.clone(),
                    epoch: None,
                };
                for (key, value) in &changes {
                    match (key.as_str(), value.as_u64()) {
                        (EPOCH, Some(epoch)) => point.epoch = Some(epoch),
                        (EPOCH, None) => {
                            return Err(failed(format!("{value} is no number of epochs")));
                        }
                        _ => change(&mut point.sections, key, value).map_err(failed)?,
                    }
                }
                points.push(point);
            }
        }
        Ok(points)
    }

    /// The numbers of the drawings: one row per point, with each metric of each task. `scored` holds the score rows of
    /// each point; empty for a point that failed.
    pub fn grid(
        &self,
        metrics: &[&'static Metric],
        tasks: &[&str],
        points: &[Point],
        scored: &[Vec<ScoreRow>],
    ) -> Grid {
        let columns: Vec<(&Metric, &str)> = tasks
            .iter()
            .flat_map(|&task| metrics.iter().map(move |&metric| (metric, task)))
            .collect();
        let head = columns.iter().map(|(metric, task)| match *task {
            ALL_TASKS => metric.name.to_owned(),
            task => format!("{}, {task}", metric.name),
        });
        let cell = |rows: &[ScoreRow], metric: &Metric, task: &str| {
            let (mean, half) = value(rows, metric, task, &is_edited);
            let digits = metric.decimals;
            match (mean.is_nan(), half.is_nan()) {
                (true, _) => ABSENT.to_owned(),
                (false, true) => format!("{mean:.digits$}"),
                (false, false) => format!("{mean:.digits$} ±{half:.digits$}"),
            }
        };
        let keys = [Some(&self.key), self.second_key.as_ref()];
        let keys: Vec<&str> = keys.into_iter().flatten().map(String::as_str).collect();
        Grid {
            title: self.name.clone(),
            head: std::iter::once(keys.join(", ")).chain(head).collect(),
            rows: std::iter::zip(points, scored)
                .map(|(point, rows)| {
                    let changed = point.changes.iter().map(|(_, value)| label(value));
                    let name = changed.collect::<Vec<_>>().join(", ");
                    let cells = columns
                        .iter()
                        .map(|(metric, task)| cell(rows, metric, task));
                    [name].into_iter().chain(cells).collect()
                })
                .collect(),
        }
    }

    /// The curve of the setting, or the heat map of two settings, for one metric. `task` is a task of the figure or
    /// [`ALL_TASKS`]. `scored` holds the score rows of each point; empty for a point that failed.
    pub fn chart(
        &self,
        metric: &Metric,
        task: &str,
        points: &[Point],
        scored: &[Vec<ScoreRow>],
    ) -> Chart {
        let edited = |rows: &Vec<ScoreRow>| value(rows, metric, task, &is_edited);
        let values: Vec<(f64, f64)> = scored.iter().map(edited).collect();
        let of_task = match task {
            ALL_TASKS => String::new(),
            task => format!(", {task}"),
        };
        let title = format!(
            "{}{of_task}: {metric} {}",
            self.name,
            (metric.better)(task).arrow()
        );
        if let Some(second) = &self.second_key {
            return Chart::Heat(HeatMap {
                title,
                x: (
                    second.clone(),
                    self.second_values.iter().map(label).collect(),
                ),
                y: (self.key.clone(), self.values.iter().map(label).collect()),
                values: values.into_iter().map(|(mean, _)| mean).collect(),
            });
        }
        let at = |point: &Point| point.value(&self.key).cloned().unwrap_or_default();
        // Values that are not numbers are treated as categories.
        let numbers: Option<Vec<f64>> = points.iter().map(|point| at(point).as_f64()).collect();
        let x_names: Vec<String> = match numbers {
            Some(_) => Vec::new(),
            None => points.iter().map(|point| label(&at(point))).collect(),
        };
        let places = numbers.unwrap_or_else(|| (0..points.len()).map(|at| at as f64).collect());
        // Rows that do not depend on the system have the same value at every scored point.
        let given = |name: &str| {
            let rows = scored.iter().find(|rows| !rows.is_empty());
            let rows = rows.map_or(&[][..], Vec::as_slice);
            let (mean, _) = value(rows, metric, task, &|system| system == name);
            Curve {
                name: name.to_owned(),
                points: places.iter().map(|&place| (place, mean)).collect(),
                intervals: Vec::new(),
            }
        };
        let edited = Curve {
            name: "edited".to_owned(),
            points: std::iter::zip(&places, &values)
                .map(|(place, (mean, _))| (*place, *mean))
                .collect(),
            intervals: values.iter().map(|(_, half)| *half).collect(),
        };
        Chart::Lines(Plot {
            title,
            x_label: self.key.clone(),
            x_names,
            y_label: metric.name.to_owned(),
            y_scale: Scale::Linear,
            curves: vec![edited, given(REAL_DATA), given(IDENTITY)],
        })
    }
}

/// Whether a row belongs to the system whose setting changes, rather than being a reference row of every table.
fn is_edited(system: &str) -> bool {
    !GIVEN.contains(&system)
}

/// Mean and half width of the score of a wanted system; NaN for missing values.
fn value(
    rows: &[ScoreRow],
    metric: &Metric,
    task: &str,
    wanted: &dyn Fn(&str) -> bool,
) -> (f64, f64) {
    let of_metric = |row: &&ScoreRow| row.metric == metric.name && wanted(&row.system);
    let mut found = rows.iter().filter(of_metric);
    let of_task = found.clone().find(|row| row.task == task);
    // With one kind of edit, no row covers all tasks.
    let any = || (task == ALL_TASKS).then(|| found.next()).flatten();
    of_task.or_else(any).map_or((f64::NAN, f64::NAN), |row| {
        (row.mean, row.ci95.unwrap_or(f64::NAN))
    })
}

/// Sets the setting with a key such as `section.name.name` to a value.
fn change(sections: &mut Sections, key: &str, value: &Value) -> Result<(), String> {
    let mut names = key.split('.');
    let section = names.next().unwrap_or_default();
    let names: Vec<&str> = names.collect();
    let place = match sections.get_mut(section) {
        Some(place) if names.iter().any(|name| !name.is_empty()) => place,
        _ => {
            return Err(format!(
                "{key:?} is no setting: it must begin with one of {}, such as compose.mcm_ratio",
                SECTIONS.join(", ")
            ));
        }
    };
    let place = names.iter().fold(place, |place, name| {
        if !place.is_object() {
            *place = Value::Object(Map::new());
        }
        &mut place[*name]
    });
    *place = value.clone();
    Ok(())
}

/// A value as a label; strings are shown without quotes.
fn label(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn figure(key: &str, second: Option<&str>) -> Figure {
        Figure {
            name: "a".to_owned(),
            system: None,
            key: key.to_owned(),
            values: vec![json!(0.5), json!(1)],
            second_key: second.map(str::to_owned),
            second_values: second.map_or_else(Vec::new, |_| vec![json!("x"), json!("y")]),
            metrics: average_rank(),
            tasks: Vec::new(),
        }
    }

    fn own() -> Sections {
        SECTIONS.map(|name| (name, json!({ "kept": 1 }))).into()
    }

    #[test]
    fn points_are_every_value_or_every_pair_of_values() {
        let points = |figure: Figure| figure.points(&own()).expect("points");
        let ratios = points(figure("compose.mcm_ratio", None));
        assert_eq!(ratios.len(), 2);
        assert_eq!(ratios[0].name(), "compose.mcm_ratio = 0.5");
        let pairs = points(figure("train.length.steps", Some("edit.name")));
        assert_eq!(pairs.len(), 4);
        assert_eq!(pairs[3].name(), "train.length.steps = 1, edit.name = \"y\"");
        let last = &pairs[3].sections;
        let length = json!({ "steps": 1 });
        assert_eq!(last["train"], json!({ "kept": 1, "length": length }));
        assert_eq!(last["edit"], json!({ "kept": 1, "name": "y" }));
        assert_eq!(last["compose"], json!({ "kept": 1 }));
        let mut epochs = figure(EPOCH, None);
        epochs.values = vec![json!(5), json!(10)];
        let epochs = points(epochs);
        assert_eq!(epochs[1].epoch, Some(10));
        assert_eq!(epochs[1].sections, own());
    }

    #[test]
    fn settings_that_do_not_exist_are_refused() {
        for key in ["mcm_ratio", "train", "train.", "eval.repeats", EPOCH] {
            assert!(figure(key, None).points(&own()).is_err(), "{key}");
        }
        let mut half = figure("train.seed", None);
        half.second_key = Some("edit.name".to_owned());
        assert!(half.points(&own()).is_err());
    }

    #[test]
    fn a_curve_has_the_values_of_its_task_beside_real_data_and_identity() {
        use crate::metric::retrieval::E2T_AVERAGE_RANK;
        use crate::table::tests::score_row;

        let figure = figure("compose.mcm_ratio", None);
        let points = figure.points(&own()).expect("points");
        let scored: Vec<Vec<ScoreRow>> = [7.0, 5.0]
            .into_iter()
            .map(|mean| {
                let row = |task, system, mean| score_row(task, system, &E2T_AVERAGE_RANK, mean);
                vec![
                    row("style", REAL_DATA, 1.0),
                    row("style", IDENTITY, 9.0),
                    row("style", "ours", mean),
                    row("semantic", "ours", 2.0 * mean),
                ]
            })
            .collect();
        let drawn = |task: &str| match figure.chart(&E2T_AVERAGE_RANK, task, &points, &scored) {
            Chart::Lines(plot) => plot.curves,
            other => panic!("{other:?}"),
        };
        let [edited, real, identity] = &drawn("style")[..] else {
            panic!("three curves");
        };
        assert_eq!(edited.points, [(0.5, 7.0), (1.0, 5.0)]);
        assert_eq!(real.points, [(0.5, 1.0), (1.0, 1.0)]);
        assert_eq!(identity.points[0].1, 9.0);
        assert_eq!(drawn("semantic")[0].points[1], (1.0, 10.0));
        assert!(drawn("fine-grained")[0].points[0].1.is_nan());
    }
}
