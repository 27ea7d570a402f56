//! From folders of motion files to a committed `motions` dataset.
//!
//! The run is planned before any work: every file is listed and hashed, its split drawn and its
//! shard fixed, so the result depends neither on the order in which threads finish nor on how often
//! the run was interrupted. A bad file becomes a row of the `quarantine` table and the rest goes on.

mod list;
mod options;
mod plan;
mod report;
mod rows;
mod shard;
mod split_list;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use datasets_spec::dataset::Commit;
use datasets_spec::license::{self, LICENSES_FACT};
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{MaskRow, MotionRow, PairRow, QuarantineRow};
use datasets_spec::table::Row;
use datasets_spec::{Progress, Resample, Seed, Split, Transaction};

use serde::Serialize;

use self::options::{LABEL_PROBLEMS_FACT, REFUSED_PAIRS_FACT, rate_name};
use self::plan::Plan;
use self::report::{Tally, already_complete, describe};
use self::shard::ShardNotes;
use crate::Error;
use crate::source::ReadOptions;

pub(crate) use self::list::{list_files, read_head};
pub use self::options::{IngestOptions, REMARKS_FACT};
pub use self::report::IngestReport;
pub use self::split_list::SplitList;

/// Fact of a manifest: the seed its splits were drawn with.
const SEED_FACT: &str = "seed";

/// Reads every motion under `sources` and commits them as a dataset at `out`.
///
/// Run again after an interruption it continues; run again after success it changes nothing.
/// `holder` is what another run is told while this one holds the lock.
///
/// # Errors
/// A source does not exist, there is no file at all, the dataset is locked or was made by another
/// plan, or writing fails. Faulty files are listed in the report and are no error.
pub fn ingest(
    sources: &[PathBuf],
    out: &Path,
    options: &IngestOptions,
    holder: &str,
    progress: &dyn Progress,
) -> Result<IngestReport, Error> {
    // A run with nothing to read leaves no folder behind.
    list_files(sources)?;
    let transaction = Transaction::begin(out, holder)?;
    ingest_in(transaction, sources, options, progress)
}

/// [`ingest`] within a transaction that has begun.
///
/// # Errors
/// As [`ingest`].
pub fn ingest_in(
    transaction: Transaction,
    sources: &[PathBuf],
    options: &IngestOptions,
    progress: &dyn Progress,
) -> Result<IngestReport, Error> {
    options.fps.map_or(Ok(()), IngestOptions::check_fps)?;
    let (seed, kept_seed) = split_seed(&transaction, options.seed);
    let options = &IngestOptions {
        seed,
        read: ReadOptions {
            // The published stride rule counts the file's own frames.
            rate: options.fps.filter(|_| options.resample == Resample::Exact),
            ..options.read.clone()
        },
        ..options.clone()
    };
    let plan = Plan::make(transaction.store(), sources, options, progress)?;
    let plan_hash = plan.hash(options);
    let recorded = transaction
        .base()
        .and_then(|base| base.plans.get(MotionRow::TABLE).cloned());
    match recorded {
        Some(recorded) if recorded == plan_hash && !plan.may_read_more_now(&transaction) => {
            let out = transaction.root().to_owned();
            transaction.finish()?;
            return already_complete(&out, &plan, kept_seed);
        }
        Some(recorded) if recorded != plan_hash && !options.new_version => {
            return Err(Error::Spec(datasets_spec::Error::OtherPlan {
                path: transaction.root().to_owned(),
                recorded,
                now: plan_hash,
            }));
        }
        _ => {}
    }

    let shards = plan.shards(options);
    let mut tally = Tally {
        skipped: plan.skipped.clone(),
        quarantine: plan.rejected.clone(),
        ..Tally::default()
    };
    let total: usize = shards.iter().map(|(_, items)| items.len()).sum();
    progress.begin("ingest", Some(total as u64));
    let facts = shard_facts(options, &plan_hash);
    for (name, items) in &shards {
        let staged = transaction.staged::<ShardNotes>(&plan_hash, name)?;
        let (entry, notes) = match staged {
            Some(done) if transaction.holds(done.1.beside.iter().map(|(_, file)| file))? => {
                tally.resumed_shards += 1;
                progress.advance(items.len() as u64);
                done
            }
            _ => {
                let done = plan.make_shard(&transaction, name, items, options, &facts, progress)?;
                transaction.stage(&plan_hash, name, &done.0, &done.1)?;
                done
            }
        };
        tally.take(entry, notes);
    }
    tally.quarantine.sort_by(|a, b| a.path.cmp(&b.path));

    let accounting = tally.accounting(plan.num_items());
    progress.finish(&format!(
        "{} sources: {} ingested, {} quarantined, {} skipped",
        accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
    ));
    let (mut pairs, dropped_pairs) = tally.pairs(&shards);
    let listed = tally.listed_pairs(&shards, options.pairs.as_ref(), &pairs);
    pairs.extend(listed.rows);
    pairs.sort_by(|a, b| a.id.cmp(&b.id));
    let masks = tally.masks();
    let quarantine = transaction.write_shards(None, &tally.quarantine, &facts)?;
    let motions = tally.tables.get(MotionRow::TABLE).into_iter().flatten();
    let licenses = license::count(transaction.root(), motions)?;
    let label_problems = tally.label_problems(&plan);
    let mut tables = tally.tables;
    tables.insert(QuarantineRow::TABLE.to_owned(), quarantine);
    if !pairs.is_empty() {
        let files = write_present(&transaction, |row: &PairRow| row.split, &pairs, &facts)?;
        tables.insert(PairRow::TABLE.to_owned(), files);
    }
    if !masks.is_empty() {
        let files = write_present(&transaction, |row: &MaskRow| row.split, &masks, &facts)?;
        tables.insert(MaskRow::TABLE.to_owned(), files);
    }
    let mut recorded = BTreeMap::from([
        (LICENSES_FACT.to_owned(), json(&licenses)),
        (LABEL_PROBLEMS_FACT.to_owned(), json(&label_problems)),
        (SEED_FACT.to_owned(), options.seed.0.to_string()),
        ("fps".to_owned(), rate_name(options)),
        ("files".to_owned(), plan.files.len().to_string()),
        ("dropped_pairs".to_owned(), dropped_pairs.to_string()),
        ("skipped".to_owned(), describe(&tally.skipped)),
    ]);
    if !plan.remarks.is_empty() {
        recorded.insert(REMARKS_FACT.to_owned(), plan.remarks.join("; "));
    }
    if !listed.refused.is_empty() {
        recorded.insert(REFUSED_PAIRS_FACT.to_owned(), json(&listed.refused));
    }
    let dataset = transaction.commit(Commit {
        tables,
        plan_hash,
        skeleton: options.read.skeleton.clone(),
        accounting: Some(accounting.clone()),
        facts: recorded,
        fresh: true,
    })?;
    Ok(IngestReport {
        dataset,
        accounting,
        files: plan.files.len() as u64,
        dropped_pairs,
        refused_pairs: listed.refused,
        remarks: plan
            .remarks
            .into_iter()
            .chain(kept_seed)
            .chain(license::warning(&licenses))
            .collect(),
        refused_splits: plan.refused_splits,
        label_problems,
        licenses,
        quarantine: tally.quarantine,
        skipped: tally.skipped,
        resumed_shards: tally.resumed_shards,
        already_complete: false,
    })
}

/// The seed of the splits, and a remark if it is not the one asked for: a dataset that is there
/// keeps its own, so that no clip moves.
fn split_seed(transaction: &Transaction, asked: Seed) -> (Seed, Option<String>) {
    let recorded = transaction
        .base()
        .filter(|base| base.plans.contains_key(MotionRow::TABLE))
        .and_then(|base| base.facts.get(SEED_FACT)?.parse().ok().map(Seed));
    match recorded {
        Some(seed) if seed != asked => {
            let remark = format!(
                "the splits were drawn with seed {} when the dataset was made and stay as they are; \
                 ingest into a new folder to draw them with seed {}",
                seed.0, asked.0
            );
            (seed, Some(remark))
        }
        Some(seed) => (seed, None),
        None => (asked, None),
    }
}

/// A fact of a manifest as JSON.
fn json(fact: &impl Serialize) -> String {
    serde_json::to_string(fact).expect("numbers and texts serialise")
}

fn shard_facts(options: &IngestOptions, plan_hash: &str) -> [(&'static str, String); 6] {
    [
        ("skeleton", options.read.skeleton.name().to_owned()),
        ("fps", rate_name(options)),
        ("plan_hash", plan_hash.to_owned()),
        ("units", "metres, radians, seconds".to_owned()),
        ("up_axis", "y".to_owned()),
        ("forward_axis", "z".to_owned()),
    ]
}

/// Writes a table with a shard for each split that has rows.
fn write_present<R: Row>(
    transaction: &Transaction,
    split_of: fn(&R) -> Split,
    rows: &[R],
    facts: &[(&str, String)],
) -> Result<Vec<FileEntry>, Error> {
    let mut files = Vec::new();
    for split in Split::ALL {
        let rows = rows.iter().filter(|row| split_of(row) == split);
        let rows: Vec<R> = rows.cloned().collect();
        if !rows.is_empty() {
            files.extend(transaction.write_shards(Some(split), &rows, facts)?);
        }
    }
    Ok(files)
}
