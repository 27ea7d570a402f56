//! Fates of the clips of a dataset that grows. A clip is removed only if pruning was requested.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::dataset::ShardName;
use datasets_spec::manifest::FileEntry;
use datasets_spec::{MotionId, Split, Transaction};

use super::growth::Growth;
use super::plan::Plan;
use super::recorded::{Recorded, RecordedClip};
use crate::Error;
use crate::clip_table::rewrite;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fate {
    /// The clip's source is not among those of this run, or cannot be read now.
    Elsewhere,
    Kept,
    /// The motion is the same, but it is read again: a label, a setting or another clip of its file changed.
    ReadAgain,
    /// The clip is read again because its file changed. If the file then gives the same motion, the fate is `ReadAgain`.
    Changed,
    /// The clip's file is missing, and the clip stays.
    Missing,
    /// The file no longer gives the clip, and the clip stays as it was.
    Unusable,
    /// The file could not be read this time, which says nothing about the clip: it stays, also if pruning is asked for.
    Unread,
    /// The clip is removed, because its file is missing or no longer gives it.
    Pruned {
        is_there: bool,
    },
}

/// How a clip fared that was read again.
#[derive(Clone, Copy)]
pub(super) enum Reread {
    Ingested,
    /// Its file gives the recorded motion.
    Same,
    /// Its file no longer gives it.
    Refused,
    /// It could not be read this time, which says nothing about its file.
    Unread,
}

impl Reread {
    /// How a clip fared whose file gave a motion with this hash.
    pub(super) fn with(clip: &RecordedClip, content: &str) -> Self {
        match clip.has_motion() && clip.content == content {
            true => Self::Same,
            false => Self::Ingested,
        }
    }
}

#[derive(Clone)]
pub(super) struct Fates<'a> {
    recorded: &'a Recorded,
    fates: Vec<Fate>,
    of_id: BTreeMap<&'a str, usize>,
    /// Whether to remove clips that their files no longer give.
    prune: bool,
    /// Shards that were planned to be written again, in their order.
    rewritten: Vec<usize>,
}

/// Files of tables that are written shard by shard, by table.
pub(super) type Files = BTreeMap<String, Vec<FileEntry>>;

impl<'a> Fates<'a> {
    pub(super) fn of(plan: &Plan, recorded: &'a Recorded, prune: bool) -> Self {
        let clips = recorded.clips.iter();
        let unread = plan.unread_files();
        let is_unread = |clip: &RecordedClip| unread.contains(clip.path.as_str());
        let fates = clips.map(|clip| match plan.fate(recorded, clip) {
            Fate::Unusable if is_unread(clip) => Fate::Unread,
            fate if is_unread(clip) => fate,
            Fate::Unusable if prune => Fate::Pruned { is_there: true },
            Fate::Missing if prune => Fate::Pruned { is_there: false },
            fate => fate,
        });
        let mut fates: Vec<Fate> = fates.collect();
        for item in &plan.items {
            let Some(index) = item.known else { continue };
            let is_same_file = || plan.hash_of(item) == recorded.clips[index].hash;
            fates[index] = match item.is_kept {
                true => Fate::Kept,
                false if is_same_file() => Fate::ReadAgain,
                false => Fate::Changed,
            };
        }
        let clips = recorded.clips.iter().enumerate();
        let mut fates = Self {
            recorded,
            fates,
            of_id: clips
                .map(|(index, clip)| (clip.id.as_str(), index))
                .collect(),
            prune,
            rewritten: Vec::new(),
        };
        fates.rewritten = fates.broken().into_iter().map(|(shard, _)| shard).collect();
        fates
    }

    /// Decides the fate of clips that were read again. Those that were not ingested stay unchanged, or are pruned if
    /// their files no longer give them.
    pub(super) fn settle(&mut self, reread: impl Fn(&RecordedClip) -> Reread) {
        for (clip, fate) in self.recorded.clips.iter().zip(&mut self.fates) {
            if !matches!(fate, Fate::ReadAgain | Fate::Changed) {
                continue;
            }
            match reread(clip) {
                Reread::Ingested => {}
                Reread::Same => *fate = Fate::ReadAgain,
                Reread::Refused if self.prune => *fate = Fate::Pruned { is_there: true },
                Reread::Refused => *fate = Fate::Unusable,
                Reread::Unread => *fate = Fate::Unread,
            }
        }
    }

    /// Fate of a clip; `None` if the dataset did not have it.
    pub(super) fn of_clip(&self, id: &MotionId) -> Option<Fate> {
        self.of_id.get(id.as_str()).map(|&index| self.fates[index])
    }

    /// Clips whose files changed.
    pub(super) fn changed(&self) -> impl Iterator<Item = &'a str> + '_ {
        let clips = self.recorded.clips.iter().zip(&self.fates);
        let changed = clips.filter(|(_, fate)| **fate == Fate::Changed);
        changed.map(|(clip, _)| clip.id.as_str())
    }

    fn stays(&self, index: usize) -> bool {
        !matches!(
            self.fates[index],
            Fate::ReadAgain | Fate::Changed | Fate::Pruned { .. }
        )
    }

    pub(super) fn staying(&self) -> impl Iterator<Item = &'a RecordedClip> + '_ {
        let clips = self.recorded.clips.iter().enumerate();
        clips
            .filter(|(index, _)| self.stays(*index))
            .map(|(_, clip)| clip)
    }

    /// Clips that stay although no item of this run gives them: they are elsewhere, missing, unusable or unread.
    pub(super) fn beside(&self) -> impl Iterator<Item = &'a MotionId> + '_ {
        let clips = self.recorded.clips.iter().zip(&self.fates);
        let stay = clips.filter(|(_, fate)| {
            use Fate::{Elsewhere, Missing, Unread, Unusable};
            matches!(fate, Elsewhere | Missing | Unusable | Unread)
        });
        stay.map(|(clip, _)| &clip.id)
    }

    pub(super) fn nothing_changed(&self) -> bool {
        (0..self.fates.len()).all(|index| self.stays(index))
    }

    /// The shards of which some but not all clips stay, each with the clips that stay.
    fn broken(&self) -> Vec<(usize, BTreeSet<&'a str>)> {
        let mut staying: BTreeMap<usize, BTreeSet<&str>> = BTreeMap::new();
        let mut broken = BTreeSet::new();
        for (index, clip) in self.recorded.clips.iter().enumerate() {
            let staying = staying.entry(clip.shard).or_default();
            if self.stays(index) {
                staying.insert(clip.id.as_str());
            } else {
                broken.insert(clip.shard);
            }
        }
        staying.retain(|shard, _| broken.contains(shard));
        staying
            .into_iter()
            .filter(|(_, ids)| !ids.is_empty())
            .collect()
    }

    /// Number of shards of each split that are planned to be written again.
    pub(super) fn rewritten(&self) -> BTreeMap<Split, usize> {
        let mut counts = BTreeMap::new();
        for shard in &self.rewritten {
            let split = self.recorded.shards[*shard].split;
            *counts.entry(split).or_default() += 1;
        }
        counts
    }

    /// Returns the files of the clips that stay. Shards of which all clips stay are kept. Of other shards, the rows
    /// that stay are written again: under the number that was planned for the shard, or after all others if none was
    /// planned. `of` counts the shards of each split that this run writes, and is raised for those after all others.
    pub(super) fn shards(
        &self,
        transaction: &Transaction,
        of: &mut BTreeMap<Split, usize>,
        facts: &[(&str, String)],
    ) -> Result<Files, Error> {
        let mut files = Files::new();
        let planned: BTreeSet<usize> = self.rewritten.iter().copied().collect();
        let mut rest: BTreeMap<usize, Staying<'_>> = BTreeMap::new();
        for clip in self.staying() {
            let staying = rest.entry(clip.shard).or_default();
            staying.insert(clip.id.as_str(), clip.source);
        }
        let broken: BTreeSet<usize> = self.broken().into_iter().map(|(shard, _)| shard).collect();
        let is_whole = |shard: &usize| !broken.contains(shard) && !planned.contains(shard);
        for shard in rest.keys().filter(|shard| is_whole(shard)) {
            for (table, file) in &self.recorded.shards[*shard].files {
                let files = files.entry((*table).to_owned()).or_default();
                files.push(file.clone());
            }
        }
        let mut write = |shard: usize, (index, of): (usize, usize), ids: &Staying<'_>| {
            let shard = &self.recorded.shards[shard];
            let name_of = |source: usize| self.recorded.sources[source].name.as_str();
            let stays = |id: &MotionId| ids.get(id.as_str()).copied().map(name_of);
            for (table, file) in &shard.files {
                let name = ShardName {
                    table,
                    split: Some(shard.split),
                    index,
                    of,
                };
                let written = rewrite(transaction, &name, file, facts, &stays)?;
                let files = files.entry((*table).to_owned()).or_default();
                files.extend(written);
            }
            Ok::<(), Error>(())
        };
        let mut next: BTreeMap<Split, usize> = BTreeMap::new();
        for shard in &self.rewritten {
            let split = self.recorded.shards[*shard].split;
            let index = next.entry(split).or_default();
            let ids = rest.get(shard).cloned().unwrap_or_default();
            let number = (*index, of.get(&split).copied().unwrap_or(0));
            write(*shard, number, &ids)?;
            *index += 1;
        }
        for (shard, ids) in rest {
            if broken.contains(&shard) && !planned.contains(&shard) {
                let split = self.recorded.shards[shard].split;
                let next = of.entry(split).or_default();
                write(shard, (*next, *next + 1), &ids)?;
                *next += 1;
            }
        }
        Ok(files)
    }

    /// Counts of the fates. `plan` is the plan that the fates were computed from.
    pub(super) fn report(&self, plan: &Plan, ingested: &BTreeSet<String>) -> Growth {
        let with = |wanted: fn(Fate) -> bool| -> Vec<String> {
            let clips = self.recorded.clips.iter().zip(&self.fates);
            let found = clips.filter(|(_, fate)| wanted(**fate));
            found.map(|(clip, _)| clip.id.to_string()).collect()
        };
        let moved = plan.items.iter().filter(|item| {
            let clip = item.known.map(|index| &self.recorded.clips[index]);
            let is_elsewhere = clip.is_some_and(|clip| clip.path != item.entry.file);
            is_elsewhere && ingested.contains(&item.id)
        });
        let new = ingested
            .iter()
            .filter(|id| !self.of_id.contains_key(id.as_str()));
        Growth {
            new: new.count() as u64,
            kept: self.staying().count() as u64,
            read_again: with(|fate| fate == Fate::ReadAgain),
            changed: with(|fate| fate == Fate::Changed),
            moved: moved.map(|item| item.id.clone()).collect(),
            missing: with(|fate| fate == Fate::Missing),
            kept_unusable: with(|fate| fate == Fate::Unusable),
            kept_unread: with(|fate| fate == Fate::Unread),
            pruned: with(|fate| matches!(fate, Fate::Pruned { .. })),
            ..Growth::default()
        }
    }
}

impl Plan {
    /// Fate of a recorded clip that is not among the items of this run, in a run that does not prune.
    fn fate(&self, recorded: &Recorded, clip: &RecordedClip) -> Fate {
        let is_there = self.sources.contains_key(&clip.path);
        // A member of an archive that is refused alone is listed by its own path.
        let is_refused = self.notes.unlisted.contains(&clip.path);
        match self.is_of_run(&recorded.sources[clip.source].name, &clip.path) {
            false => Fate::Elsewhere,
            true if is_refused => Fate::Elsewhere,
            true if is_there => Fate::Unusable,
            true => Fate::Missing,
        }
    }

    /// Whether a recorded path belongs to a source of this run, and can be read if it exists. `name` is the name of its
    /// source.
    pub(super) fn is_of_run(&self, name: &str, path: &str) -> bool {
        let mut given = self.notes.given.iter();
        let Some(given) = given.find(|given| given.label.name == name) else {
            return false;
        };
        match self.sources.get(path) {
            _ if self.notes.staying.contains(path) => false,
            Some(source) => source.hash.is_ok(),
            None => given.is_whole && self.unlisted_around(path).is_none(),
        }
    }
}

/// Clips that stay, with the numbers of their sources.
type Staying<'a> = BTreeMap<&'a str, usize>;
