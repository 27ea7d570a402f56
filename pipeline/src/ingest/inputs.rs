//! Files that a clip is read from: its own file and the files that may hold labels of it. A clip is read again when one
//! of them changes.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Digest;
use formats::source::Contents;

use super::list::{Source, source_hash};

/// Label and licence files that apply to all clips in their folder and below. A file is one of them if its
/// name begins with one of these words.
const SPEAK_OF_ALL_BELOW: [&str; 7] = [
    "stance.toml",
    "captions.csv",
    "license",
    "licence",
    "readme",
    "copying",
    "unlicense",
];

/// Extensions of label files that apply to the motion of the same name.
const ENDS_OF_LABELS: [&str; 2] = [".json", ".txt"];

/// The files that each single file with motions is read from. `motions` are the files with motions and `others` those
/// without.
///
/// A file without a motion may label the motion with its name. Files that are not labels may be read by any motion of
/// their folder; files in a folder without motions belong to the next folder above that has motions. A file is never an
/// input of a motion from another source: only the names of sources put them below each other.
pub(super) fn files_of_single<'a>(
    motions: &BTreeSet<&'a str>,
    others: &BTreeSet<&'a str>,
    sources: &BTreeMap<String, Source>,
) -> BTreeMap<&'a str, Vec<&'a str>> {
    let source_of = |file: &str| sources.get(file).map(|source| source.of);
    let mut stems: BTreeMap<_, BTreeSet<&str>> = BTreeMap::new();
    for file in motions {
        let (folder, name) = split_name(file);
        let folder = (source_of(file), folder);
        stems.entry(folder).or_default().insert(stem(name));
    }
    let mut of_stem: BTreeMap<_, Vec<&str>> = BTreeMap::new();
    let mut of_folder: BTreeMap<_, Vec<&str>> = BTreeMap::new();
    let below = LabelsBelow::of(others, sources);
    for file in others {
        let (folder, name) = split_name(file);
        let source = source_of(file);
        let lower = name.to_lowercase();
        if speaks_of_all_below(&lower) {
            continue;
        }
        let beside = stems.get(&(source, folder));
        let own = beside.and_then(|stems| own_stem(name, stems));
        let is_label = beside.is_some() && ENDS_OF_LABELS.iter().any(|end| lower.ends_with(end));
        if let Some(own) = own {
            let motion = (source, folder, own);
            of_stem.entry(motion).or_default().push(file);
        } else if is_label {
            // Labels of a motion that does not exist.
        } else {
            let mut folders = above(folder).map(|folder| (source, folder));
            if let Some(folder) = folders.find(|folder| stems.contains_key(folder)) {
                of_folder.entry(folder).or_default().push(file);
            }
        }
    }
    motions
        .iter()
        .map(|file| {
            let (folder, name) = split_name(file);
            let source = source_of(file);
            let own = of_stem.get(&(source, folder, stem(name)));
            let of_folder = of_folder.get(&(source, folder));
            let files = std::iter::once(*file)
                .chain(own.into_iter().flatten().copied())
                .chain(of_folder.into_iter().flatten().copied())
                .chain(below.around(file, sources));
            (*file, files.collect())
        })
        .collect()
}

fn speaks_of_all_below(name: &str) -> bool {
    let mut begins = SPEAK_OF_ALL_BELOW.iter();
    begins.any(|begin| name.starts_with(begin))
}

/// Files that speak of all clips in their folder and below, by source and folder.
pub(super) struct LabelsBelow<'a>(BTreeMap<(Option<usize>, &'a str), Vec<&'a str>>);

impl<'a> LabelsBelow<'a> {
    /// Those of some files without a motion.
    pub(super) fn of(others: &BTreeSet<&'a str>, sources: &BTreeMap<String, Source>) -> Self {
        let mut below: BTreeMap<_, Vec<&str>> = BTreeMap::new();
        for file in others {
            let (folder, name) = split_name(file);
            if speaks_of_all_below(&name.to_lowercase()) {
                let source = sources.get(*file).map(|source| source.of);
                below.entry((source, folder)).or_default().push(file);
            }
        }
        Self(below)
    }

    /// The files that speak of the clips of a file.
    fn around<'b>(
        &'b self,
        file: &'b str,
        sources: &BTreeMap<String, Source>,
    ) -> impl Iterator<Item = &'a str> + use<'a, 'b> {
        let source = sources.get(file).map(|source| source.of);
        let around = above(folder_of(file)).filter_map(move |folder| self.0.get(&(source, folder)));
        around.flatten().copied()
    }
}

/// Hashes of the inputs of single files, by file; see [`files_of_single`].
pub(super) fn of_single_files<'a>(
    motions: &BTreeSet<&'a str>,
    others: &BTreeSet<&'a str>,
    sources: &BTreeMap<String, Source>,
) -> BTreeMap<&'a str, String> {
    let files = files_of_single(motions, others, sources).into_iter();
    files
        .map(|(motion, files)| (motion, hash(files.into_iter(), sources)))
        .collect()
}

/// Hash of the inputs of a file with hashes of files beside it, if there are any.
pub(super) fn with_beside(inputs: &str, beside: &[String]) -> String {
    if beside.is_empty() {
        return inputs.to_owned();
    }
    let all = format!("{inputs} {}", beside.join(" "));
    blake3::hash(all.as_bytes()).to_hex().to_string()
}

pub(super) struct FilesOfRelease<'a> {
    /// By file: the file, and the files of the same name elsewhere in the release.
    pub(super) own: BTreeMap<&'a str, Vec<&'a str>>,
    /// Files that are not named after a motion: every motion may read them.
    pub(super) common: Vec<&'a str>,
}

pub(super) fn files_of_release(contents: &Contents) -> FilesOfRelease<'_> {
    let motions: BTreeSet<&str> = contents.entries.iter().map(|e| e.file.as_str()).collect();
    let stems: BTreeSet<&str> = motions
        .iter()
        .map(|file| stem(split_name(file).1))
        .collect();
    let passed_over = contents.passed_over.iter().map(|(file, _)| file.as_str());
    let rejected = contents.rejected.iter().map(|(file, _)| file.as_str());
    let mut of_stem: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    let mut of_all = Vec::new();
    for file in passed_over.chain(rejected) {
        match own_stem(split_name(file).1, &stems) {
            Some(own) => of_stem.entry(own).or_default().push(file),
            None => of_all.push(file),
        }
    }
    let own = motions.into_iter().map(|file| {
        let own = of_stem.get(stem(split_name(file).1)).into_iter().flatten();
        let files = std::iter::once(file).chain(own.copied());
        (file, files.collect())
    });
    FilesOfRelease {
        own: own.collect(),
        common: of_all,
    }
}

/// Hashes of the inputs of the motions of a release, in the order of its entries: the files of the release, see
/// [`files_of_release`], and files beside it that speak of its motions.
pub(super) fn of_release(
    contents: &Contents,
    below: &LabelsBelow<'_>,
    sources: &BTreeMap<String, Source>,
) -> Vec<String> {
    let FilesOfRelease { own, common } = files_of_release(contents);
    let common = hash(common.into_iter(), sources);
    let of_file: BTreeMap<&str, String> = own
        .into_iter()
        .map(|(file, files)| {
            let own = hash(files.into_iter(), sources);
            let mut all = format!("{own} {common}");
            let mut around = below.around(file, sources).peekable();
            if around.peek().is_some() {
                all = format!("{all} {}", hash(around, sources));
            }
            (file, blake3::hash(all.as_bytes()).to_hex().to_string())
        })
        .collect();
    let entries = contents.entries.iter();
    entries
        .map(|entry| of_file[entry.file.as_str()].clone())
        .collect()
}

/// A folder, and those above it up to the top.
pub(super) fn above(folder: &str) -> impl Iterator<Item = &str> {
    std::iter::successors(Some(folder), |folder| {
        (!folder.is_empty()).then(|| folder_of(folder))
    })
}

/// The folder of a file; empty at the top.
pub(super) fn folder_of(file: &str) -> &str {
    split_name(file).0
}

fn split_name(file: &str) -> (&str, &str) {
    file.rsplit_once('/').unwrap_or(("", file))
}

fn stem(name: &str) -> &str {
    match name.rfind('.') {
        Some(dot) if dot > 0 => &name[..dot],
        _ => name,
    }
}

/// The longest part of a name, up to one of its dots, that is the stem of a motion.
fn own_stem<'a>(name: &'a str, stems: &BTreeSet<&str>) -> Option<&'a str> {
    let dots = name.match_indices('.').rev();
    dots.map(|(dot, _)| &name[..dot])
        .find(|stem| stems.contains(stem))
}

/// BLAKE3 over names and hashes of files.
fn hash<'a>(files: impl Iterator<Item = &'a str>, sources: &BTreeMap<String, Source>) -> String {
    let mut digest = Digest::default();
    for file in files {
        digest.part(split_name(file).1);
        digest.part(source_hash(sources, file));
    }
    digest.hex()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOTIONS: [&str; 4] = ["a/walk.bvh", "a/run.bvh", "b/walk.bvh", "other/walk.bvh"];

    /// Files with motions whose inputs change when `changed` does.
    fn depend_on(changed: &str, others: &[&str]) -> Vec<&'static str> {
        let inputs = |content: &str| {
            let source = |file: &&str| {
                let is_changed = *file == changed;
                let content = if is_changed { content } else { "as it was" };
                let source = Source {
                    of: usize::from(file.starts_with("other/")),
                    hash: Ok(content.to_owned()),
                    damaged_at: None,
                    head: Vec::new(),
                    bytes: 0,
                };
                ((*file).to_owned(), source)
            };
            let sources = MOTIONS.iter().chain(others).map(source).collect();
            let others = others.iter().copied().collect();
            of_single_files(&MOTIONS.into_iter().collect(), &others, &sources)
                .into_values()
                .collect::<Vec<String>>()
        };
        let mut motions = MOTIONS;
        motions.sort_unstable();
        let changed = std::iter::zip(inputs("before"), inputs("after"));
        std::iter::zip(motions, changed)
            .filter(|(_, (before, after))| before != after)
            .map(|(file, _)| file)
            .collect()
    }

    #[test]
    fn a_file_speaks_of_its_namesake_its_folder_or_all_below_in_its_source() {
        let others = [
            "a/walk.stance.json",
            "a/walk.txt",
            "a/cfg/labels.txt",
            "a/scene.bin",
            "a/gone.stance.json",
            "stance.toml",
            "b/README.md",
            "notes/list.txt",
            "other/README.md",
        ];
        for (changed, expected) in [
            ("a/walk.bvh", vec!["a/walk.bvh"]),
            ("a/walk.stance.json", vec!["a/walk.bvh"]),
            ("a/walk.txt", vec!["a/walk.bvh"]),
            ("a/cfg/labels.txt", vec!["a/run.bvh", "a/walk.bvh"]),
            ("a/scene.bin", vec!["a/run.bvh", "a/walk.bvh"]),
            ("a/gone.stance.json", vec![]),
            ("b/README.md", vec!["b/walk.bvh"]),
            ("stance.toml", vec!["a/run.bvh", "a/walk.bvh", "b/walk.bvh"]),
            ("notes/list.txt", vec![]),
            ("other/README.md", vec!["other/walk.bvh"]),
        ] {
            assert_eq!(depend_on(changed, &others), expected, "{changed}");
        }
    }
}
