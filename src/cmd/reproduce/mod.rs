//! `stance reproduce`

mod figures;
mod files;
mod finish;
mod made;
mod pictures;
mod plan;
mod work;

use std::path::{Path, PathBuf};

use anyhow::Context;

use self::figures::drawn;
use self::files::without_rows;
use self::finish::{Done, finish};
use self::made::tables;
use self::plan::{FigureSpecs, Plan, Trained};
use self::work::Work;
use crate::evaluators::WeakJudgeArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::trainings::TrainingsArgs;
use crate::{report, settings};

/// Reproduce tables and figures of a plan: train what is missing, edit, score, draw.
///
/// The plan is a TOML file, or the name of a built-in plan (--list). It names a dataset, the systems that are rows of
/// the tables, the tables, and the figures, which vary settings of a system. Trainings, edits and scores that several
/// tables or figures need are made once. Run again after an interruption, it continues where it stopped.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The plan: a file, or the name of a built-in plan
    #[arg(required_unless_present = "list")]
    plan: Option<PathBuf>,
    /// List the built-in plans
    #[arg(long)]
    list: bool,
    /// Dataset to use instead of the plan's
    #[arg(long)]
    dataset: Option<PathBuf>,
    /// Folder for the results, instead of the plan's
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

/// The built-in plans: those of the paper's size, and those for two processor cores.
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
    "wording",
];

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let Some(path) = args.plan.as_deref().filter(|_| !args.list) else {
        let names: Vec<&str> = PLANS.iter().map(|(name, _)| *name).collect();
        return global.say(&names, &names.join("\n"));
    };
    args.trainings.device.choose()?;
    let plan = read(args, path)?;
    let at = |error| settings::at(path, error);
    let systems = plan.trained(global).map_err(at)?;
    let figures = plan.figure_specs(global).map_err(at)?;
    plan.check_tasks()?;
    if args.dry_run {
        return list(&systems, &figures, global);
    }
    let work = Work::begin(&plan, global)?;
    let at_once = args.trainings.at_once(plan.preset);
    if at_once > 1 {
        let of_figures = figures.iter().flat_map(|figure| &figure.trained);
        let all = systems.iter().chain(of_figures);
        work.train_ahead(all.flat_map(|trained| &trained.specs), at_once)?;
    }
    let mut done = Done::default();
    for (place, system) in systems.iter().enumerate() {
        let (count, name) = (systems.len(), &system.name);
        report::note(&format!("system {} of {count}: {name}", place + 1));
        match work.edits_of(system) {
            Ok(edits) => done.edits.push((name.clone(), edits)),
            Err(error) => done.failed.add(name, error)?,
        }
    }
    for table in &plan.tables {
        match tables(table, args.published, &plan, &work, &done.edits, global) {
            Ok(Some(made)) => done.tables.push(made),
            Ok(None) => done.failed.0.push(without_rows(table.paper, &plan.out)),
            Err(error) => done
                .failed
                .add(&format!("table {}", table.paper.name()), error)?,
        }
    }
    for figure in &figures {
        let made = drawn(figure, &plan, &work, &mut done.failed, global)?;
        done.figures.push(made);
    }
    for picture in &plan.pictures {
        let systems = plan.systems_named(&picture.systems);
        match pictures::draw(picture, &systems, &done.edits, &plan.out) {
            Ok(drawing) => done.pictures.push(drawing),
            Err(error) => done
                .failed
                .add(&format!("picture {}", picture.name), error)?,
        }
    }
    let command = command(args, path, global);
    finish(&plan, &work, done, command, args.weak_judge, global)
}

fn read(args: &Args, path: &Path) -> anyhow::Result<Plan> {
    let (dataset, out) = (args.dataset.as_deref(), args.out.as_deref());
    let own = PLANS.iter().find(|(name, _)| path == Path::new(name));
    match own.filter(|_| !path.exists()) {
        // This file name has no folder, so relative paths of the plan start from the working folder.
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

fn list(systems: &[Trained], figures: &[FigureSpecs<'_>], global: &Global) -> anyhow::Result<Exit> {
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
    global.say(&lines, &lines.join("\n"))
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
