//! Result tables in the shape of the paper's Table 1.

use std::collections::BTreeMap;

use datasets_spec::record::ScoreRow;

use crate::judge::{Judges, unranked};
use crate::metric::{self, Metric};
use crate::names::{GIVEN, NOVELTIES, place_of_task};

mod column;
pub(crate) mod notes;
mod ranking;

use ranking::{Key, key};

pub use column::Column;
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
    /// Why the table cannot rank systems, as a sentence for its first line; none if it can. An unranked table marks no
    /// best value and compares no systems.
    pub unranked: Option<String>,
    /// The measured items.
    pub items: Items,
    /// Number of repeats.
    pub repeats: u32,
    /// Width of a latent.
    pub latent_width: u32,
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
    /// Number of items on each side of a Fréchet distance.
    pub fid: u32,
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
    /// Whether the row is a reference (real data, identity, noise floor) rather than a system.
    pub baseline: bool,
    /// Whether the values are taken from a publication and were not measured.
    pub published: bool,
    /// Number of motions per item.
    pub takes: u32,
    /// One cell per column; none if the metric was not measured.
    pub cells: Vec<Option<Cell>>,
}

/// A cell of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Mean over the repeats.
    pub mean: f64,
    /// Half width of the 95 % interval; none if there is no variation or a publication prints none.
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
        let mut keys: Vec<Key<'_>> = Vec::new();
        for row in scores {
            let key = key(row);
            if !keys.contains(&key) {
                keys.push(key);
            }
        }
        // The sort is stable, so tasks stay together even if two runs were joined.
        keys.sort_by_key(|(task, ..)| (place_of_task(task), *task));
        keys.into_iter()
            .filter_map(|wanted| {
                let rows: Vec<&ScoreRow> = scores.iter().filter(|row| key(row) == wanted).collect();
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
        let found = Found::of(scores, &standings, unranked.is_none());
        let columns: Vec<Column> = metrics
            .iter()
            .filter(|metric| found.cells.keys().any(|(_, known)| known == *metric))
            .map(|&metric| Column {
                metric,
                better: (metric.better)(&first.task),
            })
            .collect();
        if columns.is_empty() {
            return None;
        }
        let mut table = Self {
            task: first.task.clone(),
            protocol: first.protocol.clone(),
            encoder_hash: first.encoder_hash.clone(),
            encoder_recipe: judges
                .get(&first.encoder_hash)
                .map(|judge| judge.recipe.clone())
                .unwrap_or_default(),
            unranked,
            items: Items {
                count: first.n,
                targets: first.targets,
                sources: first.sources,
                instructions: first.instructions,
                fid: first.fid_items,
                novelty: first.novelty.clone(),
                digest: first.items_digest.clone(),
            },
            repeats: first.repeats,
            latent_width: first.latent_width,
            rows: found.rows(&columns),
            columns,
            notes: Vec::new(),
        };
        if table.unranked.is_none() {
            table.notes = notes::of_ranking(scores, &standings, &table.columns);
        }
        table.notes.extend(table.note_of_novelty());
        table.notes.extend(notes::of_shortages(first, metrics));
        Some(table)
    }

    /// Note on how much of the items the training split shows; none if that is not known or the table has only one
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
            (!row.baseline).then(|| place.unwrap_or(names.len()))
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
            text.push_str(&format!("; encoder {}", short_hash(&self.encoder_hash)));
        }
        if !self.encoder_recipe.is_empty() {
            text.push_str(&format!(" ({})", self.encoder_recipe));
        }
        text
    }

    /// The number of motions per item, in words.
    fn takes(&self) -> String {
        let systems = || self.rows.iter().filter(|row| competes(row));
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

/// Systems and conditions, collected from the scores of a table.
struct Found<'a> {
    /// Names of the systems: reference rows first, then the others in the order of their scores.
    names: Vec<&'a str>,
    takes: BTreeMap<&'a str, u32>,
    cells: BTreeMap<(&'a str, &'static Metric), Cell>,
}

impl<'a> Found<'a> {
    /// Skips scores of unknown metrics, and marks no best value unless `ranks` is set.
    fn of(scores: &[&'a ScoreRow], standings: &[Standing], ranks: bool) -> Self {
        let mut names: Vec<&str> = Vec::new();
        let mut takes = BTreeMap::new();
        let mut cells = BTreeMap::new();
        for (row, standing) in scores.iter().copied().zip(standings) {
            let Some(metric) = metric::from_name(&row.metric) else {
                continue;
            };
            let system = row.system.as_str();
            if !names.contains(&system) {
                names.push(system);
            }
            takes.insert(system, row.takes);
            let cell = Cell {
                mean: row.mean,
                ci95: row.ci95,
                best: standing.best && ranks,
            };
            cells.insert((system, metric), cell);
        }
        names.sort_by_key(|name| {
            let place = GIVEN.iter().position(|given| given == name);
            place.unwrap_or(GIVEN.len())
        });
        Self {
            names,
            takes,
            cells,
        }
    }

    fn rows(&self, columns: &[Column]) -> Vec<Row> {
        let cell = |name: &'a str, column: &Column| self.cells.get(&(name, column.metric)).copied();
        self.names
            .iter()
            .map(|&name| Row {
                system: name.to_owned(),
                baseline: GIVEN.contains(&name),
                published: false,
                takes: self.takes.get(name).copied().unwrap_or(0),
                cells: columns.iter().map(|column| cell(name, column)).collect(),
            })
            .collect()
    }
}

/// Whether a row is a system that was measured here.
fn competes(row: &Row) -> bool {
    !row.baseline && !row.published
}

/// Notes about values left out because of too few items, one sentence for each task and metric.
pub fn shortages(scores: &[ScoreRow]) -> Vec<String> {
    let mut known: Vec<Key<'_>> = Vec::new();
    let mut found = Vec::new();
    for row in scores {
        if known.contains(&key(row)) {
            continue;
        }
        known.push(key(row));
        let of_table = notes::of_shortages(row, metric::ALL).into_iter();
        found.extend(of_table.map(|sentence| format!("{}: {sentence}", row.task)));
    }
    found
}

fn counted(count: u32, what: &str) -> String {
    if count == 1 {
        format!("1 {what}")
    } else {
        format!("{count} {what}s")
    }
}

/// Number of digits of a hash that tables print: enough to distinguish the encoders of a project.
const SHORT_HASH: usize = 12;

/// The first digits of a hash.
pub(crate) fn short_hash(hash: &str) -> &str {
    hash.char_indices()
        .nth(SHORT_HASH)
        .map_or(hash, |(end, _)| &hash[..end])
}

#[cfg(test)]
pub(crate) mod tests;
