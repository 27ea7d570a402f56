//! Final output of `stance reproduce`: files of tables and figures, the page, and the printed text.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use eval::judge::Judges;
use eval::names::{ALL_TASKS, IDENTITY, NOISE_FLOOR, REAL_DATA, is_pooled};
use eval::report::Report;
use eval::table::Table;
use serde::Serialize;
use serde_json::Value;

use super::figures::FigureMade;
use super::files::{Failed, file_name, left_over, write, write_drawing};
use super::made::TableMade;
use super::plan::Plan;
use super::work::{Work, in_json};
use crate::cmd::page;
use crate::evaluators::WeakJudgeArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Items in the viewer of the page.
const SHOWN_ITEMS: usize = 12;

/// Results of a plan so far.
#[derive(Default)]
pub(super) struct Done {
    /// Name of each system, with a folder of edits for each of its trainings.
    pub(super) edits: Vec<(String, Vec<PathBuf>)>,
    pub(super) tables: Vec<TableMade>,
    pub(super) figures: Vec<FigureMade>,
    /// Drawings of the pictures.
    pub(super) pictures: Vec<PathBuf>,
    pub(super) failed: Failed,
}

/// The `--json` document, also `results.json`.
#[derive(Default, Serialize)]
struct Document {
    page: PathBuf,
    tables: Vec<(String, Vec<Value>)>,
    /// Scores of each training, for tables whose systems were trained several times.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    trainings: Vec<(String, Vec<Vec<Value>>)>,
    figures: Vec<FigureMade>,
    pictures: Vec<PathBuf>,
    failed: Vec<String>,
}

impl Document {
    /// Paths of tables and drawings, without extension.
    fn written(&self, out: &Path) -> BTreeSet<PathBuf> {
        let of_figures = self.figures.iter().map(|figure| file_name(&figure.name));
        let tables = self.tables.iter().map(|(name, _)| name.clone());
        let tables = tables
            .chain(of_figures)
            .map(|name| out.join("tables").join(name));
        let drawings = self.figures.iter().flat_map(|figure| &figure.drawings);
        let drawings = drawings
            .chain(&self.pictures)
            .map(|path| path.with_extension(""));
        tables.chain(drawings).collect()
    }
}

/// Writes tables, figures and the page, which names the `command`, and prints the tables.
pub(super) fn finish(
    plan: &Plan,
    work: &Work<'_>,
    mut done: Done,
    command: String,
    weak_judge: WeakJudgeArgs,
    global: &Global,
) -> anyhow::Result<Exit> {
    let (out, judges) = (&plan.out, &work.judges());
    let of_tables = done.tables.iter().find_map(|made| made.unranked.clone());
    let unranked = of_tables.or_else(|| weakness_of(judges));
    let mut results = Results {
        out,
        texts: Vec::new(),
        document: Document {
            page: out.join("index.html"),
            pictures: std::mem::take(&mut done.pictures),
            failed: std::mem::take(&mut done.failed.0),
            ..Document::default()
        },
        record: Vec::new(),
    };
    for made in &done.tables {
        results.add_table(made, judges)?;
    }
    let mut page = page_of(work, &done, global)?;
    for figure in done.figures {
        results.add_figure(figure, &mut page)?;
    }
    let document = &results.document;
    page.title.clone_from(&plan.title);
    if !document.failed.is_empty() {
        let failed = document.failed.join("; ");
        page.settings
            .push(("failed and missing".to_owned(), failed));
    }
    page.commands = vec![command];
    write(&document.page, page.to_html().as_bytes())?;
    let text = serde_json::to_vec_pretty(document)?;
    write(&out.join("results.json"), &text)?;
    write(&out.join("record.jsonl"), &results.record)?;
    let left = left_over(out, &document.written(out));
    if !left.is_empty() {
        report::note(&format!(
            "{} holds files of earlier runs, which this one did not write: {}",
            out.display(),
            left.join(", ")
        ));
    }
    let paths = document.pictures.iter().chain([&document.page]);
    let paths = paths.map(|path| path.display().to_string());
    results.texts.extend(paths);
    global.say(document, &results.texts.join("\n"))?;
    if document.failed.is_empty() {
        return Ok(weak_judge.exit(unranked, Exit::Done));
    }
    report::note(&format!(
        "failed and missing: {}; the rest is written, and the same command tries these again",
        document.failed.join("; ")
    ));
    Ok(Exit::Failed)
}

fn weakness_of(judges: &Judges) -> Option<String> {
    let weakness = judges.values().find_map(|judge| judge.weakness.as_ref())?;
    Some(format!(
        "The figures compare nothing. The encoder is too weak to judge: {weakness}."
    ))
}

/// The page of a plan, without its figures. It plays the edits of the first training of each system.
fn page_of(work: &Work<'_>, done: &Done, global: &Global) -> anyhow::Result<Report> {
    let first = |(_, edits): &(String, Vec<PathBuf>)| edits[0].clone();
    let folders: Vec<PathBuf> = done.edits.iter().map(first).collect();
    let all: Vec<Table> = done
        .tables
        .iter()
        .flat_map(|made| made.tables.clone())
        .collect();
    let (answered, _) = work.answered(&folders, None)?;
    match folders.is_empty() {
        true => Ok(Report::default()),
        false => page::of_edits(&answered, &folders, all, SHOWN_ITEMS, global),
    }
}

/// Collects the results while they are written.
struct Results<'a> {
    out: &'a Path,
    /// Printed texts.
    texts: Vec<String>,
    document: Document,
    /// Lines of `record.jsonl`.
    record: Vec<u8>,
}

impl Results<'_> {
    fn add_table(&mut self, made: &TableMade, judges: &Judges) -> anyhow::Result<()> {
        let forms = made.forms(judges)?;
        for (extension, text) in &forms {
            let name = format!("{}.{extension}", made.name);
            write(&self.out.join("tables").join(name), text.as_bytes())?;
        }
        let [(_, text), .., (_, document)] = forms;
        self.texts.push(text);
        let scores: Vec<Value> = serde_json::from_str(&document)?;
        let trainings = made.trainings.iter().map(|rows| in_json(rows, judges));
        let trainings: Vec<Vec<Value>> = trainings.collect::<anyhow::Result<_>>()?;
        let shows = |table: &Table, score: &Value| {
            let mut columns = table.columns.iter();
            score["task"] == *table.task
                && columns.any(|column| score["metric"] == *column.metric.name)
        };
        let is_shown = |score: &Value| made.tables.iter().any(|table| shows(table, score));
        self.record((&made.name, &[]), &scores, &trainings, is_shown)?;
        self.document.tables.push((made.name.clone(), scores));
        if !trainings.is_empty() {
            self.document.trainings.push((made.name.clone(), trainings));
        }
        Ok(())
    }

    /// Writes the drawings and numbers of a figure, and puts it on the page.
    fn add_figure(&mut self, mut figure: FigureMade, page: &mut Report) -> anyhow::Result<()> {
        for (name, chart) in std::mem::take(&mut figure.charts) {
            let drawing = write_drawing(self.out, &name, &chart.svg())?;
            self.texts.push(drawing.display().to_string());
            figure.drawings.push(drawing);
            page.figures.push(chart);
        }
        let notes = figure.notes.iter().map(|note| format!("\n{note}\n"));
        let page = figure.grid.markdown() + &notes.collect::<String>();
        for (extension, text) in [("md", page), ("csv", figure.grid.csv())] {
            let table = format!("{}.{extension}", file_name(&figure.name));
            write(&self.out.join("tables").join(table), text.as_bytes())?;
        }
        self.record_points(&figure)?;
        self.document.figures.push(figure);
        Ok(())
    }

    /// Records the scores that a figure shows: those of its metrics and tasks, for the system whose settings change.
    fn record_points(&mut self, figure: &FigureMade) -> anyhow::Result<()> {
        let [metrics, tasks] = &figure.shows;
        for point in &figure.points {
            let is = |score: &Value, key: &str, names: &[String]| {
                names.iter().any(|name| score[key] == *name)
            };
            // With one kind of edit there is no row over all tasks.
            let all = [ALL_TASKS.to_owned()];
            let alone = *tasks == all && !point.scores.iter().any(|score| is(score, "task", &all));
            let is_shown = |score: &Value| {
                let given = [REAL_DATA, IDENTITY, NOISE_FLOOR];
                is(score, "metric", metrics)
                    && (alone && !is_pooled(score["task"].as_str().unwrap_or_default())
                        || is(score, "task", tasks))
                    && !given.iter().any(|name| score["system"] == **name)
            };
            let place = (figure.name.as_str(), point.values.as_slice());
            self.record(place, &point.scores, &point.trainings, is_shown)?;
        }
        Ok(())
    }

    /// Adds the shown scores of a table, or of one point of a figure, to `record.jsonl`, with those of each training.
    fn record(
        &mut self,
        (shown_in, at): (&str, &[Value]),
        scores: &[Value],
        trainings: &[Vec<Value>],
        is_shown: impl Fn(&Value) -> bool,
    ) -> serde_json::Result<()> {
        for score in scores.iter().filter(|score| is_shown(score)) {
            let [task, system, metric] = ["task", "system", "metric"].map(|key| &score[key]);
            let is_same = |row: &&Value| {
                (&row["task"], &row["system"], &row["metric"]) == (task, system, metric)
            };
            let line = Line {
                shown_in,
                at,
                task,
                system,
                metric,
                mean: &score["mean"],
                ci95: &score["ci95"],
                trainings: trainings
                    .iter()
                    .filter_map(|rows| rows.iter().find(is_same))
                    .map(|row| &row["mean"])
                    .collect(),
            };
            serde_json::to_writer(&mut self.record, &line)?;
            self.record.push(b'\n');
        }
        Ok(())
    }
}

/// A line of `record.jsonl`: a score that a table or figure shows. The file is small enough to be stored beside a
/// document that quotes it, so that a test can compare the two (`eval/RESULTS.md`, `tests/it/evidence.rs`).
#[derive(Serialize)]
struct Line<'a> {
    /// The table or figure that shows the value.
    shown_in: &'a str,
    /// Values of the settings at the point of a figure.
    #[serde(skip_serializing_if = "<[Value]>::is_empty")]
    at: &'a [Value],
    task: &'a Value,
    system: &'a Value,
    metric: &'a Value,
    mean: &'a Value,
    #[serde(skip_serializing_if = "Value::is_null")]
    ci95: &'a Value,
    /// Scores of each training, if there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    trainings: Vec<&'a Value>,
}
