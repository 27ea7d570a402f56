//! From folders of motion files to a committed `motions` dataset.
//!
//! The run is planned before any work: every file is listed and hashed, its split drawn and its
//! shard fixed, so the result depends neither on the order in which threads finish nor on how often
//! the run was interrupted. A bad file becomes a row of the `quarantine` table and the rest goes on.

mod added;
mod equal;
mod growth;
mod id_list;
mod identity;
mod inputs;
mod job;
mod list;
mod options;
mod plan;
mod recorded;
mod report;
mod rows;
mod run;
mod shard;
mod sources;
mod split_list;
mod stored;
mod taken_out;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use datasets_spec::license;
use datasets_spec::manifest::Manifest;
use datasets_spec::record::MotionRow;
use datasets_spec::store::Store;
use datasets_spec::table::Row;
use datasets_spec::{Progress, Resample, Seed, Transaction};

use self::growth::Fates;
use self::options::{SEED_FACT, Settings};
use self::plan::Plan;
use self::recorded::Base;
use self::report::already_complete;
use self::run::{Pieces, Run};
use crate::Error;
use crate::source::ReadOptions;

pub use self::growth::{Growth, LostLabel};
pub use self::id_list::IdList;
pub use self::job::plan_ingest;
pub(crate) use self::job::{JOB, open_job};
pub(crate) use self::list::{labelled as with_label, read_head};
pub use self::options::{IngestOptions, REMARKS_FACT};
pub(crate) use self::plan::SHARD_SOURCES as SHARD_CLIPS;
pub(crate) use self::recorded::{merged_facts, recorded_settings};
pub use self::report::IngestReport;
pub(crate) use self::sources::list_files;
pub use self::split_list::SplitList;
pub use self::stored::{PlannedMotion, PlannedSource};

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
    let prepared = Prepared::of(transaction.root(), transaction.base(), options)?;
    let plan = prepared.plan(transaction.store(), sources, progress)?;
    prepared.conclude(transaction, &plan, Pieces::Make, progress)
}

/// What a run knows before it lists its sources.
struct Prepared {
    options: IngestOptions,
    settings: Settings,
    base: Base,
    is_new: bool,
    /// Whether the dataset was made with the same settings.
    is_same: bool,
    /// A remark where the dataset keeps another seed than the one asked for.
    kept_seed: Option<String>,
}

impl Prepared {
    /// Reads what the dataset at `root` holds.
    ///
    /// # Errors
    /// It was made with other settings, or cannot be read.
    fn of(root: &Path, base: Option<&Manifest>, options: &IngestOptions) -> Result<Self, Error> {
        options.fps.map_or(Ok(()), IngestOptions::check_fps)?;
        let (options, kept_seed) = effective(base, options);
        let settings = Settings::of(&options);
        let recorded = Base::read(root, base)?;
        let is_new = recorded.is_none();
        let base = recorded.unwrap_or_default();
        let differing = match is_new {
            true => None,
            false => settings.differing(base.settings.as_ref(), &|name| match name {
                "splits" => options
                    .splits
                    .as_ref()
                    .map(|list| list.changes(&base.recorded)),
                "ids" => options
                    .ids
                    .as_ref()
                    .map(|list| format!("now chooses {}", list.shown())),
                _ => None,
            }),
        };
        if let (Some(differing), false) = (&differing, options.new_version) {
            return Err(Error::OtherSettings {
                path: root.to_owned(),
                differing: differing.clone(),
            });
        }
        Ok(Self {
            options,
            settings,
            base,
            is_new,
            is_same: differing.is_none(),
            kept_seed,
        })
    }

    fn plan(
        &self,
        store: Arc<dyn Store>,
        sources: &[PathBuf],
        progress: &dyn Progress,
    ) -> Result<Plan, Error> {
        let recorded = &self.base.recorded;
        Plan::make(
            store,
            sources,
            &self.options,
            recorded,
            self.is_same,
            progress,
        )
    }

    /// Carries a plan out.
    fn conclude(
        self,
        transaction: Transaction,
        plan: &Plan,
        pieces: Pieces,
        progress: &dyn Progress,
    ) -> Result<IngestReport, Error> {
        let recorded = &self.base.recorded;
        let fates = Fates::of(plan, recorded);
        let outside = plan.outside(recorded);
        let is_as_before = self.is_same && fates.nothing_changed();
        let is_complete = !self.is_new
            && is_as_before
            && plan.items.iter().all(|item| item.is_kept)
            && plan.has_rejected(recorded, &outside)
            && self.base.pairs
                == self
                    .options
                    .pairs
                    .as_ref()
                    .map(|list| list.hash().to_owned());
        let mut report = if is_complete {
            let out = transaction.root().to_owned();
            transaction.finish()?;
            already_complete(&out, plan)?
        } else {
            let run = Run::new(transaction, &self, plan, &fates);
            let (report, growth) = run.finish(outside, is_as_before, pieces, progress)?;
            IngestReport {
                growth: (!self.is_new).then_some(growth),
                ..report
            }
        };
        let warning = license::warning(&report.licenses);
        let kept_seed = self.kept_seed.clone();
        report.remarks.extend(plan.choice.iter().cloned());
        report.remarks.extend(kept_seed.into_iter().chain(warning));
        Ok(report)
    }
}

/// The options as a run uses them, and a remark where it keeps another seed than the one asked for.
fn effective(base: Option<&Manifest>, options: &IngestOptions) -> (IngestOptions, Option<String>) {
    let (seed, kept_seed) = split_seed(base, options.seed);
    let options = IngestOptions {
        seed,
        read: ReadOptions {
            // The published stride rule counts the file's own frames.
            rate: options.fps.filter(|_| options.resample == Resample::Exact),
            ..options.read.clone()
        },
        ..options.clone()
    };
    (options, kept_seed)
}

/// The seed of the splits, and a remark if it is not the one asked for: a dataset that is there
/// keeps its own, so that no clip moves.
fn split_seed(base: Option<&Manifest>, asked: Seed) -> (Seed, Option<String>) {
    let recorded = base
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
