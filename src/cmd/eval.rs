//! `stance eval`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::ValueEnum as _;
use datasets_spec::{Seed, Skeleton, Split};
use eval::answers::{Answered, Scores};
use eval::compare::{Comparison, compare};
use eval::format::{self, ABSENT};
use eval::metric::cross_retrieval::CrossRetrieval;
use eval::metric::interval::Interval;
use eval::metric::retrieval::Retrieval;
use eval::metric::{self, Part};
use eval::names::{ALL_TASKS, RECAPTURED};
use eval::protocol::{FidSample, Floor, Gallery, Keypoints, Limit, Protocol, Queries, Spread};
use eval::published::PaperTable;
use eval::table::{Table, shortages};
use eval::times::{self, WindowTimes};
use pipeline::answers::bundle::{Asked, Bundle};
use serde::Deserialize;
use serde_json::json;

use crate::device::DeviceArgs;
use crate::evaluators::{EvaluatorRuns, WeakJudgeArgs, encoder_retrieval, judge_hash};
use crate::exit::Exit;
use crate::global::{Global, Names, one_of};
use crate::{local, report, stages};

/// Score tables of edits, print the result table, or compare two systems.
///
/// Every table also has two rows for comparison: the real data, and the identity editor, which returns each original
/// unchanged. The paired differences of each system from the identity editor, and from the next system in R@1, follow
/// the main table.
#[derive(clap::Args, Debug)]
#[command(subcommand_negates_reqs = true, args_conflicts_with_subcommands = true, after_long_help = columns())]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Option<Action>,
    /// Tables of edits of the same items, as `stance edit` writes them, and bundles, as `stance edits bundle` writes
    /// them; takes with different seeds count as one system
    #[arg(required_unless_present = "items")]
    edits: Vec<PathBuf>,
    /// Items that bundles answer; without edits, only the real data and the identity editor are scored
    #[arg(long)]
    items: Option<PathBuf>,
    /// Table to print: the main one, or one of the paper
    #[arg(long, value_enum, default_value_t = TableArg::Main)]
    table: TableArg,
    /// Source of the intervals: bootstrap draws of the targets, or the repeats, as published
    #[arg(long, value_parser = one_of(INTERVALS), default_value = "targets")]
    interval: Spread,
    /// Print further columns that the paper lacks: median ranks, raw FID, multimodality, errors and
    /// motion quality
    #[arg(long)]
    further: bool,
    /// Print the published rows of the paper as well, marked as published
    #[arg(long)]
    published: bool,
    /// Folder to commit the scores to
    #[arg(long)]
    out: Option<PathBuf>,
    #[command(flatten)]
    measure: Measure,
}

fn columns() -> String {
    let columns = metric::ALL.iter().map(|metric| {
        let arrow = (metric.better)(ALL_TASKS).arrow();
        format!("\n  {metric} {arrow}\n          {}", metric.about)
    });
    let title = "Columns (↓ lower, ↑ higher, → closer to the real data is better):".to_owned();
    title + &columns.collect::<String>()
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    Compare(CompareArgs),
    Encoder(EncoderArgs),
}

/// Measure how well an encoder's texts and motions retrieve each other: whether it is suitable for evaluation.
///
/// Motions with equal captions count as correct for each other.
#[derive(clap::Args, Debug)]
struct EncoderArgs {
    /// Dataset with captions
    dataset: PathBuf,
    /// Split to evaluate on
    #[arg(long, default_value = "test")]
    split: Split,
    #[command(flatten)]
    ranking: Ranking,
}

/// Compare two systems item by item, with bootstrap intervals of their differences.
#[derive(clap::Args, Debug)]
struct CompareArgs {
    /// Table of edits of the first system
    a: PathBuf,
    /// Table of edits of the second, of the same items
    b: PathBuf,
    #[command(flatten)]
    measure: Measure,
}

/// The encoder, and how it ranks.
#[derive(clap::Args, Debug)]
struct Ranking {
    /// Run folder of the encoder, or `builtin`; not needed for Table A4
    #[arg(long, value_name = "RUN")]
    encoder: Option<PathBuf>,
    /// Output format; --json prints the scores
    #[arg(long, value_enum, default_value_t = FormatArg::Text)]
    format: FormatArg,
    /// Rank among all items instead of the table's galleries
    #[arg(long, conflicts_with = "gallery")]
    full_gallery: bool,
    /// Number of items in a gallery, instead of the table's
    #[arg(long, value_name = "N")]
    gallery: Option<usize>,
    /// Number of evaluations to average
    #[arg(long, default_value_t = Protocol::default().repeats)]
    repeats: usize,
    #[command(flatten)]
    device: DeviceArgs,
}

impl Ranking {
    fn format(&self, global: &Global) -> FormatArg {
        match global.json {
            true => FormatArg::Json,
            false => self.format,
        }
    }

    fn protocol(&self, table: Option<PaperTable>, global: &Global) -> Protocol {
        let default = Protocol::default();
        Protocol {
            gallery: match (self.full_gallery, self.gallery, table) {
                (true, ..) => Gallery::Full,
                (false, Some(size), _) => Gallery::Batches(size),
                (false, None, Some(table)) => table.gallery(),
                (false, None, None) => default.gallery,
            },
            repeats: self.repeats,
            seed: global.seed(),
            ..default
        }
    }

    fn encoder(&self) -> anyhow::Result<&Path> {
        self.device.choose()?;
        let encoder = self.encoder.as_deref();
        encoder.context(
            "name the encoder to compare motions with: --encoder RUN, of `stance train tmr`, or --encoder builtin",
        )
    }
}

/// Models and settings of the evaluation.
#[derive(clap::Args, Debug)]
struct Measure {
    #[command(flatten)]
    ranking: Ranking,
    /// Run folder of a coordinator, to also measure the share of each system's windows it classifies as composed
    #[arg(long, value_name = "RUN")]
    coordinator: Option<PathBuf>,
    /// Use edited motions as queries and real ones as the gallery (the paper's text; its code, and the
    /// default here, do the opposite)
    #[arg(long)]
    transpose: bool,
    /// Truncate edited motions to the length of their target, as the MotionFix evaluation does
    #[arg(long)]
    truncate: bool,
    /// Compare whole sets by FID instead of random halves
    #[arg(long)]
    fid_all: bool,
    /// Score this many items, drawn at random: 506 of MotionFix's 1,013 are the half that the code of
    /// later systems scores
    #[arg(long, value_name = "N")]
    items_limit: Option<usize>,
    /// Seed of the random draws
    #[arg(
        long,
        value_name = "SEED",
        default_value_t = 42,
        requires = "items_limit"
    )]
    items_seed: u64,
    /// Keypoints of the position error: 28, or the 22 body joints that the paper uses on MotionFix
    #[arg(long, default_value = "28", value_parser = parse_keypoints)]
    keypoints: Keypoints,
    /// Height of the floor in metres [default: the lowest foot of each motion]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    floor: Option<f64>,
    #[command(flatten)]
    weak_judge: WeakJudgeArgs,
}

impl Measure {
    fn protocol(&self, table: Option<PaperTable>, global: &Global) -> Protocol {
        let ranking = self.ranking.protocol(table, global);
        Protocol {
            queries: match self.transpose {
                true => Queries::Edited,
                false => Queries::Real,
            },
            truncate_to_target: self.truncate,
            fid_sample: match self.fid_all {
                true => FidSample::All,
                false => FidSample::Halves,
            },
            floor: self.floor.map_or(ranking.floor, Floor::At),
            keypoints: self.keypoints,
            limit: self.items_limit.map(|items| Limit {
                items,
                seed: Seed(self.items_seed),
            }),
            ..ranking
        }
    }

    fn runs(&self) -> anyhow::Result<EvaluatorRuns<'_>> {
        Ok(EvaluatorRuns {
            encoder: self.ranking.encoder()?,
            coordinator: self.coordinator.as_deref(),
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum FormatArg {
    Text,
    Markdown,
    Latex,
    Csv,
    Json,
}

const INTERVALS: Names<Spread> = &[
    ("targets", Spread::Targets, ""),
    ("repeats", Spread::Repeats, ""),
];

fn parse_keypoints(text: &str) -> Result<Keypoints, String> {
    [Keypoints::All, Keypoints::Body]
        .into_iter()
        .find(|keypoints| text == keypoints.count().to_string())
        .ok_or_else(|| "there are 28 and 22".to_owned())
}

/// A result table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum TableArg {
    #[value(
        name = "main",
        help = "what a claim is made of: R@1, foot slide, error inside and outside of the mask"
    )]
    Main,
    #[serde(rename = "1")]
    #[value(name = "1", help = "body part replacement and style transfer")]
    One,
    #[serde(rename = "2")]
    #[value(name = "2", help = "MotionFix, galleries of 32")]
    Two,
    #[serde(alias = "A1")]
    #[value(name = "a1", help = "fine-grained adjustment")]
    A1,
    #[serde(alias = "A2")]
    #[value(name = "a2", help = "ablations, without Diversity and FS")]
    A2,
    #[serde(alias = "A3")]
    #[value(name = "a3", help = "MotionFix, one gallery of the test set")]
    A3,
    #[serde(alias = "A4")]
    #[value(name = "a4", help = "seconds for one window")]
    A4,
}

impl TableArg {
    /// Name of the table on the command line.
    pub(crate) fn name(self) -> String {
        let value = self.to_possible_value().expect("no table is left out");
        value.get_name().to_owned()
    }

    /// The paper's table with the same protocol and published rows; none for Table A4, which has no scores.
    pub(crate) fn scored(self) -> Option<PaperTable> {
        Some(match self {
            Self::Main | Self::One => PaperTable::One,
            Self::Two => PaperTable::Two,
            Self::A1 => PaperTable::A1,
            Self::A2 => PaperTable::A2,
            Self::A3 => PaperTable::A3,
            Self::A4 => return None,
        })
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    match &args.action {
        Some(Action::Compare(args)) => return compared(args, global),
        Some(Action::Encoder(args)) => return encoder(args, global),
        None => {}
    }
    let Some(table) = args.table.scored() else {
        return timed(args, global);
    };
    let format = args.measure.ranking.format(global);
    let is_data = matches!(format, FormatArg::Json | FormatArg::Csv);
    if args.published && is_data {
        bail!("{WITHOUT_PUBLISHED}");
    }
    let protocol = Protocol {
        interval: args.interval,
        ..args.measure.protocol(Some(table), global)
    };
    if let Some(out) = &args.out {
        // Before the work.
        Scores::check_room(out)?;
    }
    let runs = args.measure.runs()?;
    let answered = answers(args, runs.encoder)?;
    let scores = stages::scores(&answered, &runs, &protocol, global)?;
    if let Some(out) = &args.out {
        commit(&scores, out, &answered.skeleton, global)?;
    }
    let text = if format == FormatArg::Json {
        format::json::render(&scores.rows, &scores.judges)?
    } else {
        let mut tables = result_tables(&scores, args.table, table);
        if args.published {
            for laid_out in &mut tables {
                laid_out.append_published(table);
            }
        }
        if args.further {
            tables.extend(further_tables(&scores));
        }
        match format {
            FormatArg::Text => format::text::render(&tables),
            FormatArg::Markdown => format::markdown::render(&tables),
            FormatArg::Latex => format::latex::render(&tables),
            FormatArg::Csv | FormatArg::Json => format::csv::render(&scores.rows, &scores.judges),
        }
    };
    report::text(&text);
    if is_data {
        for shortage in shortages(&scores.rows) {
            report::note(&shortage);
        }
    }
    let weak_judge = args.measure.weak_judge;
    Ok(weak_judge.exit(scores.unranked(), Exit::Done))
}

/// Commits scores, and says which ones they replace.
fn commit(scores: &Scores, out: &Path, skeleton: &Skeleton, global: &Global) -> anyhow::Result<()> {
    let before = Scores::held_in(out)?;
    let dataset = scores.commit(out, skeleton, &global.holder())?;
    let now = dataset.manifest().version;
    if let Some((systems, version)) = before.filter(|(_, version)| *version < now) {
        report::note(&format!(
            "{} held scores of {}; version {version} of it keeps them",
            out.display(),
            Vec::from_iter(systems).join(", ")
        ));
    }
    Ok(())
}

fn answers(args: &Args, encoder: &Path) -> anyhow::Result<Answered> {
    let is_bundle = |path: &&PathBuf| path.extension().is_some_and(|end| end == "zip");
    let (bundles, folders): (Vec<&PathBuf>, Vec<&PathBuf>) = args.edits.iter().partition(is_bundle);
    let folders: Vec<PathBuf> = args.items.iter().chain(folders).cloned().collect();
    if let (Some(first), []) = (bundles.first(), folders.as_slice()) {
        bail!(
            "{} holds no items; name those that it answers: --items ITEMS",
            first.display()
        );
    }
    let answered = Answered::read_for_table(&folders)?;
    if bundles.is_empty() {
        return Ok(answered);
    }
    let judge = judge_hash(encoder)?;
    let items = answered.items.facts().iter();
    let asked = items.map(|item| (item.id.as_str(), (item.fps, item.novelty.as_deref())));
    let asked: Asked<'_> = asked.collect();
    let mut edits = Vec::new();
    for path in bundles {
        let Bundle { facts, rows } = Bundle::read(path, &asked, &answered.skeleton)?;
        if let Some(asked) = facts.judge_hash.filter(|asked| *asked != judge) {
            bail!(
                "{}: it asks to be judged by the encoder {asked:.12}, and --encoder {} is {judge:.12}",
                path.display(),
                encoder.display()
            );
        }
        edits.extend(rows);
    }
    Ok(answered.with_edits(edits)?)
}

/// The scores as tables. `paper` is the corresponding table of the paper.
pub(crate) fn result_tables(scores: &Scores, table: TableArg, paper: PaperTable) -> Vec<Table> {
    match table {
        TableArg::Main => scores.main_tables(),
        _ => paper_tables(scores, paper),
    }
}

/// Scores in the layout of a table of the paper. If the edits have tasks of that table, only these and pooled tasks are
/// kept; otherwise all tasks are.
fn paper_tables(scores: &Scores, table: PaperTable) -> Vec<Table> {
    let mut tables = Table::from_scores(&scores.rows, &scores.judges, &table.columns());
    let (title, tasks) = (table.title(), table.tasks());
    if !tables
        .iter()
        .any(|found| tasks.contains(&found.task.as_str()))
    {
        let tasks = tasks.join(" and ");
        report::note(&format!(
            "{title} is about {tasks} edits, and there are none; these are the tasks there are"
        ));
        return tables;
    }
    let kept = [&tasks[..], &[ALL_TASKS, RECAPTURED]].concat();
    let left: Vec<String> = tables
        .extract_if(.., |found| !kept.contains(&found.task.as_str()))
        .map(|found| format!("{} ({} items)", found.task, found.items.count))
        .collect();
    if !left.is_empty() {
        report::note(&format!(
            "{title} has no table for {}; {ALL_TASKS:?} is over all items",
            left.join(", ")
        ));
    }
    tables
}

/// Refuses options that Table A4, which has no scores, would ignore.
fn refuse_unused(args: &Args) -> anyhow::Result<()> {
    let (own, usual) = (&args.measure, Protocol::default());
    for (option, is_given) in [
        ("--items", args.items.is_some()),
        ("--interval", args.interval != usual.interval),
        ("--further", args.further),
        ("--out", args.out.is_some()),
        ("--encoder", own.ranking.encoder.is_some()),
        ("--coordinator", own.coordinator.is_some()),
        ("--full-gallery", own.ranking.full_gallery),
        ("--gallery", own.ranking.gallery.is_some()),
        ("--repeats", own.ranking.repeats != usual.repeats),
        ("--transpose", own.transpose),
        ("--truncate", own.truncate),
        ("--fid-all", own.fid_all),
        ("--items-limit", own.items_limit.is_some()),
        ("--keypoints", own.keypoints != usual.keypoints),
        ("--floor", own.floor.is_some()),
        ("--weak-judge", own.weak_judge.is_given()),
    ] {
        if is_given {
            bail!("Table A4 makes no use of {option}; print it without");
        }
    }
    Ok(())
}

const WITHOUT_PUBLISHED: &str =
    "scores as JSON or CSV make no use of --published; print them without";

/// Prints Table A4.
fn timed(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    refuse_unused(args)?;
    let format = args.measure.ranking.format(global);
    if args.published && matches!(format, FormatArg::Json | FormatArg::Csv) {
        bail!("{WITHOUT_PUBLISHED}");
    }
    let names = local::names_of(&args.edits).into_iter();
    let mut rows: Vec<(String, WindowTimes)> = names
        .zip(&args.edits)
        .map(|(name, path)| Ok((name, WindowTimes::read(path)?)))
        .collect::<anyhow::Result<_>>()?;
    rows.retain(|(name, times)| {
        if !times.is_known() {
            report::note(&format!(
                "{name} has no times: its system generates no windows"
            ));
        }
        times.is_known()
    });
    if args.published {
        rows.extend(times::published());
    }
    if args.measure.ranking.format(global) == FormatArg::Json {
        let row = |(name, times): &(String, WindowTimes)| {
            json!({
                "name": name,
                "window": times.window,
                "batch": times.batch,
                "device": times.device,
                "latency": times.is_latency(),
                "diffusion_secs": times.diffusion_secs,
                "coordinator_secs": times.coordinator_secs,
                "fit_secs": times.fit_secs,
                "total_secs": times.total_secs(),
                "fps": times.fps(),
            })
        };
        report::json(&rows.iter().map(row).collect::<Vec<_>>())?;
    } else {
        let grids = times::tables(&rows);
        let texts = grids
            .iter()
            .map(|grid| printed(grid, args.measure.ranking.format));
        report::text(&texts.collect::<Vec<_>>().join("\n"));
        if rows.iter().any(|(_, times)| !times.is_latency()) {
            report::note("a latency is timed by editing with --max-batch 1, into another folder");
        }
    }
    Ok(Exit::Done)
}

fn compared(args: &CompareArgs, global: &Global) -> anyhow::Result<Exit> {
    if args.measure.fid_all {
        bail!("a comparison takes whole sets for FID in any case; leave --fid-all out");
    }
    let protocol = args.measure.protocol(None, global);
    let runs = args.measure.runs()?;
    let (answered, names) = Answered::read_pair([&args.a, &args.b])?;
    let names = names.each_ref().map(String::as_str);
    let comparisons = runs.with(&answered.skeleton, |evaluators| {
        compare(&answered, names, evaluators, &protocol, &global.bars())
    })?;
    // The table of all items decides, as in `stance eval`.
    let of_all = comparisons.iter().find(|found| found.task == ALL_TASKS);
    let unranked = of_all
        .or(comparisons.first())
        .and_then(|found| found.unranked.clone());
    let exit = args.measure.weak_judge.exit(unranked, Exit::Done);
    let said = |comparison: &Comparison| -> Vec<String> {
        let notes = comparison.notes.iter().cloned();
        notes.chain(comparison.claim()).collect()
    };
    let printed = |comparison: &Comparison| {
        let mut text = printed(&comparison.grid(), args.measure.ranking.format);
        for line in said(comparison) {
            text += &match args.measure.ranking.format {
                FormatArg::Latex => format!("% {line}\n"),
                _ => format!("\n{line}\n"),
            };
        }
        text
    };
    match args.measure.ranking.format(global) {
        FormatArg::Json => report::json(&comparisons)?,
        FormatArg::Csv => {
            report::text(&Comparison::csv(&comparisons));
            // CSV has no place for a sentence.
            for comparison in &comparisons {
                for line in said(comparison) {
                    report::note(&format!("{}: {line}", comparison.task));
                }
            }
        }
        FormatArg::Text | FormatArg::Markdown | FormatArg::Latex => {
            let texts: Vec<String> = comparisons.iter().map(printed).collect();
            report::text(&texts.join("\n"));
        }
    }
    Ok(exit)
}

/// Name of the row with the recalls of a random order.
const CHANCE: &str = "random order";

fn encoder(args: &EncoderArgs, global: &Global) -> anyhow::Result<Exit> {
    let protocol = args.ranking.protocol(None, global);
    let run = args.ranking.encoder()?;
    let measured = encoder_retrieval(&args.dataset, run, args.split, &protocol)?;
    let (n, repeats) = (measured.clips, &measured.repeats);
    type Side = fn(&CrossRetrieval) -> &Retrieval;
    type Column = fn(&Retrieval) -> f64;
    let sides: [(&str, Side); 2] = [
        ("text to motion", |found| &found.text_to_motion),
        ("motion to text", |found| &found.motion_to_text),
    ];
    let columns: [(&str, Column); 5] = [
        ("R@1", |found| found.recall[0]),
        ("R@2", |found| found.recall[1]),
        ("R@3", |found| found.recall[2]),
        ("MedR", |found| found.median_rank),
        ("AvgR", |found| found.average_rank),
    ];
    let mut found = Vec::new();
    for (queries, side) in sides {
        for (metric, column) in columns {
            let values: Vec<f64> = repeats.iter().map(|found| column(side(found))).collect();
            found.push((queries, metric, Interval::of(&values)));
        }
    }
    let by_chance = std::iter::zip(columns, measured.chance);
    found.extend(
        by_chance.map(|((metric, _), mean)| (CHANCE, metric, Interval { mean, ci95: None })),
    );
    let gallery = protocol.gallery_name(n);
    if args.ranking.format(global) == FormatArg::Json {
        let row = |(queries, metric, Interval { mean, ci95 }): (&str, &str, Interval)| {
            json!({
                "queries": queries, "metric": metric, "n": n, "mean": mean, "ci95": ci95,
                "texts": measured.texts, "encoder_hash": measured.encoder_hash, "split": args.split.as_str(),
                "gallery": gallery, "repeats": protocol.repeats, "seed": protocol.seed.0,
            })
        };
        report::json(&found.into_iter().map(row).collect::<Vec<_>>())?;
        return Ok(Exit::Done);
    }
    let head = std::iter::once("Queries").chain(columns.iter().map(|(name, _)| *name));
    let cell = |(_, _, Interval { mean, ci95 }): &(&str, &str, Interval)| {
        let ci95 = ci95.map_or_else(String::new, |ci95| format!("±{ci95:.2}"));
        format!("{mean:.2}{ci95}")
    };
    let row = |row: &[(&str, &str, Interval)]| {
        let cells = row.iter().map(cell);
        let absent = std::iter::repeat_n(ABSENT.to_owned(), columns.len() - row.len());
        let cells = cells.chain(absent);
        std::iter::once(row[0].0.to_owned()).chain(cells).collect()
    };
    let grid = format::grid::Grid {
        title: format!(
            "{n} clips of {} with {} different captions, ± over {} repeats, seed {}; {gallery}; encoder {:.12}",
            args.split, measured.texts, protocol.repeats, protocol.seed.0, measured.encoder_hash
        ),
        head: head.map(str::to_owned).collect(),
        rows: found.chunks(columns.len()).map(row).collect(),
    };
    report::text(&printed(&grid, args.ranking.format));
    if args.ranking.format == FormatArg::Csv {
        // CSV has no place for a title.
        report::note(&grid.title);
    }
    Ok(Exit::Done)
}

fn printed(grid: &format::grid::Grid, format: FormatArg) -> String {
    match format {
        FormatArg::Text | FormatArg::Json => grid.text(),
        FormatArg::Markdown => grid.markdown(),
        FormatArg::Latex => grid.latex(),
        FormatArg::Csv => grid.csv(),
    }
}

/// The main tables and the columns of the paper's Table 1, for all tasks with items.
pub(crate) fn tables(scores: &Scores) -> Vec<Table> {
    let of_paper = metric::of_part(Part::Paper);
    [
        scores.main_tables(),
        Table::from_scores(&scores.rows, &scores.judges, &of_paper),
    ]
    .concat()
}

/// The columns the paper does not print, and motion quality.
pub(crate) fn further_tables(scores: &Scores) -> Vec<Table> {
    let of = |part| Table::from_scores(&scores.rows, &scores.judges, &metric::of_part(part));
    [of(Part::Further), of(Part::Quality)].concat()
}
