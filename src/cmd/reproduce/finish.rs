//! Final output of `stance reproduce`: files of tables and figures, the page, and the printed text.

use std::path::{Path, PathBuf};

use eval::judge::Judges;
use eval::names::{ALL_TASKS, IDENTITY, NOISE_FLOOR, REAL_DATA, is_pooled};
use eval::report::Report;
use eval::table::Table;
use serde::Serialize;
use serde_json::Value;

use super::failed::Failed;
use super::figures::{FigureMade, PointMade};
use super::files::{file_name, write, write_drawing};
use super::made::TableMade;
use super::plan::Plan;
use super::record::Record;
use super::scores::in_json;
use super::work::Work;
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
#[derive(Serialize)]
struct Document {
    page: PathBuf,
    tables: Vec<(String, Value)>,
    /// Scores of each training, for tables whose systems were trained several times.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    trainings: Vec<(String, Vec<Vec<Value>>)>,
    figures: Vec<FigureDocument>,
    pictures: Vec<PathBuf>,
    failed: Vec<String>,
}

#[derive(Serialize)]
struct FigureDocument {
    name: String,
    drawings: Vec<PathBuf>,
    left_out: usize,
    points: Vec<PointMade>,
}

/// Writes tables, figures and the page, which names the `command`, and prints the tables.
pub(super) fn finish(
    plan: &Plan,
    work: &Work<'_>,
    done: Done,
    command: String,
    weak_judge: WeakJudgeArgs,
    global: &Global,
) -> anyhow::Result<Exit> {
    let out = &plan.out;
    let judges = &work.judges();
    let mut results = Results::new(out, &done);
    for made in &done.tables {
        results.add_table(made, judges)?;
    }
    let of_tables = done.tables.iter().find_map(|made| made.unranked.clone());
    let unranked = of_tables.or_else(|| weakness_of(judges));
    let mut page = page_of(work, &done, global)?;
    for figure in done.figures {
        results.add_figure(figure, &mut page)?;
    }
    let Results {
        mut texts,
        document,
        record,
        ..
    } = results;
    texts.extend(
        done.pictures
            .iter()
            .map(|drawing| drawing.display().to_string()),
    );
    page.title.clone_from(&plan.title);
    page.commands = vec![command];
    write(&document.page, page.to_html().as_bytes())?;
    write(
        &out.join("results.json"),
        &serde_json::to_vec_pretty(&document)?,
    )?;
    write(&out.join("record.jsonl"), &record.into_bytes())?;
    texts.push(document.page.display().to_string());
    global.say(&document, &texts.join("\n"))?;
    let Failed(failed) = done.failed;
    if failed.is_empty() {
        return Ok(weak_judge.exit(unranked, Exit::Done));
    }
    report::note(&format!(
        "failed and missing: {}; the rest is written, and the same command tries these again",
        failed.join("; ")
    ));
    Ok(Exit::Failed)
}

/// Reason why the figures cannot compare systems.
fn weakness_of(judges: &Judges) -> Option<String> {
    let weakness = judges.values().find_map(|judge| judge.weakness.as_ref())?;
    Some(format!(
        "The figures compare nothing. The encoder is too weak to judge: {weakness}."
    ))
}

/// The page of a plan, without its figures. It plays the edits of one training of each system.
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

/// Collects results as they are written one after the other.
struct Results<'a> {
    out: &'a Path,
    /// Printed texts.
    texts: Vec<String>,
    document: Document,
    record: Record,
}

impl<'a> Results<'a> {
    fn new(out: &'a Path, done: &Done) -> Self {
        Self {
            out,
            texts: Vec::new(),
            document: Document {
                page: out.join("index.html"),
                tables: Vec::new(),
                trainings: Vec::new(),
                figures: Vec::new(),
                pictures: done.pictures.clone(),
                failed: done.failed.0.clone(),
            },
            record: Record::default(),
        }
    }

    /// Writes a table in each of its forms.
    fn add_table(&mut self, made: &TableMade, judges: &Judges) -> anyhow::Result<()> {
        let forms = made.forms(judges)?;
        for (extension, text) in &forms {
            let name = format!("{}.{extension}", made.name);
            write(&self.out.join("tables").join(name), text.as_bytes())?;
        }
        self.texts.push(forms[0].1.clone());
        let document = made.document(judges)?;
        self.document.tables.push((made.name.clone(), document));
        let trainings = made.trainings.iter().map(|rows| in_json(rows, judges));
        let trainings: Vec<Vec<Value>> = trainings.collect::<anyhow::Result<_>>()?;
        let shows = |table: &Table, score: &Value| {
            let mut columns = table.columns.iter();
            score["task"] == *table.task
                && columns.any(|column| score["metric"] == *column.metric.name)
        };
        let scores = in_json(&made.scores, judges)?;
        let is_shown = |score: &Value| made.tables.iter().any(|table| shows(table, score));
        self.record
            .add((&made.name, &[]), &scores, &trainings, is_shown)?;
        if !trainings.is_empty() {
            self.document.trainings.push((made.name.clone(), trainings));
        }
        Ok(())
    }

    /// Writes the drawings and numbers of a figure, and puts it on the page.
    fn add_figure(&mut self, mut figure: FigureMade, page: &mut Report) -> anyhow::Result<()> {
        let mut drawings = Vec::new();
        for (name, chart) in std::mem::take(&mut figure.charts) {
            let drawing = self.out.join("figures").join(format!("{name}.svg"));
            write_drawing(&drawing, &chart.svg())?;
            drawings.push(drawing);
            page.figures.push(chart);
        }
        self.texts
            .extend(drawings.iter().map(|drawing| drawing.display().to_string()));
        for (extension, text) in [("md", figure.grid.markdown()), ("csv", figure.grid.csv())] {
            let table = format!("{}.{extension}", file_name(&figure.name));
            write(&self.out.join("tables").join(table), text.as_bytes())?;
        }
        self.record_points(&figure)?;
        self.document.figures.push(FigureDocument {
            name: figure.name,
            drawings,
            left_out: figure.left_out,
            points: figure.points,
        });
        Ok(())
    }

    /// Records the scores that a figure shows: of its metrics and tasks, for the system whose setting changes.
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
            self.record
                .add(place, &point.scores, &point.trainings, is_shown)?;
        }
        Ok(())
    }
}
