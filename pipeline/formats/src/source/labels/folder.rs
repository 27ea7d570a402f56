//! Labels and licences that apply to a folder and all folders below it: `stance.toml`, `captions.csv`, licence files
//! and readmes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::pattern::{is_pattern, matches};
use super::{csv_file, license_text, toml_file};
use crate::sidecar::{Content, Sidecar};
use crate::source::head::refuse_pointer;
use crate::source::{Entry, Files, text_of_name};
use clip::{LabelProblem, Rejected};
use datasets_spec::Split;

/// Names of the files with labels.
const TOML: &str = "stance.toml";
const CSV: &str = "captions.csv";
/// Names of licence files and readmes that are tried beside a single source file, whose folder is not listed.
const LICENSES: [&str; 6] = [
    "LICENSE",
    "LICENSE.txt",
    "LICENSE.md",
    "README.md",
    "README.txt",
    "README",
];
/// Limit on label files, in bytes.
const MAX_BYTES: u64 = 64 << 20;

/// Whether a file holds labels of the motions in its folder, by its name in lower case.
pub fn is_label_file(name: &str) -> bool {
    name == TOML || name == CSV
}

/// Names of the label and licence files that are looked up in a folder.
pub fn names_in_folder() -> impl Iterator<Item = &'static str> {
    [TOML, CSV].into_iter().chain(LICENSES)
}

/// Labels of a clip from the files of the folders around it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClipLabels {
    /// Labels of this clip, by its name or a pattern.
    pub(super) of_clip: Sidecar,
    /// Labels of all clips of its folders.
    pub(super) of_folder: Sidecar,
    /// Files of its folders that could not be used.
    pub(super) problems: Vec<LabelProblem>,
    /// Error of reading a file of its folders; a later read may succeed.
    pub failed: Option<Rejected>,
}

/// The labels of every folder among the files.
#[derive(Debug, Default)]
pub struct FolderLabels {
    folders: BTreeMap<PathBuf, Folder>,
    problems: Vec<LabelProblem>,
}

/// Labels from the files of one folder.
#[derive(Debug, Default)]
struct Folder {
    all: Sidecar,
    clips: Vec<Clips>,
    /// Indices in `clips` by exact name.
    named: BTreeMap<String, Vec<usize>>,
    /// Indices in `clips` of patterns, the longest first.
    patterns: Vec<usize>,
    license: Licensing,
    /// Files that could not be used as a whole.
    unread: Vec<LabelProblem>,
    /// Error of reading a file of the folder.
    failed: Option<Rejected>,
}

/// Labels of the clips that a name or pattern selects.
#[derive(Debug)]
struct Clips {
    name: String,
    labels: Sidecar,
    file: String,
    line: Option<u64>,
}

/// Licences that the files of a folder state.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Licensing {
    /// Licence tags.
    pub(crate) tags: BTreeSet<String>,
    /// Files that state these licences.
    pub files: Vec<String>,
    /// Licence files without a known licence.
    pub unknown: Vec<String>,
}

impl Licensing {
    /// All tags joined by `AND`, because each licence applies; `None` without tags.
    pub fn tag(&self) -> Option<String> {
        let tags: Vec<&str> = self.tags.iter().map(String::as_str).collect();
        (!tags.is_empty()).then(|| tags.join(" AND "))
    }
}

/// The root of the dataset of which a file is a manifest.
fn root_of_dataset(relative: &str) -> Option<&str> {
    let (folder, name) = relative.rsplit_once('/')?;
    let is_manifest = name.starts_with("manifest-") && name.ends_with(".json");
    let root = folder.strip_suffix("meta")?;
    (is_manifest && (root.is_empty() || root.ends_with('/'))).then(|| root.trim_end_matches('/'))
}

impl FolderLabels {
    /// Reads the labels and licences among the files and beside single source files.
    pub fn read(files: &Files) -> Self {
        let mut labels = Self::default();
        let mut seen = BTreeSet::new();
        let mut lone = BTreeSet::new();
        let datasets: BTreeSet<&str> = files.all().filter_map(root_of_dataset).collect();
        for relative in files.all() {
            let (folder, name) = relative.rsplit_once('/').unwrap_or(("", relative));
            let Some(path) = files.path(relative) else {
                continue;
            };
            // The card of a dataset lists the licences of all its clips, and each clip states its own.
            if name == "README.md" && datasets.contains(folder) {
                seen.insert(path.to_owned());
                continue;
            }
            if is_label_file(&name.to_lowercase()) || license_text::is_named(name) {
                seen.insert(path.to_owned());
                labels.take(files, path, relative);
            } else if folder.is_empty()
                && let Some(folder) = path.parent()
            {
                lone.insert(folder.to_owned());
            }
        }
        for folder in lone {
            for name in names_in_folder() {
                let path = folder.join(name);
                if !seen.contains(&path) {
                    labels.take(files, &path, name);
                }
            }
        }
        for folder in labels.folders.values_mut() {
            folder.index();
        }
        labels.problems.sort();
        labels
    }

    /// Reads a label or licence file, which may be missing beside a single source file.
    fn take(&mut self, files: &Files, path: &Path, relative: &str) {
        let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else {
            return;
        };
        let problem = |reason: String| LabelProblem {
            file: relative.to_owned(),
            reason,
        };
        let too_large = files.size_beside(path).is_some_and(|size| size > MAX_BYTES);
        if too_large {
            let problem = problem(format!("it is larger than {MAX_BYTES} bytes"));
            let found = self.folders.entry(folder.to_owned()).or_default();
            found.unread.push(problem.clone());
            self.problems.push(problem);
            return;
        }
        let read = files.read_beside(path).and_then(|bytes| {
            bytes.as_deref().map_or(Ok(()), refuse_pointer)?;
            Ok(bytes)
        });
        let bytes = match read {
            Ok(Some(bytes)) => bytes,
            Ok(None) => return,
            Err(rejected) => {
                let found = self.folders.entry(folder.to_owned()).or_default();
                found.failed = Some(rejected);
                return;
            }
        };
        let found = self.folders.entry(folder.to_owned()).or_default();
        let name = name.to_string_lossy().to_lowercase();
        let content = match name.as_str() {
            TOML => {
                let content = toml_file::parse(&String::from_utf8_lossy(&bytes));
                found.all = content.all.clone();
                let problems = content.problems.iter();
                let of_folder = problems.filter(|reason| !reason.starts_with("clips"));
                found.unread.extend(of_folder.cloned().map(&problem));
                content
            }
            CSV => csv_file::parse(&bytes),
            name => {
                let text = String::from_utf8_lossy(&bytes);
                let tags = license_text::stated_in(name, &text);
                if !tags.is_empty() {
                    found.license.files.push(relative.to_owned());
                } else if !license_text::is_readme(name) || license_text::is_licensed_card(&text) {
                    found.license.unknown.push(relative.to_owned());
                }
                found.license.tags.extend(tags);
                Content::default()
            }
        };
        let clips = content.clips.into_iter();
        found.clips.extend(clips.map(|(line, name, labels)| Clips {
            name,
            labels,
            file: relative.to_owned(),
            line,
        }));
        self.problems
            .extend(content.problems.into_iter().map(problem));
    }

    /// Labels of a motion from the files of the folders around it.
    pub fn of(&self, files: &Files, entry: &Entry) -> ClipLabels {
        let mut labels = ClipLabels::default();
        for (folder, relative) in self.around(files, entry) {
            for place in folder.naming(&relative, entry) {
                labels.of_clip.add(&folder.clips[place].labels);
            }
            labels.of_folder.fill(&folder.all);
            labels.of_folder.fill(&Sidecar {
                license: folder.license.tag(),
                ..Sidecar::default()
            });
            labels.problems.extend(folder.unread.iter().cloned());
            labels.failed = labels.failed.or_else(|| folder.failed.clone());
        }
        labels
    }

    /// The folders around a motion that have labels, the nearest first, and the path of the motion's file in each.
    fn around<'a>(
        &'a self,
        files: &'a Files,
        entry: &'a Entry,
    ) -> impl Iterator<Item = (&'a Folder, String)> {
        let depth = entry.file.matches('/').count();
        let path = files.path(&entry.file);
        let folders = path.and_then(Path::parent).into_iter();
        let folders = folders.flat_map(move |parent| parent.ancestors().take(depth + 1));
        folders.filter_map(move |folder| {
            let relative = path?.strip_prefix(folder).ok()?;
            let parts = relative.iter().map(text_of_name);
            let relative = parts.collect::<Vec<_>>().join("/");
            Some((self.folders.get(folder)?, relative))
        })
    }

    /// Unusable files and lines, and names that no motion has.
    pub fn problems<'a>(
        &self,
        files: &Files,
        entries: impl Iterator<Item = &'a Entry>,
    ) -> Vec<LabelProblem> {
        let mut used: BTreeSet<*const Clips> = BTreeSet::new();
        let mut contradicting: BTreeSet<LabelProblem> = BTreeSet::new();
        for entry in entries {
            for (folder, relative) in self.around(files, entry) {
                let places = folder.naming(&relative, entry);
                contradicting.extend(folder.contradictions(&places));
                let places = places.into_iter();
                used.extend(places.map(|place| std::ptr::from_ref(&folder.clips[place])));
            }
        }
        let unused = self.folders.values().flat_map(|folder| &folder.clips);
        let unused = unused.filter(|clips| !used.contains(&std::ptr::from_ref(*clips)));
        let mut problems: Vec<LabelProblem> = self.problems.clone();
        problems.extend(contradicting);
        problems.extend(unused.map(|clips| {
            let line = clips
                .line
                .map_or(String::new(), |line| format!("line {line}: "));
            LabelProblem {
                file: clips.file.clone(),
                reason: format!("{line}no motion of its folder is called {:?}", clips.name),
            }
        }));
        problems.sort();
        problems
    }

    /// The file and line that give a motion this split by its name; `None` if none does. Files of TOML tell no line.
    pub fn line_of_split<'a>(
        &'a self,
        files: &'a Files,
        entry: &'a Entry,
        split: Split,
    ) -> Option<(&'a str, Option<u64>)> {
        self.around(files, entry).find_map(|(folder, relative)| {
            let named = folder.naming(&relative, entry).into_iter();
            let mut named = named.map(|place| &folder.clips[place]);
            let clips = named.find(|clips| clips.labels.split == Some(split))?;
            Some((clips.file.as_str(), clips.line))
        })
    }

    /// Files and lines that could not be used.
    pub fn unread(&self) -> &[LabelProblem] {
        &self.problems
    }

    /// The licences that folders state: path of the folder, tag, and where it was found.
    pub fn licenses(&self) -> impl Iterator<Item = (&Path, Option<String>, &Licensing)> {
        let folders = self.folders.iter();
        let stated = folders.map(|(path, folder)| {
            let tag = folder.all.license.clone().or_else(|| folder.license.tag());
            (path.as_path(), tag, &folder.license)
        });
        stated.filter(|(_, tag, found)| tag.is_some() || !found.unknown.is_empty())
    }
}

impl Folder {
    fn index(&mut self) {
        let names = self.clips.iter().enumerate();
        for (place, clips) in names {
            let exact = self.named.entry(clips.name.clone()).or_default();
            exact.push(place);
            if is_pattern(&clips.name) {
                self.patterns.push(place);
            }
        }
        let length = |place: &usize| std::cmp::Reverse(self.clips[*place].name.len());
        self.patterns.sort_by_key(length);
    }

    /// Labels of the same motion by exact names that differ; the first of them is used. `places` are the result of
    /// [`Folder::naming`].
    fn contradictions(&self, places: &[usize]) -> Vec<LabelProblem> {
        let clips = places.iter().map(|place| &self.clips[*place]);
        let exact: Vec<&Clips> = clips.filter(|clips| !is_pattern(&clips.name)).collect();
        let line = |clips: &Clips| match clips.line {
            Some(line) => format!("line {line}"),
            None => format!("{:?} of {}", clips.name, clips.file),
        };
        let mut used: BTreeMap<&str, (String, &Clips)> = BTreeMap::new();
        let mut found = Vec::new();
        for clips in exact {
            for (field, value) in clips.labels.stated() {
                let (before, first) = used.entry(field).or_insert_with(|| (value.clone(), clips));
                if *before != value {
                    let (own, first) = (line(clips), line(first));
                    found.push(LabelProblem {
                        file: clips.file.clone(),
                        reason: format!(
                            "{own}: {field} {value} was not used: {first} says {before} of the same motion"
                        ),
                    });
                }
            }
        }
        found
    }

    /// Indices in `clips` of the labels that name a motion: exact names, then patterns.
    fn naming(&self, relative: &str, entry: &Entry) -> Vec<usize> {
        if self.clips.is_empty() {
            return Vec::new();
        }
        let names = names_of(relative, entry);
        let exact = names.iter().filter_map(|name| self.named.get(name));
        let mut places: Vec<usize> = exact.flatten().copied().collect();
        for &place in &self.patterns {
            let pattern = &self.clips[place].name;
            if !places.contains(&place) && names.iter().any(|name| matches(pattern, name)) {
                places.push(place);
            }
        }
        places
    }
}

/// Names of a motion in a folder: its file with and without extension, each also with the motion's key, and its id in a
/// release.
fn names_of(relative: &str, entry: &Entry) -> BTreeSet<String> {
    let name_start = relative.rfind('/').map_or(0, |slash| slash + 1);
    let stem = match relative[name_start..].rfind('.') {
        Some(dot) if dot > 0 => &relative[..name_start + dot],
        _ => relative,
    };
    let mut names = BTreeSet::from([relative.to_owned(), stem.to_owned()]);
    if !entry.key.is_empty() {
        names.insert(format!("{relative}#{}", entry.key));
        names.insert(format!("{stem}#{}", entry.key));
    }
    if !entry.id.is_empty() {
        names.insert(entry.id.clone());
    }
    names
}
