//! Ablation plans: the points of a sweep, their scores side by side, and the drawings of its axes.

use std::collections::BTreeMap;

use datasets_spec::record::ScoreRow;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::Error;
use crate::draw::plot::{Curve, HeatMap, Plot, Scale, heat_map, plot};
use crate::metric::Metric;
use crate::names::{ALL_TASKS, IDENTITY, NOISE_FLOOR, REAL_DATA};

/// Sections a setting can be in.
pub const SECTIONS: [&str; 3] = ["train", "compose", "edit"];

/// Settings in place of those of a preset, by section.
pub type Sections = BTreeMap<&'static str, Value>;

/// Settings that change together along one or two lists.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Names the drawing.
    pub name: String,
    /// The setting, such as `compose.mcm_ratio`.
    pub key: String,
    /// Its values.
    pub values: Vec<Value>,
    /// A second setting; every pair of values is a point.
    pub second_key: Option<String>,
    /// Its values.
    #[serde(default)]
    pub second_values: Vec<Value>,
}

/// A point of a sweep.
#[derive(Clone, Debug)]
pub struct Point {
    /// Index of its axis; `None` for the settings without any change.
    pub axis: Option<usize>,
    /// Changed settings and their values.
    pub changes: Vec<(String, Value)>,
    /// Settings of the plan with the changes applied.
    pub sections: Sections,
}

impl Point {
    /// The changes in words.
    pub fn name(&self) -> String {
        if self.changes.is_empty() {
            return "unchanged".to_owned();
        }
        let parts: Vec<String> = self
            .changes
            .iter()
            .map(|(key, value)| format!("{key} = {value}"))
            .collect();
        parts.join(", ")
    }
}

/// The points of a sweep: first the plan's own settings, then every value of every axis.
///
/// # Errors
/// An axis has a second setting without values or the reverse, or a key names no section.
pub fn points(axes: &[Axis], own: &Sections) -> Result<Vec<Point>, Error> {
    let mut points = vec![Point {
        axis: None,
        changes: Vec::new(),
        sections: own.clone(),
    }];
    for (index, axis) in axes.iter().enumerate() {
        if axis.second_key.is_some() == axis.second_values.is_empty() {
            return Err(Error::Axis {
                axis: axis.name.clone(),
                problem: "it needs second_key and second_values together".to_owned(),
            });
        }
        for value in &axis.values {
            let first = (axis.key.clone(), value.clone());
            let changes: Vec<Vec<(String, Value)>> = match &axis.second_key {
                None => vec![vec![first]],
                Some(key) => axis
                    .second_values
                    .iter()
                    .map(|second| vec![first.clone(), (key.clone(), second.clone())])
                    .collect(),
            };
            for changes in changes {
                let mut sections = own.clone();
                for (key, value) in &changes {
                    change(&mut sections, key, value).map_err(|problem| Error::Axis {
                        axis: axis.name.clone(),
                        problem,
                    })?;
                }
                points.push(Point {
                    axis: Some(index),
                    changes,
                    sections,
                });
            }
        }
    }
    Ok(points)
}

/// Sets `section.name.name` to a value.
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

/// A row of the scores of a sweep.
#[derive(Clone, Debug, Serialize)]
pub struct Collected<'a> {
    /// Name of the point.
    pub point: String,
    /// Name of its axis.
    pub axis: Option<&'a str>,
    /// Its values on the axis.
    pub values: Vec<&'a Value>,
    /// System.
    pub system: &'a str,
    /// Task.
    pub task: &'a str,
    /// Metric.
    pub metric: &'a str,
    /// Items behind the value.
    pub n: u32,
    /// Value.
    pub mean: f64,
    /// Half of its 95 % interval.
    pub ci95: Option<f64>,
}

/// The scores of all points in one list. `scored` holds the rows of each point, none for one that failed.
pub fn collected<'a>(
    axes: &'a [Axis],
    points: &'a [Point],
    scored: &'a [Vec<ScoreRow>],
) -> Vec<Collected<'a>> {
    points
        .iter()
        .zip(scored)
        .flat_map(|(point, rows)| {
            rows.iter().map(|row| Collected {
                point: point.name(),
                axis: point.axis.map(|axis| axes[axis].name.as_str()),
                values: point.changes.iter().map(|(_, value)| value).collect(),
                system: &row.system,
                task: &row.task,
                metric: &row.metric,
                n: row.n,
                mean: row.mean,
                ci95: row.ci95,
            })
        })
        .collect()
}

/// The curve of an axis, or the heat map of a pair of settings, as SVG. As in the paper's Figures 6 and
/// A1 a point is the value over all tasks.
pub fn drawing(
    axes: &[Axis],
    index: usize,
    metric: &Metric,
    points: &[Point],
    scored: &[Vec<ScoreRow>],
) -> String {
    let axis = &axes[index];
    let value = |rows: &[ScoreRow], wanted: &dyn Fn(&str) -> bool| -> (f64, f64) {
        let of_metric = |row: &&ScoreRow| row.metric == metric.name && wanted(&row.system);
        let mut found = rows.iter().filter(of_metric);
        // With one kind of edit there is no row over all tasks.
        let all = found.clone().find(|row| row.task == ALL_TASKS);
        all.or_else(|| found.next())
            .map_or((f64::NAN, f64::NAN), |row| {
                (row.mean, row.ci95.unwrap_or(f64::NAN))
            })
    };
    let is_edited = |system: &str| ![REAL_DATA, IDENTITY, NOISE_FLOOR].contains(&system);
    let on_axis: Vec<(&Point, (f64, f64))> = points
        .iter()
        .zip(scored)
        .filter(|(point, _)| point.axis == Some(index))
        .map(|(point, rows)| (point, value(rows, &is_edited)))
        .collect();
    let title = format!(
        "{}: {metric} {}",
        axis.name,
        (metric.better)(ALL_TASKS).arrow()
    );
    if let Some(second) = &axis.second_key {
        let label = |value: &Value| value.to_string();
        return heat_map(&HeatMap {
            title,
            x: (
                second.clone(),
                axis.second_values.iter().map(label).collect(),
            ),
            y: (axis.key.clone(), axis.values.iter().map(label).collect()),
            values: on_axis.into_iter().map(|(_, (mean, _))| mean).collect(),
        });
    }
    let at = |point: &Point| {
        point
            .changes
            .first()
            .map_or(Value::Null, |(_, value)| value.clone())
    };
    // Values that are not numbers are categories.
    let numbers: Option<Vec<f64>> = on_axis
        .iter()
        .map(|(point, _)| at(point).as_f64())
        .collect();
    let x_names: Vec<String> = match numbers {
        Some(_) => Vec::new(),
        None => on_axis.iter().map(|(point, _)| label(&at(point))).collect(),
    };
    let places = numbers.unwrap_or_else(|| (0..on_axis.len()).map(|at| at as f64).collect());
    // The identity editor has the same value at every point that was scored.
    let (identity, _) = scored
        .iter()
        .find(|rows| !rows.is_empty())
        .map_or((f64::NAN, f64::NAN), |rows| {
            value(rows, &|system| system == IDENTITY)
        });
    plot(&Plot {
        title,
        x_label: axis.key.clone(),
        x_names,
        y_label: metric.name.to_owned(),
        y_scale: Scale::Linear,
        curves: vec![
            Curve {
                name: "edited".to_owned(),
                points: places
                    .iter()
                    .copied()
                    .zip(on_axis.iter().map(|(_, (mean, _))| *mean))
                    .collect(),
                intervals: on_axis.iter().map(|(_, (_, half))| *half).collect(),
            },
            Curve {
                name: IDENTITY.to_owned(),
                points: places.iter().map(|&place| (place, identity)).collect(),
                intervals: Vec::new(),
            },
        ],
    })
}

/// A value of an axis as its label: texts without quotes.
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

    fn axis(key: &str, second: Option<&str>) -> Axis {
        Axis {
            name: "a".to_owned(),
            key: key.to_owned(),
            values: vec![json!(0.5), json!(1)],
            second_key: second.map(str::to_owned),
            second_values: second.map_or_else(Vec::new, |_| vec![json!("x"), json!("y")]),
        }
    }

    fn own() -> Sections {
        SECTIONS.map(|name| (name, json!({ "kept": 1 }))).into()
    }

    #[test]
    fn points_are_the_plan_and_every_value_of_every_axis() {
        let axes = [
            axis("compose.mcm_ratio", None),
            axis("train.length.steps", Some("edit.name")),
        ];
        let points = points(&axes, &own()).expect("usable axes");
        let names: Vec<String> = points.iter().map(Point::name).collect();
        assert_eq!(names.len(), 1 + 2 + 4);
        assert_eq!(names[0], "unchanged");
        assert_eq!(names[1], "compose.mcm_ratio = 0.5");
        assert_eq!(names[6], "train.length.steps = 1, edit.name = \"y\"");
        let last = &points[6].sections;
        assert_eq!(
            last["train"],
            json!({ "kept": 1, "length": { "steps": 1 } })
        );
        assert_eq!(last["edit"], json!({ "kept": 1, "name": "y" }));
        assert_eq!(last["compose"], json!({ "kept": 1 }));
    }

    #[test]
    fn axes_that_cannot_be_followed_are_refused() {
        for key in ["mcm_ratio", "train", "train.", "eval.repeats"] {
            assert!(points(&[axis(key, None)], &own()).is_err(), "{key}");
        }
        let mut half = axis("train.seed", None);
        half.second_key = Some("edit.name".to_owned());
        assert!(points(&[half], &own()).is_err());
    }
}
