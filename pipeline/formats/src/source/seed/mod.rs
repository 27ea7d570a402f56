//! BONES-SEED: BVH files of the SOMA rig, their metadata and their temporal labels.
//!
//! The metadata are a table with a row per motion (`metadata/seed_metadata_v004.parquet`, or `.csv`); the temporal
//! labels have a line of JSON per motion (`metadata/seed_metadata_v002_temporal_labels.jsonl`). Without metadata, the
//! BVH files are read like any others.
//!
//! # Source
//! The dataset itself requires consent before download. Its layout, columns and labels are known from public programs
//! that read it: nv-tlabs/kimodo at 7330e7e, NVlabs/ProtoMotions at 607ca7a (guides to SEED), and notes that list the
//! columns of version 3 and 4.

mod metadata;
#[cfg(test)]
mod tests;
mod timeline;

use std::collections::{BTreeMap, BTreeSet};

use self::metadata::{Described, stem};
use self::timeline::Timeline;
use super::files::Files;
use super::format::{Contents, Entry, Format, Release, boxed};
use super::head::refuse_pointer;
use super::names::file_name;
use super::options::ReadOptions;
use super::{bvh, escaped};
use crate::sidecar::caption;
use clip::{LabelProblem, ReadClip, Rejected};

pub use timeline::Timelines;

/// BONES-SEED.
// Bytes per second: 240 numbers of nine characters at 120 fps.
pub const FORMAT: Format = Format {
    find: |files| boxed(SeedFolder::find(files)),
    ..Format::of_releases(
        "bones-seed",
        "BVH files with metadata/seed_metadata_* beside them; rotations are retargeted",
        260_000.0,
    )
};

/// Prefix of the names of metadata files, and part of the names of temporal label files.
const METADATA: &str = "seed_metadata";
const TEMPORAL: &str = "temporal_labels";
/// The folder of the tables.
const METADATA_FOLDER: &str = "metadata/";
/// The folder of BVH files whose skeleton is each actor's own. The same motions are in another folder on one skeleton.
const PROPORTIONAL: &str = "soma_proportional";
/// The folder of body shapes and of the rig.
const SHAPES: &str = "soma_shapes/";
/// Suffix of the names of mirrored copies.
const MIRRORED: &str = "_M";

/// A folder of the dataset.
#[derive(Debug, Default)]
struct SeedFolder {
    contents: Contents,
    /// Whether something of the metadata could not be read.
    is_incomplete: bool,
    motions: BTreeMap<String, Described>,
    timelines: BTreeMap<String, Timeline>,
    /// The file that the temporal labels are from.
    labels_from: String,
}

/// The tables of a folder.
#[derive(Default)]
struct Tables<'a> {
    metadata: Vec<&'a str>,
    temporal: Vec<&'a str>,
}

impl SeedFolder {
    /// Folders of the dataset among the files: those that contain metadata, directly or in a folder `metadata`.
    fn find(files: &Files) -> Vec<Self> {
        let mut roots: BTreeMap<&str, Tables<'_>> = BTreeMap::new();
        for file in files.all() {
            let name = file_name(file);
            if !name.starts_with(METADATA) {
                continue;
            }
            let folder = &file[..file.len() - name.len()];
            let root = folder.strip_suffix(METADATA_FOLDER);
            let root = root.filter(|root| root.is_empty() || root.ends_with('/'));
            let tables = roots.entry(root.unwrap_or(folder)).or_default();
            if name.contains(TEMPORAL) {
                tables.temporal.push(file);
            } else if name.ends_with(".parquet") || name.ends_with(".csv") {
                tables.metadata.push(file);
            }
        }
        roots
            .into_iter()
            .map(|(root, tables)| Self::plan(files, root, &tables))
            .collect()
    }

    fn plan(files: &Files, root: &str, tables: &Tables<'_>) -> Self {
        let mut folder = Self::default();
        let motions: Vec<&str> = files
            .under(root)
            .filter(|file| file.ends_with(".bvh") && !below(root, file).starts_with(SHAPES))
            .collect();
        let names: BTreeSet<&str> = motions.iter().map(|file| stem(file_name(file))).collect();
        folder.read_tables(files, tables, &names);
        for file in files.under(root) {
            if below(root, file).starts_with(SHAPES) {
                let reason = "body shape or rig of BONES-SEED, no motion";
                folder.contents.pass_over(file, reason);
            }
        }
        let is_proportional =
            |file: &str| file.split('/').any(|component| component == PROPORTIONAL);
        let uniform: BTreeSet<&str> = motions
            .iter()
            .filter(|file| !is_proportional(file))
            .map(|file| stem(file_name(file)))
            .collect();
        let ids: BTreeSet<&str> = motions.iter().map(|file| id_of(root, file)).collect();
        for file in motions {
            let name = stem(file_name(file));
            // What could not be read of the metadata may name it, and say which motion it mirrors.
            let is_named = folder.motions.contains_key(name)
                || folder.timelines.contains_key(name)
                || folder.is_incomplete;
            if !is_named {
                continue;
            }
            if is_proportional(file) && uniform.contains(name) {
                let reason = "motion of BONES-SEED on its actor's skeleton, which is read on the uniform one";
                folder.contents.pass_over(file, reason);
                continue;
            }
            let is_mirrored = folder
                .motions
                .get(name)
                .is_some_and(|motion| motion.is_mirrored);
            let original = |text: &str| {
                let original = text.strip_suffix(MIRRORED).filter(|_| is_mirrored);
                original.map(str::to_owned)
            };
            let id = id_of(root, file);
            folder.contents.entries.push(Entry {
                file: file.to_owned(),
                id: escaped(id),
                // An unnamed motion may be the mirrored copy that its name says.
                group: Some(match folder.motions.contains_key(name) {
                    true => original(name).unwrap_or_else(|| name.to_owned()),
                    false => name.strip_suffix(MIRRORED).unwrap_or(name).to_owned(),
                }),
                mirrored_of: original(id)
                    .filter(|original| ids.contains(original.as_str()))
                    .map(|original| escaped(&original)),
                ..Entry::default()
            });
        }
        folder
    }

    /// Reads the newest metadata and temporal labels; older ones are passed over.
    fn read_tables(&mut self, files: &Files, tables: &Tables<'_>, names: &BTreeSet<&str>) {
        let wanted = |name: &str| names.contains(name);
        let newest_metadata = newest(&tables.metadata);
        if let Some(file) = newest_metadata {
            let read = files.read(file).and_then(|bytes| {
                if file.ends_with(".parquet") {
                    metadata::of_parquet(bytes, &wanted)
                } else {
                    metadata::of_csv(&bytes, &wanted)
                }
            });
            let read = read.map(|(motions, problem)| {
                self.motions = motions;
                problem
            });
            if read.is_err() {
                self.contents.unread_splits.push(file.to_owned());
            }
            self.is_incomplete = !matches!(read, Ok(None));
            self.account(file, read);
        }
        let newest_temporal = newest(&tables.temporal);
        if let Some(file) = newest_temporal {
            let read = files
                .read(file)
                .and_then(|bytes| Timelines::parse(&bytes, &wanted));
            let read = read.map(|timelines| {
                self.timelines = timelines.of_motion;
                timelines.problem
            });
            file.clone_into(&mut self.labels_from);
            self.account(file, read);
        }
        let read = [newest_metadata, newest_temporal];
        let all = tables.metadata.iter().chain(&tables.temporal);
        for file in all.filter(|file| !read.contains(&Some(**file))) {
            let reason = "older or repeated metadata of BONES-SEED, not read";
            self.contents.pass_over(*file, reason);
        }
    }

    /// Lists a table as read with the motions, or as rejected if some of its rows could not be used.
    fn account(&mut self, file: &str, read: Result<Option<Rejected>, Rejected>) {
        match read {
            Ok(None) => {
                let reason = "metadata of BONES-SEED, read with the motions";
                self.contents.pass_over(file, reason);
            }
            Ok(Some(rejected)) | Err(rejected) => self.contents.reject(file, rejected),
        }
    }
}

/// The newest of some tables: versions are numbers in the names. Parquet is preferred to CSV.
fn newest<'a>(tables: &[&'a str]) -> Option<&'a str> {
    tables.iter().copied().max_by_key(|&file| {
        let name = file_name(file);
        let (version, extension) = name.rsplit_once('.').unwrap_or((name, ""));
        let numbers: Vec<u64> = version
            .split(|letter: char| !letter.is_ascii_digit())
            .filter_map(|digits| digits.parse().ok())
            .collect();
        (numbers, extension == "parquet", version)
    })
}

/// A file's path below the root.
fn below<'a>(root: &str, file: &'a str) -> &'a str {
    file.strip_prefix(root).unwrap_or(file)
}

/// Id of a motion: its path without extension, as for files outside a release.
fn id_of<'a>(root: &str, file: &'a str) -> &'a str {
    let path = below(root, file);
    path.strip_suffix(".bvh").unwrap_or(path)
}

impl Release for SeedFolder {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let bytes = files.read(&entry.file)?;
        refuse_pointer(&bytes)?;
        let mut clip = bvh::read(&mut &bytes[..], bytes.len(), options)?;
        let name = stem(file_name(&entry.file));
        if let Some(motion) = self.motions.get(name) {
            clip.captions = motion.captions.iter().map(caption).collect();
            clip.action.clone_from(&motion.action);
            clip.style.clone_from(&motion.style);
            clip.subject.clone_from(&motion.subject);
        } else {
            clip.notes
                .push("the metadata of BONES-SEED do not name it".to_owned());
        }
        if let Some(timeline) = self.timelines.get(name) {
            for caption in &timeline.captions {
                if !clip.captions.contains(caption) {
                    clip.captions.push(caption.clone());
                }
            }
            if let Some(origin) = &timeline.carried_from {
                clip.notes.push(format!(
                    "temporal labels carried over automatically from {origin}"
                ));
            }
            let problems = timeline.problems.iter();
            clip.label_problems
                .extend(problems.map(|reason| LabelProblem {
                    file: self.labels_from.clone(),
                    reason: format!("{name}: {reason}"),
                }));
        }
        Ok(clip)
    }
}
