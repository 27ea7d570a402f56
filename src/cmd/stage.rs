//! `stance stage`

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Instant;

use anyhow::{Context, bail};
use datasets_spec::Progress as _;
use datasets_spec::store::temporary_beside;
use pipeline::export::Exported;
use pipeline::ingest::IngestNotes;
use serde::Deserialize;
use serde_json::json;
use train::sample::EditTimes;
use train::work::{Surroundings, device_of, edits, variants};
use work::{CommitOptions, Failed, Jobs, NewFolder, Outcome, Piece, Plan, Record, Sample, Worker};

use crate::device::DeviceArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::itself::Itself;
use crate::session::surroundings;
use crate::stages::per_window;
use crate::{cmd, report};

/// Do a long job in pieces, on any number of machines, with the same result.
///
/// `plan` lists the pieces of a job in a folder, `work` makes some or all of them, and `commit` combines them into the
/// result. Any scheduler can start the workers: pieces may be made in any order, at the same time and more than once.
/// Workers need the folder of the plan, the sources and the destination at the same paths.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    Plan(Box<PlanArgs>),
    Work(WorkArgs),
    Commit(CommitArgs),
    Status(StatusArgs),
}

/// Plan a job. Its options are those of its own verb, with --into instead of --out.
#[derive(clap::Args, Debug)]
struct PlanArgs {
    #[command(subcommand)]
    job: JobArgs,
    /// New folder of the plan
    #[arg(long = "out", global = true, value_name = "PLAN")]
    plan: Option<PathBuf>,
    /// Print the pieces, bytes and estimated hours, and write nothing
    #[arg(long, global = true)]
    dry_run: bool,
}

#[derive(clap::Subcommand, Debug)]
enum JobArgs {
    #[command(mut_arg("out", |arg| arg.long("into")))]
    Ingest(Box<cmd::ingest::Args>),
    #[command(mut_arg("out", |arg| arg.long("into")))]
    Triplets(Box<cmd::triplets::Args>),
    #[command(mut_arg("out", |arg| arg.long("into")))]
    Edit(Box<cmd::edit::Args>),
    #[command(mut_arg("out", |arg| arg.long("into")))]
    Export(Box<cmd::export::Args>),
    #[command(mut_arg("out", |arg| arg.long("into")))]
    Variants(Box<cmd::variants::Args>),
}

/// Make pieces of a plan. Existing pieces are skipped.
#[derive(clap::Args, Debug)]
struct WorkArgs {
    /// Folder of the plan
    plan: PathBuf,
    /// Make every N-th piece from number I, counted from 0, as worker I of N [default: all pieces]
    #[arg(long, value_name = "I/N", value_parser = parse_share, conflicts_with = "items")]
    shard: Option<Share>,
    /// Make the pieces with these ids; - reads them from the standard input
    #[arg(long, value_name = "IDS", value_delimiter = ',')]
    items: Vec<String>,
    /// Make each piece in a separate process, so that a crash fails only that piece
    #[arg(long)]
    isolate: bool,
    /// Address space of each process, such as 4GB: a piece that needs more fails
    #[cfg(unix)]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    memory: Option<u64>,
}

/// Combine the pieces of a plan into its result.
#[derive(clap::Args, Debug)]
struct CommitArgs {
    /// Folder of the plan
    plan: PathBuf,
    /// Put the items of failed pieces into quarantine; without it, failed pieces stop the commit
    #[arg(long)]
    quarantine_failed: bool,
}

/// Count the pieces of a plan that are done, missing and failed.
#[derive(clap::Args, Debug)]
struct StatusArgs {
    /// Folder of the plan
    plan: PathBuf,
}

/// One of several equal shares of the pieces.
#[derive(Clone, Copy, Debug)]
struct Share {
    index: u64,
    of: u64,
}

fn parse_share(text: &str) -> Result<Share, String> {
    let numbers = text.split_once('/');
    let numbers = numbers.and_then(|(index, of)| Some((index.parse().ok()?, of.parse().ok()?)));
    match numbers {
        Some((index, of)) if index < of => Ok(Share { index, of }),
        _ => Err(format!(
            "expected I/N with I from 0 to N-1, such as 0/4, got {text:?}"
        )),
    }
}

#[cfg(unix)]
fn parse_size(text: &str) -> Result<u64, String> {
    let size = datasets_spec::cache::parse_bytes(text).filter(|size| *size > 0);
    size.ok_or_else(|| format!("expected a size such as 4GB or 512MB, got {text:?}"))
}

pub(crate) fn run(args: &Args, global: &Global, itself: Itself<'_>) -> anyhow::Result<Exit> {
    match &args.action {
        Action::Plan(args) => plan(args, global),
        Action::Work(args) => work(args, global, itself),
        Action::Commit(args) => commit(args, global),
        Action::Status(args) => status(args, global),
    }
}

fn jobs() -> Jobs {
    pipeline::jobs::jobs()
        .with(
            edits::JOB,
            Box::new(|plan| edits::open_job(plan, of_plan(plan)?)),
        )
        .with(
            variants::JOB,
            Box::new(|plan| variants::open_job(plan, of_plan(plan)?)),
        )
}

fn of_plan(plan: &Plan) -> Result<Surroundings, Failed> {
    let failed = |error: anyhow::Error| Failed::new("E-DEVICE", format!("{error:#}"));
    let device = device_of(plan)?;
    let device = DeviceArgs::from_json(device).map_err(failed)?;
    device.choose().map_err(failed)?;
    Ok(surroundings())
}

fn plan(args: &PlanArgs, global: &Global) -> anyhow::Result<Exit> {
    let make = |folder: &Path| -> anyhow::Result<Plan> {
        match &args.job {
            JobArgs::Ingest(args) => args.plan(folder, global),
            JobArgs::Triplets(args) => args.plan(folder, global),
            JobArgs::Edit(args) => args.plan(folder, global),
            JobArgs::Export(args) => args.plan(folder),
            JobArgs::Variants(args) => args.plan(folder, global),
        }
    };
    if args.dry_run {
        return dry_run(make, global);
    }
    let Some(folder) = &args.plan else {
        bail!("say where the plan goes: --out PLAN, or --dry-run to see how large it would be");
    };
    let made = make(folder).with_context(|| format!("cannot plan in {}", folder.display()))?;
    say(&made, Some(folder), None, global)
}

/// Plans in a temporary folder, and times a small sample.
fn dry_run(
    make: impl FnOnce(&Path) -> anyhow::Result<Plan>,
    global: &Global,
) -> anyhow::Result<Exit> {
    const SAMPLE: u64 = 16;
    let folder = NewFolder::beside(&temporary_beside(&std::env::temp_dir().join("stance")))?;
    // A plan needs an unused path, so a dry run writes it into a temporary folder.
    let place = folder.path().join("plan");
    let plan = make(&place)?;
    let worker = Worker::open(&place, jobs())?;
    let sample = worker.sample(SAMPLE).map_err(failure)?;
    say(&plan, None, sample, global)
}

fn failure(failed: Failed) -> anyhow::Error {
    anyhow::anyhow!("{} ({})", failed.reason, failed.code)
}

fn say(
    plan: &Plan,
    folder: Option<&Path>,
    sample: Option<Sample>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let count = |number: fn(&Piece) -> u64| plan.pieces().iter().map(number).sum::<u64>();
    let items = count(|piece| piece.items);
    // Not known where all pieces read the same.
    let bytes = Some(count(|piece| piece.bytes)).filter(|bytes| *bytes > 0);
    let hours = sample
        .map(|Sample { items: made, secs }| secs / made.max(1) as f64 * items as f64 / 3600.0);
    let (job, destination, pieces) = (plan.job(), plan.destination(), plan.pieces().len());
    // Sample and estimate are null without --dry-run. The estimate is for one process like this one.
    let planned = json!({
        "job": job,
        "plan": folder.map(|folder| folder.display().to_string()),
        "destination": destination,
        "plan_hash": plan.hash(),
        "pieces": pieces,
        "items": items,
        "bytes": bytes,
        "sample": sample.map(|Sample { items, secs }| json!({ "items": items, "secs": secs })),
        "estimated_hours": hours,
    });
    let read = bytes.map_or(String::new(), |bytes| {
        format!(", {:.1} MB to read", bytes as f64 / 1e6)
    });
    let mut text = format!(
        "{pieces} pieces of {job}: {items} items{read}, into {}\n",
        destination.display()
    );
    if let (Some(Sample { items, secs }), Some(hours)) = (sample, hours) {
        text += &format!(
            "{items} items were made to time them: {secs:.1} s; all take about {hours:.2} hours of one process \
             like this one\n"
        );
    }
    if let Some(folder) = folder {
        let folder = folder.display();
        text += &format!(
            "make the pieces: stance stage work {folder} [--shard I/N]\n\
             then: stance stage commit {folder}\n"
        );
    }
    global.say(&planned, &text)
}

fn work(args: &WorkArgs, global: &Global, itself: Itself<'_>) -> anyhow::Result<Exit> {
    #[cfg(unix)]
    if let (Some(bytes), false) = (args.memory, args.isolate) {
        rlimit::setrlimit(rlimit::Resource::AS, bytes, bytes)
            .context("cannot limit the memory of this process")?;
    }
    let worker = Worker::open(&args.plan, jobs())?;
    let ids = chosen(args, worker.plan())?;
    let (mut done, mut before, mut failed) = (0u64, 0u64, 0u64);
    let progress = global.bars();
    progress.begin("work", Some(ids.len() as u64));
    for id in &ids {
        let record = match args.isolate {
            true => isolated(args, &worker, id, global, itself),
            false => worker.make(id),
        };
        match record.outcome {
            Outcome::Done => done += 1,
            Outcome::DoneBefore => before += 1,
            Outcome::Failed => failed += 1,
        }
        progress.advance(1);
        if global.json {
            report::text(&serde_json::to_string(&record)?);
        } else if !record.is_done() {
            let (piece, name) = (&record.piece, &record.name);
            report::note(&format!("piece {piece} {name} failed {}", why(&record)));
        }
    }
    progress.finish(&format!("{} pieces", ids.len()));
    if !global.json {
        report::text(&format!(
            "{done} pieces made, {before} were there already, {failed} failed"
        ));
    }
    Ok(Exit::quarantined_if(failed > 0))
}

fn why(record: &Record) -> String {
    let [code, reason] = [&record.code, &record.reason];
    let [code, reason] = [code, reason].map(|text| text.as_deref().unwrap_or_default());
    format!("({code}): {reason}")
}

/// Ids of the pieces to make: those of --items in the given order, or those of the share in the order of the plan.
fn chosen(args: &WorkArgs, plan: &Plan) -> anyhow::Result<Vec<String>> {
    if args.items.is_empty() {
        let is_chosen = |piece: &&Piece| match args.shard {
            Some(Share { index, of }) => piece.number % of == index,
            None => true,
        };
        let pieces = plan.pieces().iter().filter(is_chosen);
        return Ok(pieces.map(|piece| piece.id.clone()).collect());
    }
    let mut ids = Vec::new();
    for item in &args.items {
        if item != "-" {
            ids.push(item.trim().to_owned());
            continue;
        }
        for line in std::io::stdin().lock().lines() {
            let line = line.context("cannot read the ids")?;
            let words = line.split([' ', '\t', ',']);
            ids.extend(words.filter(|word| !word.is_empty()).map(str::to_owned));
        }
    }
    let known = plan.pieces().iter().map(|piece| piece.id.as_str());
    let known: BTreeSet<&str> = known.collect();
    if let Some(unknown) = ids.iter().find(|id| !known.contains(id.as_str())) {
        bail!(
            "the plan {} has no piece {unknown:?}; ids are in its pieces.parquet, and `stance stage status` \
             lists those that are missing",
            plan.path().display()
        );
    }
    Ok(ids)
}

fn isolated(
    args: &WorkArgs,
    worker: &Worker,
    id: &str,
    global: &Global,
    itself: Itself<'_>,
) -> Record {
    let begun = Instant::now();
    let failed = match child(args, id, global, itself) {
        Ok((Some(record), _)) => return record,
        Ok((None, status)) => Failed::new("E-CRASH", ended(status)),
        Err(error) => Failed::new("E-IO", format!("cannot start a process: {error}")),
    };
    match worker.plan().piece(id) {
        Some(piece) => worker.fail(piece, failed, begun.elapsed().as_secs_f64()),
        None => worker.make(id),
    }
}

fn child(
    args: &WorkArgs,
    id: &str,
    global: &Global,
    itself: Itself<'_>,
) -> std::io::Result<(Option<Record>, ExitStatus)> {
    let mut command = itself()?;
    command.args(["--json", "--no-progress"]);
    if let Some(threads) = global.threads {
        command.args(["--threads", &threads.to_string()]);
    }
    command.args(["stage", "work"]).arg(&args.plan);
    command.args(["--items", id]);
    #[cfg(unix)]
    if let Some(bytes) = args.memory {
        command.args(["--memory", &bytes.to_string()]);
    }
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut record = None;
    if let Some(stdout) = child.stdout.take() {
        for line in BufReader::new(stdout).lines() {
            record = serde_json::from_str(&line?).ok().or(record);
        }
    }
    Ok((record, child.wait()?))
}

/// How a process without a record ended.
fn ended(status: ExitStatus) -> String {
    #[cfg(unix)]
    {
        use std::os::unix::process::ExitStatusExt;

        if let Some(signal) = status.signal() {
            let why = match signal {
                signal_hook::consts::SIGKILL => {
                    ": killed, by the system for want of memory or by somebody"
                }
                signal_hook::consts::SIGABRT => ": aborted, for want of memory or by a defect",
                _ => "",
            };
            return format!("the process that made this piece ended by signal {signal}{why}");
        }
    }
    format!("the process that made this piece ended without a record ({status})")
}

/// Notes that a commit of edits returns.
#[derive(Deserialize)]
struct TimesOf {
    times: EditTimes,
}

fn commit(args: &CommitArgs, global: &Global) -> anyhow::Result<Exit> {
    let options = CommitOptions {
        quarantine_failed: args.quarantine_failed,
        holder: global.holder(),
    };
    let done = work::commit(&args.plan, &jobs(), &options, &global.bars())?;
    // Write the times of editing, as `stance edit` does.
    if let Ok(TimesOf { times }) = TimesOf::deserialize(&done.notes) {
        per_window(&times, "the processes of a plan".to_owned()).write(&done.destination)?;
    }
    let quarantined = done
        .accounting
        .as_ref()
        .map_or(0, |counts| counts.quarantined);
    let mut text = String::new();
    if done.already_committed {
        text += "the plan was committed before; nothing was done\n";
    }
    if let Some(counts) = &done.accounting {
        text += &format!(
            "{} sources: {} ingested, {} quarantined, {} skipped\n",
            counts.sources, counts.ingested, counts.quarantined, counts.skipped
        );
        for (code, count) in &counts.codes {
            text += &format!("  {code:<20} {count:>6}\n");
        }
    }
    if done.failed > 0 {
        text += &format!("{} of {} pieces failed\n", done.failed, done.pieces);
    }
    for (table, rows) in &done.tables {
        text += &format!("{table:<12} {rows:>8} rows\n");
    }
    if let Ok(export) = Exported::deserialize(&done.notes) {
        for line in cmd::export::said(&export) {
            text += &format!("{line}\n");
        }
    }
    let notes = IngestNotes::deserialize(&done.notes).ok();
    text += &notes.as_ref().map_or_else(String::new, cmd::ingest::noted);
    text += &format!(
        "{} with root hash {}\n",
        done.destination.display(),
        done.root_hash
    );
    global.say(&done, &text)?;
    let is_whole = notes.is_none_or(|notes| notes.all_lines_were_used());
    let is_lost = quarantined + done.failed > 0 || !is_whole;
    Ok(Exit::quarantined_if(is_lost && !done.already_committed))
}

fn status(args: &StatusArgs, global: &Global) -> anyhow::Result<Exit> {
    let plan = Plan::open(&args.plan)?;
    let status = work::status(&plan)?;
    let mut text = format!(
        "{} pieces: {} done, {} missing, {} failed{}\n",
        status.pieces,
        status.done,
        status.missing.len(),
        status.failed.len(),
        if status.committed { "; committed" } else { "" }
    );
    if status.secs > 0.0 {
        text += &format!("{:.1} s of work in what is done\n", status.secs);
    }
    for record in &status.failed {
        let (piece, name) = (&record.piece, &record.name);
        text += &format!("failed {piece} {name} {}\n", why(record));
    }
    const SHOWN: usize = 20;
    for id in status.missing.iter().take(SHOWN) {
        text += &format!("missing {id}\n");
    }
    if status.missing.len() > SHOWN {
        let more = status.missing.len() - SHOWN;
        text += &format!("and {more} more missing; --json lists all\n");
    }
    global.say(&status, &text)
}
