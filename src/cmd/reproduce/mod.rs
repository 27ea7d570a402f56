//! `stance reproduce`

mod made;
mod pictures;
mod plan;
mod record;
mod work;

use std::path::{Path, PathBuf};

use anyhow::Context;
use datasets_spec::record::ScoreRow;
use eval::answers::Scores;
use eval::draw::raster::png;
use eval::format;
use eval::format::grid::Grid;
use eval::judge::Judges;
use eval::names::{ALL_TASKS, IDENTITY, NOISE_FLOOR, REAL_DATA, is_pooled};
use eval::protocol::Protocol;
use eval::report::{Chart, Report};
use eval::score::over_trainings;
use eval::table::Table;
use eval::times::{self, WindowTimes};
use serde::Serialize;
use serde_json::Value;

use self::made::TableMade;
use self::plan::{FigureSpecs, PaperTable, Plan, Trained};
use self::record::Record;
use self::work::{Work, write};
use crate::cmd::eval::result_tables;
use crate::cmd::page;
use crate::evaluators::WeakJudgeArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::report;
use crate::session::{is_stopped, stopped};
use crate::settings;
use crate::trainings::TrainingsArgs;

/// Reproduce tables and figures of a plan: train what is missing, edit, score, draw.
///
/// The plan is a TOML file, or the name of one of the plans of the program (--list). It names a dataset,
/// the systems that are rows of the tables, the tables, and the figures: settings of a system that change.
/// Trainings, edits and scores that several of them need are made once. Interrupted and run again, it goes
/// on where it stopped.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The plan: a file, or the name of a plan of the program
    #[arg(required_unless_present = "list")]
    plan: Option<PathBuf>,
    /// List the plans of the program
    #[arg(long)]
    list: bool,
    /// Dataset in place of the plan's
    #[arg(long)]
    dataset: Option<PathBuf>,
    /// Folder for the results in place of the plan's
    #[arg(long, value_parser = crate::local::path())]
    out: Option<PathBuf>,
    /// Print the published rows of the paper as well, marked as published
    #[arg(long)]
    published: bool,
    /// Check the plan, and list its systems and points without running them
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    weak_judge: WeakJudgeArgs,
    #[command(flatten)]
    trainings: TrainingsArgs,
}

/// The plans of the program: those of the paper's size, and those for two processor cores.
macro_rules! plans {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../../eval/plans/", $name, ".toml")))),*]
    };
}

const PLANS: &[(&str, &str)] = plans![
    "paper/table-1",
    "paper/table-2",
    "paper/table-a1",
    "paper/table-a2",
    "paper/table-a3",
    "paper/table-a4",
    "paper/figure-6",
    "paper/figure-a1",
    "small/table-1",
    "small/table-2",
    "small/table-a1",
    "small/table-a2",
    "small/table-a3",
    "small/table-a4",
    "small/figure-6",
    "small/figure-a1",
    "small/additions",
    "real-small",
    "real-small-choices",
    "real-small-text",
    "real-few",
];

/// Items in the viewer of the page.
const SHOWN_ITEMS: usize = 12;

/// Pixels of a drawing for each of its own.
const PNG_ZOOM: f32 = 2.0;

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let Some(path) = args.plan.as_deref().filter(|_| !args.list) else {
        let names: Vec<&str> = PLANS.iter().map(|(name, _)| *name).collect();
        match global.json {
            true => report::json(&names)?,
            false => report::text(&names.join("\n")),
        }
        return Ok(Exit::Done);
    };
    args.trainings.choose()?;
    let plan = read(args, path)?;
    let at = |error| settings::at(path, error);
    let systems = plan.trained(global).map_err(at)?;
    let figures = plan.figure_specs(global).map_err(at)?;
    plan.check_tasks()?;
    if args.dry_run {
        list(&systems, &figures, global)?;
        return Ok(Exit::Done);
    }
    let Some(work) = Work::begin(&plan, global)? else {
        return Ok(stopped());
    };
    let at_once = args.trainings.at_once(plan.preset);
    if at_once > 1 {
        let of_figures = figures.iter().flat_map(|figure| &figure.trained);
        let specs = systems
            .iter()
            .chain(of_figures)
            .flat_map(|trained| &trained.specs);
        if work.train_ahead(specs, at_once)?.is_none() {
            return Ok(stopped());
        }
    }
    let mut done = Done::default();
    for (place, system) in systems.iter().enumerate() {
        let name = &system.name;
        report::note(&format!(
            "system {} of {}: {name}",
            place + 1,
            systems.len()
        ));
        match edits(system, &work) {
            Ok(Some(edits)) => done.edits.push((name.clone(), edits)),
            Ok(None) => return Ok(stopped()),
            Err(error) => done.fail(name, error)?,
        }
    }
    for table in &plan.tables {
        let made = tables(table, args.published, &plan, &work, &done, global);
        match made {
            Ok(made) => done.tables.extend(made),
            Err(error) => done.fail(&format!("table {}", table.paper.name()), error)?,
        }
    }
    for figure in &figures {
        match drawn(figure, &plan, &work, &mut done, global)? {
            Some(made) => done.figures.push(made),
            None => return Ok(stopped()),
        }
    }
    for picture in &plan.pictures {
        let systems = plan.systems_named(&picture.systems);
        match pictures::draw(picture, &systems, &done.edits, &plan.out) {
            Ok(drawing) => done.pictures.push(drawing),
            Err(error) => done.fail(&format!("picture {}", picture.name), error)?,
        }
    }
    finish(args, path, &plan, &work, done, global)
}

fn read(args: &Args, path: &Path) -> anyhow::Result<Plan> {
    let (dataset, out) = (args.dataset.as_deref(), args.out.as_deref());
    let own = PLANS.iter().find(|(name, _)| path == Path::new(name));
    match own.filter(|_| !path.exists()) {
        // Their paths are relative to the folder in which the command runs.
        Some((_, text)) => Plan::read(text, Path::new("plan.toml"), dataset, out),
        None => {
            let text = std::fs::read_to_string(path).with_context(|| {
                format!(
                    "cannot read {}; --list names the plans of the program",
                    path.display()
                )
            })?;
            Plan::read(&text, path, dataset, out)
        }
    }
}

fn list(systems: &[Trained], figures: &[FigureSpecs<'_>], global: &Global) -> anyhow::Result<()> {
    let trainings = |trained: &Trained| match trained.specs.len() {
        1 => String::new(),
        count => format!(" ({count} trainings)"),
    };
    let mut lines: Vec<String> = systems
        .iter()
        .map(|system| format!("{}{}", system.name, trainings(system)))
        .collect();
    for figure in figures {
        let name = &figure.figure.name;
        let points = std::iter::zip(&figure.points, &figure.trained);
        lines.extend(
            points
                .map(|(point, trained)| format!("{name}: {}{}", point.name(), trainings(trained))),
        );
    }
    match global.json {
        true => report::json(&lines)?,
        false => report::text(&lines.join("\n")),
    }
    Ok(())
}

/// What has been made of a plan.
#[derive(Default)]
struct Done {
    /// For each system its name, and a folder of edits for each of its trainings.
    edits: Vec<(String, Vec<PathBuf>)>,
    tables: Vec<TableMade>,
    figures: Vec<FigureMade>,
    /// Drawings of the pictures.
    pictures: Vec<PathBuf>,
    failed: Vec<String>,
}

impl Done {
    /// Reports a part that failed. An interrupt or a lock ends the command; the other parts go on after any
    /// other failure.
    fn fail(&mut self, part: &str, error: anyhow::Error) -> anyhow::Result<()> {
        if Exit::of_error(&error) != Exit::Failed {
            return Err(error.context(part.to_owned()));
        }
        report::error(&error.context(part.to_owned()));
        self.failed.push(part.to_owned());
        Ok(())
    }
}

/// Edits of all trainings of a system. None if an interrupt ended it.
fn edits(system: &Trained, work: &Work<'_>) -> anyhow::Result<Option<Vec<PathBuf>>> {
    system.specs.iter().map(|spec| work.edits(spec)).collect()
}

/// Scores of systems, some of which were trained several times.
struct Scored {
    /// Means over the trainings.
    scores: Scores,
    /// Rows of each training.
    trainings: Vec<Vec<ScoreRow>>,
    /// Items that are too short to be scored.
    left_out: usize,
}

/// Scores systems, each given by a folder of edits for each of its trainings, and averages over the trainings. Items
/// are left out if their source has fewer than `min_frames` frames at the model's rate.
fn scored(
    systems: &[&[PathBuf]],
    min_frames: Option<usize>,
    protocol: &Protocol,
    work: &Work<'_>,
) -> anyhow::Result<Scored> {
    let count = systems.iter().map(|edits| edits.len()).max().unwrap_or(0);
    let mut all = Scored {
        scores: Scores {
            rows: Vec::new(),
            judges: Judges::new(),
            comparisons: Vec::new(),
        },
        trainings: Vec::with_capacity(count),
        left_out: 0,
    };
    for training in 0..count {
        let edits = systems.iter().filter_map(|edits| edits.get(training));
        let edits: Vec<PathBuf> = edits.cloned().collect();
        let (answered, left_out) = work.answered(&edits, min_frames)?;
        all.left_out = left_out;
        let scores = work.scores(&answered, &edits, protocol)?;
        all.scores.judges = scores.judges;
        all.trainings.push(scores.rows);
    }
    all.scores.rows = over_trainings(&all.trainings);
    Ok(all)
}

/// A figure.
struct FigureMade {
    name: String,
    charts: Vec<(String, Chart)>,
    /// Names of the metrics and tasks that it shows.
    shows: [Vec<String>; 2],
    /// Its numbers.
    grid: Grid,
    points: Vec<PointMade>,
    /// Items that are too short for some point.
    left_out: usize,
}

#[derive(Serialize)]
struct PointMade {
    point: String,
    values: Vec<Value>,
    scores: Vec<Value>,
    /// Scores of each training, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    trainings: Vec<Vec<Value>>,
}

fn tables(
    table: &PaperTable,
    published: bool,
    plan: &Plan,
    work: &Work<'_>,
    done: &Done,
    global: &Global,
) -> anyhow::Result<Option<TableMade>> {
    let wanted = plan.systems_of(table);
    let rows = |name: &&str| done.edits.iter().find(|(system, _)| system == name);
    let found: Vec<&(String, Vec<PathBuf>)> = wanted.iter().filter_map(rows).collect();
    if found.is_empty() {
        return Ok(None);
    }
    let published = published || table.published;
    let name = format!("table-{}", table.paper.name());
    let Some(paper) = table.paper.scored() else {
        let mut rows: Vec<(String, WindowTimes)> = found
            .into_iter()
            .map(|(system, edits)| Ok((system.clone(), WindowTimes::read(&edits[0])?)))
            .collect::<anyhow::Result<_>>()?;
        if published {
            rows.extend(times::published());
        }
        return Ok(Some(TableMade {
            name,
            tables: Vec::new(),
            scores: Vec::new(),
            trainings: Vec::new(),
            grids: times::tables(&rows),
            unranked: None,
        }));
    };
    let edits: Vec<&[PathBuf]> = found.iter().map(|(_, edits)| edits.as_slice()).collect();
    let protocol = plan.protocol(Some(table.paper), global);
    let Scored {
        scores, trainings, ..
    } = scored(&edits, None, &protocol, work)?;
    let mut tables = result_tables(&scores, table.paper, paper);
    for laid_out in &mut tables {
        laid_out.sort_systems(&wanted);
        laid_out.notes.extend(note_of_trainings(&found));
        if published {
            laid_out.append_published(paper);
        }
    }
    Ok(Some(TableMade {
        unranked: scores.unranked(),
        name,
        tables,
        scores: scores.rows,
        trainings: several(trainings),
        grids: Vec::new(),
    }))
}

/// Scores by training, where there are several.
fn several(trainings: Vec<Vec<ScoreRow>>) -> Vec<Vec<ScoreRow>> {
    if trainings.len() > 1 {
        trainings
    } else {
        Vec::new()
    }
}

/// A sentence on the rows that are means over trainings.
fn note_of_trainings(systems: &[&(String, Vec<PathBuf>)]) -> Option<String> {
    let most = systems.iter().map(|(_, edits)| edits.len()).max()?;
    let once: Vec<&str> = systems
        .iter()
        .filter(|(_, edits)| edits.len() < most)
        .map(|(name, _)| name.as_str())
        .collect();
    let fewer = match once.is_empty() {
        true => String::new(),
        false => format!(", fewer for {}", once.join(", ")),
    };
    (most > 1).then(|| {
        format!("Means over {most} trainings of each system{fewer}; intervals are over items and trainings.")
    })
}

/// Makes the points of a figure, and draws it. None if an interrupt ended it.
fn drawn(
    specs: &FigureSpecs<'_>,
    plan: &Plan,
    work: &Work<'_>,
    done: &mut Done,
    global: &Global,
) -> anyhow::Result<Option<FigureMade>> {
    let protocol = plan.protocol(None, global);
    let figure = specs.figure;
    let mut rows_at = Vec::with_capacity(specs.points.len());
    let mut trainings_at = Vec::with_capacity(specs.points.len());
    let mut left_out = 0;
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
        let at_point = || -> anyhow::Result<Option<Scored>> {
            let Some(edits) = edits(trained, work)? else {
                return Ok(None);
            };
            scored(&[&edits], specs.min_frames, &protocol, work).map(Some)
        };
        match at_point() {
            Ok(Some(scored)) => {
                left_out = scored.left_out;
                rows_at.push(scored.scores.rows);
                trainings_at.push(several(scored.trainings));
            }
            Ok(None) => return Ok(None),
            Err(error) => {
                done.fail(name, error)?;
                rows_at.push(Vec::new());
                trainings_at.push(Vec::new());
            }
        }
    }
    if left_out > 0 {
        report::note(&format!(
            "{}: {left_out} items are shorter than the longest window and count at no point",
            figure.name
        ));
    }
    let mut charts = Vec::new();
    for &task in &specs.tasks {
        if left_out > 0 && !rows_at.iter().flatten().any(|row| row.task == task) {
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
            charts.push((name, figure.chart(metric, task, &specs.points, &rows_at)));
        }
    }
    let grid = figure.grid(&specs.metrics, &specs.tasks, &specs.points, &rows_at);
    let points = std::iter::zip(&specs.points, std::iter::zip(rows_at, trainings_at))
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
        .collect::<anyhow::Result<_>>()?;
    Ok(Some(FigureMade {
        name: figure.name.clone(),
        shows: [
            specs
                .metrics
                .iter()
                .map(|metric| metric.name.to_owned())
                .collect(),
            specs.tasks.iter().map(|&task| task.to_owned()).collect(),
        ],
        charts,
        grid,
        points,
        left_out,
    }))
}

/// Scores as `stance eval --json` prints them.
fn in_json(rows: &[ScoreRow], judges: &Judges) -> anyhow::Result<Vec<Value>> {
    Ok(serde_json::from_str(&format::json::render(rows, judges)?)?)
}

/// Why figures compare nothing.
fn weakness_of(judges: &Judges) -> Option<String> {
    let weakness = judges.values().find_map(|judge| judge.weakness.as_ref())?;
    Some(format!(
        "The figures compare nothing. The encoder is too weak to judge: {weakness}."
    ))
}

fn file_name(text: &str) -> String {
    let name: String = text
        .chars()
        .map(|c| if c.is_alphanumeric() { c } else { '-' })
        .collect();
    name.to_lowercase()
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

/// Writes tables, figures and the page, and prints the tables.
fn finish(
    args: &Args,
    path: &Path,
    plan: &Plan,
    work: &Work<'_>,
    done: Done,
    global: &Global,
) -> anyhow::Result<Exit> {
    let out = &plan.out;
    let mut texts = Vec::new();
    let mut document = Document {
        page: out.join("index.html"),
        tables: Vec::new(),
        trainings: Vec::new(),
        figures: Vec::new(),
        pictures: done.pictures.clone(),
        failed: done.failed.clone(),
    };
    let judges = &work.judges();
    let mut record = Record::default();
    for made in &done.tables {
        let forms = made.forms(judges)?;
        for (extension, text) in &forms {
            write(
                &out.join("tables")
                    .join(format!("{}.{extension}", made.name)),
                text.as_bytes(),
            )?;
        }
        texts.push(forms[0].1.clone());
        document
            .tables
            .push((made.name.clone(), made.document(judges)?));
        let trainings = made.trainings.iter().map(|rows| in_json(rows, judges));
        let trainings: Vec<Vec<Value>> = trainings.collect::<anyhow::Result<_>>()?;
        let shows = |table: &Table, score: &Value| {
            let mut columns = table.columns.iter();
            score["task"] == *table.task
                && columns.any(|column| score["metric"] == *column.metric.name)
        };
        let scores = in_json(&made.scores, judges)?;
        record.add((&made.name, &[]), &scores, &trainings, |score| {
            made.tables.iter().any(|table| shows(table, score))
        })?;
        if !trainings.is_empty() {
            document.trainings.push((made.name.clone(), trainings));
        }
    }
    let of_tables = done.tables.iter().find_map(|made| made.unranked.clone());
    let unranked = of_tables.or_else(|| weakness_of(judges));
    // The page plays the edits of one training of each system.
    let first = |(_, edits): &(String, Vec<PathBuf>)| edits[0].clone();
    let folders: Vec<PathBuf> = done.edits.iter().map(first).collect();
    let all: Vec<Table> = done
        .tables
        .iter()
        .flat_map(|made| made.tables.clone())
        .collect();
    let (answered, _) = work.answered(&folders, None)?;
    let mut page: Report = match folders.is_empty() {
        true => Report::default(),
        false => page::of_edits(&answered, &folders, all, SHOWN_ITEMS, global)?,
    };
    for figure in done.figures {
        let mut drawings = Vec::new();
        for (name, chart) in figure.charts {
            let svg = chart.svg();
            let drawing = out.join("figures").join(format!("{name}.svg"));
            write(&drawing, svg.as_bytes())?;
            write(&drawing.with_extension("png"), &png(&svg, PNG_ZOOM)?)?;
            drawings.push(drawing);
            page.figures.push(chart);
        }
        texts.extend(drawings.iter().map(|drawing| drawing.display().to_string()));
        for (extension, text) in [("md", figure.grid.markdown()), ("csv", figure.grid.csv())] {
            let table = format!("{}.{extension}", file_name(&figure.name));
            write(&out.join("tables").join(table), text.as_bytes())?;
        }
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
            record.add(place, &point.scores, &point.trainings, is_shown)?;
        }
        document.figures.push(FigureDocument {
            name: figure.name,
            drawings,
            left_out: figure.left_out,
            points: figure.points,
        });
    }
    texts.extend(
        done.pictures
            .iter()
            .map(|drawing| drawing.display().to_string()),
    );
    page.title.clone_from(&plan.title);
    page.commands = vec![command(args, path, global)];
    write(&document.page, page.to_html().as_bytes())?;
    write(
        &out.join("results.json"),
        &serde_json::to_vec_pretty(&document)?,
    )?;
    write(&out.join("record.jsonl"), &record.into_bytes())?;
    match global.json {
        true => report::json(&document)?,
        false => {
            texts.push(document.page.display().to_string());
            report::text(&texts.join("\n"));
        }
    }
    if done.failed.is_empty() {
        return Ok(args.weak_judge.exit(unranked, Exit::Done));
    }
    report::note(&format!(
        "failed and missing: {}; the rest is written, and the same command tries these again",
        done.failed.join("; ")
    ));
    Ok(Exit::Failed)
}

fn command(args: &Args, path: &Path, global: &Global) -> String {
    let option = |name: &str, value: &Option<PathBuf>| match value {
        Some(value) => format!(" {name} {}", value.display()),
        None => String::new(),
    };
    format!(
        "stance reproduce {}{}{}{}",
        path.display(),
        option("--dataset", &args.dataset),
        option("--out", &args.out),
        global.seed_option()
    )
}
