//! Ingestion as a job of many processes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use datasets_spec::dataset::{ShardName, Staging};
use datasets_spec::store::ByPath;
use datasets_spec::{NoProgress, Progress, Split};
use serde::{Deserialize, Serialize};

use super::deal::Dealt;
use super::fates::Fates;
use super::inputs;
use super::list::list_given;
use super::options::{IngestOptions, StoredOptions};
use super::plan::{Plan, Planned};
use super::prepared::{Prepared, effective};
use super::run::{Pieces, piece, shard_facts};
use super::shard::ShardNotes;
use super::sources::SourceArg;
use crate::Error;
use work::{self, CommitOptions, Committed, Draft, Failed, Finished, Job, Made, Piece};

pub(crate) const JOB: &str = "ingest";

/// The shard that a piece makes, and the files that it reads.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Detail {
    split: Split,
    index: usize,
    of: usize,
    /// Numbers of the files that the piece reads.
    sources: Vec<u32>,
}

/// Plans an ingestion for any number of processes: every file is listed and hashed; of the motions, only changed ones with
/// labels of people are read. `out` is the folder of the plan.
///
/// # Errors
/// As [`ingest`](super::ingest), or the folder of the plan is occupied.
pub fn plan_ingest<S: Clone + Into<SourceArg>>(
    sources: &[S],
    destination: &Path,
    options: &IngestOptions,
    out: &Path,
    progress: &dyn Progress,
) -> Result<work::Plan, Error> {
    let store = ByPath::store();
    let listed = list_given(sources, destination, progress)?;
    let newest = Staging::newest(store.as_ref(), destination)?;
    let prepared = Prepared::of(store.as_ref(), destination, newest.as_ref(), options)?;
    prepared.refuse_other_settings(destination)?;
    let plan = prepared.plan(store, destination, listed, progress)?;
    if let Some(path) = plan.files.archives().unpacked() {
        let path = path.display();
        let reason = format!(
            "{path}: the members of a packed tar cannot be read by many processes; unpack it and name its folder, or \
             pack it as zip"
        );
        return Err(Error::coded("E-PACKED-TAR", path, reason));
    }
    let fates = Fates::of(&plan, &prepared.base.recorded, options.prune);
    // Nothing is planned for clips that cannot stay, or for labels that may not be lost.
    prepared.refuse_mixture(destination, &fates)?;
    prepared.refuse_common_ids(destination, &plan, &fates)?;
    let mut labels = prepared.labels(&prepared.foreseen(&plan, &fates, progress));
    labels.follow(&plan.splits_now(&prepared.base.recorded));
    prepared.refuse_loss(destination, &labels)?;
    let version = newest.as_ref().map_or(0, |base| base.version);
    let plan_hash = plan.hash(&prepared.settings, &prepared.options, version);
    let draft = Draft {
        job: JOB,
        settings: serde_json::to_value(StoredOptions::of(options)?)
            .expect("options are numbers and texts"),
        destination: destination.to_owned(),
        is_dataset: true,
        pieces: plan.pieces(&plan_hash, &plan.deal(&fates.rewritten())),
        plan_hash,
        base: Staging::base(&ByPath, destination, newest.as_ref())?,
    };
    Ok(draft.write(out, |folder| Ok(plan.write(folder)?))?)
}

impl Plan {
    /// The pieces that make `shards`, one for each.
    fn pieces(&self, plan_hash: &str, shards: &[Dealt]) -> Vec<Piece> {
        let numbers: BTreeMap<&str, u32> =
            self.sources.keys().map(String::as_str).zip(0..).collect();
        let (motions, others) = self.single_files();
        let single = inputs::files_of_single(&motions, &others, &self.sources);
        let releases: Vec<_> = self
            .releases
            .iter()
            .map(|(_, release)| inputs::files_of_release(release.contents()))
            .collect();
        let mut pieces = Vec::with_capacity(shards.len());
        let mut counted: BTreeSet<&str> = BTreeSet::new();
        for (number, shard) in shards.iter().enumerate() {
            let mut read: BTreeSet<&str> = BTreeSet::new();
            for (place, _) in &shard.items {
                let Planned { entry, release, .. } = &self.items[*place];
                let own = match release {
                    Some(release) => releases[*release].own.get(entry.file.as_str()),
                    None => single.get(entry.file.as_str()),
                };
                let common = release.map(|release| &releases[release].common);
                read.extend(own.into_iter().chain(common).flatten());
            }
            let items = self.items_of(shard);
            let first_read = read.iter().filter(|path| counted.insert(path));
            let bytes = first_read.filter_map(|path| Some(self.sources.get(*path)?.bytes));
            let bytes = bytes.sum();
            let detail = Detail {
                split: shard.name.split.unwrap_or(Split::Train),
                index: shard.name.index,
                of: shard.name.of,
                sources: read
                    .iter()
                    .filter_map(|path| numbers.get(path).copied())
                    .collect(),
            };
            let piece = piece(plan_hash, number, &shard.name, &items);
            pieces.push(piece.with(bytes, &detail));
        }
        pieces
    }
}

pub(crate) fn open_job(plan: &work::Plan) -> Result<Box<dyn Job>, Failed> {
    let stored: StoredOptions = plan.settings()?;
    let given = stored.options()?;
    let store = ByPath::store();
    let newest = Staging::newest(store.as_ref(), plan.destination())?;
    let (options, _) = effective(newest.as_ref(), &given);
    let read = Plan::read(plan.path(), store, &options)?;
    let paths = read.sources.keys().cloned().collect();
    // For each split, the first shard that this run reads; the commit rewrites the shards before it.
    let mut before: BTreeMap<Split, usize> = BTreeMap::new();
    for piece in plan.pieces() {
        let Detail { split, index, .. } = piece.detail()?;
        let first = before.entry(split).or_insert(index);
        *first = index.min(*first);
    }
    Ok(Box::new(Ingestion {
        facts: shard_facts(&options, plan.hash()),
        shards: read.deal(&before),
        paths,
        plan: read,
        given,
        options,
    }))
}

struct Ingestion {
    plan: Plan,
    shards: Vec<Dealt>,
    /// Paths of the sources by number.
    paths: Vec<String>,
    /// Options as given; `options` are those resolved with the dataset's own.
    given: IngestOptions,
    options: IngestOptions,
    facts: [(&'static str, String); 6],
}

impl Ingestion {
    fn shard(&self, piece: &Piece) -> Result<(&Dealt, Detail), Failed> {
        let detail: Detail = piece.detail()?;
        let shard = usize::try_from(piece.number).ok();
        let shard = shard.and_then(|number| self.shards.get(number));
        let is_it = |name: &ShardName| {
            name.split == Some(detail.split) && (name.index, name.of) == (detail.index, detail.of)
        };
        let shard = shard.filter(|shard| is_it(&shard.name)).ok_or_else(|| {
            let name = &piece.name;
            let reason = format!("the tables of the plan do not have {name}; plan again");
            Failed::new("E-PLAN", reason)
        })?;
        Ok((shard, detail))
    }

    fn check(&self, detail: &Detail) -> Result<(), Failed> {
        use rayon::prelude::*;

        let sources = detail.sources.par_iter();
        let paths = sources.filter_map(|number| self.paths.get(*number as usize));
        let found = paths.map(|path| (path, self.plan.is_as_planned(path)));
        let Some((path, found)) = found.find_first(|(_, found)| !matches!(found, Ok(true))) else {
            return Ok(());
        };
        let place = self.plan.files.path(path);
        let place = place.map_or(PathBuf::from(path), Path::to_owned);
        Err(match found {
            Ok(_) => work::Error::SourceChanged { path: place }.into(),
            Err(error) => {
                let place = place.display();
                let reason = format!("cannot read {place}: {error}; make the piece again");
                Failed::new("E-IO", reason)
            }
        })
    }
}

impl Job for Ingestion {
    fn make(&self, piece: &Piece, staging: &Staging) -> Result<Made, Failed> {
        let (shard, detail) = self.shard(piece)?;
        self.check(&detail)?;
        let items = self.plan.items_of(shard);
        if let Some(path) = self.plan.added(&items) {
            return Err(work::Error::SourceChanged { path }.into());
        }
        let (entry, notes) = self.plan.make_shard(
            staging,
            &shard.name,
            &items,
            &self.options,
            &self.facts,
            &NoProgress,
        )?;
        Ok(Made::new(notes.files(&entry).cloned().collect(), &notes))
    }

    fn sample(&self, piece: &Piece, count: u64) -> Result<u64, Failed> {
        let (shard, _) = self.shard(piece)?;
        let items = self.plan.items_of(shard);
        let count = usize::try_from(count).unwrap_or(usize::MAX).max(1);
        // Sample over the whole shard, because neighbouring files are often alike.
        let step = items.len().div_ceil(count).max(1);
        let items: Vec<_> = items.into_iter().step_by(step).collect();
        self.plan.read_items(&items, &self.options, &NoProgress);
        Ok(items.len() as u64)
    }

    fn commit(
        &self,
        plan: &work::Plan,
        pieces: Vec<Finished>,
        options: &CommitOptions,
        progress: &dyn Progress,
    ) -> Result<Committed, work::Error> {
        let transaction = plan.begin(options)?;
        let (store, root) = (transaction.store(), plan.destination());
        let prepared = Prepared::of(store.as_ref(), root, transaction.base(), &self.given)?;
        prepared.refuse_other_settings(root)?;
        let version = transaction.base().map_or(0, |base| base.version);
        let (settings, options) = (&prepared.settings, &prepared.options);
        if self.plan.hash(settings, options, version) != plan.hash() {
            return Err(work::Error::BadPlan {
                path: plan.path().to_owned(),
                reason: "its tables were altered; plan again".to_owned(),
            });
        }
        let taken = pieces.into_iter().map(|finished| {
            let Made { files, notes } = match finished.made {
                Ok(made) => made,
                Err(failed) => return Ok(Err(failed)),
            };
            let notes: ShardNotes = work::notes(plan, &finished.piece, notes)?;
            let shard = files
                .into_iter()
                .next()
                .ok_or_else(|| work::Error::BadPlan {
                    path: plan.path().to_owned(),
                    reason: format!("piece {} has no shard", finished.piece.name),
                })?;
            Ok(Ok((shard, notes)))
        });
        let taken = taken.collect::<Result<Vec<_>, Error>>()?;
        let report = prepared.conclude(transaction, &self.plan, Pieces::Taken(taken), progress)?;
        let notes = serde_json::to_value(&report.notes).expect("counts and texts");
        Ok(Committed {
            notes,
            ..plan.committed(report.dataset.manifest())
        })
    }
}
