//! Folders of HumanML3D among the files.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Split;

use super::id::is_id;
use super::index::{IndexRow, parse_index};
use crate::source::archive;
use crate::source::files::Files;
use crate::source::head::refuse_pointer;
use clip::{Rejected, rejected};

/// Folders of a release.
const JOINTS_FOLDER: &str = "new_joints";
const VECTORS_FOLDER: &str = "new_joint_vecs";
const TEXTS_FOLDER: &str = "texts";
/// Names of the lists that state splits.
pub(crate) const SPLIT_LISTS: &str = "train.txt, val.txt and test.txt";
/// Lists of ids, and the split of each list, if any.
pub(crate) const LISTS: [(&str, Option<Split>); 5] = [
    ("train.txt", Some(Split::Train)),
    ("val.txt", Some(Split::Val)),
    ("test.txt", Some(Split::Test)),
    ("all.txt", None),
    ("train_val.txt", None),
];
/// Statistics of the features, beside the lists.
const STATISTICS: [&str; 2] = ["Mean.npy", "Std.npy"];
/// The list of crops.
const INDEX: &str = "index.csv";

/// The files of one HumanML3D folder by kind.
#[derive(Debug, Default)]
pub struct Layout {
    /// Path of the folder with a trailing slash; empty for the source itself.
    pub root: String,
    /// File of each id's joints.
    pub joints: BTreeMap<String, String>,
    /// File of each id's vector.
    pub vectors: BTreeMap<String, String>,
    /// File of each id's captions.
    pub texts: BTreeMap<String, String>,
    /// Lists by their file: the split of each and its ids.
    pub lists: BTreeMap<String, List>,
    /// Other files of the folder, with the reason why each is skipped.
    pub(super) others: Vec<(String, String)>,
    /// The crop list, and its rows by id.
    pub(super) index: Option<(String, BTreeMap<String, IndexRow>)>,
    /// Files that could not be read.
    pub(super) rejected: Vec<(String, Rejected)>,
    /// Lists of a split that could not be read.
    pub unread_splits: Vec<String>,
}

/// Finds HumanML3D folders by their layout.
pub fn layouts(files: &Files) -> Vec<Layout> {
    let mut found: BTreeMap<&str, Layout> = BTreeMap::new();
    for file in files.all() {
        let Some((folder, name)) = file.rsplit_once('/') else {
            continue;
        };
        let (root, parent) = root_and_folder(folder);
        let Some((id, extension)) = name.rsplit_once('.') else {
            continue;
        };
        let pick: fn(&mut Layout) -> &mut BTreeMap<String, String> = match (parent, extension) {
            (JOINTS_FOLDER, "npy") => |layout| &mut layout.joints,
            (VECTORS_FOLDER, "npy") => |layout| &mut layout.vectors,
            (TEXTS_FOLDER, "txt") if is_id(id) => |layout| &mut layout.texts,
            _ => continue,
        };
        let layout = found.entry(root).or_default();
        pick(layout).insert(id.to_owned(), file.to_owned());
    }
    found
        .into_iter()
        .map(|(root, mut layout)| {
            layout.root = root.to_owned();
            layout.find_companions(files);
            layout
        })
        .collect()
}

/// The release's root folder, with a trailing slash, and the name of `folder` in it. A release's folder may be an
/// archive: `texts.zip` stands for `texts`, with or without a folder of that name inside.
fn root_and_folder(folder: &str) -> (&str, &str) {
    let split = |folder: &str| folder.rfind('/').map_or(0, |slash| slash + 1);
    let at = split(folder);
    let (root, name) = folder.split_at(at);
    if let Some(name) = archive::stem(name) {
        return (root, name);
    }
    let above = root.strip_suffix('/').unwrap_or(root);
    let (outer, archived) = above.split_at(split(above));
    match archive::stem(archived) {
        Some(stem) if stem == name => (outer, name),
        _ => (root, name),
    }
}

impl Layout {
    /// Finds lists, statistics and the crop list in the folder or the nearest one above that has them.
    fn find_companions(&mut self, files: &Files) {
        let root = self.root.clone();
        let nearest = |name: &str| nearest(files, &root, name);
        for (file, split, ids) in lists_above(files, &root) {
            match ids {
                Ok(ids) => {
                    self.lists.insert(file, (split, ids));
                }
                Err(rejected) => {
                    self.unread_splits.extend(split.map(|_| file.clone()));
                    self.rejected.push((file, rejected));
                }
            }
        }
        for name in STATISTICS {
            if let Some(file) = nearest(name) {
                let reason = "statistics of HumanML3D features, no motion".to_owned();
                self.others.push((file, reason));
            }
        }
        if let Some(file) = nearest(INDEX) {
            match files.read(&file).and_then(|bytes| parse_index(&bytes)) {
                Ok(rows) => {
                    let rows = rows.into_iter().map(|row| (row.id.clone(), row));
                    self.index = Some((file, rows.collect()));
                }
                Err(rejected) => self.rejected.push((file, rejected)),
            }
        }
    }

    /// Whether the id has joints or a vector.
    pub fn has_motion(&self, id: &str) -> bool {
        self.vectors.contains_key(id) || self.joints.contains_key(id)
    }

    /// Ids of motions, each once, sorted.
    pub fn ids(&self) -> impl Iterator<Item = &String> {
        let ids: BTreeSet<&String> = self.vectors.keys().chain(self.joints.keys()).collect();
        ids.into_iter()
    }
}

/// A list of ids, and its split, if any.
pub(crate) type List = (Option<Split>, Vec<String>);

/// The file of a list, its split, if any, and its ids, unless they cannot be read.
type FoundList = (String, Option<Split>, Result<Vec<String>, Rejected>);

/// The [`LISTS`] in the folder or the nearest one above that has them, in their order.
pub(crate) fn lists_above(files: &Files, root: &str) -> Vec<FoundList> {
    let found = LISTS
        .into_iter()
        .filter_map(|(name, split)| Some((nearest(files, root, name)?, split)));
    found
        .map(|(file, split)| {
            let read = files.read(&file);
            let ids = read.and_then(|bytes| parse_list(&bytes));
            (file, split, ids)
        })
        .collect()
}

/// The file of this name in the folder or the nearest one above that has it.
fn nearest(files: &Files, root: &str, name: &str) -> Option<String> {
    above(root)
        .map(|folder| format!("{folder}{name}"))
        .find(|file| files.contains(file))
}

/// A folder and its parents, innermost first, each with a trailing slash.
fn above(root: &str) -> impl Iterator<Item = &str> {
    let ends: Vec<usize> = root.match_indices('/').map(|(at, _)| at + 1).collect();
    ends.into_iter()
        .rev()
        .chain([0])
        .map(move |end| &root[..end])
}

/// The ids of a list, one on each line.
///
/// # Errors
/// `E-LFS-POINTER`, or `E-HML-LIST` if it is no text.
pub(crate) fn parse_list(bytes: &[u8]) -> Result<Vec<String>, Rejected> {
    refuse_pointer(bytes)?;
    let text = str::from_utf8(bytes)
        .map_err(|error| rejected!("E-HML-LIST", "found no list of ids: {error}"))?;
    let ids = text
        .trim_start_matches('\u{feff}')
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .map(|line| line.strip_suffix(".npy").unwrap_or(line).to_owned())
        .collect();
    Ok(ids)
}
