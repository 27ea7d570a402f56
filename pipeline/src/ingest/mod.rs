//! From folders of motion files to a committed `motions` dataset.
//!
//! The run is planned before any work: every file is listed and hashed, its split drawn and its shard fixed, so the
//! result depends neither on the order in which threads finish nor on how often the run was interrupted. A bad file
//! becomes a row of the `quarantine` table and the run continues.

mod added;
mod alike;
mod content;
mod deal;
mod fates;
mod forecast;
mod growth;
mod id_list;
mod identity;
mod inputs;
mod job;
mod kept;
mod known;
mod list;
mod options;
mod places;
mod plan;
mod prepared;
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
mod unread;

use std::path::Path;

use datasets_spec::dataset::Staging;
use datasets_spec::store::ByPath;
use datasets_spec::{Progress, Transaction};

use self::known::Known;
use self::list::{Listed, list_given};
pub(crate) use self::places::Places;
use self::prepared::Prepared;
use self::recorded::Recorded;
use self::run::Pieces;
use crate::Error;

pub use self::alike::AlikeClips;
pub(crate) use self::deal::SHARD_SOURCES as SHARD_CLIPS;
pub use self::forecast::{Forecast, SourceForecast, forecast};
pub use self::growth::{Growth, LostLabel};
pub use self::id_list::IdList;
pub use self::job::plan_ingest;
pub(crate) use self::job::{JOB, open_job};
pub(crate) use self::list::{
    labelled as with_label, list_each, list_files, quarantine_row, reason_beside, without_extension,
};
pub use self::options::{IngestOptions, REMARKS_FACT};
pub(crate) use self::recorded::{MergedSources, recorded_settings};
pub use self::report::{IngestNotes, IngestReport};
pub(crate) use self::shard::guarded;
pub use self::sources::SourceArg;
pub use self::split_by::SplitBy;
pub use self::split_list::SplitList;

/// Reads every motion under `sources` and commits them as a dataset at `out`.
///
/// A second run continues an interrupted one, and changes nothing after a successful one. An existing dataset grows:
/// only files that are new or changed are read, and clips keep their ids, splits and labels. Sources that are not given
/// stay as they are, and clips whose files are gone stay unless [`IngestOptions::prune`] says otherwise. `holder` is
/// reported to other runs while this one holds the lock.
///
/// # Errors
/// A source does not exist or is ambiguous; there is no file at all; the dataset is locked or was made with other
/// settings; labels would be lost; or writing fails. Faulty files are listed in the report and are not an error.
pub fn ingest<S: Clone + Into<SourceArg>>(
    sources: &[S],
    out: &Path,
    options: &IngestOptions,
    holder: &str,
    progress: &dyn Progress,
) -> Result<IngestReport, Error> {
    let listed = list_given(sources, out, progress)?;
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
    let listed = list_given(sources, transaction.root(), progress)?;
    ingest_listed(transaction, listed, options, progress)
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
