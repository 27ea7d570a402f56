//! `stance-cluster run`

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use ballista::extension::{SessionConfigExt, SessionContextExt};
use datafusion::arrow::array::AsArray;
use datafusion::arrow::record_batch::RecordBatch;
use datafusion::error::DataFusionError;
use datafusion::prelude::{ParquetReadOptions, SessionContext};
use datasets_spec::NoProgress;
use indicatif::{ProgressBar, ProgressStyle};
use pipeline::jobs::jobs;
use serde::Serialize;
use work::{CommitOptions, Committed, Plan, Record, commit, status};

use crate::function::{Isolation, NAME, function};
use crate::{note, result, session, work_list};

/// Exit code of a run with failed pieces.
const SOME_FAILED: u8 = 3;

/// Make the missing pieces of a plan and commit it.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Plan of `stance stage plan`
    plan: PathBuf,
    /// Scheduler, as HOST:PORT
    #[arg(long, default_value = "127.0.0.1:50050")]
    scheduler: String,
    /// Run scheduler and executor within this process
    #[arg(long, conflicts_with = "scheduler")]
    local: bool,
    /// Pieces made at a time with --local
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..), requires = "local")]
    pieces: u16,
    /// With --local: make every piece in a process of its own, with this command `stance`
    #[arg(long, value_name = "STANCE", requires = "local")]
    isolate: Option<PathBuf>,
    /// Make the pieces, and leave the commit to `stance stage commit`
    #[arg(long)]
    no_commit: bool,
    /// Commit without the pieces that fail; their sources go to the table `quarantine`
    #[arg(long)]
    quarantine_failed: bool,
    /// Print one JSON document to stdout
    #[arg(long)]
    json: bool,
    /// Give the cluster all pieces, even those that are done: this measures scheduling alone
    #[arg(long, hide = true)]
    again: bool,
    /// File for the times of the tasks as the scheduler reports them
    #[arg(long, value_name = "FILE", hide = true, conflicts_with = "local")]
    times: Option<PathBuf>,
    /// A setting of Ballista for this job
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = setting, hide = true)]
    settings: Vec<(String, String)>,
}

fn setting(text: &str) -> Result<(String, String), String> {
    let (key, value) = text.split_once('=').ok_or("KEY=VALUE")?;
    Ok((key.to_owned(), value.to_owned()))
}

/// The document of `--json`.
#[derive(Debug, Serialize)]
struct Document {
    /// Pieces of the plan.
    pieces: u64,
    /// Pieces that this run made.
    made: u64,
    /// Pieces that were done before this run.
    done_before: u64,
    /// Why each failed piece failed, by its id.
    failed: BTreeMap<String, String>,
    /// The commit; null if there was none.
    committed: Option<Committed>,
}

pub(crate) async fn run(args: Args) -> anyhow::Result<ExitCode> {
    let path = std::path::absolute(&args.plan)?;
    let plan = Plan::open(&path)?;
    let before = status(&plan)?;
    let mut wanted = before.missing;
    // A piece that failed before may succeed now.
    wanted.extend(before.failed.into_iter().map(|record| record.piece));
    if args.again {
        wanted = plan.pieces().iter().map(|piece| piece.id.clone()).collect();
    }
    wanted.sort();
    let failed = work(&args, &plan, wanted, before.done).await?;
    let mut document = Document {
        pieces: before.pieces,
        made: 0,
        done_before: before.done,
        failed: BTreeMap::new(),
        committed: None,
    };
    for record in failed {
        let [code, reason] = [record.code, record.reason].map(Option::unwrap_or_default);
        note(&format!(
            "piece {} {} failed: {code}: {reason}",
            record.piece, record.name
        ));
        document
            .failed
            .insert(record.piece, format!("{code}: {reason}"));
    }
    document.made = before.pieces - before.done - document.failed.len() as u64;
    let is_whole = document.failed.is_empty() || args.quarantine_failed;
    let jobs = jobs();
    if is_whole && !args.no_commit && !jobs.know(&plan) {
        note(&format!(
            "jobs of {} are committed by the command: stance stage commit {}",
            plan.job(),
            path.display()
        ));
    } else if is_whole && !args.no_commit {
        let options = CommitOptions {
            quarantine_failed: args.quarantine_failed,
            holder: format!("stance-cluster run, process {}", std::process::id()),
        };
        let done = tokio::task::spawn_blocking(move || commit(&path, &jobs, &options, &NoProgress))
            .await?;
        document.committed = Some(done?);
    }
    say(&args, &document)?;
    Ok(if document.failed.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(SOME_FAILED)
    })
}

fn say(args: &Args, document: &Document) -> anyhow::Result<()> {
    if args.json {
        result(&serde_json::to_string_pretty(document)?);
        return Ok(());
    }
    let Document {
        pieces,
        made,
        done_before,
        failed,
        committed,
    } = document;
    result(&format!(
        "{pieces} pieces: {made} made, {done_before} done before, {} failed",
        failed.len()
    ));
    match committed {
        Some(committed) => result(&format!(
            "{} in {}",
            committed.root_hash,
            committed.destination.display()
        )),
        None => result(&format!(
            "not committed; `stance stage commit {}` does it",
            args.plan.display()
        )),
    }
    Ok(())
}

/// Lets the cluster make pieces until each exists or has failed, and returns the records of the failed ones.
///
/// Executors keep the results of a job. If one is lost with its results, the job fails although its pieces exist;
/// another job then makes the pieces that are missing.
async fn work(
    args: &Args,
    plan: &Plan,
    mut wanted: Vec<String>,
    mut done: u64,
) -> anyhow::Result<Vec<Record>> {
    /// Number of jobs in a row without a new piece after which the last error is returned.
    const PATIENCE: usize = 3;
    let mut in_vain = 0;
    while !wanted.is_empty() {
        let error = match made(args, plan, &wanted).await {
            Ok(records) => {
                return Ok(records
                    .into_iter()
                    .filter(|record| !record.is_done())
                    .collect());
            }
            Err(error) => error,
        };
        let now = status(plan)?;
        in_vain = if now.done > done { 0 } else { in_vain + 1 };
        if in_vain == PATIENCE
            || !args.local && executors(&args.scheduler).is_none_or(|alive| alive == 0)
        {
            return Err(error);
        }
        done = now.done;
        wanted = now.missing;
        wanted.extend(now.failed.into_iter().map(|record| record.piece));
        note(&format!("{error:#}; going on with {} pieces", wanted.len()));
    }
    Ok(Vec::new())
}

/// Lets the cluster make pieces in one job, and returns a record for each.
async fn made(args: &Args, plan: &Plan, wanted: &[String]) -> anyhow::Result<Vec<Record>> {
    let list = tempfile::Builder::new()
        .prefix("cluster-")
        .tempdir_in(plan.path())
        .with_context(|| {
            format!(
                "cannot write to {}; executors read the work list there",
                plan.path().display()
            )
        })?;
    let files = work_list::write(list.path(), plan.path(), wanted)?;
    let mut config = session::config(files, &args.settings)?;
    config = config.with_ballista_job_name(&format!("stance {} {:.12}", plan.job(), plan.hash()));
    let context = if args.local {
        let isolation = args
            .isolate
            .clone()
            .map_or(Isolation::None, Isolation::Child);
        let config = config.with_ballista_standalone_parallelism(args.pieces.into());
        SessionContext::standalone_with_state(session::state(config, isolation)?).await?
    } else {
        let address = format!("df://{}", args.scheduler);
        SessionContext::remote_with_state(&address, session::state(config, Isolation::None)?)
            .await?
    };
    // Creating a Ballista session drops functions that are not Ballista's own.
    context.register_udf(function(Isolation::None));
    let folder = list.path().to_string_lossy();
    context
        .register_parquet("pieces", folder, ParquetReadOptions::default())
        .await?;
    let query = format!("SELECT {NAME}(plan, piece) AS made FROM pieces");
    let watch = tokio::spawn(watch(
        plan.clone(),
        (!args.local).then(|| args.scheduler.clone()),
    ));
    let collected = match context.sql(&query).await {
        Ok(frame) => frame.collect().await,
        Err(error) => Err(error),
    };
    watch.abort();
    let batches = collected.map_err(|error| ended(args, &error))?;
    if let Some(file) = &args.times {
        let times = stages(&args.scheduler).context("the scheduler told no times")?;
        std::fs::write(file, times).with_context(|| format!("cannot write {}", file.display()))?;
    }
    let records = records(&batches)?;
    let mut told: Vec<&str> = records.iter().map(|record| record.piece.as_str()).collect();
    told.sort_unstable();
    if told != wanted.iter().map(String::as_str).collect::<Vec<_>>() {
        bail!(
            "{} pieces were asked for and {} answers came; run the same command again",
            wanted.len(),
            told.len()
        );
    }
    Ok(records)
}

/// The error for a job that ended, and what to do next.
fn ended(args: &Args, error: &DataFusionError) -> anyhow::Error {
    let next = "pieces that are done stay done: run the same command again";
    if args.local {
        return anyhow!("the job ended: {error}; {next}");
    }
    let place = &args.scheduler;
    match executors(place) {
        None => anyhow!(
            "the scheduler on {place} does not answer ({error}); start it again, and {next}"
        ),
        Some(0) => {
            anyhow!("the scheduler on {place} has no executor ({error}); start one, and {next}")
        }
        Some(alive) => anyhow!(
            "the job ended on {place}, which has {alive} executors: {error}; a piece that ends its executor can be \
             made with --isolate; {next}"
        ),
    }
}

fn records(batches: &[RecordBatch]) -> anyhow::Result<Vec<Record>> {
    let mut records = Vec::new();
    for batch in batches {
        let column = batch.column(0).as_struct();
        let column = column
            .column_by_name("record")
            .context("an answer without a record")?;
        let column = column.as_string::<i32>();
        for text in column.iter().flatten() {
            records.push(serde_json::from_str(text).context("an answer that is no record")?);
        }
    }
    Ok(records)
}

/// Shows pieces that are done or failed, and executors that are alive, until it is aborted.
async fn watch(plan: Plan, scheduler: Option<String>) {
    const EVERY: Duration = Duration::from_secs(1);
    let total = plan.pieces().len() as u64;
    let style = ProgressStyle::with_template("{pos}/{len} pieces {wide_bar} {msg} {elapsed}");
    let bar =
        ProgressBar::new(total).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    loop {
        let (plan, scheduler) = (plan.clone(), scheduler.clone());
        let looked = tokio::task::spawn_blocking(move || {
            (marks(&plan), scheduler.as_deref().map(executors))
        });
        if let Ok(((done, failed), executors)) = looked.await {
            bar.set_position(done);
            let mut text = format!("{failed} failed");
            match executors {
                Some(Some(alive)) => text += &format!(", {alive} executors"),
                Some(None) => text += ", the scheduler does not answer",
                None => {}
            }
            bar.set_message(text);
        }
        tokio::time::sleep(EVERY).await;
    }
}

/// Numbers of done and of failed pieces, counted by the names of their record files, which are not read.
fn marks(plan: &Plan) -> (u64, u64) {
    let staging = plan.staging();
    let entries = staging.store().list(staging.folder()).unwrap_or_default();
    let names = entries
        .iter()
        .filter_map(|(path, _)| path.file_name()?.to_str());
    let (mut done, mut failed) = (0, 0);
    for name in names.filter_map(|name| name.strip_suffix(".json")) {
        if name.ends_with(".failed") {
            failed += 1;
        } else {
            done += 1;
        }
    }
    (done, failed)
}

/// Number of executors of a scheduler; `None` if it does not answer.
fn executors(scheduler: &str) -> Option<usize> {
    let listed: Vec<serde_json::Value> =
        serde_json::from_str(&asked(scheduler, "executors")?).ok()?;
    Some(listed.len())
}

/// Stages and tasks of the newest job of a scheduler, in JSON.
fn stages(scheduler: &str) -> Option<String> {
    let jobs: Vec<serde_json::Value> = serde_json::from_str(&asked(scheduler, "jobs")?).ok()?;
    let newest = jobs.iter().max_by_key(|job| job["start_time"].as_u64())?;
    asked(
        scheduler,
        &format!("job/{}/stages", newest["job_id"].as_str()?),
    )
}

/// Response of a scheduler to a status request; `None` if it does not respond.
fn asked(scheduler: &str, what: &str) -> Option<String> {
    const PATIENCE: Duration = Duration::from_secs(2);
    let agent = ureq::Agent::config_builder()
        .timeout_global(Some(PATIENCE))
        .build()
        .new_agent();
    let mut answer = agent
        .get(format!("http://{scheduler}/api/{what}"))
        .call()
        .ok()?;
    answer.body_mut().read_to_string().ok()
}
