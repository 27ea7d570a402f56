//! Result tables in the shape of the paper's Table 1.

use std::collections::BTreeMap;

use datasets_spec::record::ScoreRow;

use crate::judge::{Judges, unranked};
use crate::metric::interval::Interval;
use crate::metric::{self, Better, Metric, fid};
use crate::names::{GIVEN, IDENTITY, NOVELTIES, REAL_DATA, place_of_task};

/// The scores of one task under one protocol and one encoder.
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
    /// Why the table ranks no system, as a sentence that stands in its first line; none if it ranks. Such a table marks no
    /// value and compares no system.
    pub unranked: Option<String>,
    /// What was measured.
    pub items: Items,
    /// Evaluations.
    pub repeats: u32,
    /// Numbers of a latent.
    pub latent_width: u32,
    /// The columns.
    pub columns: Vec<Column>,
    /// The rows: real data, identity, noise floor where there is one, then the systems.
    pub rows: Vec<Row>,
    /// What a reader has to know besides the numbers, one sentence each.
    pub notes: Vec<String>,
}

/// The items behind a table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Items {
    /// Items measured.
    pub count: u32,
    /// Distinct motions that their targets were made of; 0 where it is not known.
    pub targets: u32,
    /// Distinct motions that their sources were made of.
    pub sources: u32,
    /// Distinct instructions.
    pub instructions: u32,
    /// Items on either side of a Fréchet distance.
    pub fid: u32,
    /// Items of each novelty in words, such as `100 retake, 50 action`; empty where it is not known.
    pub novelty: String,
    /// Digest of the sorted item ids.
    pub digest: String,
}

/// A column of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    /// The metric.
    pub metric: &'static Metric,
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
    /// Motions of each item.
    pub takes: u32,
    /// One cell for each column; none where the metric was not measured.
    pub cells: Vec<Option<Cell>>,
}

/// A cell of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Mean over the repeats.
    pub mean: f64,
    /// Half width of the 95 % interval; none where nothing varies or a publication prints none.
    pub ci95: Option<f64>,
    /// Whether no measured system is better, the identity editor included.
    pub best: bool,
}

impl Cell {
    /// The mean as printed.
    pub fn mean_text(&self, metric: &Metric) -> String {
        format!("{:.*}", metric.decimals, self.mean)
    }

    /// The half width as printed, with its sign; empty where there is none.
    pub fn ci_text(&self, metric: &Metric) -> String {
        self.ci95
            .map_or_else(String::new, |ci95| format!("±{ci95:.*}", metric.decimals))
    }
}

impl Table {
    /// Lays out scores: one table for each task, protocol and encoder found, in the order of
    /// [`crate::score::score`].
    ///
    /// `judges` holds the encoder of each hash. `metrics` are the columns; those that
    /// no system has a value of are left out, and so are scores of other metrics.
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
        // A stable sort: tasks keep together even when two runs were joined.
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
        let mut names: Vec<&str> = Vec::new();
        let mut values: BTreeMap<(&str, &Metric), Interval> = BTreeMap::new();
        let mut takes: BTreeMap<&str, u32> = BTreeMap::new();
        for row in scores {
            let Some(metric) = metric::from_name(&row.metric) else {
                continue;
            };
            if !names.contains(&row.system.as_str()) {
                names.push(&row.system);
            }
            takes.insert(&row.system, row.takes);
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
                better: (metric.better)(&first.task),
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
                takes: takes.get(name).copied().unwrap_or(0),
                cells: columns
                    .iter()
                    .map(|column| {
                        values.get(&(name, column.metric)).map(|interval| Cell {
                            mean: interval.mean,
                            ci95: interval.ci95,
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
            encoder_recipe: judges
                .get(&first.encoder_hash)
                .map(|judge| judge.recipe.clone())
                .unwrap_or_default(),
            unranked: unranked(first, scores.iter().copied(), judges),
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
            columns,
            rows,
            notes: Vec::new(),
        };
        if table.unranked.is_none() {
            let behind = table.mark_best();
            table.notes.extend(behind);
        }
        table.notes.extend(table.note_of_novelty());
        table.notes.extend(table.note_of_small_samples());
        Some(table)
    }

    /// What training has shown of the items; none where that is not known or the table is of one novelty.
    fn note_of_novelty(&self) -> Option<String> {
        let is_of_one = NOVELTIES.contains(&self.task.as_str());
        (!is_of_one && !self.items.novelty.is_empty()).then(|| {
            format!(
                "Items by what training has shown of them: {}.",
                self.items.novelty
            )
        })
    }

    /// Orders the systems as they are named, after the rows that every table has.
    pub fn sort_systems(&mut self, names: &[&str]) {
        self.rows.sort_by_key(|row| {
            let place = names.iter().position(|name| *name == row.system);
            (!row.baseline).then(|| place.unwrap_or(names.len()))
        });
    }

    /// The head of the table in one line: the task, and what the numbers depend on.
    pub fn head(&self) -> String {
        format!("{}: {}", self.task, self.conditions())
    }

    /// What the numbers depend on, in one line.
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

    /// How many motions of each item the systems made.
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

    /// Marks the best measured systems of each column; values that print alike are equally good.
    /// Where the identity editor is better than all systems, none is marked. Returns a sentence that
    /// names the systems behind the identity editor.
    fn mark_best(&mut self) -> Option<String> {
        let mut behind: BTreeMap<usize, Vec<&'static str>> = BTreeMap::new();
        for (index, column) in self.columns.iter().enumerate() {
            let given = |name: &str| {
                let row = self.rows.iter().find(|row| row.system == name)?;
                row.cells[index].map(|cell| cell.mean)
            };
            let (real, identity) = (given(REAL_DATA), given(IDENTITY));
            let badness = |mean: f64| badness(*column, mean, real);
            let limit = identity.and_then(badness).unwrap_or(f64::INFINITY);
            let best = self
                .rows
                .iter()
                .filter(|row| competes(row))
                .filter_map(|row| badness(row.cells[index]?.mean))
                .min_by(f64::total_cmp)
                .filter(|best| *best <= limit);
            for (place, row) in self.rows.iter_mut().enumerate() {
                let is_competitor = competes(row);
                if let Some(cell) = &mut row.cells[index] {
                    let found = badness(cell.mean);
                    cell.best = is_competitor && best.is_some() && found == best;
                    if is_competitor && found.is_some_and(|found| found > limit) {
                        behind.entry(place).or_default().push(column.metric.name);
                    }
                }
            }
        }
        // Systems that fall behind in the same columns share a clause.
        let mut clauses: Vec<(Vec<&'static str>, Vec<&str>)> = Vec::new();
        for (place, metrics) in behind {
            let system = self.rows[place].system.as_str();
            match clauses.iter_mut().find(|(known, _)| *known == metrics) {
                Some((_, systems)) => systems.push(system),
                None => clauses.push((metrics, vec![system])),
            }
        }
        let systems: Vec<String> = clauses
            .into_iter()
            .map(|(metrics, systems)| {
                let systems = systems.join(", ");
                if metrics.len() == self.columns.len() {
                    format!("{systems} in every column")
                } else {
                    format!("{systems} in {}", metrics.join(", "))
                }
            })
            .collect();
        (!systems.is_empty()).then(|| {
            format!(
                "Behind the identity editor, which returns the original unchanged: {}.",
                systems.join("; ")
            )
        })
    }

    /// A note where the covariances of a Fréchet distance come from fewer motions than dimensions.
    fn note_of_small_samples(&self) -> Option<String> {
        let is_fid = |column: &Column| [&fid::FID, &fid::FID_RAW].contains(&column.metric);
        let (count, width) = (self.items.fid, self.latent_width);
        (self.columns.iter().any(is_fid) && count > 0 && count <= width).then(|| {
            format!(
                "FID: {count} motions a side are too few for latents of {width} numbers, whose \
                 covariance is singular below {}. Most of the value is what a small sample adds: \
                 hold it against the row of the real data, not against published values.",
                width + 1
            )
        })
    }
}

/// Whether a row can be the best of its column.
fn competes(row: &Row) -> bool {
    !row.baseline && !row.published
}

/// How far a value is from the best, as printed; none where values near real data are good and there
/// is no real data.
fn badness(column: Column, mean: f64, real: Option<f64>) -> Option<f64> {
    let unit = 10f64.powi(column.metric.decimals as i32);
    let printed = |mean: f64| (mean * unit).round();
    match column.better {
        Better::Lower => Some(printed(mean)),
        Better::Higher => Some(-printed(mean)),
        Better::NearReal => real.map(|real| (printed(mean) - printed(real)).abs()),
    }
}

/// Whether each score is one of a table that ranks systems; and whether it is then worse than the identity editor's of the
/// same task, items and protocol.
pub(crate) fn standings(scores: &[ScoreRow], judges: &Judges) -> Vec<Standing> {
    let mut ranking: BTreeMap<Key<'_>, bool> = BTreeMap::new();
    for row in scores {
        ranking
            .entry(key(row))
            .or_insert_with(|| unranked(row, scores, judges).is_none());
    }
    let behind = behind_identity(scores);
    let rows = scores.iter().zip(behind);
    rows.map(|(row, behind_identity)| {
        let ranks_systems = ranking[&key(row)];
        Standing {
            ranks_systems,
            behind_identity: ranks_systems && behind_identity,
        }
    })
    .collect()
}

/// Where a score stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Standing {
    /// Whether its table ranks systems.
    pub(crate) ranks_systems: bool,
    /// Whether it is worse than the identity editor's.
    pub(crate) behind_identity: bool,
}

/// Whether each score is worse than the identity editor's of the same task, items and protocol.
fn behind_identity(scores: &[ScoreRow]) -> Vec<bool> {
    let given: BTreeMap<(Key<'_>, &str, &str), f64> = scores
        .iter()
        .filter(|row| [REAL_DATA, IDENTITY].contains(&row.system.as_str()))
        .map(|row| {
            (
                (key(row), row.metric.as_str(), row.system.as_str()),
                row.mean,
            )
        })
        .collect();
    scores
        .iter()
        .map(|row| {
            let of = |system| given.get(&(key(row), row.metric.as_str(), system)).copied();
            let (Some(metric), Some(identity)) = (metric::from_name(&row.metric), of(IDENTITY))
            else {
                return false;
            };
            let column = Column {
                metric,
                better: (metric.better)(&row.task),
            };
            let badness = |mean| badness(column, mean, of(REAL_DATA));
            !GIVEN.contains(&row.system.as_str()) && badness(row.mean) > badness(identity)
        })
        .collect()
}

fn counted(count: u32, what: &str) -> String {
    if count == 1 {
        format!("1 {what}")
    } else {
        format!("{count} {what}s")
    }
}

/// Task, protocol, encoder and items: scores that share them stand in one table.
type Key<'a> = (&'a str, &'a str, &'a str, &'a str);

fn key(row: &ScoreRow) -> Key<'_> {
    (
        &row.task,
        &row.protocol,
        &row.encoder_hash,
        &row.items_digest,
    )
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
    use crate::judge::{Judge, TOLD_APART};
    use crate::metric::diversity::DIVERSITY;
    use crate::metric::foot_score::FOOT_SCORE;
    use crate::metric::position_error::POSITION_ERROR;
    use crate::metric::{Measure, Part, RankSummary, retrieval};
    use crate::names::ALL_TASKS;

    fn paper_columns() -> Vec<&'static Metric> {
        metric::of_part(Part::Paper)
    }

    /// A score row of the sample table.
    pub(crate) fn score_row(task: &str, system: &str, metric: &Metric, mean: f64) -> ScoreRow {
        ScoreRow {
            system: system.to_owned(),
            task: task.to_owned(),
            metric: metric.name.to_owned(),
            protocol: "galleries of 32, seed 0".to_owned(),
            encoder_hash: "0123456789abcdef".to_owned(),
            n: 512,
            repeats: 10,
            mean,
            ci95: Some(mean / 100.0),
            takes: 1,
            targets: 29,
            sources: 400,
            instructions: 61,
            gallery: 32,
            ranked: 512,
            fid_items: 256,
            latent_width: 64,
            novelty: String::new(),
            items_digest: "a1b2c3d4e5f6".to_owned(),
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
            for &metric in metric::ALL {
                let mean = match metric.measure {
                    Measure::Rank(_, RankSummary::Recall(_)) => 100.0 * factor,
                    _ if *metric == DIVERSITY => 36.06 * factor,
                    _ if *metric == FOOT_SCORE => factor,
                    _ => 2.0 / factor,
                };
                scores.push(score_row(task, system, metric, mean));
            }
        }
        scores
    }

    /// The encoder of the sample scores.
    pub(crate) fn judges(weakness: Option<&str>) -> Judges {
        let judge = Judge {
            recipe: "TMR tiny".to_owned(),
            weakness: weakness.map(str::to_owned),
        };
        Judges::from([("0123456789abcdef".to_owned(), judge)])
    }

    /// The sample scores as a table of the paper's columns.
    pub(crate) fn sample_table() -> Table {
        Table::from_scores(&sample_scores("semantic"), &judges(None), &paper_columns()).remove(0)
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
            "semantic: 512 items (29 targets, 400 sources, 61 instructions; ids a1b2c3d4e5f6), \
             1 take, 10 repeats; galleries of 32, seed 0; encoder 0123456789ab (TMR tiny)"
        );
    }

    #[test]
    fn a_weak_encoder_and_items_without_difference_rank_nothing() {
        let scores = sample_scores("semantic");
        let told_apart = |mean: f64, ci95: Option<f64>| {
            let mut scores = scores.clone();
            let row = score_row("semantic", IDENTITY, &retrieval::E2T_RECALL_1, mean);
            scores.push(ScoreRow {
                metric: TOLD_APART.to_owned(),
                ci95,
                ..row
            });
            scores
        };
        let cases = [
            (scores.clone(), judges(None), true),
            (told_apart(12.0, Some(11.9)), judges(None), true),
            (told_apart(12.0, None), judges(None), true),
            (told_apart(12.0, Some(12.0)), judges(None), false),
            (told_apart(0.0, None), judges(None), false),
            (
                told_apart(12.0, Some(1.0)),
                judges(Some("it guesses")),
                false,
            ),
        ];
        for (scores, judges, ranks) in cases {
            let table = Table::from_scores(&scores, &judges, &paper_columns()).remove(0);
            let marks = table.rows.iter().flat_map(|row| row.cells.iter().flatten());
            assert_eq!(marks.filter(|cell| cell.best).count() > 0, ranks);
            assert_eq!(table.unranked.is_none(), ranks, "{:?}", table.unranked);
            let compares = table
                .notes
                .iter()
                .any(|note| note.contains("Behind the identity"));
            assert_eq!(compares, ranks);
            let standings = standings(&scores, &judges);
            assert!(
                standings
                    .iter()
                    .all(|standing| standing.ranks_systems == ranks)
            );
            let behind = standings.iter().any(|standing| standing.behind_identity);
            assert_eq!(behind, ranks);
            if !ranks {
                let tables = [table];
                let sentence = "This table ranks nothing.";
                assert!(crate::format::text::render(&tables).starts_with(sentence));
                let markdown = crate::format::markdown::render(&tables);
                assert!(
                    markdown
                        .lines()
                        .nth(2)
                        .is_some_and(|line| line.starts_with(sentence))
                );
                let latex = crate::format::latex::render(&tables);
                assert!(latex.starts_with(&format!("% {sentence}")));
            }
        }
    }

    fn best<'a>(table: &'a Table, metric: &Metric) -> Vec<&'a str> {
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
    fn no_system_is_best_where_returning_the_original_is_better() {
        let (error, recall) = (&POSITION_ERROR, &retrieval::E2S_RECALL_1);
        let rows = [
            score_row("style", REAL_DATA, error, 0.0),
            score_row("style", IDENTITY, error, 40.0),
            score_row("style", "a", error, 43.0),
            score_row("style", "b", error, 40.001),
            // Near real data is good here: the identity editor is 48 away, the systems 41 and 49.
            score_row("style", REAL_DATA, recall, 52.0),
            score_row("style", IDENTITY, recall, 100.0),
            score_row("style", "a", recall, 93.0),
            score_row("style", "b", recall, 3.0),
        ];
        let table = &Table::from_scores(&rows, &BTreeMap::new(), &[error, recall])[0];
        // 40.001 prints as the identity's 40.00 and is not behind it.
        assert_eq!(best(table, error), ["b"]);
        assert_eq!(best(table, recall), ["a"]);
        let behind = "Behind the identity editor, which returns the original unchanged: \
                      a in Position error (cm); b in E2S R@1.";
        assert_eq!(table.notes, [behind]);
        assert_eq!(
            behind_identity(&rows),
            [false, false, true, false, false, false, false, true]
        );
        let alone = &Table::from_scores(&rows[..3], &BTreeMap::new(), &[error])[0];
        assert!(best(alone, error).is_empty());
        assert!(alone.notes[0].contains(": a in every column."));
    }

    #[test]
    fn a_small_sample_is_said_to_be_one() {
        let mut scores = sample_scores("style");
        let notes = |scores: &[ScoreRow]| {
            let table = Table::from_scores(scores, &BTreeMap::new(), &paper_columns()).remove(0);
            table.notes.join(" ")
        };
        assert!(!notes(&scores).contains("FID:"));
        for row in &mut scores {
            row.fid_items = 64;
        }
        let note = notes(&scores);
        assert!(
            note.contains("64 motions a side are too few for latents of 64 numbers"),
            "{note}"
        );
        assert!(note.contains("singular below 65"), "{note}");
        let of_feet = [score_row("style", "a", &FOOT_SCORE, 0.9)];
        assert_eq!(notes(&of_feet), "");
    }

    #[test]
    fn takes_are_counted_and_item_sets_kept_apart() {
        let mut rows = [
            score_row("style", REAL_DATA, &FOOT_SCORE, 0.9),
            score_row("style", "a", &FOOT_SCORE, 0.9),
            score_row("style", "b", &FOOT_SCORE, 0.9),
        ];
        rows[1].takes = 3;
        let head = |rows: &[ScoreRow]| {
            let tables = Table::from_scores(rows, &BTreeMap::new(), &[&FOOT_SCORE]);
            tables.iter().map(Table::head).collect::<Vec<_>>()
        };
        assert!(head(&rows)[0].contains("), 3 takes of a, 1 take of b, 10 repeats;"));
        rows[2].takes = 3;
        assert!(head(&rows)[0].contains("), 3 takes, 10 repeats;"));
        rows[2].items_digest = "ffffffffffff".to_owned();
        let heads = head(&rows);
        assert_eq!(heads.len(), 2);
        assert!(heads[1].contains("ids ffffffffffff"), "{heads:?}");
        // Scores from before these were recorded.
        for row in &mut rows {
            (row.takes, row.targets, row.items_digest) = (0, 0, String::new());
        }
        assert!(head(&rows)[0].starts_with("style: 512 items, 10 repeats; "));
    }

    #[test]
    fn closeness_to_real_data_beats_size() {
        let metric = &retrieval::E2S_RECALL_1;
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
        let metric = &DIVERSITY;
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
        let tables = Table::from_scores(&scores, &BTreeMap::new(), &metric::of_part(Part::Further));
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
        assert_eq!(
            tables[0].columns.len(),
            metric::of_part(Part::Further).len()
        );
        assert!(Table::from_scores(&[], &BTreeMap::new(), &paper_columns()).is_empty());
    }

    #[test]
    fn missing_values_leave_a_gap_and_missing_metrics_no_column() {
        let scores = [
            score_row("style", "a", &FOOT_SCORE, 0.9),
            score_row("style", "b", &fid::FID, 0.2),
        ];
        let table = &Table::from_scores(&scores, &BTreeMap::new(), &paper_columns())[0];
        assert_eq!(table.columns.len(), 2);
        assert_eq!(table.rows[0].cells[0], None);
        assert!(table.rows[0].cells[1].is_some());
    }
}
