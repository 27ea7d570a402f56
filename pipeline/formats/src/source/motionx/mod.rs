//! Motion-X and Motion-X++: SMPL-X parameters as arrays of 322 columns, with captions in a folder of the same
//! layout, and lists of splits.
//!
//! # Source
//! Repository IDEA-Research/Motion-X at 2a7db28: the columns and folders of its README; its conversion of
//! AMASS, which turns z up into y up; 30 fps. The second spelling of the folders is that of Motion-X++.

mod array;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use pickle::npy::Header;

use super::escaped;
use super::files::Files;
use super::format::{Contents, Entry, Format, Release, boxed};
use super::humanml3d::{SPLIT_LISTS, Splits, add_captions, lists_above};
use super::names::{around_folder, is_number};
use super::options::ReadOptions;
use super::up::Up;
use clip::ReadClip;

pub use array::read_array;

/// Motion-X: SMPL-X parameters of 322 columns.
// Bytes per second: the columns in f4.
pub const FORMAT: Format = Format {
    extensions: &["npy"],
    assumed_up: Some(Up::Y),
    by_name: |_, head| {
        let shape = Header::peek_shape("array", head).ok()?;
        matches!(shape[..], [_, array::WIDTH]).then_some(Ok(()))
    },
    read: |_, _, bytes, options| read_array(bytes, &options.skeleton).into(),
    find: |files| boxed(MotionXFolder::find(files)),
    ..Format::of_releases(
        "motion-x",
        "a folder smplx_322 of Motion-X, or smplx322 of Motion-X++; a lone array of 322 columns; its own rotations",
        (4 * array::WIDTH) as f64 * array::FPS,
    )
};

/// Folders of motions. The name of a motion is its path below such a folder.
const MOTIONS: [&str; 2] = ["smplx_322", "smplx322"];
/// Sibling folder with faces, which holds no bodies.
const FACES: &str = "face_motion_data";
/// Folders with the captions of whole clips, in files with the names of the motions.
const CAPTIONS: [&str; 3] = ["semantic_labels", "semantic_label", "motionx_seq_text_v1.1"];

/// A folder of motions of the release.
#[derive(Debug, Default)]
struct MotionXFolder {
    contents: Contents,
    /// File with the captions of a motion, by the motion's file.
    captions: BTreeMap<String, String>,
    /// Notes on a motion, by its file.
    notes: BTreeMap<String, String>,
}

/// Splits a file's path at one of `folders`: the part before the folder's name, and the part after it without
/// extension.
fn below<'a>(file: &'a str, folders: &[&str], extension: &str) -> Option<(&'a str, &'a str)> {
    let stem = file.strip_suffix(extension)?.strip_suffix('.')?;
    around_folder(stem, folders).map(|(root, _, name)| (root, name))
}

impl MotionXFolder {
    /// The folders of the release among the files.
    fn find(files: &Files) -> Vec<Self> {
        let mut roots: BTreeSet<&str> = BTreeSet::new();
        for file in files.all() {
            let place = below(file, &MOTIONS, "npy");
            roots.extend(
                place
                    .filter(|(root, _)| !is_face(root))
                    .map(|(root, _)| root),
            );
        }
        // Captions by the name of their motion.
        let mut captions: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for file in files.all() {
            if let Some((_, name)) = below(file, &CAPTIONS, "txt") {
                captions.entry(name).or_default().push(file);
            }
        }
        let mut folders: Vec<Self> = roots
            .iter()
            .map(|root| Self::plan(files, root, &roots, &captions))
            .collect();
        let used: BTreeSet<String> = folders
            .iter()
            .flat_map(|folder| folder.captions.values().cloned())
            .collect();
        // Files of no motion folder are listed once, in the first folder.
        if let Some(first) = folders.first_mut() {
            let faces = files
                .all()
                .filter(|file| below(file, &MOTIONS, "npy").is_some_and(|(root, _)| is_face(root)));
            for file in faces {
                let reason = "facial expressions of Motion-X, no body";
                first.contents.pass_over(file, reason);
            }
            for file in captions.into_values().flatten() {
                let is_used = used.contains(file);
                first.contents.pass_over_captions(file, is_used);
            }
        }
        folders
    }

    fn plan(
        files: &Files,
        root: &str,
        roots: &BTreeSet<&str>,
        captions: &BTreeMap<&str, Vec<&str>>,
    ) -> Self {
        let mut folder = Self::default();
        folder.contents.publishes_splits = SPLIT_LISTS;
        let mut lists = Vec::new();
        for (file, split, ids) in lists_above(files, root) {
            match ids {
                Ok(ids) => {
                    let reason = "list of motions of Motion-X, no motion";
                    folder.contents.pass_over(&file, reason);
                    lists.extend(split.map(|split| (file, (Some(split), ids))));
                }
                Err(rejected) if split.is_some() => folder.contents.reject_splits(file, rejected),
                Err(rejected) => folder.contents.reject(file, rejected),
            }
        }
        let original = |name: &str| original_of(name).unwrap_or_else(|| name.to_owned());
        let splits = Splits::of(lists.iter().map(|(_, list)| list), original);
        let motions: Vec<(&str, &str)> = files
            .under(root)
            .filter_map(|file| Some((file, below(file, &MOTIONS, "npy")?)))
            .filter(|(_, (before, _))| *before == root)
            .map(|(file, (_, name))| (file, name))
            .collect();
        let names: BTreeSet<&str> = motions.iter().map(|(_, name)| *name).collect();
        let missing = splits.clips().filter(|name| !names.contains(name));
        let lists: Vec<&str> = lists.iter().map(|(file, _)| file.as_str()).collect();
        let contents = &mut folder.contents;
        contents.remark_on_listed("Motion-X", &lists.join(", "), missing.collect());
        // Captions of another copy of the release, or of another release with the same names, are skipped.
        let is_own = |text: &&&str| {
            let common = |root: &&str| common_start(text, root);
            roots.iter().map(common).max() == Some(common(&root))
        };
        for (file, name) in motions {
            let original = original_of(name);
            let (split, note) = splits.get(name);
            folder
                .notes
                .extend(note.map(|note| (file.to_owned(), note)));
            let own = captions.get(name).into_iter().flatten().filter(is_own);
            // If there are several copies of the release, use the captions nearest to the motion.
            let nearest = own.max_by_key(|text| common_start(text, file));
            if let Some(text) = nearest {
                folder.captions.insert(file.to_owned(), (*text).to_owned());
            }
            folder.contents.entries.push(Entry {
                file: file.to_owned(),
                key: String::new(),
                id: escaped(name),
                split,
                group: Some(original.clone().unwrap_or_else(|| name.to_owned())),
                mirrored_of: original
                    .filter(|original| names.contains(original.as_str()))
                    .map(|original| escaped(&original)),
            });
        }
        folder
    }
}

fn is_face(root: &str) -> bool {
    root.split('/').any(|component| component == FACES)
}

/// Name of the motion that a mirrored copy mirrors: the release has copies of HumanML3D's clips, with an `M`
/// before their number.
fn original_of(name: &str) -> Option<String> {
    let (folder, clip) = name.rsplit_once('/')?;
    let number = clip.strip_prefix('M')?;
    let is_copy = folder.ends_with("humanml") && is_number(number);
    is_copy.then(|| format!("{folder}/{number}"))
}

fn common_start(a: &str, b: &str) -> usize {
    std::iter::zip(a.bytes(), b.bytes())
        .take_while(|(a, b)| a == b)
        .count()
}

impl Release for MotionXFolder {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let mut clip = read_array(&files.read(&entry.file)?, &options.skeleton)?;
        clip.notes.extend(self.notes.get(&entry.file).cloned());
        add_captions(&mut clip, files, self.captions.get(&entry.file))?;
        Ok(clip)
    }
}
