//! The plan of a run: the motions to read, their ids and their splits.

use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clip::{LabelProblem, Rejected, rejected};
use datasets_spec::record::{QuarantineRow, SkippedRow};
use datasets_spec::store::Store;
use datasets_spec::{Digest, Progress, Split};
use formats::sidecar::Sidecar;
use formats::source::archive::{self, Archives};
use formats::source::labels::{self, FolderLabels};
use formats::source::{
    Entry, Files, Format, FoundRelease, Recognised, find_releases, recognise, refuse_pointer,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::content::{companions, keys_of};
use super::inputs;
use super::known::Identified;
use super::list::{
    self, Source, hash_files, quarantine_row, reason_beside, source_hash, whole, without_extension,
};
use super::options::{IngestOptions, Settings};
use super::recorded::Recorded;
use super::sources::{self, Given};
use super::split_by::SplitBy;
use super::split_list::{SplitList, name_of_subject};
use crate::Error;
use crate::annotation::pairs::{PairList, RefusedLine, names_of, originals, style_group};
use crate::recordings::source_clip;

/// Everything a run will do, known before any motion is read.
pub(super) struct Plan {
    pub(super) files: Files,
    pub(super) sources: BTreeMap<String, Source>,
    pub(super) releases: Vec<FoundRelease>,
    pub(super) items: Vec<Planned>,
    /// Files without a motion.
    pub(super) skipped: Vec<SkippedRow>,
    /// Files found broken while planning, and folders that cannot be listed.
    pub(super) rejected: Vec<QuarantineRow>,
    pub(super) folder_labels: FolderLabels,
    pub(super) claimed: BTreeSet<String>,
    pub(super) notes: PlanNotes,
}

/// Parts of a plan besides its tables.
#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlanNotes {
    pub(super) given: Vec<Given>,
    pub(super) unlisted: Vec<String>,
    /// Recorded files whose clips stay unchanged, because their labels cannot be read now or they were not chosen.
    pub(super) staying: BTreeSet<String>,
    /// Remarks on the splits of the dataset.
    pub(super) remarks: Vec<String>,
    /// Remarks on how the sources were recognised, and what was left out of them.
    pub(super) said: Vec<String>,
    /// Remarks on the clips that the user's choice left out, and on its lines that name no clip.
    pub(super) choice: Vec<String>,
    /// Labels of folders that could not be used, names in them that no motion has, and contradicting splits.
    pub(super) label_problems: Vec<LabelProblem>,
    /// Motions that are not read although labels may name them; known only while the plan is made.
    #[serde(skip)]
    pub(super) left_out: Vec<Entry>,
    /// Lines of the list of splits that gave no clip a split.
    pub(super) refused_splits: Vec<RefusedLine>,
    /// Grouping whose clips share one drawn split.
    pub(super) split_by: SplitBy,
}

#[derive(Clone)]
pub(super) struct Planned {
    pub(super) entry: Entry,
    pub(super) format: Format,
    /// Index of the release that reads it; `None` for single files.
    pub(super) release: Option<usize>,
    /// Id prefix that keeps two releases' ids apart.
    pub(super) prefix: String,
    /// Group of clips that share a split; `None` for a clip outside any group.
    pub(super) group: Option<String>,
    /// Split that the user's list states, otherwise that of its labels.
    pub(super) own_split: Option<Split>,
    pub(super) labelled_split: Option<Split>,
    pub(super) subject: Option<String>,
    pub(super) action: Option<String>,
    /// Id that its sidecar states.
    pub(super) named: Option<String>,
    pub(super) id: String,
    pub(super) inputs: String,
    /// Index of the same clip of the previous version in [`Recorded::clips`](super::recorded::Recorded).
    pub(super) known: Option<usize>,
    /// Whether that clip stays unchanged.
    pub(super) is_kept: bool,
    pub(super) split: Split,
}

impl Planned {
    pub(super) fn new(entry: Entry, format: Format, release: Option<usize>) -> Self {
        Self {
            entry,
            format,
            release,
            prefix: String::new(),
            group: None,
            labelled_split: None,
            own_split: None,
            subject: None,
            action: None,
            named: None,
            id: String::new(),
            inputs: String::new(),
            known: None,
            is_kept: false,
            split: Split::Train,
        }
    }

    fn state(&mut self, stated: Sidecar) {
        self.labelled_split = stated.split;
        self.subject = stated.subject;
        self.action = stated.action;
    }

    /// Id in the dataset without crop or mirror suffix.
    fn clip(&self) -> String {
        source_clip(&self.id)
    }

    /// Names by which a list of splits may refer to the motion: its id, that of its source clip, its file, its subject.
    pub(super) fn names(&self) -> BTreeSet<String> {
        let (entry, subject) = (&self.entry, self.subject.as_deref());
        let file = [entry.file.as_str(), without_extension(&entry.file)];
        let mut names = BTreeSet::from([self.id.clone(), self.clip(), entry.id.clone()]);
        names.extend(file.map(str::to_owned));
        names.extend(subject.map(name_of_subject));
        names
    }
}

impl Plan {
    /// Plans a run over the sources. `recorded` is what the dataset holds; with `same_settings`, clips are kept if
    /// their files have not changed.
    pub(super) fn make(
        store: Arc<dyn Store>,
        (sources, said): Identified,
        options: &IngestOptions,
        recorded: &Recorded,
        same_settings: bool,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let (mut skipped, mut rejected) = (Vec::new(), Vec::new());
        let mut notes = PlanNotes {
            said,
            split_by: options.split_by.unwrap_or_default(),
            ..PlanNotes::default()
        };
        let mut files: BTreeMap<String, (PathBuf, usize)> = BTreeMap::new();
        let mut archives = Archives::default();
        for (source, listing) in sources {
            let (name, of) = (source.label.name.as_str(), notes.given.len());
            let behind = |path: &str| list::labelled(&source.label.label, path);
            let special = listing.special.into_iter();
            skipped.extend(special.map(|(path, reason)| SkippedRow {
                path: behind(&path),
                source_name: name.to_owned(),
                source_hash: String::new(),
                inputs_hash: String::new(),
                reason,
            }));
            for (path, hash, why) in unread(listing.unlisted, listing.refused) {
                let path = behind(&path);
                rejected.push(quarantine_row(&path, "", name, hash, why));
                notes.unlisted.push(path);
            }
            archives.add(listing.archives);
            let own = listing.files.into_iter();
            files.extend(own.map(|(path, place)| (behind(&path), (place, of))));
            notes.given.push(source);
        }
        let sources = hash_files(store.as_ref(), &files, progress);
        let files = files.into_iter().map(|(path, (place, _))| (path, place));
        let files = Files::on(store, files.collect()).with_archives(archives);
        let mut plan = Self {
            folder_labels: FolderLabels::read(&files),
            releases: find_releases(&files, options.humanml3d_index.as_deref())?,
            files,
            sources,
            items: Vec::new(),
            skipped,
            rejected,
            claimed: BTreeSet::new(),
            notes,
        };
        plan.claimed = plan.take_releases(options);
        plan.take_single_files(options);
        plan.name_companions();
        for source in plan.sources.values_mut() {
            // The first bytes are not needed any more.
            source.head = Vec::new();
        }
        plan.note_inputs();
        plan.take_named_ids();
        plan.identify(recorded, same_settings);
        plan.keep_described(recorded);
        plan.take_labels(recorded);
        if let Some(list) = &options.ids {
            plan.choose(list, recorded);
        }
        plan.note_label_problems(recorded);
        plan.take_own_splits(options.splits.as_ref());
        plan.hold_back(recorded);
        if let Some(list) = &options.pairs {
            plan.follow_originals(list);
        }
        plan.note_split_labels();
        plan.assign_splits(recorded, options.seed);
        plan.note_unpublished();
        Ok(plan)
    }

    /// The row of a motion that is not read, or of a file without one, whose key and inputs are empty.
    pub(super) fn skipped_row(
        &self,
        file: &str,
        key: &str,
        inputs: &str,
        reason: String,
    ) -> SkippedRow {
        SkippedRow {
            path: list::path_of(file, key),
            source_name: self.source_name(file).to_owned(),
            source_hash: source_hash(&self.sources, file).to_owned(),
            inputs_hash: inputs.to_owned(),
            reason,
        }
    }

    pub(super) fn source_of(&self, file: &str) -> Option<&Given> {
        let source = self.sources.get(file);
        source.and_then(|source| self.notes.given.get(source.of))
    }

    pub(super) fn source_name(&self, file: &str) -> &str {
        self.source_of(file)
            .map_or("", |source| source.label.name.as_str())
    }

    pub(super) fn rejected_row(&self, file: &str, key: &str, rejected: Rejected) -> QuarantineRow {
        let hash = source_hash(&self.sources, file).to_owned();
        quarantine_row(file, key, self.source_name(file), hash, rejected)
    }

    /// Why a file could not be read while planning.
    fn unreadable(&self, file: &str) -> Option<Rejected> {
        let source = self.sources.get(file)?;
        let reason = source.hash.as_ref().err()?;
        let code = match archive::is_in_archive(file) {
            true => archive::DAMAGED,
            false => "E-IO",
        };
        Some(Rejected {
            byte_offset: source.damaged_at,
            ..rejected!(code, "cannot read the file: {reason}")
        })
    }

    /// The path of a file without the label of its source.
    pub(super) fn unlabelled<'a>(&self, file: &'a str) -> &'a str {
        let label = self
            .source_of(file)
            .map_or("", |source| source.label.label.as_str());
        sources::below(label, file).unwrap_or(file)
    }

    /// Plans the motions of the releases, and returns the files that the releases claim.
    fn take_releases(&mut self, options: &IngestOptions) -> BTreeSet<String> {
        let mut claimed = BTreeSet::new();
        for (index, (format, release)) in self.releases.iter().enumerate() {
            let (format, release) = (*format, release.contents());
            claimed.extend(release.entries.iter().map(|entry| entry.file.clone()));
            if options.format.is_some_and(|only| only != format) {
                self.notes.left_out.extend(release.entries.iter().cloned());
                let files = release.entries.iter().map(|entry| entry.file.as_str());
                for file in BTreeSet::from_iter(files) {
                    self.skipped
                        .push(self.skipped_row(file, "", "", not_asked_for(format)));
                }
            } else {
                let entries = release.entries.iter().cloned();
                self.items
                    .extend(entries.map(|entry| Planned::new(entry, format, Some(index))));
                self.notes.remarks.extend(release.remarks.iter().cloned());
            }
            for (file, reason) in &release.passed_over {
                if !claimed.insert(file.clone()) {
                    continue;
                }
                match self.unreadable(file) {
                    Some(why) => self.rejected.push(self.rejected_row(file, "", why)),
                    None => self
                        .skipped
                        .push(self.skipped_row(file, "", "", reason.clone())),
                }
            }
            for (file, rejected) in &release.rejected {
                if claimed.insert(file.clone()) {
                    let row = self.rejected_row(file, "", rejected.clone());
                    self.rejected.push(row);
                }
            }
        }
        claimed
    }

    /// Plans every file that no release claims.
    fn take_single_files(&mut self, options: &IngestOptions) {
        for (relative, source) in &self.sources {
            if self.claimed.contains(relative) {
                continue;
            }
            match self.keys_of_single(relative, source, options) {
                Ok((format, keys)) => self.items.extend(keys.into_iter().map(|key| {
                    let entry = Entry {
                        key,
                        ..whole(relative)
                    };
                    Planned::new(entry, format, None)
                })),
                Err(NoMotion::Skipped(reason)) => {
                    self.skipped
                        .push(self.skipped_row(relative, "", "", reason));
                }
                Err(NoMotion::NotAskedFor(reason)) => {
                    self.skipped
                        .push(self.skipped_row(relative, "", "", reason));
                    self.notes.left_out.push(whole(relative));
                }
                Err(NoMotion::Rejected(why)) => {
                    self.rejected.push(self.rejected_row(relative, "", why));
                    self.notes.left_out.push(whole(relative));
                }
            }
        }
    }

    /// Says of skipped captions and sidecars whether they lie beside a motion that they describe.
    fn name_companions(&mut self) {
        let files = self.items.iter().map(|item| item.entry.file.as_str());
        let files = files.chain(self.rejected.iter().map(|row| row.path.as_str()));
        let stems: BTreeSet<&str> = files.map(without_extension).collect();
        for row in &mut self.skipped {
            if let Some(reason) = reason_beside(&row.path, &row.reason, &stems) {
                row.reason = reason.to_owned();
            }
        }
    }

    /// The format of a file that no release claims, and the keys of its motions.
    fn keys_of_single(
        &self,
        relative: &str,
        source: &Source,
        options: &IngestOptions,
    ) -> Result<(Format, Vec<String>), NoMotion> {
        // Do not guess the format of an unreadable file from its name.
        let readable = self.unreadable(relative).map_or(Ok(()), Err);
        readable.map_err(NoMotion::Rejected)?;
        refuse_pointer(&source.head).map_err(NoMotion::Rejected)?;
        match recognise(Path::new(relative), &source.head) {
            Recognised::NotMotion { reason } => Err(NoMotion::Skipped(reason)),
            Recognised::Motion(format) if options.format.is_some_and(|only| only != format) => {
                Err(NoMotion::NotAskedFor(not_asked_for(format)))
            }
            Recognised::Motion(format) => {
                let keys = keys_of(format, &self.files, relative, &options.read);
                Ok((format, keys.map_err(NoMotion::Rejected)?))
            }
        }
    }

    fn note_inputs(&mut self) {
        let (motions, others) = self.single_files();
        let of_file = inputs::of_single_files(&motions, &others, &self.sources);
        let below = inputs::LabelsBelow::of(&others, &self.sources);
        let of_release = self.releases.iter().map(|(_, release)| {
            inputs::of_release(release.contents(), &below, &self.sources).into_iter()
        });
        let mut of_release: Vec<_> = of_release.collect();
        let mut of_folder = BTreeMap::new();
        let hashes: Vec<String> = self
            .items
            .iter()
            .map(|item| match item.release {
                Some(release) => of_release[release].next().unwrap_or_default(),
                None => {
                    let file = item.entry.file.as_str();
                    let beside = self.beside_lone(file, &mut of_folder);
                    inputs::with_beside(&of_file[file], &beside)
                }
            })
            .collect();
        for (item, inputs) in self.items.iter_mut().zip(hashes) {
            item.inputs = inputs;
        }
    }

    /// Hashes of the files that describe a motion which was given alone and are not given themselves: labels of its name,
    /// and labels and licences of its folder, which `of_folder` keeps. None for a motion of a folder that was given.
    fn beside_lone(
        &self,
        file: &str,
        of_folder: &mut BTreeMap<PathBuf, Vec<String>>,
    ) -> Vec<String> {
        let is_lone = self.source_of(file).is_some_and(|given| !given.is_whole);
        let path = self.files.path(file).filter(|_| is_lone);
        let Some((path, folder)) = path.and_then(|path| Some((path, path.parent()?))) else {
            return Vec::new();
        };
        let hashed = |name: &str| {
            let bytes = match self.files.read_beside(&folder.join(name)) {
                Ok(bytes) => bytes?,
                // It is reported when the labels are read, and may be readable next time.
                Err(rejected) => rejected.reason.into_bytes(),
            };
            Some(format!("{name} {}", blake3::hash(&bytes).to_hex()))
        };
        let names = labels::names_beside(path);
        let own = names.iter().filter_map(|name| hashed(name));
        let all = of_folder
            .entry(folder.to_owned())
            .or_insert_with(|| labels::names_in_folder().filter_map(hashed).collect());
        own.chain(all.iter().cloned()).collect()
    }

    /// The files that no release claims: those with motions that are read, and the others.
    pub(super) fn single_files(&self) -> (BTreeSet<&str>, BTreeSet<&str>) {
        let single = self.items.iter().filter(|item| item.release.is_none());
        let motions: BTreeSet<&str> = single.map(|item| item.entry.file.as_str()).collect();
        let others = self.sources.keys().map(String::as_str);
        let others = others.filter(|file| !self.claimed.contains(*file) && !motions.contains(file));
        let others = others.collect();
        (motions, others)
    }

    /// Takes the ids that sidecars state. [`Plan::take_labels`] takes the labels once every motion has an id, because label
    /// files may name it.
    fn take_named_ids(&mut self) {
        let files = &self.files;
        let single = self
            .items
            .par_iter_mut()
            .filter(|item| item.release.is_none());
        single.for_each(|item| {
            let file = &item.entry.file;
            // A sidecar that cannot be read now is noticed with the labels.
            let failed = Cell::new(None);
            let companions = companions(files, file, &failed);
            let (id, mirrored_of) = labels::stated_ids(Path::new(file), &companions);
            item.named = id;
            item.entry.mirrored_of = mirrored_of;
        });
    }

    /// Takes the labels that decide on splits, and gives single files with labels of action and style the group of
    /// their original. A motion is rejected if labels beside it or in its folders cannot be read now: they may be
    /// readable next time and change the split of the clip.
    fn take_labels(&mut self, recorded: &Recorded) {
        let mut items = std::mem::take(&mut self.items);
        let (files, folder_labels) = (&self.files, &self.folder_labels);
        let unreadable: Vec<Option<Rejected>> = items
            .par_iter_mut()
            .map(|item| {
                let around = folder_labels.of(files, &item.entry);
                let file = &item.entry.file;
                if item.release.is_some() {
                    let stated = labels::stated(Path::new(file), None, &around, None);
                    item.state(stated);
                    return around.failed;
                }
                let failed = Cell::new(None);
                let companions = companions(files, file, &failed);
                let own = item.format.subject_of(&item.entry.key);
                let stated = labels::stated(Path::new(file), Some(&companions), &around, own);
                let styled = stated.action.as_ref().zip(stated.style.as_ref());
                item.group =
                    styled.map(|(action, style)| style_group(self.unlabelled(file), action, style));
                item.state(stated);
                failed.take().or(around.failed)
            })
            .collect();
        let mut unreadable = unreadable.into_iter();
        items.retain(|item| match unreadable.next().flatten() {
            None => true,
            Some(reason) => {
                if let Some(clip) = item.known {
                    // A clip of the dataset stays unchanged.
                    let remark = format!("{} stays as it was: {}", item.id, reason.reason);
                    self.notes.remarks.push(remark);
                    let path = recorded.clips[clip].path.clone();
                    self.notes.staying.insert(path);
                } else {
                    let Entry { file, key, .. } = &item.entry;
                    let row = self.rejected_row(file, key, reason);
                    self.rejected.push(row);
                }
                self.notes.left_out.push(item.entry.clone());
                false
            }
        });
        self.items = items;
    }

    /// Gives clips the splits that the user states: those of the list, otherwise those of their labels. All motions of
    /// a source clip get one split, by the first line or label that names any of them. Labels that state another one
    /// are label problems.
    fn take_own_splits(&mut self, list: Option<&SplitList>) {
        let mut lines: BTreeMap<String, usize> = BTreeMap::new();
        let mut stated: BTreeMap<String, (Split, usize)> = BTreeMap::new();
        let mut unused: Vec<([usize; 2], [Split; 2])> = Vec::new();
        let mut known: BTreeSet<String> = BTreeSet::new();
        for (place, item) in self.items.iter().enumerate() {
            let clip = item.clip();
            let names = item.names();
            if let Some(line) = list.and_then(|list| list.line_of(&names)) {
                let first = lines.entry(clip.clone()).or_insert(line);
                *first = line.min(*first);
            }
            if let Some(split) = item.labelled_split {
                let (used, first) = *stated.entry(clip).or_insert((split, place));
                if used != split {
                    unused.push(([place, first], [split, used]));
                }
            }
            if list.is_some() {
                known.extend(names);
            }
        }
        // Where the list decides, no label does.
        unused.retain(|([place, _], _)| !lines.contains_key(&self.items[*place].clip()));
        for (places, splits) in unused {
            let problem = self.contradiction(places, splits);
            self.notes.label_problems.push(problem);
        }
        let stated = stated.into_iter();
        let mut splits: BTreeMap<String, Split> =
            stated.map(|(clip, (split, _))| (clip, split)).collect();
        if let Some(list) = list {
            self.notes.refused_splits = list.refused(&known);
            let lines = lines.into_iter();
            splits.extend(lines.map(|(clip, line)| (clip, list.split(line))));
        }
        for item in &mut self.items {
            item.own_split = splits.get(&item.clip()).copied();
        }
    }

    /// The problem of a motion whose label states `split`, while the first of its source clip states `used`.
    fn contradiction(&self, places: [usize; 2], [split, used]: [Split; 2]) -> LabelProblem {
        let [item, first] = places.map(|place| &self.items[place]);
        let name = |item: &Planned| list::path_of(&item.entry.file, &item.entry.key);
        let line = self
            .folder_labels
            .line_of_split(&self.files, &item.entry, split);
        let (file, line) = line.unwrap_or((item.entry.file.as_str(), None));
        let line = line.map_or(String::new(), |line| format!("line {line}: "));
        LabelProblem {
            file: file.to_owned(),
            reason: format!(
                "{line}split {split} of {} was not used: {}, of the same source clip, has split {used}",
                name(item),
                name(first)
            ),
        }
    }

    /// Puts each styled clip of a pair list, with its copies and crops, into the split of its original.
    /// A published split stays as it is.
    fn follow_originals(&mut self, list: &PairList) {
        let clips: BTreeMap<String, String> = self
            .items
            .iter()
            .map(|item| (item.id.clone(), item.clip()))
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
                let key = || (None, self.split_key(item));
                let (split, _) = deciding.entry(clip).or_insert_with(key);
                *split = split.or(item.own_split).or(item.entry.split);
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

    pub(super) fn all_remarks(&self) -> Vec<String> {
        [&self.notes.remarks[..], &self.notes.said].concat()
    }

    /// Number of source items: motions, and files without one.
    pub(super) fn num_items(&self) -> u64 {
        (self.items.len() + self.rejected.len() + self.skipped.len()) as u64
    }

    /// Hash of everything that determines the rows of this run.
    pub(super) fn hash(&self, settings: &Settings, options: &IngestOptions, base: u64) -> String {
        let mut digest = Digest::default();
        digest.part(&settings.text());
        digest.part(&base.to_string());
        digest.part(if options.prune { "prune" } else { "" });
        for source in &self.notes.given {
            digest.part(&source.label.name);
            digest.part(&source.label.label);
            digest.part(if source.is_whole { "whole" } else { "" });
        }
        for (relative, source) in &self.sources {
            digest.part(relative);
            digest.part(source.hash.as_deref().unwrap_or(""));
        }
        // The list of motions can depend on more than the files, such as an index elsewhere.
        for item in &self.items {
            digest.part(item.format.as_str());
            digest.part(&item.entry.file);
            digest.part(&item.entry.key);
            digest.part(&item.prefix);
            digest.part(&item.entry.id);
            digest.part(&item.id);
            digest.part(item.split.as_str());
            digest.part(if item.is_kept { "kept" } else { "" });
        }
        if let Some(list) = &options.pairs {
            digest.part(list.hash());
        }
        digest.hex()
    }
}

/// Why a file gives no motion.
enum NoMotion {
    Skipped(String),
    NotAskedFor(String),
    Rejected(Rejected),
}

fn not_asked_for(format: Format) -> String {
    format!("{} file, not asked for", format.as_str())
}

/// Folders and archives that cannot be read, with the hash of the archive and the reason: clips below them stay as they
/// are.
fn unread(
    folders: Vec<(String, String)>,
    archives: Vec<(String, String, Rejected)>,
) -> impl Iterator<Item = (String, String, Rejected)> {
    let folders = folders.into_iter().map(|(folder, reason)| {
        let reason = format!("cannot list the folder: {reason}");
        (folder, String::new(), Rejected::read("E-IO", reason))
    });
    folders.chain(archives)
}
