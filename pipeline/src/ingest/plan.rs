//! The plan of a run: which motions are read, under which ids, in which splits and shards.

use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use datasets_spec::dataset::ShardName;
use datasets_spec::record::{MotionRow, QuarantineRow};
use datasets_spec::store::Store;
use datasets_spec::table::{Row, SCHEMA_VERSION};
use datasets_spec::{Fps, MotionId, Progress, Split, Transaction};
use rayon::prelude::*;

use super::list::{Source, hash_sources, list_files, quarantine_row};
use super::options::IngestOptions;
use super::split_list::{SplitList, name_of_subject};
use crate::Error;
use crate::annotation::pairs::{PairList, RefusedLine, names_of, originals, style_group};
use crate::clip::Rejected;
use crate::feature::humanml3d;
use crate::source::labels::{self, FolderLabels};
use crate::source::{
    Entry, Files, Format, FoundRelease, Recognised, find_releases, name_of_text, recognise,
    refuse_pointer,
};

/// Version of the rules by which files become rows. It is part of every plan, so a dataset made by
/// older rules is never continued by newer ones.
pub(super) const INGEST_VERSION: u32 = 3;

/// Source items per shard: few enough that every thread can hold a shard in memory.
pub(super) const SHARD_SOURCES: usize = 256;

/// Everything a run will do, known before any motion is read.
pub(super) struct Plan {
    pub(super) files: Files,
    pub(super) sources: BTreeMap<String, Source>,
    pub(super) releases: Vec<FoundRelease>,
    pub(super) items: Vec<Planned>,
    /// Files without a motion, by reason.
    pub(super) skipped: BTreeMap<String, u64>,
    /// Files found broken while planning, and folders that cannot be listed.
    pub(super) rejected: Vec<QuarantineRow>,
    /// Folders that cannot be listed.
    num_unlisted: usize,
    /// What a reader of the dataset should know about its splits.
    pub(super) remarks: Vec<String>,
    /// What folders say of the motions in them.
    pub(super) folder_labels: FolderLabels,
    /// Lines of the list of splits that gave no clip a split.
    pub(super) refused_splits: Vec<RefusedLine>,
}

/// A motion to be read.
pub(super) struct Planned {
    pub(super) entry: Entry,
    pub(super) format: Format,
    /// The release that reads it; none for single files.
    pub(super) release: Option<usize>,
    /// Id prefix that keeps two releases' ids apart.
    pub(super) prefix: String,
    /// Group of clips that share a split; none for a clip outside any group.
    pub(super) group: Option<String>,
    /// Split that its labels state.
    pub(super) labelled_split: Option<Split>,
    /// Subject that its labels state.
    pub(super) subject: Option<String>,
}

impl Planned {
    fn full_id(&self) -> String {
        format!("{}{}", self.prefix, self.entry.id)
    }

    /// Id of the source clip in the dataset, without crop or mirror suffix.
    fn clip(&self) -> String {
        let id = self.full_id();
        MotionId::parse(&id).map_or(id, |id| id.source_clip().to_owned())
    }

    /// Names by which a list of splits means it: its id, that of its source clip, its file, its subject.
    fn names(&self) -> BTreeSet<String> {
        let (entry, subject) = (&self.entry, self.subject.as_deref());
        let file = [entry.file.as_str(), without_extension(&entry.file)];
        let mut names = BTreeSet::from([self.full_id(), self.clip(), entry.id.clone()]);
        names.extend(file.map(str::to_owned));
        names.extend(subject.map(name_of_subject));
        names
    }

    /// Key of the drawn split, for clips without a published one.
    fn split_key(&self) -> String {
        // Two releases of one clip share a split: the id prefix is left out.
        let clip = || {
            let own_id = MotionId::parse(&self.entry.id);
            own_id.map_or(self.entry.id.clone(), |id| id.source_clip().to_owned())
        };
        let group = self.group.as_ref().or(self.entry.group.as_ref());
        group.cloned().unwrap_or_else(clip)
    }
}

/// A motion assigned to a shard.
pub(super) struct Item<'a> {
    pub(super) entry: &'a Entry,
    pub(super) prefix: &'a str,
    pub(super) format: Format,
    pub(super) release: Option<usize>,
    pub(super) split: Split,
    pub(super) id: Result<MotionId, String>,
}

pub(super) type Shards<'a> = Vec<(ShardName, Vec<Item<'a>>)>;

impl Plan {
    pub(super) fn make(
        store: Arc<dyn Store>,
        paths: &[PathBuf],
        options: &IngestOptions,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let listing = list_files(paths)?;
        let mut skipped: BTreeMap<String, u64> = BTreeMap::new();
        for reason in listing.special {
            *skipped.entry(reason).or_default() += 1;
        }
        let unlisted = listing.unlisted.iter().map(|(folder, reason)| {
            let reason = format!("cannot list the folder: {reason}");
            quarantine_row(folder, "", String::new(), Rejected::read("E-IO", reason))
        });
        let rejected: Vec<QuarantineRow> = unlisted.collect();
        let files = Files::on(store, listing.files);
        let sources = hash_sources(&files, progress);
        let mut plan = Self {
            folder_labels: FolderLabels::read(&files),
            refused_splits: Vec::new(),
            releases: find_releases(&files, options.humanml3d_index.as_deref())?,
            files,
            sources,
            items: Vec::new(),
            skipped,
            num_unlisted: rejected.len(),
            rejected,
            remarks: Vec::new(),
        };
        let claimed = plan.take_releases(options);
        plan.take_single_files(&claimed, options);
        plan.take_labels();
        plan.take_own_splits(options.splits.as_ref());
        if let Some(list) = &options.pairs {
            plan.follow_originals(list);
        }
        Ok(plan)
    }

    /// Plans the motions of the releases, and returns the files that are theirs.
    fn take_releases(&mut self, options: &IngestOptions) -> BTreeSet<String> {
        let mut claimed = BTreeSet::new();
        let mut taken = BTreeSet::new();
        for (index, (format, release)) in self.releases.iter().enumerate() {
            let (format, release) = (*format, release.contents());
            let prefix = prefix_of(format, &release.entries, &taken);
            let ids = release.entries.iter();
            taken.extend(ids.map(|entry| format!("{prefix}{}", entry.id)));
            claimed.extend(release.entries.iter().map(|entry| entry.file.clone()));
            if options.format.is_some_and(|only| only != format) {
                let files: BTreeSet<&str> =
                    release.entries.iter().map(|e| e.file.as_str()).collect();
                let reason = format!("{} file, not asked for", format.as_str());
                *self.skipped.entry(reason).or_default() += files.len() as u64;
            } else {
                let entries = release.entries.iter().cloned();
                self.items.extend(entries.map(|entry| Planned {
                    entry,
                    format,
                    release: Some(index),
                    prefix: prefix.clone(),
                    group: None,
                    labelled_split: None,
                    subject: None,
                }));
                self.remarks.extend(release.remarks.iter().cloned());
            }
            for (file, reason) in &release.passed_over {
                if !claimed.insert(file.clone()) {
                    continue;
                }
                match unreadable(&self.sources, file) {
                    Some(row) => self.rejected.push(row),
                    None => *self.skipped.entry(reason.clone()).or_default() += 1,
                }
            }
            for (file, rejected) in &release.rejected {
                if claimed.insert(file.clone()) {
                    let hash = source_hash(&self.sources, file);
                    let row = quarantine_row(file, "", hash, rejected.clone());
                    self.rejected.push(row);
                }
            }
        }
        claimed
    }

    /// Plans every file that no release claims.
    fn take_single_files(&mut self, claimed: &BTreeSet<String>, options: &IngestOptions) {
        for (relative, source) in &self.sources {
            if claimed.contains(relative) {
                continue;
            }
            // Do not guess the format of an unreadable file from its name.
            if let Some(row) = unreadable(&self.sources, relative) {
                self.rejected.push(row);
                continue;
            }
            if let Err(rejected) = refuse_pointer(&source.head) {
                let hash = source.hash.clone().unwrap_or_default();
                let row = quarantine_row(relative, "", hash, rejected);
                self.rejected.push(row);
                continue;
            }
            let format = match recognise(Path::new(relative), &source.head) {
                Recognised::Motion(format) => format,
                Recognised::NotMotion { reason } => {
                    *self.skipped.entry(reason).or_default() += 1;
                    continue;
                }
            };
            if options.format.is_some_and(|only| only != format) {
                let reason = format!("{} file, not asked for", format.as_str());
                *self.skipped.entry(reason).or_default() += 1;
                continue;
            }
            for key in keys_of(format, &source.path) {
                self.items.push(Planned {
                    entry: Entry {
                        file: relative.clone(),
                        id: String::new(),
                        key,
                        split: None,
                        group: None,
                        mirrored_of: None,
                    },
                    format,
                    release: None,
                    prefix: String::new(),
                    group: None,
                    labelled_split: None,
                    subject: None,
                });
            }
        }
        // Files that differ only in their extension keep it in their id.
        let mut seen = BTreeSet::new();
        let mut twice = BTreeSet::new();
        let single = |item: &&Planned| item.release.is_none();
        for item in self.items.iter().filter(single) {
            if seen.insert(item.entry.file.clone()) {
                let stem = without_extension(&item.entry.file).to_owned();
                if !seen.insert(stem.clone()) {
                    twice.insert(stem);
                }
            }
        }
        for item in self.items.iter_mut().filter(|item| item.release.is_none()) {
            let entry = &mut item.entry;
            let stem = without_extension(&entry.file);
            let name = if twice.contains(stem) {
                &entry.file
            } else {
                stem
            };
            entry.id = match entry.key.as_str() {
                "" => name.to_owned(),
                key => format!("{name}#{key}"),
            };
        }
    }

    /// Takes the labels that decide on splits, and gives single files with labels of action and style the
    /// group of their original. A motion is rejected if labels beside it or in its folders cannot be read now:
    /// they may be next time, and the clip might change its split.
    fn take_labels(&mut self) {
        let Self {
            files,
            items,
            folder_labels,
            ..
        } = self;
        let unreadable: Vec<Option<Rejected>> = items
            .par_iter_mut()
            .map(|item| {
                let around = folder_labels.of(files, &item.entry);
                let file = &item.entry.file;
                if item.release.is_some() {
                    let stated = labels::stated(Path::new(file), None, &around);
                    (item.labelled_split, item.subject) = (stated.split, stated.subject);
                    return around.failed;
                }
                let folder = files.path(file).and_then(Path::parent);
                let folder = folder.unwrap_or(Path::new("."));
                let failed = Cell::new(None);
                let companions =
                    |name: &str| match files.read_beside(&folder.join(name_of_text(name))) {
                        Ok(bytes) => bytes,
                        Err(rejected) => {
                            failed.set(Some(rejected));
                            None
                        }
                    };
                let stated = labels::stated(Path::new(file), Some(&companions), &around);
                let styled = stated.action.zip(stated.style);
                item.group = styled.map(|(action, style)| style_group(file, &action, &style));
                (item.labelled_split, item.subject) = (stated.split, stated.subject);
                failed.into_inner().or(around.failed)
            })
            .collect();
        let mut unreadable = unreadable.into_iter();
        let (sources, rejected) = (&self.sources, &mut self.rejected);
        self.items.retain(|item| match unreadable.next().flatten() {
            None => true,
            Some(reason) => {
                let Entry { file, key, .. } = &item.entry;
                let row = quarantine_row(file, key, source_hash(sources, file), reason);
                rejected.push(row);
                false
            }
        });
    }

    /// Gives clips the splits that the user states: those of the list, else those of their labels. All
    /// motions of a source clip get one split, by the first line that names any of them.
    fn take_own_splits(&mut self, list: Option<&SplitList>) {
        let mut lines: BTreeMap<String, usize> = BTreeMap::new();
        let mut stated: BTreeMap<String, Split> = BTreeMap::new();
        let mut known: BTreeSet<String> = BTreeSet::new();
        for item in &self.items {
            let clip = item.clip();
            let names = item.names();
            if let Some(line) = list.and_then(|list| list.line_of(&names)) {
                let first = lines.entry(clip.clone()).or_insert(line);
                *first = line.min(*first);
            }
            if let Some(split) = item.labelled_split {
                stated.entry(clip).or_insert(split);
            }
            if list.is_some() {
                known.extend(names);
            }
        }
        if let Some(list) = list {
            self.refused_splits = list.refused(&known);
            stated.extend(
                lines
                    .into_iter()
                    .map(|(clip, line)| (clip, list.split(line))),
            );
        }
        for item in &mut self.items {
            let own = stated.get(&item.clip()).copied();
            item.entry.split = own.or(item.entry.split);
        }
    }

    /// Puts each styled clip of a pair list, with its copies and crops, into the split of its original.
    /// A published split stays as it is.
    fn follow_originals(&mut self, list: &PairList) {
        let clips: BTreeMap<String, String> = self
            .items
            .iter()
            .map(|item| (item.full_id(), item.clip()))
            .collect();
        let clip_of = |name| names_of(name).find_map(|name| clips.get(name).map(String::as_str));
        let pairs = list.clips().filter_map(|(styled, original)| {
            let (styled, original) = (clip_of(styled)?, clip_of(original)?);
            (styled != original).then_some((styled, original))
        });
        let originals = originals(pairs);
        let wanted: BTreeSet<&str> = originals.values().copied().collect();
        let mut deciding: BTreeMap<&str, (Option<Split>, String)> = BTreeMap::new();
        for item in &self.items {
            if let Some(&clip) = wanted.get(item.clip().as_str()) {
                let key = || (None, item.split_key());
                let (split, _) = deciding.entry(clip).or_insert_with(key);
                *split = split.or(item.entry.split);
            }
        }
        for item in &mut self.items {
            let original = originals.get(item.clip().as_str());
            if let Some((split, key)) = original.and_then(|original| deciding.get(original)) {
                item.entry.split = item.entry.split.or(*split);
                item.group = Some(key.clone());
            }
        }
    }

    /// Source items: motions, and files without one.
    pub(super) fn num_items(&self) -> u64 {
        let skipped: u64 = self.skipped.values().sum();
        self.items.len() as u64 + self.rejected.len() as u64 + skipped
    }

    pub(super) fn hash(&self, options: &IngestOptions) -> String {
        let mut hasher = blake3::Hasher::new();
        let settings = format!(
            "{INGEST_VERSION} {SCHEMA_VERSION} {} {:?} {:?} {:?} {} {:?} {:?} {:?} {}",
            options.made_captions,
            options.fps.map(Fps::get),
            options.resample,
            options.format,
            options.seed.0,
            options.license,
            options.read,
            options.teleports,
            if options.humanml3d_features {
                humanml3d::RECIPE
            } else {
                ""
            },
        );
        let mut take = |part: &str| {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        };
        take(&settings);
        for (relative, source) in &self.sources {
            take(relative);
            take(source.hash.as_deref().unwrap_or(""));
        }
        // The list of motions can depend on more than the files, such as an index elsewhere.
        for item in &self.items {
            take(item.format.as_str());
            take(&item.entry.file);
            take(&item.entry.key);
            take(&item.prefix);
            take(&item.entry.id);
            take(item.entry.split.map_or("", Split::as_str));
            // Datasets without styles keep the plans they had before there were groups.
            if let Some(group) = &item.group {
                take(group);
            }
        }
        if let Some(list) = &options.pairs {
            take(list.hash());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Whether the finished run of this plan failed to read a file that is readable now, so that the plan
    /// must run again.
    pub(super) fn may_read_more_now(&self, transaction: &Transaction) -> bool {
        let Some(base) = transaction.base() else {
            return false;
        };
        let failed = base.accounting.codes.get("E-IO").copied().unwrap_or(0);
        let unreadable = self.sources.values().filter(|source| source.hash.is_err());
        failed > (unreadable.count() + self.num_unlisted) as u64
    }

    /// Deals the motions into shards by split.
    pub(super) fn shards(&self, options: &IngestOptions) -> Shards<'_> {
        let mut by_split: BTreeMap<Split, Vec<Item>> = BTreeMap::new();
        let mut seen = BTreeSet::new();
        for planned in &self.items {
            let entry = &planned.entry;
            let full_id = planned.full_id();
            let id = MotionId::parse(&full_id)
                .map_err(|error| error.to_string())
                .and_then(|id| match seen.insert(full_id) {
                    true => Ok(id),
                    false => Err(format!("another motion has the id {id} already")),
                });
            let split = entry
                .split
                .unwrap_or_else(|| Split::assign(&planned.split_key(), options.seed));
            by_split.entry(split).or_default().push(Item {
                entry,
                prefix: &planned.prefix,
                format: planned.format,
                release: planned.release,
                split,
                id,
            });
        }
        let mut shards = Vec::new();
        for (split, mut items) in by_split {
            let of = items.len().div_ceil(SHARD_SOURCES);
            for index in 0..of {
                let rest = items.split_off(items.len().min(SHARD_SOURCES));
                let name = ShardName {
                    table: MotionRow::TABLE,
                    split: Some(split),
                    index,
                    of,
                };
                shards.push((name, std::mem::replace(&mut items, rest)));
            }
        }
        shards
    }
}

/// Keys of the motions of a single file. The key is empty if the file holds one motion or cannot be
/// read; the reader then reports the error.
fn keys_of(format: Format, path: &Path) -> Vec<String> {
    let whole = || vec![String::new()];
    if !format.may_hold_several() {
        return whole();
    }
    let bytes = fs::read(path).unwrap_or_default();
    let keys = std::panic::catch_unwind(AssertUnwindSafe(|| format.keys(&bytes)));
    let keys = keys.unwrap_or_default();
    if keys.is_empty() { whole() } else { keys }
}

pub(super) fn source_hash(sources: &BTreeMap<String, Source>, relative: &str) -> String {
    let hash = sources.get(relative).map(|source| source.hash.clone());
    hash.and_then(Result::ok).unwrap_or_default()
}

/// The quarantine row of a file that could not be read while planning.
fn unreadable(sources: &BTreeMap<String, Source>, relative: &str) -> Option<QuarantineRow> {
    let reason = sources.get(relative)?.hash.clone().err()?;
    let rejected = Rejected::read("E-IO", format!("cannot read the file: {reason}"));
    Some(quarantine_row(relative, "", String::new(), rejected))
}

fn without_extension(relative: &str) -> &str {
    let name_start = relative.rfind('/').map_or(0, |slash| slash + 1);
    match relative[name_start..].rfind('.') {
        Some(dot) if dot > 0 => &relative[..name_start + dot],
        _ => relative,
    }
}

/// Id prefix that keeps a release's ids unique: empty, its format, or its format and a number.
fn prefix_of(format: Format, entries: &[Entry], taken: &BTreeSet<String>) -> String {
    let name = format.as_str();
    let mut prefix = String::new();
    let mut number = 1;
    let is_taken = |prefix: &str| {
        let mut ids = entries.iter();
        ids.any(|entry| taken.contains(&format!("{prefix}{}", entry.id)))
    };
    while is_taken(&prefix) {
        prefix = match number {
            1 => format!("{name}/"),
            _ => format!("{name}-{number}/"),
        };
        number += 1;
    }
    prefix
}
