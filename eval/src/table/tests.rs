use std::collections::BTreeMap;

use super::*;
use crate::judge::{Judge, TOLD_APART};
use crate::metric::diversity::DIVERSITY;
use crate::metric::foot_score::FOOT_SCORE;
use crate::metric::position_error::POSITION_ERROR;
use crate::metric::{Measure, Part, RankSummary, fid, retrieval};
use crate::names::{ALL_TASKS, IDENTITY, REAL_DATA};
use crate::protocol::{Protocol, Spread};

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

/// Scores of four systems, some of whose names need escaping.
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
fn the_table_has_the_shape_of_the_papers_and_marks_the_best_system() {
    let table = sample_table();
    let labels: Vec<String> = table.columns.iter().map(Column::label).collect();
    assert_eq!(
        labels.join(" | "),
        "FID ↓ | Diversity → | FS ↑ | E2S R@1 → | E2S R@2 → | E2S R@3 → | E2S AvgR → | \
         E2T R@1 ↑ | E2T R@2 ↑ | E2T R@3 ↑ | E2T AvgR ↓"
    );
    let names: Vec<&str> = table.rows.iter().map(|row| row.system.as_str()).collect();
    let ours = "ours_100%|<b>";
    assert_eq!(names, [REAL_DATA, IDENTITY, "MotionReFit tiny", ours]);
    assert_eq!(
        table.head(),
        "semantic: 512 items (29 targets, 400 sources, 61 instructions; ids a1b2c3d4e5f6), \
         1 take, 10 repeats; galleries of 32, seed 0; encoder 0123456789ab (TMR tiny)"
    );
    // Baselines are never marked.
    for column in &table.columns {
        assert_eq!(best(&table, column.metric), [ours], "{}", column.metric);
    }
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
    let of_targets = |targets: u32| {
        let scores = told_apart(12.0, None).into_iter();
        let scores = scores.map(|row| ScoreRow { targets, ..row });
        scores.collect::<Vec<_>>()
    };
    let guesses = Some("it guesses");
    for (scores, weakness, ranks) in [
        (scores.clone(), None, true),
        (told_apart(12.0, Some(11.9)), None, true),
        (told_apart(12.0, None), None, true),
        (told_apart(12.0, Some(12.0)), None, false),
        (told_apart(0.0, None), None, false),
        (of_targets(1), None, false),
        (of_targets(9), None, false),
        (of_targets(10), None, true),
        (told_apart(12.0, Some(1.0)), guesses, false),
    ] {
        let judges = judges(weakness);
        let table = Table::from_scores(&scores, &judges, &paper_columns()).remove(0);
        let marks = table.rows.iter().flat_map(|row| row.cells.iter().flatten());
        assert_eq!(marks.filter(|cell| cell.best).count() > 0, ranks);
        assert_eq!(table.unranked.is_none(), ranks, "{:?}", table.unranked);
        let mut notes = table.notes.iter();
        let compares = notes.any(|note| note.contains("Behind the identity"));
        assert_eq!(compares, ranks);
        let standings = standings(&scores, &judges);
        let mut ranked = standings.iter().map(|standing| standing.ranks_systems);
        assert!(ranked.all(|ranked| ranked == ranks));
        let behind = standings.iter().any(|standing| standing.behind_identity);
        assert_eq!(behind, ranks);
        if !ranks {
            let tables = [table];
            let sentence = "This table ranks nothing.";
            let text = crate::format::text::render(&tables);
            assert!(
                text.lines().any(|line| line.starts_with(sentence)),
                "{text}"
            );
            let markdown = crate::format::markdown::render(&tables);
            let line = markdown.lines().nth(2).expect("a line");
            assert!(line.starts_with(sentence));
            let latex = crate::format::latex::render(&tables);
            assert!(latex.starts_with(&format!("% {sentence}")));
        }
    }
}

/// The only table of the scores. Nothing is known about their encoder.
fn table(scores: &[ScoreRow], columns: &[&'static Metric]) -> Table {
    let mut tables = Table::from_scores(scores, &BTreeMap::new(), columns);
    assert_eq!(tables.len(), 1);
    tables.remove(0)
}

fn best<'a>(table: &'a Table, metric: &Metric) -> Vec<&'a str> {
    let mut columns = table.columns.iter();
    let index = columns.position(|column| column.metric == metric);
    let index = index.expect("a column");
    table
        .rows
        .iter()
        .filter(|row| row.cells[index].is_some_and(|cell| cell.best))
        .map(|row| row.system.as_str())
        .collect()
}

#[test]
fn no_system_is_best_where_returning_the_original_is_better() {
    let (error, recall) = (&POSITION_ERROR, &retrieval::E2S_RECALL_1);
    let rows = [
        score_row("style", REAL_DATA, error, 0.0),
        score_row("style", IDENTITY, error, 40.0),
        score_row("style", "a", error, 43.0),
        score_row("style", "b", error, 40.001),
        // Good values are near real data: the identity editor is 48 away, the systems are 41 and 49 away.
        score_row("style", REAL_DATA, recall, 52.0),
        score_row("style", IDENTITY, recall, 100.0),
        score_row("style", "a", recall, 93.0),
        score_row("style", "b", recall, 3.0),
    ];
    let shown = &table(&rows, &[error, recall]);
    // 40.001 prints as the identity editor's 40.00, so it is neither behind nor better.
    assert!(best(shown, error).is_empty());
    assert_eq!(best(shown, recall), ["a"]);
    let behind = "Behind the identity editor, which returns the original unchanged: \
                  a in Position error (cm); b in E2S R@1.";
    assert_eq!(shown.notes, [behind]);
    let standings = standings(&rows, &BTreeMap::new());
    let places = |is: fn(&Standing) -> bool| -> Vec<usize> {
        (0..rows.len())
            .filter(|&place| is(&standings[place]))
            .collect()
    };
    assert_eq!(places(|found| found.behind_identity), [2, 7]);
    assert_eq!(places(|found| found.best), [6]);
    let alone = &table(&rows[..3], &[error]);
    assert!(best(alone, error).is_empty());
    assert!(alone.notes[0].contains(": a in every column."));
}

#[test]
fn a_metric_without_intervals_over_test_sets_ranks_nothing() {
    let error = &POSITION_ERROR;
    for (ci95, interval, expected) in [
        (None, Spread::Targets, &[][..]),
        (Some(9.0), Spread::Targets, &["a"][..]),
        // Repeats may all agree, and a published table then has no intervals.
        (None, Spread::Repeats, &["a"][..]),
    ] {
        let protocol = Protocol {
            interval,
            ..Protocol::default()
        };
        let rows = [(IDENTITY, 40.0), ("a", 30.0), ("b", 50.0)].map(|(system, mean)| ScoreRow {
            ci95,
            protocol: protocol.name(512),
            ..score_row("style", system, error, mean)
        });
        let shown = table(&rows, &[error]);
        assert_eq!(best(&shown, error), expected);
        // Nor is a system called worse than the identity editor.
        assert_eq!(shown.notes.is_empty(), expected.is_empty());
    }
}

#[test]
fn a_row_that_does_nothing_is_never_best() {
    let (error, fit) = (&POSITION_ERROR, &crate::metric::fit_error::FIT_ERROR);
    let mut rows = vec![
        score_row("style", REAL_DATA, error, 0.0),
        score_row("style", IDENTITY, error, 40.0),
        score_row("style", "imported sources", error, 40.001),
        score_row("style", "imported sources", fit, 0.0),
        score_row("style", "editor", error, 43.0),
        score_row("style", "editor", fit, 1.0),
    ];
    let columns = [error, fit];
    let shown = table(&rows, &columns);
    assert!(best(&shown, error).is_empty());
    // The identity editor has no fit error. A system that does not edit has the smallest one, but is not best.
    assert_eq!(best(&shown, fit), ["editor"]);
    let unmarked = "Never marked as best, as all values are those of the identity editor: ";
    assert_eq!(shown.notes[0], format!("{unmarked}imported sources."));
    let marks = standings(&rows, &BTreeMap::new());
    let best_rows: Vec<usize> = (0..rows.len()).filter(|&place| marks[place].best).collect();
    assert_eq!(best_rows, [5]);
    // The system is not marked in a table without other systems either.
    rows.truncate(4);
    let shown = table(&rows, &columns);
    assert!(best(&shown, error).is_empty() && best(&shown, fit).is_empty());
    // With a single different value, it counts as a system that edits.
    rows[2].mean = 39.0;
    let shown = table(&rows, &columns);
    assert_eq!(best(&shown, error), ["imported sources"]);
    assert!(shown.notes.is_empty(), "{:?}", shown.notes);
}

#[test]
fn what_is_left_out_for_want_of_items_is_explained() {
    let notes = |row: ScoreRow, columns: &[&'static Metric]| table(&[row], columns).notes;
    let row = |n: u32, fid_items: u32, targets: u32| ScoreRow {
        n,
        fid_items,
        targets,
        protocol: Protocol::default().name(n as usize),
        ..score_row("style", REAL_DATA, &FOOT_SCORE, 0.9)
    };
    let paper = paper_columns();
    assert!(notes(row(300, 65, 10), &paper).is_empty());
    assert_eq!(
        notes(row(299, 64, 9), &paper),
        [
            "FID is not measured: latents of 64 numbers need 65 items a side, and there are 64.",
            "Diversity is not measured: it draws 300 pairs and needs as many items, and there are 299.",
            "There are no intervals: they need 10 targets, and there are 9.",
        ]
    );
    // A table without FID and Diversity needs no note.
    assert!(notes(row(299, 64, 10), &[&FOOT_SCORE]).is_empty());
    // Intervals over repeats need no targets.
    let over_repeats = ScoreRow {
        protocol: Protocol {
            interval: Spread::Repeats,
            ..Protocol::default()
        }
        .name(300),
        ..row(300, 65, 1)
    };
    assert!(notes(over_repeats, &paper).is_empty());
    let rows = [row(1, 0, 1), row(1, 0, 1)];
    let all = shortages(&rows);
    assert_eq!(all.len(), 4, "{all:?}");
    assert!(all[0].starts_with("style: FID is not measured: ") && all[0].ends_with("there are 0."));
    assert!(all[3].ends_with("there is 1."));
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
    // Scores of earlier versions lack these fields.
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
    let best_of = |rows: &[ScoreRow]| best(&table(rows, &[metric]), metric).join(", ");
    // 53.001 prints as 53.00, so both are one away from the real data.
    assert_eq!(best_of(&rows("style")), "edits, edits too");
    assert_eq!(best_of(&rows("fine-grained")), "copies");
    // Without real data, nothing is closest to them.
    let alone = [score_row("style", "ours", &DIVERSITY, 30.0)];
    assert!(best(&table(&alone, &[&DIVERSITY]), &DIVERSITY).is_empty());
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
    let hash = "0123456789abcdef";
    assert_eq!(keys, [(ALL_TASKS, hash), ("style", hash), ("style", "ff")]);
    let columns = metric::of_part(Part::Further);
    assert_eq!(tables[0].columns.len(), columns.len());
    assert!(Table::from_scores(&[], &BTreeMap::new(), &paper_columns()).is_empty());
}

#[test]
fn missing_values_leave_a_gap_and_missing_metrics_no_column() {
    let scores = [
        score_row("style", "a", &FOOT_SCORE, 0.9),
        score_row("style", "b", &fid::FID, 0.2),
    ];
    let table = table(&scores, &paper_columns());
    assert_eq!(table.columns.len(), 2);
    assert_eq!(table.rows[0].cells[0], None);
    assert!(table.rows[0].cells[1].is_some());
}
