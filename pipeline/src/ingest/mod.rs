//! From folders of motion files to a committed `motions` dataset.
//!
//! The run is planned before any work: every file is listed and hashed, its split drawn and its
//! shard fixed, so the result depends neither on the order in which threads finish nor on how often
//! the run was interrupted. A bad file becomes a row of the `quarantine` table and the rest goes on.

mod equal;
mod growth;
mod identity;
mod inputs;
mod list;
mod options;
mod plan;
mod recorded;
mod report;
mod rows;
mod shard;
mod sources;
mod split_list;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use datasets_spec::dataset::Commit;
use datasets_spec::license::{self, LICENSES_FACT};
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{MaskRow, MotionRow, PairRow, QuarantineRow, SkippedRow};
use datasets_spec::table::Row;
use datasets_spec::{Progress, Resample, Seed, Split, Transaction};

use serde::Serialize;

use self::growth::Fates;
use self::options::{
    LABEL_PROBLEMS_FACT, PAIRS_FACT, REFUSED_PAIRS_FACT, SEED_FACT, SETTINGS_FACT, Settings,
    rate_name,
};
use self::plan::Plan;
use self::recorded::Base;
use self::report::{Tally, already_complete, counted};
use self::shard::ShardNotes;
use self::sources::SOURCES_FACT;
use crate::Error;
use crate::source::ReadOptions;

pub use self::growth::{Growth, LostLabel};
pub(crate) use self::list::{labelled as with_label, read_head};
pub use self::options::{IngestOptions, REMARKS_FACT};
pub(crate) use self::recorded::{SHARDED, merged_facts};
pub use self::report::IngestReport;
pub(crate) use self::sources::list_files;
pub use self::split_list::SplitList;

/// Reads every motion under `sources` and commits them as a dataset at `out`.
///
/// Run again after an interruption it continues; run again after success it changes nothing. Where the
/// dataset exists, it grows: only files that are new or changed are read, clips keep their ids, splits and
/// labels, and sources that are not given stay as they are.
/// `holder` is what another run is told while this one holds the lock.
///
/// # Errors
/// A source does not exist, there is no file at all, the dataset is locked or was made with other
/// settings, labels would be lost, or writing fails. Faulty files are listed in the report and are no error.
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
    let settings = Settings::of(options);
    let base = Base::read(&transaction)?;
    let differing = base
        .as_ref()
        .and_then(|base| settings.differing(base.settings.as_ref()));
    if let (Some(differing), false) = (&differing, options.new_version) {
        return Err(Error::OtherSettings {
            path: transaction.root().to_owned(),
            differing: differing.clone(),
        });
    }
    let is_new = base.is_none();
    let base = base.unwrap_or_default();
    let recorded = &base.recorded;
    let plan = Plan::make(
        transaction.store(),
        sources,
        options,
        recorded,
        differing.is_none(),
        progress,
    )?;
    let fates = Fates::of(&plan, recorded);
    let outside = plan.outside(recorded);
    let is_complete = !is_new
        && differing.is_none()
        && fates.nothing_changed()
        && plan.items.iter().all(|item| item.is_kept)
        && plan.has_rejected(recorded, &outside)
        && base.pairs == options.pairs.as_ref().map(|list| list.hash().to_owned());
    if is_complete {
        let out = transaction.root().to_owned();
        transaction.finish()?;
        return already_complete(&out, &plan, kept_seed);
    }
    // Nothing is read for labels that may not be lost.
    let labels = fates.labels(base.masks.clone(), base.label_pairs.clone(), None);
    refuse_losses(&transaction, &labels.lost, options)?;

    let plan_hash = plan.hash(
        &settings,
        options,
        transaction.base().map_or(0, |base| base.version),
    );
    let before = fates.rewritten();
    let shards = plan.shards(&before);
    let mut tally = Tally {
        skipped: plan.skipped.clone(),
        quarantine: plan.rejected.clone(),
        ..Tally::default()
    };
    let total: usize = shards.iter().map(|(_, items)| items.len()).sum();
    progress.begin("ingest", Some(total as u64));
    let facts = shard_facts(options, &plan_hash);
    let mut of = before;
    of.extend(
        shards
            .iter()
            .filter_map(|(name, _)| Some((name.split?, name.of))),
    );
    tally.tables = fates.shards(&transaction, &of, &facts)?;
    let mut made = Vec::new();
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
        made.push((name.clone(), entry.clone()));
        tally.take(entry, notes);
    }
    let contents = equal::contents(&transaction, &made)?;
    let moves = plan.moves(recorded, options.seed, &contents);
    if !moves.is_empty() {
        equal::move_rows(&transaction, &made, &mut tally.tables, &moves, &facts)?;
        tally.follow(moves);
    }
    tally.staying = fates
        .staying()
        .map(|(id, split)| (id.to_string(), split))
        .collect();
    let accounting = tally.accounting(plan.num_items(), &outside, fates.num_elsewhere());
    progress.finish(&format!(
        "{} sources: {} ingested, {} quarantined, {} skipped",
        accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
    ));
    let mut labels = fates.labels(base.masks, base.label_pairs, Some(&tally.ingested));
    labels.follow(&tally.splits(&shards));
    refuse_losses(&transaction, &labels.lost, options)?;
    let mut growth = fates.report(&plan, &tally.ingested);
    growth.lost = labels.lost;
    growth.labels = [
        (MaskRow::TABLE, labels.masks.len()),
        (PairRow::TABLE, labels.pairs.len()),
    ]
    .into_iter()
    .filter(|(_, count)| *count > 0)
    .map(|(table, count)| (table.to_owned(), count as u64))
    .collect();

    let (made, dropped_pairs) = tally.pairs(&shards);
    let mut pairs: BTreeMap<String, PairRow> = BTreeMap::new();
    let rows = labels.pairs.into_iter().chain(made);
    pairs.extend(rows.map(|row| (row.id.clone(), row)));
    let known: Vec<PairRow> = pairs.values().cloned().collect();
    let listed = tally.listed_pairs(&shards, options.pairs.as_ref(), &known);
    pairs.extend(listed.rows.into_iter().map(|row| (row.id.clone(), row)));
    let pairs: Vec<PairRow> = pairs.into_values().collect();
    let masks = tally.masks(labels.masks);
    tally.quarantine.extend(outside.quarantine);
    tally.quarantine.sort_by(|a, b| a.path.cmp(&b.path));
    tally.skipped.extend(outside.skipped);
    tally.skipped.sort_by(|a, b| a.path.cmp(&b.path));

    let motions = tally.tables.get(MotionRow::TABLE).into_iter().flatten();
    let licenses = license::count(transaction.root(), motions)?;
    let mut label_problems = tally.label_problems(&plan);
    label_problems.extend(fates.label_problems(&plan, base.label_problems));
    label_problems.sort();
    label_problems.dedup();
    let mut tables = tally.tables;
    let quarantine = transaction.write_shards(None, &tally.quarantine, &facts)?;
    tables.insert(QuarantineRow::TABLE.to_owned(), quarantine);
    let skipped = transaction.write_shards(None, &tally.skipped, &facts)?;
    tables.insert(SkippedRow::TABLE.to_owned(), skipped);
    if !pairs.is_empty() {
        let files = write_present(&transaction, |row: &PairRow| row.split, &pairs, &facts)?;
        tables.insert(PairRow::TABLE.to_owned(), files);
    }
    if !masks.is_empty() {
        let files = write_present(&transaction, |row: &MaskRow| row.split, &masks, &facts)?;
        tables.insert(MaskRow::TABLE.to_owned(), files);
    }
    let composed = transaction
        .base()
        .into_iter()
        .flat_map(|base| base.tables.keys());
    let composed: BTreeSet<String> = composed
        .filter(|table| is_composed(table))
        .cloned()
        .collect();
    let carried = if differing.is_none() && fates.nothing_changed() {
        composed
    } else {
        growth.dropped_tables = composed.into_iter().collect();
        BTreeSet::new()
    };
    let mut facts = BTreeMap::from([
        (LICENSES_FACT.to_owned(), json(&licenses)),
        (LABEL_PROBLEMS_FACT.to_owned(), json(&label_problems)),
        (SEED_FACT.to_owned(), options.seed.0.to_string()),
        ("fps".to_owned(), rate_name(options)),
        ("files".to_owned(), plan.files.len().to_string()),
        ("dropped_pairs".to_owned(), dropped_pairs.to_string()),
        (SETTINGS_FACT.to_owned(), settings.text()),
        (SOURCES_FACT.to_owned(), plan.all_sources(recorded)),
    ]);
    if let Some(list) = &options.pairs {
        facts.insert(PAIRS_FACT.to_owned(), list.hash().to_owned());
    }
    if !plan.remarks.is_empty() {
        facts.insert(REMARKS_FACT.to_owned(), plan.remarks.join("; "));
    }
    if !listed.refused.is_empty() {
        facts.insert(REFUSED_PAIRS_FACT.to_owned(), json(&listed.refused));
    }
    let dataset = transaction.commit(Commit {
        tables,
        plan_hash,
        skeleton: options.read.skeleton.clone(),
        accounting: Some(accounting.clone()),
        facts,
        fresh: true,
        carried,
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
        skipped: counted(&tally.skipped),
        quarantine: tally.quarantine,
        resumed_shards: tally.resumed_shards,
        already_complete: false,
        growth: (!is_new).then_some(growth),
    })
}

/// Whether a table is composed of motions by a stage that can make it again.
fn is_composed(table: &str) -> bool {
    let of_ingestion = [
        MaskRow::TABLE,
        PairRow::TABLE,
        QuarantineRow::TABLE,
        SkippedRow::TABLE,
    ];
    !SHARDED.contains(&table) && !of_ingestion.contains(&table)
}

fn refuse_losses(
    transaction: &Transaction,
    lost: &[LostLabel],
    options: &IngestOptions,
) -> Result<(), Error> {
    const SHOWN: usize = 5;
    if lost.is_empty() || options.drop_labels {
        return Ok(());
    }
    let shown: Vec<String> = lost
        .iter()
        .take(SHOWN)
        .map(|label| format!("{} of {} ({})", label.id, label.table, label.reason))
        .collect();
    Err(Error::LabelsLost {
        path: transaction.root().to_owned(),
        count: lost.len(),
        shown: shown.join(", "),
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
