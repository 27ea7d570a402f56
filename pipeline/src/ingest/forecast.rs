//! Forecast of a run, made without writing anything.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::dataset::Staging;
use datasets_spec::store::ByPath;
use datasets_spec::{Progress, Split};
use serde::Serialize;

use super::fates::{Fate, Fates};
use super::growth::LostLabel;
use super::list::list_given;
use super::options::IngestOptions;
use super::plan::Plan;
use super::prepared::Prepared;
use super::recorded::Recorded;
use super::sources::SourceArg;
use crate::Error;
use crate::annotation::pairs::RefusedLine;

/// Forecast of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Forecast {
    /// Every source that would be read.
    pub sources: Vec<SourceForecast>,
    /// Settings that differ from those the dataset was made with, with both values.
    pub settings: Option<String>,
    /// Masks and pairs that would be lost, with the clip and what happens to it.
    pub lost: Vec<LostLabel>,
    /// Number of automatic masks and pairs that would be removed with clips that change or go, by table.
    pub removed: BTreeMap<String, u64>,
    /// Lines of the list of splits that would give no clip a split.
    pub refused_splits: Vec<RefusedLine>,
    /// Remarks on sources and splits.
    pub remarks: Vec<String>,
    /// Reasons why this run would be refused.
    pub refusals: Vec<String>,
}

/// Forecast of the clips of a source. Files are compared by their hashes. Of clips that the dataset has, those whose
/// files changed are read; the others are not, so some of them may still be quarantined.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SourceForecast {
    /// Name of the source.
    pub name: String,
    /// Whether the source is new to the dataset.
    pub is_new: bool,
    /// Files without a motion.
    pub skipped: u64,
    /// Files that are rejected without being read as motions.
    pub quarantined: u64,
    /// Clips that the dataset does not have.
    pub new: Vec<String>,
    /// Clips whose motions changed.
    pub changed: Vec<String>,
    /// Clips that are read again although their motions did not change.
    pub read_again: Vec<String>,
    /// Clips whose files lie elsewhere now, with the new paths.
    pub moved: BTreeMap<String, String>,
    /// Clips that stay unchanged.
    pub equal: Vec<String>,
    /// Clips whose files are missing; the clips stay in the dataset.
    pub missing: Vec<String>,
    /// Clips whose files exist and no longer give them; the clips stay in the dataset.
    pub kept_unusable: Vec<String>,
    /// Clips that would be removed.
    pub pruned: Vec<String>,
}

/// Forecasts the result of [`ingest`](super::ingest) with the same arguments. Nothing is written, and nothing is
/// locked. Ranges of masks at another rate, and words that files no longer give, are known only once all clips are read.
///
/// # Errors
/// A source does not exist or is ambiguous, or the dataset cannot be read. Other reasons to refuse the run are in
/// [`Forecast::refusals`].
pub fn forecast<S: Clone + Into<SourceArg>>(
    sources: &[S],
    out: &Path,
    options: &IngestOptions,
    progress: &dyn Progress,
) -> Result<Forecast, Error> {
    let listed = list_given(sources, out, progress)?;
    let store = ByPath::store();
    let newest = Staging::newest(store.as_ref(), out)?;
    let prepared = Prepared::of(store.as_ref(), out, newest.as_ref(), options)?;
    let plan = prepared.plan(store, out, listed, progress)?;
    let recorded = &prepared.base.recorded;
    let mut fates = Fates::of(&plan, recorded, options.prune);
    let changed: BTreeSet<String> = fates.changed().map(str::to_owned).collect();
    prepared.settle_now(&plan, &mut fates, &changed, progress);
    let mut lost = prepared.labels(&fates);
    lost.follow(&plan.splits_now(recorded));
    let mut refusals = Vec::new();
    let mut refuse = |checked: Result<(), Error>| {
        refusals.extend(checked.err().map(|error| error.to_string()));
    };
    refuse(prepared.refuse_other_settings(out));
    if options.new_version {
        refuse(prepared.refuse_mixture(out, &fates));
    }
    refuse(prepared.refuse_common_ids(out, &plan, &fates));
    refuse(prepared.refuse_loss(out, &lost));
    Ok(Forecast {
        sources: plan.forecast(recorded, &fates),
        settings: prepared.differing,
        lost: lost.lost,
        removed: lost.removed,
        refused_splits: plan.notes.refused_splits.clone(),
        remarks: plan
            .all_remarks()
            .into_iter()
            .chain(prepared.kept)
            .collect(),
        refusals,
    })
}

impl Plan {
    /// The split of every clip, if all planned ones are ingested.
    pub(super) fn splits_now<'a>(&'a self, recorded: &'a Recorded) -> BTreeMap<&'a str, Split> {
        let known = recorded.clips.iter();
        let known = known.map(|clip| (clip.id.as_str(), clip.split));
        // Of several motions with one id, the first is ingested. Reversed, it comes last and replaces the others.
        let planned = self.items.iter().rev().filter(|item| !item.is_kept);
        known
            .chain(planned.map(|item| (item.id.as_str(), item.split)))
            .collect()
    }

    fn forecast(&self, recorded: &Recorded, fates: &Fates<'_>) -> Vec<SourceForecast> {
        let mut sources: BTreeMap<&str, SourceForecast> = BTreeMap::new();
        for given in &self.notes.given {
            let name = given.label.name.as_str();
            let source = SourceForecast {
                name: name.to_owned(),
                is_new: !recorded.sources.contains(&given.label),
                ..SourceForecast::default()
            };
            sources.insert(name, source);
        }
        for item in self.items.iter().filter(|item| item.known.is_none()) {
            if let Some(source) = sources.get_mut(self.source_name(&item.entry.file)) {
                source.new.push(item.id.clone());
            }
        }
        let known = self
            .items
            .iter()
            .filter_map(|item| Some((item.known?, item)));
        let known: BTreeMap<usize, _> = known.collect();
        for (index, clip) in recorded.clips.iter().enumerate() {
            let name = recorded.sources[clip.source].name.as_str();
            let Some(source) = sources.get_mut(name) else {
                continue;
            };
            let id = clip.id.to_string();
            if let Some(item) = known
                .get(&index)
                .filter(|item| item.entry.file != clip.path)
            {
                source.moved.insert(id.clone(), item.entry.file.clone());
            }
            match fates.of_clip(&clip.id) {
                Some(Fate::Kept | Fate::Elsewhere | Fate::Unread) | None => source.equal.push(id),
                Some(Fate::ReadAgain) => source.read_again.push(id),
                Some(Fate::Changed) => source.changed.push(id),
                Some(Fate::Missing) => source.missing.push(id),
                Some(Fate::Unusable) => source.kept_unusable.push(id),
                Some(Fate::Pruned { .. }) => source.pruned.push(id),
            }
        }
        for row in &self.rejected {
            if let Some(source) = sources.get_mut(row.source_name.as_str()) {
                source.quarantined += 1;
            }
        }
        for row in &self.skipped {
            if let Some(source) = sources.get_mut(row.source_name.as_str()) {
                source.skipped += 1;
            }
        }
        sources.into_values().collect()
    }
}
