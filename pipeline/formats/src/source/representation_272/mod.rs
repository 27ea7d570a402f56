//! The 272 features of MotionStreamer and MotionMillion: folders of them, with captions, split lists and
//! statistics, and lone arrays.
//!
//! | folder | MotionMillion | HumanML3D-272, BABEL-272 |
//! |---|---|---|
//! | features | `motion_data/vector_272/PATH.npy` | `motion_data/ID.npy` |
//! | captions | `texts/PATH.txt`, plain lines | `texts/ID.txt`, lines of HumanML3D |
//! | splits | `split/VERSION/LENGTHS/SPLIT.txt` | `split/SPLIT.txt` |
//! | statistics | `mean_std/vector_272` | `mean_std`, `t2m_babel_mean_std` |
//!
//! # Source
//! Li-xingXiao/272-dim-Motion-Representation and VankouF/MotionMillion-Codes: their descriptions of the folders,
//! and the loaders in `dataset/`.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;

use datasets_spec::{Skeleton, Split};
use features::representation_272::{Features, WIDTH, motion_of_features};
use pickle::npy::{self, Header};

use super::files::Files;
use super::format::{Contents, Entry, Format, Release, boxed};
use super::head::refuse_pointer;
use super::humanml3d::{
    List, SPLIT_LISTS, Splits, add_captions, check_length, clip_of, in_single_precision,
    mirrored_of, parse_list,
};
use super::names::file_name;
use super::options::ReadOptions;
use super::up::Up;
use clip::{ReadClip, Rejected, RotationSource, SourceClip, rejected};

const MOTIONS: &str = "motion_data/";
/// Folder of the features in MotionMillion, which may hold other features beside it.
const VECTORS: &str = "vector_272/";
const TEXTS: &str = "texts/";
const SPLITS: &str = "split/";
/// Part of the name of the folder with mean and deviation.
const STATISTICS: &str = "mean_std";
/// Number of bytes at the start of a file that contain the shape of its array.
const HEAD_BYTES: u64 = 256;

/// The 272 features of MotionStreamer and MotionMillion.
// Bytes per second: the features in f4 at 30 fps.
pub const FORMAT: Format = Format {
    extensions: &["npy"],
    assumed_up: Some(Up::Y),
    by_name: |_, head| has_width(head).then_some(Ok(())),
    read: |_, _, bytes, options| read_array(bytes, &options.skeleton).into(),
    find,
    ..Format::of_releases(
        "272",
        "a folder motion_data of arrays with 272 columns (MotionMillion, HumanML3D-272, BABEL-272); a lone array of \
         their shape; its own rotations",
        (size_of::<Features>() * 30) as f64,
    )
};

/// Whether these are the first bytes of an array with 272 columns.
fn has_width(head: &[u8]) -> bool {
    Header::peek_shape("array", head).is_ok_and(|shape| matches!(shape[..], [_, WIDTH]))
}

/// A folder of features.
#[derive(Debug, Default)]
struct Folder {
    contents: Contents,
    /// File of each id's captions.
    texts: BTreeMap<String, String>,
    /// Notes on the splits of ids.
    notes: BTreeMap<String, String>,
}

/// The folders of 272 features among the files, each found by its layout and the width of its arrays.
pub fn find(files: &Files) -> Vec<Box<dyn Release>> {
    let mut found: BTreeMap<&str, BTreeMap<&str, &str>> = BTreeMap::new();
    for file in files.all() {
        if let Some((root, id)) = place(file) {
            found.entry(root).or_default().insert(id, file);
        }
    }
    found.retain(|_, clips| clips.values().any(|file| starts_with_width(files, file)));
    let found = found.into_iter();
    boxed(found.map(|(root, clips)| Folder::new(files, root, &clips)))
}

/// The folder of a release, with a trailing slash, and the id of the clip in this file.
fn place(file: &str) -> Option<(&str, &str)> {
    let at = match file.starts_with(MOTIONS) {
        true => 0,
        false => file.find(&format!("/{MOTIONS}"))? + 1,
    };
    let (root, inside) = file.split_at(at);
    let path = &inside[MOTIONS.len()..];
    let id = path.strip_prefix(VECTORS).unwrap_or(path);
    Some((root, id.strip_suffix(".npy")?))
}

fn starts_with_width(files: &Files, file: &str) -> bool {
    let mut head = Vec::new();
    let read = files
        .open(file)
        .map(|file| file.take(HEAD_BYTES).read_to_end(&mut head));
    matches!(read, Ok(Ok(_))) && has_width(&head)
}

impl Folder {
    fn new(files: &Files, root: &str, clips: &BTreeMap<&str, &str>) -> Self {
        let mut folder = Self::default();
        folder.contents.publishes_splits = SPLIT_LISTS;
        let mut lists: Vec<List> = Vec::new();
        for file in files.under(root) {
            let inside = &file[root.len()..];
            let text_of = |folder: &str| inside.strip_prefix(folder)?.strip_suffix(".txt");
            let reason = if let Some(id) = text_of(TEXTS) {
                let has_motion = clips.contains_key(id);
                folder.contents.pass_over_captions(file, has_motion);
                if has_motion {
                    folder.texts.insert(id.to_owned(), file.to_owned());
                }
                continue;
            } else if let Some(list) = text_of(SPLITS) {
                // Other lists, such as all.txt, state no split.
                let split: Option<Split> = file_name(list).parse().ok();
                match files.read(file).and_then(|bytes| parse_list(&bytes)) {
                    Ok(ids) => lists.push((split, ids)),
                    Err(rejected) if split.is_some() => {
                        folder.contents.reject_splits(file, rejected);
                        continue;
                    }
                    Err(rejected) => {
                        folder.contents.reject(file, rejected);
                        continue;
                    }
                }
                "list of ids of 272-d features, no motion"
            } else if is_statistics(inside) {
                "statistics of 272-d features, no motion"
            } else {
                continue;
            };
            folder.contents.pass_over(file, reason);
        }
        let splits = Splits::of(lists.iter(), |id| clip_of(id).to_owned());
        let listed = lists.iter().filter(|(split, _)| split.is_some());
        let listed: BTreeSet<&str> = listed
            .flat_map(|(_, ids)| ids.iter().map(String::as_str))
            .collect();
        let missing = listed.into_iter().filter(|id| !clips.contains_key(id));
        let (name, lists) = ("272-d features", format!("{root}{SPLITS}"));
        let missing = missing.collect();
        folder.contents.remark_on_listed(name, &lists, missing);
        for (&id, &file) in clips {
            let (split, note) = splits.get(id);
            if let Some(note) = note {
                folder.notes.insert(id.to_owned(), note);
            }
            folder.contents.entries.push(Entry {
                file: file.to_owned(),
                id: id.to_owned(),
                split,
                mirrored_of: mirrored_of(id).map(str::to_owned),
                ..Entry::default()
            });
        }
        folder
    }
}

fn is_statistics(inside: &str) -> bool {
    let mut parts = inside.split('/');
    let is_folder = parts.next().is_some_and(|first| first.contains(STATISTICS));
    let name = parts.next_back().unwrap_or_default().to_lowercase();
    is_folder && matches!(&*name, "mean.npy" | "std.npy")
}

impl Release for Folder {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let mut clip = read_array(&files.read(&entry.file)?, &options.skeleton)?;
        clip.notes.extend(self.notes.get(&entry.id).cloned());
        add_captions(&mut clip, files, self.texts.get(&entry.id))?;
        Ok(clip)
    }
}

/// Reads 272 features as a motion of the given body. The fit error is the mean distance between the features' joints
/// and the body's joints, posed by the features' rotations.
///
/// # Shapes
/// `[L, 272]`, y up, 30 fps.
///
/// # Errors
/// Those of [`npy`], `E-LFS-POINTER`, `E-272-SHAPE`, `E-272-FINITE`, `E-272-FIT` or `E-TOO-SHORT`.
pub fn read_array(bytes: &[u8], skeleton: &Skeleton) -> Result<SourceClip, Rejected> {
    refuse_pointer(bytes)?;
    let array = npy::read_numbers("array", bytes)?;
    let [num_frames, WIDTH] = array.shape[..] else {
        return Err(rejected!(
            "E-272-SHAPE",
            "found an array of shape {:?}, expected [frames, {WIDTH}]",
            array.shape
        ));
    };
    check_length(num_frames)?;
    let broken = |value: &f64| !(*value as f32).is_finite();
    if let Some(at) = array.values.iter().position(broken) {
        return Err(rejected!(
            "E-272-FINITE",
            "found {} in column {} of frame {}, expected finite numbers",
            array.values[at],
            at % WIDTH,
            at / WIDTH
        ));
    }
    let features: Vec<Features> = in_single_precision(&array);
    let (motion, fit_error_m) = motion_of_features(&features, skeleton)
        .map_err(|error| Rejected::retarget("E-272-FIT", error.to_string()))?;
    let mut clip = SourceClip::new(motion, RotationSource::Native);
    clip.fit_error_m = Some(fit_error_m);
    clip.notes = vec![format!(
        "rotations of the 272-d vector, 30 fps; they drive the body {} as they are",
        skeleton.name()
    )];
    Ok(clip)
}
