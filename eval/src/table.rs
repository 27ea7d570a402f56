//! Result tables in the shape of the paper's Table 1.

use std::collections::BTreeMap;

use datasets_spec::record::ScoreRow;

use crate::metric::interval::Interval;
use crate::metric::{Better, Metric};
use crate::score::{ALL_TASKS, IDENTITY, NOISE_FLOOR, REAL_DATA, RECAPTURED};

/// The rows that no system made, in their order.
const GIVEN: [&str; 3] = [REAL_DATA, IDENTITY, NOISE_FLOOR];

/// The scores of one task under one protocol and one encoder.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// The task, such as `semantic`.
    pub task: String,
    /// The protocol in words.
    pub protocol: String,
    /// Hash of the encoder in hexadecimal.
    pub encoder_hash: String,
    /// How the encoder came about.
    pub encoder_recipe: String,
    /// Items measured.
    pub num_items: u32,
    /// Evaluations.
    pub repeats: u32,
    /// The columns.
    pub columns: Vec<Column>,
    /// The rows: real data, identity, noise floor where there is one, then the systems.
    pub rows: Vec<Row>,
}

/// A column of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    /// The metric.
    pub metric: Metric,
    /// Which values are good in this task.
    pub better: Better,
}

impl Column {
    /// The metric with its arrow, such as `FID ↓`.
    pub fn label(&self) -> String {
        format!("{} {}", self.metric, self.better.arrow())
    }
}

/// A row of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the system.
    pub system: String,
    /// Whether the row is no competitor: real data, identity, noise floor.
    pub baseline: bool,
    /// Whether the values are taken from a publication and were not measured.
    pub published: bool,
    /// One cell for each column; none where the metric was not measured.
    pub cells: Vec<Option<Cell>>,
}

/// A cell of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Mean over the repeats.
    pub mean: f64,
    /// Half width of the 95 % interval; none where a publication prints none.
    pub ci95: Option<f64>,
    /// Whether no measured system is better.
    pub best: bool,
}

impl Cell {
    /// The mean as printed.
    pub fn mean_text(&self, metric: Metric) -> String {
        format!("{:.*}", metric.decimals(), self.mean)
    }

    /// The half width as printed, with its sign; empty where there is none.
    pub fn ci_text(&self, metric: Metric) -> String {
        self.ci95
            .map_or_else(String::new, |ci95| format!("±{ci95:.*}", metric.decimals()))
    }
}

impl Table {
    /// Lays out scores: one table for each task, protocol and encoder found, in the order of
    /// [`crate::score::score`].
    ///
    /// `recipes` says how the encoder of each hash came about. `metrics` are the columns; those
    /// no system has a value of are left out, and so are scores of other metrics.
    pub fn from_scores(
        scores: &[ScoreRow],
        recipes: &BTreeMap<String, String>,
        metrics: &[Metric],
    ) -> Vec<Self> {
        let mut keys: Vec<(&str, &str, &str)> = Vec::new();
        for row in scores {
            let key = key(row);
            if !keys.contains(&key) {
                keys.push(key);
            }
        }
        // A stable sort: tasks keep together even when two runs were joined.
        keys.sort_by_key(|(task, ..)| (*task != ALL_TASKS, *task == RECAPTURED, *task));
        keys.into_iter()
            .filter_map(|wanted| {
                let rows: Vec<&ScoreRow> = scores.iter().filter(|row| key(row) == wanted).collect();
                Self::of_group(&rows, recipes, metrics)
            })
            .collect()
    }

    fn of_group(
        scores: &[&ScoreRow],
        recipes: &BTreeMap<String, String>,
        metrics: &[Metric],
    ) -> Option<Self> {
        let first = scores.first()?;
        let mut names: Vec<&str> = Vec::new();
        let mut values: BTreeMap<(&str, Metric), Interval> = BTreeMap::new();
        for row in scores {
            let Some(metric) = Metric::from_name(&row.metric) else {
                continue;
            };
            if !names.contains(&row.system.as_str()) {
                names.push(&row.system);
            }
            let interval = Interval {
                mean: row.mean,
                ci95: row.ci95,
            };
            values.insert((&row.system, metric), interval);
        }
        names.sort_by_key(|name| {
            GIVEN
                .iter()
                .position(|given| given == name)
                .unwrap_or(GIVEN.len())
        });
        let columns: Vec<Column> = metrics
            .iter()
            .filter(|metric| values.keys().any(|(_, known)| known == *metric))
            .map(|&metric| Column {
                metric,
                better: metric.better(&first.task),
            })
            .collect();
        if columns.is_empty() {
            return None;
        }
        let rows = names
            .into_iter()
            .map(|name| Row {
                system: name.to_owned(),
                baseline: GIVEN.contains(&name),
                published: false,
                cells: columns
                    .iter()
                    .map(|column| {
                        values.get(&(name, column.metric)).map(|interval| Cell {
                            mean: interval.mean,
                            ci95: Some(interval.ci95),
                            best: false,
                        })
                    })
                    .collect(),
            })
            .collect();
        let mut table = Self {
            task: first.task.clone(),
            protocol: first.protocol.clone(),
            encoder_hash: first.encoder_hash.clone(),
            encoder_recipe: recipes
                .get(&first.encoder_hash)
                .cloned()
                .unwrap_or_default(),
            num_items: first.n,
            repeats: first.repeats,
            columns,
            rows,
        };
        table.mark_best();
        Some(table)
    }

    /// The head of the table in one line: the task, and what the numbers depend on.
    pub fn head(&self) -> String {
        format!("{}: {}", self.task, self.conditions())
    }

    /// What the numbers depend on, in one line.
    pub fn conditions(&self) -> String {
        let mut text = format!(
            "{} items, {} repeats, 95 % intervals; {}",
            self.num_items, self.repeats, self.protocol
        );
        if !self.encoder_hash.is_empty() {
            text.push_str(&format!("; encoder {}", short_hash(&self.encoder_hash)));
        }
        if !self.encoder_recipe.is_empty() {
            text.push_str(&format!(" ({})", self.encoder_recipe));
        }
        text
    }

    /// Marks the best measured systems of each column. Values that print alike are equally good.
    fn mark_best(&mut self) {
        for (index, column) in self.columns.iter().enumerate() {
            let real = self
                .rows
                .iter()
                .find(|row| row.system == REAL_DATA)
                .and_then(|row| row.cells[index])
                .map(|cell| cell.mean);
            let unit = 10f64.powi(column.metric.decimals() as i32);
            let printed = |mean: f64| (mean * unit).round();
            let badness = |mean: f64| match column.better {
                Better::Lower => Some(printed(mean)),
                Better::Higher => Some(-printed(mean)),
                Better::NearReal => real.map(|real| (printed(mean) - printed(real)).abs()),
            };
            let best = self
                .rows
                .iter()
                .filter(|row| !row.baseline && !row.published)
                .filter_map(|row| badness(row.cells[index]?.mean))
                .min_by(f64::total_cmp);
            for row in &mut self.rows {
                let competes = !row.baseline && !row.published;
                if let Some(cell) = &mut row.cells[index] {
                    cell.best = competes && best.is_some() && badness(cell.mean) == best;
                }
            }
        }
    }
}

fn key(row: &ScoreRow) -> (&str, &str, &str) {
    (&row.task, &row.protocol, &row.encoder_hash)
}

/// Digits of a hash that tables print: enough to tell the encoders of a project apart.
const SHORT_HASH: usize = 12;

/// The first digits of a hash.
pub(crate) fn short_hash(hash: &str) -> &str {
    hash.char_indices()
        .nth(SHORT_HASH)
        .map_or(hash, |(end, _)| &hash[..end])
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A score row of the sample table.
    pub(crate) fn score_row(task: &str, system: &str, metric: Metric, mean: f64) -> ScoreRow {
        ScoreRow {
            system: system.to_owned(),
            task: task.to_owned(),
            metric: metric.name().to_owned(),
            protocol: "galleries of 32, seed 0".to_owned(),
            encoder_hash: "0123456789abcdef".to_owned(),
            n: 512,
            repeats: 10,
            mean,
            ci95: mean / 100.0,
        }
    }

    /// Scores of four systems whose names need escaping somewhere.
    pub(crate) fn sample_scores(task: &str) -> Vec<ScoreRow> {
        let systems = [
            (REAL_DATA, 1.0),
            (IDENTITY, 0.8),
            ("MotionReFit tiny", 0.7),
            ("ours_100%|<b>", 0.9),
        ];
        let mut scores = Vec::new();
        for (system, factor) in systems {
            for metric in Metric::ALL {
                let mean = match metric {
                    Metric::SourceRecall(_) | Metric::TargetRecall(_) => 100.0 * factor,
                    Metric::Diversity => 36.06 * factor,
                    Metric::FootScore => factor,
                    _ => 2.0 / factor,
                };
                scores.push(score_row(task, system, metric, mean));
            }
        }
        scores
    }

    /// The sample scores as a table of the paper's columns.
    pub(crate) fn sample_table() -> Table {
        let recipes = BTreeMap::from([("0123456789abcdef".to_owned(), "TMR tiny".to_owned())]);
        Table::from_scores(&sample_scores("semantic"), &recipes, Metric::PAPER).remove(0)
    }

    #[test]
    fn the_table_has_the_shape_of_the_papers() {
        let table = sample_table();
        let labels: Vec<String> = table.columns.iter().map(Column::label).collect();
        assert_eq!(
            labels.join(" | "),
            "FID ↓ | Diversity → | FS ↑ | E2S R@1 → | E2S R@2 → | E2S R@3 → | E2S AvgR → | \
             E2T R@1 ↑ | E2T R@2 ↑ | E2T R@3 ↑ | E2T AvgR ↓"
        );
        let names: Vec<&str> = table.rows.iter().map(|row| row.system.as_str()).collect();
        assert_eq!(
            names,
            [REAL_DATA, IDENTITY, "MotionReFit tiny", "ours_100%|<b>"]
        );
        assert_eq!(
            table.head(),
            "semantic: 512 items, 10 repeats, 95 % intervals; galleries of 32, seed 0; \
             encoder 0123456789ab (TMR tiny)"
        );
    }

    fn best(table: &Table, metric: Metric) -> Vec<&str> {
        let index = table
            .columns
            .iter()
            .position(|column| column.metric == metric)
            .expect("a column");
        table
            .rows
            .iter()
            .filter(|row| row.cells[index].is_some_and(|cell| cell.best))
            .map(|row| row.system.as_str())
            .collect()
    }

    #[test]
    fn the_best_system_is_marked_and_baselines_never_are() {
        let table = sample_table();
        for column in &table.columns {
            assert_eq!(
                best(&table, column.metric),
                ["ours_100%|<b>"],
                "{}",
                column.metric
            );
        }
    }

    #[test]
    fn closeness_to_real_data_beats_size() {
        let metric = Metric::SourceRecall(1);
        let rows = |task| {
            [
                score_row(task, REAL_DATA, metric, 52.0),
                score_row(task, "copies", metric, 93.0),
                score_row(task, "edits", metric, 51.0),
                score_row(task, "edits too", metric, 53.001),
            ]
        };
        let recipes = BTreeMap::new();
        let table = &Table::from_scores(&rows("style"), &recipes, &[metric])[0];
        // 53.001 prints as 53.00, so both are one away from the real data.
        assert_eq!(best(table, metric), ["edits", "edits too"]);
        let table = &Table::from_scores(&rows("fine-grained"), &recipes, &[metric])[0];
        assert_eq!(best(table, metric), ["copies"]);
    }

    #[test]
    fn without_real_data_nothing_is_closest_to_them() {
        let metric = Metric::Diversity;
        let scores = [score_row("style", "ours", metric, 30.0)];
        let table = &Table::from_scores(&scores, &BTreeMap::new(), &[metric])[0];
        assert!(best(table, metric).is_empty());
    }

    #[test]
    fn tasks_protocols_and_encoders_are_kept_apart() {
        let mut scores = sample_scores("style");
        scores.extend(sample_scores(ALL_TASKS));
        let mut other = sample_scores("style");
        for row in &mut other {
            row.encoder_hash = "ff".to_owned();
        }
        scores.extend(other);
        let tables = Table::from_scores(&scores, &BTreeMap::new(), Metric::FURTHER);
        let keys: Vec<(&str, &str)> = tables
            .iter()
            .map(|table| (table.task.as_str(), table.encoder_hash.as_str()))
            .collect();
        assert_eq!(
            keys,
            [
                (ALL_TASKS, "0123456789abcdef"),
                ("style", "0123456789abcdef"),
                ("style", "ff")
            ]
        );
        assert_eq!(tables[0].columns.len(), Metric::FURTHER.len());
        assert!(Table::from_scores(&[], &BTreeMap::new(), Metric::PAPER).is_empty());
    }

    #[test]
    fn missing_values_leave_a_gap_and_missing_metrics_no_column() {
        let scores = [
            score_row("style", "a", Metric::FootScore, 0.9),
            score_row("style", "b", Metric::FidUnit, 0.2),
        ];
        let table = &Table::from_scores(&scores, &BTreeMap::new(), Metric::PAPER)[0];
        assert_eq!(table.columns.len(), 2);
        assert_eq!(table.rows[0].cells[0], None);
        assert!(table.rows[0].cells[1].is_some());
    }
}
