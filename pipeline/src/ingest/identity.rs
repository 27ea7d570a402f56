//! Ids and splits of motions. Once assigned, both are kept.

use std::collections::{BTreeMap, BTreeSet};

use clip::LabelProblem;
use datasets_spec::record::{QuarantineRow, SkippedRow};
use datasets_spec::{Seed, Split};
use formats::source::{Entry, Format, escaped};

use super::alike::Alike;
use super::list::{path_of, without_extension};
use super::plan::{Plan, Planned};
use super::recorded::{Recorded, RecordedClip};
use super::shard::PIECE_STAGE;
use super::split_by::SplitBy;
use super::taken_out::NOT_CHOSEN;
use crate::names::free;
use crate::recordings::{Groups, source_clip};
use crate::versions::taken_out;

/// Whether a motion of a release may be a recorded clip. The clip's id is this prefix and the motion's id.
type IsWanted<'a> = dyn Fn(&Planned, &str) -> bool + 'a;

impl Plan {
    /// Finds the motions that the dataset has, and gives the others ids.
    ///
    /// A motion is the clip that was read from the same path; otherwise the clip of the same source whose file had the
    /// same content and is no longer at its path; otherwise, in a release, the clip of the same source with the same id.
    /// Motions that the dataset quarantined or skipped are refused again as long as none of their inputs has changed.
    pub(super) fn identify(&mut self, recorded: &Recorded, same_settings: bool) {
        // A clip whose file cannot be read now stays unchanged.
        let (sources, remarks) = (&self.sources, &mut self.notes.remarks);
        self.rejected.retain(|row| {
            let source = sources.get(&row.path);
            let unreadable = source.is_some_and(|source| source.hash.is_err());
            let stays = unreadable && recorded.clips.iter().any(|clip| clip.path == row.path);
            if stays {
                remarks.push(format!("{} stays as it was: {}", row.path, row.reason));
            }
            !stays
        });
        let mut items = std::mem::take(&mut self.items);
        self.leave_out(&mut items, recorded);
        if same_settings {
            self.refuse_again(&mut items, recorded);
        }
        self.recognise(&mut items, recorded, same_settings);
        let known = recorded.clips.iter();
        let mut taken: BTreeSet<String> = known.map(|clip| clip.id.to_string()).collect();
        self.name_releases(&mut items, &mut taken);
        let problems = take_named_ids(&mut items, &mut taken);
        self.notes.label_problems.extend(problems);
        name_single_files(&mut items, &taken);
        self.items = items;
    }

    /// Takes over the rows of items that were quarantined or skipped and have not changed.
    fn refuse_again(&mut self, items: &mut Vec<Planned>, recorded: &Recorded) {
        // Items that could not be read may be readable now. A failed piece may have failed because of one of its
        // motions, so all are tried again.
        let quarantine = recorded.quarantine.iter();
        let quarantine = quarantine.filter(|row| row.code != "E-IO" && row.stage != PIECE_STAGE);
        let quarantine: BTreeMap<(&str, &str), &QuarantineRow> = quarantine
            .map(|row| ((row.path.as_str(), row.inputs_hash.as_str()), row))
            .collect();
        // Clips that an earlier run did not choose, or that were taken out, may be chosen now.
        let skipped = recorded.skipped.iter();
        let skipped = skipped.filter(|row| row.reason != NOT_CHOSEN && taken_out(row).is_none());
        let skipped: BTreeMap<(&str, &str), &SkippedRow> = skipped
            .map(|row| ((row.path.as_str(), row.inputs_hash.as_str()), row))
            .collect();
        items.retain(|item| {
            let path = path_of(&item.entry.file, &item.entry.key);
            let place = (path.as_str(), item.inputs.as_str());
            let (quarantined, skipped) = (quarantine.get(&place), skipped.get(&place));
            self.rejected.extend(quarantined.copied().cloned());
            self.skipped.extend(skipped.copied().cloned());
            let is_left = quarantined.is_some() || skipped.is_some();
            if is_left {
                self.notes.left_out.push(item.entry.clone());
            }
            !is_left
        });
    }

    fn recognise(&self, items: &mut [Planned], recorded: &Recorded, same_settings: bool) {
        let mut by_path: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (index, clip) in recorded.clips.iter().enumerate() {
            by_path.entry(&clip.path).or_default().push(index);
        }
        let moved = self.moved_files(items, recorded);
        let clips = recorded.clips.iter().enumerate();
        let by_id: BTreeMap<&str, usize> = clips
            .map(|(index, clip)| (clip.id.as_str(), index))
            .collect();
        let mut claimed: BTreeSet<usize> = BTreeSet::new();
        // Most motions of a release have the id that the release gives them. All of these come first, because the id
        // of another may end alike.
        for (is_moved, is_exact) in [(false, true), (false, false), (true, true), (true, false)] {
            for item in items.iter_mut().filter(|item| item.known.is_none()) {
                let file = item.entry.file.as_str();
                let path = match is_moved {
                    true => moved.get(file).map(String::as_str),
                    false => Some(file),
                };
                let Some(path) = path else { continue };
                let found = match is_exact {
                    true => by_id.get(item.entry.id.as_str()).copied(),
                    false => by_path.get(path).and_then(|there| {
                        let mut there = there.iter().copied();
                        there.find(|index| {
                            let id = recorded.clips[*index].id.as_str();
                            item.is_of(id) && !claimed.contains(index)
                        })
                    }),
                };
                let found = found.filter(|index| recorded.clips[*index].path == path);
                if let Some(index) = found.filter(|index| claimed.insert(*index)) {
                    item.resume(index, &recorded.clips[index], same_settings && !is_moved);
                }
            }
        }
        self.recognise_by_id(items, recorded, &mut claimed);
    }

    /// Recognises the remaining motions of releases by source and id, because datasets rename a shard when a clip in it
    /// changes. If several motions could be one clip, none is.
    fn recognise_by_id(
        &self,
        items: &mut [Planned],
        recorded: &Recorded,
        claimed: &mut BTreeSet<usize>,
    ) {
        let mut prefixes: BTreeMap<usize, BTreeSet<String>> = BTreeMap::new();
        for item in items.iter().filter(|item| item.known.is_some()) {
            if let Some(release) = item.release {
                let of_release = prefixes.entry(release).or_default();
                of_release.insert(item.prefix.clone());
            }
        }
        let of_release = |item: &Planned| {
            let release = item.release.as_ref();
            release.and_then(|release| prefixes.get(release))
        };
        // The only prefix of the release's other clips comes first, then none.
        let is_only = |item: &Planned, prefix: &str| {
            of_release(item).is_some_and(|known| known.len() == 1 && known.contains(prefix))
        };
        let is_none = |_: &Planned, prefix: &str| prefix.is_empty();
        let is_any = |item: &Planned, prefix: &str| {
            let is_known = of_release(item).is_some_and(|known| known.contains(prefix));
            is_known || is_prefix_of(item.format, prefix)
        };
        let rounds: [&IsWanted<'_>; 3] = [&is_only, &is_none, &is_any];
        for is_wanted in rounds {
            for (place, index) in self.same_ids(items, recorded, claimed, is_wanted) {
                claimed.insert(index);
                items[place].resume(index, &recorded.clips[index], false);
            }
        }
    }

    /// Pairs of a new motion of a release (its place in `items`) and a recorded clip (its index) of the same source, with
    /// the same id behind a prefix that `is_wanted` accepts. Motions and clips in more than one pair are left out.
    fn same_ids(
        &self,
        items: &[Planned],
        recorded: &Recorded,
        claimed: &BTreeSet<usize>,
        is_wanted: &IsWanted<'_>,
    ) -> Vec<(usize, usize)> {
        let is_new = |item: &Planned| item.release.is_some() && item.known.is_none();
        if !items.iter().any(is_new) {
            return Vec::new();
        }
        // A release may still list a clip at its place although it cannot be read. Then no other motion is that clip.
        let entries = self.releases.iter();
        let entries = entries.flat_map(|(_, release)| &release.contents().entries);
        let listed: BTreeSet<(&str, &str)> = entries
            .map(|entry| (entry.file.as_str(), entry.id.as_str()))
            .collect();
        let mut by_end: BTreeMap<(&str, &str), Vec<usize>> = BTreeMap::new();
        for (index, clip) in recorded.clips.iter().enumerate() {
            let mut ends = ends_of(clip.id.as_str());
            let is_listed = ends.any(|end| listed.contains(&(clip.path.as_str(), end)));
            if is_listed || claimed.contains(&index) {
                continue;
            }
            let source = recorded.sources[clip.source].name.as_str();
            for end in ends_of(clip.id.as_str()) {
                by_end.entry((source, end)).or_default().push(index);
            }
        }
        let mut found: Vec<(usize, usize)> = Vec::new();
        for (place, item) in items.iter().enumerate() {
            if !is_new(item) {
                continue;
            }
            let id = item.entry.id.as_str();
            let there = by_end.get(&(self.source_name(&item.entry.file), id));
            for &index in there.into_iter().flatten() {
                let whole = recorded.clips[index].id.as_str();
                if is_wanted(item, &whole[..whole.len() - id.len()]) {
                    found.push((place, index));
                }
            }
        }
        let mut of_place: BTreeMap<usize, usize> = BTreeMap::new();
        let mut of_clip: BTreeMap<usize, usize> = BTreeMap::new();
        for (place, index) in &found {
            *of_place.entry(*place).or_default() += 1;
            *of_clip.entry(*index).or_default() += 1;
        }
        found.retain(|(place, index)| of_place[place] == 1 && of_clip[index] == 1);
        found
    }

    /// Files that moved within their source, with their previous paths. A file is taken for a recorded one if it has
    /// the same content, nothing lies at the recorded path, and the match is unique.
    fn moved_files(&self, items: &[Planned], recorded: &Recorded) -> BTreeMap<String, String> {
        let known = recorded.paths();
        let mut gone: BTreeMap<(&str, String), BTreeSet<&str>> = BTreeMap::new();
        for clip in &recorded.clips {
            let name = recorded.sources[clip.source].name.as_str();
            let is_gone =
                !self.sources.contains_key(&clip.path) && self.is_of_run(name, &clip.path);
            if is_gone && !clip.hash.is_empty() {
                gone.entry((name, clip.hash.clone()))
                    .or_default()
                    .insert(&clip.path);
            }
        }
        let mut new: BTreeMap<(&str, String), BTreeSet<&str>> = BTreeMap::new();
        for item in items
            .iter()
            .filter(|item| !known.contains(item.entry.file.as_str()))
        {
            let file = item.entry.file.as_str();
            let place = (self.source_name(file), self.hash_of(item));
            new.entry(place).or_default().insert(file);
        }
        let moved = new.into_iter().filter_map(|(place, files)| {
            let before = gone
                .get(&place)
                .filter(|before| before.len() == 1)?
                .first()?;
            let now = files.first().filter(|_| files.len() == 1)?;
            Some(((*now).to_owned(), (*before).to_owned()))
        });
        moved.collect()
    }

    /// As [`Plan::motion_hash`]; empty if a file cannot be read.
    pub(super) fn hash_of(&self, item: &Planned) -> String {
        let hash = self.motion_hash(item.release, &item.entry);
        hash.unwrap_or_default()
    }

    /// BLAKE3 of the file that holds a motion, or over the hashes of all its files; empty if they are not known.
    ///
    /// # Errors
    /// Why a file cannot be read.
    pub(super) fn motion_hash(
        &self,
        release: Option<usize>,
        entry: &Entry,
    ) -> Result<String, String> {
        let files = match release {
            Some(release) => self.releases[release].1.motion_files(entry),
            None => vec![entry.file.as_str()],
        };
        let known = files.into_iter().filter_map(|file| self.sources.get(file));
        let hashes: Vec<&str> = known
            .map(|source| source.hash.as_deref().map_err(Clone::clone))
            .collect::<Result<_, String>>()?;
        Ok(match hashes[..] {
            [] => String::new(),
            [one] => one.to_owned(),
            _ => blake3::hash(hashes.join(" ").as_bytes())
                .to_hex()
                .to_string(),
        })
    }

    /// Gives the new motions of releases their ids: with the prefix of the release's other clips, unless an id is taken.
    fn name_releases(&self, items: &mut [Planned], taken: &mut BTreeSet<String>) {
        for (index, (format, _)) in self.releases.iter().enumerate() {
            let own = items.iter().filter(|item| item.release == Some(index));
            let (known, new): (Vec<&Planned>, Vec<&Planned>) =
                own.partition(|item| item.known.is_some());
            let of_known = known.first().map(|item| item.prefix.clone());
            let mut prefixes = of_known.into_iter().chain(prefixes_of(*format));
            let prefix = prefixes.find(|prefix| {
                let mut ids = new.iter().map(|item| format!("{prefix}{}", item.entry.id));
                ids.all(|id| !taken.contains(&id))
            });
            let prefix = prefix.expect("numbers do not end");
            for item in items.iter_mut().filter(|item| item.release == Some(index)) {
                if item.known.is_none() {
                    item.prefix.clone_from(&prefix);
                    item.id = format!("{prefix}{}", item.entry.id);
                }
                taken.insert(item.id.clone());
            }
        }
    }

    /// Draws or takes over the split of every motion.
    ///
    /// The user's own lists and labels decide first; then a clip keeps the split it has; then a published list decides.
    /// Motions of one group, and motions whose files are equal, share a split: that of the first of them that has one,
    /// otherwise the one drawn from the smallest of their keys. A key depends on neither the label of the source nor
    /// the files beside it, so that growth cannot change it.
    pub(super) fn assign_splits(&mut self, recorded: &Recorded, seed: Seed) {
        let splits = self.splits(recorded, seed, &Alike::default());
        for (item, split) in self.items.iter_mut().zip(splits) {
            let before = item.known.map(|index| recorded.clips[index].split);
            item.is_kept &= before.is_none_or(|before| before == split);
            item.split = split;
        }
    }

    /// Motions of this run whose split changes once every motion is known, by id: similar motions share a split,
    /// whatever their files.
    pub(super) fn moves(
        &self,
        recorded: &Recorded,
        seed: Seed,
        alike: &Alike,
    ) -> BTreeMap<String, Split> {
        let splits = self.splits(recorded, seed, alike);
        let items = self.items.iter().zip(splits);
        items
            .filter(|(item, split)| !item.is_kept && item.split != *split)
            .map(|(item, split)| (item.id.clone(), split))
            .collect()
    }

    /// The splits of all motions. `alike` are those that are equal or nearly so, as far as that is known.
    fn splits(&self, recorded: &Recorded, seed: Seed, alike: &Alike) -> Vec<Split> {
        let mut of_content: BTreeMap<(&str, &str), Option<Split>> = BTreeMap::new();
        for clip in &recorded.clips {
            let split = of_content
                .entry((&clip.hash, key_of(clip.id.as_str())))
                .or_default();
            split.get_or_insert(clip.split);
        }
        let mut first_key: BTreeMap<(String, &str), usize> = BTreeMap::new();
        let mut first_alike: BTreeMap<usize, usize> = BTreeMap::new();
        let texts: Vec<String> = self.items.iter().map(|item| self.split_key(item)).collect();
        // In this order, the smallest index in a group is that of the key from which the group's split is drawn.
        let mut names: Vec<(&str, &str)> =
            texts.iter().map(|key| (drawn_by(key), &**key)).collect();
        names.sort_unstable();
        names.dedup();
        let keys = texts.iter().map(|key| (drawn_by(key), &**key));
        let keys = keys.map(|key| names.partition_point(|name| *name < key));
        let keys: Vec<usize> = keys.collect();
        let mut groups = Groups::new(names.len());
        for (item, &key) in self.items.iter().zip(&keys) {
            let hash = self.hash_of(item);
            let motion = match item.release {
                Some(_) => item.entry.id.as_str(),
                None => item.entry.key.as_str(),
            };
            if !hash.is_empty() {
                let first = *first_key.entry((hash, motion)).or_insert(key);
                groups.unite(first, key);
            }
            if let Some(class) = alike.class(&item.id) {
                let first = *first_alike.entry(class).or_insert(key);
                groups.unite(first, key);
            }
        }
        let ids = self.items.iter().map(|item| item.id.as_str());
        let by_id: BTreeMap<&str, usize> = ids.zip(keys.iter().copied()).collect();
        for (item, &key) in self.items.iter().zip(&keys) {
            // Releases name the group of a mirrored clip.
            let original = item.entry.mirrored_of.as_deref();
            let original = original.filter(|_| item.release.is_none());
            if let Some(&first) = original.and_then(|id| by_id.get(id)) {
                groups.unite(first, key);
            }
        }
        // Sources of the split of each motion, the strongest first.
        let reasons: Vec<[Option<Split>; 4]> = self
            .items
            .iter()
            .map(|item| {
                let recorded = item.known.map(|index| recorded.clips[index].split);
                let hash = self.hash_of(item);
                let content = (hash.as_str(), item.entry.key.as_str());
                let single = item.release.is_none() && !content.0.is_empty();
                let copied = of_content.get(&content).copied().flatten();
                let alike = alike.class(&item.id).and_then(|class| alike.split(class));
                let copied = copied.filter(|_| single).or(alike);
                [item.own_split, recorded, item.entry.split, copied]
            })
            .collect();
        let mut given: BTreeMap<usize, Split> = BTreeMap::new();
        for strength in 0..4 {
            for (reasons, key) in reasons.iter().zip(&keys) {
                if let Some(split) = reasons[strength] {
                    given.entry(groups.of(*key)).or_insert(split);
                }
            }
        }
        reasons
            .iter()
            .zip(&keys)
            .map(|([own, recorded, published, _], key)| {
                let group = groups.of(*key);
                own.or(*recorded)
                    .or(*published)
                    .or(given.get(&group).copied())
                    .unwrap_or_else(|| Split::assign(names[group].0, seed))
            })
            .collect()
    }

    /// Adds remarks on clips that no list of their release names, and on those that keep another split than the published
    /// one.
    pub(super) fn note_unpublished(&mut self) {
        let mut unlisted: BTreeMap<(&str, &str), usize> = BTreeMap::new();
        let mut others: Vec<&Planned> = Vec::new();
        for item in self.items.iter().filter(|item| item.own_split.is_none()) {
            let publishes = item
                .release
                .map(|release| self.releases[release].1.contents().publishes_splits);
            let publishes = publishes.filter(|lists| !lists.is_empty());
            match (item.entry.split, publishes) {
                (Some(split), _) if split != item.split => others.push(item),
                (None, Some(lists)) => {
                    let format = (item.format.as_str(), lists);
                    *unlisted.entry(format).or_default() += 1;
                }
                _ => {}
            }
        }
        let unlisted = unlisted.into_iter().map(|((format, lists), count)| {
            format!("{format}: {count} clips are in none of the lists ({lists}) and have no published split")
        });
        let others = others.first().map(|first| {
            let published = first.entry.split.map_or("", Split::as_str);
            format!(
                "{} clips keep the split that they have in the dataset, not the one that their source states (such as {}: {}, stated \
                 {published}); ingest into another folder, or name the splits by --splits, to take those of the source",
                others.len(),
                first.id,
                first.split,
            )
        });
        let remarks: Vec<String> = unlisted.chain(others).collect();
        self.notes.remarks.extend(remarks);
    }

    /// Number of releases of the same format that come before one.
    fn number_in_format(&self, release: usize) -> usize {
        let format = self.releases[release].0;
        let before = self.releases[..release].iter();
        before.filter(|(other, _)| *other == format).count()
    }

    /// The label from which the split of a clip is drawn; `None` if the clip has no such label, or splits are drawn by
    /// clip.
    fn split_label(&self, item: &Planned) -> Option<String> {
        match self.notes.split_by {
            SplitBy::Clip => None,
            SplitBy::Subject => {
                let source = self.source_name(&item.entry.file);
                let subject = item.subject.as_ref()?;
                Some(format!("subject:{source}/{subject}"))
            }
            SplitBy::Action => Some(format!("action:{}", item.action.as_ref()?)),
        }
    }

    /// Adds a remark on how many clips lack the label from which splits are drawn.
    pub(super) fn note_split_labels(&mut self) {
        if self.notes.split_by == SplitBy::Clip {
            return;
        }
        let lacks = |item: &&Planned| self.split_label(item).is_none();
        let count = self.items.iter().filter(lacks).count();
        if count > 0 {
            self.notes.remarks.push(format!(
                "{count} of {} clips state no {by}, and their splits were drawn by clip; a label file, a sidecar or a table of \
                 the source states it",
                self.items.len(),
                by = self.notes.split_by
            ));
        }
    }

    /// Key from which the split of a clip without a published split is drawn.
    pub(super) fn split_key(&self, item: &Planned) -> String {
        if let Some(key) = self.split_label(item).or_else(|| item.group.clone()) {
            return key;
        }
        match item.release {
            // A clip in releases of two formats has one split, so the id prefix is left out. Two releases of one format
            // hold different clips under the same names, unless their content is equal, so the number of the release is
            // added.
            Some(release) => {
                let clip = || source_clip(&item.entry.id);
                let key = item.entry.group.clone().unwrap_or_else(clip);
                match self.number_in_format(release) {
                    0 => key,
                    number => format!("{number}{AMONG_RELEASES}{key}"),
                }
            }
            None => escaped(without_extension(self.unlabelled(&item.entry.file))),
        }
    }
}

/// Separator between a release's number among those of its format and a key. Names have no control characters.
const AMONG_RELEASES: char = '\u{1f}';

/// The part of a key from which its split is drawn: it leaves out the number of the release.
fn drawn_by(key: &str) -> &str {
    key.rsplit(AMONG_RELEASES).next().unwrap_or(key)
}

impl Planned {
    /// Makes the motion that of a recorded clip, with its index. With `may_stay`, the clip is kept if its inputs have
    /// not changed.
    fn resume(&mut self, index: usize, clip: &RecordedClip, may_stay: bool) {
        self.known = Some(index);
        // Captures without a motion, which earlier versions kept, are read again.
        self.is_kept = may_stay && clip.has_motion() && self.inputs == clip.inputs;
        self.id = clip.id.to_string();
        if self.release.is_some() {
            let prefix = self.id.strip_suffix(&self.entry.id);
            self.prefix = prefix.unwrap_or("").to_owned();
        } else {
            self.entry.id.clone_from(&self.id);
        }
    }

    /// Whether the motion is the one that the clip with this id was read from, given that the file is the same.
    pub(super) fn is_of(&self, id: &str) -> bool {
        match self.release {
            Some(_) => id
                .strip_suffix(&self.entry.id)
                .is_some_and(|prefix| prefix.is_empty() || prefix.ends_with('/')),
            None => self.named.as_deref() == Some(id) || key_of(id) == self.entry.key,
        }
    }
}

/// The key in an id, which tells motions of one file apart; empty if the file holds only one.
pub(super) fn key_of(id: &str) -> &str {
    id.split_once('#').map_or("", |(_, key)| key)
}

/// An id without the key of the motion.
fn name_of(id: &str) -> &str {
    id.split_once('#').map_or(id, |(name, _)| name)
}

/// Gives new motions the ids that their sidecars state, and returns the sidecars whose ids cannot be used.
fn take_named_ids(items: &mut [Planned], taken: &mut BTreeSet<String>) -> Vec<LabelProblem> {
    let mut motions: BTreeMap<String, usize> = BTreeMap::new();
    // Ids of motions without such a sidecar, which their paths give.
    let mut of_paths: BTreeSet<String> = BTreeSet::new();
    for item in items.iter() {
        let file = &item.entry.file;
        *motions.entry(file.clone()).or_default() += 1;
        if item.release.is_none() && item.named.is_none() {
            of_paths.insert(escaped(without_extension(file)));
        }
    }
    let problems = items.iter_mut().filter_map(|item| {
        let id = item.named.clone()?;
        let why = match motions[&item.entry.file] {
            _ if item.known.is_some() && item.id == id => return None,
            _ if item.known.is_some() => format!("the dataset has the clip as {}", item.id),
            1 if !of_paths.contains(&id) && taken.insert(id.clone()) => {
                item.id.clone_from(&id);
                item.entry.id = id;
                return None;
            }
            1 => "another clip has it".to_owned(),
            count => format!("the file holds {count} motions"),
        };
        Some(LabelProblem {
            file: item.entry.file.clone(),
            reason: format!("id {id:?} of its sidecar was not used: {why}"),
        })
    });
    problems.collect()
}

/// Gives the other new motions of single files their ids: their path without its extension. Files that differ
/// only in their extension keep it.
fn name_single_files(items: &mut [Planned], taken: &BTreeSet<String>) {
    let mut files: BTreeMap<String, BTreeSet<&str>> = BTreeMap::new();
    for item in items.iter().filter(|item| item.release.is_none()) {
        let file = item.entry.file.as_str();
        files
            .entry(escaped(without_extension(file)))
            .or_default()
            .insert(file);
    }
    let twice: BTreeSet<String> = files
        .into_iter()
        .filter(|(_, files)| files.len() > 1)
        .map(|(stem, _)| stem)
        .collect();
    // A clip of another file may have taken the id.
    let owners: BTreeSet<&str> = taken.iter().map(|id| name_of(id)).collect();
    let mut own: BTreeMap<String, String> = BTreeMap::new();
    for item in items
        .iter()
        .filter(|item| item.release.is_none() && item.known.is_some())
        .filter(|item| key_of(&item.id) == item.entry.key)
    {
        own.insert(item.entry.file.clone(), name_of(&item.id).to_owned());
    }
    let new = items
        .iter_mut()
        .filter(|item| item.release.is_none() && item.id.is_empty());
    for item in new {
        let file = &item.entry.file;
        let stem = escaped(without_extension(file));
        let is_free = |name: &String| !twice.contains(name) && !owners.contains(name.as_str());
        let name = own.get(file).cloned().unwrap_or_else(|| {
            if is_free(&stem) {
                return stem.clone();
            }
            free(&escaped(file), |name| !owners.contains(name))
        });
        item.id = match item.entry.key.as_str() {
            "" => name,
            key => format!("{name}#{key}"),
        };
        item.entry.id.clone_from(&item.id);
    }
}

/// Id prefixes of a release, of which the first that keeps ids unique is used: none, its format, or its format and a
/// number.
fn prefixes_of(format: Format) -> impl Iterator<Item = String> {
    let name = format.as_str();
    let numbered = (2..).map(move |number| format!("{name}-{number}/"));
    [String::new(), format!("{name}/")]
        .into_iter()
        .chain(numbered)
}

/// Whether `prefix` is one of [`prefixes_of`], and not empty.
fn is_prefix_of(format: Format, prefix: &str) -> bool {
    let number = prefix.strip_prefix(format.as_str());
    let number = number.and_then(|rest| rest.strip_suffix('/'));
    number.is_some_and(|number| {
        let digits = number.strip_prefix('-');
        number.is_empty() || digits.is_some_and(|digits| digits.parse::<u32>().is_ok())
    })
}

/// An id, and what follows each of its slashes.
fn ends_of(id: &str) -> impl Iterator<Item = &str> {
    let ends = id.match_indices('/').map(move |(at, _)| &id[at + 1..]);
    std::iter::once(id).chain(ends)
}
