//! Files that cannot be read now. They cost no clip of the dataset, and none of its labels.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use clip::rejected;
use datasets_spec::record::QuarantineRow;
use formats::source::archive::DAMAGED;
use formats::source::labels::names_beside;
use formats::source::{Entry, Recognised, recognise};

use super::identity::key_of;
use super::inputs::{self, folder_of};
use super::list::{Source, labelled, path_of};
use super::plan::Plan;
use super::recorded::Recorded;
use super::shard::PIECE_STAGE;
use super::sources::below;
use crate::names::some_of;

/// Code of a motion whose release states its split in a file that cannot be read.
const UNREAD_SPLITS: &str = "E-SPLITS-UNREAD";

/// Whether a rejection says nothing about the content of an item, which may be readable next time.
pub(super) fn is_passing(row: &QuarantineRow) -> bool {
    let codes = [
        "E-IO",
        "E-INTERNAL",
        "E-LFS-POINTER",
        DAMAGED,
        UNREAD_SPLITS,
    ];
    let code = row.code.as_str();
    // A damaged copy of a dataset says nothing about its motions; another body model does.
    let is_damaged_dataset = code.starts_with("E-DATASET-") && code != "E-DATASET-SKELETON";
    row.stage == PIECE_STAGE || codes.contains(&code) || is_damaged_dataset
}

/// A recorded file that lies in a folder or an archive that cannot be read now.
struct Hidden<'a> {
    path: &'a str,
    /// Index of its source in [`PlanNotes::given`](super::plan::PlanNotes).
    of: usize,
    /// The folder or archive.
    place: &'a str,
}

impl Plan {
    /// Ids of the clips of the dataset among these rejected items that could not be read this time.
    pub(super) fn unread_ids(&self, rejected: &[QuarantineRow]) -> BTreeSet<&str> {
        let passing = rejected.iter().filter(|row| is_passing(row));
        let paths: BTreeSet<&str> = passing.map(|row| row.path.as_str()).collect();
        let known = self.items.iter().filter(|item| item.known.is_some());
        let unread = known.filter(|item| {
            let path = path_of(&item.entry.file, &item.entry.key);
            paths.contains(path.as_str())
        });
        unread.map(|item| item.id.as_str()).collect()
    }

    /// The files that could not be read while planning, or a motion of which could not.
    pub(super) fn unread_files(&self) -> BTreeSet<&str> {
        let passing = self.rejected.iter().filter(|row| is_passing(row));
        let files = passing.flat_map(|row| {
            let path = row.path.as_str();
            let ends = path.match_indices('#').map(|(end, _)| &path[..end]);
            ends.chain([path])
        });
        files.collect()
    }

    /// The folder or archive around a path that cannot be read now.
    pub(super) fn unlisted_around(&self, path: &str) -> Option<&str> {
        let mut unlisted = self.notes.unlisted.iter().map(String::as_str);
        unlisted.find(|&folder| {
            // A source that cannot be listed itself is the folder `.`.
            let folder = match folder.strip_suffix('.') {
                Some(above) if above.is_empty() || above.ends_with('/') => above,
                _ => folder,
            };
            below(folder.trim_end_matches('/'), path).is_some()
        })
    }

    /// Keeps clips as they were if files that may describe them cannot be read now: read again, the clips would lose
    /// these labels.
    pub(super) fn keep_described(&mut self, recorded: &Recorded) {
        let mut sources = self.sources.values();
        let is_all_read = sources.all(|source| source.hash.is_ok());
        if self.notes.unlisted.is_empty() && is_all_read && !self.rejected.iter().any(is_passing) {
            return;
        }
        let described = self.described(recorded);
        let is_read = |known: usize| !described.contains_key(&known);
        self.items.retain(|item| item.known.is_none_or(is_read));
        if !described.is_empty() {
            let places: BTreeSet<&str> = described.values().map(String::as_str).collect();
            let places = some_of(places.into_iter());
            self.notes.remarks.push(format!(
                "{} clips stay as they were, because files that may describe them cannot be read now: {places}",
                described.len()
            ));
        }
        let staying = described.keys().map(|clip| &recorded.clips[*clip].path);
        self.notes.staying.extend(staying.cloned());
    }

    /// Holds back the motions of releases whose splits cannot be read: new ones are quarantined unless the user states
    /// their split, and clips of the dataset stay as they were.
    pub(super) fn hold_back(&mut self, recorded: &Recorded) {
        let releases = self.releases.iter();
        let unread: Vec<Option<String>> = releases
            .map(|(_, release)| release.contents().unread_splits.first().cloned())
            .collect();
        let mut items = std::mem::take(&mut self.items);
        let mut num_staying: BTreeMap<&str, usize> = BTreeMap::new();
        items.retain(|item| {
            let unread = item.release.and_then(|release| unread[release].as_deref());
            let Some(list) = unread.filter(|_| !item.is_kept) else {
                return true;
            };
            if let Some(clip) = item.known {
                *num_staying.entry(list).or_default() += 1;
                let path = recorded.clips[clip].path.clone();
                self.notes.staying.insert(path);
                return false;
            }
            if item.own_split.is_some() {
                return true;
            }
            let Entry { file, key, .. } = &item.entry;
            let why = rejected!(
                UNREAD_SPLITS,
                "{list} decides on the splits of its release and cannot be read; make it readable and ingest again, or name the \
                 splits with --splits"
            );
            self.rejected.push(self.rejected_row(file, key, why));
            false
        });
        self.items = items;
        let remarks = num_staying.into_iter().map(|(list, count)| {
            format!(
                "{count} clips stay as they were, because {list}, which decides on splits, cannot be read"
            )
        });
        self.notes.remarks.extend(remarks);
    }

    /// Notes the labels of folders that cannot be used, and names in them that no motion has, read in this run or not;
    /// remarks on labels of new clips that may be unread.
    pub(super) fn note_label_problems(&mut self, recorded: &Recorded) {
        let remark = self.remark_on_new();
        self.notes.remarks.extend(remark);
        let mut left_out = std::mem::take(&mut self.notes.left_out);
        // Labels may name clips that stay although no item of this run gives them.
        let staying = recorded.clips.iter().filter(|clip| {
            let source = &recorded.sources[clip.source].name;
            !self.is_of_run(source, &clip.path)
        });
        let staying = staying.map(|clip| Entry {
            file: clip.path.clone(),
            id: clip.id.to_string(),
            key: key_of(clip.id.as_str()).to_owned(),
            ..Entry::default()
        });
        left_out.extend(staying);
        let entries = self.items.iter().map(|item| &item.entry);
        let entries = entries.chain(&left_out);
        let of_folders = self.folder_labels.problems(&self.files, entries);
        self.notes.label_problems.extend(of_folders);
    }

    /// The recorded clips that a file may describe that cannot be read now, by index in [`Recorded::clips`], each with
    /// the file, or the folder or archive that holds it.
    fn described(&self, recorded: &Recorded) -> BTreeMap<usize, String> {
        let rows = recorded.skipped.iter();
        let rows = rows.filter(|row| !row.source_hash.is_empty());
        let hidden = rows.filter_map(|row| self.hidden(&row.source_name, &row.path));
        let hidden: Vec<Hidden<'_>> = hidden.collect();
        let of_source: BTreeMap<usize, &str> =
            hidden.iter().map(|file| (file.of, file.place)).collect();
        let of_single = self.hidden_inputs(recorded, &hidden);
        let passing = self.rejected.iter().filter(|row| is_passing(row));
        let passing: BTreeSet<&str> = passing.map(|row| row.path.as_str()).collect();
        let releases = self.releases.iter();
        let of_release: Vec<_> = releases
            .map(|(_, release)| inputs::files_of_release(release.contents()))
            .collect();
        let is_unread = |file: &str| {
            let source = self.sources.get(file);
            passing.contains(file) || source.is_some_and(|source| source.hash.is_err())
        };
        let common: Vec<Option<&str>> = of_release
            .iter()
            .map(|files| files.common.iter().copied().find(|&file| is_unread(file)))
            .collect();
        let mut described = BTreeMap::new();
        let mut given = BTreeSet::new();
        for item in &self.items {
            let Some(clip) = item.known else { continue };
            given.insert(clip);
            if item.is_kept {
                continue;
            }
            let file = item.entry.file.as_str();
            let place = match item.release {
                Some(release) => {
                    let own = of_release[release].own.get(file).into_iter().flatten();
                    let of = self.sources.get(file).map(|source| source.of);
                    let own = own.copied().find(|&file| is_unread(file));
                    own.or(common[release])
                        .or_else(|| of_source.get(&of?).copied())
                }
                None => {
                    let hidden = of_single.get(file).copied();
                    hidden.or_else(|| self.unread_beside(file, &passing))
                }
            };
            described.extend(place.map(|place| (clip, place.to_owned())));
        }
        // Without the hidden files, a release may not have been found.
        for (index, clip) in recorded.clips.iter().enumerate() {
            let source = self.sources.get(&clip.path);
            let source = source.filter(|_| !given.contains(&index));
            let place = source.and_then(|source| of_source.get(&source.of));
            described.extend(place.map(|place| (index, (*place).to_owned())));
        }
        described
    }

    /// A recorded file of a source of this name, if it is hidden now.
    fn hidden<'a>(&'a self, name: &str, path: &'a str) -> Option<Hidden<'a>> {
        let place = self.unlisted_around(path)?;
        let mut given = self.notes.given.iter();
        let of = given.position(|given| given.label.name == name)?;
        let is_hidden = !self.sources.contains_key(path);
        is_hidden.then_some(Hidden { path, of, place })
    }

    /// The single files that were read from hidden files, each with the folder or archive that holds one of these.
    fn hidden_inputs<'a>(
        &'a self,
        recorded: &'a Recorded,
        hidden: &[Hidden<'a>],
    ) -> BTreeMap<&'a str, &'a str> {
        if hidden.is_empty() {
            return BTreeMap::new();
        }
        let (mut motions, mut others) = self.single_files();
        let mut sources = self.sources.clone();
        let mut add = |file: &Hidden<'a>| {
            let source = Source {
                of: file.of,
                hash: Ok(String::new()),
                damaged_at: None,
                head: Vec::new(),
                bytes: 0,
            };
            sources.insert(file.path.to_owned(), source);
        };
        for clip in &recorded.clips {
            let name = recorded.sources[clip.source].name.as_str();
            if let Some(motion) = self.hidden(name, &clip.path) {
                add(&motion);
                motions.insert(motion.path);
            }
        }
        for file in hidden {
            add(file);
            others.insert(file.path);
        }
        let places: BTreeMap<&str, &'a str> =
            hidden.iter().map(|file| (file.path, file.place)).collect();
        let files = inputs::files_of_single(&motions, &others, &sources).into_iter();
        files
            .filter_map(|(motion, files)| {
                let place = files.into_iter().find_map(|file| places.get(file))?;
                Some((motion, *place))
            })
            .collect()
    }

    /// A label file beside a motion that cannot be read now; `passing` are the rejected files of [`is_passing`].
    fn unread_beside(&self, file: &str, passing: &BTreeSet<&str>) -> Option<&str> {
        let folder = folder_of(file);
        let names = names_beside(Path::new(file)).into_iter();
        let mut beside =
            names.filter_map(|name| self.sources.get_key_value(&labelled(folder, &name)));
        let unread =
            beside.find(|(name, source)| source.hash.is_err() || passing.contains(name.as_str()));
        unread.map(|(name, _)| name.as_str())
    }

    /// The remark on new clips that may have labels in what cannot be read now.
    fn remark_on_new(&self) -> Option<String> {
        let motions: BTreeSet<&str> = self.items.iter().map(|item| &*item.entry.file).collect();
        // By source and folder: what may describe the motions there and below.
        let mut unread: BTreeMap<(usize, &str), Vec<&str>> = BTreeMap::new();
        for place in &self.notes.unlisted {
            if matches!(recognise(Path::new(place), &[]), Recognised::Motion(_)) {
                continue;
            }
            // An archive that gives motions describes these, and one that gives none those beside it.
            let in_it = format!("{place}/");
            let mut in_it = self.files.under(&in_it);
            let folder = match in_it.any(|file| motions.contains(file)) {
                true => place,
                false => folder_of(place),
            };
            let given = self.notes.given.iter().enumerate();
            let around = given.filter(|(_, given)| below(&given.label.label, place).is_some());
            if let Some((of, _)) = around.max_by_key(|(_, given)| given.label.label.len()) {
                unread.entry((of, folder)).or_default().push(place);
            }
        }
        let (mut num_new, mut places) = (0, BTreeSet::new());
        for item in self.items.iter().filter(|item| item.known.is_none()) {
            let file = item.entry.file.as_str();
            let Some(Source { of, .. }) = self.sources.get(file) else {
                continue;
            };
            let mut found = inputs::above(folder_of(file))
                .filter_map(|folder| unread.get(&(*of, folder)))
                .flatten()
                .peekable();
            num_new += usize::from(found.peek().is_some());
            places.extend(found.copied());
        }
        (num_new > 0).then(|| {
            let places = some_of(places.into_iter());
            // Some of them may turn out to be damaged when they are read.
            format!(
                "up to {num_new} new clips may lack labels, because files that may describe them cannot be read now: \
                 {places}"
            )
        })
    }
}
