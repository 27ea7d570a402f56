//! Result tables in the shape of the paper's Table 1.

use datasets_spec::record::ScoreRow;

use crate::judge::{Judges, table_of, unranked};
use crate::metric::{self, Column, Metric};
use crate::names::{GIVEN, NOVELTIES, place_of_task};

pub(crate) mod notes;
mod ranking;

use ranking::distinct;

pub(crate) use ranking::{Standing, standings};

/// A result table: the scores of one task with one protocol and one encoder.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// The task, such as `semantic`.
    pub task: String,
    /// The protocol in words.
    pub protocol: String,
    /// Hash of the encoder in hexadecimal.
    pub encoder_hash: String,
    /// How the encoder was trained.
    pub encoder_recipe: String,
    /// Why the table cannot rank systems, as a sentence for its first line; `None` if it can. An unranked table marks
    /// no best value and compares no systems.
    pub unranked: Option<String>,
    /// The measured items.
    pub items: Items,
    /// Number of repeats.
    pub repeats: u32,
    /// The columns.
    pub columns: Vec<Column>,
    /// The rows: real data, identity editor, noise floor if there is one, then the systems.
    pub rows: Vec<Row>,
    /// Notes below the table, one sentence each.
    pub notes: Vec<String>,
}

/// The items behind a table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Items {
    /// Number of items.
    pub count: u32,
    /// Number of distinct motions that the targets were made of; 0 if not known.
    pub targets: u32,
    /// Number of distinct motions that the sources were made of.
    pub sources: u32,
    /// Number of distinct instructions.
    pub instructions: u32,
    /// Number of items of each novelty in words, such as `100 retake, 50 action`; empty if not known.
    pub novelty: String,
    /// Digest of the sorted item ids.
    pub digest: String,
}

/// A row of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the system.
    pub system: String,
    /// What kind of row it is.
    pub group: RowGroup,
    /// Number of motions per item.
    pub takes: u32,
    /// One cell per column; `None` if the metric was not measured.
    pub cells: Vec<Option<Cell>>,
}

/// Groups of rows, which formats separate visually.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowGroup {
    /// A reference: real data, identity editor or noise floor.
    Baseline,
    /// A system that was measured here.
    System,
    /// Values of a publication, which were not measured here.
    Published,
}

/// A cell of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Mean over the repeats.
    pub mean: f64,
    /// Half width of the 95 % interval; `None` if there is no variation, or if a publication prints no interval.
    pub ci95: Option<f64>,
    /// Whether the value is the best of the measured systems and better than that of the identity editor.
    pub best: bool,
}

impl Cell {
    /// The mean as printed.
    pub fn mean_text(&self, metric: &Metric) -> String {
        format!("{:.*}", metric.decimals, self.mean)
    }

    /// The half width as printed, with its sign; empty without an interval.
    pub fn ci_text(&self, metric: &Metric) -> String {
        self.ci95
            .map_or_else(String::new, |ci95| format!("±{ci95:.*}", metric.decimals))
    }
}

impl Table {
    /// Lays out scores: one table per task, protocol and encoder, in the order of [`crate::score::score`].
    ///
    /// `judges` holds the encoder of each hash. `metrics` are the columns. Columns in which no system has a value are
    /// left out, and so are scores of other metrics.
    pub fn from_scores(
        scores: &[ScoreRow],
        judges: &Judges,
        metrics: &[&'static Metric],
    ) -> Vec<Self> {
        let mut keys = distinct(scores.iter().map(table_of), |&key| key);
        // The tables of a task stand together even if two runs were joined, in their order: the sort is stable.
        keys.sort_by_key(|(task, ..)| (place_of_task(task), *task));
        keys.into_iter()
            .filter_map(|wanted| {
                let rows: Vec<&ScoreRow> = scores
                    .iter()
                    .filter(|row| table_of(row) == wanted)
                    .collect();
                Self::of_group(&rows, judges, metrics)
            })
            .collect()
    }

    fn of_group(
        scores: &[&ScoreRow],
        judges: &Judges,
        metrics: &[&'static Metric],
    ) -> Option<Self> {
        let first = scores.first()?;
        let unranked = unranked(first, scores.iter().copied(), judges);
        let standings = ranking::of_table(scores);
        let columns: Vec<Column> = metrics
            .iter()
            .filter(|metric| scores.iter().any(|row| row.metric == metric.name))
            .map(|&metric| Column::of(metric, &first.task))
            .collect();
        if columns.is_empty() {
            return None;
        }
        let ranked = unranked.is_none().then_some(&standings[..]);
        let mut table = Self {
            task: first.task.clone(),
            protocol: first.protocol.clone(),
            encoder_hash: first.encoder_hash.clone(),
            encoder_recipe: judges
                .get(&first.encoder_hash)
                .map(|judge| judge.recipe.clone())
                .unwrap_or_default(),
            items: Items {
                count: first.n,
                targets: first.targets,
                sources: first.sources,
                instructions: first.instructions,
                novelty: first.novelty.clone(),
                digest: first.items_digest.clone(),
            },
            repeats: first.repeats,
            rows: rows(scores, ranked, &columns),
            notes: ranked.map_or_else(Vec::new, |ranked| {
                notes::of_ranking(scores, ranked, &columns)
            }),
            columns,
            unranked,
        };
        table.notes.extend(table.note_of_novelty());
        table.notes.extend(notes::of_shortages(first, metrics));
        Some(table)
    }

    /// Note on how much of the items the training split shows; `None` if that is not known or the table is that of one
    /// novelty.
    fn note_of_novelty(&self) -> Option<String> {
        let is_of_one = NOVELTIES.contains(&self.task.as_str());
        (!is_of_one && !self.items.novelty.is_empty()).then(|| {
            format!(
                "Items by what training has shown of them: {}.",
                self.items.novelty
            )
        })
    }

    /// Sorts the systems in the given order, after the reference rows.
    pub fn sort_systems(&mut self, names: &[&str]) {
        self.rows.sort_by_key(|row| {
            let place = names.iter().position(|name| *name == row.system);
            (row.group != RowGroup::Baseline).then(|| place.unwrap_or(names.len()))
        });
    }

    /// One line above the table: the task, and the conditions of the measurement.
    pub fn head(&self) -> String {
        format!("{}: {}", self.task, self.conditions())
    }

    /// Protocol and data of the measurement, in one line.
    pub fn conditions(&self) -> String {
        let items = &self.items;
        let mut text = counted(items.count, "item");
        if items.targets > 0 {
            text.push_str(&format!(
                " ({}, {}, {}; ids {})",
                counted(items.targets, "target"),
                counted(items.sources, "source"),
                counted(items.instructions, "instruction"),
                items.digest
            ));
        }
        text.push_str(&self.takes());
        text.push_str(&format!(", {} repeats; {}", self.repeats, self.protocol));
        if !self.encoder_hash.is_empty() {
            text.push_str(&format!("; encoder {:.12}", self.encoder_hash));
        }
        if !self.encoder_recipe.is_empty() {
            text.push_str(&format!(" ({})", self.encoder_recipe));
        }
        text
    }

    /// The number of motions per item, in words.
    fn takes(&self) -> String {
        let is_system = |row: &&Row| row.group == RowGroup::System;
        let systems = || self.rows.iter().filter(is_system);
        let of = |row: &Row| counted(row.takes, "take");
        match systems().next() {
            None => String::new(),
            Some(first) if first.takes == 0 => String::new(),
            Some(first) if systems().all(|row| row.takes == first.takes) => {
                format!(", {}", of(first))
            }
            Some(_) => {
                let each: Vec<String> = systems()
                    .map(|row| format!("{} of {}", of(row), row.system))
                    .collect();
                format!(", {}", each.join(", "))
            }
        }
    }
}

/// The rows of a table: reference rows first, then the other systems in the order of their scores. Scores of unknown
/// metrics are skipped. Without `standings`, no value is marked as best.
fn rows(scores: &[&ScoreRow], standings: Option<&[Standing]>, columns: &[Column]) -> Vec<Row> {
    let is_known = |place: &usize| metric::from_name(&scores[*place].metric).is_some();
    let known: Vec<usize> = (0..scores.len()).filter(is_known).collect();
    let systems = known.iter().map(|&place| scores[place].system.as_str());
    let mut systems = distinct(systems, |&system| system);
    systems.sort_by_key(|system| {
        let place = GIVEN.iter().position(|given| given == system);
        place.unwrap_or(GIVEN.len())
    });
    let row = |system: &str| {
        let own = known
            .iter()
            .filter(|&&place| scores[place].system == system);
        let cell = |column: &Column| {
            let mut places = own.clone();
            let place = *places.rfind(|&&place| scores[place].metric == column.metric.name)?;
            Some(Cell {
                mean: scores[place].mean,
                ci95: scores[place].ci95,
                best: standings.is_some_and(|standings| standings[place].best),
            })
        };
        Row {
            system: system.to_owned(),
            group: match GIVEN.contains(&system) {
                true => RowGroup::Baseline,
                false => RowGroup::System,
            },
            takes: own
                .clone()
                .next_back()
                .map_or(0, |&place| scores[place].takes),
            cells: columns.iter().map(cell).collect(),
        }
    };
    systems.into_iter().map(row).collect()
}

/// Notes about values left out because of too few items, one sentence for each task and metric.
pub fn shortages(scores: &[ScoreRow]) -> Vec<String> {
    let of_table = |row: &ScoreRow| -> Vec<String> {
        let sentences = notes::of_shortages(row, metric::ALL).into_iter();
        sentences
            .map(|sentence| format!("{}: {sentence}", row.task))
            .collect()
    };
    distinct(scores.iter(), |&row| table_of(row))
        .into_iter()
        .flat_map(of_table)
        .collect()
}

fn counted(count: u32, what: &str) -> String {
    if count == 1 {
        format!("1 {what}")
    } else {
        format!("{count} {what}s")
    }
}

#[cfg(test)]
pub(crate) mod tests;
