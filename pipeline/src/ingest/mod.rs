//! From folders of motion files to a committed `motions` dataset.
//!
//! The run is planned before any work: every file is listed and hashed, its split drawn and its
//! shard fixed, so the result depends neither on the order in which threads finish nor on how often
//! the run was interrupted. A bad file becomes a row of the `quarantine` table and the rest goes on.

mod added;
mod alike;
mod deal;
mod equal;
mod fates;
mod forecast;
mod growth;
mod id_list;
mod identity;
mod inputs;
mod job;
mod list;
mod options;
mod places;
mod plan;
mod recorded;
mod report;
mod rows;
mod run;
mod shard;
mod sources;
mod split_by;
mod split_list;
mod stored;
mod taken_out;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use datasets_spec::dataset::Staging;
use datasets_spec::license;
use datasets_spec::manifest::Manifest;
use datasets_spec::record::MotionRow;
use datasets_spec::store::{ByPath, Store};
use datasets_spec::table::Row;
use datasets_spec::{Progress, Resample, Seed, Transaction};
use formats::source::ReadOptions;

use self::fates::Fates;
use self::list::{Listed, list_sources};
use self::options::{SEED_FACT, SHARED_SETTINGS, Settings};
pub(crate) use self::places::Places;
use self::plan::Plan;
use self::recorded::{Base, Recorded};
use self::report::already_complete;
use self::run::{Pieces, Run};
use self::sources::Known;
use crate::Error;

pub use self::alike::AlikeClips;
pub(crate) use self::deal::SHARD_SOURCES as SHARD_CLIPS;
pub use self::forecast::{Forecast, SourceForecast, forecast};
pub use self::growth::{Growth, LostLabel};
pub use self::id_list::IdList;
pub use self::job::plan_ingest;
pub(crate) use self::job::{JOB, open_job};
pub(crate) use self::list::labelled as with_label;
pub use self::options::{IngestOptions, REMARKS_FACT};
pub(crate) use self::recorded::{MergedSources, recorded_settings};
pub use self::report::IngestReport;
pub use self::sources::SourceArg;
pub(crate) use self::sources::{list_each, list_files};
pub use self::split_by::SplitBy;
pub use self::split_list::SplitList;
pub use self::stored::{PlannedMotion, PlannedSource};

/// Reads every motion under `sources` and commits them as a dataset at `out`.
///
/// Run again after an interruption it continues; run again after success it changes nothing. Where the
/// dataset exists, it grows: only files that are new or changed are read, and clips keep their ids, splits and
/// labels. Sources that are not given stay as they are, and clips whose files are gone stay unless
/// [`IngestOptions::prune`] says otherwise.
/// `holder` is what another run is told while this one holds the lock.
///
/// # Errors
/// A source does not exist, or it cannot be known which one it is; there is no file at all; the dataset is locked or
/// was made with other settings; labels would be lost; or writing fails. Faulty files are listed in the report and are
/// no error.
pub fn ingest<S: Clone + Into<SourceArg>>(
    sources: &[S],
    out: &Path,
    options: &IngestOptions,
    holder: &str,
    progress: &dyn Progress,
) -> Result<IngestReport, Error> {
    let listed = listed(sources, out, progress)?;
    // A run with nothing to read leaves no folder behind.
    if Staging::newest_version(&ByPath, out)? == 0 {
        let known = Known {
            out,
            recorded: &Recorded::default(),
            places: &Places::default(),
        };
        known.names(&listed, &mut Vec::new())?;
    }
    let transaction = Transaction::begin(out, holder)?;
    ingest_listed(transaction, listed, options, progress)
}

/// [`ingest`] within a transaction that has begun.
///
/// # Errors
/// As [`ingest`].
pub fn ingest_in<S: Clone + Into<SourceArg>>(
    transaction: Transaction,
    sources: &[S],
    options: &IngestOptions,
    progress: &dyn Progress,
) -> Result<IngestReport, Error> {
    let listed = listed(sources, transaction.root(), progress)?;
    ingest_listed(transaction, listed, options, progress)
}

fn listed<S: Clone + Into<SourceArg>>(
    sources: &[S],
    out: &Path,
    progress: &dyn Progress,
) -> Result<Vec<Listed>, Error> {
    let sources: Vec<SourceArg> = sources.iter().cloned().map(Into::into).collect();
    list_sources(&sources, Some(out), progress)
}

fn ingest_listed(
    transaction: Transaction,
    listed: Vec<Listed>,
    options: &IngestOptions,
    progress: &dyn Progress,
) -> Result<IngestReport, Error> {
    let (store, root) = (transaction.store(), transaction.root());
    let prepared = Prepared::of(store.as_ref(), root, transaction.base(), options)?;
    prepared.refuse_other_settings(root)?;
    let plan = prepared.plan(store, root, listed, progress)?;
    prepared.conclude(transaction, &plan, Pieces::Make, progress)
}

/// What a run knows before it identifies its sources.
struct Prepared {
    options: IngestOptions,
    settings: Settings,
    base: Base,
    /// Where the sources of the dataset were found.
    places: Places,
    is_new: bool,
    /// The settings that differ from those the dataset was made with, in words.
    differing: Option<String>,
    /// Those of them that are one for all clips of a dataset.
    must_agree: Option<String>,
    /// Remarks where the dataset keeps splits that were drawn otherwise than asked for.
    kept: Vec<String>,
}

impl Prepared {
    /// Reads what the dataset at `root` holds.
    ///
    /// # Errors
    /// It cannot be read.
    fn of(
        store: &dyn Store,
        root: &Path,
        base: Option<&Manifest>,
        options: &IngestOptions,
    ) -> Result<Self, Error> {
        options.fps.map_or(Ok(()), IngestOptions::check_fps)?;
        let (options, kept) = effective(base, options);
        let settings = Settings::of(&options);
        let recorded = Base::read(root, base)?;
        let is_new = recorded.is_none();
        let base = recorded.unwrap_or_default();
        let differing = |only| match is_new {
            true => None,
            false => {
                let in_words = |name: &str| match name {
                    "splits" => options
                        .splits
                        .as_ref()
                        .map(|list| list.changes(&base.recorded)),
                    "ids" => options
                        .ids
                        .as_ref()
                        .map(|list| format!("now chooses {}", list.shown())),
                    _ => None,
                };
                settings.differing(base.settings.as_ref(), only, &in_words)
            }
        };
        let mut places = match is_new {
            true => Places::default(),
            false => Places::read(store, root)?,
        };
        let names = base
            .recorded
            .sources
            .iter()
            .map(|source| source.name.as_str());
        places.retain(&names.collect());
        Ok(Self {
            differing: differing(None),
            must_agree: differing(Some(&SHARED_SETTINGS[..])),
            options,
            settings,
            base,
            places,
            is_new,
            kept,
        })
    }

    /// Refuses other settings than those of the dataset, unless a new version was asked for.
    fn refuse_other_settings(&self, root: &Path) -> Result<(), Error> {
        match &self.differing {
            Some(differing) if !self.options.new_version => Err(Error::OtherSettings {
                path: root.to_owned(),
                differing: differing.clone(),
            }),
            _ => Ok(()),
        }
    }

    /// The settings that differ and that are one for all clips of a dataset, in words.
    fn must_agree(&self) -> Option<&str> {
        self.must_agree.as_deref()
    }

    fn plan(
        &self,
        store: Arc<dyn Store>,
        out: &Path,
        listed: Vec<Listed>,
        progress: &dyn Progress,
    ) -> Result<Plan, Error> {
        let recorded = &self.base.recorded;
        let known = Known {
            out,
            recorded,
            places: &self.places,
        };
        let (mut sources, mut remarks) = known.identify(listed)?;
        if self.differing.is_some() && self.options.new_version {
            // Clips of a dataset are all read with the same settings.
            let (others, said) = known.others(&sources, progress)?;
            sources.extend(others);
            sources.sort_by(|(a, _), (b, _)| a.label.name.cmp(&b.label.name));
            remarks.extend(said);
        }
        Plan::make(
            store,
            (sources, remarks),
            &self.options,
            recorded,
            self.differing.is_none(),
            progress,
        )
    }

    /// The places of the sources, with those of a plan.
    fn places_with(&self, plan: &Plan) -> Places {
        let mut places = self.places.clone();
        places.record(&plan.given);
        places
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
        let fates = Fates::of(plan, recorded, self.options.prune);
        let places = self.places_with(plan);
        let outside = plan.outside(recorded);
        let is_same = self.differing.is_none();
        let pairs = self
            .options
            .pairs
            .as_ref()
            .map(|list| list.hash().to_owned());
        let is_complete = !self.is_new
            && is_same
            && fates.nothing_changed()
            && plan.items.iter().all(|item| item.is_kept)
            && plan.has_rejected(recorded, &outside)
            && plan.has_known_sources(recorded)
            && self.base.pairs == pairs;
        let mut report = if is_complete {
            let out = transaction.root().to_owned();
            places.write(transaction.store().as_ref(), &out)?;
            transaction.finish()?;
            let mut growth = fates.report(plan, &BTreeSet::new());
            growth.count(&run::labels(&self.base, &fates));
            IngestReport {
                growth: Some(growth),
                ..already_complete(&out, plan)?
            }
        } else {
            let run = Run::new(transaction, &self, plan, (fates, &places));
            let (report, growth) = run.finish(outside, is_same, pieces, progress)?;
            IngestReport {
                growth: (!self.is_new).then_some(growth),
                ..report
            }
        };
        let warning = license::warning(&report.licenses);
        report.remarks.extend(plan.choice.iter().cloned());
        report
            .remarks
            .extend(self.kept.iter().cloned().chain(warning));
        Ok(report)
    }
}

/// The options as a run uses them, and remarks where splits stay as the dataset was made with.
fn effective(base: Option<&Manifest>, options: &IngestOptions) -> (IngestOptions, Vec<String>) {
    let (seed, kept_seed) = split_seed(base, options.seed);
    let (split_by, kept_by) = split_by(base, options.split_by);
    let options = IngestOptions {
        seed,
        split_by: Some(split_by),
        read: ReadOptions {
            // The published stride rule counts the file's own frames.
            rate: options.fps.filter(|_| options.resample == Resample::Exact),
            ..options.read.clone()
        },
        ..options.clone()
    };
    (options, kept_seed.into_iter().chain(kept_by).collect())
}

/// What splits are drawn by, and a remark if it is not what was asked for.
fn split_by(base: Option<&Manifest>, asked: Option<SplitBy>) -> (SplitBy, Option<String>) {
    let recorded = SplitBy::recorded(base);
    let kept = recorded
        .zip(asked)
        .filter(|(recorded, asked)| recorded != asked);
    let remark = kept.map(|(recorded, asked)| {
        format!(
            "the splits were drawn by {recorded} when the dataset was made and stay as they are; ingest into a new folder to \
             draw them by {asked}"
        )
    });
    (recorded.or(asked).unwrap_or_default(), remark)
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
