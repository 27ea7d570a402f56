//! Options of a run and contents of its dataset, known before the sources are identified.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use datasets_spec::manifest::Manifest;
use datasets_spec::record::MotionRow;
use datasets_spec::store::Store;
use datasets_spec::table::Row;
use datasets_spec::{Progress, Resample, Seed};
use formats::source::ReadOptions;

use super::deal::SHARD_SOURCES;
use super::fates::{Fates, Reread};
use super::growth::LostLabel;
use super::kept::Labels;
use super::known::Known;
use super::list::{Listed, without_extension};
use super::options::{IngestOptions, SEED_FACT, SHARED_SETTINGS, Settings};
use super::places::Places;
use super::plan::Plan;
use super::recorded::{Base, Recorded};
use super::shard::Done;
use super::split_by::SplitBy;
use super::split_list::SplitList;
use super::unread::is_passing;
use crate::Error;
use crate::names::some_of;
use crate::versions::check_lost;

pub(super) struct Prepared {
    pub(super) options: IngestOptions,
    pub(super) settings: Settings,
    pub(super) base: Base,
    /// Where the sources of the dataset were found.
    places: Places,
    pub(super) is_new: bool,
    /// The settings that differ from those the dataset was made with, in words.
    pub(super) differing: Option<String>,
    /// The differing settings that must be the same for all clips of a dataset.
    pub(super) must_agree: Option<String>,
    /// Remarks on splits that the dataset keeps although they were drawn in another way than requested.
    pub(super) kept: Vec<String>,
}

impl Prepared {
    /// Reads what the dataset at `root` holds.
    pub(super) fn of(
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
        let (splits, ids) = (options.splits.as_ref(), options.ids.as_ref());
        let in_words = |name: &str| match name {
            "splits" => splits.map(|list| list.changes(&base.recorded)),
            "ids" => ids.map(|list| format!("now chooses {}", list.shown())),
            _ => None,
        };
        let differing = |only| match is_new {
            true => None,
            false => settings.differing(base.settings.as_ref(), only, &in_words),
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

    /// Refuses settings that differ from those of the dataset, unless a new version was requested.
    pub(super) fn refuse_other_settings(&self, root: &Path) -> Result<(), Error> {
        match &self.differing {
            Some(differing) if !self.options.new_version => Err(Error::refused(format!(
                "{} was made with other settings: {differing}; choose another folder, or pass --new-version to read \
                 everything again with the new ones",
                root.display()
            ))),
            _ => Ok(()),
        }
    }

    pub(super) fn plan(
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
            // All clips of a dataset are read with the same settings, so sources that were not given are read again
            // too.
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

    pub(super) fn places_with(&self, plan: &Plan) -> Places {
        let mut places = self.places.clone();
        places.record(&plan.notes.given);
        places
    }

    /// Labels of the dataset that are kept, and those that are lost.
    pub(super) fn labels(&self, fates: &Fates<'_>) -> Labels {
        fates.labels(self.base.masks.clone(), self.base.label_pairs.clone())
    }

    /// The fates that can be foreseen. Changed clips whose labels would be lost are read now: a clip keeps them if its
    /// file gives the same motion, or no longer gives any.
    pub(super) fn foreseen<'a>(
        &self,
        plan: &Plan,
        fates: &Fates<'a>,
        progress: &dyn Progress,
    ) -> Fates<'a> {
        let mut foreseen = fates.clone();
        // Lost labels refuse nothing then.
        if self.options.drop_labels {
            return foreseen;
        }
        let mut read = BTreeSet::new();
        // A pair may be lost by its second clip once the first is known to be the same.
        loop {
            let lost = self.labels(&foreseen).lost.into_iter();
            let mut clips: BTreeSet<String> = lost.map(|label| label.clip).collect();
            clips.retain(|clip| read.insert(clip.clone()));
            if clips.is_empty() {
                return foreseen;
            }
            self.settle_now(plan, &mut foreseen, &clips, progress);
        }
    }

    /// Reads some of the clips that are read again, and decides their fates.
    pub(super) fn settle_now(
        &self,
        plan: &Plan,
        fates: &mut Fates<'_>,
        clips: &BTreeSet<String>,
        progress: &dyn Progress,
    ) {
        let clips: BTreeSet<&str> = clips.iter().map(String::as_str).collect();
        let items = plan.items_with_ids(&clips);
        if items.is_empty() {
            return;
        }
        progress.begin("compare", Some(items.len() as u64));
        let mut met: BTreeMap<String, Result<String, Reread>> = BTreeMap::new();
        // The motions of more clips may not fit into memory.
        for items in items.chunks(SHARD_SOURCES) {
            let done = plan.read_items(items, &self.options, progress);
            met.extend(items.iter().zip(done).map(|(item, done)| {
                let found = match done {
                    Done::Clip(rows, _) => Ok(rows.motion.content_hash),
                    Done::Rejected(row) if is_passing(&row) => Err(Reread::Unread),
                    Done::Rejected(_) | Done::Skipped(_) => Err(Reread::Refused),
                };
                (item.planned.id.clone(), found)
            }));
        }
        progress.finish(&format!("{} clips of files that changed", items.len()));
        fates.settle(|clip| match met.get(clip.id.as_str()) {
            Some(Ok(content)) => Reread::with(clip, content),
            Some(Err(why)) => *why,
            None => Reread::Ingested,
        });
    }

    /// Refuses a run after which two clips would have one id.
    pub(super) fn refuse_common_ids(
        &self,
        root: &Path,
        plan: &Plan,
        fates: &Fates<'_>,
    ) -> Result<(), Error> {
        let made = plan.items.iter().filter(|item| !item.is_kept);
        let made = made.map(|item| item.id.as_str());
        let staying = fates.staying().map(|clip| clip.id.as_str());
        let mut ids = BTreeSet::new();
        let Some(id) = made.chain(staying).find(|id| !ids.insert(*id)) else {
            return Ok(());
        };
        let reason = format!(
            "two clips of {} would have the id {id}; nothing was changed. If `stance verify` finds it twice in this dataset, or \
             in one that is a source, go back to a version of that one without it (`stance dataset versions`, `stance dataset \
             restore`)",
            root.display()
        );
        Err(Error::coded("E-COMMON-ID", id, reason))
    }

    pub(super) fn refuse_loss(&self, root: &Path, labels: &Labels) -> Result<(), Error> {
        check_lost(root, &labels.lost, self.options.drop_labels)
    }

    /// Refuses to lose what the files of clips no longer say about them, unless that is allowed.
    pub(super) fn refuse_gone(&self, root: &Path, gone: &[LostLabel]) -> Result<(), Error> {
        if self.options.drop_labels || gone.is_empty() {
            return Ok(());
        }
        let shown: Vec<String> = gone
            .iter()
            .map(|label| format!("{} of {}", label.table, label.clip))
            .collect();
        Err(Error::refused(format!(
            "the files of {} no longer give {}; nothing was changed. Put the files with labels back, or pass --drop-labels \
             to go on without them (the version before keeps them)",
            root.display(),
            some_of(shown.iter().map(String::as_str))
        )))
    }

    /// Refuses the run if it would keep clips that were read with another value of a setting that all clips must share.
    pub(super) fn refuse_mixture(&self, root: &Path, fates: &Fates<'_>) -> Result<(), Error> {
        const SHOWN: usize = 5;
        let staying: Vec<_> = fates.beside().collect();
        let Some(differing) = self.must_agree.as_ref().filter(|_| !staying.is_empty()) else {
            return Ok(());
        };
        let shown: Vec<&str> = staying.iter().take(SHOWN).map(|id| id.as_str()).collect();
        let reason = format!(
            "{} clips of {} cannot be read again with the new settings ({differing}): {}; nothing was changed. Put \
             their files back, keep the settings, or pass --prune to leave these clips out",
            staying.len(),
            root.display(),
            shown.join(", ")
        );
        Err(Error::coded("E-MIXTURE", root.display(), reason))
    }
}

impl SplitList {
    /// The recorded clips whose split the list changes, in words.
    fn changes(&self, recorded: &Recorded) -> String {
        let moved: Vec<String> = recorded
            .clips
            .iter()
            .filter_map(|clip| {
                let stem = without_extension(&clip.path);
                let names = [clip.id.as_str(), clip.id.source_clip(), &clip.path, stem];
                let line = self.line_of(&names.map(str::to_owned).into())?;
                let split = self.split(line);
                (split != clip.split).then(|| format!("{} ({}, now {split})", clip.id, clip.split))
            })
            .collect();
        match moved.is_empty() {
            true => "has other lines, which move none of its clips by their ids".to_owned(),
            false => format!("moves {}", some_of(moved.iter().map(String::as_str))),
        }
    }
}

/// The options as a run uses them, and remarks on splits that stay as they were drawn when the dataset was made.
pub(super) fn effective(
    base: Option<&Manifest>,
    options: &IngestOptions,
) -> (IngestOptions, Vec<String>) {
    // An existing dataset keeps its seed and grouping, so that no clip moves.
    let seed = base
        .filter(|base| base.plans.contains_key(MotionRow::TABLE))
        .and_then(|base| base.facts.get(SEED_FACT)?.parse().ok().map(Seed));
    let split_by = SplitBy::recorded(base);
    let with_seed = |seed: Seed| format!("with seed {}", seed.0);
    let kept_seed = kept_splits(seed, Some(options.seed), with_seed);
    let kept_by = kept_splits(split_by, options.split_by, |by| format!("by {by}"));
    let options = IngestOptions {
        seed: seed.unwrap_or(options.seed),
        split_by: Some(split_by.or(options.split_by).unwrap_or_default()),
        read: ReadOptions {
            // The published stride rule counts the file's own frames, so the reader must not resample them.
            rate: options.fps.filter(|_| options.resample == Resample::Exact),
            ..options.read.clone()
        },
        ..options.clone()
    };
    (options, kept_seed.into_iter().chain(kept_by).collect())
}

/// A remark if splits stay as they were drawn although another way of drawing them is asked for. `way` puts a way into
/// words.
fn kept_splits<T: PartialEq>(
    recorded: Option<T>,
    asked: Option<T>,
    way: impl Fn(T) -> String,
) -> Option<String> {
    let (recorded, asked) = recorded.zip(asked)?;
    (recorded != asked).then(|| {
        format!(
            "the splits were drawn {} when the dataset was made and stay as they are; ingest into a new folder to \
             draw them {}",
            way(recorded),
            way(asked)
        )
    })
}
